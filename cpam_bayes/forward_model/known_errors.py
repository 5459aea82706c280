"""Known errors of the numbers in a plate file, and of the theory, which all frequencies of a list share.

A weighed mass is kept: a plate of other sizes has another density (docs/priors.md, Sizes and mass).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from cpam_bayes.effects.effect import FREQUENCY_SCALE as SCALE
from cpam_bayes.forward_model.labels import LabelledModel
from cpam_bayes.forward_model.model import (
    SIZES,
    ForwardModel,
    PlateModel,
    Prediction,
    model_on_basis,
    plate_problem,
)
from cpam_bayes.forward_model.reduced import ReducedModel, focused
from cpam_bayes.forward_model.three_dimensions import (
    THEORY_LEVEL,
    THEORY_SHEAR,
    common_theory_errors,
    theory_powers,
)
from cpam_bayes.mechanics.problem import Array
from cpam_bayes.parameters import Parameter, ParameterSet, TruncatedNormal, Uniform
from cpam_bayes.plate import Plate, Specimen

FREQUENCY_SCALE: Final = SCALE.name
# Relative range of a size about its value in which its derivative is taken.
_RANGE = 0.1
# Relative noise that weights the frequencies where none is stated, that of a usual tap test.
_USUAL_NOISE = 0.002


@dataclass(frozen=True, slots=True)
class ScaleError:
    """Errors of the constants due to one number that the model assumes exact, to first order.

    name : thickness, length, width, density or mass; "frequency_scale" of the analyser
    shift : constant -> its relative change, identified with the true number, per relative excess of the true
        number over the stated one
    visible : fraction of the frequencies' change that the constants cannot reproduce, 0 to 1
    sd : relative standard deviation of the number that intervals include, None where they do not
    """

    name: str
    shift: Mapping[str, float]
    visible: float
    sd: float | None


@dataclass(frozen=True, slots=True)
class Powers:
    """Powers of the frequencies in the constants, the sizes and the frequency scale, d ln f / d ln p.

    frequencies : (n_f,) predicted there, Hz
    of_constants : (n_f, n)
    of_sizes : name of a size, of the scale or of the theory's errors -> (n_f,); a weighed plate keeps its
        mass where a size changes
    """

    frequencies: Array
    of_constants: Array
    of_sizes: Mapping[str, Array]


def powers(
    specimen: Specimen, model: PlateModel, constants: Mapping[str, float], order: Array
) -> Powers | None:
    """The powers at some constants, with their signs.

    model : converged on a Ritz space; None is returned for any other
    constants : unknown -> its value, SI
    order : (n_f,) mode of each frequency
    """
    if model.basis is None:
        return None
    sizes = specimen.plate.sizes
    values = {**constants, **sizes}
    parameters = ParameterSet(tuple(_about(name, value) for name, value in values.items()))
    x = np.array([list(values.values())])
    problem = replace(plate_problem(specimen, parameters), bias=model.operator.problem.bias)
    varied = model_on_basis(problem, x, model.n_modes, model.error, model.basis)
    predicted = varied.predict(x, jacobian=True)
    assert predicted.jacobian is not None
    f = predicted.frequencies[0][order]
    relative = predicted.jacobian[0][order] * x / f[:, None]
    n = len(constants)
    of_sizes = {name: relative[:, n + i] for i, name in enumerate(sizes)}
    of_sizes[FREQUENCY_SCALE] = np.ones(len(order))
    return Powers(f, relative[:, :n], {**of_sizes, **theory_powers(f)})


@dataclass(frozen=True, slots=True, eq=False)
class Absorbed:
    """The part of errors of sizes, mass and frequency scale that the constants absorb.

    specimen : to which the numbers belong
    constants : unknown -> its most probable value, SI
    names : of the k numbers; empty where the powers of the model are not known
    shift : (k, n) relative change of the constants per relative excess of a number
    change, left : (k, n_f) that of the frequencies over their noise, and what the constants leave of it
    """

    specimen: Specimen
    constants: Mapping[str, float]
    names: tuple[str, ...]
    shift: Array
    change: Array
    left: Array

    def errors(self, *, usual: bool) -> tuple[ScaleError, ...]:
        """Errors by each number; usual : whether intervals include usual values where [plate.sd] has none."""
        known, errors = known_errors(self.specimen), []
        for name, shift, change, left in zip(self.names, self.shift, self.change, self.left, strict=True):
            if name not in known:  # of the theory, not of the file
                continue
            visible = float(np.linalg.norm(left) / np.linalg.norm(change))
            sd = known[name] if usual or name in self.specimen.plate.sd else None
            shifts = dict(zip(self.constants, shift.tolist(), strict=True))
            errors.append(ScaleError(name, shifts, visible, sd))
        return tuple(errors)


def absorbed(
    specimen: Specimen,
    model: PlateModel,
    constants: Mapping[str, float],
    order: Array,
    spread: Mapping[str, float],
    listed: Array | None = None,
) -> Absorbed:
    """The part of errors of sizes, mass and frequency scale that the constants absorb.

    The frequencies are weighted by the noise that the file states.

    model, constants, order : as in ``powers``
    spread : unknown -> standard deviation of its prior, SI
    listed : (n_f,) numbers of the frequencies in the list; all of them if left out
    """
    found, measurement = powers(specimen, model, constants, order), specimen.measurement
    prior = np.array([spread[name] / abs(value) for name, value in constants.items()])
    if found is None or measurement is None:
        none = np.zeros((0, len(order)))
        return Absorbed(specimen, constants, (), np.zeros((0, len(constants))), none, none)
    relative = _USUAL_NOISE if measurement.relative_std is None else measurement.relative_std
    own = np.arange(len(order)) if listed is None else listed
    noise = measurement.noise_sd(relative)[own] / measurement.frequencies[own]
    weighted = found.of_constants / noise[:, None]
    curvature = weighted.T @ weighted + np.diag(prior**-2.0)
    change = np.array(list(found.of_sizes.values())) / noise
    # frequencies follow the true size, and the constants have absorbed the error of the model; what the
    # analyser shows is no frequency of the plate: a scale too large shows as stiffer constants
    shift = -np.linalg.solve(curvature, weighted.T @ change.T).T
    left = change + shift @ weighted.T
    return Absorbed(specimen, constants, tuple(found.of_sizes), shift, change, left)


def known_errors(specimen: Specimen) -> dict[str, float]:
    """Relative standard deviations, stated or usual, of sizes, mass or density, and frequency scale."""
    plate, measurement = specimen.plate, specimen.measurement
    sizes = plate.sizes
    known = {name: sd / sizes[name] for name, sd in plate.known_to.items()}
    return known if measurement is None else {**known, FREQUENCY_SCALE: measurement.scale_sd}


def common_sd(specimen: Specimen) -> dict[str, float]:
    """Relative standard deviations of all common errors: of these numbers, and of the theory."""
    return {**known_errors(specimen), **common_theory_errors(specimen)}


def common_errors(
    specimen: Specimen, model: PlateModel, constants: Mapping[str, float], order: Array
) -> dict[str, Array]:
    """Relative errors (one standard deviation) of the frequencies by each common cause, (n_f,) each.

    By name: sizes, mass or density, frequency scale and theory, to first order, see ``powers``.
    The model is converged on a Ritz space.
    """
    found = powers(specimen, model, constants, order)
    assert found is not None
    return {name: sd * found.of_sizes[name] for name, sd in common_sd(specimen).items()}


# Relative error of the theory that is not made a parameter: the usual accuracy of a frequency scale.
_NEGLIGIBLE = 1e-4
# Range of a number about its value, standard deviations.
_REACH = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class TolerantModel:
    """A model whose sizes, mass, scale and theory are known to a tolerance, f prod_k (s_k / s_k0)^P_k.

    To first order in those for which the file states no sd; those with an sd are parameters of ``model``.

    model : with these numbers as in the file
    tolerances : the numbers, normal about their values
    powers : (n_numbers, n_modes) P, as in ``powers``
    """

    model: ForwardModel
    tolerances: ParameterSet
    powers: Array

    @property
    def parameters(self) -> ParameterSet:
        """The parameters of the model, then the numbers."""
        return self.model.parameters.union(self.tolerances)

    def admissible(self, x: Array) -> Array:
        """True where parameter vectors (m, n) satisfy the constraints of the material, (m,) bool."""
        return self.model.admissible(x[:, : self.model.parameters.size])

    def predict(self, x: Array, *, jacobian: bool = False) -> Prediction:
        """Frequencies at parameter vectors (m, n), and derivatives."""
        n = self.model.parameters.size
        found = self.model.predict(x[:, :n], jacobian=jacobian)
        nominal = np.array([p.prior.mean for p in self.tolerances.parameters])
        factor = np.exp(np.log(x[:, n:] / nominal) @ self.powers)
        f, slopes = found.frequencies * factor, None
        if found.jacobian is not None:
            by_number = f[:, :, None] * self.powers.T / x[:, None, n:]
            slopes = np.concatenate((found.jacobian * factor[:, :, None], by_number), axis=2)
        if isinstance(self.model, LabelledModel):
            return Prediction(f, slopes)
        # in ascending order, which may change for close modes with a size
        order = np.argsort(f, axis=1, kind="stable")
        f = np.take_along_axis(f, order, axis=1)
        return Prediction(
            f, None if slopes is None else np.take_along_axis(slopes, order[:, :, None], axis=1)
        )


def tolerant(
    specimen: Specimen, model: ReducedModel, constants: Mapping[str, float], order: Array
) -> ForwardModel:
    """A model with the usual tolerances of the numbers for which the file states none.

    constants : unknown -> its value where powers are taken, SI
    order : (n_modes,) mode at each place of the predictions
    """
    open_to = {
        name: sd for name, sd in common_sd(specimen).items() if sd > 0.0 and name not in specimen.plate.sd
    }
    found = powers(specimen, model.full, constants, order) if open_to else None
    if found is None:
        return model
    for name in (THEORY_SHEAR, THEORY_LEVEL):
        if open_to.get(name, 0.0) * found.of_sizes[name].max() < _NEGLIGIBLE:
            open_to.pop(name, None)
    if not open_to:
        return model
    sizes = {**specimen.plate.sizes, FREQUENCY_SCALE: 1.0, THEORY_SHEAR: 1.0, THEORY_LEVEL: 1.0}
    tolerances = ParameterSet(
        tuple(_known_to(name, sizes[name], sd * sizes[name]) for name, sd in open_to.items())
    )
    changed = np.array([found.of_sizes[name] for name in open_to])
    return TolerantModel(model, tolerances, changed)


def narrowed(model: ForwardModel, x: Array, tolerance: float) -> ForwardModel:
    """A model on a basis made for parameter vectors x (m, n), to a relative error of a frequency.

    Unchanged where it has no basis, one that is as coarse already, or one with labelled modes.
    """
    if isinstance(model, TolerantModel):
        within = x[:, : model.model.parameters.size]
        inner = narrowed(model.model, within, tolerance)
        return model if inner is model.model else replace(model, model=inner)
    if isinstance(model, ReducedModel) and tolerance > model.tolerance:
        return focused(model, x, tolerance)
    return model


def _known_to(name: str, value: float, sd: float) -> Parameter:
    prior = TruncatedNormal(value, sd, value - _REACH * sd, value + _REACH * sd)
    return Parameter(name, SIZES.get(name, ""), prior)


_OF_LABORATORY = (FREQUENCY_SCALE, THEORY_SHEAR, THEORY_LEVEL)


def common_covariance(lists: Sequence[tuple[str, int, Mapping[str, Array]]]) -> Array:
    """Relative covariance of the frequencies of several lists due to their common errors, (n, n).

    Errors of sizes and mass are common to the tests of a specimen, those of the frequency scale (of one
    analyser) and of the theory to all lists.

    lists : specimen, number of frequencies, and errors by name, as in ``common_errors``
    """
    first = np.cumsum([0, *(size for _, size, _ in lists)])
    errors: dict[tuple[str, str], Array] = {}
    for i, (specimen, _, of_list) in enumerate(lists):
        for name, error in of_list.items():
            key = ("" if name in _OF_LABORATORY else specimen, name)
            errors.setdefault(key, np.zeros(first[-1]))[first[i] : first[i + 1]] = error
    relative = np.array(list(errors.values())).reshape(-1, first[-1])
    return np.asarray(relative.T @ relative)


def number_of(cause: str, plate: Plate) -> str | None:
    """The number of a plate file, or the frequency scale, in which a cause is an error; else None.

    A plate that was weighed has a mass and no density of its own.
    """
    if cause == FREQUENCY_SCALE:
        return cause
    if cause not in SIZES:
        return None
    return cause if cause in plate.sizes else "mass"


def sizes_spread(errors: tuple[ScaleError, ...], constant: str) -> float:
    """Relative standard deviation of a constant due to all errors that intervals include."""
    return float(np.sqrt(sum((e.sd * e.shift[constant]) ** 2 for e in errors if e.sd is not None)))


def _about(name: str, value: float) -> Parameter:
    low, high = sorted((value * (1.0 - _RANGE), value * (1.0 + _RANGE)))
    return Parameter(name, SIZES.get(name, ""), Uniform(low, high))
