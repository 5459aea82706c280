"""Sandwich plates: stiff faces that bend by themselves about a soft core, which first-order theory lacks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cpam_bayes.formatting import significant
from cpam_bayes.forward_model.model import plate_problem
from cpam_bayes.mechanics.problem import PlateState
from cpam_bayes.mechanics.shapes import Mode
from cpam_bayes.plate import Specimen
from cpam_bayes.plate.laminate import (
    angle_functions,
    constants_of,
    equal_plies,
    reduced_stiffness,
    rotated_stiffness,
    stiffness_invariants,
)

Array = NDArray[Any]

# A ply is core where its transverse shear modulus is below this part of the largest.
_CORE: Final = 0.2
# Relative error of a frequency from which it is said.
_SAID: Final = 0.005

LIMIT: Final = 0.05
"""Relative error of a frequency from which first-order theory is of no use for a sandwich."""


def sandwich_error(
    specimen: Specimen,
    frequencies: ArrayLike,
    constants: Mapping[str, ArrayLike] = MappingProxyType({}),
) -> Array:
    """By how much first-order theory makes the bending frequencies of a sandwich too low, (n,), relative.

    Faces with a bending stiffness D_f of their own have it whatever the core does: a wave has
    m w^2 = D_f k^4 + D_0 k^4 / (1 + D_0 k^2 / S), D_0 = D - D_f (Allen, Analysis and Design of Structural
    Sandwich Panels, 1969, on thick faces). First-order theory with the energy-consistent shear stiffness
    A_s = S / (1 - r)^2, r = D_f / D, has m w^2 = D k^4 / (1 + D k^2 / A_s). With
    y = D k^2 / A_s / (1 - r) the first is 1 + r (1 - r) y^2 / (1 + y) times the second. k follows from the
    frequency; of waves along x and along y the larger error is taken. At a clamped edge the faces are held
    too: over d = (D_f / S)^1/2 the core does not shear, which takes y / (1 + y) d / L more for each clamped
    edge across a side L (the density of the shear energy is twice its mean there). The error is 0 without a
    soft core. Measured by ``python studies/22_sandwiches.py``.

    frequencies : (n,) Hz, of bending modes.
    constants : in place of the reference ones, SI.
    """
    layup = specimen.plate.layup
    if layup.n_unknown:
        raise ValueError(f"layup {layup.text}: a known layup is needed for the error of the theory")
    nominal = plate_problem(specimen).nominal
    state = replace(nominal, constants=specimen.material.complete(constants))
    omega2 = (2.0 * np.pi * np.asarray(frequencies, dtype=float)) ** 2
    shear = np.real(state.stiffness())[[7, 6], [7, 6]]
    edges = specimen.plate.edges
    clamped = [(edges[axis] + edges[axis + 2]).count("C") for axis in (0, 1)]
    of_axes = (_of_waves(state, layup.angles_deg, k, shear[k], clamped[k], omega2) for k in (0, 1))
    return np.maximum(*of_axes)


def _of_waves(
    state: PlateState, angles_deg: Array, axis: int, shear: float, clamped: int, omega2: Array
) -> Array:
    """e of waves along an axis (0: x, 1: y), (n,).

    shear : A_s across it, N/m. clamped : number of its ends that are. omega2 : (n,), (rad/s)^2.
    """
    bending, of_faces = _bending(state, angles_deg, axis)
    r = of_faces / bending
    by_shear = state.density * state.thickness * omega2 / shear
    by_bending = state.density * state.thickness * omega2 / bending
    k2 = (by_shear + np.sqrt(by_shear**2 + 4.0 * by_bending)) / 2.0
    y = bending * k2 / shear / (1.0 - r)
    held = np.sqrt(of_faces / shear) / (1.0 - r) / float(state.length if axis == 0 else state.width)
    of_waves = 1.0 - 1.0 / np.sqrt(1.0 + r * (1.0 - r) * y**2 / (1.0 + y))
    return np.asarray(np.minimum(of_waves + clamped * held * y / (1.0 + y), 1.0))


def _bending(state: PlateState, angles_deg: Array, axis: int) -> tuple[float, float]:
    """Bending stiffness along an axis, N m, of the whole plate and of its faces about their own middles."""
    plies = state.plies or equal_plies(angles_deg.size)
    functions = angle_functions(angles_deg)
    modulus, shear = np.empty(angles_deg.size), np.empty(angles_deg.size)
    for k, name in enumerate(plies.names):
        here = plies.material == k
        constants = constants_of(state.constants, name)
        invariants = stiffness_invariants(reduced_stiffness(constants))
        modulus[here] = rotated_stiffness(invariants, functions[here])[:, (0, 2)[axis]]
        g13, g23 = (float(np.real(constants[g])) for g in ("G13", "G23"))
        turn = functions[here, 1] * (1.0, -1.0)[axis]
        shear[here] = (g13 + g23) / 2.0 + (g13 - g23) / 2.0 * turn
    z = plies.interfaces * float(state.thickness)
    moments = np.array([modulus * np.diff(z**k) / k for k in (1, 2, 3)])
    is_core = shear < _CORE * shear.max()
    if not is_core.any():
        return _about_own_middle(moments), 0.0
    runs = [list(run) for core, run in groupby(range(len(is_core)), lambda i: bool(is_core[i])) if not core]
    return _about_own_middle(moments), sum(_about_own_middle(moments[:, run]) for run in runs)


def _about_own_middle(moments: Array) -> float:
    """Bending stiffness of plies with moments (3, n) of their moduli about any height."""
    a, b, d = moments.sum(axis=1)
    return float(d - b * b / a)


def sandwich_warnings(
    specimen: Specimen, modes: Sequence[Mode], constants: Mapping[str, ArrayLike] = MappingProxyType({})
) -> tuple[str, ...]:
    """A warning where first-order theory nears its limit in some mode, or is beyond it.

    constants : in place of the reference ones, SI.
    """
    frequencies = [mode.frequency for mode in modes if mode.kind != "in-plane"]
    worst = float(np.max(sandwich_error(specimen, frequencies, constants), initial=0.0))
    if worst < _SAID:
        return ()
    said = (
        "the faces of this sandwich bend by themselves about its soft core, which first-order theory cannot "
        f"show: frequencies of the model are up to about {significant(100.0 * worst, 1)} % too low"
    )
    if worst > LIMIT:
        return (
            f"{said}, beyond its limit of {100.0 * LIMIT:g} %: do not use them, nor constants that are "
            "identified with them; forward --solver ccx computes the plate by bricks",
        )
    return (f"{said}, and moduli that are identified with them too high, by up to twice as much",)
