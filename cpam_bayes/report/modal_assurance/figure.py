"""The matrix of modal assurance."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from cpam_bayes.forward_model.mode_shapes.assurance import ShapePairing
from cpam_bayes.plate import Measurement
from cpam_bayes.report.figures import PREDICTED
from cpam_bayes.report.modal_assurance.rows import FIGURE

__all__ = ["assurance_figures"]

# Numbers are written in the squares of matrices up to this size; candidates are marked from this probability.
_MOST_WRITTEN, _MARKED = 20, 0.01


def assurance_figures(
    title: str, pairing: ShapePairing | None, measurement: Measurement | None
) -> dict[str, Figure]:
    """Measured shapes against modes, none without shapes."""
    if pairing is None or measurement is None:
        return {}
    n, k = pairing.assurance.shape
    figure = Figure(figsize=(1.9 + 0.42 * k, 1.5 + 0.36 * n), layout="constrained")
    axes = figure.add_subplot()
    image = axes.imshow(pairing.assurance, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    figure.colorbar(image, ax=axes, label="modal assurance")
    axes.set_xticks(
        range(k), [f"{m.label} {m.frequency:.4g}" for m in pairing.candidates], rotation=90, fontsize=8
    )
    axes.set_yticks(range(n), [f"{f:.5g}" for f in measurement.frequencies], fontsize=8)
    axes.set(xlabel="mode of the model, Hz", ylabel="measured, Hz")
    axes.set_title(f"{title}: measured shapes and the model's", fontsize=10)
    if max(n, k) <= _MOST_WRITTEN:
        for (i, j), value in np.ndenumerate(pairing.assurance):
            if value >= 0.05:
                color = "white" if value > 0.6 else "0.2"
                axes.text(j, i, f"{value:.2f}", ha="center", va="center", fontsize=6, color=color)
    for i, j in np.argwhere(pairing.probability >= _MARKED):
        colour = PREDICTED if pairing.modes[i] == j else "0.45"
        axes.plot(j, i, "o", markersize=19, markerfacecolor="none", markeredgecolor=colour)
    return {FIGURE: figure}
