"""The screen of `export --to uff`."""

from __future__ import annotations

from cpam_bayes.forward_model.export import UniversalResult
from cpam_bayes.report.plates.head import plate_section
from cpam_bayes.report.sections import Section
from cpam_bayes.report.tables import facts


def sections(result: UniversalResult) -> tuple[Section, ...]:
    """Plate, and what its file holds."""
    shapes = result.shapes
    rows = (
        ("file", str(result.path)),
        ("format", "universal file: datasets 164 (mm), 15, 55" + (" and 82" if shapes.lines else "")),
        ("nodes", f"{len(shapes.nodes)}, {'of the measured shapes' if shapes.measured else 'on a grid'}"),
        ("modes", f"{len(shapes.modes)}, for a modal mass of 1 kg"),
    )
    return (
        plate_section(result.specimen, result.air_shifts),
        Section("Universal file", (facts("Written", rows),), folded=False),
    )
