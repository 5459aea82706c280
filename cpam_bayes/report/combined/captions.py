"""The words beside the figures of `report`."""

from __future__ import annotations

from cpam_bayes.combined import FullReport
from cpam_bayes.report.combined.screen import PLATE, figure_name
from cpam_bayes.report.sections import Caption


def captions(result: FullReport) -> dict[str, Caption]:
    """A caption for each figure."""
    return {
        figure_name(part, name): caption
        for part in result.parts
        for name, caption in part.captions().items()
        if name != PLATE
    }
