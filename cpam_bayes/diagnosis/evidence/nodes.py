"""Optima of constants and noise at held values of an effect's sizes: the nodes of its integral."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from cpam_bayes.diagnosis.evidence.comparison import Comparison
from cpam_bayes.diagnosis.evidence.optima import Optima
from cpam_bayes.inference.derivatives import Expansion
from cpam_bayes.inference.optimise import maximise
from cpam_bayes.inference.standard_normal import MAX_SCORE

Array = NDArray[Any]

# Optimisations end where a step promises less than this, nats, or after so many steps.
_PROMISED, _MOST_STEPS, _FEW_STEPS = 3e-3, 12, 6
# Joint optima that each node is approached from.
_FROM_OPTIMA = 2
# Optima of one node are the same within this distance, standard deviations.
_DISTINCT_SD = 1.0
# A node's optimum moves with the size by no more than this, scores per score.
_STEEPEST = 3.0
_HALF_LOG_2PI = 0.5 * np.log(2 * np.pi)


@dataclass(frozen=True, slots=True)
class Nodes:
    """Conditional optima at held sizes, up to two a node, the better one first.

    columns : of the sizes that are held
    scores : (k, d)
    value : (k, c), -inf where there is no further optimum
    rest : (k, c, n - d)
    curvature : (k, c, n - d, n - d)
    """

    columns: tuple[int, ...]
    scores: Array
    value: Array
    rest: Array
    curvature: Array

    @property
    def log_mass(self) -> Array:
        """Log density of the sizes and the data about each optimum, the rest integrated, (k, c)."""
        n = self.rest.shape[2]
        return np.asarray(self.value + n * _HALF_LOG_2PI - 0.5 * np.linalg.slogdet(self.curvature)[1])

    @property
    def log_density(self) -> Array:
        """The same over all optima of each node, (k,)."""
        return np.asarray(logsumexp(self.log_mass, axis=1))

    def z(self) -> Array:
        """Scores of all optima, (k, c, n)."""
        return inserted(self.columns, np.repeat(self.scores[:, None], self.rest.shape[1], axis=1), self.rest)

    def merged(self, rows: Array, again: Nodes) -> Nodes:
        """The nodes with further optima (as many nodes as rows) of some of them."""
        value, rest, curvature = self.value.copy(), self.rest.copy(), self.curvature.copy()
        value[rows], rest[rows], curvature[rows] = _best_of(
            np.concatenate((self.value[rows], again.value), axis=1),
            np.concatenate((self.rest[rows], again.rest), axis=1),
            np.concatenate((self.curvature[rows], again.curvature), axis=1),
        )
        return replace(self, value=value, rest=rest, curvature=curvature)

    def components(
        self, comparison: Comparison, log_mass: Array, width: Array, negligible: float
    ) -> tuple[Array, Array, Array]:
        """Optima (p, n), square roots (p, n, n) of their covariances and log masses (p,) of a mixture.

        Along the sizes a component is as wide as its node is far from the next ones; the optimum of the rest
        moves with the sizes as dr/ds = -C_rr^-1 C_rs.

        log_mass : (k,) of the nodes
        width : (k, d)
        """
        # in this order: where the plate buckles both densities are so low that they swallow the mass
        each = log_mass[:, None] + (self.log_mass - self.log_density[:, None])
        which = np.nonzero(each > each.max() + np.log(negligible))
        z, log_each = self.z()[which], each[which]
        curvature = comparison.expand(z).curvature
        d, n = len(self.columns), z.shape[1]
        columns = np.array(self.columns)
        rest = np.delete(np.arange(n), columns)
        inverse = np.linalg.inv(self.curvature[which])
        cross = curvature[:, rest][:, :, columns]
        slope = np.clip(-inverse @ cross, -_STEEPEST, _STEEPEST)
        factor = np.zeros((len(z), n, n))
        factor[:, rest[:, None], np.arange(n - d)] = np.linalg.cholesky(inverse)
        spread = width[which[0]]
        factor[:, columns, n - d + np.arange(d)] = spread
        factor[:, rest[:, None], n - d + np.arange(d)] = slope * spread[:, None, :]
        return z, factor, log_each


def inserted(columns: tuple[int, ...], scores: Array, rest: Array) -> Array:
    """Scores (..., n) of held sizes (..., d) and the rest (..., n - d)."""
    n = len(columns) + rest.shape[-1]
    z = np.empty((*rest.shape[:-1], n))
    z[..., list(columns)] = scores
    z[..., np.delete(np.arange(n), columns)] = rest
    return z


def conditional_optima(
    comparison: Comparison,
    columns: tuple[int, ...],
    scores: Array,
    optima: Optima | None,
    known: Array,
    *,
    few: bool = False,
) -> Nodes:
    """The best optima of the rest at sizes (k, d).

    optima : joint ones; the nearest of them are approached from along their tangents
    known : further starts, (s, n) whole scores, or (k, s, n - d) for each node
    few : only from the nearest joint optimum, which is near enough for a few steps
    """
    k, n = len(scores), comparison.parameters.size
    rest = np.delete(np.arange(n), columns)
    starts = [] if known.ndim == 2 else [known]
    if known.ndim == 2:
        used = known[:0] if few and optima is not None else known
        starts.append(np.broadcast_to(used[:, rest], (k, len(used), len(rest))))
    if optima is not None:
        starts.append(_along_tangents(columns, rest, scores, optima, 1 if few else _FROM_OPTIMA))
    begin = np.concatenate(starts, axis=1)
    s = begin.shape[1]
    held = np.repeat(scores, s, axis=0)

    def target(r: Array, rows: Array) -> Expansion:
        e = comparison.expand(inserted(columns, held[rows], r))
        return Expansion(e.value, e.gradient[:, rest], e.curvature[:, rest][:, :, rest])

    bound = np.full(len(rest), MAX_SCORE)
    flat = begin.reshape(k * s, len(rest))
    maxima = maximise(
        target, flat, -bound, bound, most_steps=_FEW_STEPS if few else _MOST_STEPS, promised=_PROMISED
    )
    e = maxima.expansion
    value = np.where(np.isfinite(e.value), e.value, -1e300).reshape(k, s)
    value, r, curvature = _best_of(
        value, maxima.u.reshape(k, s, -1), e.curvature.reshape(k, s, len(rest), len(rest))
    )
    return Nodes(columns, scores, value, r, curvature)


def _along_tangents(columns: tuple[int, ...], rest: Array, scores: Array, optima: Optima, most: int) -> Array:
    """Starts (k, most, n - d) for the rest from the joint optima nearest in size."""
    at = optima.z[:, list(columns)]
    away = scores[:, None] - at  # (k, optima, d)
    far = np.sum(away**2, axis=2) - 2e-2 * (optima.value - optima.value.max())
    nearest = np.argsort(far, axis=1, kind="stable")[:, :most]
    c_rr = optima.curvature[:, rest][:, :, rest]
    slope = -np.linalg.solve(c_rr, optima.curvature[:, rest][:, :, list(columns)])
    step = np.take_along_axis(away, nearest[..., None], axis=1)
    moved = np.einsum("ksrd,ksd->ksr", np.clip(slope, -_STEEPEST, _STEEPEST)[nearest], step)
    return np.asarray(np.clip(optima.z[nearest][..., rest] + np.clip(moved, -2.0, 2.0), -6.0, 6.0))


def _best_of(value: Array, rest: Array, curvature: Array) -> tuple[Array, Array, Array]:
    """Of candidates (k, s, ...) the best one of each node, and the best that is another optimum."""
    k = len(value)
    rows = np.arange(k)
    first = value.argmax(axis=1)
    away = rest - rest[rows, first][:, None]
    distance = np.einsum("ksi,kij,ksj->ks", away, curvature[rows, first], away)
    others = np.where(distance > _DISTINCT_SD**2, value, -np.inf)
    second = others.argmax(axis=1)
    which = np.stack((first, second), axis=1)
    kept = np.take_along_axis(value, which, axis=1)
    kept[:, 1] = others[rows, second]
    return (
        kept,
        np.take_along_axis(rest, which[..., None], axis=1),
        np.take_along_axis(curvature, which[..., None, None], axis=1),
    )


def joined(a: Nodes, b: Nodes) -> Nodes:
    """The nodes of both, by their first size."""
    scores = np.concatenate((a.scores, b.scores))
    order = np.argsort(scores[:, 0], kind="stable")
    return Nodes(
        a.columns,
        scores[order],
        *(
            np.concatenate((getattr(a, name), getattr(b, name)))[order]
            for name in ("value", "rest", "curvature")
        ),
    )
