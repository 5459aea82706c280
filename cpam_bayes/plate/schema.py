"""The plate file as strict models: names, types and ranges of single values.

What relates several values is in checks.py. The description of a field is what an error says is
accepted.
"""

from __future__ import annotations

from typing import Annotated, Any, Final

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag

from cpam_bayes.plate.elasticity import MaterialSymmetry

__all__ = [
    "MAX_FREQUENCIES",
    "NAME",
    "OF_ALL",
    "OF_EACH",
    "TAGS",
    "ConstantsModel",
    "HybridUnknownsModel",
    "MaterialModel",
    "MeasurementModel",
    "NormalModel",
    "PlateFile",
    "PlateModel",
    "is_hybrid",
]

# More frequencies than modes are computed, and more masses than a plate is hung with, are a slip.
MAX_FREQUENCIES: Final = 100
_MAX_SENSORS: Final = 100
_MAX_PLY_KINDS: Final = 100
_MAX_NOTES: Final = 1000
# Beyond these, areas and masses would overflow or vanish.
_SMALLEST: Final = 1e-12
_LARGEST: Final = 1e12


def _positive(unit: str) -> Any:
    accepted = f"a number above 0, in {unit}" if unit else "a number above 0"
    return Field(gt=0, ge=_SMALLEST, le=_LARGEST, allow_inf_nan=False, description=accepted)


def _finite(accepted: str) -> Any:
    return Field(ge=-_LARGEST, le=_LARGEST, allow_inf_nan=False, description=accepted)


def _not_negative(accepted: str) -> Any:
    return Field(ge=0, le=_LARGEST, allow_inf_nan=False, description=accepted)


Millimetres = Annotated[float, _positive("mm")]
Grams = Annotated[float, _positive("g")]
Density = Annotated[float, _positive("kg/m3")]
GPa = Annotated[float, _positive("GPa")]
Hertz = Annotated[float, _positive("Hz")]
Poisson = Annotated[float, _finite("a number, Poisson's ratio")]
Spread = Annotated[float, _positive("")]
Place = Annotated[float, _not_negative("a number, in mm from the corner x = y = 0")]
# No control, formatting or line characters: texts are printed as they stand.
_PRINTABLE: Final = r"^[^\p{Cc}\p{Cf}\p{Zl}\p{Zp}]*$"
Text = Annotated[
    str,
    Field(
        min_length=1,
        max_length=200,
        pattern=_PRINTABLE,
        description="a text of printable characters, not empty",
    ),
]
Flag = Annotated[bool, Field(description="true or false")]
NAME: Final = "^[A-Za-z]{1,20}$"
Name = Annotated[str, Field(pattern=NAME, description="a name of 1 to 20 letters")]


class _Table(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)


class PlateSpreads(_Table):
    length_mm: Millimetres | None = None
    width_mm: Millimetres | None = None
    thickness_mm: Millimetres | None = None
    density_kg_m3: Density | None = None
    mass_g: Grams | None = None


class PlateModel(_Table):
    """The table [plate]."""

    length_mm: Millimetres
    width_mm: Millimetres
    thickness_mm: Millimetres
    density_kg_m3: Density | None = None
    mass_g: Grams | None = None
    layup: Annotated[str, Field(description='a layup such as "[(0/90)_8]_s"')] | None = None
    sequence_layup: (
        Annotated[str, Field(description='a layup with "?" for the angles that `sequence` looks for')] | None
    ) = None
    edges: Annotated[
        str,
        Field(
            pattern="^[FSC]{4}$",
            description="four letters of F S C for x=0, y=0, x=length, y=width",
        ),
    ]
    mesh: (
        Annotated[str, Field(min_length=1, description="the path of a mesh file, from this file")] | None
    ) = None
    sd: Annotated[PlateSpreads, Field(description="a table [plate.sd]")] | None = None


class MaterialSpreads(_Table):
    E1_GPa: GPa | None = None
    E2_GPa: GPa | None = None
    nu12: Spread | None = None
    G12_GPa: GPa | None = None
    G13_GPa: GPa | None = None
    G23_GPa: GPa | None = None


class MaterialModel(_Table):
    """The table [material]."""

    symmetry: (
        Annotated[
            MaterialSymmetry, Field(description='"isotropic", "transversely_isotropic" or "orthotropic"')
        ]
        | None
    ) = None
    isotropic: Flag | None = None
    E1_GPa: GPa
    E2_GPa: GPa | None = None
    nu12: Poisson
    G12_GPa: GPa | None = None
    G13_GPa: GPa | None = None
    G23_GPa: GPa | None = None
    density_kg_m3: Density | None = None
    name: Text | None = None
    sd: Annotated[MaterialSpreads, Field(description="a table [material.sd]")] | None = None


Step = Annotated[
    float,
    Field(gt=0, le=180, allow_inf_nan=False, description="a step that divides 180, 0.1 or more"),
]


class PlyModel(_Table):
    """A table [[ply]]: a ply that the layup calls by its name."""

    name: Name
    material: Annotated[str, Field(description="a material M with a table [material.M]")] | None = None
    thickness_mm: Millimetres


Bounds = Annotated[
    list[Annotated[float, _finite("a number")]],
    Field(min_length=2, max_length=2, description="[lower, upper]"),
]


class NormalModel(_Table):
    """A truncated normal prior in [unknowns], before the cut."""

    mean: Annotated[float, _finite("a number")]
    sd: Spread
    bounds: Bounds


