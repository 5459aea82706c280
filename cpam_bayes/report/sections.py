"""What stands behind an answer, section by section: tables on a screen, with figures on a page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

from cpam_bayes.report.tables import Table

__all__ = ["COMPUTATION", "Caption", "Section", "merged", "modes_caption", "tables_of"]

COMPUTATION: Final = "How this was computed"
"""Title of the section that stands last on a page."""


@dataclass(frozen=True, slots=True)
class Caption:
    """The words beside a figure.

    text : what to see in the figure
    alt : what the figure shows, for a reader who cannot see it
    """

    text: str
    alt: str


@dataclass(frozen=True, slots=True)
class Section:
    """A part of an answer.

    tables : those without rows are not shown
    figures : names of figures, which stand on a page before the tables
    folded : on a page, whether a reader opens the section before its content is shown
    """

    title: str
    tables: tuple[Table, ...] = ()
    figures: tuple[str, ...] = ()
    folded: bool = True


def modes_caption(modes: Sequence[tuple[float, str]]) -> Caption:
    """The words beside mode shapes; modes : frequency, Hz, and label of each."""
    listed = ", ".join(f"{label} at {frequency:.4g} Hz" for frequency, label in modes)
    return Caption(
        "Red moves up while blue moves down. On the black lines the plate stands still: a support there "
        "does not disturb the mode, and a sensor or a tap there does not see the mode. A deformed grid is "
        "a mode in the plane of the plate.",
        f"Shapes of {len(modes)} modes: {listed}.",
    )


def merged(sections: Sequence[Section]) -> tuple[Section, ...]:
    """Sections of one title as one, where the last of them stands."""
    found: dict[str, Section] = {}
    for section in sections:
        before = found.pop(section.title, replace(section, tables=(), figures=()))
        found[section.title] = replace(
            section,
            tables=(*before.tables, *section.tables),
            figures=(*before.figures, *section.figures),
        )
    return tuple(found.values())


def tables_of(sections: tuple[Section, ...]) -> tuple[Table, ...]:
    """All tables in their order."""
    return tuple(table for section in sections for table in section.tables)
