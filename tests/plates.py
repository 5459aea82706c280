"""Plates built by hand for tests, without a plate file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cpam_bayes.mechanics.convergence import Tolerance, converge
from cpam_bayes.mechanics.modes import solve
from cpam_bayes.mechanics.problem import PlateState, Problem, bare_plate
from cpam_bayes.parameters import ParameterSet
from cpam_bayes.plate import Specimen, builtin
from cpam_bayes.plate.laminate import (
    ENERGY_CONSISTENT,
    FIVE_SIXTHS,
    ShearModel,
    complete_constants,
    laminate_geometry,
)

CARBON = {"E1": 121.2e9, "E2": 9.34e9, "nu12": 0.23, "G12": 6.25e9}
GLASS = {"E1": 40.1e9, "E2": 8.9e9, "nu12": 0.23, "G12": 4.23e9}
CROSS_PLY_16S = tuple([0.0, 90.0] * 8 + [90.0, 0.0] * 8)
ANGLE_PLY_16S = tuple([45.0, -45.0] * 8 + [-45.0, 45.0] * 8)


def plate(
    length: float,
    width: float,
    thickness: float,
    density: float,
    constants: dict[str, float],
    layup: tuple[float, ...] = (0.0,),
    edges: str = "FFFF",
    shear: ShearModel = FIVE_SIXTHS,
) -> Problem:
    """A plate without unknowns; ``constants`` of E1 and nu12 alone are isotropic."""
    state = PlateState(
        np.asarray(length),
        np.asarray(width),
        np.asarray(thickness),
        np.asarray(density),
        complete_constants(constants, "transversely_isotropic" if "E2" in constants else "isotropic"),
        laminate_geometry(layup),
        shear,
    )
    return bare_plate(ParameterSet(()), edges, state, lambda values: state)


def frequencies(problem: Problem, n_modes: int, tolerance: Tolerance | None = None) -> np.ndarray:
    """Converged frequencies of a plate without unknowns, (n_modes,) Hz."""
    found = converge(problem, {}, n_modes, tolerance).operator
    return solve(found, *found.coefficients({}), n_modes).frequencies[0]


def with_plate(name: str, **changes: object) -> Specimen:
    """A built-in specimen with other entries of its plate."""
    specimen = builtin(name)
    return replace(specimen, plate=replace(specimen.plate, **changes))  # type: ignore[arg-type]


__all__ = [
    "ANGLE_PLY_16S",
    "CARBON",
    "CROSS_PLY_16S",
    "ENERGY_CONSISTENT",
    "FIVE_SIXTHS",
    "GLASS",
    "frequencies",
    "plate",
    "with_plate",
]
