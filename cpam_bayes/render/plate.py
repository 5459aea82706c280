"""A plate in words and numbers: the head of every screen."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.formatting import fixed, significant
from cpam_bayes.forward_model.model import ROOM_AIR
from cpam_bayes.plate import Measurement, Plate, Specimen
from cpam_bayes.plate.edges import CONDITIONS, PLACES
from cpam_bayes.render.report import Section, Table, facts

__all__ = [
    "NO_AIR",
    "THIN",
    "air_text",
    "edges_text",
    "layup_text",
    "measured_facts",
    "plate_head",
    "plate_section",
    "size_text",
    "thickness_class",
    "thickness_ratio",
]

NO_AIR = "not in the model"
# Shorter side over thickness from which transverse shear hardly shows in the lowest modes.
THIN = 20.0


def plate_section(specimen: Specimen, air_shifts: NDArray[np.float64] | None) -> Section:
    """The plate as it was computed, drawn, and what was measured of it.

    air_shifts : see `PlateResult.air_shifts`
    """
    tables = (plate_head(specimen, air_shifts), measured_facts(specimen))
    return Section("The plate and what was measured", tables, ("plate",), folded=False)


def plate_head(specimen: Specimen, air_shifts: NDArray[np.float64] | None) -> Table:
    """The plate as the file gives it, and where the file says more.

    air_shifts : see `PlateResult.air_shifts`
    """
    plate = specimen.plate
    rows = [
        *((("specimen", specimen.specimen), *specimen.certificate) if specimen.certificate else ()),
        ("source", specimen.source),
        ("size", f"{size_text(plate)} mm, {thickness_class(plate)} ({thickness_ratio(plate)})"),
        ("density", _density(plate)),
        ("material", _material(specimen)),
        ("layup", layup_text(specimen)),
        ("edges", f"{plate.edges}: {edges_text(plate.edges)}"),
    ]
    if plate.mesh is not None:
        rows.append(("outline", f"the mesh {plate.mesh}"))
    rows += [
        ("mass", f"{s.mass * 1e3:g} g at x = {s.x * 1e3:g} mm, y = {s.y * 1e3:g} mm")
        for s in specimen.sensors
    ]
    rows.append(("air", air_text(specimen, air_shifts)))
    rows += [("note", note) for note in specimen.notes]
    return facts(f"Plate {specimen.name}", tuple(rows))


def measured_facts(specimen: Specimen) -> Table:
    """The frequencies as the laboratory gives them, and what it says of their quality."""
    measurement = specimen.measurement
    if measurement is None:
        return facts("What was measured", ())
    listed = ", ".join(
        f"{f:.10g}{f' {label}' if label else ''}"
        for f, label in zip(measurement.frequencies, measurement.labels, strict=True)
    )
    if measurement.frequency_sd is not None:
        low, high = measurement.frequency_sd.min(), measurement.frequency_sd.max()
        span = f"{low:.3g}" if low == high else f"{low:.3g} to {high:.3g}"
        made = "of a single hit, from the table" if measurement.origin else "as given"
        repeatability = f"standard deviation {span} Hz, {made}"
    elif measurement.relative_std is not None:
        repeatability = f"{100.0 * measurement.relative_std:.3g} % of a frequency, as given"
    else:
        repeatability = "not given: inferred from the misfit"
    resolution = f"{measurement.resolution:g} Hz" if measurement.resolution else "not given"
    complete = "no mode is missing between the first and the last"
    rows = (
        (f"{measurement.size} frequencies", f"{listed} Hz"),
        ("read to", resolution),
        ("repeatability", repeatability),
        ("completeness", complete if measurement.complete else "modes may be missing"),
        *((("read from", measurement.origin),) if measurement.origin else ()),
        *_damping(measurement),
    )
    return facts("What was measured", rows)


def _damping(measurement: Measurement) -> tuple[tuple[str, str], ...]:
    """Damping ratios and loss factors, where they were measured."""
    ratios, factors = measurement.damping, measurement.loss_factors
    if ratios is None or factors is None:
        return ()
    return (
        ("damping ratio", f"{', '.join(significant(100.0 * float(v), 3) for v in ratios)} %"),
        ("loss factor", ", ".join(significant(float(v), 3) for v in factors)),
    )


def _material(specimen: Specimen) -> str:
    """The name of the material, and what it is where the layup does not tell."""
    said = (
        f"{part.name or name or 'not named'}{', orthotropic' if part.symmetry == 'orthotropic' else ''}"
        for name, part in specimen.material.parts.items()
    )
    return "; ".join(said)


def air_text(specimen: Specimen, air_shifts: NDArray[np.float64] | None) -> str:
    """The air in the model, or what it would change by ``air_shifts``, relative, None where not computed."""
    if specimen.air_density:
        return f"{specimen.air_density:.6g} kg/m3, in the model"
    stated = NO_AIR if specimen.air_density is None else "vacuum"
    if air_shifts is None:
        return stated
    lower = -100.0 * air_shifts
    least, most = (fixed(float(v), 2) for v in (lower.min(), lower.max()))
    span = f"{most} %" if least == most else f"{least} to {most} %"
    many = "frequency" if len(lower) == 1 else f"{len(lower)} frequencies"
    return f"{stated}; {ROOM_AIR:g} kg/m3 would lower the first {many} by {span}"


def thickness_class(plate: Plate) -> str:
    """Thin or thick, by the shorter side over the thickness."""
    return "thin" if min(plate.length, plate.width) > THIN * plate.thickness else "thick"


def layup_text(specimen: Specimen) -> str:
    """The layup as written and its number of plies."""
    if specimen.material.isotropic:
        return "isotropic"
    layup = specimen.plate.layup
    return f"{layup.text}, {'1 ply' if layup.n_plies == 1 else f'{layup.n_plies} plies'}"


def edges_text(edges: str) -> str:
    """The edge conditions in words."""
    if len(set(edges)) == 1:
        return f"{CONDITIONS[edges[0]].name} on all four edges"
    said = []
    for letter in dict.fromkeys(edges):
        places = [place for place, e in zip(PLACES, edges, strict=True) if e == letter]
        listed = " and ".join([", ".join(places[:-1]), places[-1]] if len(places) > 1 else places)
        said.append(f"{CONDITIONS[letter].name} at {listed}")
    return "; ".join(said)


def size_text(plate: Plate) -> str:
    """Length, width and thickness, mm."""
    return " x ".join(f"{v * 1e3:.10g}" for v in (plate.length, plate.width, plate.thickness))


def thickness_ratio(plate: Plate) -> str:
    """Thickness over the shorter side."""
    return f"1/{min(plate.length, plate.width) / plate.thickness:.3g}"


def _density(plate: Plate) -> str:
    """Density and, unless only the mesh would tell it, mass."""
    density = f"{plate.density:.6g} kg/m3"
    if plate.mass is not None:
        return f"{density} from the weighed mass, {plate.mass * 1e3:.5g} g"
    if plate.mesh is not None:
        return f"{density} as given"
    return f"{density} as given, {plate.density * plate.area * plate.thickness * 1e3:.5g} g"