def _form(value: object) -> str | None:
    if isinstance(value, list):
        return "bounds"
    return "normal" if isinstance(value, dict | NormalModel) else None


# The names of the two forms stand in pydantic's locations, not in the file.
TAGS: Final = ("bounds", "normal")

PriorModel = Annotated[
    Annotated[Bounds, Tag("bounds")] | Annotated[NormalModel, Tag("normal")],
    Discriminator(_form),
    Field(description="[lower, upper] or { mean = M, sd = S, bounds = [lower, upper] }"),
]


class ConstantsModel(_Table):
    """Unknown constants of one material."""

    E1_GPa: PriorModel | None = None
    E2_GPa: PriorModel | None = None
    nu12: PriorModel | None = None
    G12_GPa: PriorModel | None = None
    G13_GPa: PriorModel | None = None
    G23_GPa: PriorModel | None = None


class UnknownsModel(ConstantsModel):
    """The table [unknowns]."""

    angle_grid_deg: Step = 5.0


class HybridUnknownsModel(_Table):
    """The table [unknowns] with a table for each material."""

    model_config = ConfigDict(strict=True, extra="allow", frozen=True)
    __pydantic_extra__: dict[str, ConstantsModel]

    angle_grid_deg: Step = 5.0


_SHARED: Final = (*MaterialModel.model_fields, *UnknownsModel.model_fields)
OF_EACH, OF_ALL = "of each material", "of all materials"


def is_hybrid(table: object) -> bool:
    """Whether a table [material] or [unknowns] has a table for each material instead of constants."""
    if not isinstance(table, dict):
        return False
    named = {key: value for key, value in table.items() if key != "angle_grid_deg"}
    return bool(named) and all(isinstance(v, dict | BaseModel) and k not in _SHARED for k, v in named.items())


def _materials(table: object) -> str:
    return OF_EACH if is_hybrid(table) or isinstance(table, HybridUnknownsModel) else OF_ALL


Materials = Annotated[
    Annotated[MaterialModel, Tag(OF_ALL)] | Annotated[dict[Name, MaterialModel], Tag(OF_EACH)],
    Discriminator(_materials),
    Field(description="a table [material], or a table [material.NAME] for each of several"),
]
Unknowns = Annotated[
    Annotated[UnknownsModel, Tag(OF_ALL)] | Annotated[HybridUnknownsModel, Tag(OF_EACH)],
    Discriminator(_materials),
    Field(description="a table [unknowns], or a table [unknowns.NAME] for each of several materials"),
]


class EnvironmentModel(_Table):
    air_density_kg_m3: Annotated[float, _not_negative("a number, 0 or above, in kg/m3")] | None = None


class SensorModel(_Table):
    mass_g: Grams
    x_mm: Place
    y_mm: Place


class MeasurementModel(_Table):
    """The table [measurement]."""

    frequencies_hz: (
        Annotated[
            list[Hertz],
            Field(
                min_length=1,
                max_length=MAX_FREQUENCIES,
                description=f"a list of 1 to {MAX_FREQUENCIES} frequencies, ascending",
            ),
        ]
        | None
    ) = None
    table: (
        Annotated[str, Field(min_length=1, description="the path of a table of modes, from this file")] | None
    ) = None
    shapes: (
        Annotated[
            str, Field(min_length=1, description="the path of a universal file of modes, from this file")
        ]
        | None
    ) = None
    resolution_hz: Annotated[float, _not_negative("a number, 0 or above, in Hz")] = 0.0
    relative_std: (
        Annotated[
            float,
            Field(gt=0, lt=1, allow_inf_nan=False, description="a fraction above 0 and below 1"),
        ]
        | None
    ) = None
    frequency_sd_hz: (
        Annotated[
            list[Hertz], Field(max_length=MAX_FREQUENCIES, description="a list, one for each frequency")
        ]
        | None
    ) = None
    labels: (
        Annotated[
            list[Annotated[str, Field(pattern=_PRINTABLE, description='a text, "" for none')]],
            Field(max_length=MAX_FREQUENCIES, description="a list of texts, one for each frequency"),
        ]
        | None
    ) = None
    complete: Flag = True
    missed_probability: (
        Annotated[float, Field(gt=0, lt=1, allow_inf_nan=False, description="a number above 0 and below 1")]
        | None
    ) = None
    false_peaks: Annotated[float, _not_negative("a number, 0 or above")] | None = None


class PlateFile(_Table):
    """A plate file."""

    name: Text
    specimen: Text | None = None
    notes: Annotated[
        list[Annotated[str, Field(pattern=_PRINTABLE, description="a text of printable characters")]],
        Field(max_length=_MAX_NOTES, description=f"a list of at most {_MAX_NOTES} texts"),
    ] = []
    plate: Annotated[PlateModel, Field(description="a table [plate]")]
    material: Materials
    unknowns: Unknowns = UnknownsModel()
    ply: Annotated[
        list[Annotated[PlyModel, Field(description="a table [[ply]]")]],
        Field(max_length=_MAX_PLY_KINDS, description=f"at most {_MAX_PLY_KINDS} tables [[ply]]"),
    ] = []
    environment: Annotated[EnvironmentModel, Field(description="a table [environment]")] = EnvironmentModel()
    sensor: Annotated[
        list[Annotated[SensorModel, Field(description="a table [[sensor]]")]],
        Field(max_length=_MAX_SENSORS, description=f"at most {_MAX_SENSORS} tables [[sensor]]"),
    ] = []
    measurement: Annotated[MeasurementModel, Field(description="a table [measurement]")] | None = None
