"""The words beside the figure of `poles`."""

from __future__ import annotations

from cpam_bayes.modal_analysis.poles import PolesResult
from cpam_bayes.report.sections import Caption


def captions(result: PolesResult) -> dict[str, Caption]:
    """What to see in the stability diagram."""
    return {
        "stability": Caption(
            "Each point is a pole of a model with as many poles as its height says; filled ones are in the "
            "order below as well. A mode is a column of filled points at a peak of the responses (grey). Red "
            "lines are the modes of the table: look at a line without a column, and at a column without one.",
            f"Stability diagram of {len(result.stabilisation.orders)} poles with {len(result.modes)} modes.",
        )
    }
