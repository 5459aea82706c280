"""The screen of `plates`."""

from __future__ import annotations

from cpam_bayes.forward_model.builtin import BuiltinPlates
from cpam_bayes.report.plates.head import THIN, layup_text, size_text, thickness_class, thickness_ratio
from cpam_bayes.report.sections import Section
from cpam_bayes.report.tables import Table, headed, remarks


def sections(result: BuiltinPlates) -> tuple[Section, ...]:
    """One row for each specimen."""
    columns = headed("name", "size mm", "layup", "edges", "material", "#frequencies", "class")
    rows = tuple(
        (
            s.name,
            size_text(s.plate),
            layup_text(s),
            s.plate.edges,
            s.material.name or "",
            str(0 if s.measurement is None else s.measurement.size),
            f"{thickness_class(s.plate)} ({thickness_ratio(s.plate)})",
        )
        for s in result.specimens
    )
    legend = (
        "size: length x width x thickness; edges at x = 0, y = 0, x = length, y = width: "
        "F free, S simply supported, C clamped",
        f"class: thickness over shorter side, thick from 1/{THIN:.0f} on",
        'write "D&G" in quotes: the shell has a use of its own for &',
    )
    listed = Table("Built-in specimens", columns, rows)
    return (Section("Plates of the paper", (listed, remarks("Legend", legend)), folded=False),)
