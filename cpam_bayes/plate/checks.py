"""Checks of relations between values of a plate file, on the raw tables.

Each check skips values that are missing or of the wrong type, which the schema reports, so that one reading
finds every error.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Final, cast

import numpy as np

from cpam_bayes.errors import LayupError
from cpam_bayes.plate.laminate import CONSTRAINTS, MaterialSymmetry, constraint_violations, is_admissible
from cpam_bayes.plate.layup import Layup, PlyKind, parse_layup
from cpam_bayes.plate.records import USER_UNITS, angle_grid, to_si, user_name
from cpam_bayes.plate.schema import MAX_FREQUENCIES, NAME, PlateModel, is_hybrid
from cpam_bayes.plate.text import MAX_SHOWN, Data, Problem, Problems, number, numbers, real, received, table

CONSTANT_KEYS: Final = ("E1_GPa", "E2_GPa", "nu12", "G12_GPa", "G13_GPa", "G23_GPa")
_REQUIRED: Final = CONSTANT_KEYS[:4]
_ISOTROPIC: Final = ("E1_GPa", "nu12")
_GRID_POINTS: Final = 7
# The symmetry of a material with the constants of a composite and no stated symmetry.
_COMPOSITE: Final[MaterialSymmetry] = "transversely_isotropic"
# Advice on constants that violate eq. (9) but suit other plies.
_OTHER_SYMMETRY: Final = 'fabrics, wood and plywood are symmetry = "orthotropic"'
# No solid is lighter or heavier, foams and heavy metals included, kg/m3; no fibre is stiffer, GPa.
_DENSITIES: Final = (5.0, 25_000.0)
_MAX_MODULUS: Final = 2000.0
# A pair may be equal, and a third frequency by rounding; more equal ones are one mode.
_EQUAL_AT_MOST: Final = 3
# Below this mass, g, the plate's own numbers are wrong, and are reported instead.
_LIGHTEST: Final = 1e-6
# Tolerance of the sum of the plies, as a fraction of the stated thickness; they are scaled to fill it.
_THICKNESS_TOLERANCE: Final = 0.01
SOURCES: Final = ("frequencies_hz", "table", "recordings", "peaks", "shapes")
"""Keys of [measurement], exactly one of which gives the source of the frequencies."""
_BESIDE_PEAKS: Final = {
    "frequency_sd_hz": "beside candidate peaks, which have their own, accepted: relative_std",
    "labels": "beside candidate peaks, accepted: no labels",
    "false_peaks": "beside candidate peaks, whose heights tell it, accepted: missed_probability",
}
_BESIDE: Final[Mapping[str, Mapping[str, str]]] = {
    "table": {
        "frequency_sd_hz": "beside a table, accepted: a column sd in the table instead",
        "labels": "beside a table, accepted: a column label in the table instead",
    },
    "recordings": _BESIDE_PEAKS,
    "peaks": _BESIDE_PEAKS,
    "shapes": {
        "frequency_sd_hz": "beside shapes, accepted: relative_std or resolution_hz",
        "labels": "beside shapes, which say what mode a frequency is, accepted: no labels",
        "left_out": "beside shapes, accepted: a universal file without that mode",
    },
}

_Check = Callable[[Data], Problems]


def relation_problems(data: Data, directory: Path | None, *, sizes_known: bool = True) -> list[Problem]:
    """All relations that a file violates.

    directory : base of its relative paths; sizes_known : false where keys of [plate] are guessed, perhaps in
        another unit
    """
    problems = [problem for check in _CHECKS for problem in check(data)]
    of_sizes = [problem for check in _CHECKS_OF_SIZES for problem in check(data)]
    # at the sensors a wrong size or mass would only be reported a second time
    of_sizes = of_sizes or [problem for check in (_sensors, _heavy_sensors) for problem in check(data)]
    problems += of_sizes if sizes_known else []
    problems += [
        problem.of_material(name)
        for check in _CHECKS_OF_A_MATERIAL
        for name, part in _per_material(data)
        for problem in check(part)
    ]
    return problems + list(_mesh(data, directory))


def _per_material(data: Data) -> Iterator[tuple[str, Data]]:
    """The file with each material as its only one, by name; "" and the file where there is only one."""
    material = data.get("material")
    if not is_hybrid(material):
        yield "", data
        return
    for name, part in table(data, "material").items():
        yield name, {**data, "material": part, "unknowns": table(data, "unknowns", name)}


# [material] and [unknowns]


def symmetry_of(material: Data) -> MaterialSymmetry | None:
    """The symmetry that a table [material] states or, by its constants, implies; None if it does neither."""
    stated, isotropic = material.get("symmetry"), material.get("isotropic")
    if stated is not None:
        return cast(MaterialSymmetry, stated) if stated in tuple(CONSTRAINTS) else None
    if isotropic is True:
        return "isotropic"
    implied = isotropic is False or (isotropic is None and ("E2_GPa" in material or "G12_GPa" in material))
    return _COMPOSITE if implied else None


def _known_symmetry(data: Data) -> Problems:
    """Problems with the symmetry of [material], which must be stated once."""
    material = table(data, "material")
    if not material:
        return
    stated, isotropic = material.get("symmetry"), material.get("isotropic")
    if stated is None and isotropic is None and symmetry_of(material) is None:
        yield Problem(
            ("material", "symmetry"),
            'missing, accepted: "isotropic" beside E1_GPa and nu12, or E2_GPa and G12_GPa of a composite',
        )
    contradicts = isinstance(isotropic, bool) and isotropic != (stated == "isotropic")
    if stated in tuple(CONSTRAINTS) and contradicts:
        yield Problem(
            ("material", "isotropic"),
            f"contradicts symmetry, received {received(isotropic)} beside {received(stated)}, "
            "accepted: symmetry alone",
        )


def _constants_of_symmetry(data: Data) -> Problems:
    """Constants that a material of this symmetry does not have, or lacks."""
    material, unknowns = table(data, "material"), table(data, "unknowns")
    symmetry = symmetry_of(material)
    if symmetry == "isotropic":
        for path, given in (
            (("material",), material),
            (("material", "sd"), table(data, "material", "sd")),
            (("unknowns",), unknowns),
        ):
            for key in given:
                if key in CONSTANT_KEYS and key not in _ISOTROPIC:
                    yield Problem(
                        (*path, key),
                        f"not a constant of an isotropic material, received "
                        f"{received(given[key])}, accepted: E1_GPa and nu12 only, eq. (11)",
                    )
    elif symmetry is not None:
        for key in _REQUIRED:
            if key not in material and key not in _ISOTROPIC:
                yield Problem(
                    ("material", key),
                    f"missing, a ply that is {symmetry.replace('_', ' ')} has E1 E2 nu12 G12",
                    is_gap=True,
                )


def _reference(data: Data) -> tuple[dict[str, float], MaterialSymmetry] | None:
    """The reference constants and their symmetry; None unless all are given and the moduli positive."""
    material = table(data, "material")
    symmetry = symmetry_of(material)
    if symmetry is None:
        return None
    wanted = _ISOTROPIC if symmetry == "isotropic" else CONSTANT_KEYS
    constants: dict[str, float] = {}
    for key in wanted:
        value = number(material, key)
        if value is None and (key in material or key in _REQUIRED):
            return None
        if value is not None:
            constants[USER_UNITS[key][0]] = value
    moduli_positive = all(value > 0.0 for name, value in constants.items() if name != "nu12")
    possible = moduli_positive and (constants["nu12"] != 1.0 or symmetry == "orthotropic")
    return (constants, symmetry) if possible else None


def _physical_material(data: Data) -> Problems:
    """Reference constants that their symmetry does not allow."""
    material = table(data, "material")
    if number(material, "nu12") == 1.0 and symmetry_of(material) == _COMPOSITE:
        yield Problem(("material", "nu12"), f"impossible constants, accepted: {CONSTRAINTS[_COMPOSITE][1]}")
    reference = _reference(data)
    if reference is None:
        return
    constants, symmetry = reference
    broken = np.flatnonzero(constraint_violations(constants, symmetry))
    if broken.size:
        said = ", ".join(f"{user_name(name)} = {value:g}" for name, value in constants.items())
        accepted = CONSTRAINTS[symmetry][int(broken[-1])]
        fits = symmetry == _COMPOSITE and bool(is_admissible(constants, "orthotropic"))
        hint = f"; {_OTHER_SYMMETRY}" if fits else ""
        key = "E1_GPa" if 3 in broken else "nu12"
        yield Problem(("material", key), f"impossible constants, received {said}, accepted: {accepted}{hint}")


def _search_bounds(data: Data) -> Problems:
    """Bounds and priors that are reversed, not physical, or at odds with each other."""
    unknowns = table(data, "unknowns")
    orthotropic = symmetry_of(table(data, "material")) == "orthotropic"
    boxes: dict[str, tuple[float, float]] = {}
    for key in CONSTANT_KEYS:
        prior = unknowns.get(key)
        normal = prior if isinstance(prior, dict) else None
        bounds = numbers(normal, "bounds") if normal is not None else numbers(unknowns, key)
        if bounds is None or len(bounds) != 2:
            continue
        lower, upper = bounds
        path = ("unknowns", key, "bounds") if normal is not None else ("unknowns", key)
        if not lower < upper:
            yield Problem(path, f"bounds, received {received(bounds)}, accepted: [lower, upper] ascending")
            continue
        if key == "nu12" and not (-1.0 < lower < upper < 1.0 or orthotropic):
            yield Problem(path, f"not physical, received {received(bounds)}, accepted: within -1 and 1")
            continue
        if key != "nu12" and lower <= 0.0:
            yield Problem(path, f"not physical, received {received(bounds)}, accepted: bounds above 0")
            continue
        mean = number(normal, "mean") if normal is not None else None
        if mean is not None and not lower <= mean <= upper:
            yield Problem(
                ("unknowns", key, "mean"),
                f"outside the bounds, received {mean:g}, accepted: {lower:g} to {upper:g}",
            )
        boxes[key] = (lower, upper)
    # A bound or a reference that is wrong by itself would only be reported a second time.
    if boxes.keys() == {key for key in CONSTANT_KEYS if key in unknowns}:
        yield from _possible_box(data, boxes)


def _possible_box(data: Data, boxes: Mapping[str, tuple[float, float]]) -> Problems:
    """Search boxes without any point, on a grid, that meets the constraints."""
    reference = _reference(data)
    if reference is None or not boxes:
        return
    constants, symmetry = reference
    if not is_admissible(constants, symmetry):
        return
    searched = [key for key in ("E1_GPa", "E2_GPa", "nu12") if key in boxes]
    if symmetry == "isotropic":
        searched = [key for key in searched if key in _ISOTROPIC]
    if not searched:
        return
    axes = [np.linspace(*boxes[key], _GRID_POINTS) for key in searched]
    grids = np.meshgrid(*axes, indexing="ij")
    trial: dict[str, Any] = dict(constants) | {
        USER_UNITS[key][0]: grid for key, grid in zip(searched, grids, strict=True)
    }
    if not is_admissible(trial, symmetry).any():
        said = ", ".join(f"{key} {boxes[key][0]:g} to {boxes[key][1]:g}" for key in searched)
        allowed = {_COMPOSITE: "bounds that eq. (9) does not rule out"}
        accepted = allowed.get(symmetry, f"bounds with {CONSTRAINTS[symmetry][0]}")
        hint = f"; {_OTHER_SYMMETRY}" if symmetry == _COMPOSITE else ""
        yield Problem(
            ("unknowns", searched[-1]),
            f"no physical constants within the bounds, received {said}, accepted: {accepted}{hint}",
        )


def _possible_moduli(data: Data) -> Problems:
    """Moduli that are too large for GPa, most likely in MPa or Pa."""
    material, unknowns = table(data, "material"), table(data, "unknowns")
    moduli = [name for name in USER_UNITS if name.endswith("_GPa")]
    given: list[tuple[str, str, float | None]] = [("material", key, number(material, key)) for key in moduli]
    for key in moduli:
        prior = unknowns.get(key)
        bounds = numbers(prior, "bounds") if isinstance(prior, dict) else numbers(unknowns, key)
        given.append(("unknowns", key, min(bounds, default=None) if bounds else None))
    large = [(name, key, value) for name, key, value in given if value is not None and value > _MAX_MODULUS]
    if large:
        said = ", ".join(f"{key} {value:g}" for _, key, value in large[:MAX_SHOWN])
        value = large[0][2]
        unit, factor = ("Pa", 1e9) if value > _MAX_MODULUS * 1e3 else ("MPa", 1e3)
        yield Problem(
            large[0][:2],
            f"stiffer than any material, received {said}, accepted: up to {_MAX_MODULUS:g} GPa; {value:g} "
            f"{unit} are {value / factor:g} GPa",
        )


def _grid_step(data: Data) -> Problems:
    step = number(table(data, "unknowns"), "angle_grid_deg")
    if step is None or not 0.0 < step <= 180.0:
        return
    try:
        angle_grid(step)
    except ValueError:
        yield Problem(
            ("unknowns", "angle_grid_deg"),
            f"not a grid, received {step:g}, accepted: a step that divides 180, 0.1 or more",
        )


def _spreads(data: Data, name: str) -> Problems:
    given = table(data, name)
    known = " ".join(key for key in given if key in USER_UNITS)
    for key in table(data, name, "sd"):
        if key in USER_UNITS and key not in given:
            yield Problem(
                (name, "sd", key),
                f"standard deviation of a number that [{name}] does not give, accepted: {known or 'none'}",
            )


# [plate]: sizes, mass and density


def _one_density(data: Data) -> Problems:
    """Densities that are missing, incomplete, or given twice."""
    plate, hybrid = table(data, "plate"), is_hybrid(data.get("material"))
    if not isinstance(data.get("plate"), dict):
        return
    given = [key for key in ("density_kg_m3", "mass_g") if key in plate]
    with_density = [name for name, part in _per_material(data) if "density_kg_m3" in table(part, "material")]
    if with_density and not hybrid:
        yield Problem(
            ("material", "density_kg_m3"), "of one material, accepted: density_kg_m3 or mass_g in [plate]"
        )
    elif with_density:
        for name in table(data, "material"):
            if name not in with_density:
                yield Problem(
                    ("material", name, "density_kg_m3"),
                    "missing, accepted: a density of each material, or of none",
                )
        if "density_kg_m3" in plate:
            yield Problem(
                ("plate", "density_kg_m3"),
                "beside densities of the materials, accepted: these, with mass_g where the plate was weighed",
            )
        return
    if not given and plate.keys() <= PlateModel.model_fields.keys():  # else one of the others was meant
        accepted = "accepted: density_kg_m3, mass_g, or both"
        yield Problem(("plate",), f"density, received neither, {accepted}", is_gap=True)


def _density(data: Data, owner: str) -> Problems:
    """Densities that no solid has, most likely in another unit."""
    low, high = _DENSITIES
    density = number(table(data, owner), "density_kg_m3")
    if density is not None and density > 0.0 and not low <= density <= high:
        likely = f"; {density:g} g/cm3 are {1e3 * density:g} kg/m3" if density < low else ""
        yield Problem(
            (owner, "density_kg_m3"),
            f"no density of a solid, received {density:g}, accepted: {low:g} to {high:g} kg/m3{likely}",
        )


def _possible_mass(data: Data) -> Problems:
    """Masses and sizes that give a density no solid has, most likely in another unit."""
    plate = table(data, "plate")
    low, high = _DENSITIES
    mass = number(plate, "mass_g")
    accepted = f"accepted: {low:g} to {high:g} kg/m3"
    sizes = [number(plate, key) for key in ("length_mm", "width_mm", "thickness_mm")]
    if mass is None or mass <= 0.0 or plate.get("mesh") is not None:
        return
    known = [size for size in sizes if size is not None and size > 0.0]
    if len(known) < len(sizes):
        return
    made = 1e6 * mass / math.prod(known)  # g/mm3 to kg/m3
    if not low <= made <= high:
        likely = (
            f"is the mass in kg? {mass:g} kg are {1e3 * mass:g} g" if made < low else "are the sizes in mm?"
        )
        yield Problem(
            ("plate", "mass_g"),
            f"no mass of this plate, received {mass:g}, which makes {made:.3g} kg/m3, {accepted}; {likely}",
        )


def _thin(data: Data) -> Problems:
    plate = table(data, "plate")
    thickness = number(plate, "thickness_mm")
    sides = [number(plate, key) for key in ("length_mm", "width_mm")]
    shortest = min((side for side in sides if side is not None), default=None)
    if thickness is not None and shortest is not None and thickness >= shortest > 0.0:
        yield Problem(
            ("plate", "thickness_mm"),
            f"not a plate, received {thickness:g}, accepted: below length_mm and width_mm",
        )


def _mesh(data: Data, directory: Path | None) -> Problems:
    mesh = table(data, "plate").get("mesh")
    if not isinstance(mesh, str) or not mesh:
        return
    path = Path(mesh) if directory is None else directory / mesh
    try:
        exists = path.is_file()
    except (OSError, ValueError):
        exists = False
    if not exists:
        yield Problem(
            ("plate", "mesh"),
            f"no such file, received {received(mesh)}, accepted: a path from the plate file",
        )


# [[ply]] and the layup


def ply_kinds(data: Data) -> dict[str, PlyKind] | None:
    """The plies of the tables [[ply]] by name, None where any of them is invalid."""
    kinds: dict[str, PlyKind] = {}
    densities = {name: number(table(part, "material"), "density_kg_m3") for name, part in _per_material(data)}
    for ply in _ply_tables(data):
        name, thickness, material = ply.get("name"), number(ply, "thickness_mm"), ply.get("material", "")
        if not isinstance(name, str) or not re.fullmatch(NAME, name) or name in kinds:
            return None
        if not isinstance(material, str) or material not in densities:
            return None
        if thickness is None or thickness <= 0.0:
            return None
        kinds[name] = PlyKind(name, material, to_si("thickness_mm", thickness), densities.get(material))
    return None if is_hybrid(data.get("material")) and not kinds else kinds


def _ply_tables(data: Data) -> list[Data]:
    plies = data.get("ply")
    return [ply for ply in plies if isinstance(ply, dict)] if isinstance(plies, list) else []


def _known_plies(data: Data) -> Problems:
    """Duplicate names of plies, and plies of unknown materials."""
    plies, hybrid = _ply_tables(data), is_hybrid(data.get("material"))
    names = [ply.get("name") for ply in plies]
    materials = list(table(data, "material")) if hybrid else []
    for i, ply in enumerate(plies):
        material = ply.get("material")
        if names[i] is not None and names[i] in names[:i]:
            yield Problem(
                ("ply", i, "name"), f"received {received(names[i])} twice, accepted: a name for each"
            )
        if material is not None and not hybrid:
            yield Problem(
                ("ply", i, "material"), "beside one [material], accepted: nothing; it is of that one"
            )
        elif hybrid and material not in materials:
            said = "missing" if material is None else f"no table [material.{material}]"
            yield Problem(("ply", i, "material"), f"{said}, accepted: {' '.join(materials)}")


def _materials_of_plies(data: Data) -> Problems:
    """Several materials without plies, and materials and unknowns that are not in the layup."""
    material, unknowns = data.get("material"), table(data, "unknowns")
    if not is_hybrid(material):
        if is_hybrid(data.get("unknowns")):
            yield Problem(
                ("unknowns",), "tables for several materials beside one [material], accepted: its constants"
            )
        return
    materials = table(data, "material")
    if not _ply_tables(data):
        yield Problem(
            ("material",),
            f"several materials, received {' '.join(materials)}, accepted: with a table [[ply]] for each "
            "ply that the layup names: name, material, thickness_mm",
        )
    elif table(data, "plate").get("layup") is None:
        yield Problem(
            ("plate", "layup"), 'missing, accepted: a layup of named plies such as "[(c0/g45)_4]_s"'
        )
    for name in unknowns:
        if name != "angle_grid_deg" and name not in materials:
            yield Problem(
                ("unknowns", name),
                f"of no material, received {received(name)}, accepted: tables [unknowns.NAME] with NAME one "
                f"of {' '.join(materials)}",
            )
    used = {kind.material for kind in _plies_of_layup(data)}
    for name in materials if used else ():
        if name not in used:
            yield Problem(
                ("material", name), "no ply of the layup is of it, accepted: materials of the plate"
            )


def _stated_thickness(data: Data) -> Problems:
    """Plies that do not add up to the thickness of the plate."""
    stated = number(table(data, "plate"), "thickness_mm")
    made = 1e3 * sum(kind.thickness for kind in _plies_of_layup(data))
    if stated is None or not made or abs(made / stated - 1.0) <= _THICKNESS_TOLERANCE:
        return
    yield Problem(
        ("plate", "thickness_mm"),
        f"not the sum of the plies, received {stated:g}, the plies of the layup make {made:.5g} mm, "
        f"accepted: within {100.0 * _THICKNESS_TOLERANCE:g} %; correct thickness_mm, a [[ply]] or the layup",
    )


def _plies_of_layup(data: Data) -> tuple[PlyKind, ...]:
    """The plies of the layup, empty where it cannot be read or has no named plies."""
    kinds, text = ply_kinds(data), table(data, "plate").get("layup")
    if not kinds or not isinstance(text, str):
        return ()
    try:
        return parse_layup(text, kinds).kinds
    except LayupError:
        return ()


def _layups(data: Data) -> Problems:
    plate = table(data, "plate")
    if not isinstance(data.get("plate"), dict):
        return
    kinds = ply_kinds(data)
    if kinds is None:
        return
    known, problems = _layup(plate, "layup", kinds)
    yield from problems
    sequence, problems = _layup(plate, "sequence_layup", kinds)
    yield from problems
    if "layup" not in plate and symmetry_of(table(data, "material")) not in (None, "isotropic"):
        yield Problem(("plate", "layup"), 'missing, accepted: a layup such as "[(0/90)_8]_s"', is_gap=True)
    if sequence is not None and sequence.n_unknown == 0:
        yield Problem(
            ("plate", "sequence_layup"),
            f'no unknown angle, received {received(sequence.text)}, accepted: a layup with "?"',
        )
    if known is not None and sequence is not None and known.n_plies != sequence.n_plies:
        yield Problem(
            ("plate", "sequence_layup"),
            f"other number of plies, received {sequence.n_plies}, accepted: {known.n_plies} as in layup",
        )


def _layup(plate: Data, key: str, kinds: Mapping[str, PlyKind]) -> tuple[Layup | None, list[Problem]]:
    text = plate.get(key)
    if not isinstance(text, str):
        return None, []
    try:
        return parse_layup(text, kinds), []
    except LayupError as error:
        shown = str(error).replace("\n", "\n    ")
        return None, [Problem(("plate", key), f"malformed layup: {shown}")]


# [[sensor]]


def _sensors(data: Data) -> Problems:
    plate, sensors = table(data, "plate"), data.get("sensor")
    if not isinstance(sensors, list):
        return
    for i, sensor in enumerate(sensors):
        if not isinstance(sensor, dict):
            continue
        for key, side in (("x_mm", "length_mm"), ("y_mm", "width_mm")):
            place, extent = number(sensor, key), number(plate, side)
            if place is not None and extent is not None and place > extent > 0.0:
                yield Problem(
                    ("sensor", i, key),
                    f"outside the plate, received {place:g}, accepted: 0 to {extent:g}, the {side}",
                )
                break


def _heavy_sensors(data: Data) -> Problems:
    """Sensor masses that together exceed the plate's: in another unit, or not a plate test."""
    plate, sensors = table(data, "plate"), data.get("sensor")
    if not isinstance(sensors, list):
        return
    masses = [number(sensor, "mass_g") for sensor in sensors if isinstance(sensor, dict)]
    total = sum(mass for mass in masses if mass is not None and mass > 0.0)
    mass = _mass(plate)
    if mass is not None and total > mass > _LIGHTEST:
        yield Problem(
            ("sensor", len(masses) - 1, "mass_g"),
            f"heavier than the plate, received {total:g} in all, accepted: up to {mass:.4g}, the mass of the "
            "plate in g; check the units of the masses and of the plate",
        )


