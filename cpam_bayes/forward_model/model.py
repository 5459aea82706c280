"""The forward model of a plate, from parameters to frequencies, and the effect of air."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final, Protocol

import numpy as np

from cpam_bayes.effects import add_air, add_known_mass
from cpam_bayes.mechanics.affine import AffineOperator
from cpam_bayes.mechanics.convergence import Tolerance, converge, rich_frequencies
from cpam_bayes.mechanics.dense import discretise
from cpam_bayes.mechanics.modes import (
    Mode,
    RigidBodyError,
    Spectrum,
    describe_modes,
    eigenvalue_derivatives,
    shapes_at,
    shapes_on_grid,
    solve,
)
from cpam_bayes.mechanics.problem import Array, Bias, PlateState, Problem, Values, bare_plate
from cpam_bayes.mechanics.ritz import RitzSettings, ritz_space
from cpam_bayes.parameters import Parameter, ParameterSet, Prior, TruncatedLogNormal, TruncatedNormal, Uniform
from cpam_bayes.plate import Hybrid, Material, Plate, Specimen, split_name
from cpam_bayes.plate.laminate import ENERGY_CONSISTENT, MaterialSymmetry, ShearModel, laminate_geometry
from cpam_bayes.running import single_blas_thread

NO_PARAMETERS = ParameterSet(())
SIZES = {"length": "m", "width": "m", "thickness": "m", "density": "kg/m3", "mass": "kg"}
"""Quantities of a plate that are measured beside its frequencies, with their units."""
ASSUMED_SD: Final[Mapping[MaterialSymmetry, float]] = {
    "isotropic": 0.25,
    "transversely_isotropic": 0.25,
    "orthotropic": 0.4,
}
"""Standard deviation of the logarithm of a reference constant where [material.sd] leaves it out."""
# Lower end of a log-normal prior, as a fraction of its median; [unknowns] may have bounds at zero and below.
_LEAST_OF_REFERENCE = 1e-3
# The bounds of a constant must reach this close to its reference, standard deviations.
_REACH = 4.0
# A size varies within this many standard deviations and within this factor of its value.
_SIZE_RANGE, _SIZE_FACTOR = 5.0, 4.0
# Points along each side for a shape.
_SHAPE_POINTS = 31
# Step of the complex-step derivative, relative to a parameter: any small number will do, no digits are lost.
_STEP = 1e-25
# A space is converged at this many sets of constants up to this far from the centre, as a fraction, and at
# this many all over the prior box.
_NEAR_SETS, _NEIGHBOURHOOD, _FAR_SETS = 2, 0.3, 3
# Patterns of angles for unknown plies, beside those drawn from the prior.
_SPECIAL_DEG = ((0.0,), (90.0,), (0.0, 90.0), (45.0, -45.0))
# Elsewhere in the prior box the error may be this many times larger.
_FAR_ALLOWANCE = 20.0


def angle_parameters(specimen: Specimen) -> ParameterSet:
    """The unknown ply angles of a specimen as continuous parameters, in degrees."""
    names = specimen.plate.layup.unknown_names
    return ParameterSet(tuple(Parameter(name, "deg", Uniform(-90.0, 90.0)) for name in names))


def constant_parameters(specimen: Specimen, cut: float = np.inf) -> ParameterSet:
    """The unknown constants with the prior of all verbs: bounds of [unknowns] times densities of references.

    A reference with a standard deviation is normal, truncated at its bounds and at ``cut`` standard
    deviations. Without one it is log-normal, `ASSUMED_SD` wide, where it lies within its bounds. A normal
    prior of [unknowns] is kept, as are bounds without a reference or with ``known = false`` under
    [material], and the posterior of a former plate.

    Raises ``ValueError`` where a reference with a standard deviation is far outside the bounds.
    """
    known = specimen.unknowns
    unknowns = [
        p if p.coupled is not None else replace(p, prior=_about_reference(p, specimen, cut))
        for p in known.parameters
    ]
    return ParameterSet(tuple(unknowns), known.fixed)


def with_references(specimen: Specimen) -> Specimen:
    """The specimen whose unknowns have the prior of `constant_parameters`."""
    return replace(specimen, unknowns=constant_parameters(specimen))


def assumed_spreads(specimen: Specimen) -> dict[str, float]:
    """Unknowns whose references have an assumed spread, see `constant_parameters` -> that spread."""
    spreads = {}
    for parameter in specimen.unknowns.parameters:
        prior, (of, name) = parameter.prior, split_name(parameter.name)
        bounds = replace(parameter, prior=Uniform(prior.lower, prior.upper))
        assumed = _about_reference(bounds, specimen, np.inf)
        if not assumed.is_range and assumed == prior and name not in specimen.material.parts[of].sd:
            spreads[parameter.name] = ASSUMED_SD[specimen.material.parts[of].symmetry]
    return spreads


def _about_reference(parameter: Parameter, specimen: Specimen, cut: float) -> Prior:
    of, name = split_name(parameter.name)
    material, prior = specimen.material.parts[of], parameter.prior
    mean, sd = material.constants.get(name), material.sd.get(name)
    if mean is None or not material.known or not prior.is_range:
        return prior
    if sd is None:
        if not (mean > 0.0 and prior.lower <= mean <= prior.upper):
            return prior
        low = max(prior.lower, _LEAST_OF_REFERENCE * mean)
        return TruncatedLogNormal(mean, ASSUMED_SD[material.symmetry], low, prior.upper)
    if not (prior.lower < mean + _REACH * sd and mean - _REACH * sd < prior.upper):
        raise ValueError(
            f"{specimen.source}: unknowns.{parameter.name}: its bounds leave nothing within {_REACH:g} "
            "standard deviations of [material.sd]; widen the bounds or the standard deviation"
        )
    return TruncatedNormal(mean, sd, max(prior.lower, mean - cut * sd), min(prior.upper, mean + cut * sd))


def size_parameters(specimen: Specimen) -> ParameterSet:
    """Sizes, density and mass of a specimen that are known to a standard deviation, SI, with normal priors.

    Truncated at five standard deviations, and at a quarter and four times the value of the plate file.
    """
    plate = specimen.plate
    parameters = []
    for name, unit in SIZES.items():
        if plate.sd.get(name, 0.0) > 0.0:  # 0 is exact
            value, sd = float(getattr(plate, name)), plate.sd[name]
            lower = max(value - _SIZE_RANGE * sd, value / _SIZE_FACTOR)
            upper = min(value + _SIZE_RANGE * sd, value * _SIZE_FACTOR)
            parameters.append(Parameter(name, unit, TruncatedNormal(value, sd, lower, upper)))
    return ParameterSet(tuple(parameters))


def reference_vector(specimen: Specimen, parameters: ParameterSet) -> Array:
    """Reference constants and sizes of the plate file as a vector (n,), moved into their bounds.

    Other parameters, such as unknown angles, take the mean of their prior.
    """
    known = {**reference_constants(specimen), **_given_sizes(specimen)}
    x = np.array([known.get(p.name, p.prior.mean) for p in parameters.parameters])
    return np.asarray(np.clip(x, parameters.lower, parameters.upper))


def _given_sizes(specimen: Specimen) -> dict[str, float]:
    sizes = {name: getattr(specimen.plate, name) for name in SIZES}
    return {name: float(value) for name, value in sizes.items() if value is not None}


def varied_sizes(plate: Plate, values: Values) -> dict[str, Any]:
    """Length, width, thickness and density that vary, by name.

    Where the file gives the mass, the density follows from it and the sizes.
    """
    sizes = {name: values[name] for name in SIZES if name in values}
    mass = sizes.pop("mass", plate.mass)
    if mass is not None and any(name in values for name in SIZES):
        length, width, thickness = (
            sizes.get(name, getattr(plate, name)) for name in ("length", "width", "thickness")
        )
        sizes["density"] = np.asarray(mass / (length * width * thickness))
    return sizes


def reference_constants(specimen: Specimen) -> dict[str, float]:
    """All six reference constants of a specimen, Pa or dimensionless."""
    return {name: float(value) for name, value in specimen.material.complete().items()}


def plate_problem(
    specimen: Specimen, parameters: ParameterSet = NO_PARAMETERS, shear: ShearModel = ENERGY_CONSISTENT
) -> Problem:
    """The plate of a specimen as an eigenvalue problem in some of its constants, angles and sizes.

    parameters : what varies; other constants keep their reference value, and those that are not given follow
    from the material's symmetry. Known masses keep their relative place where a size varies.

    Raises ``ValueError`` if an unknown angle of the layup is not among the parameters.
    """
    plate, material = specimen.plate, specimen.material
    layup = plate.layup
    missing = [name for name in layup.unknown_names if name not in parameters]
    if missing:
        raise ValueError(f"layup {layup.text} has {len(missing)} unknown angles; a known layup is needed")
    # unknown angles are spread evenly, so that the nominal plate favours no direction
    spread = np.linspace(-90.0, 90.0, layup.n_unknown + 1)[1:] if layup.n_unknown else np.empty(0)
    nominal = PlateState(
        length=np.asarray(plate.length),
        width=np.asarray(plate.width),
        thickness=np.asarray(plate.thickness),
        density=np.asarray(plate.density),
        constants=material.complete(),
        layup=laminate_geometry(layup.angles(spread), symmetric=layup.is_symmetric, plies=layup.plies),
        shear=shear,
        symmetric=layup.is_symmetric,
        plies=layup.plies,
    )

    # partial objects, not closures: a model must be picklable to be sent to another process
    state = partial(_plate_state, plate, material, nominal)
    problem = bare_plate(parameters, plate.edges, nominal, state, partial(_is_physical, material))
    for sensor in specimen.sensors:
        problem = add_known_mass(problem, sensor.mass, sensor.x, sensor.y)
    if specimen.air_density:
        problem = add_air(problem, specimen.air_density)
    return problem


def _plate_state(
    plate: Plate, material: Material | Hybrid, nominal: PlateState, values: Values
) -> PlateState:
    """The nominal state with the constants, sizes and angles that vary."""
    state = replace(nominal, constants=material.complete(values), **varied_sizes(plate, values))
    if not plate.layup.n_unknown:
        return state
    angles = np.stack([values[name] for name in plate.layup.unknown_names], axis=-1)
    return replace(state, layup=plate.layup.angles(angles))


def _is_physical(material: Material | Hybrid, values: Values) -> Array:
    shape = np.broadcast_shapes(*(np.shape(v) for v in values.values()))
    return np.broadcast_to(material.admissible(values), shape)


@dataclass(frozen=True, slots=True)
class Prediction:
    """Predicted frequencies of m parameter sets.

    frequencies : (m, n_modes) Hz.
    jacobian : (m, n_modes, n_parameters), Hz per unit of the parameter, or ``None``.
    """

    frequencies: Array
    jacobian: Array | None


class ForwardModel(Protocol):
    """The protocol that a plate model offers to a density."""

    @property
    def parameters(self) -> ParameterSet:
        """Parameters of the plate, in the order of the vectors."""
        ...

    def predict(self, x: Array, *, jacobian: bool = False) -> Prediction:
        """Frequencies at parameter vectors (m, n)."""
        ...

    def admissible(self, x: Array) -> Array:
        """Whether parameter vectors (m, n) are physical, (m,) bool."""
        ...


@dataclass(frozen=True, slots=True)
class PlateModel:
    """A converged plate: parameter vectors in, frequencies out.

    error : (n_modes,) estimated relative error of each frequency.
    basis : the trial functions chosen by ``converge``, by which a model can be stored; ``None`` for other
    operators.
    """

    operator: AffineOperator[Any, Any]
    n_modes: int
    error: Array
    basis: tuple[RitzSettings, Array] | None = None

    @property
    def parameters(self) -> ParameterSet:
        """The parameters that vary, in the order of the vectors."""
        return self.operator.problem.parameters

    @property
    def bias(self) -> Bias:
        """The bias of the theory, included in the predicted frequencies."""
        return self.operator.problem.bias

    def admissible(self, x: Array) -> Array:
        """True where parameter vectors (m, n) satisfy the constraints of the material, (m,) bool."""
        return self.operator.problem.admissible(self.parameters.mapping(x))

    def spectrum(self, x: Array, *, vectors: bool = False) -> Spectrum:
        """Modes at parameter vectors (m, n)."""
        stiffness, mass = self.coefficients(np.atleast_2d(x))
        return solve(self.operator, stiffness, mass, self.n_modes, vectors=vectors)

    def predict(self, x: Array, *, jacobian: bool = False) -> Prediction:
        """Frequencies at parameter vectors (m, n) and, if asked, their derivatives.

        d f / d p = phi^T (dK/dp - lambda dM/dp) phi / (8 pi^2 f), phi M-normalised.
        """
        x = np.atleast_2d(x)
        if not jacobian:
            return Prediction(self.bias.of(self.spectrum(x).frequencies), None)
        coefficients, slopes = self._with_derivatives(x)
        spectrum = solve(self.operator, *coefficients, self.n_modes, vectors=True)
        f = spectrum.frequencies
        derivative = eigenvalue_derivatives(self.operator, spectrum, *slopes)
        return biased(Prediction(f, derivative / (8 * np.pi**2 * f[..., None])), self.bias)

    def modes(self, x: Array) -> tuple[Mode, ...]:
        """Frequencies, kinds and labels at one parameter vector (n,)."""
        spectrum = self.spectrum(x, vectors=True)
        _, mass = self.coefficients(np.atleast_2d(x))
        modes = describe_modes(self.operator, spectrum, mass)
        f = self.bias.of(spectrum.frequencies[0]).tolist()
        return tuple(replace(mode, frequency=each) for mode, each in zip(modes, f, strict=True))

    def shapes(self, x: Array) -> Array:
        """Shapes of the modes at one parameter vector (n,): u, v, w on a grid, (n_modes, 3, 31, 31)."""
        return shapes_on_grid(self.operator, self.spectrum(x, vectors=True), n=_SHAPE_POINTS)

    def shapes_at(self, x: Array, points: Array) -> Array:
        """Shapes of the modes at one parameter vector (n,): u, v, w at points, (n_modes, 3, n_points).

        points : (n_points, 2), x over the length and y over the width
        """
        return shapes_at(self.operator, self.spectrum(x, vectors=True), points)

    def coefficients(self, x: Array) -> tuple[Array, Array]:
        """Coefficients of K and M at parameter vectors (m, n), (m, n_terms) each."""
        coefficients = self.operator.coefficients(self.parameters.mapping(x))
        k, m = (np.broadcast_to(c, (len(x), c.shape[-1])) for c in coefficients)
        return k, m

    def coefficient_derivatives(self, x: Array) -> tuple[Array, Array]:
        """d theta_q / d p_j, (m, n_terms, n_parameters) each."""
        return self._with_derivatives(x)[1]

    def _with_derivatives(self, x: Array) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        """``coefficients`` of K and M at parameter vectors (m, n), and their derivatives.

        The derivatives are by complex step, for the laminate's stiffness in closed form.
        """
        m, n = x.shape
        if not n:
            k, mass = self.coefficients(x)
            return (k, mass), (np.zeros((*k.shape, 0)), np.zeros((*mass.shape, 0)))
        step = _STEP * np.maximum(np.abs(x), np.finfo(float).tiny ** 0.25)
        shifted = np.repeat(x[:, None, :].astype(complex), n, axis=1)
        shifted[:, np.arange(n), np.arange(n)] += 1j * step
        stepped = self.operator.problem.both_coefficients(self.parameters.mapping(shifted), steps=True)
        k, mass = (np.broadcast_to(c, (m, n, c.shape[-1])) for c in stepped)
        d_k, d_mass = (np.swapaxes(c.imag / step[:, :, None], 1, 2) for c in (k, mass))
        return (k.real[:, 0], mass.real[:, 0]), (d_k, d_mass)


def biased(prediction: Prediction, bias: Bias) -> Prediction:
    """A prediction of the theory with its bias added."""
    f, slopes = prediction.frequencies, prediction.jacobian
    if not bias:
        return prediction
    return Prediction(bias.of(f), None if slopes is None else slopes * bias.slopes(f)[..., None])


def training_sets(problem: Problem, n: int, rng: np.random.Generator) -> Array:
    """Admissible parameter vectors that fill the prior box and its faces, (n, n_parameters).

    Half are drawn from the prior, half from Beta(1/2, 1/2), because an optimum often sits on a bound.
    """
    parameters = problem.parameters
    sets = np.empty((0, parameters.size))
    lower, upper = parameters.lower, parameters.upper
    while len(sets) < n:
        inside = parameters.sample(rng, n)
        faces = lower + (upper - lower) * rng.beta(0.5, 0.5, size=(n, parameters.size))
        both = np.stack((inside, faces), axis=1).reshape(-1, parameters.size)
        sets = np.concatenate((sets, both[problem.admissible(parameters.mapping(both))]))
    return sets[:n]


# Least relative range over which coefficients show their dependence on each other.
_RELATED = 0.2


def spread_out(problem: Problem, x: Array) -> Array:
    """Parameter vectors (m, n) spread where the prior box is narrow, so that coefficients show relations.

    Over the range of a side known to 0.1 % its powers are equal to nearly all digits.
    """
    parameters = problem.parameters
    middle, half = 0.5 * (parameters.upper + parameters.lower), 0.5 * (parameters.upper - parameters.lower)
    return np.asarray(middle + (x - middle) * np.maximum(1.0, _RELATED * np.abs(middle) / half))


@dataclass(frozen=True, slots=True)
class Samples:
    """Parameter vectors (m, n_parameters) that represent the range of a discretisation's use.

    allowance : (m,) factors by which the error may exceed the tolerance there.
    """

    x: Array
    allowance: Array


def convergence_samples(specimen: Specimen, problem: Problem, centre: Array | None = None) -> Samples:
    """A centre, neighbours within 30 % of its constants, and sets all over the prior box.

    centre : (n_parameters,), by default the reference constants. Far from it the space need only be good
    enough to show that the data lie elsewhere. The seed is fixed, so that a model does not depend on the run
    that first needs it. Unknown angles are also taken at 0, 90, both, and 45 and -45 deg, where free edges
    are hardest.
    """
    parameters = problem.parameters
    if not parameters.size:
        return Samples(np.empty((1, 0)), np.ones(1))
    rng = np.random.default_rng(0)
    middle = reference_vector(specimen, parameters) if centre is None else centre
    constants = reference_constants(specimen)
    samples: list[Array] = []
    while len(samples) <= _NEAR_SETS:
        x = parameters.sample(rng, 1)[0]
        for i, name in enumerate(parameters.names):
            if name in constants:
                away = _NEIGHBOURHOOD * rng.uniform(-1.0, 1.0) if samples else 0.0
                x[i] = middle[i] * (1.0 + away)
            elif name in SIZES and not samples:
                x[i] = middle[i]
        x = np.clip(x, parameters.lower, parameters.upper)
        if problem.admissible(parameters.mapping(x)):
            samples.append(x)
    samples += _special_layups(specimen, parameters, samples[0])
    everywhere = training_sets(problem, _FAR_SETS, rng)
    allowance = np.concatenate((np.ones(len(samples)), np.full(_FAR_SETS, _FAR_ALLOWANCE)))
    return Samples(np.concatenate((samples, everywhere)), allowance)


def _special_layups(specimen: Specimen, parameters: ParameterSet, centre: Array) -> list[Array]:
    """A vector (n,) with its unknown angles in the patterns of the usual layups, none without angles."""
    names = specimen.plate.layup.unknown_names
    at = [i for i, name in enumerate(parameters.names) if name in names]
    layups = []
    for pattern in _SPECIAL_DEG if at else ():
        x = centre.copy()
        x[at] = np.resize(pattern, len(at))
        layups.append(np.clip(x, parameters.lower, parameters.upper))
    return layups


@single_blas_thread
def converged_model(
    specimen: Specimen,
    parameters: ParameterSet,
    n_modes: int,
    shear: ShearModel = ENERGY_CONSISTENT,
    tolerance: Tolerance | None = None,
    centre: Array | None = None,
) -> PlateModel:
    """The plate of a specimen on a Ritz space that is converged about given constants.

    parameters : what varies (``NO_PARAMETERS`` for the reference constants alone).
    centre : as in ``convergence_samples``.

    Raises ``ValueError`` for a plate with a mesh.
    """
    if specimen.plate.mesh is not None:
        raise ValueError(f"{specimen.source}: the Ritz space is of a rectangle, not of {specimen.plate.mesh}")
    problem = plate_problem(specimen, parameters, shear)
    samples = convergence_samples(specimen, problem, centre)
    converged = converge(problem, parameters.mapping(samples.x), n_modes, tolerance, samples.allowance)
    basis = (converged.settings, converged.keep)
    return PlateModel(converged.operator, n_modes, converged.error, basis)


def model_on_basis(
    problem: Problem, samples: Array, n_modes: int, error: Array, basis: tuple[RitzSettings, Array]
) -> PlateModel:
    """The model that ``converged_model`` found before, from its basis and error.

    samples : (m, n_parameters), from which the symmetries of the problem are determined.
    """
    settings, keep = basis
    space = ritz_space(problem.edges, problem.nominal, settings).restricted(keep)
    operator = discretise(problem, space, problem.parameters.mapping(samples))
    return PlateModel(operator, n_modes, error, basis)


def discretisation_error(model: PlateModel, x: Array) -> Array:
    """Estimated relative error of the frequencies of a model at one parameter vector, (n_modes,).

    Relative to a space converged at this very vector, plus the error of that space.
    """
    x = np.atleast_2d(x)
    problem = model.operator.problem
    finer = rich_frequencies(problem, model.parameters.mapping(x), model.n_modes)
    difference = np.abs(model.predict(x).frequencies / problem.bias.of(finer.frequencies) - 1.0)
    return np.asarray((difference + finer.error).max(axis=0))


ROOM_AIR = 1.2
"""Density of the air of a room, kg/m3."""

# The ratio of two frequencies on one space is accurate to 1e-4 long before they are.
_SETTINGS = RitzSettings(9, 9)
# Modes for which the effect of air is computed where no measurement says how many there are.
_MODES = 6


@single_blas_thread
def air_shifts(specimen: Specimen) -> Array | None:
    """Relative changes of the lowest frequencies, f_air / f_vacuum - 1, (n_modes,).

    At the reference constants, in air of 1.2 kg/m3, for as many modes as were measured. None where the
    model includes air already, for a mesh from a file, for unknown angles, and where bending cannot be
    distinguished from rounding.
    """
    if specimen.air_density or specimen.plate.mesh is not None or specimen.plate.layup.n_unknown:
        return None
    n_modes = _MODES if specimen.measurement is None else specimen.measurement.size
    bare = plate_problem(replace(specimen, air_density=None), NO_PARAMETERS)
    mass_terms = len(bare.forms("mass"))
    problem = add_air(bare, ROOM_AIR)
    operator = discretise(problem, ritz_space(problem.edges, problem.nominal, _SETTINGS), {})
    stiffness, in_air = operator.coefficients({})
    # The last term is the mass of the air.
    in_vacuum = np.where(np.arange(in_air.shape[-1]) < mass_terms, in_air, 0.0)
    try:
        air, vacuum = (solve(operator, stiffness, m, n_modes).frequencies[0] for m in (in_air, in_vacuum))
    except RigidBodyError:
        return None
    return np.asarray(air / vacuum - 1.0)
