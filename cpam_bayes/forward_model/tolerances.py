"""Tolerances of sizes, mass and the analyser, and the errors of the constants that they cause.

A plate that is 1 % thicker than stated has higher frequencies, which stiffer constants repeat, and no fit can
tell. What was weighed stays as weighed: a plate of other sizes has another density.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.effects import frequency_list as observation
from cpam_bayes.forward_model.model import SIZES, PlateModel, model_on_basis, plate_problem
from cpam_bayes.parameters import Parameter, ParameterSet, Uniform
from cpam_bayes.plate import Plate, Specimen
from cpam_bayes.plate.units import split_name

Array = NDArray[Any]

FREQUENCY_SCALE: Final = observation.FREQUENCY_SCALE.name
# Range of a size about its value in which its derivative is taken, relative.
_RANGE = 0.1
# Relative noise that weighs the frequencies where none is stated, that of a usual tap test.
_USUAL_NOISE = 0.002


@dataclass(frozen=True, slots=True)
class ScaleError:
    """Errors of the constants by one number that the model assumes exact, to first order.

    name : thickness, length, width, density or mass; "frequency_scale" of the analyser
    shift : constant -> by how much it is another one, relative, for each relative excess of the true number
        over the stated one: as identified again with the true one
    visible : fraction of the frequencies' change that the constants do not repeat, 0 to 1
    sd : relative standard deviation of the number that intervals contain, None where they do not
    """

    name: str
    shift: Mapping[str, float]
    visible: float
    sd: float | None


@dataclass(frozen=True, slots=True)
class Powers:
    """Powers of the frequencies in the constants, the sizes and the frequency scale, d ln f / d ln p.

    of_constants : (n_f, n)
    of_sizes : name of the number -> (n_f,); of a weighed plate the mass stays where a size changes
    """

    of_constants: Array
    of_sizes: Mapping[str, Array]


def powers(
    specimen: Specimen, model: PlateModel, constants: Mapping[str, float], order: Array
) -> Powers | None:
    """The powers at some constants, with their signs.

    Parameters
    ----------
    model : converged on a Ritz space; of another one nothing is known and None returned
    constants : unknown -> its value, SI
    order : (n_f,) mode of each frequency
    """
    if model.basis is None:
        return None
    sizes = specimen.plate.sizes
    values = {**constants, **sizes}
    parameters = ParameterSet(tuple(_about(name, value) for name, value in values.items()))
    x = np.array([list(values.values())])
    problem = plate_problem(specimen, parameters)
    varied = model_on_basis(problem, x, model.n_modes, model.error, model.basis)
    predicted = varied.predict(x, jacobian=True)
    assert predicted.jacobian is not None
    relative = (predicted.jacobian[0] * x / predicted.frequencies[0][:, None])[order]
    n = len(constants)
    of_sizes = {name: relative[:, n + i] for i, name in enumerate(sizes)}
    return Powers(relative[:, :n], {**of_sizes, FREQUENCY_SCALE: np.ones(len(order))})


def scale_errors(
    specimen: Specimen,
    model: PlateModel,
    constants: Mapping[str, float],
    order: Array,
    spread: Mapping[str, float],
    listed: Array | None = None,
    *,
    usual: bool = False,
) -> tuple[ScaleError, ...]:
    """Errors by each size, the density or mass, and the frequency scale.

    The frequencies are weighed by the noise that the file states.

    Parameters
    ----------
    model, constants, order : as of ``powers``
    spread : unknown -> standard deviation of its prior, SI
    listed : (n_f,) numbers of the frequencies in the list; all of them if left out
    usual : whether intervals contain, beside [plate.sd], the usual errors of what it leaves out
    """
    found = powers(specimen, model, constants, order)
    if found is None or specimen.measurement is None:
        return ()
    measurement = specimen.measurement
    relative = _USUAL_NOISE if measurement.relative_std is None else measurement.relative_std
    noise = measurement.noise_sd(relative) / measurement.frequencies
    noise = noise[np.arange(len(order)) if listed is None else listed]
    prior = np.array([spread[name] / abs(value) for name, value in constants.items()])
    weighted = found.of_constants / noise[:, None]
    curvature = weighted.T @ weighted + np.diag(prior**-2.0)
    known, errors = known_errors(specimen), []
    # frequencies follow the true size, and the constants have taken up what the model lacks
    for name, change in found.of_sizes.items():
        # what the analyser shows is no frequency of the plate: a scale too large shows as stiffer constants
        shift = -np.linalg.solve(curvature, weighted.T @ (change / noise))
        left = (change + found.of_constants @ shift) / noise
        visible = float(np.linalg.norm(left) / np.linalg.norm(change / noise))
        sd = known[name] if usual or name in specimen.plate.sd else None
        errors.append(ScaleError(name, dict(zip(constants, shift.tolist(), strict=True)), visible, sd))
    return tuple(errors)


def known_errors(specimen: Specimen) -> dict[str, float]:
    """Relative standard deviations of the sizes, the mass or density, and the frequency scale.

    Those that the file states, else the usual ones.
    """
    plate, measurement = specimen.plate, specimen.measurement
    sizes = plate.sizes
    known = {name: sd / sizes[name] for name, sd in plate.known_to.items()}
    return known if measurement is None else {**known, FREQUENCY_SCALE: measurement.scale_sd}


def thin_plate_errors(specimen: Specimen) -> tuple[ScaleError, ...]:
    """The same of a thin plate whose layup is open: f^2 is proportional to E h^2 / rho, or E h^3 / m."""
    plate = specimen.plate
    moduli = [name for name in specimen.unknowns.names if split_name(name)[1] != "nu12"]
    thickness, weighed = (2.0, "density") if plate.mass is None else (3.0, "mass")
    moved = {"thickness": -thickness, weighed: 1.0, FREQUENCY_SCALE: -2.0}
    return tuple(ScaleError(name, dict.fromkeys(moduli, power), 0.0, None) for name, power in moved.items())


def number_of(cause: str, plate: Plate) -> str | None:
    """The number of a plate file, or the frequency scale, that a cause is an error of; None for other causes.

    A plate that was weighed has a mass and no density of its own.
    """
    if cause == FREQUENCY_SCALE:
        return cause
    if cause not in SIZES:
        return None
    return cause if cause in plate.sizes else "mass"


def sizes_spread(errors: tuple[ScaleError, ...], constant: str) -> float:
    """Relative standard deviation of a constant by the standard deviations of [plate.sd] together."""
    return float(np.sqrt(sum((e.sd * e.shift[constant]) ** 2 for e in errors if e.sd is not None)))


def _about(name: str, value: float) -> Parameter:
    low, high = sorted((value * (1.0 - _RANGE), value * (1.0 + _RANGE)))
    return Parameter(name, SIZES.get(name, ""), Uniform(low, high))
