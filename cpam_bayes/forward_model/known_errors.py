"""Known errors of a prediction: of theory against three dimensions, and of what a plate file states.

First-order theory and ideal supports have a known error of every frequency. Sandwich plates, stiff faces that
bend by themselves about a soft core, are what first-order theory lacks. Sizes, mass and the scale of the
analyser are not exact: a plate that is 1 % thicker than stated has higher frequencies, which stiffer
constants repeat, and no fit can tell. What was weighed stays as weighed: a plate of other sizes has another
density.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cpam_bayes.answer import Notice
from cpam_bayes.effects.effect import FREQUENCY_SCALE as SCALE
from cpam_bayes.forward_model.labels import LabelledModel
from cpam_bayes.forward_model.model import (
    SIZES,
    ForwardModel,
    PlateModel,
    Prediction,
    model_on_basis,
    plate_problem,
    reference_constants,
)
from cpam_bayes.forward_model.reduced import ReducedModel, focused
from cpam_bayes.mechanics.modes import Mode
from cpam_bayes.mechanics.problem import PlateState
from cpam_bayes.parameters import Parameter, ParameterSet, TruncatedNormal, Uniform
from cpam_bayes.plate import Plate, Specimen
from cpam_bayes.plate.edges import conditions
from cpam_bayes.plate.laminate import (
    angle_functions,
    constants_of,
    equal_plies,
    reduced_stiffness,
    rotated_stiffness,
    stiffness_invariants,
)
from cpam_bayes.plate.layup import Layup

Array = NDArray[Any]

# Measured by studies/16_theory_error.py, see `theory_error`.
_FLOOR: Final = 1e-4
_BY_SHEAR: Final = 0.009
_BY_FREE_EDGES: Final = 0.4
_BY_CLAMPS: Final = 0.018
# Points a ply for the integrals over the thickness.
_POINTS: Final = 8
# Place of (11, 12, 22, 66, 16, 26) in the matrix of a ply.
_ROWS, _COLUMNS = np.array([0, 0, 1, 2, 0, 1]), np.array([0, 1, 1, 2, 2, 2])


def theory_error(specimen: Specimen, frequencies: ArrayLike) -> Array:
    """Relative standard deviation of first-order theory with ideal supports against three dimensions.

    e^2 = 0.0001^2 + (0.009 w)^2 + (0.4 h / (a b) sum_free L q)^2 + (0.018 h / (a b) sum_clamped L)^2: w from
    `shear_frequency`, L the length of an edge and q its `edge_layer`. The parts are systematic, the theory
    being too soft in the second and fourth and too stiff in the third; they count as scatter because they
    differ from mode to mode.

    It was measured on plates of 240 x 180 mm with ten modes by ``python studies/16_theory_error.py``,
    which holds all plates. Root mean squares over modes, %, of the Ritz model against extrapolated bricks
    at a thickness of 1/150, 1/50, 1/25 and 1/15 of the short side:

    =================================== ===== ===== ===== =====
    plate                               1/150 1/50  1/25  1/15
    =================================== ===== ===== ===== =====
    carbon, [0/90]_2s, free             0.004 0.017 0.055 0.126
    carbon, [0], free                   0.012 0.015 0.066 0.138
    carbon, [0/45/-45/90]_s, free       0.084 0.260 0.565 1.001
    carbon, [45/-45]_2s, free           0.026 0.063 0.141 0.272
    carbon, [0/90]_2s, one edge clamped 0.009 0.014 0.065 0.146
    isotropic, free                     0.003 0.013 0.041 0.092
    isotropic, one edge clamped         0.020 0.048 0.108 0.195
    =================================== ===== ===== ===== =====

    Parameters
    ----------
    frequencies : (n,) Hz

    Returns
    -------
    (n,) relative standard deviations

    Raises
    ------
    ValueError
        If ply angles are unknown.
    """
    by_shear = _BY_SHEAR * shear_frequency(specimen, frequencies)
    return np.asarray(np.sqrt(_FLOOR**2 + _by_edges(specimen) ** 2 + by_shear**2))


def _by_edges(specimen: Specimen) -> float:
    plate = specimen.plate
    if plate.layup.n_unknown:
        raise ValueError(f"layup {plate.layup.text}: a known layup is needed for the error of the theory")
    lengths = (plate.width, plate.length) * 2
    edges = list(enumerate(conditions(plate.edges)))
    by_free = _BY_FREE_EDGES * sum(lengths[k] * edge_layer(specimen, k % 2) for k, e in edges if e.is_free)
    by_clamps = _BY_CLAMPS * sum(lengths[k] for k, e in edges if e.is_clamp)
    return float(np.hypot(by_free, by_clamps) * plate.thickness / plate.area)


def shear_frequency(specimen: Specimen, frequencies: ArrayLike) -> Array:
    """Angular frequency times the time of a shear wave through the thickness, 2 pi f h (rho / G13)^1/2.

    1 / G13 is its mean over the thickness.

    frequencies : (n,) Hz.
    """
    plate, plies = specimen.plate, _moduli(reference_constants(specimen), specimen.plate.layup)
    compliance = np.diff(plies.interfaces) @ (1.0 / plies.g13)
    slowness = np.sqrt(plate.density * compliance)
    return np.asarray(2.0 * np.pi * np.asarray(frequencies) * plate.thickness * slowness)


def edge_layer(specimen: Specimen, axis: int) -> float:
    """Strain energy that a free edge across an axis (0: x, 1: y) releases, over that of bending along it.

    A bending moment along the edge leaves stresses in the plies there whose resultants vanish but not
    they themselves. Interlaminar shear takes them away over a width d: a d + b / d is least at
    2 (a b)^1/2, with a the energy of those stresses and b that of the shear forces between plies that
    balance them (Pipes and Pagano, Journal of Composite Materials 4, 1970, for a strip in tension). Here
    (a b)^1/2 is given in units of the bending energy and of the thickness. It vanishes where all plies
    are alike.
    """
    plies = _moduli(reference_constants(specimen), specimen.plate.layup)
    ply = np.empty((len(plies.g13), 3, 3))
    ply[:, _ROWS, _COLUMNS] = ply[:, _COLUMNS, _ROWS] = plies.plane
    stiffness, compliance = (np.repeat(each, _POINTS, axis=0) for each in (ply, np.linalg.inv(ply)))
    thickness = np.diff(plies.interfaces)
    z = (plies.interfaces[:-1, None] + thickness[:, None] * (np.arange(_POINTS) + 0.5) / _POINTS).ravel()
    step = np.repeat(thickness / _POINTS, _POINTS)
    powers = np.stack((np.ones_like(z), z))
    moments = np.einsum("pk,qk,kij,k->piqj", powers, powers, stiffness, step).reshape(6, 6)
    strains = np.linalg.solve(moments, np.eye(6)[4 - axis]).reshape(2, 3)
    stress = np.einsum("kij,pk,pj->ki", stiffness, powers, strains)
    energy = np.einsum("ki,kij,kj,k->", stress, compliance, stress, step)
    left = np.zeros_like(stress)
    across = [axis, 2]
    # what is constant or linear in z has a resultant, which the theory's own edge layer takes away
    weights = powers * step
    linear = powers.T @ np.linalg.solve(weights @ powers.T, weights @ stress[:, across])
    left[:, across] = stress[:, across] - linear
    a = np.einsum("ki,kij,kj,k->", left, compliance, left, step)
    forces = np.cumsum(left[:, across] * step[:, None], axis=0)
    b = np.sum(forces**2, axis=1) @ (step / np.repeat(plies.g13, _POINTS))
    return float(np.sqrt(a * b) / energy)


@dataclass(frozen=True, slots=True)
class _Moduli:
    """Moduli of n plies in the directions of the plate.

    interfaces : (n + 1,) z / h. plane : (n, 6), as of ``rotated_stiffness``. g13, g23 : (n,) along and across
        the fibres, Pa. turn : (n,) cos 2t
    """

    interfaces: Array
    plane: Array
    g13: Array
    g23: Array
    turn: Array


def _moduli(constants: Mapping[str, ArrayLike], layup: Layup) -> _Moduli:
    """The moduli of the plies of a known layup, each by the constants of its material."""
    plies = layup.plies or equal_plies(layup.n_plies)
    functions = angle_functions(layup.angles_deg)
    plane, shear = np.empty((layup.n_plies, 6)), np.empty((2, layup.n_plies))
    for k, name in enumerate(plies.names):
        here = plies.material == k
        own = constants_of(constants, name)
        plane[here] = rotated_stiffness(stiffness_invariants(reduced_stiffness(own)), functions[here])
        shear[:, here] = [[float(np.real(own[g]))] for g in ("G13", "G23")]
    return _Moduli(plies.interfaces, plane, shear[0], shear[1], functions[:, 1])


# A ply is core where its transverse shear modulus is below this part of the largest.
_CORE: Final = 0.2
# Relative error of a frequency from which it is said.
_SAID: Final = 0.005

LIMIT: Final = 0.05
"""Relative error of a frequency from which first-order theory is of no use for a sandwich."""


def sandwich_error(
    specimen: Specimen,
    frequencies: ArrayLike,
    constants: Mapping[str, ArrayLike] = MappingProxyType({}),
) -> Array:
    """By how much first-order theory makes the bending frequencies of a sandwich too low, (n,), relative.

    Faces with a bending stiffness D_f of their own have it whatever the core does: a wave has
    m w^2 = D_f k^4 + D_0 k^4 / (1 + D_0 k^2 / S), D_0 = D - D_f (Allen, Analysis and Design of Structural
    Sandwich Panels, 1969, on thick faces). First-order theory with the energy-consistent shear stiffness
    A_s = S / (1 - r)^2, r = D_f / D, has m w^2 = D k^4 / (1 + D k^2 / A_s). With
    y = D k^2 / A_s / (1 - r) the first is 1 + r (1 - r) y^2 / (1 + y) times the second. k follows from the
    frequency; of waves along x and along y the larger error is taken. At a clamped edge the faces are held
    too: over d = (D_f / S)^1/2 the core does not shear, which takes y / (1 + y) d / L more for each clamped
    edge across a side L (the density of the shear energy is twice its mean there). The error is 0 without a
    soft core. Measured by ``python studies/22_sandwiches.py``.

    frequencies : (n,) Hz, of bending modes.
    constants : in place of the reference ones, SI.
    """
    layup = specimen.plate.layup
    if layup.n_unknown:
        raise ValueError(f"layup {layup.text}: a known layup is needed for the error of the theory")
    nominal = plate_problem(specimen).nominal
    state = replace(nominal, constants=specimen.material.complete(constants))
    omega2 = (2.0 * np.pi * np.asarray(frequencies, dtype=float)) ** 2
    shear = np.real(state.stiffness())[[7, 6], [7, 6]]
    edges = conditions(specimen.plate.edges)
    clamped = [edges[axis].is_clamp + edges[axis + 2].is_clamp for axis in (0, 1)]
    of_axes = (_of_waves(state, layup, k, shear[k], clamped[k], omega2) for k in (0, 1))
    return np.maximum(*of_axes)


def _of_waves(state: PlateState, layup: Layup, axis: int, shear: float, clamped: int, omega2: Array) -> Array:
    """e of waves along an axis (0: x, 1: y), (n,).

    shear : A_s across it, N/m. clamped : number of its ends that are. omega2 : (n,), (rad/s)^2.
    """
    bending, of_faces = _bending(state, layup, axis)
    r = of_faces / bending
    by_shear = state.density * state.thickness * omega2 / shear
    by_bending = state.density * state.thickness * omega2 / bending
    k2 = (by_shear + np.sqrt(by_shear**2 + 4.0 * by_bending)) / 2.0
    y = bending * k2 / shear / (1.0 - r)
    held = np.sqrt(of_faces / shear) / (1.0 - r) / float(state.length if axis == 0 else state.width)
    of_waves = 1.0 - 1.0 / np.sqrt(1.0 + r * (1.0 - r) * y**2 / (1.0 + y))
    return np.asarray(np.minimum(of_waves + clamped * held * y / (1.0 + y), 1.0))


def _bending(state: PlateState, layup: Layup, axis: int) -> tuple[float, float]:
    """Bending stiffness along an axis, N m, of the whole plate and of its faces about their own middles."""
    plies = _moduli(state.constants, layup)
    modulus = plies.plane[:, (0, 2)[axis]]
    along, across = plies.g13, plies.g23
    shear = (along + across) / 2.0 + (along - across) / 2.0 * plies.turn * (1.0, -1.0)[axis]
    z = plies.interfaces * float(state.thickness)
    moments = np.array([modulus * np.diff(z**k) / k for k in (1, 2, 3)])
    is_core = shear < _CORE * shear.max()
    if not is_core.any():
        return _about_own_middle(moments), 0.0
    runs = [list(run) for core, run in groupby(range(len(is_core)), lambda i: bool(is_core[i])) if not core]
    return _about_own_middle(moments), sum(_about_own_middle(moments[:, run]) for run in runs)


def _about_own_middle(moments: Array) -> float:
    """Bending stiffness of plies with moments (3, n) of their moduli about any height."""
    a, b, d = moments.sum(axis=1)
    return float(d - b * b / a)


def sandwich_notices(
    specimen: Specimen, modes: Sequence[Mode], constants: Mapping[str, ArrayLike] = MappingProxyType({})
) -> tuple[Notice, ...]:
    """A notice where first-order theory nears its limit in some mode, or is beyond it.

    constants : in place of the reference ones, SI.
    """
    frequencies = [mode.frequency for mode in modes if mode.kind != "in-plane"]
    worst = float(np.max(sandwich_error(specimen, frequencies, constants), initial=0.0))
    if worst < _SAID:
        return ()
    return (Notice("soft_core", facts={"error": worst, "limit": LIMIT}),)


FREQUENCY_SCALE: Final = SCALE.name
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

    frequencies : (n_f,) predicted there, Hz
    of_constants : (n_f, n)
    of_sizes : name of the number -> (n_f,); of a weighed plate the mass stays where a size changes
    """

    frequencies: Array
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
    f = predicted.frequencies[0][order]
    relative = predicted.jacobian[0][order] * x / f[:, None]
    n = len(constants)
    of_sizes = {name: relative[:, n + i] for i, name in enumerate(sizes)}
    return Powers(f, relative[:, :n], {**of_sizes, FREQUENCY_SCALE: np.ones(len(order))})


