"""Which intervals another constant's prior makes as narrow as they are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

__all__ = ["LEAST_WIDENING", "Reliance", "reliances"]

LEAST_WIDENING: Final = 0.1
"""Relative growth of a standard deviation that is worth a word."""

# 1 - 1/4: what a prior of twice the width takes off its precision
_LESS_PRECISION = 0.75


@dataclass(frozen=True, slots=True)
class Reliance:
    """A constant whose interval rests on the prior, or the bounds, of another one.

    name : of the constant
    on : the constant whose prior it is
    widening : relative growth of the standard deviation of ``name`` were the prior of ``on`` twice as wide
    """

    name: str
    on: str
    widening: float


def reliances(
    names: Sequence[str], covariance: Array, prior_sd: Array, sd: Array | None = None
) -> tuple[Reliance, ...]:
    """Constants whose interval would be wider by a tenth with a wider prior of another one.

    Of a normal posterior with covariance S, a normal prior of constant j with standard deviation s_j that
    becomes twice as wide takes 3/4 / s_j^2 off the precision of j, so that (Sherman and Morrison, Ann. Math.
    Stat. 21, 1950)

        S'_ii = S_ii + k S_ij^2 / (1 - k S_jj),  k = 3 / (4 s_j^2)

    Parameters
    ----------
    covariance : (n, n) of the posterior
    prior_sd : (n,)
    sd : (n,) standard deviations that the intervals have, where they contain more than the covariance does
    """
    variance = np.diag(covariance)
    shown = variance if sd is None else sd**2
    found = []
    for j, on in enumerate(names):
        left = _LESS_PRECISION / prior_sd[j] ** 2
        # a posterior piled up at both ends of its bounds has more variance than an even one
        added = left * covariance[:, j] ** 2 / (1.0 - min(left * variance[j], _LESS_PRECISION))
        for i, name in enumerate(names):
            widening = float(np.sqrt(1.0 + added[i] / shown[i]) - 1.0)
            if i != j and widening >= LEAST_WIDENING:
                found.append(Reliance(name, on, widening))
    return tuple(found)
