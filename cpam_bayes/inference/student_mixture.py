"""Mixtures of Student-t densities: density, draws, and two ways to fit them to weighted points."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, gammaln, ndtri
from scipy.stats import qmc

Array = NDArray[Any]

# Fraction of the whole that a component keeps at least, and ridge of its scale over that of all points.
_LEAST_FRACTION, _RIDGE = 0.01, 1e-6


@dataclass(frozen=True, slots=True)
class Mixture:
    """A mixture of k Student-t densities of n variables, or a stack of such mixtures.

    share : (..., k) fractions of the whole, zero for components that are not used.
    centre : (..., k, n).
    factor : (..., k, n, n), square roots of the scale matrices: factor factor^T.
    degrees_of_freedom : of all of them, infinite for Gaussians.
    """

    share: Array
    centre: Array
    factor: Array
    degrees_of_freedom: float


def log_student_t(away: Array, factor: Array, nu: float) -> Array:
    """Log density of a multivariate Student-t, or of a Gaussian where nu is infinite, (..., p).

    away : (..., p, n) from the centre.
    factor : (..., n, n) square root of the scale matrix.
    """
    n = away.shape[-1]
    squared = np.sum((away @ np.swapaxes(np.linalg.inv(factor), -1, -2)) ** 2, axis=-1)
    log_det = np.linalg.slogdet(factor)[1][..., None]
    if np.isinf(nu):
        return np.asarray(-0.5 * squared - log_det - 0.5 * n * np.log(2.0 * np.pi))
    constant = gammaln(0.5 * (nu + n)) - gammaln(0.5 * nu) - 0.5 * n * np.log(nu * np.pi)
    return np.asarray(constant - log_det - 0.5 * (nu + n) * np.log1p(squared / nu))


def log_components(mixture: Mixture, points: Array) -> Array:
    """Log of share times density of every component at points (..., p, n), (..., k, p)."""
    away = points[..., None, :, :] - mixture.centre[..., :, None, :]
    with np.errstate(divide="ignore"):
        log_share = np.log(mixture.share)
    return log_share[..., None] + log_student_t(away, mixture.factor, mixture.degrees_of_freedom)


def log_mixture(mixture: Mixture, points: Array) -> Array:
    """Log density at points (..., p, n), (..., p)."""
    return log_sum_exp(log_components(mixture, points), axis=-2)


def log_blend(mixtures: list[Mixture], sizes: list[int], points: Array) -> Array:
    """Log density at points (..., p, n) of what they were drawn from, ``sizes`` from each, (..., p).

    The deterministic mixture of adaptive importance sampling (Cornuet et al., 2012).
    """
    parts = [log_components(m, points) + np.log(size) for m, size in zip(mixtures, sizes, strict=True)]
    return log_sum_exp(np.concatenate(parts, axis=-2), axis=-2) - float(np.log(sum(sizes)))


def draw(mixture: Mixture, size: int, rng: np.random.Generator | np.random.RandomState) -> Array:
    """Independent draws of one mixture, (size, n)."""
    k, n = mixture.centre.shape
    which = rng.choice(k, size=size, p=mixture.share)
    normal = rng.standard_normal((size, n))
    nu = mixture.degrees_of_freedom
    stretch = np.sqrt(nu / rng.chisquare(nu, size=size))
    away = np.einsum("mij,mj->mi", mixture.factor[which], normal)
    return np.asarray(mixture.centre[which] + stretch[:, None] * away)


def sobol_points(mixture: Mixture, log2_points: int, part: slice = slice(None)) -> Array:
    """Points of a stack of mixtures from one scrambled Sobol sequence for all of them, (..., p, n).

    log2_points : of the sequence.
    part : which of its points.
    """
    step, uniform = _standard_points(mixture.centre.shape[-1], log2_points, mixture.degrees_of_freedom)
    below = np.cumsum(mixture.share, axis=-1)[..., None, :-1] < uniform[part, None]
    which = np.sum(below, axis=-1)
    centre = np.take_along_axis(mixture.centre, which[..., None], axis=-2)
    factor = np.take_along_axis(mixture.factor, which[..., None, None], axis=-3)
    return np.asarray(centre + np.einsum("...pij,pj->...pi", factor, step[part]))


@cache
def _standard_points(n: int, log2_points: int, nu: float) -> tuple[Array, Array]:
    """Points of a standard Student-t (2^log2_points, n), and uniform ones that choose a component."""
    uniform = qmc.Sobol(n + 2, rng=np.random.default_rng(0)).random_base2(log2_points)
    uniform = np.clip(uniform, 1e-12, 1.0 - 1e-12)
    step = ndtri(uniform[:, :n])
    if np.isfinite(nu):  # a Student-t is a Gaussian over the root of a chi-squared variable
        step = step / np.sqrt(chdtri(nu, 1.0 - uniform[:, n]) / nu)[:, None]
    return step, uniform[:, n + 1]


def single(points: Array, weights: Array, nu: float) -> Mixture:
    """One component with the mean of weighted points (m, n) and their covariance as its scale."""
    mean = weights @ points
    return Mixture(np.ones(1), mean[None], _factor(_covariance(points, weights, mean))[None], nu)


def split(mixture: Mixture, points: Array, weights: Array, components: int) -> Mixture:
    """A mixture of so many components, the largest of the given ones halved along their longest axis.

    points : (m, n), weights : (m,) that add up to one; they say how far each component reaches.
    """
    while len(mixture.share) < components:
        i = int(np.argmax(mixture.share))
        values, vectors = np.linalg.eigh(mixture.factor[i] @ mixture.factor[i].T)
        scale = np.sqrt(np.diag(_covariance(points, weights, weights @ points)))
        # the longest axis in units of the whole cloud, so that no coordinate's unit decides
        longest = int(np.argmax(np.linalg.norm(vectors * np.sqrt(values) / scale[:, None], axis=0)))
        step = 0.7 * np.sqrt(values[longest]) * vectors[:, longest]
        halves = np.stack((mixture.centre[i] + step, mixture.centre[i] - step))
        rest = np.arange(len(mixture.share)) != i
        mixture = Mixture(
            np.concatenate((mixture.share[rest], np.full(2, 0.5 * mixture.share[i]))),
            np.concatenate((mixture.centre[rest], halves)),
            np.concatenate((mixture.factor[rest], np.stack((mixture.factor[i],) * 2))),
            mixture.degrees_of_freedom,
        )
    return mixture


def fit(mixture: Mixture, points: Array, weights: Array, steps: int = 10) -> Mixture:
    """The mixture that weighted points (m, n) make most probable, next to a given one.

    Expectation maximisation at fixed degrees of freedom (Peel and McLachlan, 2000), for points of an
    importance sample the update of Cappe et al. (2008, Adaptive importance sampling in general mixture
    classes). Components keep a hundredth of the whole at least. For thousands of points; of a hundred,
    ``shrunk_moments`` makes less mistakes.

    weights : (m,) that add up to one.
    """
    nu, n = mixture.degrees_of_freedom, points.shape[1]
    whole = _covariance(points, weights, weights @ points)
    ridge = _RIDGE * np.diag(np.diag(whole))
    for _ in range(steps):
        parts = log_components(mixture, points)
        member = np.exp(parts - log_sum_exp(parts, axis=0)) * weights
        share = member.sum(axis=1)
        centres, factors = [], []
        for k in range(len(share)):
            if share[k] < 1e-8:
                centres.append(mixture.centre[k])
                factors.append(mixture.factor[k])
                continue
            z = (points - mixture.centre[k]) @ np.linalg.inv(mixture.factor[k]).T
            # points in the tails say less about centre and scale
            pull = member[k] * (nu + n) / (nu + np.sum(z**2, axis=1))
            centre = pull @ points / pull.sum()
            away = points - centre
            scale = (pull[:, None] * away).T @ away / share[k]
            centres.append(centre)
            factors.append(_factor(scale + ridge))
        kept = np.maximum(share, _LEAST_FRACTION)
        mixture = Mixture(kept / kept.sum(), np.stack(centres), np.stack(factors), nu)
    return mixture


def shrunk_moments(
    mixture: Mixture, points: Array, log_weight: Array, *, least: float, wider: float, prior_points: float
) -> Mixture:
    """Stacks of mixtures with the moments that a few weighted points (..., p, n) give their components.

    A component stays near where it was if few points speak of it: its moments are weighed as
    N / (N + prior_points n) against the old ones, N being the effective number of its points.

    log_weight : (..., p).
    least : fraction of the whole that a used component keeps.
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


