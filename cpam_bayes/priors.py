"""Prior densities of one parameter: uniform, log-uniform, normal, log-normal, Student-t, mixtures of two.

A new kind is one subclass of `Prior`: other modules use a prior's methods and never ask for its class.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import betaln, ndtr, ndtri, stdtr, stdtrit

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PriorNumbers:
    """Summary numbers of a prior, in the unit requested.

    kind : of density, in words
    centre : before truncation at the bounds; None where only a range is known
    scale : standard deviation before truncation; after it where only a range is known
    mean, sd, lower, upper : within the bounds
    """

    kind: str
    centre: float | None
    scale: float
    mean: float
    sd: float
    lower: float
    upper: float


class Prior(ABC):
    """A normalised density on [lower, upper].

    kind : of density, in words
    is_range : whether only the bounds are known
    """

    __slots__ = ()
    kind: ClassVar[str]
    is_range: ClassVar[bool] = False
    lower: float
    upper: float

    @property
    @abstractmethod
    def mean(self) -> float:
        """Mean within the bounds."""

    @property
    @abstractmethod
    def sd(self) -> float:
        """Standard deviation within the bounds."""

    @property
    def typical(self) -> float:
        """Typical size of an effect: one scale of a density about zero, else the mean."""
        return self.mean

    @property
    def _before_cut(self) -> tuple[float | None, float]:
        """Centre and scale as in `PriorNumbers`."""
        return None, self.sd

    @property
    def parts(self) -> tuple[tuple[float, Prior], ...]:
        """Mixture components with their fractions; the prior itself where it is no mixture."""
        return ((1.0, self),)

    def describe(self, in_unit: Callable[[float], float] = float) -> PriorNumbers:
        """Its kind and numbers, each passed through ``in_unit``, a conversion by a factor."""
        centre, scale = self._before_cut
        own = None if centre is None else in_unit(centre)
        numbers = (scale, self.mean, self.sd, self.lower, self.upper)
        return PriorNumbers(self.kind, own, *(in_unit(value) for value in numbers))

    def rescaled(self, factor: float) -> Prior:
        """The prior with its scale multiplied and its bounds kept; unchanged where it has no scale.

        Of a mixture only the narrow part is rescaled.
        """
        del factor
        return self

    @abstractmethod
    def stretched(self, factor: float) -> Prior:
        """The prior of ``factor`` times the quantity, bounds and all."""

    def _ends(self, factor: float) -> dict[str, float]:
        return {"lower": factor * self.lower, "upper": factor * self.upper}

    @abstractmethod
    def log_density(self, x: ArrayLike) -> Floats:
        """Log density of x, (...) -> (...), -inf outside the bounds and at NaN."""

    @abstractmethod
    def sample(self, rng: np.random.Generator, size: int) -> Floats:
        """Independent draws, (size,)."""

    @property
    def reach(self) -> float:
        """The normal score beyond which quantiles carry no information: bounds, or rounding."""
        return 7.0

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


@dataclass(frozen=True, slots=True)
class Uniform(Prior):
    """Equal density between two bounds, in the parameter's unit.

    raises ValueError when the bounds are not finite or not ascending
    """

    kind: ClassVar[str] = "uniform"
    is_range: ClassVar[bool] = True
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

    def stretched(self, factor: float) -> Uniform:
        """The prior of ``factor`` times the quantity."""
        return Uniform(**self._ends(factor))

    def log_density(self, x: ArrayLike) -> Floats:
        """Log density of x, (...) -> (...), -inf outside the bounds and at NaN."""
        height = -np.log(self.upper - self.lower)
        return _inside(np.asarray(x, dtype=float), self.lower, self.upper, height)

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


class _Logarithmic(Prior):
    """A density defined by that of the logarithm."""

    __slots__ = ("_known_logarithm",)
    _known_logarithm: Uniform | TruncatedNormal

    @property
    def _of_logarithm(self) -> Uniform | TruncatedNormal:
        # computed once, like the cut of a truncated density
        try:
            return self._known_logarithm
        except AttributeError:
            object.__setattr__(self, "_known_logarithm", self._made_of_logarithm())
            return self._known_logarithm

    @abstractmethod
    def _made_of_logarithm(self) -> Uniform | TruncatedNormal: ...

    @property
    def reach(self) -> float:
        """Reach of the logarithm's density."""
        return self._of_logarithm.reach

    def sample(self, rng: np.random.Generator, size: int) -> Floats:
        """Independent draws, (size,)."""
        return _clipped(np.exp(self._of_logarithm.sample(rng, size)), self.lower, self.upper)

    def from_normal(self, z: ArrayLike) -> Floats:
        """x with F(x) = Phi(z), accurate in both tails, (...) -> (...)."""
        return _clipped(np.exp(self._of_logarithm.from_normal(z)), self.lower, self.upper)

    def to_normal(self, x: ArrayLike) -> Floats:
        """z with Phi(z) = F(x), accurate in both tails, infinite on the bounds, (...) -> (...)."""
        inside = _clipped(np.asarray(x, dtype=float), self.lower, self.upper)
        ends = self._of_logarithm
        # the logarithm may round over a bound
        return ends.to_normal(np.clip(np.log(inside), ends.lower, ends.upper))


