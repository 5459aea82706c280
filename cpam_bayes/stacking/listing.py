"""The posterior over many stacking sequences in three parts: sampled, fitted, and summed by the surrogate.

All sequences on the grid are enumerated by their first plies, the prefix: for each prefix all choices of the
other plies at once. Those whose evidence, by the surrogate, can matter are listed and fitted one by one, and
the evidence of those that carry the mass is sampled. The rest is summed; sequences outside the surrogate's
cells are counted, and bounded by its lower bound.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.forward_model.reduced import basis_error
from cpam_bayes.parallel import run
from cpam_bayes.stacking.conditional import ConditionalPosterior
from cpam_bayes.stacking.evaluation import (
    NEAR,
    Evaluated,
    Located,
    Neighbours,
    evaluate,
    locate,
    merged,
    neighbours,
)
from cpam_bayes.stacking.records import CREDIBLE, StackingPosterior, StackingProblem, SurrogateCheck
from cpam_bayes.stacking.surrogate import PiecewiseLinearSurrogate, Surrogate
from cpam_bayes.stacking.symmetry import PlySums, all_choices, canonical, classes
from cpam_bayes.stacking.training import TrainedSurrogate

Array = NDArray[Any]

# Unknown angles behind a prefix, whose choices are taken together.
INNER = 3
# Largest rise of a prefix's best above the best of a sample, one in so many of its sequences, over the
# distance of the sample's best from the one whose rank is this number.
_UNSEEN = 1.0
# Width of a bin of log evidence, nats, and number of bins.
BIN, BINS = 0.002, 20_000
# Log evidence above the reference at which the bins begin, nats.
BINS_BEGIN = 5.0
# Fraction of the mass that the sampled classes must hold; where they hold less, twice the listed number are
# sampled, to show what sampling changes.
_MIN_SAMPLED_FRACTION = 0.5
# An evidence so many nats, and root mean square errors of the surrogate, below the surrogate's may be that of
# a lesser optimum.
_SUSPECT_NATS, _SUSPECT_ERRORS = 0.3, 2.0
# One in so many listed sequences is fitted first, as a start for the others.
_FITTED_FIRST = 16
# Pieces in which workers evaluate the surrogate.
_PIECES = 64
# Draws at which the posterior's basis is compared with full solves.
_BASIS_SETS = 24
# Fewest draws from a part that is not sampled.
_MIN_DRAWS = 64
# Least weight of a draw, in mean weights, whose error counts: for others the surrogate was far too high.
_MIN_WEIGHT = 1e-3


@dataclass(frozen=True, slots=True)
class Enumeration:
    """The log evidence of all sequences, and the threshold for listing them.

    table : log evidence on cells; ``None`` where ``every`` (n_prefixes, g^n_inner) holds that of each
    sequence.
    sums : over the plies.
    reference : log evidence that weights are relative to, about the largest.
    negation : (n_grid,) grid index of minus each angle where sequences and their mirror images are equally
    probable, else ``None``.
    threshold : sequences with this log evidence or more are listed one by one, the others are summed.
    share : one in so many choices of the last plies is evaluated, where none is near the threshold.
    mixed : (g^n_inner,) order in which the choices are distributed; ``None`` where all are evaluated.
    """

    table: PiecewiseLinearSurrogate | None
    sums: PlySums
    reference: float
    negation: Array | None
    threshold: float
    every: Array | None = None
    share: int = 1
    mixed: Array | None = None

    @property
    def n_inner(self) -> int:
        """Unknown angles behind a prefix."""
        return min(INNER, self.sums.n_unknown)

    @property
    def n_prefixes(self) -> int:
        """Number of prefixes."""
        return int(len(self.sums.grid_deg) ** (self.sums.n_unknown - self.n_inner))

    @property
    def lower_bound(self) -> float:
        """Log evidence that sequences outside the cells do not exceed."""
        return -np.inf if self.table is None else self.table.lower_bound


@dataclass(frozen=True, slots=True)
class PartialSums:
    """Sums over the sequences of some prefixes without those listed; weights exp(log evidence - reference).

    prefixes : (p,) their numbers.
    mass : (p,) weight of each, mirror images included.
    inner : (n_inner, n_grid) marginal weights of the last plies.
    count, weight : (BINS,) sequences and their weight by log evidence below ``reference + BINS_BEGIN``.
    entropy : sum of weight * (log evidence - reference).
    listed : (b, k) grid indices.
    log_evidence : (b,) of those listed.
    times : (b,) 2 for those that also stand for their mirror images, else 1.
    kept, left_out : number of sequences inside and outside the cells.
    """

    prefixes: Array
    mass: Array
    inner: Array
    count: Array
    weight: Array
    entropy: float
    listed: Array
    log_evidence: Array
    times: Array
    kept: int
    left_out: int


def place_values(base: int, digits: int) -> Array:
    """Place values (digits,) of the digits of a number, the largest first."""
    return np.asarray(base ** np.arange(digits - 1, -1, -1, dtype=np.int64))


def prefixes_to_visit(enumeration: Enumeration) -> Array:
    """Numbers of the prefixes that stand for all: of two mirror images the first."""
    every = np.arange(enumeration.n_prefixes)
    return every[every <= _mirror_images(enumeration, every)]


def enumerate_prefixes(enumeration: Enumeration, prefixes: Array) -> PartialSums:
    """Sums over all sequences that begin with some prefixes (p,), or over a sample of each.

    If one of the sample is near the threshold, all sequences of the prefix are evaluated.
    """
    g, n_inner, k = len(enumeration.sums.grid_deg), enumeration.n_inner, enumeration.sums.n_unknown
    times = np.ones(len(prefixes), dtype=np.int64)
    if enumeration.negation is not None and enumeration.n_prefixes > 1:
        times = np.where(_mirror_images(enumeration, prefixes) == prefixes, 1, 2)
    mass, inner = np.zeros(len(prefixes)), np.zeros(g**n_inner)
    count, weight = np.zeros(BINS, dtype=np.int64), np.zeros(BINS)
    kept, entropy = 0, 0.0
    listed: list[Array] = [np.empty((0, k), dtype=np.int16)]
    values: list[Array] = [np.empty(0)]
    times_listed: list[Array] = [np.empty(0, dtype=np.int64)]
    for p, (digits, rows, log_evidence, share) in enumerate(_looked_at(enumeration, prefixes)):
        kept += int(times[p]) * share * len(rows)
        high = log_evidence >= enumeration.threshold
        if share == 1 and high.any():
            listed.append(_sequences(g, n_inner, digits, rows[high]).astype(np.int16))
            values.append(log_evidence[high])
            times_listed.append(np.full(len(values[-1]), times[p]))
            rows, log_evidence = rows[~high], log_evidence[~high]
        relative = log_evidence - enumeration.reference
        w = np.exp(relative)
        number = int(times[p]) * share
        mass[p] = number * w.sum()
        inner[rows] += number * w
        entropy += float(number * (w @ relative))
        bins = np.clip(((BINS_BEGIN - relative) / BIN).astype(np.int64), 0, BINS - 1)
        count += number * np.bincount(bins, minlength=BINS)
        weight += number * np.bincount(bins, w, minlength=BINS)
    marginal = inner.reshape((g,) * n_inner)
    by_ply = np.stack([marginal.sum(axis=tuple(i for i in range(n_inner) if i != j)) for j in range(n_inner)])
    return PartialSums(
        prefixes=prefixes,
        mass=mass,
        inner=by_ply,
        count=count,
        weight=weight,
        entropy=entropy,
        listed=np.concatenate(listed),
        log_evidence=np.concatenate(values),
        times=np.concatenate(times_listed),
        kept=kept,
        left_out=max(int(times.sum()) * g**n_inner - kept, 0),
    )


def combined(parts: Sequence[PartialSums]) -> PartialSums:
    """Sums and lists of several parts combined."""
    joined: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in ("prefixes", "mass", "listed", "log_evidence", "times")
    }
    added: dict[str, Any] = {
        name: sum(getattr(part, name) for part in parts)
        for name in ("inner", "count", "weight", "entropy", "kept", "left_out")
    }
    return PartialSums(**joined, **added)


def values_of_prefix(enumeration: Enumeration, prefix: int) -> tuple[Array, Array]:
    """Unlisted sequences (m, k) of one prefix, and their log evidence (m,)."""
    digits, rows, log_evidence = next(_values(enumeration, np.array([prefix])))
    low = log_evidence < enumeration.threshold
    sequences = _sequences(len(enumeration.sums.grid_deg), enumeration.n_inner, digits, rows[low])
    return sequences, log_evidence[low]


Values = tuple[Array, Array, Array]
"""Grid indices of a prefix, the inner choices inside cells (m,) and their log evidence (m,)."""


def _looked_at(enumeration: Enumeration, prefixes: Array) -> Iterator[tuple[*Values, int]]:
    """The values of each prefix, and the number of choices that each value stands for."""
    share, threshold = enumeration.share, enumeration.threshold
    for prefix, values in zip(prefixes, _values(enumeration, prefixes, share), strict=True):
        if share > 1 and np.isfinite(threshold) and _may_reach(values[2], share) >= threshold:
            yield *next(_values(enumeration, prefix[None])), 1
        else:
            yield *values, share


def _may_reach(log_evidence: Array, share: int) -> float:
    """Largest log evidence that a prefix may have, of which these (m,) are one in ``share``."""
    if len(log_evidence) <= share:
        return float("inf") if len(log_evidence) else -float("inf")
    first = np.partition(log_evidence, -share)[-share:]
    return float(first.max() + _UNSEEN * (first.max() - first.min()))


def _values(enumeration: Enumeration, prefixes: Array, share: int = 1) -> Iterator[Values]:
    """The values of each prefix, for one in ``share`` inner choices, which differ from prefix to prefix."""
    table, n_outer = enumeration.table, enumeration.sums.n_unknown - enumeration.n_inner
    digits = _prefix_digits(enumeration, prefixes)
    if table is None:
        assert enumeration.every is not None
        inner = np.arange(enumeration.every.shape[1])
        yield from ((digits[p], inner, enumeration.every[prefix]) for p, prefix in enumerate(prefixes))
        return
    both = enumeration.sums.both
    total = all_choices(both[n_outer:]).astype(np.float32)
    mixed = np.arange(len(total)) if enumeration.mixed is None else enumeration.mixed
    parts = []
    for i in range(share):
        choices = np.sort(mixed[i::share])
        of_part = total[choices]
        sums = np.column_stack((np.ones_like(of_part[:, 0]), of_part))
        parts.append((choices, np.ascontiguousarray(of_part[:, :4].T), sums))
    outer = np.zeros((len(digits), 1 + both.shape[2]))
    for j in range(n_outer):
        outer[:, 1:] += both[j][digits[:, j]]
    for p, prefix in enumerate(prefixes):
        choices, v, sums = parts[prefix % share]
        leaf = table.rows(v, outer[p, 1:5])
        inside = np.flatnonzero(leaf >= 0)
        value = table.values(leaf[inside], sums[inside] + outer[p].astype(np.float32))
        yield digits[p], choices[inside], value


def _prefix_digits(enumeration: Enumeration, prefixes: Array) -> Array:
    """Grid indices (p, k - n_inner) of prefixes by number."""
    g = len(enumeration.sums.grid_deg)
    return np.asarray(
        prefixes[:, None] // place_values(g, enumeration.sums.n_unknown - enumeration.n_inner) % g
    )


def _mirror_images(enumeration: Enumeration, prefixes: Array) -> Array:
    """Numbers (p,) of the mirror images of prefixes (p,), or of themselves where images are not equal."""
    if enumeration.negation is None:
        return prefixes
    digits = _prefix_digits(enumeration, prefixes)
    place = place_values(len(enumeration.sums.grid_deg), digits.shape[1])
    return np.asarray(enumeration.negation[digits] @ place)


def _sequences(n_grid: int, n_inner: int, outer: Array, rows: Array) -> Array:
    """Grid indices (m, k) of the inner choices ``rows`` (m,) of one prefix."""
    inner = rows[:, None] // place_values(n_grid, n_inner) % n_grid
    return np.column_stack((np.tile(outer, (len(rows), 1)), inner))


@dataclass(frozen=True, slots=True)
class ListedClasses:
    """The m classes that were fitted, in descending order of their best known log evidence.

    sequences : (m, k) their first members.
    size : (m,) sequences in each class.
    count : (m,) sequences of each class on the list.
    log_evidence : (m,) nats.
    sampled : (m,) True where it is by sampling.
    around : tree of their features.
    evaluated : the classes that were sampled.
    refined : the first of them, with refined evidence.
    class_of_row : (b,) class of each row of the enumeration's list.
    """

    sequences: Array
    size: Array
    count: Array
    log_evidence: Array
    sampled: Array
    around: Neighbours
    evaluated: Evaluated
    refined: Evaluated
    class_of_row: Array


def evaluate_listed(
    problem: StackingProblem,
    sums: PlySums,
    trained: TrainedSurrogate,
    totals: PartialSums,
    images: Array,
    notify: Callable[[str], None],
) -> ListedClasses:
    """Fit every listed class, sample those that carry the mass, and refine the most probable ones."""
    settings, top = problem.settings, trained.surrogate.top
    distinct = classes(totals.listed.astype(np.int64), problem.symmetries)
    sequences, label = distinct.representative, distinct.label
    count = np.bincount(label, totals.times)
    features = sums.features(sequences)
    lengths = trained.surrogate.process.lengths
    expected = surrogate_values(trained.surrogate, problem.executor, features)
    fits = _fitted(problem, sums, trained, sequences, features, expected, images)
    order = np.argsort(-fits.log_evidence, kind="stable")
    some = order[: _number_to_sample(problem, fits, order, count, float(np.sum(totals.mass)), top)]
    notify(f"evidence of {len(some)} classes of sequences")
    around = neighbours(features, fits.x, lengths, images)
    starts = around.starts(features[some], fits.x[some])
    evaluated = evaluate(
        trained.focused, problem.grid_deg, sequences[some], starts, settings.log2_sampled, problem.executor
    )
    log_evidence = fits.log_evidence.copy()
    if len(some) < len(order):  # what sampling changes is much the same for neighbours
        change = evaluated.log_evidence - log_evidence[some]
        other = order[len(some) :]
        near_sampled = neighbours(features[some], fits.x[some], lengths, images)
        log_evidence[other] += near_sampled.mean(features[other], change)
    log_evidence[some] = evaluated.log_evidence
    sampled = np.zeros(len(order), dtype=bool)
    sampled[some] = True
    best = np.argsort(-evaluated.log_evidence, kind="stable")[: settings.listed]
    leading = some[best]
    refined_best = refined(problem, trained, around, sequences[leading], features[leading], fits.x[leading])
    # few points miss the tails of a conditional posterior, for all sequences alike
    log_evidence += np.median(refined_best.log_evidence - evaluated.log_evidence[best])
    log_evidence[leading] = refined_best.log_evidence
    order = np.argsort(-log_evidence, kind="stable")
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    return ListedClasses(
        sequences=sequences[order],
        size=distinct.size[order],
        count=count[order],
        log_evidence=log_evidence[order],
        sampled=sampled[order],
        around=around,
        evaluated=evaluated,
        refined=refined_best[np.argsort(-refined_best.log_evidence, kind="stable")],
        class_of_row=rank[label],
    )


def _number_to_sample(
    problem: StackingProblem, fits: Located, order: Array, count: Array, unlisted: float, reference: float
) -> int:
    """Number of the classes in ``order`` that are sampled; unlisted : mass of the others, exp(-reference)."""
    settings = problem.settings
    top = float(fits.log_evidence.max())
    mass = np.cumsum(count[order] * np.exp(fits.log_evidence[order] - top))
    needed = int(np.searchsorted(mass, settings.sampled_fraction * mass[-1])) + 1
    most, total = settings.max_sampled, mass[-1] + unlisted * np.exp(reference - top)
    if mass[min(needed, most) - 1] < _MIN_SAMPLED_FRACTION * total:
        most = 2 * settings.listed
    return min(max(needed, settings.listed), most)


def _fitted(
    problem: StackingProblem,
    sums: PlySums,
    trained: TrainedSurrogate,
    sequences: Array,
    features: Array,
    expected: Array,
    images: Array,
) -> Located:
    """Laplace's evidence of sequences (m, k), started from optima of the training set and of each other.

    expected : (m,) the surrogate's log evidence.
    """
    lengths = trained.surrogate.process.lengths
    data, focused = trained.data, trained.focused
    training_features = sums.features(data.sequences)
    around = neighbours(training_features, data.fits.x, lengths, images)
    # below this a lesser optimum may have been found
    high = data.log_evidence > data.log_evidence.max() - NEAR
    laplace = np.median((data.fits.log_evidence - data.log_evidence)[high])
    least = expected + laplace - max(_SUSPECT_NATS, _SUSPECT_ERRORS * trained.surrogate.rms_error)
    m = len(sequences)
    log_evidence, x = np.empty(m), np.empty((m, data.fits.x.shape[1]))
    every = np.arange(m)
    for rows in (every[::_FITTED_FIRST], np.delete(every, np.s_[::_FITTED_FIRST])):
        starts = around.nearest(features[rows])
        fits = locate(
            focused, problem.grid_deg, sequences[rows], starts, least[rows], problem.starts, problem.executor
        )
        log_evidence[rows], x[rows] = fits.log_evidence, fits.x
        around = neighbours(
            np.concatenate((training_features, features[rows])),
            np.concatenate((data.fits.x, fits.x)),
            lengths,
            images,
        )
    return Located(log_evidence, x)


def refined(
    problem: StackingProblem,
    trained: TrainedSurrogate,
    around: Neighbours,
    sequences: Array,
    features: Array,
    x: Array | None,
) -> Evaluated:
    """Sequences (m, k) sampled after optimisation from nearby optima, the reference and the library."""
    near = around.starts(features, x)
    common = np.broadcast_to(problem.starts[0], (len(sequences), 1, near.shape[2]))
    return evaluate(
        trained.focused,
        problem.grid_deg,
        sequences,
        np.concatenate((near, common), axis=1),
        problem.settings.log2_points,
        problem.executor,
        problem.library,
    )


def surrogate_values(surrogate: Surrogate, executor: Executor | None, features: Array) -> Array:
    """The surrogate's log evidence (m,) at features (m, d), computed in parallel."""
    pieces = run(
        Surrogate.values,
        surrogate,
        np.array_split(features, _PIECES),
        executor,
        batch_size=1,
        is_limited=True,
    )
    return np.concatenate(pieces)


