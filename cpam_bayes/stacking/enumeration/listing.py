"""The sequences that can matter: fitted one by one, from optima nearby; those that carry the mass sampled."""

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
from cpam_bayes.stacking.symmetry.classes import canonical

Array = NDArray[Any]

# Share of the mass that the most sequences that may be sampled must hold; else a quarter of them shows what
# sampling changes.
_WORTH = 0.5
# An evidence this far below the learned one, nats, may be that of a lesser optimum, and one that is below by
# twice the root mean square error of what was learned.
_SUSPECT = 0.3
# Of every so many listed sequences one is fitted first, for the others to start from.
_SPARSE = 16
# Pieces that evaluations of the surrogate are shared out in.
_PIECES = 64


@dataclass(frozen=True, slots=True)
class ListedClasses:
    """The m classes that were fitted, in descending order of their log evidence as it is known.

    sequences : (m, k) their first members. size : (m,) sequences in each class, count : (m,) of them
    on the list. log_evidence : (m,). sampled : (m,) whether by sampling. around : where they lie. exact :
    those sampled. careful : the first of them, computed with care. class_of_row : (b,) which class each
    row of the enumerator's list is of.
    """

    sequences: Array
    size: Array
    count: Array
    log_evidence: Array
    sampled: Array
    around: Neighbours
    exact: Evaluated
    careful: Evaluated
    class_of_row: Array


def evaluate_listed(
    problem: StackingProblem,
    sums: PlySums,
    trained: TrainedSurrogate,
    totals: PartialSums,
    images: Array,
    notify: Callable[[str], None],
) -> ListedClasses:
    """Every listed class fitted, those that carry the mass sampled, the first ones with care."""
    settings = problem.settings
    orbits = canonical(totals.listed.astype(np.int64), problem.symmetries)
    g, k = len(problem.grid_deg), problem.n_unknown
    code = orbits.representative @ (g ** np.arange(k - 1, -1, -1, dtype=np.int64))
    _, first, class_of_row = np.unique(code, return_index=True, return_inverse=True)
    class_of_row = class_of_row.ravel()
    sequences, size = orbits.representative[first], orbits.size[first]
    count = np.bincount(class_of_row, totals.times)
    features = sums.features(sequences)
    lengths = trained.surrogate.smooth.lengths
    expected = surrogate_values(trained.surrogate, problem.executor, features)
    found = _located(problem, sums, trained, sequences, features, expected, images)
    order = np.argsort(-found.log_evidence, kind="stable")
    top = float(found.log_evidence.max())
    mass = np.cumsum(count[order] * np.exp(found.log_evidence[order] - top))
    rest = float(np.sum(totals.mass)) * np.exp(trained.surrogate.top - top)
    needed = int(np.searchsorted(mass, settings.polished * mass[-1])) + 1
    most = settings.sampled
    if needed > most and mass[most - 1] < _WORTH * (mass[-1] + rest):
        most = most // 4
    some = order[: min(max(needed, settings.listed), most)]
    notify(f"evidence of {len(some)} classes of sequences")
    around = neighbours(features, found.x, lengths, images)
    starts = around.starts(features[some], found.x[some])
    exact = evaluate(
        trained.focused, problem.grid_deg, sequences[some], starts, settings.log2_sampled, problem.executor
    )
    log_evidence = found.log_evidence.copy()
    if len(some) < len(order):  # what sampling changes is much the same for neighbours
        change = exact.log_evidence - log_evidence[some]
        other = order[len(some) :]
        near_sampled = neighbours(features[some], found.x[some], lengths, images)
        log_evidence[other] += near_sampled.mean(features[other], change)
    log_evidence[some] = exact.log_evidence
    sampled = np.zeros(len(order), dtype=bool)
    sampled[some] = True
    first_rows = np.argsort(-exact.log_evidence, kind="stable")[: settings.listed]
    leading = some[first_rows]
    careful = refined(problem, trained, around, sequences[leading], features[leading], found.x[leading])
    # few points miss the tails of a conditional posterior, of one as of the other
    log_evidence += np.median(careful.log_evidence - exact.log_evidence[first_rows])
    log_evidence[leading] = careful.log_evidence
    careful = careful[np.argsort(-careful.log_evidence, kind="stable")]
    order = np.argsort(-log_evidence, kind="stable")
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    return ListedClasses(
        sequences=sequences[order],
        size=size[order],
        count=count[order],
        log_evidence=log_evidence[order],
        sampled=sampled[order],
        around=around,
        exact=exact,
        careful=careful,
        class_of_row=place[class_of_row],
    )


def _located(
    problem: StackingProblem,
    sums: PlySums,
    trained: TrainedSurrogate,
    sequences: Array,
    features: Array,
    expected: Array,
    images: Array,
) -> Located:
    """Laplace's evidence of sequences (m, k): of a few from those learned from, of the others from these."""
    lengths = trained.surrogate.smooth.lengths
    learned_at = sums.features(trained.data.sequences)
    around = neighbours(learned_at, trained.data.fits.x, lengths, images)
    least = _least(trained, expected)
    m = len(sequences)
    log_evidence, x = np.empty(m), np.empty((m, trained.data.fits.x.shape[1]))
    every = np.arange(m)
    for rows in (every[::_SPARSE], np.delete(every, np.s_[::_SPARSE])):
        near = around.nearest(features[rows])
        found = locate(
            trained.focused,
            problem.grid_deg,
            sequences[rows],
            near,
            least[rows],
            problem.starts,
            problem.executor,
        )
        log_evidence[rows], x[rows] = found.log_evidence, found.x
        around = neighbours(
            np.concatenate((learned_at, features[rows])),
            np.concatenate((trained.data.fits.x, found.x)),
            lengths,
            images,
        )
    return Located(log_evidence, x)


def _least(trained: TrainedSurrogate, expected: Array) -> Array:
    """Laplace's evidence below which a climb may have met a lesser optimum; expected : learned, (m,)."""
    data = trained.data
    near = data.log_evidence > data.log_evidence.max() - NEAR
    laplace = np.median((data.fits.log_evidence - data.log_evidence)[near])
    return np.asarray(expected + laplace - max(_SUSPECT, 2.0 * trained.surrogate.rms_error))


def refined(
    problem: StackingProblem,
    trained: TrainedSurrogate,
    around: Neighbours,
    sequences: Array,
    features: Array,
    x: Array | None,
) -> Evaluated:
    """Sequences (m, k) climbed from optima nearby, the reference and the library, and sampled."""
    near = around.starts(features, x)
    common = np.broadcast_to(problem.starts[0], (len(sequences), 1, near.shape[2]))
    starts = np.concatenate((near, common), axis=1)
    return evaluate(
        trained.focused,
        problem.grid_deg,
        sequences,
        starts,
        problem.settings.log2_points,
        problem.executor,
        problem.library,
    )


def surrogate_values(surrogate: Surrogate, executor: Executor | None, features: Array) -> Array:
    """The learned log evidence at features (m, d), shared out, (m,)."""
    pieces = run(Surrogate.values, surrogate, np.array_split(features, _PIECES), executor, batch_size=1)
    return np.concatenate(pieces)
