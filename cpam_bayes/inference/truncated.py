"""Gaussian and Student-t densities cut at bounds: their mass between them, and draws."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr, ndtri_exp, stdtr, stdtrit
from scipy.stats import qmc

from cpam_bayes.inference.student_mixture import log_student_t

Array = NDArray[Any]


def log_box_mass(
    centre: Array,
    scale: Array,
    lower: Array,
    upper: Array,
    nu: float = np.inf,
    log2_points: int = 10,
) -> Array:
    """Log probability between bounds of m Gaussian or Student-t densities, (m,).

    One variable after the other, each given those before, over a Sobol sequence, the most constrained
    first (Genz and Bretz, Computation of Multivariate Normal and t Probabilities, 2009). All in
    logarithms: a centre many standard deviations outside keeps its digits. The error is about 1e-3
    with 2^10 points in five dimensions. No chance is involved.

    centre : (m, n).
    scale : (m, n, n) covariance, or scale matrix of a Student-t of nu degrees of freedom.
    lower, upper : (n,), may be infinite.
    """
    m, n = centre.shape
    sd = np.sqrt(np.diagonal(scale, axis1=1, axis2=2))
    alone = _log_interval((lower - centre) / sd, (upper - centre) / sd, nu)
    order = np.argsort(alone, axis=1, kind="stable")
    row = np.arange(m)[:, None]
    factor = np.linalg.cholesky(scale[row[..., None], order[:, :, None], order[:, None, :]])
    sobol = qmc.Sobol(n, scramble=False).random_base2(log2_points)
    points = sobol + 0.5**log2_points / 2.0  # off the faces of the cube
    _, log_mass = _sequential(centre[row, order], factor, lower[order], upper[order], nu, points)
    top = log_mass.max(axis=1, keepdims=True)
    return np.asarray(np.log(np.mean(np.exp(log_mass - top), axis=1)) + top[:, 0])


def box_draws(
    centre: Array, scale: Array, lower: Array, upper: Array, nu: float, size: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Draws between bounds near a Gaussian or Student-t, (size, n), and their log density, (size,).

    Every coordinate is drawn from its conditional density given those before, cut at its bounds. That
    is not the density cut as a whole, but one that is known, normalised, and equal to it where nothing
    is cut (Geweke, 1991). centre : (n,), scale : (n, n), lower and upper (n,).
    """
    factor = np.linalg.cholesky(scale)
    uniform = rng.uniform(size=(size, len(centre)))
    x, log_mass = _sequential(centre[None], factor[None], lower[None], upper[None], nu, uniform)
    return x[0], log_student_t(x[0] - centre, factor, nu) - log_mass[0]


def _sequential(
    centre: Array, factor: Array, lower: Array, upper: Array, nu: float, uniform: Array
) -> tuple[Array, Array]:
    """Points between the bounds, (m, k, n), and the log product of the conditional masses, (m, k).

    centre, lower, upper : (m, n).
    factor : (m, n, n).
    uniform : (k, n) in (0, 1).
    """
    m, n = centre.shape
    z = np.zeros((m, len(uniform), n))
    log_mass = np.zeros((m, len(uniform)))
    squared = np.zeros((m, len(uniform)))
    for i in range(n):
        shift = np.einsum("mkj,mj->mk", z[:, :, :i], factor[:, i, :i]) + centre[:, i, None]
        # given those before, a t coordinate is a t of more degrees of freedom and another width
        dof = nu + i
        width = np.ones_like(squared) if np.isinf(nu) else np.sqrt((nu + squared) / dof)
        a, b = ((bound[:, i, None] - shift) / (factor[:, i, i, None] * width) for bound in (lower, upper))
        log_mass += _log_interval(a, b, dof)
        z[:, :, i] = width * _interval_quantile(a, b, dof, uniform[:, i])
        squared += z[:, :, i] ** 2
    x = centre[:, None] + np.einsum("mkj,mij->mki", z, factor)
    return np.clip(x, lower[:, None], upper[:, None]), log_mass


def _mirrored(a: Array, b: Array) -> tuple[Array, Array, Array]:
    """Intervals carried to the lower tail, where distribution functions are accurate, and their signs."""
    with np.errstate(invalid="ignore"):
        flip = a + b > 0  # not where both are infinite: then nothing is cut
    return np.where(flip, -b, a), np.where(flip, -a, b), np.where(flip, -1.0, 1.0)


def _log_interval(a: Array, b: Array, nu: float) -> Array:
    """Log probability of a standard variable between a and b."""
    a, b, _ = _mirrored(a, b)
    with np.errstate(divide="ignore"):
        if np.isinf(nu):
            below, above = log_ndtr(a), log_ndtr(b)
            return np.asarray(above + np.log(-np.expm1(np.minimum(below - above, 0.0))))
        return np.asarray(np.log(stdtr(nu, b) - stdtr(nu, a)))


def _interval_quantile(a: Array, b: Array, nu: float, p: Array) -> Array:
    """Quantiles p in (0, 1) of a standard variable cut to [a, b]."""
    a, b, sign = _mirrored(a, b)
    p = np.where(sign > 0, p, 1.0 - p)
    if np.isinf(nu):
        with np.errstate(divide="ignore"):
            log_p = np.logaddexp(log_ndtr(a) + np.log1p(-p), log_ndtr(b) + np.log(p))
        x = ndtri_exp(np.minimum(log_p, 0.0))
    else:
        x = stdtrit(nu, (1.0 - p) * stdtr(nu, a) + p * stdtr(nu, b))
    return np.asarray(sign * np.clip(x, a, b))
