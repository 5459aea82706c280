"""Gaussian-process regression of a few smooth functions of the same points, with derivatives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.optimize import minimize

Array = NDArray[Any]

# Points from which length scales are learned: more change them little.
_LEARNED_FROM = 400
# Bounds of the length scales in standard deviations of the points, and of the nugget's variance.
_LENGTHS, _NUGGETS = (0.2, 200.0), (1e-8, 0.3)
_ROWS = 2048


@dataclass(frozen=True, slots=True)
class SmoothMap:
    """f(x) = mean + sum_i k(x, x_i) a_i, outputs in columns.

    k(x, y) = exp(-|(x - y) / l|^2 / 2); with a mirror s, where f(x) = f(s x), that plus
    exp(-|(s x - y) / l|^2 / 2).

    points : (N, d) in units of the length scales. coefficients : (N, p). mean : (p,). lengths : (d,).
    mirror : (d,) signs, or ``None``.
    """

    points: Array
    coefficients: Array
    mean: Array
    lengths: Array
    mirror: Array | None

    def values(self, x: Array) -> Array:
        """The functions at points (m, d), (m, p)."""
        found = np.empty((len(x), len(self.mean)))
        for i in range(0, len(x), _ROWS):
            at = x[i : i + _ROWS] / self.lengths
            found[i : i + _ROWS] = sum(_kernel(a, self.points) for a in self._images(at)) @ self.coefficients
        return found + self.mean

    def expansion(self, x: Array) -> tuple[Array, Array]:
        """The functions and their gradients at points (m, d), (m, p) and (m, p, d)."""
        p, d = self.coefficients.shape[1], x.shape[1]
        weighted = (self.coefficients[:, :, None] * self.points[:, None, :]).reshape(len(self.points), -1)
        both = np.column_stack((self.coefficients, weighted))
        value, slope = np.zeros((len(x), p)), np.zeros((len(x), p, d))
        for i in range(0, len(x), _ROWS):
            at = x[i : i + _ROWS] / self.lengths
            for image, sign in zip(self._images(at), (1.0, self.mirror), strict=False):
                sums = _kernel(image, self.points) @ both
                value[i : i + _ROWS] += sums[:, :p]
                moment = sums[:, p:].reshape(len(at), p, d)
                slope[i : i + _ROWS] += (moment - sums[:, :p, None] * image[:, None, :]) * sign / self.lengths
        return value + self.mean, slope

    def _images(self, at: Array) -> tuple[Array, ...]:
        return (at,) if self.mirror is None else (at, at * self.mirror)


def fit_map(points: Array, values: Array, rng: np.random.Generator, mirror: Array | None = None) -> SmoothMap:
    """The map through values (N, p) at points (N, d), length scales by the largest marginal likelihood.

    One set of length scales, one per dimension, and one nugget serve all outputs, each in units of its
    own spread (Rasmussen and Williams, Gaussian Processes for Machine Learning, 2006, chapters 2, 5).
    """
    n, d = points.shape
    unit = np.maximum(points.std(axis=0), 1e-12)
    mean, spread = values.mean(axis=0), np.maximum(values.std(axis=0), 1e-12)
    y = (values - mean) / spread
    some = rng.permutation(n)[:_LEARNED_FROM]
    start = np.log(np.concatenate((np.full(d, 2.0), [1e-4])))
    bounds = [(np.log(_LENGTHS[0]), np.log(_LENGTHS[1]))] * d + [(np.log(_NUGGETS[0]), np.log(_NUGGETS[1]))]
    found = minimize(
        _cost,
        start,
        args=(points[some] / unit, y[some], mirror),
        jac=True,
        bounds=bounds,
        method="L-BFGS-B",
        options={"maxiter": 60},
    )
    lengths, nugget = np.exp(found.x[:d]) * unit, np.exp(found.x[d])
    at = points / lengths
    matrix = _kernel(at, at) if mirror is None else _kernel(at, at) + _kernel(at * mirror, at)
    matrix[np.diag_indices(n)] += nugget
    solved = scipy.linalg.cho_solve(scipy.linalg.cho_factor(matrix, lower=True, overwrite_a=True), y)
    return SmoothMap(at, solved * spread, mean, lengths, mirror)


def _kernel(a: Array, b: Array) -> Array:
    squared = np.sum(a**2, axis=1)[:, None] + np.sum(b**2, axis=1)[None, :] - 2.0 * (a @ b.T)
    np.maximum(squared, 0.0, out=squared)
    squared *= -0.5
    return np.asarray(np.exp(squared, out=squared))


def _cost(log_scales: Array, points: Array, y: Array, mirror: Array | None) -> tuple[float, Array]:
    """Negative log marginal likelihood, each output's amplitude at its best, and its gradient."""
    n, p = y.shape
    d = points.shape[1]
    at = points / np.exp(log_scales[:d])
    nugget = np.exp(log_scales[d])
    images = (at,) if mirror is None else (at, at * mirror)
    kernels = [_kernel(image, at) for image in images]
    matrix = np.sum(kernels, axis=0)
    matrix[np.diag_indices(n)] += nugget
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
    gradient[d] = np.trace(weight) * nugget
    return float(cost), gradient
