"""Findings of the diagnosis: probabilities of none, other and the leading causes for every plate.

python figures/12_findings.py [--help]
"""

from __future__ import annotations

from typing import Any

from journal import DARK, DOUBLE_MM, GREY, ORANGE, SKY, Drawing, Picture, figure
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

COLOURS = {"none": SKY, "other": GREY}
LEADING, REST = (ORANGE, "#E9A36A", "#F6D9BF"), "#EFEFEF"
HATCH: dict[str, Any] = {"hatch": "////", "edgecolor": "white", "linewidth": 0.0}
# Width of a letter on the probability axis.
LETTER = 0.0115


def pictures(data: dict[str, Any]) -> list[Picture]:
    groups = data["groups"]
    return [
        Picture(
            "12_findings",
            _all(groups),
            "The paper's plates and plates of spruce, diagnosed.",
            "Left: posterior probabilities. Right: rms residual of the plain model, with an arrow to that of "
            "the extended model where a cause is claimed. Hatched: causes beside which an "
            "unknown error is claimed.",
        )
    ]


def _all(groups: list[dict[str, Any]]) -> Figure:
    new = figure(DOUBLE_MM, 32 + 6.5 * len(groups))
    bars, fits = new.subplots(1, 2, width_ratios=(3.0, 1.0), sharey=True)
    for row, group in enumerate(groups):
        _bar(bars, row, group)
        _fit(fits, row, group)
    bars.set_yticks(range(len(groups)), [" + ".join(g["plates"]) for g in groups])
    bars.set_ylim(len(groups) - 0.5, -0.5)
    bars.set(xlim=(0.0, 1.0), xlabel="probability")
    fits.set_xscale("log")
    fits.set_xlim(0.1, 100.0)
    fits.set_xticks((1.0, 10.0, 100.0), ("1", "10", "100"))
    fits.minorticks_off()
    fits.set_xlabel("rms residual, %")
    fits.grid(axis="x")
    for axes in (bars, fits):
        axes.spines["left"].set_visible(False)
        axes.tick_params(axis="y", length=0)
    words = ("nothing wrong", "an unknown error", "most probable cause", "second", "third", "all others")
    colours = (*COLOURS.values(), *LEADING, REST)
    handles = [Patch(color=c, label=w) for w, c in zip(words, colours, strict=True)]
    new.legend(handles=handles, loc="outside upper center", ncols=len(handles))
    return new


def _fit(axes: Axes, row: int, group: dict[str, Any]) -> None:
    before = group["baseline"]["rms_as_stated_percent"]
    if group["extended"] is not None and group["claim"] != "other":
        after = group["extended"]["rms_as_stated_percent"]
        arrow = {"arrowstyle": "->", "color": ORANGE, "lw": 1.0, "shrinkA": 0.0, "shrinkB": 0.0}
        axes.annotate("", (after, row), (before, row), arrowprops=arrow)
    axes.plot(before, row, "o", color=DARK)


def _bar(axes: Axes, row: int, group: dict[str, Any]) -> None:
    by_cause = {h["cause"]: h for h in group["hypotheses"]}
    causes = [c for c in by_cause if c not in COLOURS]
    pieces = [(c, by_cause[c]["probability"], COLOURS[c]) for c in COLOURS if c in by_cause]
    pieces += [(c, by_cause[c]["probability"], LEADING[i]) for i, c in enumerate(causes[: len(LEADING)])]
    left = 0.0
    for cause, probability, colour in pieces:
        explains_little = group["claim"] == "other" and cause not in COLOURS
        hatch = HATCH if explains_little else {}
        axes.barh(row, probability, left=left, color=colour, height=0.75, **hatch)
        if probability >= LETTER * len(cause) and cause not in COLOURS:
            box = {"facecolor": colour, "edgecolor": "none", "pad": 1.0}
            axes.text(left + 0.5 * probability, row, cause, ha="center", va="center", fontsize=7, bbox=box)
        left += probability
    axes.barh(row, 1.0 - left, left=left, color=REST, height=0.75)


draw = Drawing(__file__, "12_findings", "seed 0", pictures)

if __name__ == "__main__":
    draw.main()
