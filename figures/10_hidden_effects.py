"""What is found of hidden effects: which cause leads by what was hidden, and how reliable its probability is.

python figures/10_hidden_effects.py
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

DPI = 110
# Okabe and Ito's colours.
COLOURS = ("#0072B2", "#D55E00")
GREY = "#777777"
RATIO = 8.0


def draw(results: Path = RESULTS, folder: Path = HERE) -> list[Path]:
    """Draw the picture from the study's results in one folder into another."""
    data = json.loads((results / f"{STUDY}.json").read_text(encoding="utf-8"))
    matrices = _matrices(data["confusion"])
    n = len(matrices) + 1
    widths = [max(len(columns), 6) for _, _, columns, _ in matrices]
    rows = max((len(r) for _, r, _, _ in matrices), default=6)
    figure = Figure(
        figsize=(1.5 + 0.22 * sum(widths) + 1.3 * len(widths) + 4.0, 2.6 + 0.2 * rows), layout="constrained"
    )
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, n, width_ratios=[*widths, max(widths, default=6) * 0.8], squeeze=False)[0]
    for ax, (name, hidden, leading, counts) in zip(axes, matrices, strict=False):
        _matrix(ax, name, hidden, leading, counts)
    _reliability(axes[-1], data["reliability"])
    path = folder / f"{STUDY}.png"
    figure.savefig(path, dpi=DPI, metadata={"Software": None})
    return [path]


def _matrices(cells: list[dict[str, Any]]) -> list[tuple[str, list[str], list[str], np.ndarray]]:
    """Name, hidden and leading causes, and shares of each bench, clean plates with strong effects."""
    by_bench: dict[str, dict[str, dict[str, int]]] = {}
    for cell in cells:
        if cell["ratio"] in (0.0, RATIO):
            by_bench.setdefault(cell["bench"], {}).update(cell["counts"])
    found = []
    for name, counts in by_bench.items():
        hidden = sorted(counts, key=lambda c: (c != "none", c))
        answers = {c for own in counts.values() for c in own}
        pairs = {c for c in answers if " + " in c}
        leading = [*hidden, *sorted(answers - set(hidden) - pairs)]
        if pairs:
            leading.append("two causes")
        share = np.zeros((len(hidden), len(leading)))
        for i, h in enumerate(hidden):
            for c, k in counts[h].items():
                share[i, leading.index("two causes" if c in pairs else c)] += k
        share /= share.sum(axis=1, keepdims=True)
        found.append((name, [f"{h} ({sum(counts[h].values())})" for h in hidden], leading, share))
    return found


def _matrix(ax: Axes, name: str, hidden: list[str], leading: list[str], share: np.ndarray) -> None:
    ax.imshow(np.ma.masked_equal(share, 0.0), cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    ax.set_xticks(range(len(leading)), leading, rotation=90, fontsize=6.5)
    ax.set_yticks(range(len(hidden)), hidden, fontsize=6.5)
    ax.set_xlabel("most probable")
    ax.set_ylabel("hidden (trials)")
    ax.set_title(f"{name}, signal to noise {RATIO:g}", fontsize=9)
    for i, row in enumerate(share):
        for j, value in enumerate(row):
            if value > 0.0:
                shade = "white" if value > 0.6 else "black"
                ax.text(j, i, f"{100 * value:.0f}", ha="center", va="center", fontsize=5, color=shade)


def _reliability(ax: Axes, sets: list[dict[str, Any]]) -> None:
    ax.plot((0, 1), (0, 1), color=GREY, linewidth=0.8)
    for own, colour, marker in zip(sets, COLOURS, "os", strict=False):
        p = np.array([b["probability"] for b in own["bins"]])
        right = np.array([b["right"] for b in own["bins"]])
        n = np.array([b["n"] for b in own["bins"]])
        # of a share, with one trial of each outcome added
        smooth = (right * n + 1) / (n + 2)
        bars = np.sqrt(smooth * (1 - smooth) / n)
        label = f"{own['set']}: {own['n']}, error {own['error']:.3f}, by chance {own['standard_error']:.3f}"
        ax.errorbar(p, right, yerr=bars, fmt=marker, ms=4, color=colour, elinewidth=0.8, label=label)
    ax.set_xlim(0, 1.02)
    ax.set_ylim(0, 1.05)
    ax.set_xlabel("probability of the leading class")
    ax.set_ylabel("share that was right")
    ax.set_title("Reliability, one standard error", fontsize=9)
    ax.legend(fontsize=6.5, loc="lower right", frameon=False)


if __name__ == "__main__":
    for path in draw():
        print(path.relative_to(HERE.parent))
