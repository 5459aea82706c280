"""A positive quantity of which the order of magnitude is known, or its range alone."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from cpam_bayes.priors.densities import Floats, Quantiles, TruncatedNormal, Uniform

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


@dataclass(frozen=True, slots=True)
class LogUniform(Quantiles):
    """A density whose logarithm is uniform: all orders of magnitude between two bounds alike.

    raises ValueError for a lower bound that is not positive, and as ``Uniform``
    """

    lower: float
    upper: float

    def __post_init__(self) -> None:
        if not self.lower > 0.0:
            raise ValueError(f"a log-uniform prior: received {self}, accepted: a positive lower bound")
        _ = self._of_logarithm

    @property
    def _of_logarithm(self) -> Uniform:
        return Uniform(math.log(self.lower), math.log(self.upper))

    @property
    def mean(self) -> float:
        """Mean, (b - a) / ln(b / a)."""
        return (self.upper - self.lower) / math.log(self.upper / self.lower)

    @property
    def sd(self) -> float:
        """Standard deviation, from the mean square (b^2 - a^2) / (2 ln(b / a))."""
        square = (self.upper**2 - self.lower**2) / (2.0 * math.log(self.upper / self.lower))
        return math.sqrt(square - self.mean**2)

    def log_density(self, x: ArrayLike) -> Floats:
        """Log density of x, (...) -> (...), -inf outside the bounds and at NaN."""
        x = np.asarray(x, dtype=float)
        inside = (x >= self.lower) & (x <= self.upper)
        with np.errstate(divide="ignore", invalid="ignore"):
            density = -np.log(x) - math.log(math.log(self.upper / self.lower))
        return np.where(inside, density, -np.inf)

    def sample(self, rng: np.random.Generator, size: int) -> Floats:
        """Independent draws, (size,)."""
        return self._within(np.exp(self._of_logarithm.sample(rng, size)))

    def from_normal(self, z: ArrayLike) -> Floats:
        """x with F(x) = Phi(z), accurate in both tails, (...) -> (...)."""
        return self._within(np.exp(self._of_logarithm.from_normal(z)))

    def to_normal(self, x: ArrayLike) -> Floats:
        """z with Phi(z) = F(x), accurate in both tails, infinite on the bounds, (...) -> (...)."""
        inside = self._within(np.asarray(x, dtype=float))
        ends = self._of_logarithm
        # the logarithm may round over a bound
        return ends.to_normal(np.clip(np.log(inside), ends.lower, ends.upper))

    def _within(self, x: Floats) -> Floats:
        return np.asarray(np.minimum(np.maximum(x, self.lower), self.upper))
