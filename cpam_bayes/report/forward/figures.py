"""Figures of `forward`: all mode shapes."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.ndimage import zoom

from cpam_bayes.forward_model.solve import Array, ForwardResult, ModeShape
from cpam_bayes.report.figures import MEASURED, PREDICTED

_COLUMNS = 5
# Every so many grid lines of an in-plane mode are drawn, moved by so much of the plate's size.
_STRIDE, _MOVED = 5, 0.12
# Nodal lines that cross are drawn on a grid so many times finer.
_FINER = 4


def figures(result: ForwardResult) -> dict[str, Figure]:
    """All mode shapes: deflection with its nodal lines, or the deformed grid of in-plane modes."""
    plate = result.specimen.plate
    columns = min(_COLUMNS, len(result.modes))
    rows = -(-len(result.modes) // columns)
    extent = result.extent or ((0.0, plate.length), (0.0, plate.width))
    x, y = ((1e3 * low, 1e3 * high) for low, high in extent)
    tall = float(np.clip((y[1] - y[0]) / (x[1] - x[0]), 0.3, 3.0))
    figure = Figure(figsize=(2.3 * columns, rows * (2.0 * tall + 0.7)), layout="constrained")
    figure.suptitle(f"{result.specimen.name}, edges {plate.edges}, {result.solver}")
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for i, axes in enumerate(grid):
        axes.set_axis_off()
        if i >= len(result.modes):
            continue
        mode, shape = result.modes[i], result.shapes[i]
        if mode.in_plane_fraction > 0.5:
            _draw_grid(axes, shape, x, y)
        else:
            _draw_deflection(axes, shape.w, (*x, *y))
        axes.set_aspect("equal")
        axes.set_title(f"{i + 1}: {mode.frequency:.6g} Hz\n{mode.kind} {mode.label}", fontsize="small")
    return {"modes": figure}


def _draw_deflection(axes: Axes, w: Array, extent: tuple[float, float, float, float]) -> None:
    # A vector's sign is arbitrary; the first of the largest deflections is drawn upwards.
    off = np.isnan(w)
    flat = np.where(off, 0.0, w).ravel()
    large = np.flatnonzero(np.abs(flat) > 0.99 * np.abs(flat).max())
    w = w * np.sign(flat[large[0]]) / np.abs(flat).max()
    axes.imshow(w.T, cmap="RdBu_r", vmin=-1, vmax=1, origin="lower", extent=extent, interpolation="bilinear")
    if np.nanmin(w) < -0.01:
        axes.contour(
            (w if off.any() else zoom(w, _FINER)).T,
            [0.0],
            colors="black",
            linewidths=1,
            extent=extent,
            negative_linestyles="solid",
        )
    if off.any():
        axes.contour(off.T.astype(float), [0.5], colors=MEASURED, linewidths=0.8, extent=extent)
        return
    x0, x1, y0, y1 = extent
    axes.plot((x0, x1, x1, x0, x0), (y0, y0, y1, y1, y0), color=MEASURED, linewidth=0.8)


def _draw_grid(
    axes: Axes, shape: ModeShape, along_x: tuple[float, float], along_y: tuple[float, float]
) -> None:
    n_x, n_y = shape.u.shape
    x, y = np.meshgrid(np.linspace(*along_x, n_x), np.linspace(*along_y, n_y), indexing="ij")
    largest = float(np.nanmax(np.hypot(shape.u, shape.v)))
    scale = _MOVED * min(np.ptp(along_x), np.ptp(along_y)) / largest
    for moved, color in ((0.0, "0.8"), (scale, PREDICTED)):
        px, py = x + moved * shape.u, y + moved * shape.v
        for i in range(0, n_x, _STRIDE):
            axes.plot(px[i], py[i], color=color, linewidth=0.8)
        for j in range(0, n_y, _STRIDE):
            axes.plot(px[:, j], py[:, j], color=color, linewidth=0.8)
