"""Laplace's method: optima of a log density within bounds, and Student-t approximations about them.

Where two modes cross, sorted frequencies have a kink: damped steps shrink there and look converged. Every
optimum is therefore polled at points spread around it, and left if a better one is found.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
from scipy.special import ndtri
from scipy.stats import qmc

from cpam_bayes.inference.derivatives import (
    Coordinates,
    Expansion,
    coordinates,
    expand_likelihood,
    expand_u,
    hessian_u,
    log_density,
    prior_sd,
)
from cpam_bayes.inference.posterior import Posterior
from cpam_bayes.inference.student_mixture import log_box_mass, log_student_t
from cpam_bayes.mechanics.problem import Array

# Gain in nats that further steps must promise.
_PROMISE = 1e-9
# Damping relative to the diagonal of the curvature: at first, and where an optimisation is given up.
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
    """Where m optimisations ended.

    u : (m, n).
    expansion : there.
    converged : (m,) bool, no step promised a gain; a kink can make that look so.
    steps : evaluations of the longest optimisation.
    """

    u: Array
    expansion: Expansion
    converged: Array
    steps: int


def promised_gain(gradient: Array, curvature: Array) -> Array:
    """Gain, nats, that a full step promises, 1/2 g^T C^-1 g, of gradients (m, n) and curvatures (m, n, n)."""
    step = np.linalg.solve(curvature, gradient[..., None])[..., 0]
    return np.asarray(0.5 * np.einsum("ki,ki->k", gradient, step))


def free_coordinates(u: Array, gradient: Array, lower: Array, upper: Array) -> Array:
    """Coordinates (m, n) that are not held by a bound against the gradient, bool."""
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
    """Local maxima next to a stack of starts (m, n), all optimised at once (Levenberg-Marquardt).

    Steps solve (C + d diag C) s = g in the coordinates that no bound holds, are cut at the bounds, and
    raise or lower the damping d as they fail or succeed (More, 1978; bounds as in Bertsekas, 1982).

    target : (u (k, n), rows (k,)) -> expansion, ``rows`` being the starts that the points belong to, so that
    each may have a density of its own.
    lower, upper : (n,).
    promised : gain in nats below which an optimisation ends.
    hopeless : expansion at k points -> (k,) bool, which optimisations are given up there.
    known : the target at the starts, where an optimisation goes on.
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
    """Damped steps (m, n) cut at the bounds, and the gains that they promise, (m,)."""
    n = u.shape[1]
    free = free_coordinates(u, gradient, lower, upper)
    g = np.where(free, gradient, 0.0)
    both = free[:, :, None] & free[:, None, :]
    # a flat coordinate has no curvature of its own: that of a prior one wide stands in
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
    # a step that the bounds cut may overshoot along the rest: half its slope is promised at least
    return step, np.maximum(linear - 0.5 * bent, 0.05 * linear)


@cache
def _directions(n: int) -> Array:
    """Points spread as a standard Gaussian in n dimensions, (points, n), the same each time."""
    points = qmc.Halton(n, scramble=False).random(_POLL_POINTS + 1)[1:]
    normal = np.asarray(ndtri(points))
    return np.concatenate((normal, -normal))


def _root_of_inverse(precision: Array) -> Array:
    """L with L L^T the inverse of a symmetric matrix whose eigenvalues are at least one, (n, n)."""
    try:
        return np.asarray(np.linalg.cholesky(np.linalg.inv(precision)))
    except np.linalg.LinAlgError:  # directions that differ by more than the digits of a number
        values, vectors = np.linalg.eigh(precision)
        return np.asarray(vectors / np.sqrt(np.maximum(values, 1.0)))


def polish(
    value: Callable[[Array], Array],
    target: Callable[[Array, Array], Expansion],
    maxima: Maxima,
    row: int,
    lower: Array,
    upper: Array,
) -> tuple[Array, Expansion, bool]:
    """One optimum made sure of: polled from 0.01 to 3 standard deviations around, left while that pays.

    After each gain the optimisation starts again, from the better point. value : (k, n) -> (k,) log density.
    Returns the optimum (n,), the expansion there (m = 1) and whether the last poll found nothing better.
    """
    u = maxima.u[row]
    expansion = maxima.expansion.of(np.array([row]))
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


Hessian = Literal["gauss-newton", "exact"]

# Curvatures in units of one over the variances of the priors: flat for all that matters, and so near
# to flat that the sign is not taken for a saddle's.
_FLAT, _NEARLY_FLAT = 1e-6, 0.05
# Least curvature in coordinates that are held, over the square of the slope: an exponential loses 1 %.
_SLOPE_ONLY = 1e-2
# An interval without end counts as so many standard deviations of the prior.
_WIDEST = 5.0
# Two optima are one if the log density between them falls by less than this below the lower one.
_DIP = 0.1
_BETWEEN = np.linspace(0.0, 1.0, 12)[1:-1]
# Optima this far below the best one carry nothing.
_NEGLIGIBLE_NATS = 30.0


