"""How far log evidences of sequences are off, and the sum over all of them layer by layer.

python figures/14_sequence_reference.py
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
STUDY = Path(__file__).stem

DPI = 130
BLUE, RED, GREY = "#4878a8", "#c0392b", "#808080"
ASKED = 0.1


def draw(results: Path = RESULTS, folder: Path = HERE) -> list[Path]:
    """Draw the picture from the study's results in one folder into another."""
    cases = json.loads((results / f"{STUDY}.json").read_text(encoding="utf-8"))["cases"]
    layered = [c for c in cases if c["layers"]]
    figure = Figure(figsize=(4.6 + 3.9 * len(layered), 3.7), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, 1 + len(layered), squeeze=False)[0]
    _errors(axes[0], cases)
    for ax, case in zip(axes[1:], layered, strict=True):
        _layers(ax, case)
    path = folder / f"{STUDY}.png"
    figure.savefig(path, dpi=DPI, metadata={"Software": None})
    return [path]


def _errors(ax: Axes, cases: list[dict[str, Any]]) -> None:
    """Root mean square errors against the reference."""
    y = np.arange(len(cases))
    kinds = (
        ("top", "o", BLUE, "most probable"),
        ("drawn_with_care", "s", RED, "drawn, refined"),
        ("drawn_as_known", "d", "#e69f00", "drawn, before refinement"),
        ("laplace", "|", GREY, "drawn, Laplace"),
    )
    for key, marker, color, label in kinds:
        values = [c[key] if key == "drawn_as_known" else c[key]["rms"] for c in cases]
        ax.plot([np.nan if v is None else v for v in values], y, marker, color=color, label=label, ms=7)
    ax.axvline(ASKED, color="0.6", lw=0.8, ls="--")
    ax.set_yticks(y, [c["case"] for c in cases], fontsize=8)
    ax.set(xscale="log", xlabel="error of the log evidence, rms, nats", ylim=(len(cases) - 0.5, -0.5))
    low, high = ax.get_xlim()
    ticks = [t for t in (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0) if low <= t <= high]
    ax.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    ax.set_xticks([], minor=True)
    ax.grid(axis="x", color="0.92")
    ax.legend(frameon=False, fontsize=7.5, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    ax.spines[["top", "right", "left"]].set_visible(False)


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
        label="reference",
    )
    ax.plot(middle, [r["learned_mass"] / total for r in rows], "x", color=RED, ms=8, label="surrogate")
    ax.set(yscale="log", ylim=(1e-12, 3.0), xlabel="surrogate below its top, nats")
    ax.set_ylabel("fraction of the sum over all sequences", fontsize=9)
    ax.set_title(case["case"], fontsize=9)
    ax.legend(frameon=False, fontsize=8)
    ax.spines[["top", "right"]].set_visible(False)


if __name__ == "__main__":
    for path in draw():
        print(path.relative_to(HERE.parent))
