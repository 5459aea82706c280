"""The result of the coin test: the finding of each further list, and the seal."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.identification.added_mass import AddedMass, Finding
from cpam_bayes.questions.identify.pso import PointResult
from cpam_bayes.result import PlateResult

Array = NDArray[Any]

# Half width of a 95 % interval in standard deviations.
_WITHIN: Final = 1.96


@dataclass(frozen=True, slots=True)
class Stated:
    """One sealed coin, SI. shifts, sd : (n,) ln f' - ln f predicted for it from the first list."""

    mass: float
    place: tuple[float, float]
    shifts: Array
    sd: Array

    def holds(self, shifts: Array) -> Array:
        """Whether shifts (n,) are inside their 95 % intervals, (n,)."""
        return np.asarray(np.abs(shifts - self.shifts) <= _WITHIN * self.sd)


@dataclass(frozen=True, slots=True)
class Coin:
    """One further list. name : of its file; found : the finding; shifts : (n,) ln f' - ln f, measured."""

    name: str
    found: AddedMass
    shifts: Array
    stated: Stated | None

    @property
    def is_added(self) -> bool:
        """Whether a mass is claimed."""
        return self.found.finding is Finding.ADDED

    @property
    def distance(self) -> float | None:
        """Distance from the stated place to the found one, or to its nearest mirror image, m."""
        if self.stated is None or not self.stated.mass or not self.is_added:
            return None
        return self.found.distance(*self.stated.place)

    @property
    def is_inside(self) -> bool | None:
        """Whether the 95 % interval holds the stated mass; if none is stated, whether none is claimed."""
        if self.stated is None:
            return None
        if not self.stated.mass:
            return not self.is_added
        low, high = self.found.interval
        return low <= self.stated.mass <= high

    @property
    def shifts_inside(self) -> int | None:
        """Number of shifts inside the 95 % intervals predicted from the first list and the seal."""
        return None if self.stated is None else int(np.sum(self.stated.holds(self.shifts)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class CoinResult(PlateResult):
    """The masses stuck to a plate after its first list, one for each further list.

    Attributes
    ----------
    coins : in the order of the lists
    hash : SHA-256 of the sealed file before the answer, "" without one
    detection_limit : mass that is claimed with 95 % probability, kg; None if there is none
    spread : for several sealed lists, the 95 % interval of the relative repeatability and the bound of the
        error of a shift, see `spread_of_shifts`
    point : the identification from the first list
    """

    command: ClassVar[str] = "prove"

    coins: tuple[Coin, ...]
    hash: str
    detection_limit: float | None
    spread: tuple[tuple[float, float], float] | None
    point: PointResult

    @property
    def coverage(self) -> Mapping[str, float] | None:
        """Coverage of the 95 % intervals of masses and of shifts; None without a seal."""
        inside = [coin.is_inside for coin in self.coins if coin.is_inside is not None]
        if not inside:
            return None
        shifts = [(coin.shifts_inside or 0) / len(coin.shifts) for coin in self.coins]
        return {"mass": float(np.mean(inside)), "shifts": float(np.mean(shifts))}
