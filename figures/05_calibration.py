"""Rank histograms, distributions of the ranks and coverage of simulation-based calibration.

python figures/05_calibration.py [--help]
"""

from __future__ import annotations

from typing import Any

import numpy as np
from journal import (
    AMBER,
    BAND,
    BLUE,
    DOUBLE_MM,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    Drawing,
    Picture,
    figure,
    listed,
    symbol,
)
from matplotlib.axes import Axes
from matplotlib.figure import Figure

COLOURS = (BLUE, ORANGE, GREEN, PURPLE, AMBER, SKY)
MARKERS = "osD^vP"


def pictures(data: dict[str, Any]) -> list[Picture]:
    plates = data["plates"]
    smallest = min(p["corrected_p"] for plate in plates for p in plate["parameters"])
    coverage = [
        (abs(c["share"] - c["level"]), 2 * c["standard_error"])
        for plate in plates
        for p in plate["parameters"]
        for c in p["coverage"]
    ]
    within = sum(difference <= allowed for difference, allowed in coverage)
    lie_whole = [
        plate["histogram_band"]["lower"][0] <= min(p["counts"])
        and max(p["counts"]) <= plate["histogram_band"]["upper"][0]
        for plate in plates
        for p in plate["parameters"]
    ]
    return [
        Picture(
            "05_calibration",
            _all(data),
            f"Simulation-based calibration of the posteriors of {listed([p['plate'] for p in plates])}.",
            f"{listed([str(p['repetitions']) for p in plates])} simulated lists. Histograms: rank of the "
            f"true value among {data['draws']} posterior draws; {100 * data['band_probability']:g} % of "
            f"histograms of uniform ranks lie whole between the broken lines, {sum(lie_whole)} of these "
            f"{len(lie_whole)} do. Below: the ranks' distribution less the uniform one with its band, and "
            "coverage of central intervals less their level with two standard errors. The smallest p of the "
            f"tests of uniformity, corrected for the number of parameters, is {smallest:.2f}; {within} of "
            f"{len(coverage)} coverages are within two standard errors of their level.",
        )
    ]


def _all(data: dict[str, Any]) -> Figure:
    plates = data["plates"]
    most = max(len(p["parameters"]) for p in plates)
    new = figure(DOUBLE_MM, 100 * len(plates))
    for part, plate in zip(np.atleast_1d(new.subfigures(len(plates), 1)), plates, strict=True):
        part.suptitle(f"{plate['plate']}, {plate['repetitions']} repetitions")
        above, below = part.subfigures(2, 1, height_ratios=(0.85, 1.0))
        panels = above.subplots(1, most, squeeze=False)[0]
        for ax in panels[len(plate["parameters"]) :]:
            ax.set_axis_off()
        for ax, parameter in zip(panels, plate["parameters"], strict=False):
            _histogram(ax, plate, parameter, data["draws"])
        panels[0].set_ylabel("repetitions")
        left, right = below.subplots(1, 2)
        _distribution(left, plate, data["draws"])
        _coverage(right, plate)
        handles, labels = left.get_legend_handles_labels()
        below.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return new


def _histogram(ax: Axes, plate: dict[str, Any], parameter: dict[str, Any], draws: int) -> None:
    counts, band = parameter["counts"], plate["histogram_band"]
    edges = np.linspace(0, draws + 1, len(counts) + 1)
    ax.stairs(counts, edges, fill=True, color=SKY)
    ax.axhline(plate["repetitions"] / len(counts), color=GREY, linewidth=0.8)
    for end in (band["lower"][0], band["upper"][0]):
        ax.axhline(end, color=GREY, linewidth=0.8, linestyle="--")
    ax.set_xlim(0, draws + 1)
    ax.set_ylim(0, 1.15 * max(band["upper"][0], *counts))
    ax.set_title(symbol(parameter["name"]))
    ax.set_xlabel("rank")


def _distribution(ax: Axes, plate: dict[str, Any], draws: int) -> None:
    """Deviation of the ranks' distribution from the uniform one, with its band."""
    n = plate["repetitions"]
    uniform = np.arange(1, draws + 1) / (draws + 1)
    band = plate["ecdf_band"]
    lower, upper = (np.array(band[side]) / n - uniform for side in ("lower", "upper"))
    ax.fill_between(uniform, lower, upper, color=BAND, linewidth=0, label="95 % of uniform ranks")
    for i, (parameter, colour) in enumerate(zip(plate["parameters"], COLOURS, strict=False)):
        departure = np.array(parameter["cumulative"][:-1]) / n - uniform
        marks = {"marker": MARKERS[i], "markevery": (5 + 2 * i, 20), "ms": 3}
        ax.plot(uniform, departure, color=colour, label=symbol(parameter["name"]), **marks)
    ax.set(xlim=(0, 1), xlabel=f"rank / {draws + 1}", ylabel="distribution - uniform one")
    ax.set_title("Distribution of the ranks")


def _coverage(ax: Axes, plate: dict[str, Any]) -> None:
    """Fractions of intervals that contain the true value, with two binomial standard errors."""
    n = len(plate["parameters"])
    for i, (parameter, colour) in enumerate(zip(plate["parameters"], COLOURS, strict=False)):
        for level, c in enumerate(parameter["coverage"]):
            ax.errorbar(
                level + 0.1 * (i - (n - 1) / 2),
                100 * (c["share"] - c["level"]),
                yerr=200 * c["standard_error"],
                fmt=MARKERS[i],
                color=colour,
                ms=3.5,
                elinewidth=0.9,
            )
    levels = [c["level"] for c in plate["parameters"][0]["coverage"]]
    ax.axhline(0.0, color=GREY, linewidth=0.8)
    ax.set_xticks(range(len(levels)), [f"{100 * level:g} %" for level in levels])
    ax.set(xlabel="level of the central interval", ylabel="coverage - level, %")
    ax.set_title("Coverage, two standard errors")


draw = Drawing(__file__, "05_calibration", "seed 0", pictures)

if __name__ == "__main__":
    draw.main()
