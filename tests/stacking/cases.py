"""A small plate with two unknown angles, all its sequences and the mixture over them, computed once."""

from dataclasses import replace

import numpy as np

from cpam_bayes.forward_model.model import angle_parameters, reference_vector
from cpam_bayes.forward_model.store import reduced_model
from cpam_bayes.plate import Measurement, Specimen, builtin
from cpam_bayes.plate.layup import parse_layup
from cpam_bayes.stacking.mixture import StackingMixture, sample_mixture
from cpam_bayes.stacking.posterior import stacking_posterior
from cpam_bayes.stacking.records import StackingPosterior, StackingSettings
from tests.shared import once_a_run

TRUE = (30.0, -60.0)
STEP = 30.0
FREQUENCIES = 6


def specimen_with(frequencies: np.ndarray, layup: str, step: float) -> Specimen:
    own = builtin("C1")
    plate = replace(own.plate, layup=parse_layup(layup), width=0.19)
    measurement = Measurement(frequencies, 0.0, 0.01, None, ("",) * len(frequencies), True)
    return replace(own, plate=plate, measurement=measurement, angle_grid_deg=step)


@once_a_run
def specimen(layup: str = "[?/?]_s", step: float = STEP) -> Specimen:
    """A thin rectangular plate with the noise-free list of one sequence, 1 % noise being stated."""
    own = specimen_with(np.arange(1.0, FREQUENCIES + 1.0), layup, step)
    model = reduced_model(own, angle_parameters(own).union(own.unknowns), FREQUENCIES)
    x = np.concatenate((TRUE, reference_vector(own, own.unknowns)))
    return specimen_with(model.predict(x[None]).frequencies[0], layup, step)


@once_a_run
def answer() -> StackingPosterior:
    settings = StackingSettings(draws=60, listed=36, log2_points=9)
    return stacking_posterior(specimen(), 0, settings=settings)


@once_a_run
def mixture() -> StackingMixture:
    return sample_mixture(answer(), 0)


def shortened(n: int) -> StackingPosterior:
    """The answer with a list of its first n classes only."""
    return answer().listing(np.arange(n))
