"""The screen of `forward`."""

from __future__ import annotations

import numpy as np

from cpam_bayes.formatting import signed, significant
from cpam_bayes.forward_model.solve import ForwardResult
from cpam_bayes.plate import Specimen, to_user, unit_of
from cpam_bayes.report.forward.rows import constants_with_origin, measured_of_modes
from cpam_bayes.report.plates.head import plate_section
from cpam_bayes.report.sections import Section
from cpam_bayes.report.tables import Table, facts, headed, remarks


def sections(result: ForwardResult) -> tuple[Section, ...]:
    """Plate, constants, modes, and how exact they are."""
    measured = measured_of_modes(result)
    columns = list(headed("#mode", "#Hz", "kind", "label"))
    if any(measured):
        columns += headed("#measured Hz", "#difference %")
    rows = []
    for i, (mode, hz) in enumerate(zip(result.modes, measured, strict=True), 1):
        row = [str(i), significant(mode.frequency, 6), mode.kind, mode.label]
        if any(measured):
            row += ["", ""] if hz is None else [f"{hz:.10g}", signed(100 * (mode.frequency / hz - 1.0), 2)]
        rows.append(tuple(row))
    worst = float(np.max(result.error))
    computation = (
        ("solver", result.solver),
        ("error", f"about {significant(100 * worst, 2)} % of a frequency in the worst mode, estimated")
        if np.isfinite(worst)
        else ("error", result.no_estimate or "no estimate"),
        ("labels", "nodal lines across x and across y; half-waves between two held edges"),
        ("time", f"{result.seconds:.1f} s"),
    )
    return (
        plate_section(result.command, result.specimen, result.air_shifts),
        Section(
            "Modes",
            (_constants(result.specimen), Table("Modes from these constants", tuple(columns), tuple(rows))),
            ("modes",),
            folded=False,
        ),
        Section("Computation", (facts("Computation", computation),)),
        Section("All warnings", (remarks("Warnings", result.warnings, flagged=True),)),
    )


def _constants(specimen: Specimen) -> Table:
    columns = headed("name", "#value", "unit", "from")
    rows = tuple(
        (name, f"{to_user(name, value):.6g}", unit_of(name), source)
        for name, value, source in constants_with_origin(specimen)
    )
    return Table("Reference constants", columns, rows)
