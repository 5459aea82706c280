"""What is found of hidden effects: which cause leads by what was hidden, and how reliable its probability is.

python figures/10_hidden_effects.py
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

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
COLUMNS = 2


def draw(results: Path = RESULTS, folder: Path = HERE) -> list[Path]:
    """Draw the pictures from the study's results in one folder into another."""
    data = json.loads((results / f"{STUDY}.json").read_text(encoding="utf-8"))
    return [
        _saved(_confusion(_matrices(data["confusion"])), folder / f"{STUDY}.png"),
        _saved(_reliability(data["reliability"]), folder / f"{STUDY}_reliability.png"),
    ]


def _saved(figure: Figure, path: Path) -> Path:
    figure.savefig(path, dpi=DPI, metadata={"Software": None})
    return path


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _confusion(matrices: list[Matrix]) -> Figure:
    """Which cause led by what was hidden, one panel a bench."""
    rows = -(-len(matrices) // COLUMNS)
    most = max(max(len(m.hidden), len(m.leading)) for m in matrices)
    figure = _figure(COLUMNS * (1.6 + 0.2 * max(most, 6)), rows * (1.6 + 0.18 * max(most, 6)))
    panels = figure.subplots(rows, COLUMNS, squeeze=False).ravel()
    for empty in panels[len(matrices) :]:
        empty.set_axis_off()
    for ax, matrix in zip(panels, matrices, strict=False):
        _matrix(ax, matrix)
    figure.suptitle(
        f"Signal to noise {RATIO:g}: most probable cause, % of the trials of each row", fontsize=10
    )
    return figure


class Matrix(NamedTuple):
    """Shares (hidden, leading) of one bench's trials; its causes by name."""

    bench: str
    hidden: list[str]
    leading: list[str]
    share: np.ndarray


def _matrices(cells: list[dict[str, Any]]) -> list[Matrix]:
    """Clean plates with strong effects, bench by bench."""
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
        found.append(Matrix(name, [f"{h} ({sum(counts[h].values())})" for h in hidden], leading, share))
    return found


def _matrix(ax: Axes, own: Matrix) -> None:
    ax.imshow(np.ma.masked_equal(own.share, 0.0), cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    ax.set_xticks(range(len(own.leading)), own.leading, rotation=90, fontsize=7)
    ax.set_yticks(range(len(own.hidden)), own.hidden, fontsize=7)
    ax.set_xlabel("most probable", fontsize=8)
    ax.set_ylabel("hidden (trials)", fontsize=8)
    ax.set_title(own.bench, fontsize=9)
    for i, row in enumerate(own.share):
        for j, value in enumerate(row):
            if value > 0.0:
                shade = "white" if value > 0.6 else "black"
                ax.text(j, i, f"{100 * value:.0f}", ha="center", va="center", fontsize=6, color=shade)


def _reliability(sets: list[dict[str, Any]]) -> Figure:
    """How often the leading class was right, by its probability."""
    figure = _figure(5.2, 4.4)
    ax = figure.subplots()
    ax.plot((0, 1), (0, 1), color=GREY, linewidth=0.8)
    for own, colour, marker in zip(sets, COLOURS, "os", strict=False):
        p = np.array([b["probability"] for b in own["bins"]])
        right = np.array([b["right"] for b in own["bins"]])
        n = np.array([b["n"] for b in own["bins"]])
        # of a share, with one trial of each outcome added
        smooth = (right * n + 1) / (n + 2)
        bars = np.sqrt(smooth * (1 - smooth) / n)
        label = f"{own['set']}: {own['n']}, {own['error']:.3f} ({own['standard_error']:.3f} by chance alone)"
        ax.errorbar(p, right, yerr=bars, fmt=marker, ms=4, color=colour, elinewidth=0.8, label=label)
    ax.set_xlim(0, 1.02)
    ax.set(ylim=(0, 1.3), yticks=np.linspace(0.0, 1.0, 6))
    ax.set_xlabel("probability of the leading class")
    ax.set_ylabel("share that was right")
    ax.legend(
        fontsize=7.5, loc="upper left", frameon=False, title="trials, calibration error", title_fontsize=7.5
    )
    ax.spines[["top", "right"]].set_visible(False)
    return figure


if __name__ == "__main__":
    for path in draw():
        print(path.relative_to(HERE.parent))
