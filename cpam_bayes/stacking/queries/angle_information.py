"""What a list says about each unknown angle, and whether it says more about the outer plies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.plate.layup import Layup

__all__ = ["AngleInformation", "angle_information", "bending_fractions", "entropies"]

Array = NDArray[Any]

# Entropies this near are equal, bits.
_SAME = 0.05


@dataclass(frozen=True, slots=True)
class AngleInformation:
    """How well each unknown angle is known, and how much it bends.

    entropy_bits : (k,) of the angles' marginals. most_bits : of an even marginal. bending_fraction : (k,) of
    the laminate's second moment. outer_first : (k,) the unknowns in descending order of that.
    outer_better : whether each angle is known as well as the next one further in, or better, and the first
    better than the last; differences below 0.05 bits count as none.
    """

    entropy_bits: Array
    most_bits: float
    bending_fraction: Array
    outer_first: Array
    outer_better: bool


def entropies(marginals: Array) -> Array:
    """Entropy of probabilities (k, n), nats, (k,): -sum p log p."""
    return np.asarray(-np.sum(marginals * np.log(np.where(marginals > 0, marginals, 1.0)), axis=1))


def bending_fractions(layup: Layup) -> Array:
    """Share of each unknown angle's plies in the second moment of the thickness, plies being equal, (k,).

    A ply from z_i to z_(i+1) has (z_(i+1)^3 - z_i^3) / 3 of h^3 / 12: what it weighs in D.
    """
    z = np.linspace(-1.0, 1.0, layup.n_plies + 1)
    share = np.diff(z**3) / 2.0
    return np.array([share[layup.unknown_index == k].sum() for k in range(layup.n_unknown)])


def angle_information(layup: Layup, marginals: Array) -> AngleInformation:
    """Entropies of the angles' marginals (k, n_grid) beside the angles' weight in bending."""
    bits = entropies(marginals) / np.log(2.0)
    share = bending_fractions(layup)
    order = np.argsort(-share, kind="stable")
    inwards = bits[order]
    return AngleInformation(
        entropy_bits=bits,
        most_bits=float(np.log2(marginals.shape[1])),
        bending_fraction=share,
        outer_first=order,
        outer_better=bool(np.all(np.diff(inwards) >= -_SAME) and inwards[-1] - inwards[0] > _SAME),
    )
