"""How far Ritz, finite elements and bricks are apart.

python figures/02_agreement.py
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

HERE = Path(__file__).parent
RESULTS = HERE.parent / "studies" / "results"

DPI = 100
ELEMENTS, BRICKS, LIMIT = "#c1440e", "#4878a8", "#333333"


def draw(results: Path = RESULTS, folder: Path = HERE) -> list[Path]:
    """Draw the picture from the study's results in one folder into another."""
    found = json.loads((results / "02_agreement.json").read_text(encoding="utf-8"))
    limit = found["limit_percent"]
    figure = Figure(figsize=(13.0, 8.0), layout="constrained")
    left, right = figure.subfigures(1, 2, width_ratios=(1.0, 1.5), wspace=0.02)
    _specimens(left.subplots(), [*found["specimens"], *found["unsymmetric"]], limit)
    right.suptitle("All combinations of edges: elements against Ritz, % of the worst mode", fontsize=11)
    grids = right.subplots(2, 2, squeeze=False).ravel()
    drawn = [_edges(axes, plate, limit) for axes, plate in zip(grids, found["edges"], strict=False)]
    for axes in grids[len(drawn) :]:
        axes.set_axis_off()
    bar = right.colorbar(drawn[0], ax=grids, shrink=0.6, extend="max")
    bar.set_label(f"| deviation |, %; more than {limit:g} is boxed and fails")
    path = folder / "02_agreement.png"
    FigureCanvasAgg(figure)
    figure.savefig(path, dpi=DPI)
    return [path]


def _specimens(axes: Axes, rows: list[dict[str, Any]], limit: float) -> None:
    places = range(len(rows))
    axes.axvspan(-limit, limit, color="0.93", label=f"{limit:g} %, the limit for elements")
    bricks = [(i, r["bricks"]["worst_percent"]) for i, r in enumerate(rows) if r["bricks"]]
    if bricks:
        y, x = zip(*bricks, strict=True)
        axes.plot(x, y, "s", ms=6, color=BRICKS, label="CalculiX bricks, three-dimensional")
    elements = [r["worst_percent"] for r in rows]
    axes.plot(elements, places, "o", ms=7, color=ELEMENTS, label="finite elements, the same theory")
    axes.axvline(0, color=LIMIT, linewidth=0.8)
    axes.set_yticks(places, [_name(r) for r in rows], fontsize=9)
    axes.set(ylim=(len(rows) - 0.5, -0.5), xlabel="worst mode: frequency / Ritz - 1, %")
    axes.set_title("Built-in plates, and four with B not zero", fontsize=11)
    axes.grid(axis="y", color="0.92")
    axes.set_axisbelow(True)
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.tick_params(axis="y", length=0)
    axes.legend(loc="upper center", bbox_to_anchor=(0.4, -0.08), fontsize=9, frameon=False)


def _name(row: Mapping[str, Any]) -> str:
    return f"{row['plate']}  {_subscripts(row['layup'])}  {row['edges']}  {row['modes']} modes"


def _subscripts(layup: str) -> str:
    return re.sub(r"_(\w+)", r"$_{\1}$", layup)


def _edges(axes: Axes, plate: Mapping[str, Any], limit: float) -> AxesImage:
    """Deviations over the conditions of the edges across x and across y."""
    worst = {}
    for r in plate["rows"]:
        x0, y0, x1, y1 = r["edges"]
        worst[x0 + x1, y0 + y1] = abs(r["worst_percent"])
        if not plate["mirrored"]:  # the same plate turned by 180 degrees
            worst[x1 + x0, y1 + y0] = abs(r["worst_percent"])
    names = sorted({pair for pairs in worst for pair in pairs}, key=lambda p: ["FSC".index(e) for e in p])
    values = np.array([[worst.get((across_x, across_y), np.nan) for across_y in names] for across_x in names])
    image = axes.imshow(values, cmap="YlOrRd", vmin=0.0, vmax=limit)
    for i, j in np.argwhere(np.isfinite(values)):
        v = values[i, j]
        box = {"edgecolor": "black", "facecolor": "none", "pad": 2} if v > limit else None
        color = "white" if v > 0.7 * limit else "black"
        axes.text(j, i, f"{v:.3f}"[1:], ha="center", va="center", fontsize=7, color=color, bbox=box)
    axes.set_xticks(range(len(names)), names, fontsize=8)
    axes.set_yticks(range(len(names)), names, fontsize=8)
    axes.set_xlabel("edges y = 0, y = width", fontsize=8)
    axes.set_ylabel("edges x = 0, x = length", fontsize=8)
    modes = plate["rows"][0]["modes"]
    axes.set_title(f"{plate['plate']} with {_subscripts(plate['layup'])}, {modes} modes", fontsize=10)
    return image


if __name__ == "__main__":
    for _path in draw():
        print(_path.name)
