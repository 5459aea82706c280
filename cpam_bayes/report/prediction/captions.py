"""The words beside the figures of `predict`."""

from __future__ import annotations

from cpam_bayes.prediction.predict import PredictionResult
from cpam_bayes.report.sections import Caption, modes_caption


def captions(result: PredictionResult) -> dict[str, Caption]:
    """A caption for each figure."""
    return {
        "prediction": Caption(
            "Thick bars: where the natural frequency of each mode lies with 95 % probability, relative to "
            "its mean. Thin bars: where a measurement of it would lie, with the posterior's noise. Dots: "
            "measured frequencies, where the plate file has them; one outside its thin bar contradicts the "
            "posterior or the plate file.",
            f"Intervals of {len(result.modes)} predicted frequencies.",
        ),
        "modes": modes_caption([(m.mean, m.mode.label or m.mode.kind) for m in result.modes]),
    }
