"""Plies that a layup calls by their names, and hybrids: where [[ply]], [material.NAME], layup agree."""

from __future__ import annotations

import re
from typing import Final

from cpam_bayes.errors import LayupError
from cpam_bayes.plate.layup import PlyKind, parse_layup
from cpam_bayes.plate.problems import Problem, received
from cpam_bayes.plate.raw import Data, Problems, number, per_material, table
from cpam_bayes.plate.schema import NAME, is_hybrid
from cpam_bayes.plate.units import to_si

# Part of the stated thickness by which the plies may miss it; they fill it in proportion.
_THICKNESS_TOLERANCE: Final = 0.01


def ply_kinds(data: Data) -> dict[str, PlyKind] | None:
    """The plies of the tables [[ply]] by their names, None where they are not all as they must be."""
    kinds: dict[str, PlyKind] = {}
    densities = {name: number(table(part, "material"), "density_kg_m3") for name, part in per_material(data)}
    for ply in _tables(data):
        name, thickness, material = ply.get("name"), number(ply, "thickness_mm"), ply.get("material", "")
        if not isinstance(name, str) or not re.fullmatch(NAME, name) or name in kinds:
            return None
        if not isinstance(material, str) or material not in densities:
            return None
        if thickness is None or thickness <= 0.0:
            return None
        kinds[name] = PlyKind(name, material, to_si("thickness_mm", thickness), densities.get(material))
    return None if is_hybrid(data.get("material")) and not kinds else kinds


def _tables(data: Data) -> list[Data]:
    plies = data.get("ply")
    return [ply for ply in plies if isinstance(ply, dict)] if isinstance(plies, list) else []


def known_plies(data: Data) -> Problems:
    """Names that occur twice, and plies of materials that there are not."""
    plies, hybrid = _tables(data), is_hybrid(data.get("material"))
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


def materials_of_plies(data: Data) -> Problems:
    """Several materials without plies, materials and unknowns that the layup does not have."""
    material, unknowns = data.get("material"), table(data, "unknowns")
    if not is_hybrid(material):
        if is_hybrid(data.get("unknowns")):
            yield Problem(
                ("unknowns",), "tables for several materials beside one [material], accepted: its constants"
            )
        return
    materials = table(data, "material")
    if not _tables(data):
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
    used = {kind.material for kind in _layup(data)}
    for name in materials if used else ():
        if name not in used:
            yield Problem(
                ("material", name), "no ply of the layup is of it, accepted: materials of the plate"
            )


def one_density(data: Data) -> Problems:
    """The density of the plate, of its materials, or its mass, and a density of one material alone."""
    plate, hybrid = table(data, "plate"), is_hybrid(data.get("material"))
    if not isinstance(data.get("plate"), dict):
        return
    given = [key for key in ("density_kg_m3", "mass_g") if key in plate]
    with_density = [name for name, part in per_material(data) if "density_kg_m3" in table(part, "material")]
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
    if len(given) != 1:
        yield Problem(
            ("plate", *given[1:]),
            f"density, received {' and '.join(given) or 'neither'}, "
            "accepted: one of density_kg_m3 and mass_g",
        )


def stated_thickness(data: Data) -> Problems:
    """Plies that do not make the thickness of the plate."""
    stated = number(table(data, "plate"), "thickness_mm")
    made = 1e3 * sum(kind.thickness for kind in _layup(data))
    if stated is None or not made or abs(made / stated - 1.0) <= _THICKNESS_TOLERANCE:
        return
    yield Problem(
        ("plate", "thickness_mm"),
        f"not the sum of the plies, received {stated:g}, the plies of the layup make {made:.5g} mm, "
        f"accepted: within {100.0 * _THICKNESS_TOLERANCE:g} %; correct thickness_mm, a [[ply]] or the layup",
    )


def _layup(data: Data) -> tuple[PlyKind, ...]:
    """The plies of the layup, none where it cannot be read or has no named plies."""
    kinds, text = ply_kinds(data), table(data, "plate").get("layup")
    if not kinds or not isinstance(text, str):
        return ()
    try:
        return parse_layup(text, kinds).kinds
    except LayupError:
        return ()
