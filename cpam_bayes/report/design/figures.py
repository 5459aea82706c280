"""Figures of `design`: maps of the expected information over layups and shapes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cpam_bayes.formatting import listed
from cpam_bayes.specimen_design.candidates import Geometry
from cpam_bayes.specimen_design.design import Candidate, DesignResult

_COLOURS = "Blues"
# Fraction of the greatest value from which a cell is dark, and its number white.
_DARK = 0.6

Value = Callable[[Candidate], float]


def figures(result: DesignResult) -> dict[str, Figure]:
    """A map of the constants asked for together, and one of each constant."""
    drawn = {"information": _map(result, listed(list(result.asked), "and"), lambda c: c.information)}
    if len(result.constants) > 1:
        for k, name in enumerate(result.constants):
            drawn[name] = _map(result, name, lambda c, k=k: float(c.expected.each[k]))  # type: ignore[misc]
    return drawn


def _map(result: DesignResult, what: str, value: Value) -> Figure:
    """Layups upwards, length over width to the right, a row of panels for each edges and thickness."""
    candidates = result.candidates
    tests = list(dict.fromkeys(sorted((_held(c.geometry) for c in candidates), key=str)))
    numbers = sorted({c.n_modes for c in candidates})
    layups = list(dict.fromkeys(c.geometry.layup.text for c in sorted(candidates, key=_place)))
    ratios = sorted({round(c.geometry.ratio, 3) for c in candidates})
    top = max(max(value(c) for c in candidates), 1e-3)
    best = max(candidates, key=value)
    size = (1.5 + len(numbers) * (0.42 * len(ratios) + 0.5), 1.5 + len(tests) * (0.32 * len(layups) + 0.7))
    figure = Figure(figsize=(max(size[0], 5.2), max(size[1], 2.8)), layout="constrained")
    grid = figure.subplots(len(tests), len(numbers), squeeze=False, sharex=True, sharey=True)
    image: Any = None
    for row, held in zip(grid, tests, strict=True):
        for axes, n in zip(row, numbers, strict=True):
            here = [c for c in candidates if _held(c.geometry) == held and c.n_modes == n]
            image = _panel(axes, here, layups, ratios, value, top)
            _mark(axes, here, layups, ratios, best)
            axes.set_title(f"{held[0]}, {1e3 * held[1]:.4g} mm, {n} modes", fontsize=9)
    for axes in grid[-1]:
        axes.set_xticks(range(len(ratios)), [f"{r:.3g}" for r in ratios], fontsize=8)
        axes.set_xlabel("length / width", fontsize=9)
    for axes in grid[:, 0]:
        axes.set_yticks(range(len(layups)), layups, fontsize=8)
    figure.colorbar(image, ax=grid, label="expected information, nats", shrink=0.9)
    figure.suptitle(f"What the frequencies would say about {what}: material of {result.specimen.name}")
    return figure


def _panel(
    axes: Axes, here: list[Candidate], layups: list[str], ratios: list[float], value: Value, top: float
) -> Any:
    cells = np.full((len(layups), len(ratios)), np.nan)
    for c in here:
        cells[_cell(c, layups, ratios)] = value(c)
    image = axes.imshow(cells, cmap=_COLOURS, vmin=0.0, vmax=top, aspect="auto", origin="lower")
    for (i, j), v in np.ndenumerate(cells):
        if np.isfinite(v):
            colour = "white" if v > _DARK * top else "black"
            axes.text(j, i, f"{v:.1f}" if top >= 1.0 else f"{v:.2f}", ha="center", va="center",
                      fontsize=7, color=colour)  # fmt: skip
    return image


def _mark(axes: Axes, here: list[Candidate], layups: list[str], ratios: list[float], best: Candidate) -> None:
    """A frame about the plate as it is, a star at the best specimen."""
    for c in here:
        i, j = _cell(c, layups, ratios)
        if c.is_present:
            frame = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5], [-0.5, -0.5]])
            axes.plot(j + frame[:, 0], i + frame[:, 1], color="#c1440e", linewidth=2, clip_on=False, zorder=4)
        if c is best:
            axes.plot(
                j + 0.36, i + 0.32, "*", color="#e8a33d", markeredgecolor="black", markersize=9, zorder=5
            )


def _cell(c: Candidate, layups: list[str], ratios: list[float]) -> tuple[int, int]:
    return layups.index(c.geometry.layup.text), ratios.index(round(c.geometry.ratio, 3))


def _held(geometry: Geometry) -> tuple[str, float]:
    """Edges and thickness: what a row of panels has in common."""
    return geometry.edges, geometry.thickness


def _place(c: Candidate) -> tuple[bool, str]:
    """The layup of the plate first, the others by their notation."""
    return not c.geometry.is_present, c.geometry.layup.text
