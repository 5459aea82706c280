"""Figures of `identify` by the swarm: predicted against measured frequencies, residuals."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from cpam_bayes.formatting import significant
from cpam_bayes.identification.identify import PointResult
from cpam_bayes.plate import to_user, unit_of
from cpam_bayes.report.figures import PREDICTED
from cpam_bayes.report.modal_assurance.figure import assurance_figures
from cpam_bayes.report.mode_shapes import extent_of, shapes_figure


def figures(result: PointResult) -> dict[str, Figure]:
    """Predicted against measured frequencies, and the residual of each mode."""
    estimate, frequencies = result.estimate, result.frequencies
    measured = np.array([row.measured for row in frequencies])
    predicted = np.array([row.predicted for row in frequencies])
    names = [f"{i}\n{row.label}" for i, row in enumerate(frequencies, 1)]

    pairs = Figure(figsize=(5.2, 5.0), layout="constrained")
    axes = pairs.add_subplot()
    ends = (0.0, 1.12 * float(max(measured.max(), predicted.max())))
    axes.plot(ends, ends, color="0.6", linewidth=1, label="predicted = measured")
    axes.plot(measured, predicted, "o", color=PREDICTED, markersize=6, label="modes")
    for i, row in enumerate(frequencies):
        # To the right and to the left in turn: close modes would write over each other.
        place, side = ((7, -8), "left") if i % 2 == 0 else ((-7, 3), "right")
        axes.annotate(
            row.label,
            (row.measured, row.predicted),
            place,
            textcoords="offset points",
            ha=side,
            fontsize="small",
        )
    axes.set(xlim=ends, ylim=ends, xlabel="measured, Hz", ylabel="predicted, Hz", aspect="equal")
    axes.set_title(f"{result.specimen.name}: predicted against measured")
    axes.legend(loc="upper left", frameon=False)

    residuals = Figure(figsize=(max(5.2, 0.8 * len(names)), 3.6), layout="constrained")
    axes = residuals.add_subplot()
    if np.isfinite(estimate.noise):
        two = 200.0 * estimate.noise
        source = "inferred from the residuals" if estimate.noise_is_inferred else "from the file"
        axes.axhspan(-two, two, color="0.9", label=f"2 standard deviations of the noise, {source}")
        axes.legend(loc="upper left", frameon=False, fontsize="small")
    axes.axhline(0.0, color="0.5", linewidth=1)
    axes.bar(np.arange(len(names)), 100.0 * (predicted / measured - 1.0), 0.5, color=PREDICTED)
    axes.set_xticks(np.arange(len(names)), names)
    axes.set(xlabel="mode", ylabel="predicted / measured - 1, %")
    axes.margins(y=0.25)
    axes.set_title(f"{result.specimen.name}: residuals, rms {100.0 * estimate.rms:.2f} %")
    drawn = {"predicted_against_measured": pairs, "residuals": residuals, "modes": _modes(result)}
    drawn |= assurance_figures(result.specimen.name, estimate.by_shape, result.specimen.measurement)
    return drawn if len(result.optima) < 2 else {**drawn, "optima": _optima(result)}


def _modes(result: PointResult) -> Figure:
    """The shape of the mode that each measured frequency belongs to."""
    plate, rows = result.specimen.plate, result.frequencies
    return shapes_figure(
        f"{result.specimen.name}: modes of the measured frequencies",
        [f"{i}: {row.measured:g} Hz measured\n{row.kind} {row.label}" for i, row in enumerate(rows, 1)],
        list(result.estimate.shapes),
        [mode.in_plane_fraction > 0.5 for mode in result.estimate.predicted],
        extent_of(plate.length, plate.width),
        plate.edges,
    )


def _optima(result: PointResult) -> Figure:
    """Where in its search interval each constant lies at every optimum that the noise leaves open."""
    constants = result.estimate.constants
    figure = Figure(figsize=(5.8, 0.55 * len(constants) + 1.9), layout="constrained")
    axes = figure.add_subplot()
    for k, (optimum, values) in enumerate(result.optima):
        share = [(values[c.name] - c.lower) / (c.upper - c.lower) for c in constants]
        best = k == 0
        axes.plot(
            share,
            range(len(constants)),
            "o-" if best else "s--",
            color=PREDICTED if best else "0.55",
            markersize=7 if best else 4,
            linewidth=1.2 if best else 0.8,
            zorder=3 if best else 2,
            label=f"{'best' if best else 'other'}, F = {significant(optimum.value, 3)}" if k < 5 else None,
        )
        if best:
            for i, (x, c) in enumerate(zip(share, constants, strict=True)):
                text = f"{to_user(c.name, values[c.name]):.4g} {unit_of(c.name)}".rstrip()
                axes.annotate(text, (x, i), (0, 7), textcoords="offset points", ha="center", fontsize="small")
    axes.set_yticks(range(len(constants)), [c.name for c in constants])
    axes.set(xlim=(-0.03, 1.03), ylim=(len(constants) - 0.4, -0.7), xlabel="place in the search interval")
    axes.grid(axis="x", color="0.9")
    axes.set_title(f"{result.specimen.name}: optima that the noise does not tell apart")
    figure.legend(loc="outside lower center", ncols=3, frameon=False, fontsize="small")
    return figure
