"""Figures of `report`: those of its parts."""

from __future__ import annotations

from matplotlib.figure import Figure

from cpam_bayes.combined import FullReport
from cpam_bayes.report.combined.screen import PLATE, figure_name


def figures(result: FullReport) -> dict[str, Figure]:
    """All figures of the parts, named after their questions; the plate once, by every result's own."""
    return {
        figure_name(part, name): figure
        for part in result.parts
        for name, figure in part.figures().items()
        if name != PLATE
    }