@dataclass(frozen=True, slots=True)
class LogUniform(_Logarithmic):
    """The density of a quantity with uniform logarithm: all orders of magnitude within the bounds alike.

    raises ValueError for a lower bound that is not positive, and as ``Uniform``
    """

    kind: ClassVar[str] = "log-uniform"
    is_range: ClassVar[bool] = True
    lower: float
    upper: float

    def __post_init__(self) -> None:
        if not self.lower > 0.0:
            raise ValueError(f"a log-uniform prior: received {self}, accepted: a positive lower bound")
        _ = self._of_logarithm

    def _made_of_logarithm(self) -> Uniform:
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

    def stretched(self, factor: float) -> LogUniform:
        """The prior of ``factor`` times the quantity."""
        return LogUniform(**self._ends(factor))

    def log_density(self, x: ArrayLike) -> Floats:
        """Log density of x, (...) -> (...), -inf outside the bounds and at NaN."""
        x = np.asarray(x, dtype=float)
        inside = (x >= self.lower) & (x <= self.upper)
        with np.errstate(divide="ignore", invalid="ignore"):
            density = -np.log(x) - math.log(math.log(self.upper / self.lower))
        return np.where(inside, density, -np.inf)


class _Truncated(Prior):
    """A location-scale density truncated at bounds."""

    __slots__ = ("_known_cut",)
    _known_cut: _Cut
    scale: float

    @property
    @abstractmethod
    def _centre(self) -> float: ...

    @property
    @abstractmethod
    def _moments(self) -> tuple[float, float]:
        """Mean and variance in scales about the centre, mirrored like the cut."""

    @abstractmethod
    def _distribution(self, t: Any) -> Any:
        """Distribution function of the standard density."""

    @abstractmethod
    def _quantile(self, p: Any) -> Any:
        """Inverse of ``_distribution``."""

    @property
    def _before_cut(self) -> tuple[float, float]:
        return self._centre, self.scale

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
        below, above = float(self._distribution(a)), float(self._distribution(-b))
        return _Cut(a, b, sign, below, above, float(self._distribution(b)) - below)

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
        cut = self._cut
        return self._at(self._quantile(cut.below + cut.mass * rng.uniform(size=size)))

    def from_normal(self, z: ArrayLike) -> Floats:
        """x with F(x) = Phi(z), accurate in both tails, (...) -> (...)."""
        cut = self._cut
        score = cut.sign * np.asarray(z, dtype=float)
        side, beyond = self._tail(score)
        return self._at(side * self._quantile(beyond + cut.mass * ndtr(side * score)))

    def to_normal(self, x: ArrayLike) -> Floats:
        """z with Phi(z) = F(x), accurate in both tails, infinite on the bounds, (...) -> (...)."""
        cut = self._cut
        inside = _clipped(np.asarray(x, dtype=float), self.lower, self.upper)
        t = cut.sign * (inside - self._centre) / self.scale
        side, beyond = self._tail(t)
        p = _clipped((self._distribution(side * t) - beyond) / cut.mass, 0.0, 1.0)
        return np.asarray(cut.sign * side * ndtri(p))

    def _tail(self, t: Floats) -> tuple[Floats, Floats]:
        """-1 where a point is on the upper side, else 1, and the probability beyond the bound there.

        Probabilities near one have lost their digits; the standard densities are even. After mirroring, the
        whole density may be on the lower side.
        """
        upper = (t > 0.0) & (self._cut.b > 0.0)
        return np.where(upper, -1.0, 1.0), np.where(upper, self._cut.above, self._cut.below)

    def _at(self, t: Floats) -> Floats:
        """x at t scales from the centre, mirrored like the cut."""
        return _clipped(self._centre + self.scale * self._cut.sign * t, self.lower, self.upper)


