"""The content of a plate file, in SI: plate, material, sensors, measured frequencies.

Names of the plate file, which carry their unit, are used only in input and output.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cpam_bayes.answer import Notice, as_written
from cpam_bayes.formatting import listed
from cpam_bayes.parameters import ParameterSet, read_only
from cpam_bayes.plate.laminate import (
    CONSTANTS,
    CONSTRAINTS,
    MaterialSymmetry,
    complete_constants,
    constants_of,
    constraint_margins,
    is_admissible,
)
from cpam_bayes.plate.laminate import Array as Array
from cpam_bayes.plate.layup import Layup

USER_UNITS: Final[Mapping[str, tuple[str, float]]] = MappingProxyType(
    {
        "E1_GPa": ("E1", 1e9),
        "E2_GPa": ("E2", 1e9),
        "nu12": ("nu12", 1.0),
        "G12_GPa": ("G12", 1e9),
        "G13_GPa": ("G13", 1e9),
        "G23_GPa": ("G23", 1e9),
        "length_mm": ("length", 1e-3),
        "width_mm": ("width", 1e-3),
        "thickness_mm": ("thickness", 1e-3),
        "density_kg_m3": ("density", 1.0),
        "mass_g": ("mass", 1e-3),
        "x_mm": ("x", 1e-3),
        "y_mm": ("y", 1e-3),
        "air_density_kg_m3": ("air_density", 1.0),
        "relative_std": ("relative_std", 1.0),
        "absolute_sd_hz": ("absolute_sd", 1.0),
        "frequency_scale": ("frequency_scale", 1.0),
        "theory_shear": ("theory_shear", 1.0),
        "theory_level": ("theory_level", 1.0),
    }
)
"""Name in the plate file -> (internal name, the file's unit in SI)."""

_BY_NAME: Final = {name: (user, factor) for user, (name, factor) in USER_UNITS.items()}


def split_name(name: str) -> tuple[str, str]:
    """The material, "" unless of a hybrid, and the plain name of a constant: "c" and "E1" of "c.E1"."""
    material, _, plain = name.rpartition(".")
    return material, plain


def joined_name(material: str, name: str) -> str:
    """The name of a constant of a material: "c.E1"; for the material "" its plain name."""
    return f"{material}.{name}" if material else name


def to_si(user: str, value: float) -> float:
    """A number of the plate file in SI.

    raises ValueError for a name that is not in USER_UNITS
    """
    if user not in USER_UNITS:
        raise ValueError(f"name with unit: received {user!r}, accepted: {list(USER_UNITS)}")
    return _scaled(value, USER_UNITS[user][1])


def to_user(name: str, value: float) -> float:
    """An internal number, SI, in the unit of the plate file.

    raises ValueError for a name that is not in USER_UNITS
    """
    return _scaled(value, 1.0 / _lookup(name)[1])


def user_name(name: str) -> str:
    """The plate file's name, with its unit, of an internal name.

    raises ValueError for a name that is not in USER_UNITS
    """
    return _lookup(name)[0]


def unit_of(name: str) -> str:
    """The unit of a constant's name in the plate file, "" where it has none."""
    return user_name(name).removeprefix(name).removeprefix("_")


def _lookup(name: str) -> tuple[str, float]:
    material, plain = split_name(name)
    if plain not in _BY_NAME:
        raise ValueError(f"name: received {name!r}, accepted: {list(_BY_NAME)}")
    user, factor = _BY_NAME[plain]
    return joined_name(material, user), factor


def _scaled(value: float, factor: float) -> float:
    """The value times a factor, rounded only once: 3.2 mm must be 0.0032 m."""
    return value * factor if factor >= 1.0 else value / round(1.0 / factor)


Value = TypeVar("Value")
_NONE_VARIED: Final[Mapping[str, ArrayLike]] = MappingProxyType({})


USUAL_SD: Final[Mapping[str, float]] = MappingProxyType(
    {"length": 0.001, "width": 0.001, "thickness": 0.01, "density": 0.01, "mass": 0.002}
)
"""Relative standard deviations of a plate's sizes, density and mass by default: docs/priors.md."""


def sds_apart(first: tuple[float, float], second: tuple[float, float]) -> float:
    """Distance of two values with standard deviations, over the standard deviation of their difference."""
    return abs(first[0] - second[0]) / math.hypot(first[1], second[1])


@dataclass(frozen=True, slots=True)
class Plate:
    """A rectangular plate, x along its length and y along its width.

    length, width, thickness : m
    density : kg/m3, from the mass when that was given
    mass : kg, None when the density was given
    edges : four of F (free), S (simply supported), C (clamped): x = 0, y = 0, x = length, y = width
    sd : standard deviations of length, width, thickness, density, mass where given, SI; 0: exact
    mesh : a mesh file to be used instead of the rectangle
    thicknesses : as gauged, and from mass and density, each with its standard deviation, m; None where the
        file does not give all three
    """

    length: float
    width: float
    thickness: float
    density: float
    mass: float | None
    layup: Layup
    edges: str
    sd: Mapping[str, float]
    mesh: Path | None
    thicknesses: tuple[tuple[float, float], tuple[float, float]] | None = None

    @property
    def area(self) -> float:
        """Length times width, m2."""
        return self.length * self.width

    @property
    def thicknesses_apart(self) -> float:
        """Distance of the two thicknesses in standard deviations of their difference; 0 for one."""
        if self.thicknesses is None:
            return 0.0
        return sds_apart(*self.thicknesses)

    @property
    def total_mass(self) -> float:
        """Mass as weighed, else density times volume, kg."""
        return self.density * self.area * self.thickness if self.mass is None else self.mass

    @property
    def sizes(self) -> dict[str, float]:
        """The stated sizes of a plate, SI: a weighed plate has a mass and no density of its own."""
        weighed = {"density": self.density} if self.mass is None else {"mass": self.mass}
        return {"thickness": self.thickness, "length": self.length, "width": self.width, **weighed}

    @property
    def known_to(self) -> dict[str, float]:
        """Standard deviations of the `sizes`, SI: those stated, else the usual ones."""
        return {name: self.sd.get(name, USUAL_SD[name] * value) for name, value in self.sizes.items()}

    def is_weighed_to(self, sd: float) -> bool:
        """Whether the mass is known to this relative standard deviation or better."""
        return self._is_known_to("mass", sd)

    def is_gauged_to(self, sd: float) -> bool:
        """Whether the thickness is known to this relative standard deviation or better."""
        return self._is_known_to("thickness", sd)

    def _is_known_to(self, name: str, sd: float) -> bool:
        # what is stated to the same figure may differ by rounding
        return name in self.sizes and self.known_to[name] <= sd * (1.0 + 1e-6) * self.sizes[name]


@dataclass(frozen=True, slots=True)
class Constraint:
    """An inequality that the constants of a ply must satisfy.

    text : as a formula, with its equation where it has a number
    symmetry : of the ply
    of : the material of a hybrid laminate
    """

    text: str
    symmetry: MaterialSymmetry
    of: str = ""


@dataclass(frozen=True, slots=True)
class Material:
    """Reference constants of a ply.

    symmetry : determines which constants the ply has, which follow from others, and what they satisfy
    constants : Pa or dimensionless; E1, E2, nu12, G12 and, where given, G13, G23;
        isotropic: E1, nu12
    sd : standard deviation of each, in the same unit, where given
    name : plates of the same name share their constants
    known : whether the constants are prior information; if not, only the bounds are
    """

    symmetry: MaterialSymmetry
    constants: Mapping[str, float]
    sd: Mapping[str, float]
    name: str | None
    known: bool = True

    @property
    def isotropic(self) -> bool:
        """Whether the ply is isotropic."""
        return self.symmetry == "isotropic"

    @property
    def parts(self) -> Mapping[str, Material]:
        """The material itself, under the empty name."""
        return {"": self}

    @property
    def constraints(self) -> tuple[Constraint, ...]:
        """The constraints on the constants, in the order of `margins`."""
        return tuple(Constraint(text, self.symmetry) for text in CONSTRAINTS[self.symmetry])

    def complete(self, values: Mapping[str, ArrayLike] = _NONE_VARIED) -> dict[str, Array]:
        """All six constants, those in ``values`` (...) in place of the reference; see `complete_constants`.

        Names in ``values`` that are no constants are ignored.
        """
        return complete_constants(self._with(values), self.symmetry)

    def admissible(self, values: Mapping[str, ArrayLike]) -> NDArray[np.bool_]:
        """True where constants are admissible, with ``values`` (...) in place of the reference; (...)."""
        return is_admissible(self._with(values), self.symmetry)

    def margins(self, values: Mapping[str, ArrayLike]) -> NDArray[np.float64]:
        """Constraint margins with ``values`` (...) in place of the reference, (..., n_constraints)."""
        return constraint_margins(self._with(values), self.symmetry)

    def with_constants(self, constants: Mapping[str, float]) -> Material:
        """The material with other reference constants; only those that its symmetry has are used."""
        names = self.constants if self.isotropic else constants
        return replace(self, constants={name: constants[name] for name in names})

    def _with(self, values: Mapping[str, ArrayLike]) -> dict[str, ArrayLike]:
        return {**self.constants, **{name: v for name, v in values.items() if name in CONSTANTS}}


@dataclass(frozen=True, slots=True)
class Hybrid:
    """The materials of a hybrid laminate by name; the constant E1 of a material "c" is called "c.E1".

    It has the interface of a `Material`, for all of them at once.
    """

    parts: Mapping[str, Material]

    @property
    def constants(self) -> Mapping[str, float]:
        """Reference constants as given, Pa or dimensionless."""
        return self._joined({name: part.constants for name, part in self.parts.items()})

    @property
    def sd(self) -> Mapping[str, float]:
        """Standard deviation of each, in the same unit, where given."""
        return self._joined({name: part.sd for name, part in self.parts.items()})

    @property
    def name(self) -> str:
        """The names of the materials, in words."""
        return listed([part.name or name for name, part in self.parts.items()], "and")

    @property
    def symmetry(self) -> str:
        """The symmetries of the materials, in words."""
        return ", ".join(f"{name} {part.symmetry}" for name, part in self.parts.items())

    @property
    def isotropic(self) -> bool:
        """False: a hybrid has directions, through its thickness at least."""
        return False

    @property
    def constraints(self) -> tuple[Constraint, ...]:
        """The constraints on the constants, in the order of `margins`."""
        return tuple(replace(each, of=name) for name, part in self.parts.items() for each in part.constraints)

    def complete(self, values: Mapping[str, ArrayLike] = _NONE_VARIED) -> dict[str, Array]:
        """All six constants of each material, see `Material.complete`."""
        return self._joined(
            {name: part.complete(constants_of(values, name)) for name, part in self.parts.items()}
        )

    def admissible(self, values: Mapping[str, ArrayLike]) -> NDArray[np.bool_]:
        """True where the constants of all materials are admissible, see `Material.admissible`; (...)."""
        each = (part.admissible(constants_of(values, name)) for name, part in self.parts.items())
        return np.asarray(reduce(np.logical_and, each))

    def margins(self, values: Mapping[str, ArrayLike]) -> NDArray[np.float64]:
        """Margins of the constraints, (..., n_constraints)."""
        each = [part.margins(constants_of(values, name)) for name, part in self.parts.items()]
        shape = np.broadcast_shapes(*(m.shape[:-1] for m in each))
        return np.concatenate([np.broadcast_to(m, (*shape, m.shape[-1])) for m in each], axis=-1)

    def with_constants(self, constants: Mapping[str, float]) -> Hybrid:
        """The materials with other reference constants, see `Material.with_constants`."""
        return Hybrid(
            {name: part.with_constants(constants_of(constants, name)) for name, part in self.parts.items()}
        )

    @staticmethod
    def _joined(parts: Mapping[str, Mapping[str, Value]]) -> dict[str, Value]:
        return {
            joined_name(part, name): value for part, values in parts.items() for name, value in values.items()
        }


@dataclass(frozen=True, slots=True)
class Sensor:
    """A known mass on the plate: mass kg; x, y m from the corner x = y = 0."""

    mass: float
    x: float
    y: float


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredShapes:
    """Shapes of measured modes, in the order of their frequencies.

    nodes : (n,) numbers
    points : (n, 2) x and y, m from the corner x = y = 0
    values : (n_modes, 3, n) displacements along x, y and z, of any scale, real or complex
    """

    nodes: Array
    points: Array
    values: Array

    def __post_init__(self) -> None:
        for name in ("nodes", "points", "values"):
            array = np.array(getattr(self, name))
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    @property
    def directions(self) -> Array:
        """Directions in which some mode moves, (3,) bool; the others were not measured."""
        return np.asarray(np.any(self.values != 0.0, axis=(0, 2)))


USUAL_SCALE_SD: Final = 1e-4
"""Relative standard deviation of an analyser's frequency scale, where the file gives none."""


@dataclass(frozen=True, slots=True, eq=False)
class Measurement:
    """Natural frequencies as the laboratory listed them, rigid-body motions left out.

    frequencies : (n,) Hz, never descending
    resolution : Hz, rounding of the list or line spacing of the analyser, 0 when not known
    relative_std : repeatability as a fraction of each frequency, None when it is to be inferred
    frequency_sd : (n,) Hz, one for each; it overrules relative_std
    labels : n mode labels, "" where the mode is not known
    complete : no mode is missing from the list
    missed_probability : that a mode in the range of an incomplete list is missing from it
    false_peaks : expected number of frequencies that are no mode; of candidate peaks (n,), like each of them
    mode_probability : (n,) prior probability of candidate peaks to be modes; None for a list
    test : the `ModalTest` of candidate peaks, None where there are no recordings
    scale_sd : relative standard deviation of the analyser's frequency scale, 0 where it is exact
    damping : (n,) ratios to critical damping, nan where not measured; None where none is
    shapes : of its modes, None where they were not measured
    origin : the file it was read from and how it was used, "" for a list in the plate file
    remarks : possible slips in that file, and changes by hand, a sentence each
    whole : the list with all its rows, None where none was left out
    """

    frequencies: NDArray[np.float64]
    resolution: float
    relative_std: float | None
    frequency_sd: NDArray[np.float64] | None
    labels: tuple[str, ...]
    complete: bool
    missed_probability: float = 0.1
    false_peaks: float | NDArray[np.float64] = 0.1
    mode_probability: NDArray[np.float64] | None = None
    test: Any = None
    scale_sd: float = USUAL_SCALE_SD
    damping: NDArray[np.float64] | None = None
    shapes: MeasuredShapes | None = None
    origin: str = ""
    remarks: tuple[str, ...] = ()
    whole: Measurement | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "frequencies", read_only(self.frequencies))
        if self.frequency_sd is not None:
            object.__setattr__(self, "frequency_sd", read_only(self.frequency_sd))
        if self.damping is not None:
            object.__setattr__(self, "damping", read_only(self.damping))

    @property
    def notices(self) -> tuple[Notice, ...]:
        """Doubts from reading it, and notices about its hits."""
        return (*as_written(self.remarks), *(() if self.test is None else self.test.notices))

    @property
    def loss_factors(self) -> NDArray[np.float64] | None:
        """Twice the damping ratios, eta = 2 zeta of a lightly damped mode, (n,); None without them."""
        return None if self.damping is None else 2.0 * self.damping

    @property
    def relative_noise(self) -> float | None:
        """Mean standard deviation as a fraction of a frequency, None where it is to be inferred."""
        if self.frequency_sd is None:
            return self.relative_std
        return float(np.mean(self.frequency_sd / self.frequencies))

    @property
    def sd_source(self) -> str:
        """The source of ``frequency_sd``: the plate file, or the hits of another file."""
        if not self.origin:
            return "the stated frequency_sd_hz"
        stated = "" if self.relative_std is None else f"the stated {100.0 * self.relative_std:.2g} % and "
        return f"{stated}the scatter of the hits"

    @property
    def names_modes(self) -> bool:
        """Whether labels or shapes identify the modes of some frequencies."""
        return any(self.labels) or self.shapes is not None

    @property
    def size(self) -> int:
        """Number of measured frequencies."""
        return int(self.frequencies.size)

    def of_rows(self, rows: Sequence[int] | NDArray[np.intp]) -> Measurement:
        """The measurement with some rows only, numbers from 0, in this order."""
        of_each = ("frequencies", "frequency_sd", "damping", "mode_probability", "false_peaks")
        values = {name: getattr(self, name) for name in of_each}
        chosen: dict[str, Any] = {name: v[rows] for name, v in values.items() if isinstance(v, np.ndarray)}
        return replace(self, **chosen, labels=tuple(self.labels[i] for i in rows))

    def without(self, rows: Collection[int]) -> Measurement:
        """The list without rows, numbers from 0; it is incomplete then, unless only its last ones go."""
        kept = [i for i in range(self.size) if i not in rows]
        complete = self.complete and kept == list(range(len(kept)))
        return replace(self.of_rows(kept), complete=complete, whole=self)

    def noise_sd(self, relative: float) -> NDArray[np.float64]:
        """Standard deviations of the frequencies, (n,) Hz: ``frequency_sd``, or ``relative`` of each."""
        return relative * self.frequencies if self.frequency_sd is None else self.frequency_sd