@dataclass(frozen=True, slots=True, eq=False)
class Absorbed:
    """What the constants take up of errors of sizes, mass and frequency scale.

    specimen : whose numbers these are
    constants : unknown -> its most probable value, SI
    prior : (n,) relative standard deviations of their priors
    residual : (n_f,) of the frequencies, predicted - measured over the noise
    names : of the k numbers; none of a model of which nothing is known
    shift : (k, n) relative, of the constants, for each relative excess of a number
    change, left : (k, n_f) likewise of the frequencies over their noise, and what the constants leave of it
    """

    specimen: Specimen
    constants: Mapping[str, float]
    prior: Array
    residual: Array
    names: tuple[str, ...]
    shift: Array
    change: Array
    left: Array

    def errors(self, *, usual: bool) -> tuple[ScaleError, ...]:
        """By each number; usual : whether intervals contain what [plate.sd] leaves out, as it usually is."""
        known, errors = known_errors(self.specimen), []
        for name, shift, change, left in zip(self.names, self.shift, self.change, self.left, strict=True):
            visible = float(np.linalg.norm(left) / np.linalg.norm(change))
            sd = known[name] if usual or name in self.specimen.plate.sd else None
            shifts = dict(zip(self.constants, shift.tolist(), strict=True))
            errors.append(ScaleError(name, shifts, visible, sd))
        return tuple(errors)

    def shifts(self) -> tuple[Array, Array]:
        """Relative shifts of the constants by all that is known to a tolerance: their mean (n,), and (k, n).

        Each row of these times a standard normal number, of k independent ones: the errors as frequencies and
        priors leave them.
        """
        known, unknowns = known_errors(self.specimen), self.specimen.unknowns
        sd = np.array([known[name] for name in self.names])[:, None]
        shift, left = sd * self.shift, sd * self.left
        away = np.array([1.0 - unknowns[name].prior.mean / value for name, value in self.constants.items()])
        moved = shift / self.prior
        precision = np.eye(len(sd)) + left @ left.T + moved @ moved.T
        mean = -np.linalg.solve(precision, left @ self.residual + moved @ (away / self.prior))
        return mean @ shift, np.linalg.solve(np.linalg.cholesky(precision), shift)


