"""Quality control of constants: limits such as "E1_GPa >= 115", and a chart of individual values.

A limit gives the probability that a constant meets it; the chart shows plates that deviate more than the
batch scatters.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from cpam_bayes.plate import USER_UNITS, to_si, to_user, unit_of, user_name
from cpam_bayes.plate.laminate import CONSTANTS

_FORM: Final = re.compile(r"\s*(\w+)\s*(>=|<=|>|<)\s*([-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?)\s*([a-zA-Z]*)\s*")
# Decimal commas, and the signs of typeset documents.
_AS_TYPED: Final = str.maketrans(
    {",": ".", "\N{GREATER-THAN OR EQUAL TO}": ">=", "\N{LESS-THAN OR EQUAL TO}": "<="}
)
# Units allowed in a limit, in terms of that of the plate file.
_UNITS: Final = {"GPa": {"": 1.0, "GPa": 1.0, "MPa": 1e-3, "Pa": 1e-9}, "": {"": 1.0}}
# Stiffer than any ply, GPa: a larger number must be in another unit.
_STIFFEST: Final = 2000.0
# A number whose separator may be of thousands or decimals, 125,000 MPa.
_THOUSANDS: Final = re.compile(r"[1-9]\d{0,2}\.\d{3}")
# Names as in a plate file or as in tables.
_NAMES: Final = {
    written: name
    for user, (name, _) in USER_UNITS.items()
    if name in CONSTANTS
    for written in dict.fromkeys((user, name))
}


@dataclass(frozen=True, slots=True)
class Limit:
    """A limit on a constant; text : normalised, name : of the constant, value : SI."""

    text: str
    name: str
    side: Literal["at least", "at most"]
    value: float

    @property
    def shown(self) -> str:
        """The limit as shown: E1 >= 115 GPa."""
        number = f"{to_user(self.name, self.value):.10g} {unit_of(self.name)}"
        return f"{self.name} {'>=' if self.side == 'at least' else '<='} {number}".rstrip()


@dataclass(frozen=True, slots=True)
class MarginalPosterior:
    """The posterior of one constant: a Gaussian truncated at the bounds of its prior, SI."""

    centre: float
    sd: float
    lower: float
    upper: float

    def below(self, value: float) -> float:
        """Probability that the constant is below a value."""
        if value <= self.lower:
            return 0.0
        if value >= self.upper:
            return 1.0
        low, here, high = (self._mass(v) for v in (self.lower, value, self.upper))
        return (here - low) / (high - low)

    def meets(self, limit: Limit) -> float:
        """Probability that the constant meets a limit."""
        below = self.below(limit.value)
        return 1.0 - below if limit.side == "at least" else below

    def draws(self, rng: np.random.Generator, n: int) -> NDArray[np.float64]:
        """Draws of the constant, (n,)."""
        u = rng.uniform(self._mass(self.lower), self._mass(self.upper), n)
        drawn = self.centre + self.sd * ndtri(u)
        return np.asarray(np.clip(drawn, self.lower, self.upper))

    def _mass(self, value: float) -> float:
        return float(ndtr((value - self.centre) / self.sd))


def read_limit(text: str) -> Limit:
    """Read a limit such as ``E1_GPa >= 115``, in the unit of the plate file or a stated one.

    raises ValueError for any other text
    """
    match = _FORM.fullmatch(text.translate(_AS_TYPED))
    if match is None or not _is_number(match[3]):
        raise ValueError(
            f'limit: received {text!r}, accepted: a constant, >= or <=, a number: "E1_GPa >= 115"'
        )
    name, sign, number, unit = match.groups()
    if name not in _NAMES:
        each = " ".join(dict.fromkeys(map(user_name, _NAMES.values())))
        raise ValueError(f"limit: received {text!r}, constants that have limits: {each}")
    name = user_name(_NAMES[name])
    units = _UNITS[unit_of(_NAMES[name])]
    if unit not in units:
        accepted = " ".join(each for each in units if each) or "a number without a unit"
        raise ValueError(f"limit: received {text!r}, the unit {unit}, accepted: {accepted}")
    value = float(number) * units[unit]
    if units[unit] < 1.0 and _THOUSANDS.fullmatch(number):
        raise ValueError(
            f"limit: received {text!r}, thousands or decimals? accepted: {number.replace('.', '')} {unit} or "
            f"{float(number):g} {unit}"
        )
    if len(units) > 1 and abs(value) > _STIFFEST:
        raise ValueError(
            f"limit: received {text!r}, {value:g} GPa, accepted: up to {_STIFFEST:g} GPa; write the unit "
            f'if it is another one: "{name} {sign} {number} MPa"'
        )
    return Limit(
        f"{name} {sign[0]}= {value:.10g}",
        _NAMES[name],
        "at least" if sign[0] == ">" else "at most",
        to_si(name, value),
    )


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


# Sd of a normal variable over the median absolute difference of two draws; control limits in sd.
OF_MEDIAN_RANGE, SIGMAS = 1.0484, 3.0
LEAST_PLATES: Final = 3


@dataclass(frozen=True, slots=True)
class ControlChart:
    """Median and limits of one constant over the plates of a batch, in the order of the batch.

    sigma : from the median moving range
    outside : indices of the values beyond the limits
    """

    median: float
    sigma: float
    outside: tuple[int, ...]

    @property
    def limits(self) -> tuple[float, float]:
        """Median - 3 sigma and median + 3 sigma."""
        return self.median - SIGMAS * self.sigma, self.median + SIGMAS * self.sigma


def control_chart(values: Sequence[float]) -> ControlChart | None:
    """The control chart of individual values, from their moving ranges; None for fewer than three.

    median(x) +- 3 * 1.0484 median |x_i - x_(i-1)|: medians, because a bad plate would widen limits from means
    and hide (Montgomery, Introduction to Statistical Quality Control, section 6.4).
    """
    if len(values) < LEAST_PLATES:
        return None
    x = np.asarray(values, dtype=float)
    ranges = np.abs(np.diff(x))
    # the median is zero where more than half of the neighbours are equal
    typical = float(np.median(ranges)) or float(ranges.mean())
    median, sigma = float(np.median(x)), OF_MEDIAN_RANGE * typical
    outside = np.flatnonzero(np.abs(x - median) > SIGMAS * sigma)
    return ControlChart(median, sigma, tuple(int(i) for i in outside))
