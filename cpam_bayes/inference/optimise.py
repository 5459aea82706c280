"""Optimisation of log densities within bounds, many starts at once.

Where two modes cross, sorted frequencies have a kink: damped steps shrink there and look converged.
`polish` therefore polls an optimum at points spread around it, and leaves it if a better one is found.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.special import ndtri
from scipy.stats import qmc

from cpam_bayes.inference.scores import Expansion
from cpam_bayes.mechanics.problem import Array

# Gain in nats that further steps must promise.
_PROMISE = 1e-9
# Damping relative to the diagonal of the curvature: initial, and the largest, at which one is given up.
_DAMPING, _MOST_DAMPING = 1e-2, 1e9
# Longest step in a coordinate: one standard deviation of a prior.
_LONGEST = 1.0
# Sizes of polls in standard deviations, and points of each size.
_POLL_SIZES = (3.0, 1.0, 0.3, 0.1, 0.03, 0.01)
_POLL_POINTS = 48
# Gain in nats for which an optimum is left.
_BETTER = 1e-4
_MOST_POLLS = 25


@dataclass(frozen=True, slots=True)
class Maxima:
    """Ends of m optimisations.

    u : (m, n).
    expansion : there.
    converged : (m,) bool, no step promised a gain; at a kink this can be wrong.
    steps : evaluations of the longest optimisation.
    """

    u: Array
    expansion: Expansion
    converged: Array
    steps: int


def promised_gain(gradient: Array, curvature: Array) -> Array:
    """Promised gain, nats, of a full step, 1/2 g^T C^-1 g, with gradients (m, n) and curvatures (m, n, n)."""
    step = np.linalg.solve(curvature, gradient[..., None])[..., 0]
    return np.asarray(0.5 * np.einsum("ki,ki->k", gradient, step))


def free_coordinates(u: Array, gradient: Array, lower: Array, upper: Array) -> Array:
    """Mask (m, n) of the coordinates that no bound holds against the gradient."""
    return np.asarray(~(((u <= lower) & (gradient < 0)) | ((u >= upper) & (gradient > 0))))


def maximise(
    target: Callable[[Array, Array], Expansion],
    start: Array,
    lower: Array,
    upper: Array,
    *,
    most_steps: int = 60,
    promised: float = _PROMISE,
    hopeless: Callable[[Expansion], Array] | None = None,
    known: Expansion | None = None,
) -> Maxima:
    """Local maxima reached from a stack of starts (m, n), all optimised at once (Levenberg-Marquardt).

    Steps solve (C + d diag C) s = g in the coordinates that no bound holds, are cut at the bounds, and
    raise or lower the damping d as they fail or succeed (More, 1978; bounds as in Bertsekas, 1982).

    target : (u (k, n), rows (k,)) -> expansion, ``rows`` being the starts that the points belong to, so that
    each may have its own density.
    lower, upper : (n,).
    promised : promised gain in nats below which an optimisation ends.
    hopeless : expansion at k points -> (k,) bool, True for optimisations to be given up there.
    known : the target at the starts, if an earlier optimisation is continued.
    """
    u = np.clip(np.array(start, dtype=float), lower, upper)
    m = len(u)
    every = np.arange(m)
    first = target(u, every) if known is None else known
    value, gradient, curvature = first.value.copy(), first.gradient.copy(), first.curvature.copy()
    damping = np.full(m, _DAMPING)
    converged = np.zeros(m, dtype=bool)
    live = np.isfinite(value)
    steps = 1
    while live.any() and steps < most_steps:
        rows = every[live]
        if hopeless is not None:
            live[rows] = ~hopeless(Expansion(value[rows], gradient[rows], curvature[rows]))
            rows = every[live]
        step, promise = _step(u[rows], gradient[rows], curvature[rows], damping[rows], lower, upper)
        idle = promise < promised
        converged[rows[idle]], live[rows[idle]] = True, False
        rows, step, promise = rows[~idle], step[~idle], promise[~idle]
        if not len(rows):
            break
        trial = target(u[rows] + step, rows)
        steps += 1
        with np.errstate(invalid="ignore"):
            gain = np.where(np.isfinite(trial.value), trial.value - value[rows], -np.inf)
        better = gain > 0
        ratio = gain / promise
        damping[rows] *= np.where(ratio > 0.75, 0.1, np.where(ratio > 0.25, 0.5, np.where(better, 2.0, 6.0)))
        taken = rows[better]
        u[taken] += step[better]
        value[taken] = trial.value[better]
        gradient[taken], curvature[taken] = trial.gradient[better], trial.curvature[better]
        live[rows[damping[rows] > _MOST_DAMPING]] = False
    return Maxima(u, Expansion(value, gradient, curvature), converged, steps)


def _step(
    u: Array, gradient: Array, curvature: Array, damping: Array, lower: Array, upper: Array
) -> tuple[Array, Array]:
    """Damped steps (m, n) cut at the bounds, and the gains (m,) that they promise."""
    n = u.shape[1]
    free = free_coordinates(u, gradient, lower, upper)
    g = np.where(free, gradient, 0.0)
    both = free[:, :, None] & free[:, None, :]
    # a flat coordinate has no curvature of its own: a small one stands in
    diagonal = np.maximum(np.diagonal(curvature, axis1=1, axis2=2), 1e-3)
    matrix = (
        np.where(both, curvature, 0.0) + np.eye(n) * np.where(free, damping[:, None] * diagonal, 1.0)[:, None]
    )
    matrix += 1e-12 * np.eye(n) * diagonal.max(axis=1)[:, None, None]
    step = np.linalg.solve(matrix, g[..., None])[..., 0]
    step *= np.minimum(1.0, _LONGEST / np.maximum(np.abs(step).max(axis=1), 1e-300))[:, None]
    step = np.clip(u + step, lower, upper) - u
    bent = np.einsum("mi,mij,mj->m", step, curvature, step)
    linear = np.sum(g * step, axis=1)
    # a step cut by the bounds may overshoot along the rest: at least a fraction of its slope is promised
    return step, np.maximum(linear - 0.5 * bent, 0.05 * linear)


@cache
def _directions(n: int) -> Array:
    """Points (points, n) spread as a standard Gaussian in n dimensions, reproducible."""
    points = qmc.Halton(n, scramble=False).random(_POLL_POINTS + 1)[1:]
    normal = np.asarray(ndtri(points))
    return np.concatenate((normal, -normal))


def _root_of_inverse(precision: Array) -> Array:
    """L (n, n) with L L^T the inverse of a symmetric matrix whose eigenvalues are at least one."""
    try:
        return np.asarray(np.linalg.cholesky(np.linalg.inv(precision)))
    except np.linalg.LinAlgError:  # directions that differ by more than the digits of a number
        values, vectors = np.linalg.eigh(precision)
        return np.asarray(vectors / np.sqrt(np.maximum(values, 1.0)))


def polish(
    value: Callable[[Array], Array],
    target: Callable[[Array, Array], Expansion],
    u: Array,
    expansion: Expansion,
    lower: Array,
    upper: Array,
) -> tuple[Array, Expansion, bool]:
    """Polish an optimum (n,) by polls from 0.01 to 3 standard deviations around it, until none is better.

    After each gain the optimisation restarts from the better point. value : (k, n) -> (k,) log density.
    expansion : of the target there, one point. Returns the optimum, the expansion there and whether the last
    poll found nothing better.
    """
    n = len(u)
    for _ in range(_MOST_POLLS):
        spread = _directions(n) @ _root_of_inverse(expansion.curvature[0] + np.eye(n)).T
        points = np.clip(u + np.concatenate([s * spread for s in _POLL_SIZES]), lower, upper)
        values = value(points)
        best = int(np.argmax(np.where(np.isnan(values), -np.inf, values)))
        if not values[best] > expansion.value[0] + _BETTER:
            return u, expansion, True
        again = maximise(target, points[best : best + 1], lower, upper)
        u, expansion = again.u[0], again.expansion
    return u, expansion, False