def _mass(plate: Data) -> float | None:
    """The mass of a plate, g; an upper limit for one with a mesh."""
    mass, density = number(plate, "mass_g"), number(plate, "density_kg_m3")
    sizes = [number(plate, key) for key in ("length_mm", "width_mm", "thickness_mm")]
    known = [size for size in sizes if size is not None and size > 0.0]
    if mass is not None or density is None or len(known) < len(sizes):
        return mass
    return 1e-6 * density * math.prod(known)  # kg/m3 mm3 to g


# [measurement]


def _one_list(data: Data) -> Problems:
    """Frequencies from no source or several, and keys that do not go with their source."""
    measurement = table(data, "measurement")
    if "measurement" not in data or not isinstance(data["measurement"], dict):
        return
    given = [key for key in SOURCES if key in measurement]
    if len(given) != 1:
        yield Problem(
            ("measurement", *given[1:2]),
            f"frequencies, received {' and '.join(given) or 'none'}, "
            f"accepted: one of {', '.join(SOURCES[:-1])} and {SOURCES[-1]}",
            is_gap=not given,
        )
    for key, sources in (("columns", ("table", "peaks")), ("range_hz", ("recordings",))):
        if key in measurement and not measurement.keys() & set(sources):
            named = " or ".join(sources)
            yield Problem(("measurement", key), f"beside no {named}, accepted: with {named} alone")
    for key, cure in _BESIDE.get(given[0], {}).items() if len(given) == 1 else ():
        if key in measurement:
            yield Problem(("measurement", key), cure)


