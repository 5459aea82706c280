"""A positive quantity of which the order of magnitude is known."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from cpam_bayes.priors.densities import Floats, Quantiles, TruncatedNormal

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(64)


@dataclass(frozen=True, slots=True)
class TruncatedLogNormal(Quantiles):
    """A density whose logarithm is normal, cut at bounds.

    median : before the cut
    log_sd : standard deviation of ln x before the cut
    raises ValueError for a median or a lower bound that is not positive, and as ``TruncatedNormal``
    """

    median: float
    log_sd: float
    lower: float
    upper: float

    def __post_init__(self) -> None:
        if not (self.median > 0.0 and self.lower > 0.0 and math.isfinite(self.upper)):
            raise ValueError(f"a log-normal prior: received {self}, accepted: positive and finite values")
        _ = self._of_logarithm

    @property
    def _of_logarithm(self) -> TruncatedNormal:
        ends = (math.log(self.lower), math.log(self.upper))
        return TruncatedNormal(math.log(self.median), self.log_sd, *ends)

    @property
    def mean(self) -> float:
        """Mean within the bounds."""
        return self._moment(1)

    @property
    def sd(self) -> float:
        """Standard deviation within the bounds."""
        return math.sqrt(self._moment(2) - self._moment(1) ** 2)

    def _moment(self, power: int) -> float:
        """E[x^power], by a quadrature over ln x within ten standard deviations of the median."""
        centre, reach = math.log(self.median), 10.0 * self.log_sd
        low, high = max(math.log(self.lower), centre - reach), min(math.log(self.upper), centre + reach)
        edges = np.linspace(low, high, 33)
        half = 0.5 * np.diff(edges)[:, None]
        t = 0.5 * (edges[1:] + edges[:-1])[:, None] + half * _NODES
        density = np.exp(self._of_logarithm.log_density(t) + power * t)
        return float(np.sum(half * _WEIGHTS * density))

    def log_density(self, x: ArrayLike) -> Floats:
        """Log density of x, (...) -> (...), -inf outside the bounds and at NaN."""
        x = np.asarray(x, dtype=float)
        inside = (x >= self.lower) & (x <= self.upper)
        t = np.log(np.where(inside, x, self.median))
        return np.where(inside, self._of_logarithm.log_density(t) - t, -np.inf)

    def sample(self, rng: np.random.Generator, size: int) -> Floats:
        """Independent draws, (size,)."""
        return self._within(np.exp(self._of_logarithm.sample(rng, size)))

    def from_normal(self, z: ArrayLike) -> Floats:
        """x with F(x) = Phi(z), accurate in both tails, (...) -> (...)."""
        return self._within(np.exp(self._of_logarithm.from_normal(z)))

    def to_normal(self, x: ArrayLike) -> Floats:
        """z with Phi(z) = F(x), accurate in both tails, infinite on the bounds, (...) -> (...)."""
        return self._of_logarithm.to_normal(np.log(self._within(np.asarray(x, dtype=float))))

    def _within(self, x: Floats) -> Floats:
        return np.asarray(np.minimum(np.maximum(x, self.lower), self.upper))
