"""What the air would change, for plates that are computed in vacuum."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.effects import add_air
from cpam_bayes.forward_model.model import NO_PARAMETERS, plate_problem
from cpam_bayes.mechanics.dense import discretise
from cpam_bayes.mechanics.modes import RigidBodyError, solve
from cpam_bayes.mechanics.spaces.ritz import RitzSettings, ritz_space
from cpam_bayes.plate import Specimen
from cpam_bayes.threads import single_blas_thread

ROOM_AIR = 1.2
"""Density of the air of a room, kg/m3."""

# The ratio of two frequencies on one space is exact to 1e-4 of itself long before they are.
_SETTINGS = RitzSettings(9, 9)
# Modes for which the effect of air is computed where no measurement says how many there are.
_MODES = 6


@single_blas_thread
def air_shifts(specimen: Specimen, n_modes: int | None = None) -> NDArray[np.float64] | None:
    """Relative changes of the lowest frequencies, f_air / f_vacuum - 1, (n_modes,).

    At the reference constants, in air of 1.2 kg/m3, by default for as many modes as were measured. None
    where air is in the model already, for a mesh from a file, for unknown angles, and where bending cannot
    be distinguished from rounding.
    """
    if specimen.air_density or specimen.plate.mesh is not None or specimen.plate.layup.n_unknown:
        return None
    if n_modes is None:
        n_modes = _MODES if specimen.measurement is None else specimen.measurement.size
    bare = plate_problem(replace(specimen, air_density=None), NO_PARAMETERS)
    mass_terms = len(bare.forms("mass"))
    problem = add_air(bare, ROOM_AIR)
    operator = discretise(problem, ritz_space(problem.edges, problem.nominal, _SETTINGS), {})
    stiffness, in_air = operator.coefficients({})
    # The mass of the air is the last of the terms.
    in_vacuum = np.where(np.arange(in_air.shape[-1]) < mass_terms, in_air, 0.0)
    try:
        air, vacuum = (solve(operator, stiffness, m, n_modes).frequencies[0] for m in (in_air, in_vacuum))
    except RigidBodyError:
        return None
    return np.asarray(air / vacuum - 1.0)
