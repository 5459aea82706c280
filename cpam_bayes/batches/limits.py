"""Limits of quality control: "E1_GPa >= 115", and the probability that a constant meets one."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Final, Literal

from scipy.stats import t

from cpam_bayes.plate import USER_UNITS, to_si
from cpam_bayes.plate.elasticity import CONSTANTS

__all__ = ["Limit", "MarginalPosterior", "read_limit"]

_FORM: Final = re.compile(r"\s*(\w+)\s*(>=|<=|>|<)\s*([-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?)\s*")
_NAMES: Final = {user: name for user, (name, _) in USER_UNITS.items() if name in CONSTANTS}


@dataclass(frozen=True, slots=True)
class Limit:
    """What a constant has to meet; text : as written, name : of the constant, value : SI."""

    text: str
    name: str
    side: Literal["at least", "at most"]
    value: float


@dataclass(frozen=True, slots=True)
class MarginalPosterior:
    """The posterior of one constant: a Student-t about its optimum, cut at the bounds of its prior, SI.

    freedom : degrees of freedom, infinite for a Gaussian
    """

    centre: float
    sd: float
    freedom: float
    lower: float
    upper: float

    def below(self, value: float) -> float:
        """Probability of a smaller constant."""
        if value <= self.lower:
            return 0.0
        if value >= self.upper:
            return 1.0
        low, here, high = (self._mass(v) for v in (self.lower, value, self.upper))
        return (here - low) / (high - low)

    def meets(self, limit: Limit) -> float:
        """Probability of meeting a limit."""
        below = self.below(limit.value)
        return 1.0 - below if limit.side == "at least" else below

    def _mass(self, value: float) -> float:
        return float(t.cdf((value - self.centre) / self.sd, self.freedom))


def read_limit(text: str) -> Limit:
    """Read a limit such as ``E1_GPa >= 115``, in the unit of the plate file.

    raises ValueError for a text that is none
    """
    match = _FORM.fullmatch(text)
    if match is None or not _is_number(match[3]):
        raise ValueError(
            f'limit: received {text!r}, accepted: a constant, >= or <=, a number: "E1_GPa >= 115"'
        )
    name, sign, value = match.groups()
    if name not in _NAMES:
        raise ValueError(f"limit: received {text!r}, constants that have limits: {' '.join(_NAMES)}")
    return Limit(
        f"{name} {sign[0]}= {float(value):.10g}",
        _NAMES[name],
        "at least" if sign[0] == ">" else "at most",
        to_si(name, float(value)),
    )


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False
