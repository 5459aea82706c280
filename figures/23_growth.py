"""Growth of the cost of answers with modes, parameters, plies, causes, stacking sequences and plates.

python figures/23_growth.py [--help]
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from journal import AMBER, BLACK, BLUE, DOUBLE_MM, GREEN, GREY, ORANGE, PURPLE, SKY, Drawing, Picture, figure
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, LogLocator, NullLocator

STYLES = {
    "full solve": (GREY, "s"),
    "reduced solve": (GREY, "o"),
    "building the reduced model": (BLACK, "^"),
    "identify": (BLUE, "o"),
    "identify --backend emcee": (SKY, "s"),
    "diagnose": (ORANGE, "D"),
    "diagnose, six causes": (ORANGE, "o"),
    "sequence": (GREEN, "v"),
    "sequence, 1 % of noise": (GREEN, "<"),
    "sequence, 0.2 % of noise": (GREEN, ">"),
    "batch": (PURPLE, "o"),
    "batch --hierarchical": (AMBER, "^"),
}
SIZES = ("modes", "parameters", "plies", "causes", "plates", "stacking sequences")
# Height of a line of 7 point text, as a fraction of a panel.
_LINE = 0.085
# Least number of points for an exponent: a line through two is no fit.
_FITTED = 3


def pictures(data: dict[str, Any]) -> list[Picture]:
    curves = data["curves"]
    return [
        Picture(
            "23_growth",
            _panels(curves),
            "Cost of answers against modes, parameters, plies, causes, plates and stacking sequences.",
            "CPU time of one process without a cached model, for a free cross-ply; solves: per "
            "parameter set. Stacking sequences: seconds on two cores. Right of each panel: the exponents p "
            "of cost ~ size^p, by least squares, in the order in which the curves end.",
        )
    ]


def _panels(curves: Sequence[dict[str, Any]]) -> Figure:
    new = figure(DOUBLE_MM, 135)
    shown: dict[str, Any] = {}
    for ax, size in zip(new.subplots(2, 3).flat, SIZES, strict=True):
        of_size = [c for c in curves if c["size"] == size]
        for curve in of_size:
            colour, marker = STYLES[curve["question"]]
            x, y = ([p[key] for p in curve["points"]] for key in ("size", "seconds"))
            (line,) = ax.loglog(x, y, marker=marker, color=colour)
            shown.setdefault(curve["question"], line)
        ax.set(xlabel=f"number of {size}", ylabel="time, s")
        ax.grid(True, which="major")
        ax.margins(x=0.08, y=0.1)
        low, high = ax.get_ylim()
        if high < 100.0 * low:
            ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            ax.yaxis.set_major_formatter("{x:g}")
            ax.yaxis.set_minor_locator(NullLocator())
        if size != "stacking sequences":
            ticks = sorted({p["size"] for c in of_size for p in c["points"]})
            ax.xaxis.set_major_locator(FixedLocator(_apart(ticks)))
            ax.xaxis.set_minor_locator(NullLocator())
            ax.xaxis.set_major_formatter("{x:g}")
        _exponents(ax, of_size)
    names = [name for name in STYLES if name in shown]
    new.legend([shown[n] for n in names], names, loc="outside lower center", ncols=4)
    return new


def _apart(ticks: Sequence[int]) -> list[int]:
    """Ticks that are far enough apart for their labels."""
    kept: list[int] = []
    for tick in ticks:
        if not kept or np.log(tick / kept[-1]) > 0.1 * np.log(ticks[-1] / ticks[0]):
            kept.append(tick)
    return kept


def _exponents(ax: Axes, curves: Sequence[dict[str, Any]]) -> None:
    """Write the exponents at the right of a panel, as close to the ends of their curves as room allows."""
    low, high = np.log(ax.get_ylim())
    ends = sorted(
        ((np.log(c["points"][-1]["seconds"]) - low) / (high - low), c["exponent"], c["question"])
        for c in curves
        if len(c["points"]) >= _FITTED
    )
    # each pushed up by the one below, then all pushed down as far as the panel is too short
    heights: list[float] = []
    for end, *_ in ends:
        heights.append(max(end, heights[-1] + _LINE) if heights else end)
    for i in range(len(heights) - 1, -1, -1):
        top = 1.0 if i == len(heights) - 1 else heights[i + 1] - _LINE
        heights[i] = min(heights[i], top)
    for height, (_, exponent, question) in zip(heights, ends, strict=True):
        place = {"xy": (1.02, height), "xycoords": "axes fraction"}
        ax.annotate(f"{exponent:z.2f}", **place, va="center", color=STYLES[question][0], fontsize=7)


draw = Drawing(__file__, "23_growth", "seed 0", pictures)

if __name__ == "__main__":
    draw.main()
