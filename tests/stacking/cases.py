"""Plates with unknown plies: one with all its sequences and the mixture over them, computed once."""

from dataclasses import replace

import numpy as np

from cpam_bayes.forward_model.build import reduced_model
from cpam_bayes.forward_model.model import angle_parameters, plate_problem, reference_vector
from cpam_bayes.identification.angle_search import search_parameters
from cpam_bayes.mechanics.dense import discretise_at
from cpam_bayes.mechanics.modes import solve
from cpam_bayes.mechanics.ritz import RitzSettings, ritz_space
from cpam_bayes.plate import Measurement, Specimen, builtin
from cpam_bayes.plate.layup import Layup, parse_layup
from cpam_bayes.stacking.posterior import MixtureSettings, StackingMixture, sample_mixture, stacking_posterior
from cpam_bayes.stacking.records import StackingPosterior, StackingSettings
from tests.shared import once_a_run

TRUE = (30.0, -60.0)
STEP = 30.0
FREQUENCIES = 6
SAMPLED = 0.03  # Probability above which a class of the mixture is sampled by emcee: the first three are.


def with_layup(specimen: Specimen, layup: Layup) -> Specimen:
    return replace(specimen, plate=replace(specimen.plate, layup=layup))


@once_a_run
def listed(
    layup: str, step: float, angles=TRUE, relative_std: float | None = 0.01, thickness: float = 0.0032
) -> Specimen:
    """A thin rectangular plate with the noise-free list of one sequence, and a stated noise."""
    own = builtin("C1")
    plate = replace(own.plate, layup=parse_layup(layup), width=0.19, thickness=thickness)
    own = replace(own, plate=plate, measurement=None, angle_grid_deg=step)
    model = reduced_model(own, angle_parameters(own).union(own.unknowns), FREQUENCIES)
    x = np.concatenate((angles, reference_vector(own, own.unknowns)))
    f, unnamed = model.full.predict(x).frequencies[0], ("",) * FREQUENCIES
    return replace(own, measurement=Measurement(f, 0.0, relative_std, None, unnamed, complete=True))


def specimen() -> Specimen:
    return listed("[?/?]_s", STEP)


@once_a_run
def answer() -> StackingPosterior:
    settings = StackingSettings(draws=60, listed=36, log2_points=9)
    return stacking_posterior(specimen(), 0, settings=settings)


@once_a_run
def mixture() -> StackingMixture:
    return sample_mixture(answer(), 0, settings=MixtureSettings(least=SAMPLED))


def shortened(n: int) -> StackingPosterior:
    return answer().listing(np.arange(n))


SIDE = 0.2
N_MODES = 8
BASIS = RitzSettings(6, 6, layers=0)  # polynomials, equal in x and y: all symmetries of the square


def unknown_plate(layup="[?/?]_s", edges="FFFF", width=SIDE, sensors=(), step: float = 15.0) -> Specimen:
    """A plate of SIDE by ``width`` m, 10 mm thick, of C1's material."""
    own, sizes = builtin("C1"), {"length": SIDE, "width": width, "thickness": 0.01}
    plate = replace(own.plate, layup=parse_layup(layup), edges=edges, **sizes)
    return replace(own, plate=plate, sensors=sensors, angle_grid_deg=step)


def frequencies(specimen: Specimen, angles_deg: np.ndarray) -> np.ndarray:
    """Frequencies of the full model for each row of angles (m, n_unknown), (m, N_MODES) Hz."""
    parameters = search_parameters(specimen)
    constants = reference_vector(specimen, specimen.unknowns)
    x = np.hstack((np.tile(constants, (len(angles_deg), 1)), angles_deg))
    problem, found = plate_problem(specimen, parameters), []
    for row in x:  # one at a time: each laminate has its own symmetries
        values = parameters.mapping(row[None])
        space = ritz_space(problem.edges, problem.nominal, BASIS)
        operator = discretise_at(problem, space, values)
        found.append(solve(operator, np.eye(1), np.eye(1), N_MODES).frequencies[0])
    return np.array(found)