@dataclass(frozen=True, slots=True)
class DrawnPart:
    """Draws from one part of the sequences, with refined evidence.

    mass : weight of the part before correction.
    data : the draws.
    error : (d,) refined log evidence minus the one they were drawn by, nats.
    """

    mass: float
    data: Evaluated
    error: Array

    @property
    def correction(self) -> float:
        """Log of the correction factor of the part's mass."""
        return float(np.log(np.mean(np.exp(self.error - self.error.max()))) + self.error.max())


def draw_parts(
    problem: StackingProblem,
    sums: PlySums,
    trained: TrainedSurrogate,
    enumeration: Enumeration,
    totals: PartialSums,
    listed: ListedClasses,
    rng: np.random.Generator,
) -> tuple[DrawnPart | None, ...]:
    """Draws from the sampled classes, from those only fitted, and from all unlisted sequences."""
    weight = listed.count * np.exp(listed.log_evidence - enumeration.reference)
    rows = (np.flatnonzero(listed.sampled), np.flatnonzero(~listed.sampled))
    masses = (*(float(weight[r].sum()) for r in rows), float(totals.mass.sum()))
    draws = problem.settings.draws
    parts: list[DrawnPart | None] = []
    for i, mass in enumerate(masses):
        if mass <= 0.0:
            parts.append(None)
            continue
        n = max(round(draws * mass / sum(masses)), min(_MIN_DRAWS, draws))
        if i < len(rows):
            pick = rows[i][rng.choice(len(rows[i]), size=n, p=weight[rows[i]] / mass)]
            sequences, value = listed.sequences[pick], listed.log_evidence[pick]
        else:
            sequences, value = _unlisted(enumeration, totals, n, rng)
        distinct, index = np.unique(sequences, axis=0, return_inverse=True)
        features = sums.features(distinct)
        data = refined(problem, trained, listed.around, distinct, features, None)[index.ravel()]
        parts.append(DrawnPart(mass, data, data.log_evidence - value))
    return tuple(parts)


