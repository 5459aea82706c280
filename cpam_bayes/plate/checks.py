"""What relates several values of a plate file, checked on the raw tables.

Each check leaves aside what is missing or of the wrong type, which the schema reports, so that one
reading finds every error.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Final

from cpam_bayes.errors import LayupError
from cpam_bayes.plate.constants import (
    constants_of_symmetry,
    known_symmetry,
    physical_material,
    search_bounds,
    symmetry_of,
)
from cpam_bayes.plate.layup import Layup, PlyKind, parse_layup
from cpam_bayes.plate.plies import (
    known_plies,
    materials_of_plies,
    one_density,
    ply_kinds,
    stated_thickness,
)
from cpam_bayes.plate.problems import Problem, received
from cpam_bayes.plate.raw import Data, Problems, number, numbers, per_material, real, table
from cpam_bayes.plate.records import angle_grid
from cpam_bayes.plate.schema import MAX_FREQUENCIES
from cpam_bayes.plate.units import USER_UNITS

# No solid is lighter or heavier, foams and heavy metals included, kg/m3; no fibre is stiffer, GPa.
_DENSITIES: Final = (5.0, 25_000.0)
_MAX_MODULUS: Final = 2000.0
# A pair may be equal, and a third frequency by chance of the rounding; more equal ones are one mode.
_EQUAL_AT_MOST: Final = 3
# Below this mass a plate's own numbers are wrong, which is said of them, g.
_LIGHTEST: Final = 1e-6

_Check = Callable[[Data], Problems]


def relation_problems(data: Data, directory: Path | None) -> list[Problem]:
    """Every relation that a file breaks; `directory` is where its relative paths begin."""
    problems = [problem for check in _CHECKS for problem in check(data)]
    problems += [
        problem.of_material(name)
        for check in _CHECKS_OF_A_MATERIAL
        for name, part in per_material(data)
        for problem in check(part)
    ]
    return problems + list(_mesh(data, directory))


def _density(data: Data, owner: str) -> Problems:
    """Densities of another unit."""
    low, high = _DENSITIES
    density = number(table(data, owner), "density_kg_m3")
    if density is not None and density > 0.0 and not low <= density <= high:
        likely = f"; {density:g} g/cm3 are {1e3 * density:g} kg/m3" if density < low else ""
        yield Problem(
            (owner, "density_kg_m3"),
            f"no density of a solid, received {density:g}, accepted: {low:g} to {high:g} kg/m3{likely}",
        )


def _possible_mass(data: Data) -> Problems:
    """Masses and sizes that make a density of another unit."""
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


def _possible_moduli(data: Data) -> Problems:
    """Moduli in MPa or Pa."""
    material, unknowns = table(data, "material"), table(data, "unknowns")
    for key in (name for name in USER_UNITS if name.endswith("_GPa")):
        value = number(material, key)
        if value is not None and value > _MAX_MODULUS:
            yield Problem(
                ("material", key),
                f"stiffer than any material, received {value:g}, accepted: up to {_MAX_MODULUS:g} GPa; "
                f"{value:g} MPa are {value / 1e3:g} GPa",
            )
        prior = unknowns.get(key)
        bounds = numbers(prior, "bounds") if isinstance(prior, dict) else numbers(unknowns, key)
        if bounds and min(bounds) > _MAX_MODULUS:
            yield Problem(
                ("unknowns", key),
                f"stiffer than any material, received {received(bounds)}, accepted: bounds in GPa, the lower "
                f"one up to {_MAX_MODULUS:g}; {min(bounds):g} MPa are {min(bounds) / 1e3:g} GPa",
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


def _spreads(data: Data, name: str) -> Problems:
    given = table(data, name)
    for key in table(data, name, "sd"):
        if key in USER_UNITS and key not in given:
            yield Problem(
                (name, "sd", key),
                f"standard deviation of a number that [{name}] does not give, "
                f"accepted: {_listed(k for k in given if k in USER_UNITS)}",
            )


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
        yield Problem(("plate", "layup"), 'missing, accepted: a layup such as "[(0/90)_8]_s"')
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


def _heavy_sensors(data: Data) -> Problems:
    """Known masses that together are heavier than the plate: in another unit, or no plate test."""
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
    """The mass of a plate, of one with a mesh at most, g."""
    mass, density = number(plate, "mass_g"), number(plate, "density_kg_m3")
    sizes = [number(plate, key) for key in ("length_mm", "width_mm", "thickness_mm")]
    known = [size for size in sizes if size is not None and size > 0.0]
    if mass is not None or density is None or len(known) < len(sizes):
        return mass
    return 1e-6 * density * math.prod(known)  # kg/m3 mm3 to g


def _one_list(data: Data) -> Problems:
    """Frequencies from one place, and what belongs to a list alone not beside a file."""
    measurement = table(data, "measurement")
    if "measurement" not in data or not isinstance(data["measurement"], dict):
        return
    given = [key for key in ("frequencies_hz", "table", "shapes") if key in measurement]
    if len(given) != 1:
        yield Problem(
            ("measurement", *given[1:2]),
            f"frequencies, received {' and '.join(given) or 'none'}, "
            "accepted: one of frequencies_hz, table and shapes",
        )
    for key, cure in _BESIDE.get(given[0], {}).items() if len(given) == 1 else ():
        if key in measurement:
            yield Problem(("measurement", key), cure)


_BESIDE: Final[Mapping[str, Mapping[str, str]]] = {
    "table": {
        "frequency_sd_hz": "beside a table, accepted: a column sd in the table instead",
        "labels": "beside a table, accepted: a column label in the table instead",
    },
    "shapes": {
        "frequency_sd_hz": "beside shapes, accepted: relative_std or resolution_hz",
        "labels": "beside shapes, which say what mode a frequency is, accepted: no labels",
    },
}


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


def _order(frequencies: list[float | None]) -> Problems:
    """One problem of a list that is not ascending, or has one frequency again and again."""
    known = [(i, value) for i, value in enumerate(frequencies) if value is not None]
    down = [(i, a, b) for (_, a), (i, b) in itertools.pairwise(known) if b < a]
    if down:
        i, before, after = down[0]
        more = f", and at {len(down) - 1} more place{'s' if len(down) > 2 else ''}" if down[1:] else ""
        whole = len(down) == len(frequencies) - 1 and len(down) > 1
        yield Problem(
            ("measurement", "frequencies_hz", i),
            f"descending frequencies, received {after:g} after {before:g}{more}, accepted: ascending, equal "
            f"ones for a degenerate pair{'; write the list the other way round' if whole else ''}",
        )
    elif len(known) > _EQUAL_AT_MOST and known[0][1] == known[-1][1]:
        yield Problem(
            ("measurement", "frequencies_hz"),
            f"all {len(frequencies)} frequencies are equal, received {known[0][1]:g} each time, accepted: "
            "one frequency a mode; are these repeats of one mode?",
        )


def _incomplete(data: Data) -> Problems:
    measurement = table(data, "measurement")
    if measurement.get("complete") is False:
        return
    for key in ("missed_probability", "false_peaks"):
        if key in measurement:
            yield Problem(
                ("measurement", key),
                f"of a complete list, received {received(measurement[key])}, accepted: "
                "complete = false beside it",
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


def _listed(keys: Iterable[str]) -> str:
    return " ".join(keys) or "none"


_CHECKS: Final[tuple[_Check, ...]] = (
    one_density,
    partial(_density, owner="plate"),
    _possible_mass,
    _thin,
    partial(_spreads, name="plate"),
    known_plies,
    materials_of_plies,
    _layups,
    stated_thickness,
    _grid_step,
    _sensors,
    _heavy_sensors,
    _one_list,
    _frequencies,
    _incomplete,
)
_CHECKS_OF_A_MATERIAL: Final[tuple[_Check, ...]] = (
    partial(_density, owner="material"),
    _possible_moduli,
    partial(_spreads, name="material"),
    known_symmetry,
    constants_of_symmetry,
    physical_material,
    search_bounds,
)