def absorbed(
    specimen: Specimen,
    model: PlateModel,
    constants: Mapping[str, float],
    order: Array,
    spread: Mapping[str, float],
    listed: Array | None = None,
) -> Absorbed:
    """What the constants take up of errors of sizes, mass and frequency scale.

    The frequencies are weighed by the noise that the file states.

    Parameters
    ----------
    model, constants, order : as of ``powers``
    spread : unknown -> standard deviation of its prior, SI
    listed : (n_f,) numbers of the frequencies in the list; all of them if left out
    """
    found, measurement = powers(specimen, model, constants, order), specimen.measurement
    prior = np.array([spread[name] / abs(value) for name, value in constants.items()])
    if found is None or measurement is None:
        none = np.zeros((0, len(order)))
        return Absorbed(
            specimen, constants, prior, np.zeros(len(order)), (), np.zeros((0, len(constants))), none, none
        )
    relative = _USUAL_NOISE if measurement.relative_std is None else measurement.relative_std
    own = np.arange(len(order)) if listed is None else listed
    measured = measurement.frequencies[own]
    noise = measurement.noise_sd(relative)[own] / measured
    residual = (found.frequencies / measured - 1.0) / noise
    weighted = found.of_constants / noise[:, None]
    curvature = weighted.T @ weighted + np.diag(prior**-2.0)
    change = np.array(list(found.of_sizes.values())) / noise
    # frequencies follow the true size, and the constants have taken up what the model lacks; what the
    # analyser shows is no frequency of the plate: a scale too large shows as stiffer constants
    shift = -np.linalg.solve(curvature, weighted.T @ change.T).T
    left = change + shift @ weighted.T
    return Absorbed(specimen, constants, prior, residual, tuple(found.of_sizes), shift, change, left)


