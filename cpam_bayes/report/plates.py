"""A plate in words and numbers: the head of every screen, the list of built-in specimens."""

from __future__ import annotations

from typing import Any

from cpam_bayes import __version__
from cpam_bayes.formatting import fixed
from cpam_bayes.forward_model.air_shift import ROOM_AIR, air_shifts
from cpam_bayes.mechanics.modes import RigidBodyError
from cpam_bayes.plate import Plate, Specimen, to_user, user_name
from cpam_bayes.report.tables import Column, Table, facts, remarks

__all__ = ["NO_AIR", "air_text", "plate_head", "plates_document", "plates_screen", "unit_of"]

NO_AIR = "none given: vacuum, no air in the model"
# Modes that are told what air would do to, where no list says how many there are.
_MODES_IN_AIR = 6
# Shorter side over thickness from which transverse shear hardly shows in the lowest modes.
_THIN = 20.0
_EDGES = ("x = 0", "y = 0", "x = length", "y = width")
_CONDITIONS = {"F": "free", "S": "simply supported", "C": "clamped"}


def plate_head(title: str, specimen: Specimen, air: str | None = None) -> Table:
    """What was computed: the plate as the file gives it, and where the file says more.

    air : what to say of it, if the plate alone does not tell.
    """
    plate = specimen.plate
    rows = [
        ("source", specimen.source),
        ("size", f"{_size(plate)} mm, {thickness_class(plate)} ({_ratio(plate)})"),
        ("density", _density(plate)),
        ("material", specimen.material.name or "not named"),
        ("layup", layup_text(specimen)),
        ("edges", f"{plate.edges}: {edges_text(plate.edges)}"),
    ]
    if plate.mesh is not None:
        rows.append(("outline", f"the mesh {plate.mesh}"))
    rows += [
        ("mass", f"{s.mass * 1e3:g} g at x = {s.x * 1e3:g} mm, y = {s.y * 1e3:g} mm")
        for s in specimen.sensors
    ]
    rows.append(("air", air_text(specimen) if air is None else air))
    rows += [("note", note) for note in specimen.notes]
    return facts(title, tuple(rows))


def air_text(specimen: Specimen) -> str:
    """The air in the model, or what it would change."""
    if specimen.air_density:
        return f"{specimen.air_density:.6g} kg/m3, in the model"
    said = NO_AIR if specimen.air_density is None else "none: vacuum"
    if specimen.plate.mesh is not None or specimen.plate.layup.n_unknown:
        return said
    measurement = specimen.measurement
    n = _MODES_IN_AIR if measurement is None else measurement.size
    try:
        lower = -100.0 * air_shifts(specimen, n)
    except RigidBodyError:
        return said
    least, most = (fixed(float(v), 2) for v in (lower.min(), lower.max()))
    span = f"{most} %" if least == most else f"{least} to {most} %"
    many = "frequency" if n == 1 else f"{n} frequencies"
    return f"{said}; {ROOM_AIR:g} kg/m3 would lower the first {many} by {span}"


def plates_screen(specimens: tuple[Specimen, ...]) -> tuple[Table, ...]:
    """One row for each specimen."""
    columns = (
        Column("name"),
        Column("size mm"),
        Column("layup"),
        Column("edges"),
        Column("material"),
        Column("frequencies", number=True),
        Column("class"),
    )
    rows = tuple(
        (
            s.name,
            _size(s.plate),
            layup_text(s),
            s.plate.edges,
            s.material.name or "",
            str(0 if s.measurement is None else s.measurement.size),
            f"{thickness_class(s.plate)} ({_ratio(s.plate)})",
        )
        for s in specimens
    )
    legend = (
        "size: length x width x thickness; edges at x = 0, y = 0, x = length, y = width: "
        "F free, S simply supported, C clamped",
        f"class: thickness over shorter side, thick from 1/{_THIN:.0f} on",
        'write "D&G" in quotes: the shell has a use of its own for &',
    )
    return Table("Built-in specimens", columns, rows), remarks("Legend", legend)


def plates_document(specimens: tuple[Specimen, ...]) -> dict[str, Any]:
    """The JSON document of `plates`."""
    return {
        "command": "plates",
        "version": __version__,
        "plates": [
            {
                "name": s.name,
                "specimen": s.specimen,
                "length_mm": to_user("length", s.plate.length),
                "width_mm": to_user("width", s.plate.width),
                "thickness_mm": to_user("thickness", s.plate.thickness),
                "density_kg_m3": s.plate.density,
                "layup": s.plate.layup.text,
                "edges": s.plate.edges,
                "material": s.material.name,
                "isotropic": s.material.isotropic,
                "unknowns": [user_name(name) for name in s.unknowns.names],
                "frequencies": 0 if s.measurement is None else s.measurement.size,
                "thickness_class": thickness_class(s.plate),
                "notes": list(s.notes),
            }
            for s in specimens
        ],
    }


def thickness_class(plate: Plate) -> str:
    """Thin or thick, by the shorter side over the thickness."""
    return "thin" if min(plate.length, plate.width) > _THIN * plate.thickness else "thick"


def layup_text(specimen: Specimen) -> str:
    """The layup as written and its number of plies."""
    if specimen.material.isotropic:
        return "isotropic"
    layup = specimen.plate.layup
    return f"{layup.text}, {layup.n_plies} plies"


def edges_text(edges: str) -> str:
    """The edge conditions in words."""
    if len(set(edges)) == 1:
        return f"{_CONDITIONS[edges[0]]} on all four edges"
    said = []
    for letter in dict.fromkeys(edges):
        own = [place for place, e in zip(_EDGES, edges, strict=True) if e == letter]
        listed = " and ".join([", ".join(own[:-1]), own[-1]] if len(own) > 1 else own)
        said.append(f"{_CONDITIONS[letter]} at {listed}")
    return "; ".join(said)


def unit_of(name: str) -> str:
    """The unit of a constant's name in the plate file, "" where it has none."""
    return user_name(name).removeprefix(name).removeprefix("_")


def _size(plate: Plate) -> str:
    return " x ".join(f"{v * 1e3:.10g}" for v in (plate.length, plate.width, plate.thickness))


def _ratio(plate: Plate) -> str:
    return f"1/{min(plate.length, plate.width) / plate.thickness:.3g}"


def _density(plate: Plate) -> str:
    """Density and, unless only the mesh would tell it, mass."""
    density = f"{plate.density:.6g} kg/m3"
    if plate.mass is not None:
        return f"{density} from mass_g, {plate.mass * 1e3:.5g} g"
    if plate.mesh is not None:
        return f"{density} as given"
    return f"{density} as given, {plate.density * plate.area * plate.thickness * 1e3:.5g} g"
