"""The problem of unknown ply angles and the posterior over stacking sequences that solves it.

Different sequences may have the same bending stiffness, and so the same frequencies of a thin plate, though
no motion of the plate maps one onto the other: where two sets of plies have the same weight, exchanging
their angles leaves all four bending lamination parameters unchanged: [0/90/90/45/0/30]_s and
[90/0/0/45/90/30]_s, since 6^3 - 5^3 + 2^3 - 1^3 = 5^3 - 3^3. Transverse shear still distinguishes them, the
less the thinner the plate and the noisier the list; where it does not, they are merged.
"""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.plate import Specimen
from cpam_bayes.stacking.conditional import ConditionalPosterior
from cpam_bayes.stacking.evaluation import Evaluated
from cpam_bayes.stacking.symmetry import PlySums, Symmetry, all_choices, canonical, members
from cpam_bayes.stacking.training import TrainingSettings

Array = NDArray[Any]

# Probability of a credible set.
CREDIBLE = 0.95
# Nats above every listed sequence from which a draw counts as overlooked: less is noise of its evidence.
OVERLOOKED = 0.3
# Sums of cosines that differ by less are equal.
_EQUAL: Final = 1e-11
# Log Bayes factors, nats, below which sequences are indistinguishable: about the accuracy of evidences.
_INDISTINGUISHABLE_NATS: Final = 0.1
# One in so many draws of the constants is compared.
_BETWEEN: Final = 4
# Direction along which sums over the outer and the inner plies are sorted; any generic one.
_DIRECTION: Final = np.array([1.0, np.sqrt(2.0), np.sqrt(3.0), np.sqrt(5.0)])


@dataclass(frozen=True, slots=True)
class RoundSettings:
    """Stopping rules of the rounds of training, listing and checking, where there are many sequences.

    least_rounds, most_rounds : of a settled result, and of one that is astray.
    settled_nats, settled_errors : root mean square error on the draws that settles it, nats, or so many times
        that at the end of the training.
    astray_nats : error from which the result is astray.
    added_from_list : listed sequences that join the training set in a further round.
    unlisted : fraction of the mass that may be known from the surrogate alone where the list can be long
        enough.
    worth_listing : fraction of the mass that the longest list must hold; otherwise the list is short.
    fine_from : unlisted fraction from which the surrogate is trained to a finer error.
    margin : fraction of the allowed left-out mass for which the lower bound is chosen, as a pilot enumeration
        is rough.
    many : sequences above which a short list is tried first.
    short : sequences fitted in a short list.
    trial_listed, trial_draws : most probable sequences, and drawn ones, in that trial.
    """

    least_rounds: int = 2
    most_rounds: int = 4
    settled_nats: float = 0.2
    settled_errors: float = 1.5
    astray_nats: float = 0.5
    added_from_list: int = 400
    unlisted: float = 0.02
    worth_listing: float = 0.5
    fine_from: float = 0.05
    margin: float = 0.5
    many: int = 10_000_000
    short: int = 500
    trial_listed: int = 50
    trial_draws: int = 150


@dataclass(frozen=True, slots=True)
class StackingSettings:
    """Settings of the posterior over stacking sequences.

    exhaustive : number of classes of sequences up to which every evidence is computed.
    training, rounds : of the surrogate where there are more.
    halvings : of the cells of the piecewise-linear surrogate.
    unaccounted : probability that may be left out.
    max_fitted : most sequences whose constants are fitted one by one.
    sampled_fraction : fraction of the probability of these whose evidence is then sampled.
    max_sampled : most classes sampled.
    log2_sampled : log2 of the points of that importance sampling.
    listed : number of most probable classes, whose evidence is refined.
    draws : sequences drawn to check and to correct the rest.
    log2_points : log2 of the points of the importance sampling of refined and drawn sequences.
    """

    exhaustive: int = 1500
    training: TrainingSettings = field(default_factory=TrainingSettings)
    rounds: RoundSettings = field(default_factory=RoundSettings)
    halvings: int = 2
    unaccounted: float = 1e-3
    max_fitted: int = 20_000
    sampled_fraction: float = 0.98
    max_sampled: int = 5_000
    log2_sampled: int = 7
    listed: int = 200
    draws: int = 500
    log2_points: int = 9

    def enumerates(self, n_sequences: int) -> bool:
        """Whether there are few enough sequences for every evidence to be computed."""
        return n_sequences <= 2 * self.exhaustive


