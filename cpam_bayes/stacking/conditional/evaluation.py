"""Evidence of stacks of sequences, shared out: Laplace's for many, sampled for those that count."""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from cpam_bayes.parallel import run
from cpam_bayes.stacking.conditional.importance import Conditionals, importance_evidence
from cpam_bayes.stacking.conditional.posterior import (
    ConditionalFits,
    ConditionalPosterior,
    fit_conditionals,
    joined,
)
from cpam_bayes.stacking.conditional.starts import scanned_starts

Array = NDArray[Any]

# Sequences that a worker takes at a time: where all is computed, and where only optima are located.
_BATCH, _LOCATED = 32, 512
# Optimisations that only locate an optimum end where a step promises less than this, nats.
_NEARLY = 3e-3
# Members of a library that an optimisation starts from.
_SCANNED = 2
# Neighbours among which the second start is looked for.
_NEIGHBOURS = 8


@dataclass(frozen=True, slots=True)
class Evaluated:
    """Sequences of grid indices (m, k) with their fits and conditional posteriors."""

    sequences: Array
    fits: ConditionalFits
    conditionals: Conditionals

    @property
    def log_evidence(self) -> Array:
        """Log evidence by importance sampling, (m,)."""
        return self.conditionals.log_evidence

    def __getitem__(self, rows: Any) -> Evaluated:
        """Some of the sequences."""
        return Evaluated(self.sequences[rows], self.fits[rows], self.conditionals[rows])


def evaluate(
    conditional: ConditionalPosterior,
    grid_deg: Array,
    sequences: Array,
    starts: Array,
    log2_points: int,
    executor: Executor | None,
    library: Array | None = None,
    *,
    scanned: int = _SCANNED,
) -> Evaluated:
    """Log evidence of sequences (m, k) by importance sampling, optimised from starts (m, s, n) or (s, n).

    library : (p, n_constants) constants, of which the ``scanned`` best ones of each sequence are starts as
    well.
    """
    angles = grid_deg[sequences]
    starts = np.broadcast_to(starts, (len(sequences), *starts.shape[-2:]))
    items = [
        (angles[i : i + _BATCH], starts[i : i + _BATCH], library, scanned, log2_points)
        for i in range(0, len(sequences), _BATCH)
    ]
    pieces = run(_evaluate_batch, conditional, items, executor, batch_size=1, is_limited=True)
    return Evaluated(sequences, joined([p[0] for p in pieces]), joined([p[1] for p in pieces]))


def _evaluate_batch(
    conditional: ConditionalPosterior, item: tuple[Array, Array, Array | None, int, int]
) -> tuple[ConditionalFits, Conditionals]:
    angles, starts, library, scanned, log2_points = item
    if library is not None:
        starts = np.concatenate((starts, scanned_starts(conditional, angles, library, scanned)), axis=1)
    fits = fit_conditionals(conditional, angles, starts)
    return fits, importance_evidence(conditional, angles, fits, log2_points)


def merged(a: Evaluated, b: Evaluated) -> Evaluated:
    """Both, one after the other."""
    return Evaluated(
        np.concatenate((a.sequences, b.sequences)),
        joined([a.fits, b.fits]),
        joined([a.conditionals, b.conditionals]),
    )


def with_optima(data: Evaluated, n: int) -> Evaluated:
    """The same with the n optima of each sequence that count most."""
    fits = data.fits
    best = np.argsort(-fits.weight, axis=1, kind="stable")[:, :n]
    row = np.arange(len(best))[:, None]
    kept = replace(
        fits,
        optima=fits.optima[row, best],
        weight=fits.weight[row, best],
        curvature=fits.curvature[row, best],
    )
    return replace(data, fits=kept)


@dataclass(frozen=True, slots=True)
class Located:
    """Laplace's log evidence of m sequences (m,) and the parameters at their best optima (m, n)."""

    log_evidence: Array
    x: Array


def locate(
    conditional: ConditionalPosterior,
    grid_deg: Array,
    sequences: Array,
    near: Array,
    least: Array,
    starts: Array,
    executor: Executor | None,
) -> Located:
    """Laplace's evidence of sequences (m, k), each optimised from one start next to its optimum.

    near : (m, n) parameters, the optima of neighbours. Those that end below the ``least`` log evidence (m,)
    are optimised again from the common ``starts`` (s, n).
    """
    angles = grid_deg[sequences]
    items = [
        (angles[i : i + _LOCATED], near[i : i + _LOCATED], least[i : i + _LOCATED], starts)
        for i in range(0, len(sequences), _LOCATED)
    ]
    if not items:
        return Located(np.empty(0), np.empty((0, near.shape[1])))
    pieces = run(_locate_batch, conditional, items, executor, batch_size=1, is_limited=True)
    return Located(np.concatenate([p.log_evidence for p in pieces]), np.concatenate([p.x for p in pieces]))


def _locate_batch(conditional: ConditionalPosterior, item: tuple[Array, Array, Array, Array]) -> Located:
    angles, near, least, starts = item
    fits = fit_conditionals(conditional, angles, near[:, None, :], _NEARLY)
    log_evidence, x = fits.log_evidence.copy(), fits.x.copy()
    low = np.flatnonzero(log_evidence < least)
    if len(low):
        again = fit_conditionals(conditional, angles[low], starts, _NEARLY)
        better = again.log_evidence > log_evidence[low]
        log_evidence[low[better]], x[low[better]] = again.log_evidence[better], again.x[better]
    return Located(log_evidence, x)


@dataclass(frozen=True, slots=True)
class Neighbours:
    """Where evaluated sequences lie among all: a tree over their features and all images of these.

    tree : over points in units of ``lengths`` (d,).
    owner : which sequence a point belongs to.
    x : (m, n) optima of the sequences.
    """

    tree: cKDTree
    lengths: Array
    owner: Array
    x: Array

    def nearest(self, features: Array) -> Array:
        """Optima of the nearest sequences, (m, n)."""
        return self.x[self.owner[self.tree.query(features / self.lengths)[1]]]

    def starts(self, features: Array, nearest: Array | None = None) -> Array:
        """Two starts of each, (m, 2, n): the nearest optimum or a given one (m, n), and an unlike one."""
        n = min(_NEIGHBOURS, self.tree.n)
        around = self.tree.query(features / self.lengths, k=np.arange(1, n + 1))[1]
        some = self.x[self.owner[around]]
        first = some[:, 0] if nearest is None else nearest
        away = np.sum(((some - first[:, None, :]) / self.x.std(axis=0).clip(1e-300)) ** 2, axis=2)
        return np.stack((first, some[np.arange(len(some)), away.argmax(axis=1)]), axis=1)

    def mean(self, features: Array, values: Array) -> Array:
        """Mean over the nearest sequences of values that they have (m,), near ones counting more."""
        n = min(_NEIGHBOURS, self.tree.n)
        distance, around = self.tree.query(features / self.lengths, k=np.arange(1, n + 1))
        weight = 1.0 / (distance + 0.1 * np.mean(distance) + 1e-12)
        return np.asarray(np.sum(weight * values[self.owner[around]], axis=1) / weight.sum(axis=1))


def neighbours(features: Array, x: Array, lengths: Array, images: Array) -> Neighbours:
    """The tree of sequences with features (m, d), their images by changes of sign (n_images, d)."""
    points = (features[None] * images[:, None, :] / lengths).reshape(-1, features.shape[1])
    return Neighbours(cKDTree(points), lengths, np.tile(np.arange(len(features)), len(images)), x)
