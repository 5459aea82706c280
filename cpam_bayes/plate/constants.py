"""Whether the constants of a plate file, and the bounds between which they are sought, can be."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from cpam_bayes.plate.elasticity import constraint_violations, is_admissible
from cpam_bayes.plate.problems import Problem, received
from cpam_bayes.plate.raw import Data, Problems, number, numbers, table
from cpam_bayes.plate.units import USER_UNITS, user_name

_CONSTANTS: Final = ("E1_GPa", "E2_GPa", "nu12", "G12_GPa", "G13_GPa", "G23_GPa")
_REQUIRED: Final = _CONSTANTS[:4]
_ISOTROPIC: Final = ("E1_GPa", "nu12")
_GRID_POINTS: Final = 7

_RELATIONS: Final = (
    "a positive definite stiffness, first of eq. (9)",
    "|nu12 (1 - nu12 E2/E1) / (1 - nu12)| < 1, second of eq. (9)",
    "|nu12| < sqrt(E1/E2), third of eq. (9)",
    "E1 > E2, fourth of eq. (9): let axis 1 be the stiffer, or say isotropic = true",
)


def constants_of_kind(data: Data) -> Problems:
    """Which constants a material of this kind has."""
    material, unknowns = table(data, "material"), table(data, "unknowns")
    if material.get("isotropic") is True:
        for path, given in (
            (("material",), material),
            (("material", "sd"), table(data, "material", "sd")),
            (("unknowns",), unknowns),
        ):
            for key in given:
                if key in _CONSTANTS and key not in _ISOTROPIC:
                    yield Problem(
                        (*path, key),
                        f"not a constant of an isotropic material, received "
                        f"{received(given[key])}, accepted: E1_GPa and nu12 only, eq. (11)",
                    )
    elif material.get("isotropic") is False:
        for key in _REQUIRED:
            if key not in material and key not in _ISOTROPIC:
                yield Problem(("material", key), "missing, an orthotropic material has E1 E2 nu12 G12")


def _reference(data: Data) -> tuple[dict[str, float], bool] | None:
    """The reference constants as numbers, when all of them are there and positive."""
    material = table(data, "material")
    isotropic = material.get("isotropic")
    if not isinstance(isotropic, bool):
        return None
    wanted = _ISOTROPIC if isotropic else _CONSTANTS
    constants: dict[str, float] = {}
    for key in wanted:
        value = number(material, key)
        if value is None and (key in material or key in _REQUIRED):
            return None
        if value is not None:
            constants[USER_UNITS[key][0]] = value
    moduli_positive = all(value > 0.0 for name, value in constants.items() if name != "nu12")
    return (constants, isotropic) if moduli_positive and constants["nu12"] != 1.0 else None


def physical_material(data: Data) -> Problems:
    """Reference constants that break eq. (9)."""
    if number(table(data, "material"), "nu12") == 1.0:
        yield Problem(("material", "nu12"), f"impossible constants, accepted: {_RELATIONS[1]}")
    reference = _reference(data)
    if reference is None:
        return
    constants, isotropic = reference
    broken = np.flatnonzero(constraint_violations(constants, isotropic))
    if broken.size:
        said = ", ".join(f"{user_name(name)} = {value:g}" for name, value in constants.items())
        accepted = "-1 < nu12 < 0.5" if isotropic else _RELATIONS[int(broken[-1])]
        key = "E1_GPa" if 3 in broken else "nu12"
        yield Problem(("material", key), f"impossible constants, received {said}, accepted: {accepted}")


def search_bounds(data: Data) -> Problems:
    """Bounds and priors that are reversed, not physical, or at odds with each other."""
    unknowns = table(data, "unknowns")
    boxes: dict[str, tuple[float, float]] = {}
    for key in _CONSTANTS:
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
        if key == "nu12" and not -1.0 < lower < upper < 1.0:
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
    # A bound or a reference that is wrong by itself would only be said a second time.
    if boxes.keys() == {key for key in _CONSTANTS if key in unknowns}:
        yield from _possible_box(data, boxes)


def _possible_box(data: Data, boxes: Mapping[str, tuple[float, float]]) -> Problems:
    """Eq. (9) must leave something of the search box, looked for on a grid."""
    reference = _reference(data)
    if reference is None or not boxes:
        return
    constants, isotropic = reference
    if not is_admissible(constants, isotropic):
        return
    searched = [key for key in ("E1_GPa", "E2_GPa", "nu12") if key in boxes]
    if isotropic:
        searched = [key for key in searched if key in _ISOTROPIC]
    if not searched:
        return
    axes = [np.linspace(*boxes[key], _GRID_POINTS) for key in searched]
    grids = np.meshgrid(*axes, indexing="ij")
    trial: dict[str, Any] = dict(constants) | {
        USER_UNITS[key][0]: grid for key, grid in zip(searched, grids, strict=True)
    }
    if not is_admissible(trial, isotropic).any():
        said = ", ".join(f"{key} {boxes[key][0]:g} to {boxes[key][1]:g}" for key in searched)
        accepted = "-1 < nu12 < 0.5" if isotropic else "bounds that eq. (9) does not rule out"
        yield Problem(
            ("unknowns", searched[-1]),
            f"no physical constants within the bounds, received {said}, accepted: {accepted}",
        )
