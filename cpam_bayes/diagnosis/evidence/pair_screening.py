"""Screening of all pairs of causes at once: their shifts add, the constants answer them linearly.

Every cause has been screened alone, so that its shifts of the frequencies are known at all nodes of its
grid. Where the constants are integrated in closed form, a pair is a sum of two vectors: all pairs of all
variants are ranked by matrix products, and only the best are integrated over both sizes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.special import logsumexp

from cpam_bayes.diagnosis.evidence.comparison import Comparison
from cpam_bayes.diagnosis.evidence.marginal import GRID, Marginal
from cpam_bayes.diagnosis.evidence.screening import Linear, free_of, log_f, log_of_frequencies, set_noise

Array = NDArray[Any]

_LOG_2PI = float(np.log(2 * np.pi))
# The fine grid has so many nodes, a multiple of which are the grid's.
_TIMES = 10
FINE = np.linspace(GRID[0], GRID[-1], _TIMES * (len(GRID) - 1) + 1)
# Of the inferred amplitudes of the noise every third ranks pairs.
_EVERY = 3
# Where the linear approximation leads, the model is solved so many times to correct it.
_CORRECTIONS = 2


@dataclass(frozen=True, slots=True)
class _Whitened:
    """Residuals and shifts in units of noise and constants together: root^T root is the precision."""

    root: Array
    residual: Array
    log_constant: float

    @staticmethod
    def of(lists: Linear, sigma: Array, log_weight: float) -> _Whitened:
        n = len(sigma)
        factor = np.linalg.cholesky(np.diag(sigma**2) + lists.slope @ lists.slope.T)
        root = np.linalg.inv(factor)
        residual = root @ lists.residual
        log_det = float(np.log(np.diagonal(factor)).sum())
        log_constant = -0.5 * float(residual @ residual) - log_det - 0.5 * n * _LOG_2PI + log_weight
        return _Whitened(root, residual, log_constant)


def ranked_pairs(
    lists: Linear, tables: Sequence[Array], log_prior: Array, most: int
) -> list[tuple[int, int]]:
    """The pairs i < j of causes with most prior times evidence, by Laplace's method at the best node.

    lists : of the plain model, residual (n_f,).
    tables : (k, n_f) shifts at the grid's nodes by cause.
    log_prior : (m, m) of the pairs, -inf where two do not go together.
    """
    m = len(tables)
    if m < 2:
        return []
    stack = np.stack(tables)
    every = _EVERY if len(lists.sigmas) > 1 else 1
    whitened = [
        _Whitened.of(lists, sigma, float(weight))
        for sigma, weight in zip(lists.sigmas[::every], lists.log_weight[::every], strict=True)
    ]
    each = np.stack([_ranks(w, stack) + w.log_constant for w in whitened])
    score = np.where(np.triu(np.ones((m, m), dtype=bool), 1), logsumexp(each, axis=0) + log_prior, -np.inf)
    best = np.argsort(-score, axis=None, kind="stable")[:most]
    pairs = [(int(i), int(j)) for i, j in zip(*np.unravel_index(best, (m, m)), strict=True)]
    return [(i, j) for i, j in pairs if np.isfinite(score[i, j])]


def _ranks(w: _Whitened, stack: Array) -> Array:
    """Log evidence of all pairs over that of no shift, (m, m)."""
    m, k, n = stack.shape
    shift = stack @ w.root.T
    alone = shift @ w.residual - 0.5 * np.sum(shift**2, axis=2) - 0.5 * GRID**2
    slope = np.gradient(shift, GRID, axis=1)
    flat = shift.reshape(m * k, n)
    log_evidence = np.empty((m, m))
    for i in range(m):
        value = alone[i][:, None] + alone.reshape(m * k) - shift[i] @ flat.T
        value = value.reshape(k, m, k).swapaxes(0, 1).reshape(m, k * k)
        node = value.argmax(axis=1)
        a, b = node // k, node % k
        rows = np.arange(m)
        left = w.residual - shift[i, a] - shift[rows, b]
        along = np.stack((slope[i, a], slope[rows, b]), axis=2)
        gradient = np.einsum("mn,mnp->mp", left, along) - np.stack((GRID[a], GRID[b]), axis=1)
        curvature = np.swapaxes(along, 1, 2) @ along + np.eye(2)
        half = 0.6 * (GRID[1] - GRID[0])
        step = np.clip(np.linalg.solve(curvature, gradient[..., None])[..., 0], -half, half)
        bent = np.einsum("mi,mij,mj->m", step, curvature, step)
        gain = np.sum(gradient * step, axis=1) - 0.5 * bent
        log_evidence[i] = value[rows, node] + gain - 0.5 * np.log(np.linalg.det(curvature))
    return log_evidence


def screened_pair(
    lists: Linear,
    tables: tuple[Array, Array],
    comparison: Comparison,
    columns: tuple[int, int],
    start: Array,
) -> Marginal:
    """The marginal likelihood of a pair by quadrature over both sizes, corrected where it leads.

    lists, tables : as in ``ranked_pairs``.
    columns : of the two sizes in the pair's comparison.
    start : (n,) scores of the constants that the lists are linear about. The grid is that of the first size.
    """
    fine = tuple(CubicSpline(GRID, table, axis=0)(FINE) for table in tables)
    free = free_of(comparison, columns)
    listed = np.log(comparison.listed.frequencies)
    prior = -0.5 * FINE[:, None] ** 2 - 0.5 * FINE**2 + 2.0 * np.log(FINE[1] - FINE[0]) - _LOG_2PI
    for correction in range(_CORRECTIONS + 1):
        whitened = [
            _Whitened.of(lists, s, float(w)) for s, w in zip(lists.sigmas, lists.log_weight, strict=True)
        ]
        log_p = np.stack([_over_both(w, fine) for w in whitened])
        total = np.asarray(logsumexp(log_p, axis=0)) + prior
        along = np.asarray(logsumexp(total, axis=1))
        second = total.argmax(axis=1)
        of_noise = log_p[:, np.arange(len(FINE)), second].argmax(axis=0)
        at = np.tile(start, (len(FINE), 1))
        at[:, columns[0]], at[:, columns[1]] = FINE, FINE[second]
        residual = lists.residual - fine[0] - fine[1][second]
        for s in np.unique(of_noise):
            rows = np.flatnonzero(of_noise == s)
            at[np.ix_(rows, free)] = lists.answer(residual[rows], lists.sigmas[s])
        set_noise(comparison, at, of_noise)
        if correction == _CORRECTIONS:
            break
        best = int(along.argmax())
        there = listed - log_f(comparison, at[best : best + 1])[0] + at[best, free] @ lists.slope.T
        lists = replace(lists, residual=lists.residual + there - residual[best])
    log_evidence = float(logsumexp(along))
    share = np.exp(along - log_evidence)
    kept = slice(0, None, _TIMES)
    owner = (np.arange(len(FINE)) + _TIMES // 2) // _TIMES
    n = len(start) - 1
    return Marginal(
        comparison=comparison,
        quadrature=columns[0],
        log_evidence=log_evidence + log_of_frequencies(comparison),
        error=np.nan,
        z=at[kept],
        curvature=np.broadcast_to(np.eye(n), (len(GRID), n, n)),
        weight=np.bincount(owner, share, len(GRID)),
        draws=comparison.scores.to_x(at),
        log_weight=along - log_evidence,
        is_refined=False,
    )


def _over_both(w: _Whitened, fine: tuple[Array, ...]) -> Array:
    """Log density of the lists at every pair of sizes, (k, k)."""
    a, b = (table @ w.root.T for table in fine)
    first, second = (t @ w.residual - 0.5 * np.sum(t**2, axis=1) for t in (a, b))
    return np.asarray(first[:, None] + second - a @ b.T + w.log_constant)
