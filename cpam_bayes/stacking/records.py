"""The problem of unknown ply angles and the posterior over stacking sequences that solves it."""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.plate import Specimen
from cpam_bayes.stacking.conditional.evaluation import Evaluated
from cpam_bayes.stacking.conditional.posterior import ConditionalPosterior
from cpam_bayes.stacking.features import PlySums
from cpam_bayes.stacking.surrogate.training import TrainingSettings
from cpam_bayes.stacking.symmetry.classes import canonical, members
from cpam_bayes.stacking.symmetry.symmetries import Symmetry

Array = NDArray[Any]

# Probability that a credible set holds.
CREDIBLE = 0.95
# A draw this much better than every sequence listed, nats, was overlooked: less is noise of its evidence.
OVERLOOKED = 0.3


@dataclass(frozen=True, slots=True)
class StackingSettings:
    """How the posterior over stacking sequences is computed.

    exhaustive : up to so many classes of sequences every evidence is computed.
    training : of the surrogate where there are more.
    halvings : of the cells of the piecewise-linear surrogate.
    unaccounted : probability that may be left out.
    max_fitted : sequences whose constants are fitted one by one, at most.
    sampled_fraction : fraction of the probability of these whose evidence is then sampled.
    max_sampled : classes sampled, at most.
    log2_sampled : log2 of the points of that importance sampling.
    listed : most probable classes, whose evidence is refined.
    draws : sequences drawn to check and to correct the rest.
    log2_points : log2 of the points of the importance sampling of refined and drawn sequences.
    """

    exhaustive: int = 1500
    training: TrainingSettings = field(default_factory=TrainingSettings)
    halvings: int = 2
    unaccounted: float = 1e-3
    max_fitted: int = 20_000
    sampled_fraction: float = 0.99
    max_sampled: int = 8_000
    log2_sampled: int = 7
    listed: int = 200
    draws: int = 500
    log2_points: int = 9

    def enumerates(self, n_sequences: int) -> bool:
        """Whether so many sequences are few enough for every evidence to be computed."""
        return n_sequences <= 2 * self.exhaustive


DEFAULT_SETTINGS = StackingSettings()


@dataclass(frozen=True, slots=True)
class SurrogateCheck:
    """Accuracy of the evidence of sequences for which it was not refined, on draws from the posterior.

    training_size : sequences that the surrogate was trained on.
    rms : root mean square error of the log evidence on the draws, nats.
    largest : largest error on those draws that count, nats.
    overlooked : by how much the best draw is better than every sequence listed, nats.
    correction : log of the factor on the sum of the surrogate that the draws gave.
    effective : fraction of the draws that count.
    fitted : classes fitted one by one.
    sampled : classes of these whose evidence was sampled.
    surrogate_probability : of all sequences known from the surrogate alone.
    basis_error : largest relative error of a frequency, at constants drawn, by the basis for the posterior.
    """

    training_size: int
    rms: float
    largest: float
    overlooked: float
    correction: float
    effective: float
    fitted: int
    sampled: int
    surrogate_probability: float
    basis_error: float


@dataclass(frozen=True, slots=True)
class StackingPosterior:
    """The posterior over the stacking sequences of one specimen.

    A class holds sequences that no frequency tells apart; it is known by its first member.

    conditional : posterior of the constants that any sequence has.
    enumerated : sequences on the grid.
    classes : distinct ones, symmetric images merged; ``None`` where they were not counted.
    log_evidence_total : log of the mean evidence of all sequences.
    top : (t, k) degrees, the most probable classes in descending order.
    same_bending : of each, (a, k) grid indices of all other classes with its bending stiffness.
    alike : those of them that the frequencies do not tell from it, and that belong to it with their images.
    multiplicity : (t,) sequences in each class.
    probability : (t,) of each single sequence.
    log_evidence, log_evidence_error : (t,) nats.
    components : conditional posteriors of ``top``.
    marginals : (k, n_grid) probability of every angle, ply by ply.
    credible_count : sequences in the smallest set that holds 95 %.
    effective_count : exp of the entropy.
    unaccounted : bound of the probability left out.
    drawn : sequences drawn from the posterior, with their conditional posteriors.
    draw_weight : (d,) weight of each draw.
    check : ``None`` where every evidence was computed.
    """

    specimen: Specimen
    conditional: ConditionalPosterior
    symmetries: tuple[Symmetry, ...]
    grid_deg: Array
    enumerated: int
    classes: int | None
    log_evidence_total: float
    top: Array
    same_bending: tuple[Array, ...]
    alike: tuple[Array, ...]
    multiplicity: Array
    probability: Array
    log_evidence: Array
    log_evidence_error: Array
    components: Evaluated
    marginals: Array
    credible_count: int
    effective_count: float
    unaccounted: float
    drawn: Evaluated
    draw_weight: Array
    check: SurrogateCheck | None
    seconds: float

    def listing(self, rows: Array) -> StackingPosterior:
        """The posterior with a list of the classes ``rows`` of this one's only."""
        return replace(
            self,
            top=self.top[rows],
            same_bending=tuple(self.same_bending[i] for i in rows),
            alike=tuple(self.alike[i] for i in rows),
            multiplicity=self.multiplicity[rows],
            probability=self.probability[rows],
            log_evidence=self.log_evidence[rows],
            log_evidence_error=self.log_evidence_error[rows],
            components=self.components[rows],
        )

    def class_members(self, i: int) -> Array:
        """All sequences of the listed class ``i``, (multiplicity, k) grid indices."""
        first = np.vstack((self.components.sequences[i], self.alike[i]))
        return np.concatenate([members(s, self.symmetries) for s in first])

    def classes_of(self, sequences: Array) -> Array:
        """Index of the listed class of each sequence of grid indices (m, k), -1 beyond the list, (m,)."""
        index = np.repeat(np.arange(len(self.top)), [1 + len(others) for others in self.alike])
        first = [np.vstack(pair) for pair in zip(self.components.sequences, self.alike, strict=True)]
        listed = canonical(np.concatenate(first), self.symmetries).representative
        position = {tuple(row): int(i) for i, row in zip(index, listed.tolist(), strict=True)}
        wanted = canonical(sequences, self.symmetries).representative
        return np.array([position.get(tuple(row), -1) for row in wanted.tolist()], dtype=np.int64)


@dataclass(frozen=True, slots=True)
class StackingProblem:
    """The stacking sequences of one specimen: their posteriors, symmetries and grid.

    sums : over the plies; ``None`` where the layup is not symmetric.
    starts : (2, n) parameters that every optimisation starts from.
    library : (p, n_constants) constants whose best two for a sequence are further starts.
    """

    specimen: Specimen
    conditional: ConditionalPosterior
    symmetries: tuple[Symmetry, ...]
    grid_deg: Array
    sums: PlySums | None
    starts: Array
    library: Array
    settings: StackingSettings
    executor: Executor | None

    @property
    def n_unknown(self) -> int:
        """Number of unknown angles."""
        return self.conditional.n_angles

    @property
    def n_sequences(self) -> int:
        """Number of sequences on the grid."""
        return int(len(self.grid_deg) ** self.n_unknown)

    def random_members(self, data: Evaluated, rng: np.random.Generator) -> Evaluated:
        """Sequences replaced by random members of their classes: all are equally probable."""
        classes = [members(sequence, self.symmetries) for sequence in data.sequences]
        drawn = [every[rng.integers(len(every))] for every in classes]
        return replace(data, sequences=np.array(drawn, dtype=data.sequences.dtype))
