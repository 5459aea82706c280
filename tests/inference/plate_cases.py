"""Square and rectangular plates with unknown plies, and their frequencies on a fixed space."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cpam_bayes.forward_model.model import plate_problem, reference_vector
from cpam_bayes.identification.angle_search import search_parameters
from cpam_bayes.mechanics.dense import discretise_at
from cpam_bayes.mechanics.modes import solve
from cpam_bayes.mechanics.spaces.ritz import RitzSettings, ritz_space
from cpam_bayes.plate import Specimen, builtin
from cpam_bayes.plate.layup import parse_layup
from cpam_bayes.plate.records import Sensor

SIDE = 0.2
N_MODES = 8
# Polynomials alone, as many along x as along y: a space that has every symmetry of the square.
BASIS = RitzSettings(6, 6, layers=0)


def unknown_plate(
    layup: str, edges: str = "FFFF", width: float = SIDE, sensors: tuple[Sensor, ...] = (), step: float = 15.0
) -> Specimen:
    """A plate of SIDE by ``width`` m, 10 mm thick, of C1's material."""
    specimen = builtin("C1")
    plate = replace(
        specimen.plate, length=SIDE, width=width, thickness=0.01, layup=parse_layup(layup), edges=edges
    )
    return replace(specimen, plate=plate, sensors=sensors, angle_grid_deg=step)


def frequencies(specimen: Specimen, angles_deg: np.ndarray) -> np.ndarray:
    """Frequencies of the full model for each row of angles (m, n_unknown), (m, N_MODES) Hz."""
    parameters = search_parameters(specimen)
    constants = reference_vector(specimen, specimen.unknowns)
    x = np.hstack((np.tile(constants, (len(angles_deg), 1)), angles_deg))
    problem = plate_problem(specimen, parameters)
    found = []
    for row in x:  # one at a time: the symmetries of each laminate are its own
        values = parameters.mapping(row[None])
        space = ritz_space(problem.edges, problem.nominal, BASIS)
        operator = discretise_at(problem, space, values)
        found.append(solve(operator, np.eye(1), np.eye(1), N_MODES).frequencies[0])
    return np.array(found)
