"""How far log evidences of stacking sequences are off, and the sum over all of them layer by layer.

python figures/14_sequence_reference.py [--help]
"""

from __future__ import annotations

from typing import Any

import numpy as np
from journal import AMBER, BLUE, DOUBLE_MM, GREY, ORANGE, Drawing, Picture, figure
from matplotlib.axes import Axes
from matplotlib.figure import Figure

LARGEST_RMS = 0.1


def pictures(data: dict[str, Any]) -> list[Picture]:
    cases = data["cases"]
    layered = [c for c in cases if c["layers"]]
    rms = [c[key]["rms"] for c in cases for key in ("top", "drawn_with_care") if c[key]["rms"] is not None]
    sums = (
        " Right: stacking sequences drawn layer by layer, by how far the surrogate has them below its "
        "largest value: fraction of the sum over all that a layer holds, by the reference with one "
        "standard error and by the surrogate."
    )
    return [
        Picture(
            "14_sequence_reference",
            _all(cases, layered),
            "Log evidences of stacking sequences against a slow and independent reference.",
            "Left: root mean square errors of the log evidence of the most probable classes and of "
            f"stacking sequences drawn from the posterior; dashed: {LARGEST_RMS:g} nats. The largest of "
            f"those that `sequence` uses is {max(rms, default=0.0):.3f} nats." + (sums if layered else ""),
        )
    ]


def _all(cases: list[dict[str, Any]], layered: list[dict[str, Any]]) -> Figure:
    new = figure(DOUBLE_MM, 78)
    axes = new.subplots(1, 1 + len(layered), squeeze=False)[0]
    _errors(axes[0], cases)
    for ax, case in zip(axes[1:], layered, strict=True):
        _layers(ax, case)
    handles, labels = axes[0].get_legend_handles_labels()
    if layered:
        more = axes[1].get_legend_handles_labels()
        handles, labels = handles + more[0], labels + more[1]
    new.legend(handles, labels, loc="outside lower center", ncols=3)
    return new


def _errors(ax: Axes, cases: list[dict[str, Any]]) -> None:
    """Root mean square errors against the reference."""
    y = np.arange(len(cases))
    kinds = (
        ("top", "o", BLUE, "most probable classes"),
        ("drawn_with_care", "s", ORANGE, "drawn, refined"),
        ("drawn_as_known", "D", AMBER, "drawn, before refinement"),
        ("laplace", "|", GREY, "drawn, Laplace's approximation"),
    )
    for key, marker, color, label in kinds:
        values = [c[key] if key == "drawn_as_known" else c[key]["rms"] for c in cases]
        size = 7 if marker == "|" else 4
        shown = [np.nan if v is None else v for v in values]
        ax.plot(shown, y, marker, color=color, label=label, ms=size, mew=1.5 if marker == "|" else 0.5)
    ax.axvline(LARGEST_RMS, color="0.6", lw=0.8, ls="--")
    ax.set_yticks(y, [c["case"].replace(", ", "\n", 1) for c in cases])
    ax.set(xscale="log", ylim=(len(cases) - 0.5, -0.5))
    ax.set_xlabel("error of the log evidence, rms, nats")
    low, high = ax.get_xlim()
    ticks = [t for t in (0.01, 0.03, 0.1, 0.3, 1.0, 3.0) if low <= t <= high]
    ax.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    ax.set_xticks([], minor=True)
    ax.grid(axis="x")
    ax.spines["left"].set_visible(False)
    ax.tick_params(axis="y", length=0)


def _layers(ax: Axes, case: dict[str, Any]) -> None:
    """Sum of each layer over that of all, by the surrogate and by the reference."""
    rows = [r for r in case["layers"] if r["mass"] > 0.0]
    total = sum(r["mass"] for r in rows)
    middle = [0.5 * (r["from"] + min(r["to"], 60.0)) for r in rows]
    ax.errorbar(
        middle,
        [r["mass"] / total for r in rows],
        yerr=[r["mass_error"] / total for r in rows],
        fmt="o",
        color=BLUE,
        label="layer, reference",
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
