"""Readers of plate files, their content and built-in specimens: a `Specimen`, or one error with all problems.

The text (text.py) is parsed; its values are checked one by one (schema.py) and together (checks.py); those
that pass become records in SI.
"""

from __future__ import annotations

import difflib
import itertools
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np

from cpam_bayes.errors import PlateFileError, checked
from cpam_bayes.parameters import Parameter, ParameterSet, Prior, TruncatedNormal, Uniform
from cpam_bayes.plate.checks import CONSTANT_KEYS, ply_kinds, relation_problems, symmetry_of
from cpam_bayes.plate.layup import Layup, PlyKind, parse_layup
from cpam_bayes.plate.records import (
    USER_UNITS,
    USUAL_SD,
    Hybrid,
    Material,
    Measurement,
    Plate,
    Sensor,
    Specimen,
    joined_name,
    sds_apart,
    to_si,
)
from cpam_bayes.plate.schema import (
    ConstantsModel,
    HybridUnknownsModel,
    MaterialModel,
    MeasurementModel,
    NormalModel,
    PlateFile,
    PlateModel,
    SensorModel,
    UnknownsModel,
    respelt,
    validated,
)
from cpam_bayes.plate.text import (
    KeyPath,
    Problem,
    decode,
    line_numbers,
    nearest_file,
    parse,
    plate_file_error,
    read_regular_file,
    received,
    table,
    understood,
)

if TYPE_CHECKING:
    from cpam_bayes.plate.stored_posterior import FormerPriors

# More than the scatter of a plate that is hung and tapped again, as a fraction.
_MUCH_SCATTER: Final = 0.05
# The angles of an isotropic plate's plies change nothing.
_ISOTROPIC_LAYUP = "[0]"
_NAMES: Final = (
    "D&G",
    *("A1", "A2", "B1", "B2", "C1", "C2", "C3", "C4"),
    *("D1", "D2", "D3", "D4", "F1", "F2", "G1", "G2"),
)


PlateLike: TypeAlias = str | os.PathLike[str] | Mapping[str, Any] | Specimen
"""The forms of a plate that verbs take, see `read_plate`."""


@checked
def read_plate(plate: PlateLike) -> Specimen:
    """Read a plate file, its content, or a built-in specimen.

    Parameters
    ----------
    plate : the name of a built-in specimen, the path of a plate file, or a mapping with the sections of
        one (the keys and units of the file; tuples and numpy arrays are lists); a `Specimen` is returned as
        it is

    Raises
    ------
    PlateFileError
        With all problems of the plate at once.

    Examples
    --------
    >>> import cpam_bayes as cb
    >>> plate = cb.read_plate("C1")
    >>> plate.plate.layup.text, plate.unknowns.names
    ('[(0/90)_8]_s', ('E1', 'E2', 'nu12', 'G12'))
    """
    if isinstance(plate, Specimen):
        return plate
    if isinstance(plate, Mapping):
        return _checked_specimen(_as_of_a_file(plate), str(plate.get("name", "plate")), None, {})
    return read_specimen(os.fspath(plate))


