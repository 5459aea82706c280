"""Mode shapes of C1 and D3 with their kinds, labels and frequencies.

python figures/mode_shapes.py
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
from scipy.ndimage import zoom

HERE = Path(__file__).parent
RESULTS = HERE.parent / "studies" / "results"

DPI = 110
COLUMNS = {6: 3, 10: 5}
OUTLINE, HELD, MOVED = "#333333", "#111111", "#c1440e"
# Every so many grid lines of an in-plane mode are drawn, moved by so much of the shorter side.
STRIDE, LARGEST = 4, 0.13
# Nodal lines that cross look torn on a coarse grid. Steps of colour.
FINER = 6
LEVELS = 20


def draw(results: Path = RESULTS, folder: Path = HERE) -> list[Path]:
    """Draw one picture a plate from the study's results in one folder into another."""
    found = json.loads((results / "02_agreement.json").read_text(encoding="utf-8"))
    written = []
    for name, plate in found["shapes"].items():
        path = folder / f"mode_shapes_{name}.png"
        figure = _plate(name, plate)
        FigureCanvasAgg(figure)
        figure.savefig(path, dpi=DPI)
        written.append(path)
    return written


def _plate(name: str, plate: Mapping[str, Any]) -> Figure:
    modes, size = plate["modes"], (plate["length_mm"], plate["width_mm"])
    columns = COLUMNS.get(len(modes), 3)
    rows = -(-len(modes) // columns)
    wide = 2.6
    tall = wide * size[1] / size[0]
    figure = Figure(figsize=(wide * columns, rows * (tall + 0.5) + 0.6), layout="constrained")
    drawn = "colour: deflection w, its nodal lines black"
    if any("w" not in mode for mode in modes):
        drawn += "; grid: displacement in the plane"
    layup = re.sub(r"_(\w+)", r"$_{\1}$", plate["layup"])
    title = f"{name}: {layup}, {size[0]:g} x {size[1]:g} mm, edges {plate['edges']}"
    figure.suptitle(f"{title}\n{drawn}", fontsize=10)
    for i, (axes, mode) in enumerate(zip(figure.subplots(rows, columns).ravel(), modes, strict=True), 1):
        (_deflection if "w" in mode else _in_plane)(axes, mode, size)
        _edges(axes, plate["edges"], size)
        axes.set_aspect("equal")
        axes.set_axis_off()
        margin = 0.02 * min(size)
        # for the width of the outline
        axes.set(xlim=(-margin, size[0] + margin), ylim=(-margin, size[1] + margin))
        axes.set_title(f"{i}   {mode['frequency_hz']:.1f} Hz\n{mode['kind']} {mode['label']}", fontsize=9)
    return figure


def _deflection(axes: Axes, mode: Mapping[str, Any], size: tuple[float, float]) -> None:
    w = zoom(np.array(mode["w"], dtype=float), FINER, order=3)
    # a vector's sign is arbitrary: the first of the largest deflections is drawn upwards
    large = np.flatnonzero(np.abs(w) > 0.99 * np.abs(w).max())
    w /= w.flat[large[0]]
    x, y = (np.linspace(0.0, s, n) for s, n in zip(size, w.shape, strict=True))
    axes.contourf(x, y, w.T, np.linspace(-1, 1, LEVELS + 1), cmap="RdBu_r", extend="both")
    # a clamped edge is zero all along, which is no nodal line
    inside = np.abs(w) > 1e-3
    if w[inside].min() < 0.0:
        axes.contour(x, y, w.T, [0.0], colors="black", linewidths=1.4)


def _in_plane(axes: Axes, mode: Mapping[str, Any], size: tuple[float, float]) -> None:
    u, v = np.array(mode["u"], dtype=float), np.array(mode["v"], dtype=float)
    largest = np.hypot(u, v).max()
    x, y = np.meshgrid(*(np.linspace(0, s, n) for s, n in zip(size, u.shape, strict=True)), indexing="ij")
    for scale, color, width in ((0.0, "0.8", 0.7), (LARGEST * min(size) / largest, MOVED, 1.0)):
        px, py = x + scale * u, y + scale * v
        axes.plot(px[:, ::STRIDE], py[:, ::STRIDE], color=color, linewidth=width, clip_on=False)
        axes.plot(px[::STRIDE].T, py[::STRIDE].T, color=color, linewidth=width, clip_on=False)


def _edges(axes: Axes, edges: str, size: tuple[float, float]) -> None:
    """The outline, clamped edges thick, simply supported ones dashed."""
    a, b = size
    lines = (((0, 0), (0, b)), ((0, a), (0, 0)), ((a, a), (0, b)), ((0, a), (b, b)))
    widths = {"F": 0.8, "S": 2.0, "C": 4.0}
    for (x, y), condition in zip(lines, edges, strict=True):
        style = "--" if condition == "S" else "-"
        color = OUTLINE if condition == "F" else HELD
        axes.plot(x, y, style, color=color, linewidth=widths[condition], solid_capstyle="butt")


if __name__ == "__main__":
    for _path in draw():
        print(_path.name)
