"""A prior that is one of two: a tolerance, or with a small probability something far larger."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr, ndtri

from cpam_bayes.priors.densities import Floats, Prior, Quantiles

# The quantiles are tabulated over these scores, where probabilities reach 1e-17 on both sides.
_END, _INTERVALS = 8.5, 8192
# Within this fraction of the range from a bound the density is that at the bound: the distribution
# functions have lost their digits there.
_NEAR = 1e-8
# Scores at which each part's quantiles make a first table, and Newton steps from its values.
_FIRST, _NEWTON = 1000, 4


@dataclass(frozen=True, slots=True)
class Mixture(Quantiles):
    """The density (1 - q) p + q p' of two priors between the same finite bounds.

    Between the same bounds the density is smooth, and so is the map from standard normal scores.

    narrow, wide : p and p'
    fraction : q, the probability of the wide one
    raises ValueError for bounds that differ or are infinite, or a fraction that is not between 0 and 1
    """

    narrow: Prior
    wide: Prior
    fraction: float

    def __post_init__(self) -> None:
        ends = [(p.lower, p.upper) for p in (self.narrow, self.wide)]
        if ends[0] != ends[1] or not all(math.isfinite(end) for end in ends[0]):
            raise ValueError(f"bounds of a mixture: received {ends}, accepted: finite, the same for both")
        if not 0.0 < self.fraction < 1.0:
            raise ValueError(
                f"fraction of a mixture: received {self.fraction}, accepted: above 0 and below 1"
            )

    @property
    def lower(self) -> float:
        """Smallest value."""
        return self.narrow.lower

    @property
    def upper(self) -> float:
        """Largest value."""
        return self.narrow.upper

    @property
    def mean(self) -> float:
        """Mean within the bounds."""
        return (1.0 - self.fraction) * self.narrow.mean + self.fraction * self.wide.mean

    @property
    def sd(self) -> float:
        """Standard deviation within the bounds."""
        q, mean = self.fraction, self.mean
        parts = ((1.0 - q, self.narrow), (q, self.wide))
        return math.sqrt(sum(w * (p.sd**2 + (p.mean - mean) ** 2) for w, p in parts))

    def log_density(self, x: ArrayLike) -> Floats:
        """Log density of x, (...) -> (...), -inf outside the bounds and at NaN."""
        narrow = math.log1p(-self.fraction) + self.narrow.log_density(x)
        return np.asarray(np.logaddexp(narrow, math.log(self.fraction) + self.wide.log_density(x)))

    def sample(self, rng: np.random.Generator, size: int) -> Floats:
        """Independent draws, (size,)."""
        draws = np.stack([p.sample(rng, size) for p in (self.narrow, self.wide)])
        return np.asarray(np.where(rng.uniform(size=size) < self.fraction, draws[1], draws[0]))

    def from_normal(self, z: ArrayLike) -> Floats:
        """x with F(x) = Phi(z), (...) -> (...), cubic between tabulated quantiles.

        Between scores of -5 and 5 the error of z is below 1e-9 where the bounds are within 50 narrow scales.
        """
        z = np.asarray(z, dtype=float)
        at = (np.minimum(np.maximum(z, -_END), _END) + _END) * (_INTERVALS / (2.0 * _END))
        i = np.minimum(np.nan_to_num(at).astype(int), _INTERVALS - 1)
        c = _table(self)[i]
        t = at - i
        x = ((c[..., 3] * t + c[..., 2]) * t + c[..., 1]) * t + c[..., 0]
        x = np.where(np.isinf(z), np.where(z > 0.0, self.upper, self.lower), x)
        return np.asarray(np.minimum(np.maximum(x, self.lower), self.upper))

    def to_normal(self, x: ArrayLike) -> Floats:
        """z with Phi(z) = F(x), accurate in both tails, infinite on the bounds, (...) -> (...)."""
        narrow, wide = self.narrow.to_normal(x), self.wide.to_normal(x)
        q = self.fraction
        below = (1.0 - q) * ndtr(narrow) + q * ndtr(wide)
        above = (1.0 - q) * ndtr(-narrow) + q * ndtr(-wide)
        return np.asarray(np.where(below < above, ndtri(below), -ndtri(above)))


@lru_cache(maxsize=512)
def _table(prior: Mixture) -> Any:
    """Coefficients of t^0 to t^3, t from 0 to 1 in an interval of scores, (n, 4).

    Values by Newton's method, slopes dx/dz = phi(z) / p(x).
    """
    z = np.linspace(-_END, _END, _INTERVALS + 1)
    first = np.linspace(-_END, _END, _FIRST)
    x = np.unique(np.concatenate((prior.narrow.from_normal(first), prior.wide.from_normal(first))))
    known = prior.to_normal(x)
    x, known = x[np.isfinite(known)], known[np.isfinite(known)]
    rising = np.diff(known, prepend=-np.inf) > 0.0
    x = np.interp(z, known[rising], x[rising])
    for _ in range(_NEWTON):
        score = prior.to_normal(x)
        step = np.where(np.isfinite(score), (z - score) * _slope(prior, x, z), 0.0)
        moved = x + step
        # halfway to a bound where a step would leave it
        moved = np.where(moved < prior.lower, 0.5 * (x + prior.lower), moved)
        x = np.where(moved > prior.upper, 0.5 * (x + prior.upper), moved)
    for bound, sign in ((prior.lower, 1.0), (prior.upper, -1.0)):
        distance = ndtr(sign * z) / np.exp(prior.log_density(bound))
        x = np.where(distance < _NEAR * (prior.upper - prior.lower), bound + sign * distance, x)
    slope = _slope(prior, x, z) * (2.0 * _END / _INTERVALS)
    rise, left, right = np.diff(x), slope[:-1], slope[1:]
    table = np.stack((x[:-1], left, 3.0 * rise - 2.0 * left - right, left + right - 2.0 * rise), axis=1)
    table.flags.writeable = False
    return table


def _slope(prior: Mixture, x: Floats, z: Floats) -> Floats:
    return np.asarray(np.exp(-0.5 * z**2 - prior.log_density(x)) / math.sqrt(2.0 * math.pi))
