"""Built-in plates whose layup is taken as unknown, and the lists that their own sequences have."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.forward_model.model import angle_parameters, reference_vector
from cpam_bayes.forward_model.store import reduced_model
from cpam_bayes.plate import Measurement, Specimen, builtin
from cpam_bayes.plate.layup import parse_layup

Array = NDArray[Any]


def with_unknown_layup(plate: str, layup: str | None, step_deg: float | None = None) -> Specimen:
    """A built-in plate with unknown angles, its own or those of ``layup``, if wanted on another grid."""
    specimen = builtin(plate, sequence=True)
    if layup is not None:
        specimen = replace(specimen, plate=replace(specimen.plate, layup=parse_layup(layup)))
    return specimen if step_deg is None else replace(specimen, angle_grid_deg=step_deg)


def known_angles(specimen: Specimen) -> Array:
    """The built-in plate's own angles at the places of the unknown ones, (k,) degrees."""
    known = builtin(specimen.name).plate.layup.angles_deg
    layup = specimen.plate.layup
    return np.array([known[np.flatnonzero(layup.unknown_index == i)[0]] for i in range(layup.n_unknown)])


def with_noise_free_list(specimen: Specimen, noise: float) -> tuple[Specimen, Array, float]:
    """A specimen with the noise-free list of its own sequence, which comes too, and the model's error.

    noise : relative standard deviation that the list states. The constants are the reference ones.
    """
    assert specimen.measurement is not None
    n = specimen.measurement.size
    model = reduced_model(specimen, angle_parameters(specimen).union(specimen.unknowns), n)
    angles = known_angles(specimen)
    x = np.concatenate((angles, reference_vector(specimen, specimen.unknowns)))
    frequencies = model.predict(x[None]).frequencies[0]
    listed = Measurement(frequencies, 0.0, noise, None, ("",) * n, complete=True)
    return replace(specimen, measurement=listed), angles, float(model.full.error.max())
