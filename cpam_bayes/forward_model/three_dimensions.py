"""Corrections of first-order theory for three dimensions, and their uncertainty (docs/theory.md)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from cpam_bayes.answer import Notice
from cpam_bayes.forward_model.model import plate_problem, reference_constants
from cpam_bayes.mechanics.modes import Mode
from cpam_bayes.mechanics.problem import Array, Bias, PlateState
from cpam_bayes.plate import Specimen
from cpam_bayes.plate.edges import conditions
from cpam_bayes.plate.laminate import (
    angle_functions,
    constants_of,
    equal_plies,
    reduced_stiffness,
    rotated_stiffness,
    stiffness_invariants,
)
from cpam_bayes.plate.layup import Layup

THEORY_SHEAR: Final = "theory_shear"
"""The bias by shear, as the relative error of a mode of 1 kHz."""
THEORY_LEVEL: Final = "theory_level"
"""The relative error that edges cause in all frequencies."""

_KILOHERTZ: Final = 1000.0
# Fitted to the bricks of studies/16_theory_error.py by maximum likelihood, with a factor N(1, 0.5^2) of the
# bias: bias by shear, common scatter by free edges and by clamps, and the scatter of single modes by each.
_SHEAR, _FREE_EDGES, _CLAMPS, _FACTOR = 0.0085, 0.43, 0.012, 0.5
_FLOOR, _OF_SHEAR, _OF_FREE_EDGES, _OF_CLAMPS = 1e-4, 0.0036, 0.27, 0.0042
# Points per ply for the integrals over the thickness.
_POINTS: Final = 8
# Positions of (11, 12, 22, 66, 16, 26) in the matrix of a ply.
_ROWS, _COLUMNS = np.array([0, 0, 1, 2, 0, 1]), np.array([0, 1, 1, 2, 2, 2])


def theory_bias(specimen: Specimen) -> Bias:
    """The mean of ln f in three dimensions less that of first-order theory with ideal supports.

    b = 0.0085 w, w from `shear_frequency`: the theory's distribution of transverse shear over the thickness
    makes it too soft. The factor is known to a half, N(1, 0.5^2), see `common_theory_errors`.

    Measured by ``python studies/16_theory_error.py``: docs/theory.md, First-order theory against three
    dimensions.
    """
    return Bias(_SHEAR * float(shear_frequency(specimen, 1.0)))


def common_theory_errors(specimen: Specimen) -> dict[str, float]:
    """Errors of the theory that all modes share, relative standard deviations by name.

    Half of the bias by shear, at 1 kHz, and a level by edges,
    (0.43 h / (a b) sum_free L q)^2 + (0.012 h / (a b) sum_clamped L)^2, L the length of an edge and q its
    `edge_layer`. Which modes are affected most depends on the layup, so the level has no sign.
    """
    bias, (free, clamped) = theory_bias(specimen), edge_sums(specimen)
    level = float(np.hypot(_FREE_EDGES * free, _CLAMPS * clamped))
    return {THEORY_SHEAR: _FACTOR * bias.slope * _KILOHERTZ, THEORY_LEVEL: level}


def theory_powers(frequencies: Array) -> dict[str, Array]:
    """Relative changes of frequencies (n,), Hz, for each of these errors, d ln f / d error."""
    return {THEORY_SHEAR: frequencies / _KILOHERTZ, THEORY_LEVEL: np.ones_like(frequencies)}


def theory_error(specimen: Specimen, frequencies: ArrayLike) -> Array:
    """Relative standard deviation of single modes about `theory_bias`, independent of each other, (n,).

    e^2 = 0.0001^2 + (0.0036 w)^2 + (0.27 h / (a b) sum_free L q)^2 + (0.0042 h / (a b) sum_clamped L)^2.

    frequencies : (n,) Hz
    Raises ``ValueError`` if ply angles are unknown.
    """
    layup = specimen.plate.layup
    if layup.n_unknown:
        raise ValueError(f"layup {layup.text}: a known layup is needed for the error of the theory")
    free, clamped = edge_sums(specimen)
    by_edges = np.hypot(_OF_FREE_EDGES * free, _OF_CLAMPS * clamped)
    by_shear = _OF_SHEAR * shear_frequency(specimen, frequencies)
    return np.asarray(np.sqrt(_FLOOR**2 + by_edges**2 + by_shear**2))


def edge_sums(specimen: Specimen) -> tuple[float, float]:
    """h / (a b) sum L q over free edges, and h / (a b) sum L over clamped ones.

    Free edges of a layup with unknown angles count as if all plies were alike.
    """
    plate = specimen.plate
    lengths, edges = (plate.width, plate.length) * 2, list(enumerate(conditions(plate.edges)))
    is_known = not plate.layup.n_unknown
    free = sum(lengths[k] * edge_layer(specimen, k % 2) for k, e in edges if e.is_free and is_known)
    clamped = sum(lengths[k] for k, e in edges if e.is_clamp)
    return free * plate.thickness / plate.area, clamped * plate.thickness / plate.area


def shear_frequency(specimen: Specimen, frequencies: ArrayLike) -> Array:
    """Angular frequency times the time of a shear wave through the thickness, 2 pi f h (rho / G13)^1/2.

    1 / G13 is its mean over the thickness.

    frequencies : (n,) Hz.
    """
    plate, plies = specimen.plate, _moduli(reference_constants(specimen), specimen.plate.layup)
    compliance = np.diff(plies.interfaces) @ (1.0 / plies.g13)
    slowness = np.sqrt(plate.density * compliance)
    return np.asarray(2.0 * np.pi * np.asarray(frequencies) * plate.thickness * slowness)


def edge_layer(specimen: Specimen, axis: int) -> float:
    """Strain energy that a free edge across an axis (0: x, 1: y) releases, over that of bending along it.

    A bending moment along the edge causes stresses in the plies there whose resultants vanish. Interlaminar
    shear relieves them over a width d: a d + b / d is least at 2 (a b)^1/2, with a the energy of those
    stresses and b that of the shear forces between plies that balance them (Pipes and Pagano, Journal of
    Composite Materials 4, 1970). Returns (a b)^1/2, in units of the bending energy and of the thickness.
    """
    plies = _moduli(reference_constants(specimen), specimen.plate.layup)
    ply = np.empty((len(plies.g13), 3, 3))
    ply[:, _ROWS, _COLUMNS] = ply[:, _COLUMNS, _ROWS] = plies.plane
    stiffness, compliance = (np.repeat(each, _POINTS, axis=0) for each in (ply, np.linalg.inv(ply)))
    thickness = np.diff(plies.interfaces)
    z = (plies.interfaces[:-1, None] + thickness[:, None] * (np.arange(_POINTS) + 0.5) / _POINTS).ravel()
    step = np.repeat(thickness / _POINTS, _POINTS)
    powers = np.stack((np.ones_like(z), z))
    moments = np.einsum("pk,qk,kij,k->piqj", powers, powers, stiffness, step).reshape(6, 6)
    strains = np.linalg.solve(moments, np.eye(6)[4 - axis]).reshape(2, 3)
    stress = np.einsum("kij,pk,pj->ki", stiffness, powers, strains)
    energy = np.einsum("ki,kij,kj,k->", stress, compliance, stress, step)
    left = np.zeros_like(stress)
    across = [axis, 2]
    # the part constant or linear in z has a resultant, which the theory's own edge layer relieves
    weights = powers * step
    linear = powers.T @ np.linalg.solve(weights @ powers.T, weights @ stress[:, across])
    left[:, across] = stress[:, across] - linear
    a = np.einsum("ki,kij,kj,k->", left, compliance, left, step)
    forces = np.cumsum(left[:, across] * step[:, None], axis=0)
    b = np.sum(forces**2, axis=1) @ (step / np.repeat(plies.g13, _POINTS))
    return float(np.sqrt(a * b) / energy)


@dataclass(frozen=True, slots=True)
class _Moduli:
    """Moduli of n plies in the directions of the plate.

    interfaces : (n + 1,) z / h. plane : (n, 6), from ``rotated_stiffness``. g13, g23 : (n,) along and across
        the fibres, Pa. turn : (n,) cos 2t
    """

    interfaces: Array
    plane: Array
    g13: Array
    g23: Array
    turn: Array


def _moduli(constants: Mapping[str, ArrayLike], layup: Layup) -> _Moduli:
    """The moduli of the plies of a known layup, each by the constants of its material."""
    plies = layup.plies or equal_plies(layup.n_plies)
    functions = angle_functions(layup.angles_deg)
    plane, shear = np.empty((layup.n_plies, 6)), np.empty((2, layup.n_plies))
    for k, name in enumerate(plies.names):
        here = plies.material == k
        own = constants_of(constants, name)
        plane[here] = rotated_stiffness(stiffness_invariants(reduced_stiffness(own)), functions[here])
        shear[:, here] = [[float(np.real(own[g]))] for g in ("G13", "G23")]
    return _Moduli(plies.interfaces, plane, shear[0], shear[1], functions[:, 1])


# A ply is core where its transverse shear modulus is below this fraction of the largest.
_CORE: Final = 0.2
# Relative error of a frequency from which it is reported.
_SAID: Final = 0.005

LIMIT: Final = 0.05
"""Relative error of a frequency from which first-order theory is useless for a sandwich."""


def sandwich_error(
    specimen: Specimen, frequencies: ArrayLike, constants: Mapping[str, ArrayLike] = MappingProxyType({})
) -> Array:
    """Relative amount by which first-order theory makes bending frequencies of a sandwich too low, (n,).

    Faces keep their own bending stiffness D_f whatever the core does: a wave has
    m w^2 = D_f k^4 + D_0 k^4 / (1 + D_0 k^2 / S), D_0 = D - D_f (Allen, Analysis and Design of Structural
    Sandwich Panels, 1969, on thick faces). First-order theory with the energy-consistent shear stiffness
    A_s = S / (1 - r)^2, r = D_f / D, has m w^2 = D k^4 / (1 + D k^2 / A_s). With
    y = D k^2 / A_s / (1 - r) the first is 1 + r (1 - r) y^2 / (1 + y) times the second. k follows from the
    frequency; of waves along x and along y the larger error is taken. At a clamped edge the faces are held
    too: over d = (D_f / S)^1/2 the core does not shear, which adds y / (1 + y) d / L for each clamped
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
    edges = conditions(specimen.plate.edges)
    clamped = [edges[axis].is_clamp + edges[axis + 2].is_clamp for axis in (0, 1)]
    of_axes = (_of_waves(state, layup, k, shear[k], clamped[k], omega2) for k in (0, 1))
    return np.maximum(*of_axes)


