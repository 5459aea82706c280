"""Coordinates in which every prior is standard normal: no bounds, flat directions integrated exactly."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.inference.derivatives import Expansion
from cpam_bayes.parameters import ParameterSet

Array = NDArray[Any]

# Scores are cut here: probabilities beyond are rounding.
MAX_SCORE = 7.0
_HALF_LOG_2PI = 0.5 * float(np.log(2.0 * np.pi))


@dataclass(frozen=True, slots=True)
class NormalScores:
    """z with Phi(z) = F(x), F the distribution function of a parameter's prior.

    The density over z is the likelihood times the standard normal density.
    """

    parameters: ParameterSet

    @property
    def lower(self) -> Array:
        """Least scores, (n,)."""
        return np.full(self.parameters.size, -MAX_SCORE)

    @property
    def upper(self) -> Array:
        """Largest scores, (n,)."""
        return np.full(self.parameters.size, MAX_SCORE)

    def to_x(self, z: Array) -> Array:
        """Parameters of scores (..., n), within their bounds."""
        x = np.empty(z.shape)
        # cut, for half-bounded parameters have no finite value at the end
        z = np.clip(z, -MAX_SCORE, MAX_SCORE)
        for i, parameter in enumerate(self.parameters.parameters):
            x[..., i] = parameter.prior.from_normal(z[..., i])
        return x

    def to_z(self, x: Array) -> Array:
        """Scores of parameters (..., n)."""
        z = np.empty(x.shape)
        for i, parameter in enumerate(self.parameters.parameters):
            z[..., i] = parameter.prior.to_normal(x[..., i])
        return np.clip(z, -MAX_SCORE, MAX_SCORE)

    def slope(self, x: Array, z: Array) -> Array:
        """d x / d z, (..., n): the density of the standard normal over that of the prior."""
        log_density = np.empty(x.shape)
        for i, parameter in enumerate(self.parameters.parameters):
            log_density[..., i] = parameter.prior.log_density(x[..., i])
        return np.asarray(np.exp(-0.5 * z**2 - _HALF_LOG_2PI - log_density))

    def log_prior(self, z: Array) -> Array:
        """Log prior density over scores (..., n), (...)."""
        return np.asarray(-0.5 * np.sum(z**2, axis=-1) - z.shape[-1] * _HALF_LOG_2PI)

    def with_prior(self, likelihood: Expansion, x: Array, z: Array) -> Expansion:
        """The log posterior density over scores z (m, n), from the log likelihood over parameters x (m, n).

        The standard normal prior has the gradient -z and the curvature 1.
        """
        slope = self.slope(x, z)
        curvature = likelihood.curvature * slope[:, :, None] * slope[:, None, :] + np.eye(z.shape[1])
        return Expansion(likelihood.value + self.log_prior(z), likelihood.gradient * slope - z, curvature)