@dataclass(frozen=True, slots=True, eq=False)
class Specimen:
    """One plate under one test, with its unknowns.

    name : of this file.
    specimen : of the plate itself, shared by its tests
    source : the file it was read from, or "built-in NAME"
    unknowns : elastic constants to identify, Pa or dimensionless
    angle_grid_deg : step of the grid of unknown ply angles
    air_density : kg/m3, None for vacuum
    notes : remarks to show beside results
    certificate : laboratory, operator and date of the test, as far as the file gives them
    sequence_layup : the layup with unknown angles for the question `sequence`, where there is one
    """

    name: str
    specimen: str
    source: str
    plate: Plate
    material: Material | Hybrid
    unknowns: ParameterSet
    angle_grid_deg: float
    air_density: float | None
    sensors: tuple[Sensor, ...]
    measurement: Measurement | None
    notes: tuple[str, ...]
    sequence_layup: Layup | None = None
    certificate: tuple[tuple[str, str], ...] = ()

    def with_unknown_angles(self) -> Specimen:
        """The specimen with its `sequence_layup`, where it has one."""
        if self.sequence_layup is None:
            return self
        return replace(self, plate=replace(self.plate, layup=self.sequence_layup))

    def with_exact_sizes(self) -> Specimen:
        """The specimen with sizes, mass and frequency scale as in the file, without tolerances."""
        exact = dict.fromkeys(self.plate.sizes, 0.0)
        measurement = self.measurement and replace(self.measurement, scale_sd=0.0)
        return replace(self, plate=replace(self.plate, sd=exact), measurement=measurement)


def angle_grid(step_deg: float) -> NDArray[np.float64]:
    """Ply angles on (-90, 90] that end at 90, eq. (10) for a step of 5; (180 / step,) degrees.

    raises ValueError when the step does not divide 180 or is below 0.1
    """
    count = round(180.0 / step_deg) if 0.1 <= step_deg <= 180.0 else 0
    if count < 1 or abs(count * step_deg - 180.0) > 1e-9:
        raise ValueError(f"angle grid: received a step of {step_deg}, accepted: 0.1 or more, dividing 180")
    return read_only(np.round(90.0 - step_deg * np.arange(count - 1, -1, -1), 9) + 0.0)