def _frequencies(data: Data) -> Problems:
    measurement = table(data, "measurement")
    listed = measurement.get("frequencies_hz")
    if not isinstance(listed, list) or len(listed) > MAX_FREQUENCIES:
        return
    yield from _order([real(value) for value in listed])
    for key in ("frequency_sd_hz", "labels"):
        values = measurement.get(key)
        if isinstance(values, list) and len(values) != len(listed):
            yield Problem(
                ("measurement", key),
                f"wrong length, received {len(values)}, accepted: {len(listed)}, one for each frequency",
            )


def _below(known: list[tuple[int, float]], i: int) -> float:
    """The frequency two places before number i, or zero."""
    return known[i - 2][1] if i > 1 else 0.0


def _order(frequencies: list[float | None]) -> Problems:
    """The problem with a list that is not ascending, or repeats one frequency."""
    known = [(i, value) for i, value in enumerate(frequencies) if value is not None]
    down = [(i, a, b) for (_, a), (i, b) in itertools.pairwise(known) if b < a]
    if down:
        i, before, after = down[0]
        more = f", and at {len(down) - 1} more place{'s' if len(down) > 2 else ''}" if down[1:] else ""
        whole = len(down) == len(frequencies) - 1 and len(down) > 1
        rest = [value for j, value in known if j not in {at for at, _, _ in down}]
        cure = "; write the list the other way round" if whole else ""
        # 80,2, 146,3 is four numbers: the parts after the commas descend, below the first frequency
        if all(b < rest[0] and b == int(b) for _, _, b in down) and rest == sorted(rest) and not whole:
            pair = f"{before:g},{after:g}"
            cure = f"; are these decimal commas? {pair} is two numbers, write {pair.replace(',', '.')}"
        elif len(down) == 1 and before == int(before) and _below(known, i) <= before / 10.0 <= after:
            cure = f"; has {before:g} lost its decimal comma? {before / 10.0:g} would fit"
        yield Problem(
            ("measurement", "frequencies_hz", i),
            f"descending frequencies, received {after:g} after {before:g}{more}, accepted: ascending, equal "
            f"ones for a degenerate pair{cure}",
        )
    elif len(known) > _EQUAL_AT_MOST and known[0][1] == known[-1][1]:
        yield Problem(
            ("measurement", "frequencies_hz"),
            f"all {len(frequencies)} frequencies are equal, received {known[0][1]:g} each time, accepted: "
            "one frequency a mode; are these repeats of one mode?",
        )


def _incomplete(data: Data) -> Problems:
    measurement = table(data, "measurement")
    if measurement.get("complete") is False or "recordings" in measurement or "peaks" in measurement:
        return
    for key in ("missed_probability", "false_peaks"):
        if key in measurement:
            yield Problem(
                ("measurement", key),
                f"of a complete list, received {received(measurement[key])}, accepted: "
                "complete = false beside it",
            )


_CHECKS: Final[tuple[_Check, ...]] = (
    _one_density,
    partial(_spreads, name="plate"),
    _known_plies,
    _materials_of_plies,
    _layups,
    _stated_thickness,
    _grid_step,
    _one_list,
    _frequencies,
    _incomplete,
)
_CHECKS_OF_SIZES: Final[tuple[_Check, ...]] = (partial(_density, owner="plate"), _possible_mass, _thin)
_CHECKS_OF_A_MATERIAL: Final[tuple[_Check, ...]] = (
    partial(_density, owner="material"),
    _possible_moduli,
    partial(_spreads, name="material"),
    _known_symmetry,
    _constants_of_symmetry,
    _physical_material,
    _search_bounds,
)
