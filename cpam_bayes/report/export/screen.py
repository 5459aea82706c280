"""The screen of `export`."""

from __future__ import annotations

from cpam_bayes.forward_model.export import ExportResult
from cpam_bayes.report.plates.head import plate_section
from cpam_bayes.report.sections import Section
from cpam_bayes.report.tables import facts


def sections(result: ExportResult) -> tuple[Section, ...]:
    """Plate, and what its file holds."""
    n_rigid = result.deck.n_rigid
    rows = (
        ("file", str(result.path)),
        ("format", "ABAQUS input, read by ABAQUS and CalculiX; N, m, kg, s"),
        ("elements", f"{result.n_elements} of {result.element_type}, {result.element}s"),
        ("nodes", str(len(result.deck.mesh.nodes))),
        ("step", f"{result.n_modes + n_rigid} modes: {result.n_modes} and {n_rigid} rigid-body motions"),
    )
    return (
        plate_section(result.specimen, result.air_shifts),
        Section("Input file", (facts("Written", rows),), folded=False),
    )