@dataclass(frozen=True, slots=True)
class _Cut:
    """Standardised bounds, mirrored to the lower tail where a distribution function is accurate.

    below, above : probability outside the bounds
    """

    a: float
    b: float
    sign: float
    below: float
    above: float
    mass: float


@dataclass(frozen=True, slots=True)
class TruncatedNormal(_Truncated):
    """A normal density truncated at bounds, which may be infinite.

    loc, scale : mean and standard deviation before truncation; `mean` and `sd` are those after it
    raises ValueError for a scale that is not positive, bounds that do not ascend, or bounds so far
        from loc that they leave no probability
    """

    kind: ClassVar[str] = "truncated normal"
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

    @property
    def reach(self) -> float:
        """Some 37 standard deviations, beyond which probabilities underflow."""
        return 37.0

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

    def rescaled(self, factor: float) -> TruncatedNormal:
        """The prior with its scale multiplied and its bounds kept."""
        return replace(self, scale=factor * self.scale)

    def stretched(self, factor: float) -> TruncatedNormal:
        """The prior of ``factor`` times the quantity."""
        return TruncatedNormal(factor * self.loc, factor * self.scale, **self._ends(factor))

    def log_density(self, x: ArrayLike) -> Floats:
        """Log density of x, (...) -> (...), -inf outside the bounds and at NaN."""
        x = np.asarray(x, dtype=float)
        constant = math.log(self.scale * self._cut.mass) + 0.5 * math.log(2.0 * math.pi)
        with np.errstate(invalid="ignore"):
            value = -0.5 * ((x - self.loc) / self.scale) ** 2 - constant
        return _inside(x, self.lower, self.upper, value)


@dataclass(frozen=True, slots=True)
class ScaledStudentT(_Truncated):
    """A Student-t density about zero truncated at bounds, which may be infinite: the prior of an effect.

    scale : one standard deviation in the sense of the effects' catalogue, before truncation
    degrees_of_freedom : above 2, so that the variance exists
    `mean` and `sd` are those after truncation
    raises ValueError for a scale that is not positive, too few degrees of freedom, bounds that do
        not ascend, or bounds that leave no probability
    """

    kind: ClassVar[str] = "Student-t"
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

    @property
    def typical(self) -> float:
        """One scale: the density is about zero."""
        return self.scale

    def rescaled(self, factor: float) -> ScaledStudentT:
        """The prior with its scale multiplied and its bounds kept."""
        return replace(self, scale=factor * self.scale)

    def stretched(self, factor: float) -> ScaledStudentT:
        """The prior of ``factor`` times the quantity."""
        return replace(self, scale=factor * self.scale, **self._ends(factor))

    def log_density(self, x: ArrayLike) -> Floats:
        """Log density of x, (...) -> (...), -inf outside the bounds and at NaN."""
        x = np.asarray(x, dtype=float)
        nu = self.degrees_of_freedom
        constant = _student_log_norm(nu) - math.log(self.scale * self._cut.mass)
        with np.errstate(over="ignore"):
            value = constant - 0.5 * (nu + 1.0) * np.log1p((x / self.scale) ** 2 / nu)
        return _inside(x, self.lower, self.upper, value)


@dataclass(frozen=True, slots=True)
class TruncatedLogNormal(_Logarithmic):
    """The density of a quantity with normal logarithm, truncated at bounds.

    median : before truncation
    log_sd : standard deviation of ln x before truncation
    raises ValueError for a median or a lower bound that is not positive, and as ``TruncatedNormal``
    """

    kind: ClassVar[str] = "truncated log-normal"
    median: float
    log_sd: float
    lower: float
    upper: float

    def __post_init__(self) -> None:
        if not (self.median > 0.0 and self.lower > 0.0 and math.isfinite(self.upper)):
            raise ValueError(f"a log-normal prior: received {self}, accepted: positive and finite values")
        _ = self._of_logarithm

    def _made_of_logarithm(self) -> TruncatedNormal:
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

    @property
    def _before_cut(self) -> tuple[float, float]:
        return self.median, self.sd

    def rescaled(self, factor: float) -> TruncatedLogNormal:
        """The prior with its median multiplied and its bounds kept."""
        return replace(self, median=factor * self.median)

    def stretched(self, factor: float) -> TruncatedLogNormal:
        """The prior of ``factor`` times the quantity."""
        return replace(self, median=factor * self.median, **self._ends(factor))

    def _moment(self, power: int) -> float:
        """E[x^power], by a quadrature over ln x within ten standard deviations of the median."""
        centre, reach = math.log(self.median), 10.0 * self.log_sd
        low, high = max(math.log(self.lower), centre - reach), min(math.log(self.upper), centre + reach)
        edges = np.linspace(low, high, 33)
        half = 0.5 * np.diff(edges)[:, None]
        t = 0.5 * (edges[1:] + edges[:-1])[:, None] + half * _GAUSS_64[0]
        density = np.exp(self._of_logarithm.log_density(t) + power * t)
        return float(np.sum(half * _GAUSS_64[1] * density))

    def log_density(self, x: ArrayLike) -> Floats:
        """Log density of x, (...) -> (...), -inf outside the bounds and at NaN."""
        x = np.asarray(x, dtype=float)
        inside = (x >= self.lower) & (x <= self.upper)
        t = np.log(np.where(inside, x, self.median))
        return np.where(inside, self._of_logarithm.log_density(t) - t, -np.inf)


