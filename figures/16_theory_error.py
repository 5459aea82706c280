"""First-order theory against bricks: the difference of every mode, and the rule that stands for it.

python figures/16_theory_error.py
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

HERE = Path(__file__).parent
RESULTS = HERE.parent / "studies" / "results"

DPI = 110
# Plates clamped all round whose bricks are not exact enough are left out.
WORST_BRICKS_PERCENT = 0.2
COLOURS = {
    "unidirectional": "#7f7f7f",
    "cross-ply": "#1f6f8b",
    "quasi-isotropic": "#c1440e",
    "angle-ply": "#5b8c3a",
    "other": "#b08bc9",
}


def draw(results: Path = RESULTS, folder: Path = HERE) -> list[Path]:
    """Draw the differences over thickness, and the rule against them, from the study's results."""
    cases = json.loads((results / "16_theory_error.json").read_text(encoding="utf-8"))["cases"]
    figure = Figure(figsize=(10.0, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    modes, rule = figure.subplots(1, 2)
    shown: set[str] = set()
    for case in cases:
        if _rms(case, "bricks_error_percent") > WORST_BRICKS_PERCENT:
            continue
        kind = _kind(case["case"])
        difference = np.array([m["difference_percent"] for m in case["modes"]])
        label = kind if kind not in shown else None
        shown.add(kind)
        thickness = np.full(len(difference), 100 * case["h_over_short_side"])
        modes.plot(thickness, difference, "o", ms=2.5, alpha=0.5, color=COLOURS[kind], label=label)
        rule.plot(
            _rms(case, "rule_percent"), _rms(case, "difference_percent"), "o", ms=4, color=COLOURS[kind]
        )
    modes.axhline(0.0, color="0.4", linewidth=0.7)
    modes.set(xlabel="thickness over the short side, %", ylabel="Ritz model less bricks, %", xlim=(0.0, None))
    if modes.get_legend_handles_labels()[0]:
        modes.legend(frameon=False, fontsize=8)
    ends = np.array([0.008, 1.5])
    rule.plot(ends, ends, color="0.4", linewidth=0.7)
    rule.fill_between(ends, ends / 2, ends * 2, color="0.92", zorder=0)
    rule.set(
        xlabel="rule, rms over modes, %", ylabel="measured, rms over modes, %", xscale="log", yscale="log"
    )
    for axes in (modes, rule):
        axes.spines[["top", "right"]].set_visible(False)
    path = folder / "16_theory_error.png"
    figure.savefig(path, dpi=DPI)
    return [path]


def _kind(name: str) -> str:
    return next((kind for kind in COLOURS if f", {kind}" in name), "other")


def _rms(case: dict[str, Any], key: str) -> float:
    return float(np.sqrt(np.mean([m[key] ** 2 for m in case["modes"]])))


if __name__ == "__main__":
    for _path in draw():
        print(_path.name)