DEFAULT_SETTINGS = StackingSettings()


@dataclass(frozen=True, slots=True)
class SurrogateCheck:
    """Accuracy of unrefined evidences of sequences, on draws from the posterior.

    training_size : number of sequences on which the surrogate was trained.
    rms : root mean square error of the log evidence on the draws, nats.
    largest : largest error on those draws that count, nats.
    overlooked : excess of the best draw over every listed sequence, nats.
    correction : log of the factor on the sum of the surrogate, from the draws.
    effective : fraction of the draws that count.
    fitted : number of classes fitted one by one.
    sampled : number of these whose evidence was sampled.
    """

    training_size: int
    rms: float
    largest: float
    overlooked: float
    correction: float
    effective: float
    fitted: int
    sampled: int


@dataclass(frozen=True, slots=True)
class StackingPosterior:
    """The posterior over the stacking sequences of one specimen.

    A class holds sequences that no frequency distinguishes; it is represented by its first member.

    conditional : posterior of the constants for any sequence.
    enumerated : number of sequences on the grid.
    classes : number of distinct ones, symmetric images merged; ``None`` where they were not counted.
    log_evidence_total : log of the mean evidence of all sequences.
    top : (t, k) degrees, the most probable classes in descending order.
    same_bending : for each, (a, k) grid indices of all other classes with its bending stiffness.
    alike : those of them that the frequencies do not distinguish; they belong to it with their images.
    multiplicity : (t,) sequences in each class.
    probability : (t,) of each single sequence.
    log_evidence, log_evidence_error : (t,) nats.
    components : conditional posteriors of ``top``.
    marginals : (k, n_grid) probability of every angle, ply by ply.
    credible_count : number of sequences in the smallest set with 95 % probability.
    effective_count : exp of the entropy.
    unaccounted : bound of the probability left out.
    drawn : sequences drawn from the posterior, with their conditional posteriors.
    draw_weight : (d,) weight of each draw.
    check : ``None`` where every evidence was computed.
    basis_error : largest relative frequency error of the posterior's basis, from full solves.
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
    basis_error: float
    seconds: float

    def listing(self, rows: Array) -> StackingPosterior:
        """The posterior with only the classes ``rows`` on its list."""
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
        """All sequences of the listed class ``i`` as grid indices (multiplicity, k)."""
        first = np.vstack((self.components.sequences[i], self.alike[i]))
        return np.concatenate([members(s, self.symmetries) for s in first])

    def classes_of(self, sequences: Array) -> Array:
        """Index (m,) of the listed class of each sequence of grid indices (m, k), -1 if unlisted."""
        index = np.repeat(np.arange(len(self.top)), [1 + len(others) for others in self.alike])
        first = [np.vstack(pair) for pair in zip(self.components.sequences, self.alike, strict=True)]
        listed = canonical(np.concatenate(first), self.symmetries).representative
        position = {tuple(row): int(i) for i, row in zip(index, listed.tolist(), strict=True)}
        wanted = canonical(sequences, self.symmetries).representative
        return np.array([position.get(tuple(row), -1) for row in wanted.tolist()], dtype=np.int64)


@dataclass(frozen=True, slots=True)
class StackingProblem:
    """The stacking sequences of one specimen: their posteriors, symmetries and grid.

    sums : over the plies; ``None`` where the layup is not symmetric or of several kinds of plies.
    starts : (2, n) parameters from which every optimisation starts.
    library : (p, n_constants) constants of which the best two for a sequence are further starts.
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
        """Sequences replaced by random members of their classes, which are equally probable."""
        classes = [members(sequence, self.symmetries) for sequence in data.sequences]
        drawn = [every[rng.integers(len(every))] for every in classes]
        return replace(data, sequences=np.array(drawn, dtype=data.sequences.dtype))