@dataclass(frozen=True, slots=True)
class Mixture(Prior):
    """The density (1 - q) p + q p' of two priors between the same finite bounds.

    With common bounds the density is smooth, and so is the map from standard normal scores.

    narrow, wide : p and p'
    fraction : q, the probability of the wide one
    raises ValueError for bounds that differ or are infinite, or a fraction that is not between 0 and 1
    """

    kind: ClassVar[str] = "mixture"
    narrow: Prior
    wide: Prior
    fraction: float
    lower: float = field(init=False, repr=False, compare=False)
    upper: float = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        ends = [(p.lower, p.upper) for p in (self.narrow, self.wide)]
        if ends[0] != ends[1] or not all(math.isfinite(end) for end in ends[0]):
            raise ValueError(f"bounds of a mixture: received {ends}, accepted: finite, the same for both")
        if not 0.0 < self.fraction < 1.0:
            raise ValueError(
                f"fraction of a mixture: received {self.fraction}, accepted: above 0 and below 1"
            )
        object.__setattr__(self, "lower", self.narrow.lower)
        object.__setattr__(self, "upper", self.narrow.upper)

    @property
    def mean(self) -> float:
        """Mean within the bounds."""
        return (1.0 - self.fraction) * self.narrow.mean + self.fraction * self.wide.mean

    @property
    def sd(self) -> float:
        """Standard deviation within the bounds."""
        mean = self.mean
        return math.sqrt(sum(w * (p.sd**2 + (p.mean - mean) ** 2) for w, p in self.parts))

    @property
    def parts(self) -> tuple[tuple[float, Prior], ...]:
        """The narrow and the wide density with their fractions."""
        return (1.0 - self.fraction, self.narrow), (self.fraction, self.wide)

    @property
    def typical(self) -> float:
        """Typical size of the narrow part."""
        return self.narrow.typical

    @property
    def _before_cut(self) -> tuple[float | None, float]:
        narrow = self.narrow.describe()
        return narrow.centre, narrow.scale

    def rescaled(self, factor: float) -> Mixture:
        """The prior with its narrow part rescaled."""
        return replace(self, narrow=self.narrow.rescaled(factor))

    def stretched(self, factor: float) -> Mixture:
        """The prior of ``factor`` times the quantity."""
        return Mixture(self.narrow.stretched(factor), self.wide.stretched(factor), self.fraction)

    def log_density(self, x: ArrayLike) -> Floats:
        """Log density of x, (...) -> (...), -inf outside the bounds and at NaN."""
        narrow = math.log1p(-self.fraction) + self.narrow.log_density(x)
        return np.asarray(np.logaddexp(narrow, math.log(self.fraction) + self.wide.log_density(x)))

    def sample(self, rng: np.random.Generator, size: int) -> Floats:
        """Independent draws, (size,)."""
        draws = np.stack([p.sample(rng, size) for p in (self.narrow, self.wide)])
        return np.asarray(np.where(rng.uniform(size=size) < self.fraction, draws[1], draws[0]))

    def from_normal(self, z: ArrayLike) -> Floats:
        """x with F(x) = Phi(z), (...) -> (...), by cubic interpolation of tabulated quantiles.

        Between scores of -5 and 5 the error of z is below 1e-9 where the bounds are within 50 narrow scales.
        """
        z = np.asarray(z, dtype=float)
        at = (np.minimum(np.maximum(z, -_END), _END) + _END) * (_INTERVALS / (2.0 * _END))
        i = np.minimum(np.nan_to_num(at).astype(int), _INTERVALS - 1)
        c = _table(self)[i]
        t = at - i
        x = ((c[..., 3] * t + c[..., 2]) * t + c[..., 1]) * t + c[..., 0]
        x = np.where(np.isinf(z), np.where(z > 0.0, self.upper, self.lower), x)
        return _clipped(x, self.lower, self.upper)

    def to_normal(self, x: ArrayLike) -> Floats:
        """z with Phi(z) = F(x), accurate in both tails, infinite on the bounds, (...) -> (...)."""
        narrow, wide = self.narrow.to_normal(x), self.wide.to_normal(x)
        q = self.fraction
        below = (1.0 - q) * ndtr(narrow) + q * ndtr(wide)
        above = (1.0 - q) * ndtr(-narrow) + q * ndtr(-wide)
        return np.asarray(np.where(below < above, ndtri(below), -ndtri(above)))