def _unlisted(
    enumeration: Enumeration, totals: PartialSums, n: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Draws (n, k) from the unlisted sequences, and the surrogate's log evidence (n,) of them."""
    prefix = rng.choice(len(totals.mass), size=n, p=totals.mass / totals.mass.sum())
    sequences = np.empty((n, enumeration.sums.n_unknown), dtype=np.int64)
    value = np.empty(n)
    for p in np.unique(prefix):
        rows = np.flatnonzero(prefix == p)
        candidates, log_evidence = values_of_prefix(enumeration, int(totals.prefixes[p]))
        weight = np.exp(log_evidence - log_evidence.max())
        pick = rng.choice(len(candidates), size=len(rows), p=weight / weight.sum())
        sequences[rows], value[rows] = candidates[pick], log_evidence[pick]
    return sequences, value


def combined_posterior(
    problem: StackingProblem,
    trained: TrainedSurrogate,
    enumeration: Enumeration,
    totals: PartialSums,
    listed: ListedClasses,
    parts: tuple[DrawnPart | None, ...],
    rng: np.random.Generator,
) -> StackingPosterior:
    """Posterior of all parts together, unsampled ones corrected by their draws."""
    fitted, rest = (0.0 if part is None else part.correction for part in parts[1:])
    relative = listed.log_evidence + np.where(listed.sampled, 0.0, fitted) - enumeration.reference
    weight = np.exp(relative)
    rest_mass = float(np.exp(rest) * totals.mass.sum())
    total = float(listed.count @ weight) + rest_mass
    log_total = float(np.log(total)) + enumeration.reference
    entropy = float((listed.count * weight) @ relative) + np.exp(rest) * (
        totals.entropy + rest * totals.mass.sum()
    )
    left_out = totals.left_out * np.exp(enumeration.lower_bound - enumeration.reference)
    drawn_parts = [part for part in parts if part is not None]
    # sampled classes keep the evidence they were drawn by: a refined one differs by the noise of both
    weights = [
        np.exp(part.error) if part is not parts[0] else np.ones(len(part.error)) for part in drawn_parts
    ]
    fractions = [part.mass / total * (w / len(w)) for part, w in zip(drawn_parts, weights, strict=True)]
    draw_weight = np.concatenate(fractions)
    draw_weight = draw_weight / draw_weight.sum()
    drawn = drawn_parts[0].data
    for part in drawn_parts[1:]:
        drawn = merged(drawn, part.data)
    error = np.concatenate([part.error for part in drawn_parts])
    top = listed.refined[np.arange(min(problem.settings.listed, len(listed.refined.sequences)))]
    none = top.sequences[:0]
    return StackingPosterior(
        specimen=problem.specimen,
        conditional=problem.conditional,
        symmetries=problem.symmetries,
        grid_deg=problem.grid_deg,
        enumerated=problem.n_sequences,
        classes=None,
        log_evidence_total=log_total - float(np.log(problem.n_sequences)),
        top=problem.grid_deg[top.sequences],
        same_bending=(none,) * len(top.sequences),
        alike=(none,) * len(top.sequences),
        multiplicity=canonical(top.sequences, problem.symmetries).size,
        probability=np.exp(top.log_evidence - log_total),
        log_evidence=top.log_evidence,
        log_evidence_error=top.conditionals.error,
        components=top,
        marginals=_marginals(enumeration, totals, listed, weight, float(np.exp(rest))),
        credible_count=_credible_count(totals, listed, weight, rest, total),
        effective_count=float(np.exp(np.log(total) - entropy / total)),
        unaccounted=float(left_out / (left_out + total)),
        drawn=problem.random_members(drawn, rng),
        draw_weight=draw_weight,
        check=SurrogateCheck(
            training_size=len(trained.data.sequences),
            rms=float(np.sqrt(np.sum(draw_weight * error**2))),
            largest=float(np.abs(error[draw_weight > _MIN_WEIGHT * draw_weight.mean()]).max()),
            overlooked=max(0.0, float(drawn.log_evidence.max() - listed.refined.log_evidence[0])),
            correction=rest,
            effective=float(1.0 / np.sum(draw_weight**2) / len(draw_weight)),
            fitted=len(listed.size),
            sampled=int(listed.sampled.sum()),
        ),
        basis_error=basis_error_at(
            trained.focused, problem.grid_deg, drawn, rng.permutation(len(drawn.sequences))
        ),
        seconds=0.0,
    )


def basis_error_at(focused: ConditionalPosterior, grid_deg: Array, drawn: Evaluated, rows: Array) -> float:
    """Largest relative frequency error of the posterior's basis, from full solves at draws."""
    rows = rows[:_BASIS_SETS]
    x = drawn.conditionals.draws[rows, 0, : focused.n_constants]
    return float(basis_error(focused.model, np.column_stack((grid_deg[drawn.sequences[rows]], x))).max())


def _credible_count(
    totals: PartialSums, listed: ListedClasses, weight: Array, correction: float, total: float
) -> int:
    """Number of sequences in the smallest set with 95 % probability, the last group in proportion."""
    value = np.exp(BINS_BEGIN - BIN * (np.arange(BINS) + 0.5) + correction)
    each = np.concatenate((weight, value))
    count = np.concatenate((listed.count, totals.count)).astype(float)
    mass = np.concatenate((listed.count * weight, np.exp(correction) * totals.weight))
    order = np.argsort(-each, kind="stable")
    cumulative = np.cumsum(mass[order])
    last = int(np.searchsorted(cumulative, CREDIBLE * total))
    before = float(count[order[:last]].sum())
    missing = CREDIBLE * total - (cumulative[last - 1] if last else 0.0)
    fraction = missing / max(float(mass[order[last]]), 1e-300)
    return int(np.ceil(before + fraction * count[order[last]] - 1e-9))


def _marginals(
    enumeration: Enumeration, totals: PartialSums, listed: ListedClasses, weight: Array, factor: float
) -> Array:
    """Probability (k, n_grid) of every angle, ply by ply."""
    g, n_outer = len(enumeration.sums.grid_deg), enumeration.sums.n_unknown - enumeration.n_inner
    outer = [
        np.bincount(totals.prefixes // p % g, totals.mass, minlength=g) for p in place_values(g, n_outer)
    ]
    summed = factor * np.concatenate((np.reshape(outer, (n_outer, g)), totals.inner))
    row_weight = totals.times * weight[listed.class_of_row]
    mass = summed + np.stack([np.bincount(column, row_weight, minlength=g) for column in totals.listed.T])
    if enumeration.negation is not None:
        mass = 0.5 * (mass + mass[:, enumeration.negation])
    return np.asarray(mass / mass.sum(axis=1, keepdims=True))
