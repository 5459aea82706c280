"""Shewhart's chart of individual values: which plates differ by more than the batch scatters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

__all__ = ["ControlChart", "control_chart"]

# Standard deviation of normal values over the median range of two of them; limits in standard deviations.
_OF_MEDIAN_RANGE, _SIGMAS = 1.047, 3.0
LEAST_PLATES: Final = 3


@dataclass(frozen=True, slots=True)
class ControlChart:
    """Median and limits of one constant over the plates of a batch, in the order of the batch.

    sigma : from the median moving range
    outside : numbers, from 0, of the values beyond the limits
    """

    median: float
    sigma: float
    outside: tuple[int, ...]

    @property
    def limits(self) -> tuple[float, float]:
        """Median - 3 sigma and median + 3 sigma."""
        return self.median - _SIGMAS * self.sigma, self.median + _SIGMAS * self.sigma


def control_chart(values: Sequence[float]) -> ControlChart | None:
    """The chart of individual values with limits from their moving ranges; None of fewer than three.

    median(x) +- 3 * 1.047 median |x_i - x_(i-1)|: medians, because a bad plate would widen limits from means
    and hide (Montgomery, Introduction to Statistical Quality Control, section 6.4).
    """
    if len(values) < LEAST_PLATES:
        return None
    x = np.asarray(values, dtype=float)
    ranges = np.abs(np.diff(x))
    # more than half of the neighbours are equal
    typical = float(np.median(ranges)) or float(ranges.mean())
    median, sigma = float(np.median(x)), _OF_MEDIAN_RANGE * typical
    outside = np.flatnonzero(np.abs(x - median) > _SIGMAS * sigma)
    return ControlChart(median, sigma, tuple(int(i) for i in outside))
