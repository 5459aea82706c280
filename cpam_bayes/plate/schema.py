"""The plate file as strict models: names, types and ranges of single values, and messages about wrong ones.

Relations between values are in checks.py. Error messages quote the description of a field as accepted.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from datetime import date as day
from functools import partial
from types import UnionType
from typing import Annotated, Any, Final, Union, get_args, get_origin, get_type_hints

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, ValidationError
from pydantic.fields import FieldInfo

from cpam_bayes.plate.edges import STATED
from cpam_bayes.plate.laminate import MaterialSymmetry
from cpam_bayes.plate.text import MAX_SHOWN, KeyPath, Problem, received

# More frequencies than modes are computed, or more masses than a plate carries in a test, are a slip.
MAX_FREQUENCIES: Final = 100
_MAX_SENSORS: Final = 100
_MAX_PLY_KINDS: Final = 100
_MAX_NOTES: Final = 1000
# A table with more unknown keys than this is not of a plate file.
_MAX_RESPELT: Final = 20
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
SizeSpread = Annotated[float, _not_negative("a number above 0, or 0 for a size that is exact")]
Place = Annotated[float, _not_negative("a number, in mm from the corner x = y = 0")]
# No control, formatting or line characters: texts are printed as they are.
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


class _PlateSpreads(_Table):
    length_mm: SizeSpread | None = None
    width_mm: SizeSpread | None = None
    thickness_mm: SizeSpread | None = None
    density_kg_m3: SizeSpread | None = None
    mass_g: SizeSpread | None = None


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
            pattern=f"^[{STATED}]{{4}}$",
            description=f"four letters of {' '.join(STATED)} for x=0, y=0, x=length, y=width",
        ),
    ]
    mesh: (
        Annotated[str, Field(min_length=1, description="the path of a mesh file, from this file")] | None
    ) = None
    sd: Annotated[_PlateSpreads, Field(description="a table [plate.sd]")] | None = None


class _MaterialSpreads(_Table):
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
    known: Flag | None = None
    posterior: (
        Annotated[str, Field(min_length=1, description="the path of a posterior.nc, from this file")] | None
    ) = None
    sd: Annotated[_MaterialSpreads, Field(description="a table [material.sd]")] | None = None


Step = Annotated[
    float,
    Field(gt=0, le=180, allow_inf_nan=False, description="a step that divides 180, 0.1 or more"),
]


class PlyModel(_Table):
    """A table [[ply]]: a ply that the layup refers to by name."""

    name: Name
    material: Annotated[str, Field(description="a material M with a table [material.M]")] | None = None
    thickness_mm: Millimetres


Bounds = Annotated[
    list[Annotated[float, _finite("a number")]],
    Field(min_length=2, max_length=2, description="[lower, upper]"),
]


class NormalModel(_Table):
    """A truncated normal prior in [unknowns], before truncation."""

    mean: Annotated[float, _finite("a number")]
    sd: Spread
    bounds: Bounds


def _form(value: object) -> str | None:
    if isinstance(value, list):
        return "bounds"
    return "normal" if isinstance(value, dict | NormalModel) else None


# The names of the two forms occur in pydantic's locations, not in the file.
_TAGS: Final = ("bounds", "normal")

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
_OF_EACH, _OF_ALL = "of each material", "of all materials"


def is_hybrid(table: object) -> bool:
    """Whether a table [material] or [unknowns] has a table for each material instead of constants."""
    if not isinstance(table, dict):
        return False
    named = {key: value for key, value in table.items() if key != "angle_grid_deg"}
    return bool(named) and all(isinstance(v, dict | BaseModel) and k not in _SHARED for k, v in named.items())


def _materials(table: object) -> str:
    return _OF_EACH if is_hybrid(table) or isinstance(table, HybridUnknownsModel) else _OF_ALL


Materials = Annotated[
    Annotated[MaterialModel, Tag(_OF_ALL)] | Annotated[dict[Name, MaterialModel], Tag(_OF_EACH)],
    Discriminator(_materials),
    Field(description="a table [material], or a table [material.NAME] for each of several"),
]
Unknowns = Annotated[
    Annotated[UnknownsModel, Tag(_OF_ALL)] | Annotated[HybridUnknownsModel, Tag(_OF_EACH)],
    Discriminator(_materials),
    Field(description="a table [unknowns], or a table [unknowns.NAME] for each of several materials"),
]


class _EnvironmentModel(_Table):
    air_density_kg_m3: Annotated[float, _not_negative("a number, 0 or above, in kg/m3")] | None = None


class SensorModel(_Table):
    """A table [[sensor]]: a known mass on the plate."""

    mass_g: Grams
    x_mm: Place
    y_mm: Place


class ColumnsModel(_Table):
    """The table [measurement.columns]: the headings of a table of modes or peaks."""

    mode: Text | None = None
    label: Text | None = None
    hz: (
        Annotated[
            Annotated[str, Field(min_length=1, max_length=200)]
            | Annotated[list[Text], Field(max_length=MAX_FREQUENCIES)],
            Field(description="a head, or a list of the heads of all modes"),
        ]
        | None
    ) = None
    hit: Text | None = None
    sd: Text | None = None
    damping: Text | None = None
    weight: Text | None = None
    height: Text | None = None


RowNumbers = Annotated[
    list[Annotated[int, Field(ge=1, le=MAX_FREQUENCIES, description="the number of a frequency, from 1")]],
    Field(max_length=MAX_FREQUENCIES, description="a list of numbers of frequencies, from 1"),
]


class MeasurementModel(_Table):
    """The table [measurement]."""

    frequencies_hz: (
        Annotated[
            list[Annotated[Hertz, Field(description="a number above 0, in Hz; no rigid-body motion")]],
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
    columns: Annotated[ColumnsModel, Field(description="a table [measurement.columns]")] | None = None
    recordings: (
        Annotated[
            list[Annotated[str, Field(min_length=1, description="a path from this file")]],
            Field(min_length=1, description="a list of recorded hits, of responses or of folders of hits"),
        ]
        | None
    ) = None
    range_hz: (
        Annotated[
            list[Hertz],
            Field(
                min_length=2,
                max_length=2,
                description="a list of two numbers, the ends of the range of recordings",
            ),
        ]
        | None
    ) = None
    peaks: (
        Annotated[str, Field(min_length=1, description="the path of a table of peaks, from this file")] | None
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
            Field(
                gt=0, lt=1, allow_inf_nan=False, description="a fraction above 0 and below 1; 0.2 % is 0.002"
            ),
        ]
        | None
    ) = None
    frequency_scale_sd: (
        Annotated[float, Field(ge=0, lt=1, allow_inf_nan=False, description="a fraction below 1, or 0")]
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
    left_out: RowNumbers = []
    by_hand: RowNumbers = []
    picked_from: (
        Annotated[str, Field(min_length=1, description="the file of the recording, from this file")] | None
    ) = None
    missed_probability: (
        Annotated[float, Field(gt=0, lt=1, allow_inf_nan=False, description="a number above 0 and below 1")]
        | None
    ) = None
    false_peaks: Annotated[float, _not_negative("a number, 0 or above")] | None = None


class PlateFile(_Table):
    """A plate file."""

    name: Text
    specimen: Text | None = None
    laboratory: Text | None = None
    operator: Text | None = None
    date: Annotated[day | Text, Field(description="a date such as 2026-03-05")] | None = None
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
    environment: Annotated[_EnvironmentModel, Field(description="a table [environment]")] = (
        _EnvironmentModel()
    )
    sensor: Annotated[
        list[Annotated[SensorModel, Field(description="a table [[sensor]]")]],
        Field(max_length=_MAX_SENSORS, description=f"at most {_MAX_SENSORS} tables [[sensor]]"),
    ] = []
    measurement: Annotated[MeasurementModel, Field(description="a table [measurement]")] | None = None


_WRONG: Final = {
    "finite_number": "not a finite number",
    "union_tag_not_found": "not a prior",
    "greater_than": "out of range",
    "greater_than_equal": "out of range",
    "less_than": "out of range",
    "less_than_equal": "out of range",
    "too_short": "wrong length",
    "too_long": "wrong length",
    "string_too_short": "empty text",
    "string_too_long": "text too long",
    "string_pattern_mismatch": "malformed",
    "literal_error": "not a symmetry",
}


# Pydantic's type of the error of a required key.
_MISSING: Final = "missing"


def validated(data: Mapping[str, Any]) -> tuple[PlateFile | None, list[Problem]]:
    """The file as models, or its unknown and missing keys, wrong types and single values out of range."""
    try:
        return PlateFile.model_validate(data), []
    except ValidationError as error:
        return None, [
            Problem(
                _path(item["loc"]),
                partial(_what, item["type"], _path(item["loc"]), item["input"]),
                item["type"] == _MISSING,
            )
            for item in error.errors(include_url=False, include_context=False)
        ]


def respelt(data: Mapping[str, Any]) -> tuple[dict[str, Any], dict[KeyPath, str]]:
    """The file with misspelt keys corrected, and these keys with the known key of each.

    An unknown key is taken for the most similar known one that the table lacks; its value is then checked
    under that name, so that one slip is one problem.
    """
    changed: dict[KeyPath, str] = {}
    return _respelt(data, (), changed), changed


def _respelt(table: Mapping[str, Any], path: KeyPath, changed: dict[KeyPath, str]) -> dict[str, Any]:
    known = _keys_of(PlateFile, path)
    few = sum(key not in known for key in table) <= _MAX_RESPELT
    meant: dict[str, Any] = {}
    for key, value in table.items():
        name = _nearest(key, known, path, value) if few and key not in _TABLE_OF else key
        other = meant.get(name, table.get(name)) if name != key else None
        # [palte] beside [plate.sd]
        joined = isinstance(value, dict) and isinstance(other, dict) and not value.keys() & other.keys()
        if other is not None and not joined:
            name = key
        if name != key:
            changed[(*path, key)] = name
        inside = isinstance(value, dict) and not path and name in known and not is_hybrid(value)
        value = _respelt(value, (*path, name), changed) if inside else value
        before = meant.get(name)
        meant[name] = {**before, **value} if isinstance(before, dict) and isinstance(value, dict) else value
    return meant


def _nearest(key: str, known: Sequence[str], path: KeyPath, value: object) -> str:
    """The known key that one stands for: itself, the most similar, or for a table that with the same keys."""
    if key in known:
        return key
    if not path:  # tables are tables
        known = [name for name in known if (name in _TABLES) == isinstance(value, dict | list)]
    folded = {name.casefold(): name for name in known}
    close = difflib.get_close_matches(key.casefold(), folded, n=3, cutoff=0.5)
    close.sort(key=lambda name: name.count("_") != key.count("_"))
    if close:
        return folded[close[0]]
    inside = set(value) if isinstance(value, dict) else set()
    alike = (
        name
        for name in known
        if not path and 2 * len(inside & set(_keys_of(PlateFile, (name,)))) > len(inside)
    )
    return next(alike, key)


def _what(kind: str, path: KeyPath, value: object) -> str:
    if kind == "extra_forbidden":
        return _unknown_key(path, value)
    accepted = _accepted(PlateFile, path) or "see the plate file's documentation"
    if kind == _MISSING:
        return f"missing, accepted: {accepted}"
    wrong = _WRONG.get(kind, "wrong type")
    if kind == "float_type" and isinstance(value, str) and any(map(str.isdigit, value)):
        accepted += ", with a point and no mark between thousands"
    if kind == "too_long" and isinstance(value, list) and len(value) > MAX_SHOWN:
        return f"too many, received {len(value)}, accepted: {accepted}"
    return f"{wrong}, received {received(value)}, accepted: {accepted}"


def _unknown_key(path: KeyPath, value: object) -> str:
    key = str(path[-1])
    siblings = _keys_of(PlateFile, path[:-1])
    if key in _TABLE_OF:
        return f"unknown key here, it belongs in {_TABLE_OF[key]}"
    nearest = _nearest(key, siblings, path[:-1], value)
    if nearest != key:
        return f"unknown key, the nearest known key is {nearest}"
    return f"unknown key, accepted: {' '.join(siblings)}"


def _path(location: tuple[int | str, ...]) -> KeyPath:
    """Pydantic's location without the tags of the forms of tables and priors."""
    table, form = location[:1], location[1:2]
    if form not in ((_OF_ALL,), (_OF_EACH,)):
        return location
    prior = 2 if form == (_OF_EACH,) else 1
    inside = location[2:]
    if table == ("unknowns",) and inside[prior : prior + 1] and inside[prior] in _TAGS:
        inside = inside[:prior] + inside[prior + 1 :]
    return table + inside


