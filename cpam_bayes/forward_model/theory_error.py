"""First-order theory and ideal supports against three dimensions: a known error of every frequency."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cpam_bayes.forward_model.model import reference_constants
from cpam_bayes.plate import Specimen
from cpam_bayes.plate.laminate import (
    angle_functions,
    reduced_stiffness,
    rotated_stiffness,
    stiffness_invariants,
)

Array = NDArray[Any]

# Measured by studies/16_theory_error.py, see `theory_error`.
_FLOOR: Final = 1e-4
_BY_SHEAR: Final = 0.009
_BY_FREE_EDGES: Final = 0.4
_BY_CLAMPS: Final = 0.018
# Points a ply for the integrals over the thickness.
_POINTS: Final = 8
# Place of (11, 12, 22, 66, 16, 26) in the matrix of a ply.
_ROWS, _COLUMNS = np.array([0, 0, 1, 2, 0, 1]), np.array([0, 1, 1, 2, 2, 2])


def theory_error(specimen: Specimen, frequencies: ArrayLike) -> Array:
    """Relative standard deviation of first-order theory with ideal supports against three dimensions.

    e^2 = 0.0001^2 + (0.009 w)^2 + (0.4 h / (a b) sum_free L q)^2 + (0.018 h / (a b) sum_clamped L)^2: w from
    `shear_frequency`, L the length of an edge and q its `edge_layer`. The parts are systematic, the theory
    being too soft in the second and fourth and too stiff in the third; they count as scatter because they
    differ from mode to mode.

    It was measured on plates of 240 x 180 mm with ten modes by ``python studies/16_theory_error.py``,
    which holds all plates. Root mean squares over modes, %, of the Ritz model against extrapolated bricks
    at a thickness of 1/150, 1/50, 1/25 and 1/15 of the short side:

    =================================== ===== ===== ===== =====
    plate                               1/150 1/50  1/25  1/15
    =================================== ===== ===== ===== =====
    carbon, [0/90]_2s, free             0.004 0.017 0.055 0.126
    carbon, [0], free                   0.012 0.015 0.066 0.138
    carbon, [0/45/-45/90]_s, free       0.084 0.260 0.565 1.001
    carbon, [45/-45]_2s, free           0.026 0.063 0.141 0.272
    carbon, [0/90]_2s, one edge clamped 0.009 0.014 0.065 0.146
    isotropic, free                     0.003 0.013 0.041 0.092
    isotropic, one edge clamped         0.020 0.048 0.108 0.195
    =================================== ===== ===== ===== =====

    Parameters
    ----------
    frequencies : (n,) Hz

    Returns
    -------
    (n,) relative standard deviations

    Raises
    ------
    ValueError
        If ply angles are unknown.
    """
    by_shear = _BY_SHEAR * shear_frequency(specimen, frequencies)
    return np.asarray(np.sqrt(_FLOOR**2 + _by_edges(specimen) ** 2 + by_shear**2))


def _by_edges(specimen: Specimen) -> float:
    plate = specimen.plate
    if plate.layup.n_unknown:
        raise ValueError(f"layup {plate.layup.text}: a known layup is needed for the error of the theory")
    lengths = (plate.width, plate.length) * 2
    free, clamped = ([k for k, c in enumerate(plate.edges) if c == kind] for kind in "FC")
    by_free = _BY_FREE_EDGES * sum(lengths[k] * edge_layer(specimen, k % 2) for k in free)
    by_clamps = _BY_CLAMPS * sum(lengths[k] for k in clamped)
    return float(np.hypot(by_free, by_clamps) * plate.thickness / plate.area)


def shear_frequency(specimen: Specimen, frequencies: ArrayLike) -> Array:
    """Angular frequency times the time of a shear wave through the thickness, 2 pi f h (rho / G13)^1/2.

    frequencies : (n,) Hz.
    """
    plate = specimen.plate
    slowness = np.sqrt(plate.density / reference_constants(specimen)["G13"])
    return np.asarray(2.0 * np.pi * np.asarray(frequencies) * plate.thickness * slowness)


def edge_layer(specimen: Specimen, axis: int) -> float:
    """Strain energy that a free edge across an axis (0: x, 1: y) releases, over that of bending along it.

    A bending moment along the edge leaves stresses in the plies there whose resultants vanish but not
    they themselves. Interlaminar shear takes them away over a width d: a d + b / d is least at
    2 (a b)^1/2, with a the energy of those stresses and b that of the shear forces between plies that
    balance them (Pipes and Pagano, Journal of Composite Materials 4, 1970, for a strip in tension). Here
    (a b)^1/2 is given in units of the bending energy and of the thickness. It vanishes where all plies
    are alike.
    """
    angles = specimen.plate.layup.angles_deg
    constants = reference_constants(specimen)
    n = len(angles)
    invariants = stiffness_invariants(reduced_stiffness(constants))
    entries = rotated_stiffness(invariants, angle_functions(angles))
    ply = np.empty((n, 3, 3))
    ply[:, _ROWS, _COLUMNS] = ply[:, _COLUMNS, _ROWS] = entries
    stiffness = np.repeat(ply, _POINTS, axis=0)
    compliance = np.repeat(np.linalg.inv(ply), _POINTS, axis=0)
    z = (np.arange(n * _POINTS) + 0.5) / (n * _POINTS) - 0.5
    step = 1.0 / z.size
    powers = np.stack((np.ones_like(z), z))
    moments = np.einsum("pk,qk,kij->piqj", powers, powers, stiffness).reshape(6, 6) * step
    strains = np.linalg.solve(moments, np.eye(6)[4 - axis]).reshape(2, 3)
    stress = np.einsum("kij,pk,pj->ki", stiffness, powers, strains)
    energy = np.einsum("ki,kij,kj->", stress, compliance, stress) * step
    left = np.zeros_like(stress)
    across = [axis, 2]
    # what is constant or linear in z has a resultant, which the theory's own edge layer takes away
    linear = powers.T @ np.linalg.lstsq(powers.T, stress[:, across], rcond=None)[0]
    left[:, across] = stress[:, across] - linear
    a = np.einsum("ki,kij,kj->", left, compliance, left) * step
    forces = np.cumsum(left[:, across], axis=0) * step
    b = np.sum(forces**2) * step / constants["G13"]
    return float(np.sqrt(a * b) / energy)
