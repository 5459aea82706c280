"""How well the frequencies determine each unknown angle, and whether the outer plies better."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.plate.layup import Layup

Array = NDArray[Any]

# Entropies that differ by less are equal, bits.
_EQUAL_BITS = 0.05


@dataclass(frozen=True, slots=True)
class AngleInformation:
    """How well each unknown angle is determined, and how much it counts in bending.

    entropy_bits : (k,) of the angles' marginals.
    most_bits : of an even marginal.
    bending_fraction : (k,) fraction of the laminate's second moment.
    outer_first : (k,) the unknowns in descending order of that.
    outer_better : whether each angle is determined as well as the next one further in, or better, and the
    first better than the last; differences below 0.05 bits count as none.
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
    """Fraction of each unknown angle's plies in the second moment of the thickness, plies being equal, (k,).

    A ply from z_i to z_(i+1) has (z_(i+1)^3 - z_i^3) / 3 of h^3 / 12, its weight in D.
    """
    z = np.linspace(-1.0, 1.0, layup.n_plies + 1)
    fraction = np.diff(z**3) / 2.0
    return np.array([fraction[layup.unknown_index == k].sum() for k in range(layup.n_unknown)])


def angle_information(layup: Layup, marginals: Array) -> AngleInformation:
    """Entropies of the angles' marginals (k, n_grid) beside the angles' weight in bending."""
    bits = entropies(marginals) / np.log(2.0)
    fraction = bending_fractions(layup)
    order = np.argsort(-fraction, kind="stable")
    inwards = bits[order]
    return AngleInformation(
        entropy_bits=bits,
        most_bits=float(np.log2(marginals.shape[1])),
        bending_fraction=fraction,
        outer_first=order,
        outer_better=bool(
            np.all(np.diff(inwards) >= -_EQUAL_BITS) and inwards[-1] - inwards[0] > _EQUAL_BITS
        ),
    )