@dataclass(frozen=True, slots=True)
class Optimum:
    """A local maximum of a posterior's density over the scaled coordinates u.

    x : (n,) parameters.
    u : (n,).
    log_prob : of the parameters.
    expansion : of the density over u there, one point.
    verified : whether no better point was found around it.
    """

    x: Array
    u: Array
    log_prob: float
    expansion: Expansion
    verified: bool


@dataclass(frozen=True, slots=True)
class Approximation:
    """A Gaussian or a Student-t over u, cut at the bounds, that touches the posterior at an optimum.

    centre : (n,), a Gaussian's outside the bounds where the density rises towards one.
    scale : (n, n), inverse of the negative Hessian, for a Student-t times (nu + n) / nu, which gives it the
    same curvature at its centre.
    degrees_of_freedom : nu, infinite for a Gaussian.
    log_evidence : integral of the approximation (``laplace_log_evidence``).
    hessian : which one was used.
    """

    centre: Array
    scale: Array
    degrees_of_freedom: float
    log_evidence: float
    hessian: Hessian


def find_optima(
    posterior: Posterior,
    starts: Array,
    rng: np.random.Generator | None = None,
    *,
    draws: int = 12,
    most: int = 6,
) -> tuple[Optimum, ...]:
    """The distinct local maxima next to given starts and to draws from the prior, the best first.

    All starts are optimised at once (``maximise``); what they reach is parted into optima with a dip between
    them, and each is polled (``polish``). Optima more than 30 nats below the best are dropped, and all after
    the best ``most``. Raises ``ValueError`` where no start lies in the support of the prior.

    starts : (m, n).
    rng : draws further starts, the best ``draws`` of ten times as many; without it there are none.
    """
    axes = coordinates(posterior)
    starts = np.clip(np.atleast_2d(starts), axes.inner, axes.outer)
    starts = starts[np.isfinite(posterior.log_prob(starts))]
    if rng is not None and draws:
        more = posterior.parameters.sample(rng, 10 * draws)
        height = posterior.log_prob(more)
        order = np.argsort(-height, kind="stable")[:draws]
        starts = np.concatenate((starts, more[order[np.isfinite(height[order])]]))
    if not len(starts):
        raise ValueError("the start of an optimisation lies outside the support of the prior")

    def target(u: Array, rows: Array) -> Expansion:
        return expand_u(posterior, axes, u)

    def value(u: Array) -> Array:
        return log_density(posterior, axes, u)

    maxima = maximise(target, axes.to_u(starts), axes.lower, axes.upper)
    rough = _distinct(value, maxima.u, maxima.expansion.value, 3 * most)
    polished = [polish(value, target, maxima, i, axes.lower, axes.upper) for i in rough]
    points, heights = np.stack([p[0] for p in polished]), np.array([p[1].value[0] for p in polished])
    kept = _distinct(value, points, heights, most)
    return tuple(_optimum(posterior, axes, *polished[i]) for i in kept)


def _optimum(
    posterior: Posterior, axes: Coordinates, u: Array, expansion: Expansion, verified: bool
) -> Optimum:
    x = axes.to_x(u)
    return Optimum(x, u, float(posterior.log_prob(x[None])[0]), expansion, verified)


def _distinct(value: Callable[[Array], Array], u: Array, height: Array, most: int) -> list[int]:
    """Indices of points (m, n) that are parted by a dip from every better one, the best first."""
    least = height.max() - _NEGLIGIBLE_NATS
    order = [int(i) for i in np.argsort(-height, kind="stable") if height[i] > least]
    kept: list[int] = []
    for i in order:
        if len(kept) == most:
            break
        between = [u[i] + t * (u[k] - u[i]) for k in kept for t in _BETWEEN]
        if between:
            lowest = value(np.stack(between)).reshape(len(kept), -1).min(axis=1)
            if np.any(lowest > height[i] - _DIP):
                continue
        kept.append(i)
    return kept


def gauss_newton_covariance(posterior: Posterior, x: Array) -> Array:
    """(F + P^-1)^-1 at x (n,), F the information of the data, P the covariance of the priors, (n, n).

    A direction which the data leave open keeps its prior's width.
    F is J^T S^-1 J for Gaussian noise that is known, see ``expand``.
    """
    by_sd = 1.0 / prior_sd(posterior)
    of_prior = by_sd[:, None] * posterior.parameters.precision * by_sd
    return np.asarray(np.linalg.inv(expand_likelihood(posterior, x[None]).curvature[0] + of_prior))


