"""The answer of `forward`: its record, its screen and its JSON document."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.formatting import signed, significant
from cpam_bayes.identification.point import SUSPICIOUS_RATIO
from cpam_bayes.mechanics.shapes import Mode
from cpam_bayes.plate import Specimen, to_user, user_name
from cpam_bayes.plate.elasticity import complete_constants
from cpam_bayes.report.documents import plate_keys
from cpam_bayes.report.identification.words import error_warning
from cpam_bayes.report.plates import plate_head, unit_of
from cpam_bayes.report.tables import Column, Table, facts, remarks

Array = NDArray[np.float64]

__all__ = [
    "ForwardAnswer",
    "ModeShape",
    "forward_document",
    "forward_screen",
    "forward_warnings",
]


@dataclass(frozen=True, slots=True)
class ModeShape:
    """Displacements of one mode on a regular grid of the plate, (nx, ny) each, of any scale.

    They are NaN off the plate: in a hole, or beyond an oblique edge.
    """

    u: Array
    v: Array
    w: Array


@dataclass(frozen=True, slots=True)
class ForwardAnswer:
    """Modes of a plate with its reference constants.

    solver : in words. error : (n_modes,) estimated relative error of the frequencies, NaN where the
    solver has no estimate, and no_estimate says why. shapes : one for each mode. seconds : wall
    clock. extent : m, least and greatest x, and y, of the shapes' grid; None for the rectangle.
    """

    specimen: Specimen
    solver: str
    modes: tuple[Mode, ...]
    error: Array
    shapes: tuple[ModeShape, ...]
    seconds: float
    no_estimate: str = ""
    extent: tuple[tuple[float, float], tuple[float, float]] | None = None


def forward_warnings(result: ForwardAnswer) -> tuple[str, ...]:
    """A solver's error that is not small, and a plate that looks like one in other units."""
    found = error_warning(result.error)
    measured = _measured(result)
    pairs = [(m, mode.frequency) for m, mode in zip(measured, result.modes, strict=True) if m]
    if pairs:
        ratios = [predicted / measured for measured, predicted in pairs]
        worst = max(ratios, key=lambda ratio: abs(np.log(ratio)))
        if not 1 / SUSPICIOUS_RATIO <= worst <= SUSPICIOUS_RATIO:
            found.append(
                f"a predicted frequency is {significant(worst, 3)} times the measured one: check "
                "the units of the sizes, the density, the constants and the frequencies"
            )
    return tuple(found)


def forward_screen(result: ForwardAnswer, warnings: tuple[str, ...]) -> tuple[Table, ...]:
    """Plate, constants, modes, and how exact they are."""
    measured = _measured(result)
    columns = [
        Column("mode", number=True),
        Column("Hz", number=True),
        Column("kind"),
        Column("label"),
    ]
    if any(measured):
        columns += [Column("measured Hz", number=True), Column("difference %", number=True)]
    rows = []
    for i, (mode, own) in enumerate(zip(result.modes, measured, strict=True), 1):
        row = [str(i), significant(mode.frequency, 6), mode.kind, mode.label]
        if any(measured):
            row += ["", ""] if own is None else [f"{own:.10g}", _difference(mode.frequency, own)]
        rows.append(tuple(row))
    worst = float(np.max(result.error))
    told = (
        ("solver", result.solver),
        ("error", f"about {significant(100 * worst, 2)} % of a frequency in the worst mode, estimated")
        if np.isfinite(worst)
        else ("error", result.no_estimate or "no estimate"),
        ("labels", "nodal lines across x and across y; half-waves between two held edges"),
        ("time", f"{result.seconds:.1f} s"),
    )
    tables = (
        plate_head(f"forward {result.specimen.name}", result.specimen),
        _constants(result.specimen),
        Table("Modes from these constants", tuple(columns), tuple(rows)),
        facts("Computation", told),
        remarks("Warnings", warnings, flagged=True),
    )
    return tables


def forward_document(result: ForwardAnswer, seed: int, warnings: tuple[str, ...]) -> dict[str, Any]:
    """The JSON document of `forward`."""
    return {
        **plate_keys("forward", result.specimen, seed),
        "solver": result.solver,
        "modes": [
            {
                "frequency_hz": mode.frequency,
                "kind": mode.kind,
                "label": mode.label,
                "in_plane_share": mode.in_plane_fraction,
                "relative_error_estimate": float(error),
                "measured_hz": measured,
            }
            for mode, error, measured in zip(result.modes, result.error, _measured(result), strict=True)
        ],
        "relative_error_estimate": float(np.max(result.error)),
        "no_error_estimate": result.no_estimate or None,
        "constants": {
            user_name(name): {"value": to_user(name, value), "source": source}
            for name, value, source in _all_constants(result.specimen)
        },
        "air_density_kg_m3": result.specimen.air_density,
        "seconds": result.seconds,
        "warnings": list(warnings),
        "notes": list(result.specimen.notes),
    }


def _constants(specimen: Specimen) -> Table:
    columns = (Column("name"), Column("value", number=True), Column("unit"), Column("from"))
    rows = tuple(
        (name, f"{to_user(name, value):.6g}", unit_of(name), source)
        for name, value, source in _all_constants(specimen)
    )
    return Table("Reference constants", columns, rows)


def _all_constants(specimen: Specimen) -> list[tuple[str, float, str]]:
    """Name, value in SI and origin of every constant that the plate has."""
    material = specimen.material
    complete = complete_constants(material.constants, material.isotropic)
    if material.isotropic:
        origins = dict.fromkeys(("E1", "nu12"), "plate file") | {"G12": "eq. (11)"}
    else:
        origins = dict.fromkeys(complete, "plate file")
        origins |= {"G13": "G12"} if "G13" not in material.constants else {}
        origins |= {"G23": "eq. (6)"} if "G23" not in material.constants else {}
    return [(name, float(complete[name]), origin) for name, origin in origins.items()]


def _measured(result: ForwardAnswer) -> list[float | None]:
    """The measured frequency of every mode, where the list has no gaps."""
    measurement = result.specimen.measurement
    listed: list[float | None] = []
    if measurement is not None and measurement.complete:
        listed += [float(f) for f in measurement.frequencies[: len(result.modes)]]
    return listed + [None] * (len(result.modes) - len(listed))


def _difference(predicted: float, measured: float) -> str:
    return signed(100 * (predicted / measured - 1.0), 2)
