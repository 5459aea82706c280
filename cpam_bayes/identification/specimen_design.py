"""Possible specimens of a plate's material, and the information of their frequencies about the constants.

A specimen is a layup, a shape, a thickness and edges. The expected information of a list of its frequencies
is by Laplace's approximation at the reference constants.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.answer import Verdict
from cpam_bayes.effects import PlateFacts, extend
from cpam_bayes.effects.edges import CLAMP_ROTATION, CLAMP_TRANSLATION
from cpam_bayes.errors import LayupError
from cpam_bayes.forward_model.known_errors import common_errors
from cpam_bayes.forward_model.model import PlateModel, plate_problem, reference_vector
from cpam_bayes.identification.point import verdict_of
from cpam_bayes.mechanics.convergence import Tolerance, converge
from cpam_bayes.mechanics.dense import discretise
from cpam_bayes.mechanics.ritz import RitzSettings, ritz_space
from cpam_bayes.plate import Specimen
from cpam_bayes.plate.edges import ALL_FREE, CANTILEVER, is_stated
from cpam_bayes.plate.layup import Layup, parse_layup

Array = NDArray[Any]

USUAL_STD: Final = 0.005
"""Repeatability of a usual tap test, taken where neither the plate file nor the caller gives one."""
# Repeatabilities that are tried, from coarse to fine, for the one that determines the constants.
_STDS: Final = tuple(step * 10.0**power for power in (-2, -3, -4, -5) for step in (5.0, 2.0, 1.0))

# Usual layups, each with the number of plies of its pattern.
_PATTERNS: Final = (
    (1, "[0_{n}]"),
    (4, "[(0/90)_{n}]_s"),
    (4, "[(45/-45)_{n}]_s"),
    (8, "[(0/45/-45/90)_{n}]_s"),
)
_RATIOS: Final = (0.5, 0.7, 1.0, 1.4, 2.0, 2.8)
# Relative difference of aspect ratios below which two shapes are one.
_SAME: Final = 0.02


@dataclass(frozen=True, slots=True)
class Geometry:
    """Geometry, layup and edges of a specimen; length, width, thickness : m."""

    length: float
    width: float
    thickness: float
    layup: Layup
    edges: str
    is_present: bool

    @property
    def ratio(self) -> float:
        """Length over width."""
        return self.length / self.width


def geometries(
    specimen: Specimen,
    *,
    layups: Sequence[str] | None = None,
    ratios: Sequence[float] | None = None,
    thicknesses_mm: Sequence[float] | None = None,
    edges: Sequence[str] | None = None,
) -> tuple[Geometry, ...]:
    """The plate as it is and all combinations of the arguments; those left out take usual values.

    ratios : of length to width, at the area of the plate

    Raises ``ValueError`` for a layup or edges that cannot be read.
    """
    plate = specimen.plate
    present = Geometry(plate.length, plate.width, plate.thickness, plate.layup, plate.edges, True)
    shapes = _shapes(plate.length, plate.width, ratios)
    thick = [1e-3 * t for t in thicknesses_mm] if thicknesses_mm else [plate.thickness]
    held = (
        [_edges(text) for text in edges]
        if edges
        else list(dict.fromkeys((plate.edges, ALL_FREE, CANTILEVER)))
    )
    found = [present]
    for layup in layups_of(specimen, layups):
        for thickness in thick:
            for length, width in shapes:
                found += [Geometry(length, width, thickness, layup, e, False) for e in held]
    distinct = {_key(g): g for g in reversed(found)}  # the present plate stays
    return tuple(distinct[key] for key in dict.fromkeys(map(_key, found)))


def specimen_of(specimen: Specimen, geometry: Geometry) -> Specimen:
    """Specimen of a geometry; its mass follows the volume, known masses keep their relative place."""
    plate = specimen.plate
    along, across = geometry.length / plate.length, geometry.width / plate.width
    volume = along * across * geometry.thickness / plate.thickness
    made = replace(
        plate,
        length=geometry.length,
        width=geometry.width,
        thickness=geometry.thickness,
        mass=None if plate.mass is None else plate.mass * volume,
        layup=geometry.layup,
        edges=geometry.edges,
    )
    sensors = tuple(replace(s, x=s.x * along, y=s.y * across) for s in specimen.sensors)
    return replace(specimen, plate=made, sensors=sensors)


def layups_of(specimen: Specimen, layups: Sequence[str] | None) -> tuple[Layup, ...]:
    """Requested layups, or the plate's and usual ones of as many plies."""
    present = specimen.plate.layup
    if present.kinds:
        if layups:
            raise ValueError(f"layups: received a plate of {present.text}, accepted: plates of equal plies")
        return (present,)
    if layups:
        return tuple(_layup(text) for text in layups)
    n = present.n_plies
    if specimen.material.isotropic:
        return (present,)
    usual = [
        parse_layup(re.sub(r"\((.*)\)_1\b", r"\1", pattern.format(n=n // plies)))
        for plies, pattern in _PATTERNS
        if n % plies == 0
    ]
    every = {tuple(layup.angles_deg): layup for layup in (*reversed(usual), present)}
    others = [layup for layup in usual if every[tuple(layup.angles_deg)] is layup]
    return (present, *others)


def _layup(text: str) -> Layup:
    try:
        layup = parse_layup(text)
    except LayupError as error:
        raise ValueError(f"layups: received {text!r}: {error}") from None
    if layup.n_unknown:
        raise ValueError(f'layups: received {text!r}, accepted: known angles, no "?"')
    return layup


def _edges(text: str) -> str:
    if not is_stated(text):
        raise ValueError(
            f"edges: received {text!r}, accepted: four letters F, S or C for x=0, y=0, x=length, y=width"
        )
    return text


def _shapes(length: float, width: float, ratios: Sequence[float] | None) -> list[tuple[float, float]]:
    """Lengths and widths of plates of one area, by ascending ratio, the present one unchanged."""
    present, side = length / width, math.sqrt(length * width)
    wanted = list(ratios) if ratios else [present, *_RATIOS]
    shapes = []
    for ratio in sorted(set(wanted)):
        near = abs(ratio / present - 1.0) < _SAME
        if near and ratio != present and not ratios:
            continue
        root = math.sqrt(ratio)
        shapes.append((length, width) if near else (side * root, side / root))
    return shapes


def _key(g: Geometry) -> tuple[object, ...]:
    return (g.length, g.width, g.thickness, tuple(g.layup.angles_deg), g.edges)


# A tenth of a usual measurement's noise will do.
_TOLERANCE = Tolerance(kept=3e-4, rich=2e-4)
# Relative offset of constants from the reference, so that equal ones cause no symmetry.
_BESIDE = 0.01


@dataclass(frozen=True, slots=True)
class Response:
    """Frequencies of a specimen at the reference constants.

    frequencies : (n_modes,) Hz
    slopes : (n_modes, n) their derivatives by the constants for each standard deviation of the prior, Hz,
        then their common errors: of sizes, mass and frequency scale, and of compliant clamps
    error : (n_modes,) estimated relative error
    precision : (n, n) inverse of the priors' correlation
    """

    frequencies: Array
    slopes: Array
    error: Array
    precision: Array


@dataclass(frozen=True, slots=True)
class Test:
    """Noise of a planned test; relative_std : repeatability, resolution : Hz."""

    __test__ = False  # it is none of pytest's

    relative_std: float
    resolution: float


@dataclass(frozen=True, slots=True)
class Expected:
    """Expected information of a list.

    information : about the requested constants, nats
    each : (n,) about each constant alone, nats
    sd : (n,) standard deviations of the constants, SI
    """

    information: float
    each: Array
    sd: Array


def response_of(specimen: Specimen, n_modes: int) -> Response:
    """Frequencies of a specimen and their derivatives, on a Ritz space converged at the reference.

    Sizes, mass and frequency scale have the errors of `known_errors`, stated or usual. A clamp is compliant
    in rotation and in translation by one catalogue standard deviation: its compliance is not better known.

    Raises ``RigidBodyError`` where bending is lost in rounding.
    """
    parameters = specimen.unknowns
    problem = plate_problem(specimen, parameters)
    x = reference_vector(specimen, parameters)
    beside = x * (1.0 + _BESIDE * np.linspace(-1.0, 1.0, len(x)))
    samples = np.stack((x, np.clip(beside, parameters.lower, parameters.upper)))
    samples = samples[problem.admissible(parameters.mapping(samples)) | np.array([True, False])]
    converged = converge(problem, parameters.mapping(samples), n_modes, _TOLERANCE)
    basis = (converged.settings, converged.keep)
    model = PlateModel(converged.operator, n_modes, converged.error, basis)
    predicted = model.predict(x, jacobian=True)
    assert predicted.jacobian is not None
    f, constants = predicted.frequencies[0], dict(zip(parameters.names, x.tolist(), strict=True))
    common = common_errors(specimen, model, constants, np.arange(n_modes))
    relative = np.column_stack([*common.values(), *_of_clamps(specimen, x, n_modes, converged.settings)])
    n = parameters.size
    precision = np.eye(n + relative.shape[1])
    precision[:n, :n] = parameters.precision
    slopes = np.column_stack((predicted.jacobian[0] * parameters.prior_sd, f[:, None] * relative))
    return Response(f, slopes, converged.error[:n_modes], precision)


def _of_clamps(specimen: Specimen, x: Array, n_modes: int, settings: RitzSettings) -> list[Array]:
    """Shifts (n_modes,) of ln f by each compliance of the clamps, one catalogue standard deviation.

    settings : of a Ritz space that is converged for the ideal clamps; opened, it serves for both
    """
    plate, shifts = specimen.plate, []
    facts = PlateFacts.of(plate, specimen.material.isotropic, loaded=bool(specimen.sensors))
    for effect in (CLAMP_ROTATION, CLAMP_TRANSLATION):
        if not effect.applies_to(facts):
            continue
        problem = extend(plate_problem(specimen, specimen.unknowns), effect, facts)
        sizes = [list(values.values()) for values in (effect.null, effect.scaled(1.0))]
        samples = np.column_stack((np.repeat(x[None], 2, axis=0), sizes))
        space = ritz_space(problem.edges, problem.nominal, settings)
        operator = discretise(problem, space, problem.parameters.mapping(samples))
        without, given = PlateModel(operator, n_modes, np.zeros(n_modes)).predict(samples).frequencies
        shifts.append(np.log(given / without))
    return shifts


def expected_information(
    response: Response, n_modes: int, test: Test, prior: Array, asked: Array
) -> Expected:
    """Information of the lowest modes about constants, with everything else integrated out.

    The posterior at the reference is Gaussian with the precision F + P^-1, F = J^T S^-1 J the Fisher
    information of the frequencies and P the covariance of the priors. The expected information is
    I = 1/2 (log det P_A - log det C_A), C_A the block of the requested constants in (F + P^-1)^-1, the common
    errors of the frequencies integrated out (Lindley, 1956; Chaloner and Verdinelli, 1995).
    S = (relative_std f)^2 + resolution^2 / 12 + (solver's error)^2.

    prior : (n,) standard deviations of the constants' priors; asked : (n,) bool
    """
    f = response.frequencies[:n_modes]
    noise = (test.relative_std * f) ** 2 + test.resolution**2 / 12.0 + (response.error[:n_modes] * f) ** 2
    j = response.slopes[:n_modes] / np.sqrt(noise)[:, None]
    covariance = np.linalg.inv(j.T @ j + response.precision)  # in units of the priors
    n = len(prior)
    before = np.linalg.inv(response.precision)[:n, :n][np.ix_(asked, asked)]
    of_constants = covariance[:n, :n]
    spread = np.sqrt(np.diagonal(of_constants))
    block = of_constants[np.ix_(asked, asked)]
    information = 0.5 * float(np.linalg.slogdet(before)[1] - np.linalg.slogdet(block)[1])
    return Expected(information, -np.log(spread), spread * prior)


@dataclass(frozen=True, slots=True)
class Candidate:
    """A specimen with a number of modes, and the expected information of its list.

    is_present : whether it is the plate as it is, with as many modes as were measured, or 10
    information : about the requested constants, nats
    """

    geometry: Geometry
    n_modes: int
    is_present: bool
    expected: Expected

    @property
    def information(self) -> float:
        """Expected information about the requested constants, nats."""
        return self.expected.information

    @property
    def description(self) -> str:
        """Size, layup, edges and number of modes."""
        g = self.geometry
        layup = f"{g.layup.text}, " if g.layup.n_plies > 1 else ""
        return (
            f"{1e3 * g.length:.4g} x {1e3 * g.width:.4g} x {1e3 * g.thickness:.4g} mm, {layup}{g.edges}, "
            f"{self.n_modes} mode{'' if self.n_modes == 1 else 's'}"
        )


def needed_std(response: Response, n_modes: int, test: Test, prior: Array, asked: Array) -> float | None:
    """Largest repeatability, 1, 2 or 5 times a power of ten, at which the data determine all asked."""
    for std in _STDS:
        sd = expected_information(response, n_modes, Test(std, test.resolution), prior, asked).sd
        verdicts = [
            verdict_of(float(s), float(p), explained=True)
            for s, p in zip(sd[asked], prior[asked], strict=True)
        ]
        if all(verdict is Verdict.DATA for verdict in verdicts):
            return std
    return None


def measured_like(specimen: Specimen, relative_std: float | None) -> tuple[Test, bool]:
    """Noise of further tests of a specimen, and whether it is that of a usual tap test."""
    measurement = specimen.measurement
    resolution = 0.0 if measurement is None else measurement.resolution
    if relative_std is not None:
        return Test(relative_std, resolution), False
    if measurement is not None and measurement.frequency_sd is not None:
        return Test(float(np.mean(measurement.frequency_sd / measurement.frequencies)), resolution), False
    if measurement is not None and measurement.relative_std is not None:
        return Test(measurement.relative_std, resolution), False
    return Test(USUAL_STD, resolution), True
