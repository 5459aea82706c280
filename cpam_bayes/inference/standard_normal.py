"""Coordinates in which the priors are standard normal: no bounds, and no scale for the data to learn."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from cpam_bayes.inference.derivatives import Expansion
from cpam_bayes.inference.posterior import Posterior
from cpam_bayes.parameters import TruncatedNormal, Uniform

Array = NDArray[Any]

# Scores beyond are rounding.
_FARTHEST = 7.0


@dataclass(frozen=True, slots=True)
class NormalScores:
    """z = ndtri(F(x)), F the distribution function of a parameter's prior; log x for other priors.

    The density over z is that of the parameters times dx/dz: for the scores the standard normal times
    the likelihood.

    low, high : (n,) distribution function of the normal at the cuts of a truncated normal prior, or 0
    and 1. loc, scale : (n,) of the normal; of a uniform prior its lower bound and width. normal, logged :
    (n,) bool. lower, upper : (n,) bounds of z.
    """

    low: Array
    high: Array
    loc: Array
    scale: Array
    normal: Array
    logged: Array
    lower: Array
    upper: Array

    def to_x(self, z: Array) -> Array:
        """Parameter vectors of scores (..., n)."""
        share = self.low + (self.high - self.low) * ndtr(z)
        with np.errstate(invalid="ignore"):
            inner = np.where(self.normal, ndtri(share), share)
        return np.asarray(np.where(self.logged, np.exp(z * self.logged), self.loc + self.scale * inner))

    def to_z(self, x: Array) -> Array:
        """Scores of parameter vectors (..., n) within the bounds."""
        inner = (x - self.loc) / self.scale
        share = (np.where(self.normal, ndtr(inner), inner) - self.low) / (self.high - self.low)
        with np.errstate(invalid="ignore", divide="ignore"):
            scores = np.where(self.logged, np.log(np.where(self.logged, x, 1.0)), ndtri(share))
        return np.asarray(np.clip(scores, self.lower, self.upper))

    def slope(self, x: Array, z: Array) -> Array:
        """d x / d z, (..., n)."""
        density = np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi)
        inner = (x - self.loc) / self.scale
        own = np.where(self.normal, np.exp(-0.5 * inner**2) / np.sqrt(2 * np.pi), 1.0)
        return np.asarray(
            np.where(self.logged, x, self.scale * (self.high - self.low) * density / np.maximum(own, 1e-300))
        )

    def log_density(self, posterior: Posterior, z: Array) -> Array:
        """Log posterior density over scores (m, n), -inf outside the support, but for the evidence."""
        x = self.to_x(z)
        inside = np.all((z >= self.lower) & (z <= self.upper), axis=1)
        found = np.full(len(z), -np.inf)
        rows = np.flatnonzero(inside)
        found[rows] = posterior.log_prob(x[rows]) + np.log(self.slope(x[rows], z[rows])).sum(axis=1)
        return found

    def carried(self, e: Expansion, x: Array, z: Array) -> tuple[Array, Array, Array]:
        """Value, gradient and curvature over scores of an expansion over parameters x (m, n).

        The priors' own part is put in its closed form: -z in the gradient, 1 in the curvature.
        """
        slope = self.slope(x, z)
        value = e.value + np.log(slope).sum(axis=1)
        gradient = e.gradient * slope + np.where(self.logged, 1.0, 0.0)
        gradient = np.where(self.logged, gradient, gradient - self._prior_slope(x) * slope - z)
        curvature = e.curvature * slope[:, :, None] * slope[:, None, :]
        bend = np.where(self.logged, 0.0, 1.0 - self._prior_bend() * slope**2)
        return value, gradient, curvature + bend[..., None] * np.eye(x.shape[1])

    def _prior_slope(self, x: Array) -> Array:
        return np.asarray(np.where(self.normal, -(x - self.loc) / self.scale**2, 0.0))

    def _prior_bend(self) -> Array:
        return np.asarray(np.where(self.normal, 1.0 / self.scale**2, 0.0))


def normal_scores(posterior: Posterior) -> NormalScores:
    """The normal scores of a posterior's parameters."""
    columns: list[tuple[float, ...]] = []
    for parameter in posterior.parameters.parameters:
        p = parameter.prior
        if isinstance(p, Uniform):
            columns.append((0.0, 1.0, p.lower, p.upper - p.lower, 0, 0, -_FARTHEST, _FARTHEST))
        elif isinstance(p, TruncatedNormal):
            a, b = (float(ndtr((v - p.loc) / p.scale)) for v in (p.lower, p.upper))
            columns.append((a, b, p.loc, p.scale, 1, 0, -_FARTHEST, _FARTHEST))
        else:
            columns.append((0.0, 1.0, 0.0, 1.0, 0, 1, float(np.log(p.lower)), float(np.log(p.upper))))
    low, high, loc, scale, normal, logged, lower, upper = (np.array(c) for c in zip(*columns, strict=True))
    return NormalScores(low, high, loc, scale, normal.astype(bool), logged.astype(bool), lower, upper)
