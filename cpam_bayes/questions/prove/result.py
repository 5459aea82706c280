"""The answer of the coin test: what each further list says, and the seal."""

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

# Standard deviations of a 95 % interval.
_WITHIN: Final = 1.96


@dataclass(frozen=True, slots=True)
class Stated:
    """The content of the seal, SI. shifts, sd : (n,) of ln f' - ln f that the first list predicts for it."""

    mass: float
    place: tuple[float, float]
    shifts: Array
    sd: Array

    def holds(self, shifts: Array) -> Array:
        """Whether shifts (n,) are inside the 95 % intervals, (n,)."""
        return np.asarray(np.abs(shifts - self.shifts) <= _WITHIN * self.sd)


@dataclass(frozen=True, slots=True)
class Coin:
    """One further list. name : of its file; found : what it says; shifts : (n,) ln f' - ln f, measured."""

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
        """From the stated place to the one that was found, or its nearest mirror image, m."""
        if self.stated is None or not self.stated.mass or not self.is_added:
            return None
        return self.found.distance(*self.stated.place)

    @property
    def is_inside(self) -> bool | None:
        """Whether the 95 % interval holds the stated mass; of a list without one, that none is claimed."""
        if self.stated is None:
            return None
        if not self.stated.mass:
            return not self.is_added
        low, high = self.found.interval
        return low <= self.stated.mass <= high

    @property
    def shifts_inside(self) -> int | None:
        """Number of shifts within the 95 % intervals that the first list and the seal predict."""
        return None if self.stated is None else int(np.sum(self.stated.holds(self.shifts)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class CoinResult(PlateResult):
    """The mass stuck to a plate after its first list, by each further list.

    Attributes
    ----------
    coins : in the order of the lists
    hash : SHA-256 of the sealed file as it was before the answer, "" without one
    detection_limit : mass that is claimed with 95 % probability, kg; None where none is
    spread : of several sealed lists, the 95 % interval of the relative repeatability and the bound of the
        error of a shift, as of `spread_of_shifts`
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
        """Shares of masses and of shifts inside their 95 % intervals; None without a seal."""
        inside = [coin.is_inside for coin in self.coins if coin.is_inside is not None]
        if not inside:
            return None
        shifts = [(coin.shifts_inside or 0) / len(coin.shifts) for coin in self.coins]
        return {"mass": float(np.mean(inside)), "shifts": float(np.mean(shifts))}
