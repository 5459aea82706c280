"""Cost of the forward solver against accuracy, number of modes and number of parameters.

python figures/03_solver_growth.py
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator

STUDY = Path(__file__).stem
HERE = Path(__file__).parent

# Okabe and Ito's colours, told apart by the colour-blind and in grey.
BLUE, ORANGE, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#777777"
BASES = {
    ("C1", "enriched"): (BLUE, "-", "o"),
    ("C1", "plain"): (BLUE, "--", "o"),
    ("D1", "enriched"): (ORANGE, "-", "s"),
    ("D1", "plain"): (ORANGE, "--", "s"),
}
COSTS = {
    "full": ("full solve", ORANGE, "-", "s"),
    "derivatives": ("reduced, with derivatives", GREEN, "-", "^"),
    "reduced": ("reduced", BLUE, "-", "o"),
    "lapack": ("LAPACK alone on its sizes", GREY, "--", ""),
}
GOAL = 2e-4
ANGLES = "with ply angles:\ntwo blocks, not four"
NOTE = "At the end of a line: how many times the cheapest point of its kind, measured in the same run."
STYLE = {"font.size": 9.0, "axes.titlesize": 9.5, "legend.fontsize": 8.0, "axes.axisbelow": True}


def draw(results: Path, folder: Path) -> list[Path]:
    """Draw the study's results, read from one folder, into another."""
    data = json.loads((results / f"{STUDY}.json").read_text(encoding="utf-8"))
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(1, 3, figsize=(12.0, 4.3), layout="constrained")
        _accuracy(axes[0], data["accuracy"])
        _growth(axes[1], data["modes"], "modes")
        axes[1].set_xlabel("number of modes")
        axes[1].set_title(f"C1, four constants; reduced in stacks of {data['stack']}")
        _growth(axes[2], data["parameters"], "parameters")
        _mark_angles(axes[2], data["parameters"])
        axes[2].set_xlabel("number of parameters")
        axes[2].set_title("C1, six modes; constants, then ply angles")
        for ax in axes[1:]:
            ax.set_ylabel("time of one parameter set, ms")
        low, high = (f(ax.get_ylim()[i] for ax in axes[1:]) for i, f in ((0, min), (1, max)))
        for ax in axes[1:]:
            ax.set_ylim(low, high)
        axes[1].legend(loc="lower right")
        for ax in axes:
            ax.grid(True, which="major", color="#dddddd", linewidth=0.6)
        figure.supxlabel(NOTE, fontsize=8, color=GREY)
        path = folder / f"{STUDY}.png"
        figure.savefig(path, dpi=160, metadata={"Software": None})
        plt.close(figure)
    return [path]


def _accuracy(ax: Axes, points: list[dict[str, Any]]) -> None:
    for (plate, basis), (colour, line, marker) in BASES.items():
        own = [p for p in points if (p["plate"], p["basis"]) == (plate, basis)]
        # what is closer to the reference than that is to the truth says nothing
        own = [p for p in own if p["error"] > p["reference_error"]]
        if not own:
            continue
        label = f"{plate}, " + ("with edge exponentials" if basis == "enriched" else "polynomials alone")
        x, y = [p["error"] for p in own], [1e3 * p["full_s"] for p in own]
        face = colour if basis == "enriched" else "white"
        ax.loglog(x, y, line, color=colour, marker=marker, ms=4, markerfacecolor=face, label=label)
        _ratio(ax, x[-1], y[-1], own[-1]["full_ratio"], colour)
    ax.axvline(GOAL, color=GREY, linewidth=0.8)
    ax.annotate(
        *("0.02 %", (GOAL, 0.98), (-3, 0), ("data", "axes fraction"), "offset points"),
        ha="right",
        va="top",
        color=GREY,
    )
    ax.invert_xaxis()
    ax.margins(x=0.12, y=0.08)
    ax.set_ylim(bottom=0.15 * min(p["full_s"] for p in points) * 1e3)
    ax.set_xlabel("worst relative error of a frequency")
    ax.set_ylabel("time of a full solve, ms")
    ax.set_title("Full solve, six modes of C1 and ten of D1")
    ax.yaxis.set_major_formatter("{x:g}")
    ax.legend(loc="lower right")


def _growth(ax: Axes, points: list[dict[str, Any]], kind: str) -> None:
    x = [p[kind] for p in points]
    for name, (label, colour, line, marker) in COSTS.items():
        y = [1e3 * p[f"{name}_s"] for p in points]
        ax.semilogy(x, y, line, color=colour, marker=marker or None, ms=4, label=label)
        if name != "lapack":
            _ratio(ax, x[-1], y[-1], points[-1][f"{name}_ratio"], colour)
    ax.xaxis.set_major_locator(FixedLocator(x))
    ax.margins(x=0.15, y=0.1)
    ax.yaxis.set_major_formatter("{x:g}")


def _ratio(ax: Axes, x: float, y: float, ratio: float, colour: str) -> None:
    """At the end of a line, how many times the cheapest point of its kind it costs."""
    ax.annotate(f"{ratio:.0f} x", (x, y), xytext=(5, 3), textcoords="offset points", color=colour, fontsize=8)


def _mark_angles(ax: Axes, points: list[dict[str, Any]]) -> None:
    first = next((p["parameters"] for p in points if p["names"][-1].startswith("angle")), None)
    if first is not None:
        ax.axvline(first - 0.5, color=GREY, linewidth=0.8)
        for text, shift, side in (("constants alone", -4, "right"), (ANGLES, 4, "left")):
            ax.annotate(
                *(text, (first - 0.5, 0.02), (shift, 0), ("data", "axes fraction"), "offset points"),
                ha=side,
                va="bottom",
                color=GREY,
                fontsize=8,
            )


if __name__ == "__main__":
    for path in draw(HERE.parent / "studies" / "results", HERE):
        print(path.relative_to(HERE.parent))
