"""The figure of `poles`: the stability diagram."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from cpam_bayes.modal_analysis.poles import PolesResult
from cpam_bayes.report.figures import MEASURED, PREDICTED


def figures(result: PolesResult) -> dict[str, Figure]:
    """Poles by order over the responses."""
    found, responses = result.stabilisation, result.responses
    figure = Figure(figsize=(9.0, 4.8), layout="constrained")
    axes = figure.add_subplot()
    behind = axes.twinx()
    shown = (responses.frequencies >= result.low) & (responses.frequencies <= result.high)
    size = np.sqrt(np.mean(np.abs(responses.frf[:, shown]) ** 2, axis=0))
    positive = np.maximum(size, size.max() * 1e-12)
    behind.semilogy(responses.frequencies[shown], positive, color="0.6", linewidth=0.8)
    behind.set_ylabel("root mean square of the responses")
    axes.set_zorder(behind.get_zorder() + 1)
    axes.patch.set_visible(False)
    for mode in result.modes:
        axes.axvline(mode.frequency, color=PREDICTED, linewidth=0.8)
    for stable, filled in ((False, "none"), (True, MEASURED)):
        at = found.stable == stable
        axes.plot(
            found.frequencies[at],
            found.orders[at],
            "o",
            markersize=2.5,
            markerfacecolor=filled,
            markeredgecolor=MEASURED if stable else "0.7",
            markeredgewidth=0.5,
            rasterized=True,
            label="in the order below as well" if stable else "new at this order",
        )
    axes.set(xlim=(result.low, result.high), ylim=(0, result.order + 1), xlabel="Hz", ylabel="poles")
    axes.set_title(f"{result.title}: {len(result.modes)} modes", fontsize=10)
    figure.legend(loc="outside lower center", ncols=2, frameon=False, fontsize="small")
    return {"stability": figure}
