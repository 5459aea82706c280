"""Mixtures of Student-t densities: density, draws, and the fit to weighted points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.inference.truncated import log_student_t

Array = NDArray[Any]

# Share of the whole that a component keeps at least, and ridge of its scale over that of all points.
_LEAST_SHARE, _RIDGE = 0.01, 1e-6


@dataclass(frozen=True, slots=True)
class Mixture:
    """A mixture of k Student-t densities of n variables.

    share : (k,) of the whole. centre : (k, n). factor : (k, n, n), lower Cholesky factors of the scale
    matrices. degrees_of_freedom : of all of them.
    """

    share: Array
    centre: Array
    factor: Array
    degrees_of_freedom: float


def log_components(mixture: Mixture, v: Array) -> Array:
    """Log of share times density of every component at points (m, n), (m, k)."""
    own = [
        log_student_t(v, c, f, mixture.degrees_of_freedom)
        for c, f in zip(mixture.centre, mixture.factor, strict=True)
    ]
    return np.stack(own, axis=1) + np.log(mixture.share)


def log_mixture(mixture: Mixture, v: Array) -> Array:
    """Log density at points (m, n), (m,)."""
    return log_sum_exp(log_components(mixture, v), axis=1)


def draw(mixture: Mixture, size: int, rng: np.random.Generator | np.random.RandomState) -> Array:
    """Independent draws, (size, n)."""
    k, n = mixture.centre.shape
    which = rng.choice(k, size=size, p=mixture.share)
    normal = rng.standard_normal((size, n))
    nu = mixture.degrees_of_freedom
    stretch = np.sqrt(nu / rng.chisquare(nu, size=size))
    away = np.einsum("mij,mj->mi", mixture.factor[which], normal)
    return np.asarray(mixture.centre[which] + stretch[:, None] * away)


def single(points: Array, weights: Array, nu: float) -> Mixture:
    """One component with the mean of weighted points (m, n) and their covariance as its scale."""
    mean = weights @ points
    return Mixture(np.ones(1), mean[None], _factor(_covariance(points, weights, mean))[None], nu)


def split(mixture: Mixture, points: Array, weights: Array, components: int) -> Mixture:
    """A mixture of so many components, the widest shares of the given one halved along their longest axis.

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
    classes). Components keep a share of a hundredth at least.

    weights : (m,) that add up to one.
    """
    nu, n = mixture.degrees_of_freedom, points.shape[1]
    whole = _covariance(points, weights, weights @ points)
    ridge = _RIDGE * np.diag(np.diag(whole))
    for _ in range(steps):
        parts = log_components(mixture, points)
        member = np.exp(parts - log_sum_exp(parts, axis=1)[:, None]) * weights[:, None]
        share = member.sum(axis=0)
        centres, factors = [], []
        for k in range(len(share)):
            z = (points - mixture.centre[k]) @ np.linalg.inv(mixture.factor[k]).T
            # points in the tails say less about centre and scale
            pull = member[:, k] * (nu + n) / (nu + np.sum(z**2, axis=1))
            if share[k] < 1e-8:
                centres.append(mixture.centre[k])
                factors.append(mixture.factor[k])
                continue
            centre = pull @ points / pull.sum()
            away = points - centre
            scale = (pull[:, None] * away).T @ away / share[k]
            centres.append(centre)
            factors.append(_factor(scale + ridge))
        kept = np.maximum(share, _LEAST_SHARE)
        mixture = Mixture(kept / kept.sum(), np.stack(centres), np.stack(factors), nu)
    return mixture


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
        found = np.log(np.sum(np.exp(values - top), axis=axis))
    return np.asarray(found + np.squeeze(top, axis=axis))


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
