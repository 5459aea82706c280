"""Errors of size, mass and frequency scale: they shift the constants and hardly show in the frequencies.

A plate that is 1 % thicker than stated has higher frequencies, which stiffer constants repeat. No fit
can tell; only a gauge, a balance and a calibrated analyser do.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.effects import observation
from cpam_bayes.forward_model.model import SIZES, PlateModel, model_on_basis, plate_problem
from cpam_bayes.parameters import Parameter, ParameterSet, Uniform
from cpam_bayes.plate import Plate, Specimen
from cpam_bayes.plate.units import split_name

Array = NDArray[Any]

__all__ = [
    "FREQUENCY_SCALE",
    "ScaleError",
    "number_of",
    "scale_errors",
    "sizes_spread",
    "thin_plate_errors",
]

FREQUENCY_SCALE: Final = observation.FREQUENCY_SCALE.name
# Range of a size about its value in which its derivative is taken, relative.
_RANGE = 0.1


@dataclass(frozen=True, slots=True)
class ScaleError:
    """What an error of one number that the model takes for exact does to the constants, to first order.

    name : thickness, length, width, density or mass; "frequency_scale" of the analyser
    shift : constant -> its relative error for each relative error of the number
    visible : fraction of the frequencies' change that the constants do not repeat, 0 to 1
    sd : relative standard deviation of the number in [plate.sd], None where it gives none
    """

    name: str
    shift: Mapping[str, float]
    visible: float
    sd: float | None


def scale_errors(
    specimen: Specimen,
    model: PlateModel,
    constants: Mapping[str, float],
    order: Array,
    noise: Array,
    spread: Mapping[str, float],
) -> tuple[ScaleError, ...]:
    """Of each size, the density or mass, and the frequency scale.

    Parameters
    ----------
    model : converged on a Ritz space; of another one nothing is known and nothing returned
    constants : unknown -> its value, SI
    order : (n_f,) mode of each measured frequency
    noise : (n_f,) relative standard deviations
    spread : unknown -> standard deviation of its prior, SI
    """
    if model.basis is None:
        return ()
    names, sizes = list(constants), _size_values(specimen.plate)
    values = {**constants, **sizes}
    parameters = ParameterSet(tuple(_about(name, value) for name, value in values.items()))
    x = np.array([list(values.values())])
    problem = plate_problem(specimen, parameters)
    varied = model_on_basis(problem, x, model.n_modes, model.error, model.basis)
    predicted = varied.predict(x, jacobian=True)
    assert predicted.jacobian is not None
    # relative change of each frequency for each relative change of a parameter
    relative = (predicted.jacobian[0] * x / predicted.frequencies[0][:, None])[order]
    n = len(names)
    prior = np.array([spread[name] / abs(constants[name]) for name in names])
    weighted = relative[:, :n] / noise[:, None]
    curvature = weighted.T @ weighted + np.diag(prior**-2.0)
    # Frequencies follow the true size; the constants take up what the model lacks.
    changes = {name: relative[:, n + i] for i, name in enumerate(sizes)}
    changes[FREQUENCY_SCALE] = np.ones(len(order))
    errors = []
    for name, change in changes.items():
        shift = np.linalg.solve(curvature, weighted.T @ (change / noise))
        left = (change - relative[:, :n] @ shift) / noise
        visible = float(np.linalg.norm(left) / np.linalg.norm(change / noise))
        sd = specimen.plate.sd.get(name)
        known = None if sd is None else float(sd / sizes[name])
        errors.append(ScaleError(name, dict(zip(names, shift.tolist(), strict=True)), visible, known))
    return tuple(errors)


def thin_plate_errors(specimen: Specimen) -> tuple[ScaleError, ...]:
    """The same of a thin plate whose layup is open: f^2 is proportional to E h^2 / rho, or E h^3 / m."""
    plate = specimen.plate
    moduli = [name for name in specimen.unknowns.names if split_name(name)[1] != "nu12"]
    thickness, weighed = (2.0, "density") if plate.mass is None else (3.0, "mass")
    powers = {"thickness": thickness, weighed: -1.0, FREQUENCY_SCALE: 2.0}
    return tuple(ScaleError(name, dict.fromkeys(moduli, power), 0.0, None) for name, power in powers.items())


def number_of(cause: str, plate: Plate) -> str | None:
    """The number of a plate file, or the frequency scale, that a cause is an error of; None for other causes.

    A plate that was weighed has a mass and no density of its own.
    """
    if cause == FREQUENCY_SCALE:
        return cause
    if cause not in SIZES:
        return None
    return cause if cause in _size_values(plate) else "mass"


def sizes_spread(errors: tuple[ScaleError, ...], constant: str) -> float:
    """Relative standard deviation of a constant by the standard deviations of [plate.sd] together."""
    return float(np.sqrt(sum((e.sd * e.shift[constant]) ** 2 for e in errors if e.sd is not None)))


def _size_values(plate: Plate) -> dict[str, float]:
    weighed = "density" if plate.mass is None else "mass"
    names = [name for name in SIZES if name not in ("density", "mass")]
    return {name: float(getattr(plate, name)) for name in (*names, weighed)}


def _about(name: str, value: float) -> Parameter:
    low, high = sorted((value * (1.0 - _RANGE), value * (1.0 + _RANGE)))
    return Parameter(name, SIZES.get(name, ""), Uniform(low, high))
