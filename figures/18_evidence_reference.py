"""Marginal likelihoods of the diagnosis less those of a slow reference, over the distance from the best.

python figures/18_evidence_reference.py
"""

from __future__ import annotations

import json
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

HERE = Path(__file__).parent
RESULTS = HERE.parent / "studies" / "results"

DPI = 110
# Agreement that is asked for, nats, and the distance within which it is.
AGREED, NEAR = 0.3, 8.0


def draw(results: Path = RESULTS, folder: Path = HERE) -> list[Path]:
    """Draw the differences of all hypotheses from the study's results."""
    cases = json.loads((results / "18_evidence_reference.json").read_text(encoding="utf-8"))["cases"]
    figure = Figure(figsize=(6.0, 4.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    axes.fill_between((0.0, NEAR), -AGREED, AGREED, color="0.92", zorder=0)
    for case in cases:
        best = max(row["slow"] for row in case["hypotheses"])
        below = [best - row["slow"] for row in case["hypotheses"]]
        difference = [row["fast"] - row["slow"] for row in case["hypotheses"]]
        axes.plot(below, difference, "o", ms=4, color="#1f6f8b" if case["noise_stated"] else "#c1440e")
    axes.axhline(0.0, color="0.4", linewidth=0.7)
    axes.plot([], [], "o", ms=4, color="#1f6f8b", label="noise stated")
    axes.plot([], [], "o", ms=4, color="#c1440e", label="noise inferred")
    if axes.get_legend_handles_labels()[0]:
        axes.legend(frameon=False, fontsize=8)
    axes.set_xscale("symlog", linthresh=NEAR)
    axes.set_yscale("symlog", linthresh=AGREED)
    axes.set(
        xlabel="nats below the best hypothesis", ylabel="quick way less reference, nats", xlim=(-0.3, None)
    )
    axes.spines[["top", "right"]].set_visible(False)
    path = folder / "18_evidence_reference.png"
    figure.savefig(path, dpi=DPI)
    return [path]


if __name__ == "__main__":
    draw()
