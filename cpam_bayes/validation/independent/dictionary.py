"""Signatures of all causes on a plate: shifts of ln f at a grid of sizes and places.

By the independent elements, once a plate at its reference constants, for the oracle and for simpler
methods.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.optimize import linear_sum_assignment

from cpam_bayes.validation.independent.elements import BucklingError
from cpam_bayes.validation.independent.flaws import DEGREES_OF_FREEDOM, FLAWS, Aux
from cpam_bayes.validation.independent.lists import FURTHER, Linear, linear_of
from cpam_bayes.validation.independent.nominal import NominalPlate
from cpam_bayes.validation.independent.true_plate import (
    TruePlate,
    matrices,
    modes,
    natural_frequencies,
    observed,
)

Array = NDArray[np.float64]

MESH = 8
# Sizes at which a signature is solved, in prior scales.
_SIZES = (0.3, 1.0, 3.0, 10.0)
_PLACES = (0.06, 0.28, 0.5, 0.72, 0.94)
# Half widths of a soft patch, of the sides.
_PATCH = 0.1
# Sizes of the fine grid, in prior scales: 3 % apart, from where nothing shows to where priors end.
_FINE = np.exp(np.arange(np.log(0.02), np.log(40.0), 0.03))


@dataclass(frozen=True, slots=True)
class Signature:
    """Shifts of ln f of a cause at one place: sizes (k,) ascending with 0, shift (k, n_modes)."""

    cause: str
    place: int
    scale: float
    sizes: Array
    shift: Array

    def fine(self) -> tuple[Array, Array, Array]:
        """Sizes on a fine grid, shifts there, and log weights of the prior."""
        both = np.concatenate([-_FINE[::-1], _FINE]) * self.scale
        size = both[(both >= self.sizes[0]) & (both <= self.sizes[-1])]
        curve = PchipInterpolator(np.arcsinh(self.sizes / self.scale), self.shift, axis=0)
        step = np.gradient(size)
        density = (1.0 + (size / self.scale) ** 2 / DEGREES_OF_FREEDOM) ** (-(DEGREES_OF_FREEDOM + 1.0) / 2.0)
        weight = density * step
        return size, np.asarray(curve(np.arcsinh(size / self.scale))), np.log(weight / weight.sum())


@dataclass(frozen=True, slots=True)
class Dictionary:
    """All signatures of a plate at its reference constants, with the modes that they are of."""

    plate: NominalPlate
    signatures: tuple[Signature, ...]
    shapes: Array
    inertia: Any

    def at(self, plate: TruePlate) -> tuple[Linear, NDArray[np.int64]]:
        """The linear plate at other constants, and which reference mode each of its modes is."""
        meshed = replace(plate, mesh=MESH)
        _, shapes = modes(meshed, self.shapes.shape[1])
        overlap = np.abs(self.shapes.T @ (self.inertia @ shapes))
        rows, columns = linear_sum_assignment(-overlap)
        order = np.empty(len(rows), dtype=np.int64)
        order[columns] = rows
        return linear_of(self.plate, plate, mesh=MESH), order


def dictionary_of(nominal: NominalPlate) -> Dictionary:
    """Solve the signatures of a plate."""
    bare = replace(nominal.plate, mesh=MESH)
    n = nominal.n_modes + FURTHER
    f, shapes = modes(bare, n)
    ln_f = np.log(observed(bare, f))
    signatures = []
    for cause, flaw in FLAWS.items():
        if flaw.applies(nominal.plate):
            for i, aux in enumerate(_places(cause, nominal.plate)):
                signature = signature_of(bare, cause, aux, ln_f, i)
                if len(signature.sizes) > 2:
                    signatures.append(signature)
    return Dictionary(nominal, tuple(signatures), shapes, matrices(bare)[1])


def signature_of(
    bare: TruePlate, cause: str, aux: Aux, ln_f: Array, place: int, size: float | None = None
) -> Signature:
    """Shifts of a cause at one place; size : one more at which they are solved."""
    flaw = FLAWS[cause]
    scale, most = flaw.scale(bare), flaw.most(bare)
    at = {min(s * scale, most) for s in _SIZES}
    if flaw.two_sided:
        at |= {-s for s in at}
    if size is not None:
        at |= {size, 0.8 * size, 1.25 * size if abs(1.25 * size) <= most else size}
    sizes, shifts = [0.0], [np.zeros(len(ln_f))]
    for value in sorted(at):
        try:
            f = natural_frequencies(flaw.apply(bare, value, aux), len(ln_f))
        except BucklingError:
            continue
        sizes.append(value)
        shifts.append(np.log(f) - ln_f)
    rank = np.argsort(sizes)
    return Signature(cause, place, scale, np.array(sizes)[rank], np.array(shifts)[rank])


def _places(cause: str, plate: TruePlate) -> list[Aux]:
    grid = [{"x": x, "y": y} for x, y in product(_PLACES, _PLACES)]
    if cause == "sensor_mass":
        return list(grid)
    if cause == "damage":
        return [{**at, "form": "ellipse", "half": [_PATCH, _PATCH]} for at in grid]
    if cause == "outline":
        ends = (1.0,) if "C" in plate.edges else (0.0, 1.0)
        corners = [{"x": x, "y": y, "form": "rectangle", "ratio": 1.0} for x, y in product(ends, (0.0, 1.0))]
        inside = (0.25, 0.5, 0.75)
        holes = [{"x": x, "y": y, "form": "ellipse", "ratio": 1.0} for x, y in product(inside, inside)]
        return [*corners, *holes]
    return [{"ratio": 1.0}] if cause == "soft_clamp" else [{}]