@dataclass(frozen=True, slots=True, eq=False)
class _Ranges(Uniform):
    """Several uniform densities, with bounds (n,)."""

    def __post_init__(self) -> None:
        """Skip the checks: each density has been checked by itself."""


@dataclass(frozen=True)
class Priors:
    """Independent priors along the last axis; uniform ones are evaluated together."""

    priors: tuple[Prior, ...]

    @cached_property
    def _parts_of_axis(self) -> tuple[tuple[Any, Prior], ...]:
        uniform = [i for i, prior in enumerate(self.priors) if isinstance(prior, Uniform)]
        if len(uniform) < 2:
            return tuple(enumerate(self.priors))
        ends: Any = np.array([(self.priors[i].lower, self.priors[i].upper) for i in uniform]).T
        others = tuple((i, prior) for i, prior in enumerate(self.priors) if i not in uniform)
        return ((np.array(uniform), _Ranges(*ends)), *others)

    def from_normal(self, z: Floats) -> Floats:
        """x with F(x) = Phi(z), accurate in both tails, (..., n) -> (..., n)."""
        x = np.empty(z.shape)
        for at, prior in self._parts_of_axis:
            x[..., at] = prior.from_normal(z[..., at])
        return x

    def to_normal(self, x: Floats) -> Floats:
        """z with Phi(z) = F(x), accurate in both tails, infinite on the bounds, (..., n) -> (..., n)."""
        z = np.empty(x.shape)
        for at, prior in self._parts_of_axis:
            z[..., at] = prior.to_normal(x[..., at])
        return z

    @cached_property
    def reach(self) -> Floats:
        """Reach of each prior, (n,)."""
        return np.array([prior.reach for prior in self.priors])

    def log_densities(self, x: Floats) -> Floats:
        """Log density of each, (..., n) -> (..., n), -inf outside its bounds and at NaN."""
        density = np.empty(x.shape)
        for at, prior in self._parts_of_axis:
            density[..., at] = prior.log_density(x[..., at])
        return density


# Nodes and weights of Gauss-Legendre quadratures.
_GAUSS_40 = np.polynomial.legendre.leggauss(40)
_GAUSS_64 = np.polynomial.legendre.leggauss(64)
# Below this width in scales the closed forms of the moments lose digits; a quadrature does not.
_NARROW = 1.0
# The quantiles of a mixture are tabulated over these scores, where probabilities reach 1e-17 on both sides.
_END, _INTERVALS = 8.5, 8192
# Within this fraction of the range from a bound the density is taken as that at the bound: the
# distribution functions have lost their digits there.
_NEAR = 1e-8
# Scores in the first table of each part's quantiles, and Newton steps from its values.
_FIRST, _NEWTON = 1000, 4


@lru_cache(maxsize=512)
def _table(prior: Mixture) -> Any:
    """Cubic coefficients of t^0 to t^3, t from 0 to 1 in each interval of scores, (n, 4).

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


def _quadrature_moments(a: float, b: float, shape: Callable[[Floats], Floats]) -> tuple[float, float]:
    """Mean and variance of a smooth density known up to a factor on a short interval."""
    offset = 0.5 * (b - a) * _GAUSS_40[0]
    centre = 0.5 * (a + b)
    weights = _GAUSS_40[1] * shape(centre + offset)
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


def _clipped(x: Floats, lower: float | Floats, upper: float | Floats) -> Floats:
    """``np.clip`` without its checks, which dominate on short arrays."""
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
