"""Figures of `identify` by the swarm: predicted against measured frequencies, residuals."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from cpam_bayes.identification.identify import PointResult
from cpam_bayes.report.figures import PREDICTED


def figures(result: PointResult) -> dict[str, Figure]:
    """Predicted against measured frequencies, and the residual of each mode."""
    estimate, frequencies = result.estimate, result.frequencies
    measured = np.array([row.measured for row in frequencies])
    predicted = np.array([row.predicted for row in frequencies])
    names = [f"{i}\n{row.label}" for i, row in enumerate(frequencies, 1)]

    pairs = Figure(figsize=(5.2, 5.0), layout="constrained")
    axes = pairs.add_subplot()
    ends = (0.0, 1.12 * float(max(measured.max(), predicted.max())))
    axes.plot(ends, ends, color="0.6", linewidth=1, label="predicted = measured")
    axes.plot(measured, predicted, "o", color=PREDICTED, markersize=6, label="modes")
    for i, row in enumerate(frequencies):
        # To the right and to the left in turn: close modes would write over each other.
        place, side = ((7, -8), "left") if i % 2 == 0 else ((-7, 3), "right")
        axes.annotate(
            row.label,
            (row.measured, row.predicted),
            place,
            textcoords="offset points",
            ha=side,
            fontsize="small",
        )
    axes.set(xlim=ends, ylim=ends, xlabel="measured, Hz", ylabel="predicted, Hz", aspect="equal")
    axes.set_title(f"{result.specimen.name}: predicted against measured")
    axes.legend(loc="upper left", frameon=False)

    residuals = Figure(figsize=(max(5.2, 0.8 * len(names)), 3.6), layout="constrained")
    axes = residuals.add_subplot()
    if np.isfinite(estimate.noise):
        two = 200.0 * estimate.noise
        source = "inferred from the residuals" if estimate.noise_is_inferred else "from the file"
        axes.axhspan(-two, two, color="0.9", label=f"2 standard deviations of the noise, {source}")
        axes.legend(loc="upper left", frameon=False, fontsize="small")
    axes.axhline(0.0, color="0.5", linewidth=1)
    axes.bar(np.arange(len(names)), 100.0 * (predicted / measured - 1.0), 0.5, color=PREDICTED)
    axes.set_xticks(np.arange(len(names)), names)
    axes.set(xlabel="mode", ylabel="predicted / measured - 1, %")
    axes.margins(y=0.25)
    axes.set_title(f"{result.specimen.name}: residuals, rms {100.0 * estimate.rms:.2f} %")
    return {"predicted_against_measured": pairs, "residuals": residuals}
