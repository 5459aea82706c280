"""The words beside the figures of `batch`."""

from __future__ import annotations

from cpam_bayes.batches.batch import BatchResult
from cpam_bayes.formatting import listed
from cpam_bayes.report.sections import Caption


def captions(result: BatchResult) -> dict[str, Caption]:
    """A caption for each figure."""
    if not result.done:
        return {}
    names = listed(list(result.constants), "and")
    return {
        "control_chart": Caption(
            "Dots: the constants of each plate, bars their 95 % intervals. Line and band: the mean of the "
            "batch, and three standard deviations of a plate as neighbours in the list scatter; a dot beyond "
            "it, in red, differs by more than chance. Dashed: a limit.",
            f"Control chart of {names} over {len(result.done)} plates.",
        )
    }