def approximate(
    posterior: Posterior, optimum: Optimum, hessian: Hessian = "exact", degrees_of_freedom: float = np.inf
) -> Approximation:
    """The Gaussian or Student-t approximation about one optimum, and its evidence.

    hessian : "gauss-newton" (Fisher information of the data plus curvature of the priors) or "exact"
    (differences of the analytic gradient, see ``hessian_u``). The Gauss-Newton one is used in place of
    an exact one that is not definite, at a kink or where its steps leave the constraints (9).
    """
    axes = coordinates(posterior)
    e = optimum.expansion
    used: Hessian = "gauss-newton"
    matrix = e.curvature
    if hessian == "exact":
        sd = np.sqrt(np.diagonal(np.linalg.inv(matrix[0] + np.eye(len(optimum.u)))))
        exact = hessian_u(posterior, axes, optimum.u, sd)
        if _is_definite(exact, free_coordinates(optimum.u[None], e.gradient, axes.lower, axes.upper)[0]):
            matrix, used = exact[None], "exact"
    u = optimum.u[None]
    centre, scale = _shape(e.gradient, matrix, u, axes, degrees_of_freedom)
    log_evidence = _integral(e.value, centre, scale, u, axes, degrees_of_freedom)
    return Approximation(centre[0], scale[0], degrees_of_freedom, float(log_evidence[0]), used)


def laplace_log_evidence(
    value: Array,
    gradient: Array,
    hessian: Array,
    u: Array,
    axes: Coordinates,
    degrees_of_freedom: float = np.inf,
) -> Array:
    """Laplace's log evidence of m posteriors about one optimum of each, (m,).

    log Z = log p(u) - log q(u) + log Q, q being the approximation and Q its mass between the bounds
    (``log_box_mass``). The Gaussian has the posterior's Hessian H and, in the coordinates that a bound
    holds, its slope g: its centre u + H^-1 g lies outside. A Student-t is centred on the optimum; in
    coordinates that are held the slope counts, not the curvature, and it has the precision pi g^2 / 2
    of the half Gaussian with the same integral. Where nothing is cut the Gaussian's is
    log p(u) + n/2 log 2 pi - 1/2 log det H (Tierney and Kadane, 1986) and the Student-t's that plus a
    constant. The constraints (9) are not cut.

    value : (m,), gradient : (m, n), hessian : (m, n, n) negative Hessian, u : (m, n).
    """
    centre, scale = _shape(gradient, hessian, u, axes, degrees_of_freedom)
    return _integral(value, centre, scale, u, axes, degrees_of_freedom)


def _is_definite(hessian: Array, free: Array) -> bool:
    """Whether a negative Hessian (n, n) may be one of a maximum in its free coordinates (n,)."""
    if not np.all(np.isfinite(hessian)):
        return False
    block = hessian[np.ix_(free, free)]
    return not len(block) or bool(np.linalg.eigvalsh(block)[0] > -_NEARLY_FLAT)


def _shape(gradient: Array, hessian: Array, u: Array, axes: Coordinates, nu: float) -> tuple[Array, Array]:
    """Centre (m, n) and scale matrix (m, n, n) of the approximations at u (m, n).

    Given the coordinates that are held, the free ones have the Hessian's free block; of the held ones'
    own precision, the Schur complement, what is negative is set to (almost) nothing: there the density
    falls by its slope.
    """
    n = u.shape[1]
    eye = np.eye(n)
    free = free_coordinates(u, gradient, axes.lower, axes.upper)
    ff, hh = (a[:, :, None] & a[:, None, :] for a in (free, ~free))
    g = np.where(free, 0.0, gradient)
    inner = _floored(np.where(ff, hessian, eye), _FLAT)
    cross = np.where(ff | hh, 0.0, hessian)
    back = cross @ np.linalg.inv(np.where(ff, inner, eye)) @ np.swapaxes(cross, 1, 2)
    # in units of the length over which the slope or the other bound ends the density
    width = np.minimum(axes.upper - axes.lower, _WIDEST)
    length = np.where(free, 1.0, 1.0 / np.maximum(np.abs(g), 1.0 / width))
    outer_units = length[:, :, None] * length[:, None, :]
    outer = _floored(np.where(hh, (hessian - back) * outer_units, eye), _SLOPE_ONLY) / outer_units
    if not np.isinf(nu):
        outer = outer + 0.5 * np.pi * (g**2)[..., None] * eye
    precision = np.where(ff, inner, 0.0) + cross + np.where(hh, outer + back, 0.0)
    scale = np.linalg.inv(precision)
    scale = 0.5 * (scale + np.swapaxes(scale, 1, 2))
    if np.isinf(nu):
        return u + np.einsum("mij,mj->mi", scale, g), scale
    return u, scale * (nu + n) / nu


def _floored(matrix: Array, least: float) -> Array:
    """Symmetric matrices (m, n, n) whose eigenvalues below a least one are set to it."""
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray((vectors * np.maximum(values, least)[:, None, :]) @ np.swapaxes(vectors, 1, 2))


def _integral(value: Array, centre: Array, scale: Array, u: Array, axes: Coordinates, nu: float) -> Array:
    at = log_student_t((u - centre)[:, None], np.linalg.cholesky(scale), nu)[:, 0]
    return np.asarray(value - at + log_box_mass(centre, scale, axes.lower, axes.upper, nu))
