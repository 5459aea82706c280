"""Evidence by three methods, and moments of posteriors by three methods.

python figures/06_evidence.py
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

HERE = Path(__file__).parent
RESULTS = HERE.parent / "studies" / "results"

DPI = 150
COLORS = {"importance": "#333333", "emcee": "#4878a8", "nested": "#c1440e"}
NAMES = {"importance": "importance sampling", "emcee": "emcee", "nested": "nested sampling (dynesty)"}
SYMBOLS = {
    "E1_GPa": "$E_1$",
    "E2_GPa": "$E_2$",
    "nu12": r"$\nu_{12}$",
    "G12_GPa": "$G_{12}$",
    "G23_GPa": "$G_{23}$",
    "relative_std": "noise",
}


def draw(results: Path = RESULTS, folder: Path = HERE) -> list[Path]:
    """Draw the picture from the study's results in one folder into another."""
    specimens = json.loads((results / "06_evidence.json").read_text(encoding="utf-8"))["specimens"]
    figure = Figure(figsize=(11.0, 7.0), layout="constrained")
    FigureCanvasAgg(figure)
    left, middle, right = figure.subplots(1, 3, width_ratios=(1.25, 1.0, 1.0))
    _evidence(left, specimens)
    _moments(middle, specimens, "mean", "Means")
    _moments(right, specimens, "sd", "Standard deviations")
    right.set_yticklabels([])
    handles, labels = middle.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False)
    path = folder / "06_evidence.png"
    figure.savefig(path, dpi=DPI)
    return [path]


def _evidence(axes: Axes, specimens: list[dict[str, Any]]) -> None:
    rows = []
    for specimen in specimens:
        reference = specimen["log_evidence"]["importance"]["value"]
        for method, found in specimen["log_evidence"].items():
            color = COLORS["nested" if method == "nested" else "importance"]
            row = len(rows)
            offset = found["value"] - reference
            # Laplace has no error to show
            axes.errorbar(
                offset,
                row,
                xerr=2 * found.get("error", 0.0),
                fmt="o",
                ms=5,
                color=color,
                mfc=color if "error" in found else "white",
                capsize=4 if "error" in found else 0,
            )
            rows.append(f"{specimen['plate']}  {method}")
        axes.axhline(len(rows) - 0.5, color="0.85", linewidth=0.8)
    axes.axvline(0.0, color="0.5", linewidth=0.8, zorder=0)
    axes.set_yticks(range(len(rows)), rows, fontsize=8)
    axes.set(ylim=(len(rows) - 0.5, -0.5))
    axes.set_xlabel("log evidence less that of importance sampling\nbars: two standard errors")
    axes.set_title("Log evidence")
    _clean(axes)


def _moments(axes: Axes, specimens: list[dict[str, Any]], what: str, title: str) -> None:
    """Each method's mean or sd less that of importance sampling, in its standard deviations."""
    rows: list[str] = []
    for specimen in specimens:
        for parameter in specimen["parameters"]:
            base = parameter["importance"]
            for shift, (method, color) in zip((-0.22, 0.0, 0.22), COLORS.items(), strict=True):
                own = parameter[method]
                axes.errorbar(
                    (own[what] - base[what]) / base["sd"],
                    len(rows) + shift,
                    xerr=2 * own[f"{what}_error"] / base["sd"],
                    fmt="o",
                    ms=4,
                    capsize=3,
                    color=color,
                    label=NAMES[method] if not rows else None,
                )
            rows.append(f"{specimen['plate']}  {SYMBOLS.get(parameter['name'], parameter['name'])}")
        axes.axhline(len(rows) - 0.5, color="0.85", linewidth=0.8)
    widest = float(np.max(np.abs(axes.get_xlim())))
    axes.axvline(0.0, color="0.5", linewidth=0.8, zorder=0)
    axes.set_yticks(range(len(rows)), rows, fontsize=9)
    axes.set(xlim=(-widest, widest), ylim=(len(rows) - 0.5, -0.5))
    axes.set_xlabel("difference in posterior sd\nbars: two standard errors")
    axes.set_title(title)
    _clean(axes)


def _clean(axes: Axes) -> None:
    axes.set_axisbelow(True)
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.tick_params(axis="y", length=0)


if __name__ == "__main__":
    for _path in draw():
        print(_path.name)
