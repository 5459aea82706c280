"""The words beside the figures of `forward`."""

from __future__ import annotations

from cpam_bayes.forward_model.solve import ForwardResult
from cpam_bayes.report.sections import Caption


def captions(result: ForwardResult) -> dict[str, Caption]:
    """A caption for each figure."""
    listed = ", ".join(f"{mode.label or mode.kind} at {mode.frequency:.4g} Hz" for mode in result.modes)
    return {
        "modes": Caption(
            "Red moves up while blue moves down; on the black lines the plate stands still: there a support "
            "does not disturb the mode, and a sensor or a tap does not see it. A deformed grid is a mode in "
            "the plane of the plate.",
            f"Shapes of {len(result.modes)} modes: {listed}.",
        )
    }
