"""Normal scores of parameters, in which every prior is standard normal, and expansions of log densities.

Scores have no bounds, and flat directions are integrated exactly.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cpam_bayes.mechanics.problem import Array
from cpam_bayes.parameters import ParameterSet
from cpam_bayes.priors import Priors


@dataclass(frozen=True, slots=True)
class Expansion:
    """Log density of m points with its derivatives.

    value : (m,), -inf outside the support, where the derivatives are zero.
    gradient : (m, n).
    curvature : (m, n, n), positive semidefinite: the negative Hessian without the second derivatives of the
    frequencies, averaged over the data.
    """

    value: Array
    gradient: Array
    curvature: Array

    def of(self, rows: Array) -> Expansion:
        """Expansion of some of the points."""
        return Expansion(self.value[rows], self.gradient[rows], self.curvature[rows])

    def without_prior(self, z: Array, weight: Array) -> Expansion:
        """Density over scores z (m, n) without fractions ``weight`` (n,) of their standard normal priors."""
        return Expansion(
            self.value + 0.5 * np.sum(weight * z**2, axis=1),
            self.gradient + weight * z,
            self.curvature - np.diag(weight),
        )


_HALF_LOG_2PI = 0.5 * float(np.log(2.0 * np.pi))


@dataclass(frozen=True)
class NormalScores:
    """z with Phi(L z) = F(x), F the distribution functions of the parameters' priors, L their `root`.

    The density over z is the likelihood times the standard normal density.
    """

    parameters: ParameterSet

    @cached_property
    def _priors(self) -> Priors:
        return Priors(tuple(p.prior for p in self.parameters.parameters))

    @property
    def lower(self) -> Array:
        """Least scores, (n,)."""
        return -self.upper

    @property
    def upper(self) -> Array:
        """Largest scores, (n,)."""
        return self._priors.reach

    def to_x(self, z: Array) -> Array:
        """Parameters of scores (..., n), within their bounds."""
        # cut, since half-bounded parameters have no finite value at the end
        return self._priors.from_normal(self._cut(self._coupled(z)))

    def to_z(self, x: Array) -> Array:
        """Scores of parameters (..., n)."""
        z = self._cut(self._priors.to_normal(x))
        if self.parameters.root is None:
            return z
        return self._cut(z @ np.linalg.inv(self.parameters.root).T)

    def _cut(self, z: Array) -> Array:
        return np.asarray(np.minimum(np.maximum(z, self.lower), self.upper))

    def _coupled(self, z: Array) -> Array:
        root = self.parameters.root
        return z if root is None else np.asarray(z @ root.T)

    def of_each(self, x: Array) -> tuple[Array, Array]:
        """Scores of parameters (..., n) as if these were independent, and their slopes, (..., n)."""
        v = self._cut(self._priors.to_normal(x))
        return v, np.exp(self._priors.log_densities(x) + 0.5 * v**2 + _HALF_LOG_2PI)

    def by_score(self, slope: Array, x: Array, z: Array) -> Array:
        """Derivatives over scores from those over parameters (..., k, n), at parameters and scores (..., n).

        d x_i / d z_j = L_ij phi(v_i) / p_i(x_i), v = L z, p_i the density of the prior.
        """
        scaled, root = slope * self.slope(x, z)[..., None, :], self.parameters.root
        return np.asarray(scaled if root is None else scaled @ root)

    def slope(self, x: Array, z: Array) -> Array:
        """Slopes (..., n) of parameters over their own scores L z: the normal density over the prior's."""
        log_density, own = self._priors.log_densities(x), self._coupled(z)
        if self.parameters.root is not None:
            own = self._cut(own)
        return np.asarray(np.exp(-0.5 * own**2 - _HALF_LOG_2PI - log_density))

    def log_prior(self, z: Array) -> Array:
        """Log prior density (...) over scores (..., n)."""
        return np.asarray(-0.5 * np.sum(z**2, axis=-1) - z.shape[-1] * _HALF_LOG_2PI)

    def with_prior(self, likelihood: Expansion, x: Array, z: Array) -> Expansion:
        """Log posterior density over scores z (m, n), from the log likelihood over parameters x (m, n).

        The standard normal prior has the gradient -z and the curvature 1.
        """
        slope, root = self.slope(x, z), self.parameters.root
        gradient = likelihood.gradient * slope
        curvature = likelihood.curvature * slope[:, :, None] * slope[:, None, :]
        if root is not None:
            gradient, curvature = gradient @ root, root.T @ curvature @ root
        curvature = curvature + np.eye(z.shape[1])
        return Expansion(likelihood.value + self.log_prior(z), gradient - z, curvature)


def distinct(
    z: Array, value: Array, curvature: Array, distance: float, *, depth: float = np.inf, drop: float = np.inf
) -> Array:
    """Index (..., k) of the optimum that each of the ends (..., k, n) of optimisations belongs to.

    An optimum has its own index. A lower end within ``distance`` standard deviations of it, by its curvature
    (..., k, n, n), is a copy, unless it is lower by more than ``drop``. Ends without a density, and those
    lower than the best by more than ``depth``, have -1.

    value : (..., k), log density, or any order of precedence
    """
    shape, (k, n) = value.shape, z.shape[-2:]
    z, value, curvature = z.reshape(-1, k, n), value.reshape(-1, k), curvature.reshape(-1, k, n, n)
    top = value.max(axis=1, keepdims=True)
    open_ones = np.isfinite(value) & (value >= np.where(np.isfinite(top), top, 0.0) - depth)
    found, row = np.full(value.shape, -1), np.arange(len(value))
    order = np.argsort(-np.where(np.isfinite(value), value, -np.inf), axis=1, kind="stable")
    for best in order.T:
        is_optimum = open_ones[row, best]
        if not is_optimum.any():
            continue
        away = z - z[row, best][:, None]
        near = np.sum((away @ curvature[row, best]) * away, axis=2) <= distance**2
        if np.isfinite(drop):
            near &= value[row, best][:, None] - value < drop
        near[row, best] = True
        near &= open_ones & is_optimum[:, None]
        found = np.where(near, best[:, None], found)
        open_ones &= ~near
    return found.reshape(shape)


def best_of_distinct(
    z: Array, value: Array, curvature: Array, distance: float, most: int | None = None
) -> list[int]:
    """Indices of the optima among ends (k, n), the best first, ``most`` at most; as of `distinct`."""
    numbers = np.flatnonzero(distinct(z, value, curvature, distance) == np.arange(len(z)))
    return [int(i) for i in numbers[np.argsort(-value[numbers], kind="stable")][:most]]
