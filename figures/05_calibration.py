"""Rank histograms, distributions of the ranks and coverage of simulation-based calibration.

python figures/05_calibration.py
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

STUDY = Path(__file__).stem
HERE = Path(__file__).parent

# Okabe and Ito's colours, told apart by the colour-blind and in grey.
BLUE, ORANGE, GREY = "#0072B2", "#D55E00", "#777777"
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
MARKERS = "osD^vP"
SYMBOLS = {"relative_std": "noise s"}
STYLE = {"font.size": 8.5, "axes.titlesize": 9.0, "legend.fontsize": 7.5, "axes.axisbelow": True}


def draw(results: Path, folder: Path) -> list[Path]:
    """Draw the study's results, read from one folder, into another."""
    data = json.loads((results / f"{STUDY}.json").read_text(encoding="utf-8"))
    plates = data["plates"]
    most = max(len(p["parameters"]) for p in plates)
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(
            len(plates),
            most + 2,
            figsize=(2.0 * most + 5.0, 2.5 * len(plates) + 0.3),
            squeeze=False,
            layout="constrained",
            width_ratios=[1.0] * most + [1.6, 1.4],
        )
        for row, plate in zip(axes, plates, strict=True):
            for ax in row[len(plate["parameters"]) : most]:
                ax.axis("off")
            for ax, parameter in zip(row, plate["parameters"], strict=False):
                _histogram(ax, plate, parameter, data["draws"])
            row[0].set_ylabel(f"{plate['plate']}, {plate['repetitions']} repetitions\ncount")
            _distribution(row[most], plate, data["draws"])
            _coverage(row[most + 1], plate)
        path = folder / f"{STUDY}.png"
        figure.savefig(path, dpi=120, metadata={"Software": None})
        plt.close(figure)
    return [path]


def _histogram(ax: Axes, plate: dict[str, Any], parameter: dict[str, Any], draws: int) -> None:
    counts, band = parameter["counts"], plate["histogram_band"]
    edges = np.linspace(0, draws + 1, len(counts) + 1)
    ax.axhspan(band["lower"][0], band["upper"][0], color="#dddddd", linewidth=0)
    ax.axhline(plate["repetitions"] / len(counts), color=GREY, linewidth=0.8)
    ax.stairs(counts, edges, fill=True, color=BLUE, alpha=0.75)
    ax.set_xlim(0, draws + 1)
    ax.set_ylim(0, 1.15 * max(band["upper"][0], *counts))
    ax.set_title(f"{_symbol(parameter['name'])}, p = {parameter['corrected_p']:.2f}")
    ax.set_xlabel("rank of the truth")


def _distribution(ax: Axes, plate: dict[str, Any], draws: int) -> None:
    """Departure of the ranks' distribution from the uniform one, with its band."""
    n = plate["repetitions"]
    share = np.arange(1, draws + 1) / (draws + 1)
    band = plate["ecdf_band"]
    lower, upper = (np.array(band[side]) / n - share for side in ("lower", "upper"))
    ax.fill_between(share, lower, upper, color="#dddddd", linewidth=0, label="95 % of uniform ranks")
    for parameter, colour in zip(plate["parameters"], COLOURS, strict=False):
        departure = np.array(parameter["cumulative"][:-1]) / n - share
        ax.plot(share, departure, color=colour, linewidth=1.0, label=_symbol(parameter["name"]))
    ax.set_xlim(0, 1)
    ax.set_xlabel("rank / 100")
    ax.set_title("distribution of ranks less the uniform one")
    ax.legend(ncols=2, loc="lower center", frameon=False, handlelength=1.2, columnspacing=1.0)
    room = 1.9 * float(np.max(np.abs((*lower, *upper))))
    ax.set_ylim(-room, 0.6 * room)


def _coverage(ax: Axes, plate: dict[str, Any]) -> None:
    """Shares of intervals that hold the truth, with two binomial standard errors."""
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
    ax.set_xlabel("central interval")
    ax.set_ylabel("coverage less level, %")
    ax.set_title("coverage, two standard errors")


def _symbol(name: str) -> str:
    return SYMBOLS.get(name, name)


if __name__ == "__main__":
    for path in draw(HERE.parent / "studies" / "results", HERE):
        print(path.relative_to(HERE.parent))