def widened(mixture: Mixture, share: float, factor: float, points: Array, weights: Array) -> Mixture:
    """The mixture with one more component, of a given share, about all points and so many times as wide."""
    safe = single(points, weights, mixture.degrees_of_freedom)
    return Mixture(
        np.append((1.0 - share) * mixture.share, share),
        np.concatenate((mixture.centre, safe.centre)),
        np.concatenate((mixture.factor, factor * safe.factor)),
        mixture.degrees_of_freedom,
    )


def log_sum_exp(values: Array, axis: int) -> Array:
    """log sum exp along an axis, -inf where all are."""
    top = values.max(axis=axis, keepdims=True)
    top = np.where(np.isfinite(top), top, 0.0)
    with np.errstate(divide="ignore"):
        total = np.log(np.sum(np.exp(values - top), axis=axis))
    return np.asarray(total + np.squeeze(top, axis=axis))


def _covariance(points: Array, weights: Array, mean: Array) -> Array:
    away = points - mean
    return np.asarray((weights[:, None] * away).T @ away)


def _factor(scale: Array) -> Array:
    """Cholesky factor of a scale matrix that few points may have left singular."""
    spread = np.diag(np.diag(scale)) + 1e-12 * np.eye(len(scale))
    for ridge in (0.0, 1e-6, 1e-3, 1e-1):
        try:
            return np.asarray(np.linalg.cholesky(scale + ridge * spread))
        except np.linalg.LinAlgError:
            continue
    return np.asarray(np.sqrt(spread))
