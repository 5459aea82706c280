"""Common parts of all figures: creation and saving, colours, mode shapes.

A mode is drawn as a coloured deflection with its nodal lines, or, in the plane, as a deformed grid.
Matplotlib is loaded when a figure is drawn.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import zoom

from cpam_bayes.plate.edges import conditions

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, FigureBase

_DPI = 150
# Colours by meaning, in all figures: measured; predicted by the model of the answer; by the plain model;
# known before, priors and references.
MEASURED, PREDICTED, BEFORE, REFERENCE = "#333333", "#c1440e", "#4878a8", "#8a8a8a"


def new_figure(width: float, height: float) -> Figure:
    """An empty figure, size in inches, with a constrained layout."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def headed(figure: FigureBase, title: str) -> None:
    """Give a figure its title, on the left, where a narrow screen shows it."""
    figure.suptitle(title, x=0.01, horizontalalignment="left", fontsize=10)


def save_figures(figures: Mapping[str, Figure], directory: Path) -> None:
    """Write each figure as NAME.png and NAME.svg, reproducibly byte for byte."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    for name, figure in figures.items():
        FigureCanvasAgg(figure)
        # A common salt would give elements of two figures on one page the same names.
        with mpl.rc_context({"svg.hashsalt": name}), warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Glyph")  # of a name that the font lacks: a box stands for it
            figure.savefig(directory / f"{name}.png", dpi=_DPI)
            figure.savefig(directory / f"{name}.svg", metadata={"Date": None})


Array = NDArray[Any]
Extent = tuple[float, float, float, float]
"""Limits in x, then in y."""

_COLUMNS = 3
# Grid lines of an in-plane mode along each side, and its displacement as a fraction of the plate.
_LINES, _MOVED = 9, 0.12
# Refinement of the grid on which nodal lines are drawn.
_FINER = 4
# Fraction of the plate next to a held edge without nodal lines.
_BLANK = 0.08


def extent_of(length: float, width: float) -> Extent:
    """The rectangle of a plate, mm, from its sides in m."""
    return 0.0, 1e3 * length, 0.0, 1e3 * width


def shapes_figure(
    title: str,
    headings: Sequence[str],
    shapes: Sequence[Array],
    in_plane: Sequence[bool],
    extent: Extent,
    edges: str,
) -> Figure:
    """All shapes, displacements (3, n, n) each, three to a row."""
    columns = min(_COLUMNS, len(shapes))
    rows = -(-len(shapes) // columns)
    x0, x1, y0, y1 = extent
    tall = float(np.clip((y1 - y0) / (x1 - x0), 0.3, 3.0))
    figure = new_figure(max(2.0 * columns, 3.0), rows * (1.75 * tall + 0.65))
    headed(figure, title)
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes in grid[len(shapes) :]:
        axes.set_axis_off()
    for axes, heading, shape, moves_in_plane in zip(grid, headings, shapes, in_plane, strict=False):
        draw_shape(axes, shape, extent, edges, in_plane=moves_in_plane)
        axes.set_title(heading, fontsize=9)
    return figure


def draw_shape(
    axes: Axes, shape: Array, extent: Extent, edges: str, *, in_plane: bool, linewidth: float = 1.0
) -> None:
    """Draw one shape (3, n, n): u, v and w on a regular grid, NaN off the plate.

    edges : next to held ones no nodal line is drawn, as the deflection there is zero up to rounding.
    """
    axes.set_axis_off()
    if in_plane:
        _draw_grid(axes, shape[0], shape[1], extent, linewidth)
    else:
        _draw_deflection(axes, shape[2], extent, edges, linewidth)
    axes.set_aspect("equal")


def _draw_deflection(axes: Axes, w: Array, extent: Extent, edges: str, linewidth: float) -> None:
    # The sign of a mode is arbitrary; the first of the largest deflections is drawn upwards.
    off = np.isnan(w)
    flat = np.where(off, 0.0, w).ravel()
    large = np.flatnonzero(np.abs(flat) > 0.99 * np.abs(flat).max())
    w = w * np.sign(flat[large[0]]) / np.abs(flat).max()
    axes.imshow(w.T, cmap="RdBu_r", vmin=-1, vmax=1, origin="lower", extent=extent, interpolation="bilinear")
    if np.nanmin(w) < -0.01:
        fine = w.copy() if off.any() else zoom(w, _FINER)
        _blank_held(fine, edges)
        axes.contour(
            fine.T,
            [0.0],
            colors="black",
            linewidths=linewidth,
            extent=extent,
            negative_linestyles="solid",
        )
    if off.any():
        axes.contour(off.T.astype(float), [0.5], colors=MEASURED, linewidths=0.8 * linewidth, extent=extent)
        return
    x0, x1, y0, y1 = extent
    axes.plot((x0, x1, x1, x0, x0), (y0, y0, y1, y1, y0), color=MEASURED, linewidth=0.8 * linewidth)


def _blank_held(w: Array, edges: str) -> None:
    n = max(1, round(_BLANK * len(w)))
    sides = (w[:n], w[:, :n], w[-n:], w[:, -n:])
    for edge, side in zip(conditions(edges), sides, strict=True):
        if not edge.is_free:
            side[...] = np.nan


def _draw_grid(axes: Axes, u: Array, v: Array, extent: Extent, linewidth: float) -> None:
    x0, x1, y0, y1 = extent
    n_x, n_y = u.shape
    x, y = np.meshgrid(np.linspace(x0, x1, n_x), np.linspace(y0, y1, n_y), indexing="ij")
    scale = _MOVED * min(x1 - x0, y1 - y0) / float(np.nanmax(np.hypot(u, v)))
    for moved, color in ((0.0, "0.8"), (scale, PREDICTED)):
        px, py = x + moved * u, y + moved * v
        for i in np.linspace(0, n_x - 1, _LINES).round().astype(int):
            axes.plot(px[i], py[i], color=color, linewidth=0.8 * linewidth)
        for j in np.linspace(0, n_y - 1, _LINES).round().astype(int):
            axes.plot(px[:, j], py[:, j], color=color, linewidth=0.8 * linewidth)
