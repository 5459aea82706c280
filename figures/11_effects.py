"""What every cause does to the modes of a plate, and what of it the constants leave to be seen.

python figures/11_effects.py
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

HERE = Path(__file__).parent
RESULTS = HERE.parent / "studies" / "results"

DPI = 110
COLUMNS = 4
GREY, ORANGE = "#a8a8a8", "#c1440e"


def draw(results: Path = RESULTS, folder: Path = HERE) -> list[Path]:
    """Draw one panel a cause from the study's results in one folder into another."""
    found = json.loads((results / "11_effects.json").read_text(encoding="utf-8"))
    effects = found["effects"]
    rows = -(-len(effects) // COLUMNS)
    figure = Figure(figsize=(11.0, 1.75 * rows + 0.8), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(rows, COLUMNS, squeeze=False).ravel()
    for axes, effect in zip(grid, effects, strict=False):
        _panel(axes, effect, found["plates"][effect["plate"]]["labels"])
    for axes in grid[len(effects) :]:
        axes.set_axis_off()
    handles, labels = grid[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False, fontsize=9)
    figure.suptitle("Relative shift of each mode in %, by one standard deviation of every cause", fontsize=11)
    path = folder / "11_effects.png"
    figure.savefig(path, dpi=DPI)
    return [path]


def _panel(axes: Axes, effect: dict[str, Any], labels: list[str]) -> None:
    shift, left = (np.array(effect[key]) for key in ("shift_percent", "projected_percent"))
    x = np.arange(len(shift))
    axes.bar(x - 0.2, shift, 0.38, color=GREY, label="shift")
    axes.bar(x + 0.2, left, 0.38, color=ORANGE, label="left when the constants have taken what they can")
    axes.axhline(0.0, color="0.4", linewidth=0.7)
    axes.set_xticks(x, [_short(label) for label in labels[: len(x)]], fontsize=6)
    axes.tick_params(axis="y", labelsize=7)
    axes.locator_params(axis="y", nbins=4)
    axes.margins(y=0.12)
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_title(f"{effect['cause']}, {_size(effect)}, {effect['plate']}", fontsize=8)


def _size(effect: dict[str, Any]) -> str:
    if effect["unit"] == "mode":
        return f"mode {effect['size']:g} missed"
    return f"{effect['size']:g} {effect['unit']}".strip()


def _short(label: str) -> str:
    """A label in the space of a bar: its numbers, a combination in two lines."""
    return label.replace("(", "").replace(")", "").replace("+", "\n")


if __name__ == "__main__":
    for _path in draw():
        print(_path.name)
