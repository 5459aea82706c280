"""What the air would change, for plates that are computed in vacuum."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.effects import add_air
from cpam_bayes.forward_model.model import NO_PARAMETERS, plate_problem
from cpam_bayes.mechanics.affine import discretise
from cpam_bayes.mechanics.modes import solve
from cpam_bayes.mechanics.problem import Problem
from cpam_bayes.mechanics.spaces.ritz import RitzSettings, ritz_space
from cpam_bayes.plate import Specimen
from cpam_bayes.threads import single_blas_thread

__all__ = ["ROOM_AIR", "air_shifts"]

ROOM_AIR = 1.2
"""Density of the air of a room, kg/m3."""

# The ratio of two frequencies on one space is exact to 1e-4 of itself long before they are.
_SETTINGS = RitzSettings(9, 9)


@single_blas_thread
def air_shifts(specimen: Specimen, n_modes: int) -> NDArray[Any]:
    """Relative changes of the lowest frequencies, f_air / f_vacuum - 1, (n_modes,).

    At the reference constants, in air of 1.2 kg/m3. The plate is a rectangle with a known layup. Raises
    ``RigidBodyError`` where bending cannot be told from rounding.
    """
    bare = plate_problem(replace(specimen, air_density=None), NO_PARAMETERS)
    in_vacuum, in_air = (_frequencies(problem, n_modes) for problem in (bare, add_air(bare, ROOM_AIR)))
    return np.asarray(in_air / in_vacuum - 1.0)


def _frequencies(problem: Problem, n_modes: int) -> NDArray[Any]:
    space = ritz_space(problem.edges, problem.nominal, _SETTINGS)
    operator = discretise(problem, space, {})
    return np.asarray(solve(operator, *operator.coefficients({}), n_modes).frequencies[0])
