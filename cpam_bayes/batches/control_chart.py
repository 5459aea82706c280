"""Shewhart's chart of individual values: which plates differ by more than the batch scatters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

__all__ = ["ControlChart", "control_chart"]

# Mean range of two normal values over their standard deviation, d2; limits in standard deviations.
_D2, _SIGMAS = 1.128, 3.0
LEAST_PLATES: Final = 3


@dataclass(frozen=True, slots=True)
class ControlChart:
    """Mean and limits of one constant over the plates of a batch, in the order of the batch.

    sigma : from the mean moving range, MR / 1.128
    outside : numbers, from 0, of the values beyond the limits
    """

    mean: float
    sigma: float
    outside: tuple[int, ...]

    @property
    def limits(self) -> tuple[float, float]:
        """Mean - 3 sigma and mean + 3 sigma."""
        return self.mean - _SIGMAS * self.sigma, self.mean + _SIGMAS * self.sigma


def control_chart(values: Sequence[float]) -> ControlChart | None:
    """The chart of individual values with limits from their moving ranges; None of fewer than three.

    Mean +- 3 MR / 1.128, MR the mean of |x_i - x_(i-1)| (Montgomery, Introduction to Statistical Quality
    Control; NIST/SEMATECH e-Handbook, 6.3.2.2).
    """
    if len(values) < LEAST_PLATES:
        return None
    x = np.asarray(values, dtype=float)
    mean, sigma = float(x.mean()), float(np.mean(np.abs(np.diff(x)))) / _D2
    outside = np.flatnonzero(np.abs(x - mean) > _SIGMAS * sigma)
    return ControlChart(mean, sigma, tuple(int(i) for i in outside))