def _as_of_a_file(value: Any) -> Any:
    """Python or numpy values as TOML types: tables, lists and single values."""
    if isinstance(value, Mapping):
        return {key: _as_of_a_file(inner) for key, inner in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    return [_as_of_a_file(inner) for inner in value] if isinstance(value, list | tuple) else value


def read_specimen(path_or_name: str, heads: Sequence[str] = ()) -> Specimen:
    """Read a plate file, or take a built-in specimen by its name.

    heads : headings of the columns of frequencies in its table, as if [measurement.columns] named them
    A file that has the name of a built-in specimen is reached as "./NAME". Raises ``PlateFileError`` with
    all problems of the file at once.
    """
    if path_or_name in builtin_names():
        return builtin(path_or_name)
    source = path_or_name if path_or_name.isprintable() and path_or_name else received(path_or_name)
    try:
        content = read_regular_file(path_or_name, source, "a plate file or a built-in specimen")
    except FileNotFoundError:
        raise PlateFileError(_unknown_name(path_or_name, source)) from None
    path = Path(path_or_name)
    try:
        text = decode(content, source)
        parse(text, source)
    except PlateFileError:
        if path.suffix.casefold() not in _OTHERS:
            raise
        raise PlateFileError(f"{source}: no plate file, received {path.suffix}, {_PLATE_FILE}") from None
    return parse_specimen(text, source, path.parent, heads)


# Suffixes of files that are no plate file, whatever is in them.
_OTHERS: Final = (
    *(".csv", ".xlsx", ".xls", ".ods", ".pdf", ".doc", ".docx", ".json", ".yaml", ".yml", ".png", ".jpg"),
    *(".wav", ".unv", ".uff", ".nc", ".msh", ".inp"),
)
_PLATE_FILE: Final = (
    'accepted: a TOML text, as `cpam-bayes new FILE` writes; a list of frequencies is its table = "FILE"'
)


def _unknown_name(name: str, source: str) -> str:
    beside = nearest_file(Path(name))
    if beside:
        return f"{source}: no such file, the nearest there is {beside}"
    names = builtin_names()
    folded = {known.casefold(): known for known in names}
    close = difflib.get_close_matches(name.casefold(), folded, n=3, cutoff=0.5)
    nearest = [folded[match] for match in close]
    hint = f"the nearest built-in: {' '.join(nearest)}" if nearest else f"built in: {' '.join(names)}"
    return f"{source}: neither a file nor a built-in specimen, {hint}"


def builtin_names() -> tuple[str, ...]:
    """Names of the built-in specimens, as in the paper."""
    return _NAMES


def builtin(name: str, sequence: bool = False) -> Specimen:
    """A built-in specimen: Tables 1 to 4 as printed, bounds of eq. (8).

    sequence : with the unknown angles of Table 9(b)
    raises ValueError for a name that is not in `builtin_names`
    """
    if name not in _NAMES:
        raise ValueError(f"built-in specimen: received {name!r}, accepted: {' '.join(_NAMES)}")
    specimen = parse_specimen(builtin_text(name), f"built-in {name}")
    return specimen.with_unknown_angles() if sequence else specimen


def builtin_text(name: str) -> str:
    """The plate file of a built-in specimen."""
    resource = files("cpam_bayes") / "data" / "specimens" / f"{name.replace('&', '_and_')}.toml"
    return resource.read_text(encoding="utf-8")


def builtin_plates() -> tuple[Specimen, ...]:
    """The specimens of the paper, as `read_plate` gives each by its name.

    Examples
    --------
    >>> import cpam_bayes as cb
    >>> [plate.name for plate in cb.builtin_plates()][:5]
    ['D&G', 'A1', 'A2', 'B1', 'B2']
    """
    return tuple(builtin(name) for name in builtin_names())


def parse_specimen(
    text: str, source: str, directory: Path | None = None, heads: Sequence[str] = ()
) -> Specimen:
    """Read the text of a plate file.

    source : name of the file in messages
    directory : base of its relative paths
    heads : as in `read_specimen`
    raises PlateFileError with all problems, each with file, line and key
    """
    data = parse(text, source)
    if not data:
        raise PlateFileError(f"{source}: nothing is in it, {_PLATE_FILE}")
    return _checked_specimen(data, source, directory, line_numbers(text), heads)


def _checked_specimen(
    data: Mapping[str, Any],
    source: str,
    directory: Path | None,
    lines: Mapping[KeyPath, int],
    heads: Sequence[str] = (),
) -> Specimen:
    """Check the content of a plate file; arguments and errors as `parse_specimen`.

    lines : line of each key, empty for content that was not read from a text
    """
    data, misspelt = respelt(understood(data))
    if heads:
        columns = {**table(data, "measurement", "columns"), "hz": list(heads)}
        data = {**data, "measurement": {**table(data, "measurement"), "columns": columns}}
    data, former, of_former = _with_former(data, directory)
    file, problems = validated(data)
    measured, file_problems = _measured(data, directory)
    guessed = any(path[0] == "plate" and len(path) > 1 for path in misspelt)
    problems += relation_problems(data, directory, sizes_known=not guessed) + file_problems
    if of_former:  # what [material] lacks is what they were to tell
        told = (p.path[0] == "material" and (p.is_gap or p.path[-1] == "symmetry") for p in problems)
        problems = [p for p, is_told in zip(problems, told, strict=True) if not is_told] + of_former
    # a value under a misspelt key is often in another unit, or of another kind
    problems = [p for p in (problem.under(misspelt) for problem in problems) if p.path not in misspelt]
    problems += [
        Problem(path, f"unknown key, the nearest known key is {key}").under(misspelt)
        for path, key in misspelt.items()
    ]
    if file is None or problems:
        raise plate_file_error(source, problems, lines)
    return _specimen(file, source, directory, measured, former)


def _with_former(
    data: dict[str, Any], directory: Path | None
) -> tuple[dict[str, Any], Mapping[str, FormerPriors], list[Problem]]:
    """The file completed from former posteriors, see `with_former_posteriors`."""
    material = table(data, "material")
    if not any("posterior" in part for part in (material, *material.values()) if isinstance(part, dict)):
        return data, {}, []
    from cpam_bayes.plate.stored_posterior import with_former_posteriors  # for these plates alone

    return with_former_posteriors(data, directory)


def _measured(data: Mapping[str, Any], directory: Path | None) -> tuple[Mapping[str, Any], list[Problem]]:
    """Fields of `Measurement` from the file that [measurement] names, and its problems."""
    measurement = table(data, "measurement")
    fields: Mapping[str, Any] = {}
    problems: list[Problem] = []
    if measurement.get("table"):
        from cpam_bayes.plate.modes_of_hits import table_of  # for plates with a table alone

        of_table, problems = table_of(data, directory)
        fields = {} if of_table is None else of_table.fields(str(measurement["table"]))
    if measurement.get("recordings") or measurement.get("peaks"):
        from cpam_bayes.plate.modal_analysis.peaks import candidates_of  # for plates with peaks alone

        fields, problems = candidates_of(data, directory)
    if measurement.get("shapes"):
        from cpam_bayes.plate.instruments import shapes_of  # for plates with a universal file alone

        of_shapes, of_file = shapes_of(data, directory)
        problems = problems + of_file
        fields = fields if of_shapes is None else of_shapes.fields(str(measurement["shapes"]))
    listed = fields.get("frequencies", measurement.get("frequencies_hz"))
    return fields, [*problems, *_rows_by_hand(measurement, listed)]


def _rows_by_hand(measurement: Mapping[str, Any], listed: object) -> Iterator[Problem]:
    """Row numbers beyond the list, and lists of which nothing is left."""
    if not isinstance(listed, list | np.ndarray) or not len(listed):
        return
    for key in ("left_out", "by_hand"):
        given = measurement.get(key)
        rows = [row for row in given if isinstance(row, int)] if isinstance(given, list) else []
        if any(row > len(listed) for row in rows):
            what = f"received {max(rows)}, accepted: 1 to {len(listed)}, the numbers of the frequencies"
            yield Problem(("measurement", key), what)
        elif key == "left_out" and len(set(rows)) == len(listed):
            yield Problem(("measurement", key), "all frequencies, accepted: at least one is left")


def _specimen(
    file: PlateFile,
    source: str,
    directory: Path | None,
    measured: Mapping[str, Any],
    former: Mapping[str, FormerPriors],
) -> Specimen:
    """The records of a file that passed every check.

    measured : fields of `Measurement` from another file; former : priors from former posteriors, by material
    """
    kinds = ply_kinds(file.model_dump(exclude_none=True)) or {}
    sequence_layup = file.plate.sequence_layup
    return Specimen(
        name=file.name,
        specimen=file.specimen or file.name,
        source=source,
        plate=_plate(file.plate, kinds, directory),
        material=_materials(file.material),
        unknowns=_unknowns(file.unknowns, former),
        angle_grid_deg=float(file.unknowns.angle_grid_deg),
        air_density=file.environment.air_density_kg_m3,
        sensors=tuple(_sensor(sensor) for sensor in file.sensor),
        measurement=None if file.measurement is None else _measurement(file.measurement, measured),
        notes=tuple(file.notes),
        certificate=tuple(
            (key, str(getattr(file, key)))
            for key in ("laboratory", "operator", "date")
            if getattr(file, key) is not None
        ),
        sequence_layup=None if sequence_layup is None else parse_layup(sequence_layup, kinds),
    )


def _plate(model: PlateModel, kinds: Mapping[str, PlyKind], directory: Path | None) -> Plate:
    length = to_si("length_mm", model.length_mm)
    width = to_si("width_mm", model.width_mm)
    thickness = to_si("thickness_mm", model.thickness_mm)
    mass = None if model.mass_g is None else to_si("mass_g", model.mass_g)
    layup = parse_layup(model.layup or _ISOTROPIC_LAYUP, kinds)
    sd = {} if model.sd is None else _in_si(model.sd.model_dump(exclude_none=True))
    thicknesses = None
    if mass is not None and model.density_kg_m3 is not None:
        stated = {"thickness": thickness, "length": length, "width": width, "mass": mass}
        thicknesses = _thicknesses({**stated, "density": float(model.density_kg_m3)}, sd)
        thickness, sd = _mean_thickness(thicknesses, sd)
    if mass is not None:
        density = mass / (length * width * thickness)
    elif model.density_kg_m3 is not None:
        density = float(model.density_kg_m3)
    else:
        density = _mean_density(layup)
    return Plate(
        length=length,
        width=width,
        thickness=thickness,
        density=density,
        mass=mass,
        layup=layup,
        edges=model.edges,
        sd=sd,
        mesh=None if model.mesh is None else (directory or Path()) / model.mesh,
        thicknesses=thicknesses,
    )


def _thicknesses(
    stated: Mapping[str, float], sd: Mapping[str, float]
) -> tuple[tuple[float, float], tuple[float, float]]:
    """The gauged thickness and m / (rho a b), each with its standard deviation, m."""
    relative = {name: sd[name] / value if name in sd else USUAL_SD[name] for name, value in stated.items()}
    gauged = stated["thickness"]
    own = relative.pop("thickness") * gauged
    by_mass = stated["mass"] / (stated["density"] * stated["length"] * stated["width"])
    return (gauged, own), (by_mass, by_mass * math.hypot(*relative.values()))


def _mean_thickness(
    each: tuple[tuple[float, float], tuple[float, float]], sd: Mapping[str, float]
) -> tuple[float, dict[str, float]]:
    """The thickness of a plate with given mass and density, m, and the plate's standard deviations.

    The mean of both thicknesses weighted by their precisions. Its standard deviation is multiplied by their
    distance in standard deviations where that is above one (Birge's ratio of two values): one of them is
    wrong then. The density follows from the weighed mass and has no standard deviation of its own.
    """
    (gauged, own), (by_mass, other) = each
    weight = other**2 / (own**2 + other**2) if own > 0.0 else 1.0
    kept = {name: value for name, value in sd.items() if name != "density"}
    kept["thickness"] = own * math.sqrt(weight) * max(sds_apart(*each), 1.0)
    return weight * gauged + (1.0 - weight) * by_mass, kept


def _mean_density(layup: Layup) -> float:
    """Mass of the plies over their thickness, kg/m3."""
    mass = sum((kind.density or 0.0) * kind.thickness for kind in layup.kinds)
    return mass / sum(kind.thickness for kind in layup.kinds)


def _materials(model: MaterialModel | dict[str, MaterialModel]) -> Material | Hybrid:
    if isinstance(model, MaterialModel):
        return _material(model)
    return Hybrid({name: _material(part) for name, part in model.items()})


def _material(model: MaterialModel) -> Material:
    given = model.model_dump(exclude_none=True)
    symmetry = symmetry_of(given)
    assert symmetry is not None
    known = model.known is not False
    return Material(
        symmetry=symmetry,
        constants=_in_si({key: value for key, value in given.items() if key in CONSTANT_KEYS}),
        sd={} if model.sd is None or not known else _in_si(model.sd.model_dump(exclude_none=True)),
        name=model.name,
        known=known,
    )


def _unknowns(model: UnknownsModel | HybridUnknownsModel, former: Mapping[str, FormerPriors]) -> ParameterSet:
    if isinstance(model, UnknownsModel):
        return ParameterSet(_parameters(model, "", former.get("", {})))
    parts = (model.__pydantic_extra__ or {}).items()
    each = (_parameters(part, material, former.get(material, {})) for material, part in parts)
    return ParameterSet(tuple(itertools.chain.from_iterable(each)))


def _parameters(model: ConstantsModel, material: str, former: FormerPriors) -> tuple[Parameter, ...]:
    parameters = []
    for user in type(model).model_fields:
        prior = getattr(model, user)
        if user in USER_UNITS and prior is not None:
            name, factor = USER_UNITS[user]
            unit = "Pa" if factor != 1.0 else ""
            density, coupled = former.get(user) or (_prior(user, prior), None)
            if coupled is not None and material:
                coupled = replace(coupled, group=f"{coupled.group}, {material}")
            parameters.append(Parameter(joined_name(material, name), unit, density, coupled=coupled))
    return tuple(parameters)


def _prior(user: str, model: list[float] | NormalModel) -> Prior:
    if isinstance(model, NormalModel):
        lower, upper = (to_si(user, bound) for bound in model.bounds)
        return TruncatedNormal(to_si(user, model.mean), to_si(user, model.sd), lower, upper)
    lower, upper = (to_si(user, bound) for bound in model)
    return Uniform(lower, upper)


def _sensor(model: SensorModel) -> Sensor:
    return Sensor(to_si("mass_g", model.mass_g), to_si("x_mm", model.x_mm), to_si("y_mm", model.y_mm))


def _measurement(model: MeasurementModel, measured: Mapping[str, Any]) -> Measurement:
    sd, listed = model.frequency_sd_hz, model.frequencies_hz or []
    keys = {"missed_probability": "missed_probability", "false_peaks": "false_peaks"}
    keys["scale_sd"] = "frequency_scale_sd"
    given_keys = {name: getattr(model, key) for name, key in keys.items()}
    stated: dict[str, Any] = {name: float(v) for name, v in given_keys.items() if v is not None}
    given = Measurement(
        frequencies=np.array(listed, dtype=float),
        resolution=float(model.resolution_hz),
        relative_std=model.relative_std,
        frequency_sd=None if sd is None else np.array(sd, dtype=float),
        labels=tuple(model.labels or ("",) * len(listed)),
        complete=model.complete,
    )
    whole = replace(given, **stated, **measured)
    std = model.relative_std or 0.0
    if std > _MUCH_SCATTER:
        much = f"relative_std = {std:g} is {100 * std:g} % of a frequency, where taps repeat to 0.02 to 1 %"
        whole = replace(whole, remarks=(*whole.remarks, f"{much}; 0.2 % is 0.002"))
    if not (model.left_out or model.by_hand):
        return whole
    listed_hz = whole.frequencies
    recording = f" to those of {model.picked_from}" if model.picked_from else ""
    said = tuple(
        f"frequency {row} of the list, {listed_hz[row - 1]:.10g} Hz, was {done} by hand"
        for rows, done in ((model.left_out, "left out"), (model.by_hand, f"added{recording}"))
        for row in sorted(set(rows))
    )
    used = whole.without({row - 1 for row in model.left_out}) if model.left_out else whole
    return replace(used, remarks=(*whole.remarks, *said))


def _in_si(values: dict[str, float]) -> dict[str, float]:
    return {USER_UNITS[user][0]: to_si(user, value) for user, value in values.items()}
