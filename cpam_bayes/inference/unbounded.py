"""Coordinates without bounds, by a logistic map of bounded ones or a logarithmic one of half-bounded ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, log_expit

from cpam_bayes.inference.derivatives import Coordinates

Array = NDArray[Any]


@dataclass(frozen=True, slots=True)
class WholeLine:
    """Coordinates v without bounds: u = l + w / (1 + exp(-v)), l + exp(v) or h - exp(-v), or v itself.

    below, above : (n,) bool, whether u has a lower bound l and an upper bound h.
    """

    axes: Coordinates
    below: Array
    above: Array

    def to_v(self, u: Array) -> Array:
        """u (..., n) to v; a u on its bound is taken a rounding inside."""
        lower, width = self._spans()
        both = self.below & self.above
        t = np.clip((u - lower) / width, 1e-12, 1.0 - 1e-12)
        inside = np.log(t) - np.log1p(-t)
        up = np.log(np.maximum(u - self.axes.lower, 1e-12), where=self.below, out=np.zeros_like(u))
        down = np.log(np.maximum(self.axes.upper - u, 1e-12), where=self.above, out=np.zeros_like(u))
        return np.asarray(np.where(both, inside, np.where(self.below, up, np.where(self.above, -down, u))))

    def to_u(self, v: Array) -> Array:
        """v (..., n) to u, both bounds kept to the last digit."""
        lower, width = self._spans()
        upper = np.where(self.above, self.axes.upper, 0.0)
        both = self.below & self.above
        low = np.where(v < 0, lower + width * expit(v), np.where(both, upper, 0.0) - width * expit(-v))
        grown = np.exp(np.where(self.below, v, -v))
        one = np.where(self.below, lower + grown, upper - grown)
        return np.asarray(np.where(both, low, np.where(self.below | self.above, one, v)))

    def log_jacobian(self, v: Array) -> Array:
        """log |du / dv|, (m, n) -> (m,)."""
        _, width = self._spans()
        both = self.below & self.above
        inside = np.log(width) + log_expit(v) + log_expit(-v)
        one = np.where(self.below, v, np.where(self.above, -v, 0.0))
        return np.asarray(np.where(both, inside, one).sum(axis=-1))

    def _spans(self) -> tuple[Array, Array]:
        both = self.below & self.above
        lower = np.where(self.below, self.axes.lower, 0.0)
        return lower, np.where(both, self.axes.upper - lower, 1.0)


def whole_line(axes: Coordinates) -> WholeLine:
    """The whole line of coordinates with bounds."""
    return WholeLine(axes, np.isfinite(axes.lower), np.isfinite(axes.upper))