def equal_bending(sums: PlySums, sequences: Array) -> tuple[Array, ...]:
    """All sequences of the grid with the bending lamination parameters of each of (m, k), itself included.

    The parameters are sums over outer and inner plies, tabulated for all choices of either.
    """
    k, g = sums.n_unknown, len(sums.grid_deg)
    inner = k - k // 2
    left, right = all_choices(sums.first[: k - inner]), all_choices(sums.first[k - inner :])
    order = np.argsort(right @ _DIRECTION, kind="stable")
    at = (right @ _DIRECTION)[order]
    equal = []
    for target in sums.features(sequences)[:, :4]:
        needed = (target - left) @ _DIRECTION
        begin, end = (np.searchsorted(at, needed + sign * len(_DIRECTION) * _EQUAL) for sign in (-1, 1))
        some = np.flatnonzero(end > begin)
        rows = np.repeat(some, (end - begin)[some])
        columns = order[np.concatenate([np.arange(begin[i], end[i]) for i in some])]
        same = np.all(np.abs(left[rows] + right[columns] - target) < _EQUAL, axis=1)
        whole = rows[same] * g**inner + columns[same]
        equal.append(np.column_stack(np.unravel_index(whole, (g,) * k)))
    return tuple(equal)


def merge_indistinguishable(
    answer: StackingPosterior, problem: StackingProblem, sums: PlySums
) -> StackingPosterior:
    """The posterior with classes of equal bending stiffness noted, and merged where indistinguishable.

    They are merged if the log of their Bayes factor E[p(f | x, s') / p(f | x, s)], over the posterior of the
    constants x of the first, is within ``_INDISTINGUISHABLE_NATS`` of zero.
    """
    sequences = answer.components.sequences
    classes = canonical(sequences, problem.symmetries).representative
    listed_row = {tuple(row): i for i, row in enumerate(classes.tolist())}
    same_bending, alike = list(answer.same_bending), list(answer.alike)
    probability, multiplicity = answer.probability.copy(), answer.multiplicity.copy()
    merged = np.zeros(len(sequences), dtype=bool)
    for i, same in enumerate(equal_bending(sums, sequences)):
        orbits = canonical(same, problem.symmetries)
        others, at = np.unique(orbits.representative, axis=0, return_index=True)
        new = np.any(others != classes[i], axis=1)
        if merged[i] or not new.any():
            continue
        same_bending[i], size = others[new], orbits.size[at][new]
        near = np.abs(_log_bayes_factors(answer, i, same_bending[i])) < _INDISTINGUISHABLE_NATS
        alike[i] = same_bending[i][near]
        rows = [listed_row[key] for key in map(tuple, alike[i].tolist()) if key in listed_row]
        rows = [i, *(row for row in rows if row > i and not merged[row])]
        merged[rows[1:]] = True
        probability[i] = np.average(answer.probability[rows], weights=answer.multiplicity[rows])
        multiplicity[i] += size[near].sum()
    kept = np.flatnonzero(~merged)
    kept = kept[np.lexsort((-answer.log_evidence[kept], -probability[kept]))]
    whole = replace(
        answer,
        same_bending=tuple(same_bending),
        alike=tuple(alike),
        probability=probability,
        multiplicity=multiplicity,
    )
    return whole.listing(kept)


def _log_bayes_factors(answer: StackingPosterior, i: int, others: Array) -> Array:
    """Log Bayes factors (m,) of others (m, k) against the listed class ``i``, from draws of its constants."""
    x = answer.components.conditionals.draws[i, ::_BETWEEN]
    angles = answer.grid_deg[np.vstack((answer.components.sequences[i], others))]
    rows = np.repeat(np.arange(len(angles)), len(x))
    log_p = (
        answer.conditional.at(angles, rows)
        .log_prob(np.tile(x, (len(angles), 1)))
        .reshape(len(angles), len(x))
    )
    return np.asarray(np.log(np.mean(np.exp(log_p[1:] - log_p[0]), axis=1)))
