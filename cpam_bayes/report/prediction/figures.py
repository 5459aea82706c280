"""Figures of `predict`: intervals of the frequencies, mode shapes."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from cpam_bayes.prediction.predict import PredictionResult
from cpam_bayes.report.figures import MEASURED, PREDICTED
from cpam_bayes.report.forward.rows import measured_of_modes
from cpam_bayes.report.mode_shapes import extent_of, shapes_figure


def figures(result: PredictionResult) -> dict[str, Figure]:
    """Intervals relative to the means, and the shapes of the modes."""
    plate = result.specimen.plate
    shapes = shapes_figure(
        f"{result.specimen.name}, edges {plate.edges}: predicted modes",
        [f"{i}: {m.mean:.6g} +- {m.sd:.2g} Hz\n{m.mode.kind} {m.mode.label}"
         for i, m in enumerate(result.modes, 1)],
        list(result.shapes),
        [m.mode.in_plane_fraction > 0.5 for m in result.modes],
        extent_of(plate.length, plate.width),
        plate.edges,
    )  # fmt: skip
    return {"prediction": _intervals(result), "modes": shapes}


def _intervals(result: PredictionResult) -> Figure:
    modes = result.modes
    at = np.arange(len(modes))
    figure = Figure(figsize=(5.8, 0.34 * len(modes) + 1.5), layout="constrained")
    axes = figure.add_subplot()

    def percent(values: list[float]) -> np.ndarray:
        return np.array([100.0 * (v / m.mean - 1.0) for v, m in zip(values, modes, strict=True)])

    axes.hlines(at, percent([m.measured_q025 for m in modes]), percent([m.measured_q975 for m in modes]),
                color="0.6", linewidth=1.2, label="a measurement, 95 %")  # fmt: skip
    axes.hlines(at, percent([m.q025 for m in modes]), percent([m.q975 for m in modes]),
                color=PREDICTED, linewidth=5, label="natural frequency, 95 %")  # fmt: skip
    measured = measured_of_modes(result.specimen, [m.mode for m in modes])
    shown = [(k, 100.0 * (f.hz / modes[k].mean - 1.0)) for k, f in enumerate(measured) if f is not None]
    if shown:
        place, off = zip(*shown, strict=True)
        axes.plot(off, place, "o", color=MEASURED, markersize=4, label="measured")
    axes.set_yticks(at, [f"{m.mode.label or m.mode.kind}  {m.mean:.5g} Hz" for m in modes])
    axes.set(ylim=(len(modes) - 0.4, -0.6), xlabel="frequency / predicted mean - 1, %")
    axes.grid(axis="x", color="0.9")
    axes.set_axisbelow(True)
    axes.set_title(f"{result.specimen.name}: predicted from {result.posterior.plate or 'the posterior'}")
    figure.legend(loc="outside lower center", ncols=3, frameon=False, fontsize="small")
    return figure
