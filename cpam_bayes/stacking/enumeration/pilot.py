"""A pilot of the enumeration: the surrogate of every sequence, and sums over some of them."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.parallel import counted, run
from cpam_bayes.stacking.enumeration.best_first import (
    BIN,
    BINS_BEGIN,
    INNER,
    Enumeration,
    PartialSums,
    combined,
    enumerate_prefixes,
    prefixes_to_visit,
)
from cpam_bayes.stacking.enumeration.listing import surrogate_values
from cpam_bayes.stacking.features import PlySums, all_sequences
from cpam_bayes.stacking.records import StackingProblem
from cpam_bayes.stacking.surrogate.piecewise_linear import piecewise_linear_surrogate
from cpam_bayes.stacking.surrogate.training import TrainedSurrogate
from cpam_bayes.stacking.symmetry.classes import classes
from cpam_bayes.stacking.symmetry.symmetries import Symmetry

Array = NDArray[Any]

# Pieces that the prefixes are enumerated in.
_PIECES = 64
# Depth of the lower bound below the best to begin with, the most that it grows by while too much is left out,
# and the depth from which on it grows no more, nats.
_DEPTH, _DEEPER, _MAX_DEPTH = 17.0, 5.0, 35.0
# Prefixes of the pilot enumeration, which predicts what a lower bound leaves out and how long a list gets.
_PILOT_PREFIXES = 512
# Effective number of these, by their mass, from which on a trial on them alone shows the surrogate's error.
_ENOUGH_PREFIXES = 64.0
# Fraction of the mass that may be known from the surrogate alone where the list can be long enough.
_MAX_UNLISTED = 3e-3
# Fraction of what may be left out that the lower bound is chosen for: a pilot enumeration is rough.
MARGIN = 0.5
# Number of sequences up to which the surrogate is evaluated for each.
_MAX_EVALUATED = 3_000_000


@dataclass(frozen=True, slots=True)
class PilotEnumeration:
    """All sequences with the surrogate's log evidence, and the sums over some, which predict a list's length.

    sums : over a ``fraction`` of the sequences.
    """

    enumeration: Enumeration
    sums: PartialSums
    fraction: float

    def listing(self, problem: StackingProblem) -> Enumeration:
        """The enumeration with the threshold of what a problem's settings list."""
        threshold = self.enumeration.reference + BINS_BEGIN - BIN * self._listed_bins(problem)
        return replace(self.enumeration, threshold=threshold)

    def unlisted(self, problem: StackingProblem) -> float:
        """Fraction of the mass, by the surrogate, of sequences that a problem's settings do not list."""
        n = self._listed_bins(problem)
        return float(self.sums.weight[n:].sum() / self.sums.weight.sum())

    @property
    def is_representative(self) -> bool:
        """Whether the mass is spread over so many of the prefixes that these few stand for all."""
        mass = self.sums.mass
        return self.fraction < 1.0 and float(mass.sum() ** 2) >= _ENOUGH_PREFIXES * float(mass @ mass)

    def _listed_bins(self, problem: StackingProblem) -> int:
        """Number of bins of the log evidence that are listed: nearly all the mass, not too many sequences."""
        rest = 1.0 - np.cumsum(self.sums.weight) / self.sums.weight.sum()
        images = 1 if self.enumeration.negation is None else 2
        number = np.cumsum(self.sums.count) / self.fraction / images
        enough = int(np.argmax(rest <= _MAX_UNLISTED))
        return min(enough + 1, int(np.searchsorted(number, problem.settings.max_fitted, side="right")))


def acts_on_angles(problem: StackingProblem, symmetry: Symmetry) -> bool:
    """Whether a symmetry changes every angle in the same way and leaves the plies in their places."""
    return symmetry.everywhere and np.array_equal(symmetry.source, np.arange(problem.n_unknown))


def _negation(problem: StackingProblem) -> Array | None:
    """Grid index of minus every angle if all sequences have an equally probable mirror image."""
    for symmetry in problem.symmetries:
        if symmetry.name == "mirror image" and acts_on_angles(problem, symmetry):
            return np.asarray(symmetry.permutation)
    return None


def pilot_enumeration(
    problem: StackingProblem,
    sums: PlySums,
    trained: TrainedSurrogate,
    rng: np.random.Generator,
    notify: Callable[[str], None],
    margin: float = MARGIN,
) -> PilotEnumeration:
    """The surrogate's log evidence of each sequence.

    Up to a few million sequences it is evaluated for all. For more it is piecewise linear, with a lower bound
    so low that what it leaves out does not count: at most the fraction ``margin`` of what may be left out.
    """
    settings, surrogate = problem.settings, trained.surrogate
    negation, executor = _negation(problem), problem.executor
    if problem.n_sequences <= _MAX_EVALUATED:
        every = _every_value(problem, sums, trained)
        enumeration = Enumeration(None, sums, surrogate.top, negation, np.inf, every)
        return PilotEnumeration(enumeration, enumerated(enumeration, executor), 1.0)
    slack = float(np.clip(surrogate.largest_error, 0.2, 3.0))
    depth = _DEPTH
    while True:
        table = piecewise_linear_surrogate(
            surrogate.tangent,
            sums.rest_bound,
            surrogate.top,
            depth,
            settings.halvings,
            slack,
            surrogate.freedom,
            executor,
        )
        enumeration = Enumeration(table, sums, surrogate.top, negation, np.inf)
        visited = prefixes_to_visit(enumeration)
        pilot = np.sort(rng.choice(visited, size=min(_PILOT_PREFIXES, len(visited)), replace=False))
        some = enumerated(enumeration, executor, prefixes=pilot)
        left_out = some.left_out * np.exp(-depth)
        allowed = margin * settings.unaccounted * some.mass.sum()
        if left_out <= allowed or depth > _MAX_DEPTH:
            return PilotEnumeration(enumeration, some, len(pilot) / len(visited))
        del table, enumeration  # the next one takes as much memory
        depth += float(np.clip(np.log(left_out / max(allowed, 1e-300)), 1.0, _DEEPER))
        notify(f"the piecewise-linear surrogate reaches {depth:.0f} nats below the best")


def _every_value(problem: StackingProblem, sums: PlySums, trained: TrainedSurrogate) -> Array:
    """The surrogate's log evidence of every sequence, (choices of the first plies, choices of the others)."""
    g, k = len(problem.grid_deg), problem.n_unknown
    distinct = classes(all_sequences(g, k), problem.symmetries)
    features = sums.features(distinct.representative)
    values = surrogate_values(trained.surrogate, problem.executor, features)
    return values[distinct.label].reshape(-1, g ** min(k, INNER))


def enumerated(
    enumeration: Enumeration,
    executor: Executor | None,
    progress: Callable[[int, int], None] = lambda done, total: None,
    prefixes: Array | None = None,
) -> PartialSums:
    """The sums over all sequences, or over those of some prefixes, and the list of the best."""
    visited = prefixes_to_visit(enumeration) if prefixes is None else prefixes
    items = [part for part in np.array_split(visited, _PIECES) if len(part)]
    count = counted(progress, len(items))
    return combined(
        run(enumerate_prefixes, enumeration, items, executor, batch_size=1, on_result=count, is_limited=True)
    )
