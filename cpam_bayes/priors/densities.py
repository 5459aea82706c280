"""Prior densities of one parameter: uniform, truncated normal, truncated Student-t."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import betaln, ndtr, ndtri, stdtr, stdtrit

__all__ = ["Prior", "Quantiles", "ScaledStudentT", "TruncatedNormal", "Uniform"]

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

    def cdf(self, x: ArrayLike) -> Floats:
        """Distribution function F at x, (...) -> (...)."""
        ...

    def ppf(self, p: ArrayLike) -> Floats:
        """Quantiles, the inverse of F, at p in [0, 1], (...) -> (...)."""
        ...

    def from_normal(self, z: ArrayLike) -> Floats:
        """x with F(x) = Phi(z), accurate in both tails, (...) -> (...)."""
        ...

    def to_normal(self, x: ArrayLike) -> Floats:
        """z with Phi(z) = F(x), accurate in both tails, infinite on the bounds, (...) -> (...)."""
        ...


class Quantiles:
    """Distribution function and quantiles through the standard normal, where both tails are accurate."""

    __slots__ = ()

    def cdf(self, x: ArrayLike) -> Floats:
        """Distribution function F at x, (...) -> (...)."""
        return np.asarray(ndtr(self.to_normal(x)))

    def ppf(self, p: ArrayLike) -> Floats:
        """Quantiles, the inverse of F, at p in [0, 1], (...) -> (...)."""
        return self.from_normal(ndtri(np.asarray(p, dtype=float)))

    @abstractmethod
    def from_normal(self, z: ArrayLike) -> Floats:
        """x with F(x) = Phi(z), accurate in both tails, (...) -> (...)."""

    @abstractmethod
    def to_normal(self, x: ArrayLike) -> Floats:
        """z with Phi(z) = F(x), accurate in both tails, infinite on the bounds, (...) -> (...)."""


class _Truncated(Quantiles):
    """A density of location and scale, cut at bounds."""

    __slots__ = ("_known_cut",)
    _known_cut: _Cut
    lower: float
    upper: float
    scale: float

    @property
    @abstractmethod
    def _centre(self) -> float: ...

    @property
    @abstractmethod
    def _moments(self) -> tuple[float, float]:
        """Mean and variance in scales about the centre, mirrored as the cut is."""

    @abstractmethod
    def _distribution(self, t: Any) -> Any:
        """Distribution function of the standard density."""

    @abstractmethod
    def _quantile(self, p: Any) -> Any:
        """Inverse of ``_distribution``."""

    @property
    def _cut(self) -> _Cut:
        # computed once: no field, so that equality, hashes and pickles know nothing of it
        try:
            return self._known_cut
        except AttributeError:
            object.__setattr__(self, "_known_cut", self._computed_cut())
            return self._known_cut

    def _computed_cut(self) -> _Cut:
        a, b = (self.lower - self._centre) / self.scale, (self.upper - self._centre) / self.scale
        sign = 1.0
        if a > 0.0:
            a, b, sign = -b, -a, -1.0
        below = float(self._distribution(a))
        return _Cut(a, b, sign, below, float(self._distribution(b)) - below)

    @property
    def mean(self) -> float:
        """Mean within the bounds."""
        return self._centre + self.scale * self._cut.sign * self._moments[0]

    @property
    def sd(self) -> float:
        """Standard deviation within the bounds."""
        return self.scale * math.sqrt(self._moments[1])

    def sample(self, rng: np.random.Generator, size: int) -> Floats:
        """Independent draws, (size,)."""
        return self._from_lower_tail(rng.uniform(size=size))

    def from_normal(self, z: ArrayLike) -> Floats:
        """x with F(x) = Phi(z), accurate in both tails, (...) -> (...)."""
        return self._from_lower_tail(ndtr(self._cut.sign * np.asarray(z, dtype=float)))

    def to_normal(self, x: ArrayLike) -> Floats:
        """z with Phi(z) = F(x), accurate in both tails, infinite on the bounds, (...) -> (...)."""
        cut = self._cut
        inside = _clipped(np.asarray(x, dtype=float), self.lower, self.upper)
        t = cut.sign * (inside - self._centre) / self.scale
        p = _clipped((self._distribution(t) - cut.below) / cut.mass, 0.0, 1.0)
        return np.asarray(cut.sign * ndtri(p))

    def _from_lower_tail(self, p: Floats) -> Floats:
        """x with probability p between it and the bound in the tail that is the lower one after mirroring."""
        cut = self._cut
        t = self._quantile(cut.below + cut.mass * p)
        return _clipped(self._centre + self.scale * cut.sign * t, self.lower, self.upper)


@dataclass(frozen=True, slots=True)
class Uniform(Quantiles):
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

    def from_normal(self, z: ArrayLike) -> Floats:
        """x with F(x) = Phi(z), accurate in both tails, (...) -> (...)."""
        x = self.lower + (self.upper - self.lower) * ndtr(np.asarray(z, dtype=float))
        return _clipped(x, self.lower, self.upper)

    def to_normal(self, x: ArrayLike) -> Floats:
        """z with Phi(z) = F(x), infinite on the bounds, (...) -> (...)."""
        inside = _clipped(np.asarray(x, dtype=float), self.lower, self.upper)
        return np.asarray(ndtri((inside - self.lower) / (self.upper - self.lower)))


@dataclass(frozen=True, slots=True)
class TruncatedNormal(_Truncated):
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
    def _centre(self) -> float:
        return self.loc

    def _distribution(self, t: Any) -> Any:
        return ndtr(t)

    def _quantile(self, p: Any) -> Any:
        return ndtri(p)

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

    def log_density(self, x: ArrayLike) -> Floats:
        """Log density of x, (...) -> (...), -inf outside the bounds and at NaN."""
        x = np.asarray(x, dtype=float)
        constant = math.log(self.scale * self._cut.mass) + 0.5 * math.log(2.0 * math.pi)
        with np.errstate(invalid="ignore"):
            value = -0.5 * ((x - self.loc) / self.scale) ** 2 - constant
        return _inside(x, self.lower, self.upper, value)


@dataclass(frozen=True, slots=True)
class ScaledStudentT(_Truncated):
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
    def _centre(self) -> float:
        return 0.0

    def _distribution(self, t: Any) -> Any:
        return stdtr(self.degrees_of_freedom, t)

    def _quantile(self, p: Any) -> Any:
        return stdtrit(self.degrees_of_freedom, p)

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

    def log_density(self, x: ArrayLike) -> Floats:
        """Log density of x, (...) -> (...), -inf outside the bounds and at NaN."""
        x = np.asarray(x, dtype=float)
        nu = self.degrees_of_freedom
        constant = _student_log_norm(nu) - math.log(self.scale * self._cut.mass)
        with np.errstate(over="ignore"):
            value = constant - 0.5 * (nu + 1.0) * np.log1p((x / self.scale) ** 2 / nu)
        return _inside(x, self.lower, self.upper, value)


@dataclass(frozen=True, slots=True)
class _Cut:
    """Standardised bounds, mirrored to the lower tail where a distribution function is accurate."""

    a: float
    b: float
    sign: float
    below: float
    mass: float


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


def _clipped(x: Floats, lower: float, upper: float) -> Floats:
    """As ``np.clip``, whose checks take longer than the work on short arrays."""
    return np.asarray(np.minimum(np.maximum(x, lower), upper))


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
