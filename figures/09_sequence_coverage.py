"""Places of true sequences among all, and how large the credible sets are.

python figures/09_sequence_coverage.py
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
BLUE, RED = "#4878a8", "#c0392b"


def draw(results: Path = RESULTS, folder: Path = HERE) -> list[Path]:
    """Draw the picture from the study's results in one folder into another."""
    found = json.loads((results / "09_sequence_coverage.json").read_text(encoding="utf-8"))
    cases = found["cases"]
    figure = Figure(figsize=(10.0, 0.6 + 3.4 * len(cases)), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(len(cases), 2, squeeze=False)
    for (left, right), case in zip(panels, cases, strict=True):
        _places(left, case, found["allowed"])
        _sizes(right, case)
    figure.suptitle(
        f"Sequences drawn from the prior, lists with {100 * found['noise']:g} % noise", fontsize=11
    )
    path = folder / "09_sequence_coverage.png"
    figure.savefig(path, dpi=DPI)
    return [path]


def _places(axes: Axes, case: dict[str, Any], allowed: float) -> None:
    """How often randomised sets hold the truth, less the level, at every level."""
    place = np.sort([t["place"] for t in case["trials"]])
    level = np.linspace(0.0, 1.0, 401)
    covered = np.searchsorted(place, level, side="right") / len(place)
    band = allowed * np.sqrt(level * (1.0 - level) / len(place))
    axes.fill_between(level, -band, band, color="0.88", label=f"{allowed:g} binomial sd")
    axes.step(level, covered - level, where="post", color=BLUE, label="covered - level")
    axes.axhline(0.0, color="0.5", lw=0.8)
    axes.axvline(0.95, color=RED, lw=0.8, ls="--")
    axes.set(xlabel="level of the set", ylabel="covered - level", xlim=(0.0, 1.0))
    axes.set_title(f"{case['case']}: {case['layup']}, grid of {case['step_deg']:g} degrees", fontsize=10)
    axes.legend(frameon=False, fontsize=8, loc="upper left")
    axes.spines[["top", "right"]].set_visible(False)


def _sizes(axes: Axes, case: dict[str, Any]) -> None:
    size = np.array([t["set_size"] for t in case["trials"]])
    edges = np.unique(np.round(np.geomspace(1, max(int(size.max()), 30) + 1, 16)))
    axes.hist(size, bins=edges - 0.5, color=BLUE)
    axes.set(xscale="log", xlabel="sequences in the 95 % set", ylabel="lists")
    axes.set_title(
        f"true sequence first in {100 * case['truth_ranked_first']:.0f} % of {len(size)}", fontsize=10
    )
    axes.spines[["top", "right"]].set_visible(False)


if __name__ == "__main__":
    for _path in draw():
        print(_path.name)
