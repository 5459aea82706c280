"""Gaussian-process regression of a few smooth functions of the same points, with derivatives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.optimize import minimize

Array = NDArray[Any]

# Points that length scales are estimated from: more change them little.
_SCALES_FROM = 400
# Bounds of the length scales in standard deviations of the points, and of the nugget's variance; its start.
_LENGTHS, _NUGGETS, _NUGGET = (0.2, 200.0), (1e-8, 0.3), 1e-4
# Growth of the number of points from which on length scales are estimated again.
_GROWTH = 1.25
# Points predicted at a time: their kernel stays in the processor's cache.
_ROWS = 128


@dataclass(frozen=True, slots=True)
class GaussianProcess:
    """f(x) = mean + sum_i k(x, x_i) a_i, outputs in columns.

    k(x, y) = sum_s exp(-|(s x - y) / l|^2 / 2), the sum over the changes of sign under which
    f(s x) = f(x), the identity among them.

    points : (N, d) in units of the length scales.
    coefficients : (N, p).
    mean : (p,).
    lengths : (d,) length scales.
    images : (n_images, d) signs, the first row all ones.
    factor : (N, N) lower Cholesky factor of the points' covariance.
    amplitude : (p,) prior standard deviations of the functions.
    nugget : variance of what is not smooth, relative to that.
    training_size : points that the length scales were estimated from.
    """

    points: Array
    coefficients: Array
    mean: Array
    lengths: Array
    images: Array
    factor: Array
    amplitude: Array
    nugget: float
    training_size: int

    def values(self, x: Array) -> Array:
        """The functions at points (m, d), (m, p)."""
        value = np.empty((len(x), len(self.mean)))
        for i in range(0, len(x), _ROWS):
            at = x[i : i + _ROWS] / self.lengths
            value[i : i + _ROWS] = sum(_kernel(at * s, self.points) for s in self.images) @ self.coefficients
        return value + self.mean

    def error(self, x: Array) -> Array:
        """Standard deviations of the functions at points (m, d), given the values, (m, p)."""
        at = x / self.lengths
        prior = sum(np.exp(-0.5 * np.sum((at * s - at) ** 2, axis=1)) for s in self.images)
        covariance = np.sum([_kernel(at * s, self.points) for s in self.images], axis=0)
        explained = scipy.linalg.solve_triangular(self.factor, covariance.T, lower=True)
        variance = np.maximum(prior - np.sum(explained**2, axis=0), 0.0)
        return np.asarray(np.sqrt(variance)[:, None] * self.amplitude)

    def expansion(self, x: Array) -> tuple[Array, Array]:
        """The functions and their gradients at points (m, d), (m, p) and (m, p, d)."""
        p, d = self.coefficients.shape[1], x.shape[1]
        weighted = (self.coefficients[:, :, None] * self.points[:, None, :]).reshape(len(self.points), -1)
        both = np.column_stack((self.coefficients, weighted))
        value, slope = np.zeros((len(x), p)), np.zeros((len(x), p, d))
        for i in range(0, len(x), _ROWS):
            at = x[i : i + _ROWS] / self.lengths
            for sign in self.images:
                image = at * sign
                sums = _kernel(image, self.points) @ both
                value[i : i + _ROWS] += sums[:, :p]
                moment = sums[:, p:].reshape(len(at), p, d)
                slope[i : i + _ROWS] += (moment - sums[:, :p, None] * image[:, None, :]) * sign / self.lengths
        return value + self.mean, slope


def fit_gaussian_process(
    points: Array,
    values: Array,
    rng: np.random.Generator,
    images: Array | None = None,
    like: GaussianProcess | None = None,
    min_lengths: Array | float = _LENGTHS[0],
    nugget_factor: Array | None = None,
) -> GaussianProcess:
    """The process through values (N, p) at points (N, d), length scales by the largest marginal likelihood.

    One set of length scales, one per dimension, and one nugget serve all outputs, each in units of its
    standard deviation (Rasmussen and Williams, Gaussian Processes for Machine Learning, 2006, chapters 2, 5).

    images : (n_images, d) changes of sign that leave the functions as they are, the identity first.
    like : a process through fewer points, whose length scales are a start.
    min_lengths : (d,) lower bounds of the length scales in standard deviations of the points.
    nugget_factor : (N,) factors on the nugget, 1 where a value is to be met.
    """
    n, d = points.shape
    factors = np.ones(n) if nugget_factor is None else nugget_factor
    signs = np.ones((1, d)) if images is None else images
    unit = np.maximum(points.std(axis=0), 1e-12)
    mean, spread = values.mean(axis=0), np.maximum(values.std(axis=0), 1e-12)
    y = (values - mean) / spread
    some = _scale_points(factors, rng)
    if like is not None and n < _GROWTH * like.training_size:
        lengths, nugget, training_size = like.lengths, like.nugget, like.training_size
    else:
        lengths, nugget = _scales(points[some] / unit, y[some], factors[some], signs, like, unit, min_lengths)
        training_size = n
    at = points / lengths
    matrix = np.sum([_kernel(at * s, at) for s in signs], axis=0)
    matrix[np.diag_indices(n)] += nugget * factors
    factor = scipy.linalg.cholesky(matrix, lower=True, overwrite_a=True)
    solved = scipy.linalg.cho_solve((factor, True), y)
    amplitude = spread * np.sqrt(np.sum(y * solved, axis=0) / n)
    return GaussianProcess(
        at, solved * spread, mean, lengths, signs, factor, amplitude, nugget, training_size
    )


def _scale_points(nugget_factor: Array, rng: np.random.Generator) -> Array:
    """Points that length scales are estimated from: any, but half of them with the least nuggets."""
    some = rng.permutation(len(nugget_factor))
    surest = some[np.argsort(nugget_factor[some], kind="stable")[: _SCALES_FROM // 2]]
    return np.concatenate((surest, some[~np.isin(some, surest)]))[:_SCALES_FROM]


def _scales(
    points: Array,
    y: Array,
    nugget_factor: Array,
    signs: Array,
    like: GaussianProcess | None,
    unit: Array,
    min_lengths: Array | float,
) -> tuple[Array, float]:
    """Length scales (d,) and nugget with the largest marginal likelihood, points (N, d) being in ``unit``."""
    d = points.shape[1]
    start = np.full(d, 2.0) if like is None else like.lengths / unit
    shortest = np.broadcast_to(min_lengths, d)
    start = np.clip(start, shortest, _LENGTHS[1])
    bounds = [(np.log(a), np.log(_LENGTHS[1])) for a in shortest]
    bounds.append((np.log(_NUGGETS[0]), np.log(_NUGGETS[1])))
    optimum = minimize(
        _cost,
        np.log(np.concatenate((start, [_NUGGET]))),
        args=(points, y, nugget_factor, signs),
        jac=True,
        bounds=bounds,
        method="L-BFGS-B",
        options={"maxiter": 60 if like is None else 15},
    )
    return np.exp(optimum.x[:d]) * unit, float(np.exp(optimum.x[d]))


def _kernel(a: Array, b: Array) -> Array:
    """exp(-|a - b|^2 / 2) of rows (m, d) and (n, d), (m, n): the exponent is one product."""
    left = np.column_stack((a, -0.5 * np.sum(a**2, axis=1), np.ones(len(a))))
    right = np.column_stack((b, np.ones(len(b)), -0.5 * np.sum(b**2, axis=1)))
    exponent = left @ right.T
    np.minimum(exponent, 0.0, out=exponent)
    return np.asarray(np.exp(exponent, out=exponent))


def _cost(
    log_scales: Array, points: Array, y: Array, nugget_factor: Array, signs: Array
) -> tuple[float, Array]:
    """Negative log marginal likelihood, each output's amplitude at its best, and its gradient."""
    n, p = y.shape
    d = points.shape[1]
    at = points / np.exp(log_scales[:d])
    nugget = np.exp(log_scales[d])
    images = [at * s for s in signs]
    kernels = [_kernel(image, at) for image in images]
    matrix = np.sum(kernels, axis=0)
    matrix[np.diag_indices(n)] += nugget * nugget_factor
    try:
        factor = scipy.linalg.cho_factor(matrix, lower=True)
    except np.linalg.LinAlgError:
        return 1e10, np.zeros(d + 1)
    alpha = scipy.linalg.cho_solve(factor, y)
    amplitude = np.maximum(np.sum(y * alpha, axis=0) / n, 1e-300)
    half = np.log(np.diagonal(factor[0])).sum()
    cost = 0.5 * n * np.log(amplitude).sum() + p * half
    inverse = scipy.linalg.cho_solve(factor, np.eye(n))
    weight = (p * inverse - (alpha / amplitude) @ alpha.T) * 0.5
    gradient = np.empty(d + 1)
    for j in range(d):
        gradient[j] = sum(
            np.sum(weight * k * (image[:, None, j] - at[None, :, j]) ** 2)
            for image, k in zip(images, kernels, strict=True)
        )
    gradient[d] = np.diagonal(weight) @ nugget_factor * nugget
    return float(cost), gradient
