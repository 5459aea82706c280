"""The likelihood of a hypothesis: measured lists against its model, in normal scores."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.diagnosis.composed import ComposedModel
from cpam_bayes.inference.derivatives import Expansion
from cpam_bayes.inference.standard_normal import NormalScores
from cpam_bayes.parameters import ParameterSet

Array = NDArray[Any]


@dataclass(frozen=True, slots=True)
class Listed:
    """Measured frequencies of all lists and their noise.

    sigma_i^2 = variance_i + (a scale_i)^2 + (tau f_i)^2, with the amplitude a where it is inferred and
    the discrepancy tau where a hypothesis has one. log_constant : log probability of what the model does
    not predict, false peaks for instance.

    frequencies, variance, scale : (n,) Hz, Hz^2, Hz; scale is zero where the noise is given.
    """

    frequencies: Array
    variance: Array
    scale: Array
    log_constant: float = 0.0

    def without(self, i: int) -> Listed:
        """The list less one frequency."""
        kept = np.arange(len(self.frequencies)) != i
        return Listed(self.frequencies[kept], self.variance[kept], self.scale[kept], self.log_constant)


def kept_of(whole: Array, listed: Array) -> Array:
    """Which frequencies (n,) of a list are in a shorter one of the same order, bool.

    Equal frequencies are told apart by their order.
    """
    kept, at = np.zeros(len(whole), dtype=bool), 0
    for i, f in enumerate(whole):
        if at < len(listed) and f == listed[at]:
            kept[i], at = True, at + 1
    return kept


@dataclass(frozen=True, slots=True)
class Comparison:
    """A model against lists.

    parameters : those of the model, then those of the noise.
    noise, discrepancy : columns of a and tau, or ``None``.
    left_out : a frequency of the model that the list lacks on purpose, or ``None``.
    """

    model: ComposedModel
    listed: Listed
    parameters: ParameterSet
    scores: NormalScores
    noise: int | None
    discrepancy: int | None
    left_out: int | None = None

    def predict(self, x: Array, *, jacobian: bool = False) -> tuple[Array, Array | None]:
        """Frequencies (m, n_f) of the list at parameters (m, n), derivatives over these."""
        prediction = self.model.predict(x, jacobian=jacobian)
        f, slope = prediction.frequencies, prediction.jacobian
        if self.left_out is not None:
            kept = np.arange(f.shape[1]) != self.left_out
            f, slope = f[:, kept], None if slope is None else slope[:, kept]
        if slope is not None and x.shape[1] > slope.shape[2]:
            further = np.zeros((*slope.shape[:2], x.shape[1] - slope.shape[2]))
            slope = np.concatenate((slope, further), axis=2)
        return f, slope

    def variance(self, x: Array) -> Array:
        """sigma^2 of every frequency at parameters (m, n), (m, n_f) Hz^2."""
        variance = np.broadcast_to(self.listed.variance, (len(x), len(self.listed.variance)))
        if self.noise is not None:
            variance = variance + (x[:, self.noise, None] * self.listed.scale) ** 2
        if self.discrepancy is not None:
            variance = variance + (x[:, self.discrepancy, None] * self.listed.frequencies) ** 2
        return variance

    def log_likelihood(self, x: Array) -> Array:
        """Log likelihood at parameters (m, n), -inf where the constraints (9) are broken, (m,)."""
        value = np.full(len(x), -np.inf)
        inside = np.flatnonzero(self.model.admissible(x))
        if len(inside):
            f, _ = self.predict(x[inside])
            variance = self.variance(x[inside])
            value[inside] = self._gaussian(self.listed.frequencies - f, variance)
        return value

    def log_density(self, z: Array) -> Array:
        """Log of likelihood times prior density over scores (m, n), (m,)."""
        return self.scores.log_prior(z) + self.log_likelihood(self.scores.to_x(z))

    def expand(self, z: Array) -> Expansion:
        """Log density over scores (m, n), its gradient, and its curvature with the Fisher information."""
        m, n = z.shape
        x = self.scores.to_x(z)
        value, gradient, curvature = np.full(m, -np.inf), np.zeros((m, n)), np.zeros((m, n, n))
        inside = np.flatnonzero(self.model.admissible(x))
        if len(inside):
            f, slope = self.predict(x[inside], jacobian=True)
            assert slope is not None
            variance = self.variance(x[inside])
            r = self.listed.frequencies - f
            log_sigma = self._log_sigma_slope(x[inside], variance)
            value[inside] = self._gaussian(r, variance)
            gradient[inside] = np.einsum("mi,mij->mj", r / variance, slope)
            gradient[inside] += np.einsum("mi,mij->mj", r**2 / variance - 1.0, log_sigma)
            weighted = slope / np.sqrt(variance)[..., None]
            curvature[inside] = np.swapaxes(weighted, 1, 2) @ weighted
            curvature[inside] += 2.0 * np.swapaxes(log_sigma, 1, 2) @ log_sigma
        return self.scores.with_prior(Expansion(value, gradient, curvature), x, z)

    def _gaussian(self, r: Array, variance: Array) -> Array:
        log_density = -0.5 * np.sum(r**2 / variance + np.log(2 * np.pi * variance), axis=1)
        return np.asarray(log_density + self.listed.log_constant)

    def _log_sigma_slope(self, x: Array, variance: Array) -> Array:
        """d ln sigma_i / d x_j, (m, n_f, n)."""
        slope = np.zeros((*variance.shape, x.shape[1]))
        for column, scale in ((self.noise, self.listed.scale), (self.discrepancy, self.listed.frequencies)):
            if column is not None:
                slope[:, :, column] = x[:, column, None] * scale**2 / variance
        return slope