def known_errors(specimen: Specimen) -> dict[str, float]:
    """Relative standard deviations of the sizes, the mass or density, and the frequency scale.

    Those that the file states, else the usual ones.
    """
    plate, measurement = specimen.plate, specimen.measurement
    sizes = plate.sizes
    known = {name: sd / sizes[name] for name, sd in plate.known_to.items()}
    return known if measurement is None else {**known, FREQUENCY_SCALE: measurement.scale_sd}


def common_errors(
    specimen: Specimen, model: PlateModel, constants: Mapping[str, float], order: Array
) -> dict[str, Array]:
    """Relative errors of the frequencies, a standard deviation, by what they have in common, (n_f,) each.

    By name: sizes, mass or density and frequency scale as they are known, to first order, as of ``powers``.
    The model is converged on a Ritz space.
    """
    found = powers(specimen, model, constants, order)
    assert found is not None
    return {name: sd * found.of_sizes[name] for name, sd in known_errors(specimen).items()}


# Standard deviations that a number is looked at about its value.
_REACH = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class TolerantModel:
    """A model whose sizes, mass and frequency scale are known to a tolerance, f prod_k (s_k / s_k0)^P_k.

    To first order in those that the file leaves open; what it states an sd of the model has as it is.

    model : with these numbers as the file has them
    tolerances : the numbers, normal about their values
    powers : (n_numbers, n_modes) P, as of ``powers``
    by_rank : whether modes stand in ascending order, which close ones change with a size
    """

    model: ForwardModel
    tolerances: ParameterSet
    powers: Array
    by_rank: bool

    @property
    def parameters(self) -> ParameterSet:
        """Those of the model, then the numbers."""
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
        if not self.by_rank:
            return Prediction(f, slopes)
        order = np.argsort(f, axis=1, kind="stable")
        f = np.take_along_axis(f, order, axis=1)
        return Prediction(
            f, None if slopes is None else np.take_along_axis(slopes, order[:, :, None], axis=1)
        )