def _accepted(annotation: Any, path: KeyPath) -> str | None:
    """The description of the field at a path of the schema."""
    if get_origin(annotation) is Annotated:
        described = [
            item.description
            for item in annotation.__metadata__
            if isinstance(item, FieldInfo) and item.description
        ]
        if not path and described:
            return described[-1]
        return _accepted(annotation.__origin__, path)
    for inner, rest in _inside(annotation, path):
        accepted = _accepted(inner, rest)
        if accepted:
            return accepted
    return None


def _keys_of(annotation: Any, path: KeyPath) -> list[str]:
    """The keys of the table at a path of the schema."""
    if get_origin(annotation) is Annotated:
        return _keys_of(annotation.__origin__, path)
    if not path and _is_table(annotation):
        return list(annotation.model_fields)
    for inner, rest in _inside(annotation, path):
        keys = _keys_of(inner, rest)
        if keys:
            return keys
    return []


def _inside(annotation: Any, path: KeyPath) -> list[tuple[Any, KeyPath]]:
    """One step along a path into an annotation that is not Annotated."""
    origin = get_origin(annotation)
    if origin in (Union, UnionType):
        return [(option, path) for option in get_args(annotation)]
    if origin is list and path and isinstance(path[0], int):
        return [(get_args(annotation)[0], path[1:])]
    if origin is dict and path:
        return [(get_args(annotation)[1], path[1:])]
    if _is_table(annotation) and path:
        hints = get_type_hints(annotation, include_extras=True)
        if annotation.model_config["extra"] == "allow" and path[0] not in annotation.model_fields:
            return [(hints["__pydantic_extra__"], path)]
        hint = hints.get(str(path[0]))
        return [] if hint is None else [(hint, path[1:])]
    return []


def _is_table(annotation: Any) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)


# Tables that a file may have several of.
_LISTS: Final = ("sensor", "ply")


def _tables() -> dict[str, str]:
    """The table of each key that only one table has."""
    homes: dict[str, list[str]] = {}
    for table in PlateFile.model_fields:
        for key in _keys_of(PlateFile, (table,)) + _keys_of(PlateFile, (table, 0)):
            homes.setdefault(key, []).append(f"[[{table}]]" if table in _LISTS else f"[{table}]")
    homes |= {key: ["the top of the file"] for key in PlateFile.model_fields if key not in homes}
    return {key: places[0] for key, places in homes.items() if len(places) == 1}


_TABLE_OF: Final = _tables()
_TABLES: Final = [name for name in PlateFile.model_fields if _keys_of(PlateFile, (name,)) or name in _LISTS]
