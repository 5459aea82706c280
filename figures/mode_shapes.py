"""Mode shapes of C1 and D3 with their kinds, labels and frequencies.

python figures/mode_shapes.py [--help]
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from journal import BLACK, DARK, DOUBLE_MM, ORANGE, Drawing, Picture, figure, subscripts
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.ndimage import zoom

COLUMNS = {6: 3, 10: 5}
OUTLINE, HELD, MOVED = DARK, BLACK, ORANGE
# In-plane modes: every STRIDE-th grid line is drawn, displaced by at most this part of the shorter side.
STRIDE, LARGEST = 4, 0.13
# Refinement, since crossing nodal lines look torn on a coarse grid, and number of colour steps.
FINER = 6
LEVELS = 20


def pictures(found: dict[str, Any]) -> list[Picture]:
    return [_picture(name, plate) for name, plate in found["shapes"].items()]


def _picture(name: str, plate: Mapping[str, Any]) -> Picture:
    modes = plate["modes"]
    in_plane = any("w" not in mode for mode in modes)
    lowest, highest = (modes[i]["frequency_hz"] for i in (0, -1))
    return Picture(
        f"mode_shapes_{name}",
        _plate(name, plate),
        f"Mode shapes of {name}, {plate['layup']}, edges {plate['edges']}: {len(modes)} modes from "
        f"{lowest:.1f} to {highest:.1f} Hz.",
        f"The plate is {plate['length_mm']:g} x {plate['width_mm']:g} mm. Colour: deflection w, up red, "
        "down blue; black: nodal lines"
        + ("; grid: displacement in the plane, undeformed in grey" if in_plane else "")
        + ". Thick edges are clamped. Above each mode its number, frequency, kind, and the numbers of nodal "
        "lines that are crossed along x and along y.",
    )


def _plate(name: str, plate: Mapping[str, Any]) -> Figure:
    modes, size = plate["modes"], (plate["length_mm"], plate["width_mm"])
    columns = COLUMNS.get(len(modes), 3)
    rows = -(-len(modes) // columns)
    wide = min(DOUBLE_MM / columns, 45.0)
    tall = wide * size[1] / size[0]
    new = figure(DOUBLE_MM, rows * (tall + 12) + 8)
    new.suptitle(
        f"{name}: {subscripts(plate['layup'])}, {size[0]:g} x {size[1]:g} mm, edges {plate['edges']}"
    )
    for i, (axes, mode) in enumerate(zip(new.subplots(rows, columns).ravel(), modes, strict=True), 1):
        (_deflection if "w" in mode else _in_plane)(axes, mode, size)
        _edges(axes, plate["edges"], size)
        axes.set_aspect("equal")
        axes.set_axis_off()
        margin = 0.02 * min(size)
        # leaves room for the width of the outline
        axes.set(xlim=(-margin, size[0] + margin), ylim=(-margin, size[1] + margin))
        axes.set_title(f"{i}   {mode['frequency_hz']:.1f} Hz\n{mode['kind']} {mode['label']}", fontsize=7.5)
    return new


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
        axes.contour(x, y, w.T, [0.0], colors="black", linewidths=1.0)


def _in_plane(axes: Axes, mode: Mapping[str, Any], size: tuple[float, float]) -> None:
    u, v = np.array(mode["u"], dtype=float), np.array(mode["v"], dtype=float)
    largest = np.hypot(u, v).max()
    x, y = np.meshgrid(*(np.linspace(0, s, n) for s, n in zip(size, u.shape, strict=True)), indexing="ij")
    for scale, color, width in ((0.0, "0.8", 0.7), (LARGEST * min(size) / largest, MOVED, 1.0)):
        px, py = x + scale * u, y + scale * v
        axes.plot(px[:, ::STRIDE], py[:, ::STRIDE], color=color, linewidth=width, clip_on=False)
        axes.plot(px[::STRIDE].T, py[::STRIDE].T, color=color, linewidth=width, clip_on=False)


def _edges(axes: Axes, edges: str, size: tuple[float, float]) -> None:
    """Draw the outline, with clamped edges thick and simply supported ones dashed."""
    a, b = size
    lines = (((0, 0), (0, b)), ((0, a), (0, 0)), ((a, a), (0, b)), ((0, a), (b, b)))
    widths = {"F": 0.8, "S": 1.6, "C": 3.2}
    for (x, y), condition in zip(lines, edges, strict=True):
        style = "--" if condition == "S" else "-"
        color = OUTLINE if condition == "F" else HELD
        axes.plot(x, y, style, color=color, linewidth=widths[condition], solid_capstyle="butt")


draw = Drawing(__file__, "02_agreement", "no random numbers", pictures)

if __name__ == "__main__":
    draw.main()
