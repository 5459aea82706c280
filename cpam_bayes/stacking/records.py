"""What is asked of the posterior over stacking sequences, and what is answered."""

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

# Share of the probability that a credible set holds.
CREDIBLE = 0.95
# A draw this much better than every sequence listed, nats, was overlooked: less is noise of its evidence.
OVERLOOKED = 0.3


@dataclass(frozen=True, slots=True)
class StackingSettings:
    """How the sequences are gone through.

    exhaustive : up to so many classes of sequences each evidence is computed. learning : of the surface.
    halvings : of the table's cells. unaccounted : probability that may be left out. fitted : most sequences
    whose constants are fitted one by one. polished : share of the probability of these whose evidence is then
    sampled; sampled : of so many at most; log2_sampled : with so many points. listed : most probable
    sequences whose evidence is computed with care. draws : sequences drawn to check and correct the rest.
    log2_points : of the importance sampling of these.
    """

    exhaustive: int = 1500
    learning: TrainingSettings = field(default_factory=TrainingSettings)
    halvings: int = 2
    unaccounted: float = 1e-3
    fitted: int = 20_000
    polished: float = 0.99
    sampled: int = 8_000
    log2_sampled: int = 7
    listed: int = 200
    draws: int = 500
    log2_points: int = 9

    def computes_each(self, n_sequences: int) -> bool:
        """Whether so many are few: no evidence is learned."""
        return n_sequences <= 2 * self.exhaustive


DEFAULT_SETTINGS = StackingSettings()


@dataclass(frozen=True, slots=True)
class SurrogateCheck:
    """How good the evidence is of sequences where it is not computed with care.

    training_size : sequences. rms, largest : error of the log evidence on draws from the posterior, on those
    that count, nats. overlooked : what the best of them is better by than every sequence listed, nats.
    correction : log of the factor on the sum of what was learned that the draws found. effective : share
    of the draws that count. fitted : sequences fitted one by one; sampled : classes of these whose
    evidence was sampled; surrogate_probability : of all sequences whose evidence is learned alone.
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
    """The posterior over the sequences of one specimen.

    enumerated : sequences on the grid. classes : distinct ones, symmetric images merged, ``None`` where they
    were not counted. log_evidence_total : log of their mean evidence. top : the most probable classes, each
    by its first member, (t, k) degrees, in descending order; same_bending : of each, the first members of all
    other classes with its bending stiffness, (a, k) grid indices; alike : those of them that the list does
    not tell from it, and that belong to it with their images; multiplicity : (t,) sequences in each;
    probability : (t,) of each single sequence; log_evidence, log_evidence_error : (t,).
    marginals : (k, n_grid) probability of every angle, ply by ply. credible_count : sequences in the smallest
    set that holds 95 %. effective_count : exp of the entropy. unaccounted : bound of what is left out.
    drawn : sequences drawn from the posterior with their conditional posteriors; draw_weight : (d,) what each
    counts. components : those of ``top``. check : ``None`` where every evidence was computed.
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
        """The same with a list of some of the classes."""
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
        first = [np.vstack(own) for own in zip(self.components.sequences, self.alike, strict=True)]
        own = canonical(np.concatenate(first), self.symmetries).representative
        place = {tuple(row): int(i) for i, row in zip(index, own.tolist(), strict=True)}
        asked = canonical(sequences, self.symmetries).representative
        return np.array([place.get(tuple(row), -1) for row in asked.tolist()], dtype=np.int64)


@dataclass(frozen=True, slots=True)
class StackingProblem:
    """The sequences of one specimen: their posteriors, symmetries and grid.

    sums : over the plies, ``None`` where the layup is not symmetric. starts : (2, n) of every climb.
    library : (p, n_constants) constants whose best two for a sequence are starts where climbs are to be
    thorough.
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

    @property
    def each_computed(self) -> bool:
        """Whether they are so few that no evidence is learned."""
        return self.settings.computes_each(self.n_sequences)


def random_members(problem: StackingProblem, data: Evaluated, rng: np.random.Generator) -> Evaluated:
    """Sequences replaced by members of their classes at random: all are equally probable."""
    found = data.sequences.copy()
    for i, sequence in enumerate(data.sequences):
        every = members(sequence, problem.symmetries)
        found[i] = every[rng.integers(len(every))]
    return replace(data, sequences=found)
