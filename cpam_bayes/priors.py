"""Prior densities of one parameter: uniform, truncated normal, truncated Student-t."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import betaln, ndtr, ndtri, stdtr, stdtrit

__all__ = ["Prior", "ScaledStudentT", "TruncatedNormal", "Uniform"]

Floats = NDArray[np.float64]

# Below this width in scales the closed forms of the moments cancel; a quadrature does not.
_NARROW = 1.0
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(40)


class Prior(Protocol):
    """A normalised density on [lower, upper]."""

    @property
    def lower(self) -> float:
        """Smallest value."""
        ...

    @property
    def upper(self) -> float:
        """Largest value."""
        ...

    @property
    def mean(self) -> float:
        """Mean within the bounds."""
        ...

    @property
    def sd(self) -> float:
        """Standard deviation within the bounds."""
        ...

    def log_density(self, x: ArrayLike) -> Floats:
        """Log density of x, (...) -> (...), -inf outside the bounds and at NaN."""
        ...

    def sample(self, rng: np.random.Generator, size: int) -> Floats:
        """Independent draws, (size,)."""
        ...


@dataclass(frozen=True, slots=True)
class Uniform:
    """Equal density between two bounds, in the parameter's unit.

    raises ValueError when the bounds are not finite or not ascending
    """

    lower: float
    upper: float

    def __post_init__(self) -> None:
        _require_ascending(self.lower, self.upper)
        if not math.isfinite(self.upper - self.lower):
            raise ValueError(f"bounds of a uniform prior: received {self}, accepted: finite bounds")

    @property
    def mean(self) -> float:
        """Mean within the bounds."""
        return 0.5 * (self.lower + self.upper)

    @property
    def sd(self) -> float:
        """Standard deviation within the bounds."""
        return (self.upper - self.lower) / math.sqrt(12.0)

    def log_density(self, x: ArrayLike) -> Floats:
        """Log density of x, (...) -> (...), -inf outside the bounds and at NaN."""
        height = -math.log(self.upper - self.lower)
        return _inside(np.asarray(x, dtype=float), self.lower, self.upper, np.float64(height))

    def sample(self, rng: np.random.Generator, size: int) -> Floats:
        """Independent draws, (size,)."""
        return rng.uniform(self.lower, self.upper, size)


@dataclass(frozen=True, slots=True)
class TruncatedNormal:
    """A normal density cut at bounds, which may be infinite.

    loc, scale : mean and standard deviation before the cut; `mean` and `sd` are those after it
    raises ValueError for a scale that is not positive, bounds that do not ascend, or bounds so far
        from loc that nothing is left between them
    """

    loc: float
    scale: float
    lower: float
    upper: float

    def __post_init__(self) -> None:
        _require_ascending(self.lower, self.upper)
        _require_scale(self.scale)
        if not math.isfinite(self.loc):
            raise ValueError(f"loc of a truncated normal prior: received {self.loc}, accepted: finite")
        _require_mass(self._cut.mass, self)

    @property
    def _cut(self) -> _Cut:
        a, b = (self.lower - self.loc) / self.scale, (self.upper - self.loc) / self.scale
        return _cut(a, b, lambda t: float(ndtr(t)))

    @property
    def _moments(self) -> tuple[float, float]:
        cut = self._cut
        if cut.b - cut.a < _NARROW:
            return _quadrature_moments(cut.a, cut.b, lambda t: np.exp(-0.5 * t * t))
        pdf_a, pdf_b = _normal_pdf(cut.a), _normal_pdf(cut.b)
        mean = (pdf_a - pdf_b) / cut.mass
        a_pdf_a = cut.a * pdf_a if math.isfinite(cut.a) else 0.0
        b_pdf_b = cut.b * pdf_b if math.isfinite(cut.b) else 0.0
        return mean, 1.0 + (a_pdf_a - b_pdf_b) / cut.mass - mean * mean

    @property
    def mean(self) -> float:
        """Mean within the bounds."""
        return self.loc + self.scale * self._cut.sign * self._moments[0]

    @property
    def sd(self) -> float:
        """Standard deviation within the bounds."""
        return self.scale * math.sqrt(self._moments[1])

    def log_density(self, x: ArrayLike) -> Floats:
        """Log density of x, (...) -> (...), -inf outside the bounds and at NaN."""
        x = np.asarray(x, dtype=float)
        constant = math.log(self.scale * self._cut.mass) + 0.5 * math.log(2.0 * math.pi)
        with np.errstate(invalid="ignore"):
            value = -0.5 * ((x - self.loc) / self.scale) ** 2 - constant
        return _inside(x, self.lower, self.upper, value)

    def sample(self, rng: np.random.Generator, size: int) -> Floats:
        """Independent draws, (size,)."""
        cut = self._cut
        t = ndtri(cut.below + cut.mass * rng.uniform(size=size))
        return np.clip(self.loc + self.scale * cut.sign * t, self.lower, self.upper)


@dataclass(frozen=True, slots=True)
class ScaledStudentT:
    """A Student-t density about zero cut at bounds, which may be infinite: the prior of an effect.

    scale : one standard deviation in the sense of the effects' catalogue, before the cut
    degrees_of_freedom : above 2, so that the variance exists
    `mean` and `sd` are those after the cut
    raises ValueError for a scale that is not positive, too few degrees of freedom, bounds that do
        not ascend, or bounds between which nothing is left
    """

    scale: float
    degrees_of_freedom: float
    lower: float
    upper: float

    def __post_init__(self) -> None:
        _require_ascending(self.lower, self.upper)
        _require_scale(self.scale)
        if not (math.isfinite(self.degrees_of_freedom) and self.degrees_of_freedom > 2.0):
            raise ValueError(
                f"degrees of freedom of a Student-t prior: received {self.degrees_of_freedom}, "
                "accepted: finite and above 2"
            )
        _require_mass(self._cut.mass, self)

    @property
    def _cut(self) -> _Cut:
        nu = self.degrees_of_freedom
        return _cut(self.lower / self.scale, self.upper / self.scale, lambda t: float(stdtr(nu, t)))

    @property
    def _moments(self) -> tuple[float, float]:
        cut, nu = self._cut, self.degrees_of_freedom
        if cut.b - cut.a < _NARROW:
            return _quadrature_moments(
                cut.a, cut.b, lambda t: np.exp(-0.5 * (nu + 1.0) * np.log1p(t * t / nu))
            )
        # (1 + t^2/nu) times the density is, up to a factor, that of nu - 2 degrees of freedom.
        mean = (_first_moment(nu, cut.a) - _first_moment(nu, cut.b)) / cut.mass
        shrink = math.sqrt((nu - 2.0) / nu)
        lighter = float(stdtr(nu - 2.0, cut.b * shrink)) - float(stdtr(nu - 2.0, cut.a * shrink))
        second = nu * ((nu - 1.0) / (nu - 2.0) * lighter / cut.mass - 1.0)
        return mean, second - mean * mean

    @property
    def mean(self) -> float:
        """Mean within the bounds."""
        return self.scale * self._cut.sign * self._moments[0]

    @property
    def sd(self) -> float:
        """Standard deviation within the bounds."""
        return self.scale * math.sqrt(self._moments[1])

    def log_density(self, x: ArrayLike) -> Floats:
        """Log density of x, (...) -> (...), -inf outside the bounds and at NaN."""
        x = np.asarray(x, dtype=float)
        nu = self.degrees_of_freedom
        constant = _student_log_norm(nu) - math.log(self.scale * self._cut.mass)
        with np.errstate(over="ignore"):
            value = constant - 0.5 * (nu + 1.0) * np.log1p((x / self.scale) ** 2 / nu)
        return _inside(x, self.lower, self.upper, value)

    def sample(self, rng: np.random.Generator, size: int) -> Floats:
        """Independent draws, (size,)."""
        cut = self._cut
        t = stdtrit(self.degrees_of_freedom, cut.below + cut.mass * rng.uniform(size=size))
        return np.clip(self.scale * cut.sign * t, self.lower, self.upper)


@dataclass(frozen=True, slots=True)
class _Cut:
    """Standardised bounds, mirrored to the lower tail where a distribution function is accurate."""

    a: float
    b: float
    sign: float
    below: float
    mass: float


def _cut(a: float, b: float, distribution: Callable[[float], float]) -> _Cut:
    sign = 1.0
    if a > 0.0:
        a, b, sign = -b, -a, -1.0
    below = distribution(a)
    return _Cut(a, b, sign, below, distribution(b) - below)


def _quadrature_moments(a: float, b: float, shape: Callable[[Floats], Floats]) -> tuple[float, float]:
    """Mean and variance of a smooth density known up to a factor on a short interval."""
    offset = 0.5 * (b - a) * _NODES
    centre = 0.5 * (a + b)
    weights = _WEIGHTS * shape(centre + offset)
    weights = weights / weights.sum()
    mean = float(weights @ offset)
    return centre + mean, float(weights @ (offset - mean) ** 2)


def _normal_pdf(t: float) -> float:
    return math.exp(-0.5 * t * t) / math.sqrt(2.0 * math.pi)


def _student_log_norm(nu: float) -> float:
    return -0.5 * math.log(nu) - float(betaln(0.5, 0.5 * nu))


def _first_moment(nu: float, t: float) -> float:
    """Integral of t times the Student-t density from t to infinity."""
    if math.isinf(t):
        return 0.0
    decay = -0.5 * (nu - 1.0) * math.log1p(t * t / nu)
    return nu / (nu - 1.0) * math.exp(_student_log_norm(nu) + decay)


def _inside(x: Floats, lower: float, upper: float, value: Floats | np.float64) -> Floats:
    return np.where((x >= lower) & (x <= upper), value, -np.inf)


def _require_ascending(lower: float, upper: float) -> None:
    if not lower < upper:
        raise ValueError(f"bounds of a prior: received [{lower}, {upper}], accepted: lower < upper")


def _require_scale(scale: float) -> None:
    if not (math.isfinite(scale) and scale > 0.0):
        raise ValueError(f"scale of a prior: received {scale}, accepted: finite and above 0")


def _require_mass(mass: float, prior: object) -> None:
    if not mass > 0.0:
        raise ValueError(
            f"bounds of a prior: received {prior}, whose bounds leave no probability; "
            "accepted: bounds within a few scales of the centre"
        )
