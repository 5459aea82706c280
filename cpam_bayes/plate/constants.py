"""Whether the constants of a plate file, and the bounds between which they are sought, can be."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, cast

import numpy as np

from cpam_bayes.plate.elasticity import (
    CONSTRAINTS,
    MaterialSymmetry,
    constraint_violations,
    is_admissible,
)
from cpam_bayes.plate.problems import Problem, received
from cpam_bayes.plate.raw import Data, Problems, number, numbers, table
from cpam_bayes.plate.units import USER_UNITS, user_name

CONSTANT_KEYS: Final = ("E1_GPa", "E2_GPa", "nu12", "G12_GPa", "G13_GPa", "G23_GPa")
_REQUIRED: Final = CONSTANT_KEYS[:4]
_ISOTROPIC: Final = ("E1_GPa", "nu12")
_GRID_POINTS: Final = 7
# What a material is that names the constants of a composite and no symmetry.
_COMPOSITE: Final[MaterialSymmetry] = "transversely_isotropic"
# What to do about constants that eq. (9) refuses and that other plies have.
_OTHER_SYMMETRY: Final = 'fabrics, wood and plywood are symmetry = "orthotropic"'


def symmetry_of(material: Data) -> MaterialSymmetry | None:
    """The symmetry that a table [material] states or, by its constants, implies; None where it does not."""
    stated, isotropic = material.get("symmetry"), material.get("isotropic")
    if stated is not None:
        return cast(MaterialSymmetry, stated) if stated in tuple(CONSTRAINTS) else None
    if isotropic is True:
        return "isotropic"
    implied = isotropic is False or (isotropic is None and ("E2_GPa" in material or "G12_GPa" in material))
    return _COMPOSITE if implied else None


def known_symmetry(data: Data) -> Problems:
    """Whether [material] says once what its symmetry is."""
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


def constants_of_symmetry(data: Data) -> Problems:
    """Which constants a material of this symmetry has."""
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
                )


def _reference(data: Data) -> tuple[dict[str, float], MaterialSymmetry] | None:
    """The reference constants as numbers, when all of them are there and positive."""
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


def physical_material(data: Data) -> Problems:
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


def search_bounds(data: Data) -> Problems:
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
    # A bound or a reference that is wrong by itself would only be said a second time.
    if boxes.keys() == {key for key in CONSTANT_KEYS if key in unknowns}:
        yield from _possible_box(data, boxes)


def _possible_box(data: Data, boxes: Mapping[str, tuple[float, float]]) -> Problems:
    """The constraints must leave something of the search box, looked for on a grid."""
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
