"""Worked cases from bricks: residuals before and after, and how probable each cause is.

python figures/17_worked_cases.py
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Patch

HERE = Path(__file__).parent
RESULTS = HERE.parent / "studies" / "results"

DPI = 90
GREY, ORANGE, GREEN = "#a8a8a8", "#c1440e", "#3f7d3f"
COLUMNS = 2
BEFORE = "residual of the plain model, %"
AFTER = "residual of the extended model, %, where something is claimed"
MOST_CAUSES = 5


def draw(results: Path = RESULTS, folder: Path = HERE) -> list[Path]:
    """Draw two panels a case from the study's results in one folder into another."""
    cases = json.loads((results / "17_worked_cases.json").read_text(encoding="utf-8"))["cases"]
    rows = -(-len(cases) // COLUMNS)
    figure = Figure(figsize=(12.5, 1.75 * rows + 0.7), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(rows, 2 * COLUMNS, squeeze=False, width_ratios=(1.4, 1.0) * COLUMNS)
    for k, case in enumerate(cases):
        left, right = grid[k // COLUMNS, 2 * (k % COLUMNS) : 2 * (k % COLUMNS) + 2]
        _residuals(left, case)
        _probabilities(right, case)
    for axes in grid.ravel()[2 * len(cases) :]:
        axes.set_axis_off()
    handles = [Patch(color=GREY, label=BEFORE), Patch(color=ORANGE, label=AFTER)]
    figure.legend(handles=handles, loc="outside lower center", ncols=2, frameon=False, fontsize=9)
    path = folder / "17_worked_cases.png"
    figure.savefig(path, dpi=DPI)
    return [path]


def _residuals(axes: Axes, case: dict[str, Any]) -> None:
    before = _numbers(case["residuals_percent_before"])
    x = np.arange(1, len(before) + 1)
    after = case["residuals_percent_after"]
    axes.bar(x - 0.2, before, 0.38, color=GREY)
    extended = np.zeros(0) if after is None else _numbers(after)
    axes.bar(x[: len(extended)] + 0.2, extended, 0.38, color=ORANGE)
    axes.axhline(0.0, color="0.4", linewidth=0.7)
    axes.tick_params(labelsize=7)
    axes.set_xticks(x)
    axes.set_title(f"{case['case']}: {_short(case['truth']['size'])}", fontsize=8, loc="left")
    axes.spines[["top", "right"]].set_visible(False)


def _probabilities(axes: Axes, case: dict[str, Any]) -> None:
    true = case["truth"]["cause"]
    shown = case["hypotheses"][:MOST_CAUSES]
    shown += [h for h in case["hypotheses"][MOST_CAUSES:] if h["cause"] == true]
    y = -np.arange(len(shown))
    p = np.array([h["probability"] for h in shown])
    axes.barh(y, p, 0.65, color=[GREEN if h["cause"] == true else GREY for h in shown])
    names = [h["cause"] + (" (true)" if h["cause"] == true else "") for h in shown]
    axes.set_yticks(y, names, fontsize=7)
    axes.set_xlim(0.0, 1.0)
    axes.tick_params(axis="x", labelsize=7)
    axes.set_title(f"{case['claim']} {case['probability']:.2f}: {case['verdict']}", fontsize=8, loc="left")
    axes.spines[["top", "right"]].set_visible(False)


def _numbers(values: list[float | None]) -> np.ndarray:
    return np.array([np.nan if v is None else v for v in values])


def _short(text: str) -> str:
    return text if len(text) <= 62 else text[:60] + " ..."


if __name__ == "__main__":
    for _path in draw():
        print(_path.name)
