"""What the diagnosis finds: probabilities of none, other and the leading causes of every plate.

python figures/12_findings.py
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

HERE = Path(__file__).parent
RESULTS = HERE.parent / "studies" / "results"

DPI = 110
# none, other, the three leading causes, all else
COLOURS = {"none": "#7a9e7e", "other": "#8c8c8c"}
LEADING, REST = ("#c1440e", "#e08e45", "#f2cc8f"), "#e8e8e8"
# Width of a letter on the axis of probabilities.
_OF_A_LETTER = 0.0095


def draw(results: Path = RESULTS, folder: Path = HERE) -> list[Path]:
    """Draw one bar a group of plates from the study's results in one folder into another."""
    groups = json.loads((results / "12_findings.json").read_text(encoding="utf-8"))["groups"]
    figure = Figure(figsize=(10.5, 0.3 * len(groups) + 1.4), layout="constrained")
    FigureCanvasAgg(figure)
    bars, fits = figure.subplots(1, 2, width_ratios=(3.2, 1.0), sharey=True)
    for row, group in enumerate(groups):
        _bar(bars, row, group)
        before = group["baseline"]["rms_percent"]
        fits.plot(before, row, "o", color="#555555", markersize=4)
        if group["extended"] is not None:
            after = group["extended"]["rms_percent"]
            fits.annotate(
                "", (after, row), (before, row), arrowprops={"arrowstyle": "->", "color": LEADING[0]}
            )
    bars.set_yticks(range(len(groups)), [" + ".join(g["plates"]) for g in groups], fontsize=8)
    bars.invert_yaxis()
    bars.set_xlim(0.0, 1.0)
    bars.set_xlabel("probability")
    bars.set_title("none (green), other (grey), the leading causes, the rest (light)", fontsize=9)
    fits.set_xscale("log")
    fits.set_xlim(0.1, 100.0)
    fits.set_xticks((0.1, 1.0, 10.0, 100.0), ("0.1", "1", "10", "100"))
    fits.minorticks_off()
    fits.set_xlabel("rms residual, %;\narrow: to the extended model")
    fits.grid(axis="x", color="0.9")
    for axes in (bars, fits):
        axes.spines[["top", "right"]].set_visible(False)
    path = folder / "12_findings.png"
    figure.savefig(path, dpi=DPI)
    return [path]


def _bar(axes: Axes, row: int, group: dict[str, Any]) -> None:
    by_cause = {h["cause"]: h for h in group["hypotheses"]}
    causes = [c for c in by_cause if c not in COLOURS]
    pieces = [(c, by_cause[c]["probability"], COLOURS[c]) for c in COLOURS if c in by_cause]
    pieces += [(c, by_cause[c]["probability"], LEADING[i]) for i, c in enumerate(causes[:3])]
    left = 0.0
    for cause, probability, colour in pieces:
        axes.barh(row, probability, left=left, color=colour, height=0.72)
        if probability >= _OF_A_LETTER * len(cause) and cause not in COLOURS:
            axes.text(
                left + 0.5 * probability, row, cause, ha="center", va="center", fontsize=7, color="white"
            )
        left += probability
    axes.barh(row, 1.0 - left, left=left, color=REST, height=0.72)


if __name__ == "__main__":
    for _path in draw():
        print(_path.name)