def tolerant(
    specimen: Specimen, model: ReducedModel | LabelledModel, constants: Mapping[str, float], order: Array
) -> ForwardModel:
    """A model with the usual tolerances of what the file leaves open.

    Parameters
    ----------
    constants : unknown -> its value where powers are taken, SI
    order : (n_modes,) mode at each place of the predictions
    """
    open_to = {
        name: sd for name, sd in known_errors(specimen).items() if sd > 0.0 and name not in specimen.plate.sd
    }
    found = powers(specimen, model.full, constants, order) if open_to else None
    if found is None:
        return model
    sizes = {**specimen.plate.sizes, FREQUENCY_SCALE: 1.0}
    tolerances = ParameterSet(
        tuple(_known_to(name, sizes[name], sd * sizes[name]) for name, sd in open_to.items())
    )
    changed = np.array([found.of_sizes[name] for name in open_to])
    return TolerantModel(model, tolerances, changed, by_rank=not isinstance(model, LabelledModel))


def narrowed(model: ForwardModel, x: Array, tolerance: float) -> ForwardModel:
    """A model on a basis that is made for parameter vectors x (m, n), to a relative error of a frequency.

    Itself where it has no basis, one that is as coarse already, or one to which modes were labelled.
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


def common_covariance(lists: Sequence[tuple[str, int, Mapping[str, Array]]]) -> Array:
    """Relative covariance of the frequencies of several lists by errors that they have in common, (n, n).

    Sizes and mass are those of a specimen, common to its tests; the frequency scale, of one analyser, is
    common to all lists.

    lists : specimen, number of frequencies, and errors by name, as of ``common_errors``
    """
    first = np.cumsum([0, *(size for _, size, _ in lists)])
    errors: dict[tuple[str, str], Array] = {}
    for i, (specimen, _, of_list) in enumerate(lists):
        for name, error in of_list.items():
            key = ("" if name == FREQUENCY_SCALE else specimen, name)
            errors.setdefault(key, np.zeros(first[-1]))[first[i] : first[i + 1]] = error
    relative = np.array(list(errors.values())).reshape(-1, first[-1])
    return np.asarray(relative.T @ relative)


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
