"""Log evidences of stacking sequences against nested sampling, and the sum over all of them layer by layer.

python figures/14_sequence_reference.py [--help]
"""

from __future__ import annotations

from typing import Any

import numpy as np
from journal import BLUE, DOUBLE_MM, ORANGE, Drawing, Picture, figure
from matplotlib.axes import Axes
from matplotlib.figure import Figure

# Part of a list's row that its sequences take up.
SPREAD = 0.7


def pictures(data: dict[str, Any]) -> list[Picture]:
    cases = data["cases"]
    layered = [c for c in cases if c["layers"]]
    n = sum(len(c["compared"]) for c in cases)
    sums = (
        " Right: stacking sequences drawn layer by layer, by how far the surrogate has them below its "
        "largest value: fraction of the sum over all that a layer holds, by importance sampling with one "
        "standard error and by the surrogate."
    )
    return [
        Picture(
            "14_sequence_reference",
            _all(cases, layered),
            "Log evidences of stacking sequences against nested sampling.",
            f"Left: {n} classes of stacking sequences drawn from the posteriors of {len(cases)} lists, "
            f"importance sampling less nested sampling ({data['live_points']} live points), with one "
            "standard error of the latter." + (sums if layered else ""),
        )
    ]


def _all(cases: list[dict[str, Any]], layered: list[dict[str, Any]]) -> Figure:
    new = figure(DOUBLE_MM, 78)
    axes = new.subplots(1, 1 + len(layered), squeeze=False)[0]
    _differences(axes[0], cases)
    for ax, case in zip(axes[1:], layered, strict=True):
        _layers(ax, case)
    handles, labels = axes[0].get_legend_handles_labels()
    if layered:
        more = axes[1].get_legend_handles_labels()
        handles, labels = handles + more[0], labels + more[1]
    new.legend(handles, labels, loc="outside lower center", ncols=3)
    return new


def _differences(ax: Axes, cases: list[dict[str, Any]]) -> None:
    """Both log evidences of each sequence, one row per list."""
    for row, case in enumerate(cases):
        compared = case["compared"]
        y = row + SPREAD * ((np.arange(len(compared)) + 0.5) / len(compared) - 0.5)
        ax.errorbar(
            [c["importance"] - c["nested"] for c in compared],
            y,
            xerr=[c["nested_error"] for c in compared],
            fmt="o",
            color=BLUE,
            ms=3,
            lw=0.8,
            label=None if row else "stacking sequence, importance less nested sampling",
        )
    ax.axvline(0.0, color="0.6", lw=0.8)
    ax.set_yticks(range(len(cases)), [c["case"].replace(", ", "\n", 1) for c in cases])
    ax.set(ylim=(len(cases) - 0.5, -0.5), xlabel="difference of log evidences, nats")
    ax.grid(axis="x")
    ax.spines["left"].set_visible(False)
    ax.tick_params(axis="y", length=0)


def _layers(ax: Axes, case: dict[str, Any]) -> None:
    """Sum of each layer relative to the total, by the surrogate and by the reference."""
    rows = [r for r in case["layers"] if r["mass"] > 0.0]
    total = sum(r["mass"] for r in rows)
    middle = [0.5 * (r["from"] + min(r["to"], 60.0)) for r in rows]
    ax.errorbar(
        middle,
        [r["mass"] / total for r in rows],
        yerr=[r["mass_error"] / total for r in rows],
        fmt="o",
        color=BLUE,
        label="layer, importance sampling",
    )
    ax.plot(
        middle, [r["learned_mass"] / total for r in rows], "x", color=ORANGE, ms=6, label="layer, surrogate"
    )
    ax.set(yscale="log", ylim=(1e-12, 3.0), xlabel="surrogate below its largest, nats")
    ax.set_ylabel("fraction of the sum over all")
    ax.set_title(case["case"])


draw = Drawing(__file__, "14_sequence_reference", "seed 0", pictures)

if __name__ == "__main__":
    draw.main()
