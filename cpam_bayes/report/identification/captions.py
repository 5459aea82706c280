"""The words beside the figures of `identify` by the swarm."""

from __future__ import annotations

import math

from cpam_bayes.formatting import significant
from cpam_bayes.identification.identify import PointResult
from cpam_bayes.report.modal_assurance.rows import assurance_captions
from cpam_bayes.report.sections import Caption, modes_caption


def captions(result: PointResult) -> dict[str, Caption]:
    """A caption for each figure."""
    estimate, rows = result.estimate, result.frequencies
    n = len(rows)
    listed = "; ".join(f"frequency {i}: {100.0 * row.residual:+.2f} %" for i, row in enumerate(rows, 1))
    band = ""
    if math.isfinite(estimate.noise):
        source = "inferred from these bars" if estimate.noise_is_inferred else "of the plate file"
        band = (
            f" The grey band is two standard deviations of the noise, {source}: a bar that leaves the band "
            "is not explained by noise."
        )
    drawn = {
        "predicted_against_measured": Caption(
            "Each point is a mode; on the line the plate model repeats the measured frequency. A point far "
            "from the line is a mode that the model gets wrong, or a frequency paired with another mode.",
            f"Predicted against measured frequencies of {n} modes with the line of equality.",
        ),
        "residuals": Caption(
            "What is left of each frequency after the fit: a bar above zero is predicted too high, one below "
            f"too low.{band}",
            f"Residuals of {n} modes in percent. {listed}.",
        ),
    }
    drawn["modes"] = modes_caption([(row.measured, row.label or row.kind) for row in rows])
    drawn |= assurance_captions(estimate.by_shape)
    if len(result.optima) > 1:
        best = significant(result.optima[0][0].value, 3)
        drawn["optima"] = Caption(
            "Each line is an optimum that the noise does not tell from the best one, across the search "
            "interval of each constant. Where lines part, the constant has more than one possible value.",
            f"{len(result.optima)} optima across the search intervals; the best has F = {best}.",
        )
    return drawn
