"""Figures of single commands, as PNG and SVG. The only module of the package that draws."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from scipy.ndimage import zoom

from cpam_bayes.identification.point import Identification
from cpam_bayes.report.forward.screen import Array, ForwardAnswer, ModeShape

__all__ = ["identification_figures", "mode_figures", "save_figures"]

_DPI = 150
_COLUMNS = 5
_MEASURED, _PREDICTED = "#333333", "#c1440e"
# Every so many grid lines of an in-plane mode are drawn, moved by so much of the plate's size.
_STRIDE, _MOVED = 5, 0.12
# Nodal lines that cross are drawn on a grid so many times finer.
_FINER = 4


def save_figures(figures: Mapping[str, Figure], directory: Path) -> None:
    """Write each figure as NAME.png and NAME.svg; the same figure gives the same bytes."""
    for name, figure in figures.items():
        FigureCanvasAgg(figure)
        figure.savefig(directory / f"{name}.png", dpi=_DPI)
        # One salt for two figures would give them the same element names on one page.
        with mpl.rc_context({"svg.hashsalt": name}):
            figure.savefig(directory / f"{name}.svg", metadata={"Date": None})


def identification_figures(result: Identification) -> dict[str, Figure]:
    """Predicted against measured frequencies, and the residual of each mode."""
    measurement = result.specimen.measurement
    assert measurement is not None
    measured = measurement.frequencies
    predicted = np.array([mode.frequency for mode in result.predicted])
    names = [f"{i}\n{mode.label}" for i, mode in enumerate(result.predicted, 1)]

    pairs = Figure(figsize=(5.2, 5.0), layout="constrained")
    axes = pairs.add_subplot()
    ends = (0.0, 1.12 * float(max(measured.max(), predicted.max())))
    axes.plot(ends, ends, color="0.6", linewidth=1, label="predicted = measured")
    axes.plot(measured, predicted, "o", color=_PREDICTED, markersize=6, label="modes")
    for i, (x, y, mode) in enumerate(zip(measured, predicted, result.predicted, strict=True)):
        # To the right and to the left in turn: close modes would write over each other.
        place, side = ((7, -8), "left") if i % 2 == 0 else ((-7, 3), "right")
        axes.annotate(mode.label, (x, y), place, textcoords="offset points", ha=side, fontsize="small")
    axes.set(xlim=ends, ylim=ends, xlabel="measured, Hz", ylabel="predicted, Hz", aspect="equal")
    axes.set_title(f"{result.specimen.name}: predicted against measured")
    axes.legend(loc="upper left", frameon=False)

    residuals = Figure(figsize=(max(5.2, 0.8 * len(names)), 3.6), layout="constrained")
    axes = residuals.add_subplot()
    if np.isfinite(result.noise):
        two = 200.0 * result.noise
        source = "inferred from the residuals" if result.noise_is_inferred else "from the file"
        axes.axhspan(-two, two, color="0.9", label=f"2 standard deviations of the noise, {source}")
        axes.legend(loc="upper left", frameon=False, fontsize="small")
    axes.axhline(0.0, color="0.5", linewidth=1)
    axes.bar(np.arange(len(names)), 100.0 * (predicted / measured - 1.0), 0.5, color=_PREDICTED)
    axes.set_xticks(np.arange(len(names)), names)
    axes.set(xlabel="mode", ylabel="predicted / measured - 1, %")
    axes.margins(y=0.25)
    axes.set_title(f"{result.specimen.name}: residuals, rms {100.0 * result.rms:.2f} %")
    return {"predicted_against_measured": pairs, "residuals": residuals}


def mode_figures(result: ForwardAnswer) -> dict[str, Figure]:
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
        axes.contour(off.T.astype(float), [0.5], colors=_MEASURED, linewidths=0.8, extent=extent)
        return
    x0, x1, y0, y1 = extent
    axes.plot((x0, x1, x1, x0, x0), (y0, y0, y1, y1, y0), color=_MEASURED, linewidth=0.8)


def _draw_grid(
    axes: Axes, shape: ModeShape, along_x: tuple[float, float], along_y: tuple[float, float]
) -> None:
    n_x, n_y = shape.u.shape
    x, y = np.meshgrid(np.linspace(*along_x, n_x), np.linspace(*along_y, n_y), indexing="ij")
    largest = float(np.nanmax(np.hypot(shape.u, shape.v)))
    scale = _MOVED * min(np.ptp(along_x), np.ptp(along_y)) / largest
    for moved, color in ((0.0, "0.8"), (scale, _PREDICTED)):
        px, py = x + moved * shape.u, y + moved * shape.v
        for i in range(0, n_x, _STRIDE):
            axes.plot(px[i], py[i], color=color, linewidth=0.8)
        for j in range(0, n_y, _STRIDE):
            axes.plot(px[:, j], py[:, j], color=color, linewidth=0.8)
