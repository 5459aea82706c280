"""The stacking sequences listed one by one: fitted from optima nearby, those that carry the mass sampled."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.parallel import run
from cpam_bayes.stacking.conditional.bases import NEAR
from cpam_bayes.stacking.conditional.evaluation import (
    Evaluated,
    Located,
    Neighbours,
    evaluate,
    locate,
    neighbours,
)
from cpam_bayes.stacking.enumeration.best_first import PartialSums
from cpam_bayes.stacking.features import PlySums
from cpam_bayes.stacking.records import StackingProblem
from cpam_bayes.stacking.surrogate.surrogate import Surrogate
from cpam_bayes.stacking.surrogate.training import TrainedSurrogate
from cpam_bayes.stacking.symmetry.classes import classes

Array = NDArray[Any]

# Fraction of the mass that the largest number of classes to sample must hold; where it holds less, a quarter
# of them shows what sampling changes.
_MIN_SAMPLED_FRACTION = 0.5
# Nats, and root mean square errors of the surrogate, below it from which on an evidence may be that of a
# lesser optimum.
_SUSPECT_NATS, _SUSPECT_ERRORS = 0.3, 2.0
# Of every so many listed sequences one is fitted first, for the others to start from.
_FITTED_FIRST = 16
# Pieces that a worker evaluates the surrogate for.
_PIECES = 64


@dataclass(frozen=True, slots=True)
class ListedClasses:
    """The m classes that were fitted, in descending order of their log evidence as far as it is known.

    sequences : (m, k) their first members.
    size : (m,) sequences in each class.
    count : (m,) sequences of each class on the list.
    log_evidence : (m,) nats.
    sampled : (m,) whether by sampling.
    around : tree of their features.
    evaluated : the classes that were sampled.
    refined : the first of them, their evidence refined.
    class_of_row : (b,) which class each row of the enumeration's list is of.
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
    """Every listed class fitted, those that carry the mass sampled, the most probable ones refined."""
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
    # few points miss the tails of a conditional posterior, of all sequences alike
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
    """How many of the classes in ``order`` are sampled; unlisted : mass of the others, exp(-reference)."""
    settings = problem.settings
    top = float(fits.log_evidence.max())
    mass = np.cumsum(count[order] * np.exp(fits.log_evidence[order] - top))
    needed = int(np.searchsorted(mass, settings.sampled_fraction * mass[-1])) + 1
    most, total = settings.max_sampled, mass[-1] + unlisted * np.exp(reference - top)
    if needed > most and mass[most - 1] < _MIN_SAMPLED_FRACTION * total:
        most = most // 4
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
    """Laplace's evidence of sequences (m, k), from optima of the training set and then of one another.

    expected : (m,) the surrogate's log evidence.
    """
    lengths = trained.surrogate.process.lengths
    data, focused = trained.data, trained.focused
    training_features = sums.features(data.sequences)
    around = neighbours(training_features, data.fits.x, lengths, images)
    # below this a lesser optimum may have been met
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
    """Sequences (m, k) optimised from optima nearby, the reference and the library, and sampled."""
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
    """The surrogate's log evidence at features (m, d), in parallel, (m,)."""
    pieces = run(
        Surrogate.values,
        surrogate,
        np.array_split(features, _PIECES),
        executor,
        batch_size=1,
        is_limited=True,
    )
    return np.concatenate(pieces)
