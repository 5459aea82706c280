"""Sections of `report`: ten questions, the plate once, then those of its parts, what is folded last."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from cpam_bayes.combined import FullReport
from cpam_bayes.report.combined.questions import QUESTIONS, questions
from cpam_bayes.report.combined.summary import FREQUENCIES_ALONE, summary
from cpam_bayes.report.plates.head import plate_section
from cpam_bayes.report.sections import COMPUTATION, Section
from cpam_bayes.result import Result

PLATE: Final = "plate"


def figure_name(part: Result, name: str) -> str:
    """The name of a part's figure, of which there is one in all parts."""
    return f"{part.question}_{name}"


def sections(result: FullReport) -> tuple[Section, ...]:
    """The ten questions, plate, then constants, stacking sequences and diagnosis."""
    of_parts = [
        replace(
            section,
            title=_title(section, part is result.identification),
            figures=tuple(figure_name(part, name) for name in section.figures),
        )
        for part in result.parts
        for section in part.sections()
        if PLATE not in section.figures
    ]
    return (
        Section(QUESTIONS, (questions(result, summary(result)),), folded=False),
        plate_section(result.specimen, result.air_shifts),
        *sorted(of_parts, key=lambda section: section.folded),
    )


def _title(section: Section, alone: bool) -> str:
    """The title of a section; alone : of the identification, whose constants are not those of the summary."""
    if alone and section.tables and section.title != COMPUTATION:
        return f"{section.title}, {FREQUENCIES_ALONE}"
    return section.title
