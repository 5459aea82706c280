"""Optima of a posterior, and its Gaussian and Student-t approximations about them (Laplace's method)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.inference.derivatives import (
    Coordinates,
    Expansion,
    coordinates,
    expand_u,
    hessian_u,
    information,
    log_density,
    prior_sd,
)
from cpam_bayes.inference.optimise import free_coordinates, maximise, polish
from cpam_bayes.inference.posterior import Posterior
from cpam_bayes.inference.student_mixture import log_student_t
from cpam_bayes.inference.truncated import log_box_mass

__all__ = [
    "Approximation",
    "GaussianApproximation",
    "Optimum",
    "approximate",
    "find_optima",
    "gauss_newton_covariance",
    "laplace_log_evidence",
    "optimise",
    "prior_sd",
]

Array = NDArray[Any]
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
class GaussianApproximation:
    """A posterior as a Gaussian about one optimum.

    optimum : (n,).
    covariance : (n, n), the inverse of the Gauss-Newton Hessian with the variances of the priors added, so
    that a direction which the data leave open keeps its prior's width.
    """

    optimum: Array
    log_prob: float
    covariance: Array


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

    All starts are optimised at once by damped Gauss-Newton steps (``maximise``); what they reach is parted
    into optima with a dip between them, and each is polled from 0.01 to 3 standard deviations around
    (``polish``), which catches false convergence where modes cross. Optima more than 30 nats below the
    best are dropped, and all after the best ``most``. Raises ``ValueError`` where no start lies in the
    support of the prior.

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


def optimise(posterior: Posterior, start: Array) -> GaussianApproximation:
    """The optimum of the posterior next to ``start`` (n,), bounded by the priors' support.

    Raises ``ValueError`` if the start lies outside the support of the prior.
    """
    best = find_optima(posterior, start[None])[0]
    return GaussianApproximation(best.x, best.log_prob, gauss_newton_covariance(posterior, best.x))


def gauss_newton_covariance(posterior: Posterior, x: Array) -> Array:
    """(F + P^-1)^-1 at x (n,), F the information of the data, P the variances of the priors, (n, n).

    F is J^T S^-1 J for Gaussian noise that is known, see ``expansion.information``.
    """
    precision = information(posterior, x[None])[0] + np.diag(1.0 / prior_sd(posterior) ** 2)
    return np.asarray(np.linalg.inv(precision))


def approximate(
    posterior: Posterior,
    optimum: Optimum,
    hessian: Hessian = "exact",
    degrees_of_freedom: float = np.inf,
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