def _of_waves(state: PlateState, layup: Layup, axis: int, shear: float, clamped: int, omega2: Array) -> Array:
    """`sandwich_error` of waves along an axis (0: x, 1: y), (n,).

    shear : A_s of the axis, N/m. clamped : number of its clamped ends. omega2 : (n,), (rad/s)^2.
    """
    bending, of_faces = _bending(state, layup, axis)
    r = of_faces / bending
    by_shear = state.density * state.thickness * omega2 / shear
    by_bending = state.density * state.thickness * omega2 / bending
    k2 = (by_shear + np.sqrt(by_shear**2 + 4.0 * by_bending)) / 2.0
    y = bending * k2 / shear / (1.0 - r)
    held = np.sqrt(of_faces / shear) / (1.0 - r) / float(state.length if axis == 0 else state.width)
    of_waves = 1.0 - 1.0 / np.sqrt(1.0 + r * (1.0 - r) * y**2 / (1.0 + y))
    return np.asarray(np.minimum(of_waves + clamped * held * y / (1.0 + y), 1.0))


def _bending(state: PlateState, layup: Layup, axis: int) -> tuple[float, float]:
    """Bending stiffness along an axis, N m, of the whole plate and of its faces about their own axes."""
    plies = _moduli(state.constants, layup)
    modulus = plies.plane[:, (0, 2)[axis]]
    along, across = plies.g13, plies.g23
    shear = (along + across) / 2.0 + (along - across) / 2.0 * plies.turn * (1.0, -1.0)[axis]
    z = plies.interfaces * float(state.thickness)
    moments = np.array([modulus * np.diff(z**k) / k for k in (1, 2, 3)])
    is_core = shear < _CORE * shear.max()
    if not is_core.any():
        return _about_own_middle(moments), 0.0
    runs = [list(run) for core, run in groupby(range(len(is_core)), lambda i: bool(is_core[i])) if not core]
    return _about_own_middle(moments), sum(_about_own_middle(moments[:, run]) for run in runs)


def _about_own_middle(moments: Array) -> float:
    """Bending stiffness about the neutral axis, from the moments (3, n) of ply moduli about any height."""
    a, b, d = moments.sum(axis=1)
    return float(d - b * b / a)


def sandwich_notices(
    specimen: Specimen, modes: Sequence[Mode], constants: Mapping[str, ArrayLike] = MappingProxyType({})
) -> tuple[Notice, ...]:
    """A notice where first-order theory nears its limit in some mode, or is beyond it.

    constants : in place of the reference ones, SI.
    """
    frequencies = [mode.frequency for mode in modes if mode.kind != "in-plane"]
    worst = float(np.max(sandwich_error(specimen, frequencies, constants), initial=0.0))
    if worst < _SAID:
        return ()
    return (Notice("soft_core", facts={"error": worst, "limit": LIMIT}),)
