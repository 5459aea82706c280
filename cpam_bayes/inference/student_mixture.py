"""Mixtures of Student-t densities: density, draws, refits to weighted points, and importance weights."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.special import chdtri, gammaln, ndtri
from scipy.stats import qmc

from cpam_bayes.mechanics.problem import Array


@dataclass(frozen=True, slots=True)
class Mixture:
    """A mixture of k Student-t densities of n variables, or a stack of such mixtures.

    share : (..., k) fractions of the whole, zero for components that are not used.
    centre : (..., k, n).
    factor : (..., k, n, n), square roots of the scale matrices: factor factor^T.
    degrees_of_freedom : of all components, infinite for Gaussians.
    """

    share: Array
    centre: Array
    factor: Array
    degrees_of_freedom: float

    def alone(self) -> Mixture:
        """The mixture of a stack of one."""
        return Mixture(self.share[0], self.centre[0], self.factor[0], self.degrees_of_freedom)


def log_components(mixture: Mixture, points: Array) -> Array:
    """Log (..., k, p) of share times density of every component at points (..., p, n)."""
    nu, n = mixture.degrees_of_freedom, points.shape[-1]
    back = np.swapaxes(np.linalg.inv(mixture.factor), -1, -2)
    away = points[..., None, :, :] @ back
    away -= mixture.centre[..., None, :] @ back
    squared = np.einsum("...i,...i->...", away, away)
    with np.errstate(divide="ignore"):
        log_height = np.log(mixture.share) - np.linalg.slogdet(mixture.factor)[1]
    if np.isinf(nu):
        return np.asarray(log_height[..., None] - 0.5 * squared - 0.5 * n * np.log(2.0 * np.pi))
    constant = gammaln(0.5 * (nu + n)) - gammaln(0.5 * nu) - 0.5 * n * np.log(nu * np.pi)
    return np.asarray(constant + log_height[..., None] - 0.5 * (nu + n) * np.log1p(squared / nu))


def log_mixture(mixture: Mixture, points: Array) -> Array:
    """Log density (..., p) at points (..., p, n)."""
    return log_sum_exp(log_components(mixture, points), axis=-2)


def draw(mixture: Mixture, size: int, rng: np.random.Generator | np.random.RandomState) -> Array:
    """Independent draws (size, n) of one mixture."""
    k, n = mixture.centre.shape
    which = rng.choice(k, size=size, p=mixture.share)
    normal = rng.standard_normal((size, n))
    nu = mixture.degrees_of_freedom
    stretch = np.sqrt(nu / rng.chisquare(nu, size=size))
    away = np.einsum("mij,mj->mi", mixture.factor[which], normal)
    return np.asarray(mixture.centre[which] + stretch[:, None] * away)


def sobol_points(mixture: Mixture, log2_points: int, part: slice = slice(None)) -> Array:
    """Points (..., p, n) of a stack of mixtures, from one scrambled Sobol sequence for all of them.

    log2_points : of the sequence.
    part : of its points.
    """
    step, uniform = _standard_points(mixture.centre.shape[-1], log2_points, mixture.degrees_of_freedom)
    below = np.cumsum(mixture.share, axis=-1)[..., None, :-1] < uniform[part, None]
    which = np.sum(below, axis=-1)
    centre = np.take_along_axis(mixture.centre, which[..., None], axis=-2)
    factor = np.take_along_axis(mixture.factor, which[..., None, None], axis=-3)
    return np.asarray(centre + np.einsum("...pij,pj->...pi", factor, step[part]))


@cache
def _standard_points(n: int, log2_points: int, nu: float) -> tuple[Array, Array]:
    """Points (2^log2_points, n) of a standard Student-t, and uniform numbers that choose a component."""
    uniform = qmc.Sobol(n + 2, rng=np.random.default_rng(0)).random_base2(log2_points)
    uniform = np.clip(uniform, 1e-12, 1.0 - 1e-12)
    step = ndtri(uniform[:, :n])
    if np.isfinite(nu):  # a Student-t is a Gaussian over the root of a chi-squared variable
        step = step / np.sqrt(chdtri(nu, 1.0 - uniform[:, n]) / nu)[:, None]
    return step, uniform[:, n + 1]


def shrunk_moments(
    mixture: Mixture, points: Array, log_weight: Array, *, least: float, wider: float, prior_points: float
) -> Mixture:
    """Mixtures with the moments of their components refitted to weighted points (..., p, n).

    A component with few points stays near where it was: new moments have the weight
    N / (N + prior_points n) against the old ones, N being the effective number of its points.

    log_weight : (..., p).
    least : fraction of the whole that a used component keeps at least.
    wider : factor on the points' standard deviations.
    """
    n = points.shape[-1]
    parts = log_components(mixture, points)
    weight = np.exp(log_weight - log_weight.max(axis=-1, keepdims=True))
    weight /= weight.sum(axis=-1, keepdims=True)
    member = np.exp(parts - log_sum_exp(parts, axis=-2)[..., None, :]) * weight[..., None, :]
    held = member.sum(axis=-1)
    share = np.where(mixture.share > 0.0, np.maximum(held, least), 0.0)
    number = held**2 / np.maximum(np.sum(member**2, axis=-1), 1e-300)
    trust = (number / (number + prior_points * n))[..., None]
    member = member / np.maximum(held, 1e-300)[..., None]
    centre = mixture.centre + trust * (member @ points - mixture.centre)
    away = points[..., None, :, :] - centre[..., :, None, :]
    covariance = np.swapaxes(member[..., None] * away, -1, -2) @ away
    old = mixture.factor @ np.swapaxes(mixture.factor, -1, -2)
    trust = trust[..., None]
    factor = np.linalg.cholesky(trust * wider**2 * covariance + (1.0 - trust) * old)
    share = share / share.sum(axis=-1, keepdims=True)
    return Mixture(share, centre, factor, mixture.degrees_of_freedom)


def log_sum_exp(values: Array, axis: int | tuple[int, ...]) -> Array:
    """log sum exp along axes, -inf where all values are."""
    top = values.max(axis=axis, keepdims=True)
    top = np.where(np.isfinite(top), top, 0.0)
    with np.errstate(divide="ignore"):
        total = np.log(np.sum(np.exp(values - top), axis=axis))
    return np.asarray(total + np.squeeze(top, axis=axis))


# Importance weights with a heavier tail than this have no useful error (Vehtari et al., 2024).
RELIABLE_K = 0.7
# Fewest weights in a tail to which a Pareto density is fitted.
_FEWEST_IN_TAIL = 5


@dataclass(frozen=True, slots=True)
class Weighted:
    """Weighted points of m densities and the integrals of these.

    points : (m, p, n).
    weight : (m, p), normalised in each row.
    log_evidence : (m,) log of the mean weight.
    standard_error : (m,) of it as for independent points, an upper bound for a Sobol sequence.
    effective_size : (m,) (sum w)^2 / sum w^2.
    k_hat : (m,) Pareto shape of the largest weights.
    """

    points: Array
    weight: Array
    log_evidence: Array
    standard_error: Array
    effective_size: Array
    k_hat: Array


def weighted(points: Array, log_ratio: Array) -> Weighted:
    """Points (m, p, n) weighted by the log ratios (m, p) of target density over proposal density.

    Where all ratios of a row are -inf so is its log evidence, and the rest of the row is not a number.
    """
    top = log_ratio.max(axis=1)
    top = np.where(np.isfinite(top), top, 0.0)
    ratio = np.exp(log_ratio - top[:, None])
    mean = ratio.mean(axis=1)
    p = log_ratio.shape[1]
    with np.errstate(divide="ignore", invalid="ignore"):
        return Weighted(
            points=points,
            weight=ratio / ratio.sum(axis=1, keepdims=True),
            log_evidence=top + np.log(mean),
            standard_error=ratio.std(axis=1) / mean / np.sqrt(p),
            effective_size=ratio.sum(axis=1) ** 2 / np.sum(ratio**2, axis=1),
            k_hat=np.array([pareto_shape(row) for row in log_ratio]),
        )


def effective_size(log_weight: Array) -> float:
    """(sum w)^2 / sum w^2 of weights (p,) given by their logarithms."""
    top = float(log_weight.max())
    if not np.isfinite(top):
        return 0.0
    w = np.exp(log_weight - top)
    return float(w.sum() ** 2 / np.sum(w**2))


def pareto_shape(log_weight: Array) -> float:
    """Shape k-hat of a generalised Pareto density fitted to the largest of weights (p,).

    The largest fifth or the 3 sqrt(p) largest, whichever are fewer, by the posterior mean of Zhang and
    Stephens (2009) with the prior of Vehtari et al. (2024, Pareto smoothed importance sampling, eq. 10): 10
    weights of shape 0.5. Infinite where the tail has fewer than five.
    """
    finite = log_weight[np.isfinite(log_weight)]
    n = len(finite)
    n_tail = int(np.ceil(min(n / 5.0, 3.0 * np.sqrt(n))))
    if n_tail < _FEWEST_IN_TAIL:
        return np.inf
    ordered = np.sort(finite) - finite.max()
    cut = max(float(ordered[-n_tail - 1]), float(np.log(np.finfo(float).tiny)))
    tail = np.exp(ordered[ordered > cut]) - np.exp(cut)
    return _generalised_pareto_shape(tail) if len(tail) >= _FEWEST_IN_TAIL else np.inf


def _generalised_pareto_shape(tail: Array) -> float:
    """Shape of a generalised Pareto distribution fitted to exceedances (m,) in ascending order."""
    m = len(tail)
    n_grid = 30 + int(np.sqrt(m))
    b = 1.0 - np.sqrt(n_grid / (np.arange(1, n_grid + 1) - 0.5))
    b = b / (3.0 * tail[int(m / 4 + 0.5) - 1]) + 1.0 / tail[-1]
    k = np.log1p(-b[:, None] * tail).mean(axis=1)
    log_likelihood = m * (np.log(-b / k) - k - 1.0)
    with np.errstate(over="ignore"):
        weight = 1.0 / np.exp(log_likelihood - log_likelihood[:, None]).sum(axis=1)
    kept = weight >= 10.0 * np.finfo(float).eps
    mean = np.sum(b[kept] * weight[kept]) / weight[kept].sum()
    shape = float(np.log1p(-mean * tail).mean())
    return (m * shape + 10.0 * 0.5) / (m + 10.0)
