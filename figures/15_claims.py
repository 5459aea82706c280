"""What is claimed of lists with hidden causes: right, wrong or nothing, beside other engines and methods.

python figures/15_claims.py
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

HERE = Path(__file__).parent
RESULTS = HERE.parent / "studies" / "results"
STUDY = Path(__file__).stem

DPI = 110
# Okabe and Ito's colours, and greys for what claims nothing.
COLOURS = {
    "claimed and right": "#0072B2",
    "other": "#56B4E9",
    "none": "#BBBBBB",
    "undecided": "#DDDDDD",
    "claimed and wrong": "#D55E00",
    "error": "#000000",
}
SETS = {"final": "Final set", "rows": "Known failures", "tuning": "Tuning set"}
THIS = "diagnosis"
NAMES = {
    THIS: "this diagnosis",
    "diagnosis beside old": "this one on the lists of",
    "old": "the one before",
}
# Height of a bar, inches.
BAR = 0.24


def draw(results: Path = RESULTS, folder: Path = HERE) -> list[Path]:
    """Draw the picture from the study's results in one folder into another."""
    data = json.loads((results / f"{STUDY}.json").read_text(encoding="utf-8"))
    path = folder / f"{STUDY}.png"
    _claims(data["sets"]).savefig(path, dpi=DPI, metadata={"Software": None})
    return [path]


def _claims(found: dict[str, Any]) -> Figure:
    """Two panels a set: this diagnosis by what was hidden, and all methods on the same lists."""
    shown = [name for name in SETS if found.get(name)]
    left = [_by_kind(found[name]) for name in shown]
    right = [_by_method(found[name]) for name in shown]
    heights = [max(len(a), len(b)) for a, b in zip(left, right, strict=True)]
    figure = Figure(figsize=(10.5, 1.2 + BAR * sum(heights) + 0.6 * len(shown)), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(len(shown), 2, squeeze=False, height_ratios=heights)
    for (a, b), name, kinds, methods in zip(panels, shown, left, right, strict=True):
        _bars(a, kinds)
        a.set_title(f"{SETS[name]}, by what was hidden", fontsize=9)
        _bars(b, methods)
        b.set_title(f"{SETS[name]}, all lists that this diagnosis answered", fontsize=9)
    handles, labels = panels[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(COLOURS), fontsize=8, frameon=False)
    return figure


def _by_kind(engines: dict[str, Any]) -> dict[str, dict[str, int]]:
    own = engines.get(THIS) or next(iter(engines.values()))
    return {f"{r['what']} ({r['lists']})": {c: r[c] for c in COLOURS} for r in own["by_kind"]}


def _by_method(engines: dict[str, Any]) -> dict[str, dict[str, int]]:
    order = [n for n in NAMES if n in engines] + [n for n in engines if n not in NAMES]
    return {
        f"{NAMES.get(name, name).replace('_', ' ')} ({engines[name]['lists']})": {
            c: sum(r[c] for r in engines[name]["by_kind"]) for c in COLOURS
        }
        for name in order
    }


def _bars(ax: Axes, rows: dict[str, dict[str, int]]) -> None:
    """Shares of each category, one bar a row, stacked."""
    names = list(rows)
    base = [0.0] * len(names)
    for category, colour in COLOURS.items():
        share = [100.0 * rows[n][category] / max(sum(rows[n].values()), 1) for n in names]
        ax.barh(range(len(names)), share, 0.75, left=base, color=colour, label=category)
        base = [b + s for b, s in zip(base, share, strict=True)]
    ax.set_yticks(range(len(names)), names, fontsize=7)
    ax.invert_yaxis()
    ax.set_xlim(0.0, 100.0)
    ax.set_xlabel("share of the lists, %", fontsize=8)
    ax.tick_params(axis="x", labelsize=8)


if __name__ == "__main__":
    for drawn in draw():
        print(drawn)
