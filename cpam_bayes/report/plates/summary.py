"""`plates` in plain words: the list of the built-in specimens."""

from __future__ import annotations

from typing import Final

from cpam_bayes.forward_model.builtin import BuiltinPlates
from cpam_bayes.report.plates.head import THIN, layup_text, size_text, thickness_class, thickness_ratio
from cpam_bayes.report.summary import Summary
from cpam_bayes.report.tables import Table, headed, remarks

_LEGEND: Final = (
    "size: length x width x thickness; edges at x = 0, y = 0, x = length, y = width: F free, S simply "
    "supported, C clamped",
    f"class: thickness over shorter side, thick from 1/{THIN:.0f} on",
    'write "D&G" in quotes: the shell has a use of its own for &',
)


def summary(result: BuiltinPlates) -> Summary:
    """One row for each specimen."""
    return Summary(
        title="plates",
        headline=(
            f"{len(result.specimens)} specimens are built in; wherever a command takes PLATE it takes such a "
            "name or the path of a plate file."
        ),
        tables=(_specimens(result), remarks("Legend", _LEGEND)),
        next_steps=("Identify the constants of a specimen: cpam-bayes identify A1",),
    )


def _specimens(result: BuiltinPlates) -> Table:
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
    return Table("Built-in specimens", columns, rows)
