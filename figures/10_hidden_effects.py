"""What is found of hidden effects: which cause leads by what was hidden, and how reliable its probability is.

python figures/10_hidden_effects.py [--help]
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from journal import BLUE, DOUBLE_MM, GREY, ORANGE, SINGLE_MM, Drawing, Picture, figure
from matplotlib.axes import Axes
from matplotlib.figure import Figure

STUDY = "10_hidden_effects"
RATIO = 8.0
# Millimetres of a row, a column and the labels of a matrix.
ROW_MM, LABELS_MM = 3.4, 42.0


class Matrix(NamedTuple):
    """Fractions (hidden, leading) of the trials on one plate; its causes by name."""

    bench: str
    hidden: list[str]
    leading: list[str]
    fraction: np.ndarray
    trials: int
    right: int


def pictures(data: dict[str, Any]) -> list[Picture]:
    matrices = _matrices(data["confusion"])
    trials, right = sum(m.trials for m in matrices), sum(m.right for m in matrices)
    bins = "; ".join(
        f"{s['set']}: {s['n']} trials, calibration error {s['error']:.3f} ({s['standard_error']:.3f} by "
        "chance alone)"
        for s in data["reliability"]
    )
    drawn = [
        Picture(
            f"{STUDY}_{matrix.bench.replace(',', '').replace(' ', '_')}",
            _confusion(matrix),
            f"Most probable cause by the cause that was hidden, {matrix.bench}.",
            f"Signal to noise {RATIO:g}, and plates without a hidden cause; per cent of the trials of each "
            "row, their number in brackets. On the diagonal the most probable hypothesis is the true one: "
            f"{matrix.right} of {matrix.trials} trials here, {right} of {trials} on all plates. Causes that "
            "act alike share the rest.",
        )
        for matrix in matrices
    ]
    drawn.append(
        Picture(
            f"{STUDY}_reliability",
            _reliability(data["reliability"]),
            "How often the most probable class of causes is right, by its probability.",
            "Fraction of trials whose most probable class holds the true cause, with one standard error. "
            f"{bins[:1].upper()}{bins[1:]}.",
        )
    )
    return drawn


def _matrices(cells: list[dict[str, Any]]) -> list[Matrix]:
    """Plates without a hidden cause and with strong effects, bench by bench."""
    by_bench: dict[str, dict[str, dict[str, int]]] = {}
    for cell in cells:
        if cell["ratio"] in (0.0, RATIO):
            by_bench.setdefault(cell["bench"], {}).update(cell["counts"])
    found = []
    for name, counts in by_bench.items():
        hidden = sorted(counts, key=lambda c: (c != "none", c))
        answers = {c for row in counts.values() for c in row}
        pairs = {c for c in answers if " + " in c}
        leading = [*hidden, *sorted(answers - set(hidden) - pairs)]
        if pairs:
            leading.append("two causes")
        number = np.zeros((len(hidden), len(leading)))
        for i, h in enumerate(hidden):
            for c, k in counts[h].items():
                number[i, leading.index("two causes" if c in pairs else c)] += k
        rows = number.sum(axis=1)
        labels = [f"{h} ({n:.0f})" for h, n in zip(hidden, rows, strict=True)]
        right = int(number.diagonal().sum())
        found.append(Matrix(name, labels, leading, number / rows[:, None], int(rows.sum()), right))
    return found


def _confusion(matrix: Matrix) -> Figure:
    """Which cause led by what was hidden, on one plate."""
    wide = min(DOUBLE_MM, 3.0 * ROW_MM * len(matrix.leading))
    new = figure(DOUBLE_MM if wide > SINGLE_MM else SINGLE_MM, LABELS_MM + ROW_MM * len(matrix.hidden) + 8)
    _matrix(new.subplots(), matrix)
    return new


def _matrix(ax: Axes, matrix: Matrix) -> None:
    ax.imshow(np.ma.masked_equal(matrix.fraction, 0.0), cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    ax.set_xticks(range(len(matrix.leading)), matrix.leading, rotation=90)
    ax.set_yticks(range(len(matrix.hidden)), matrix.hidden)
    ax.set_xlabel("most probable hypothesis")
    ax.set_ylabel("hidden cause (trials)")
    ax.set_title(f"{matrix.bench}, % of the trials of each row")
    ax.tick_params(length=0)
    for i, row in enumerate(matrix.fraction):
        for j, value in enumerate(row):
            if value > 0.0:
                shade = "white" if value > 0.6 else "black"
                ax.text(j, i, f"{100 * value:.0f}", ha="center", va="center", fontsize=7, color=shade)


def _reliability(sets: list[dict[str, Any]]) -> Figure:
    """How often the leading class was right, by its probability."""
    new = figure(SINGLE_MM, 82)
    ax = new.subplots()
    ax.plot((0, 1), (0, 1), color=GREY, linewidth=0.8)
    for trials, colour, marker in zip(sets, (BLUE, ORANGE), "os", strict=False):
        p = np.array([b["probability"] for b in trials["bins"]])
        right = np.array([b["right"] for b in trials["bins"]])
        n = np.array([b["n"] for b in trials["bins"]])
        # of a fraction, with one trial of each outcome added
        smooth = (right * n + 1) / (n + 2)
        bars = np.sqrt(smooth * (1 - smooth) / n)
        label = f"{trials['set']}, {trials['n']} trials"
        ax.errorbar(p, right, yerr=bars, fmt=marker, color=colour, elinewidth=0.8, label=label)
    ax.set(xlim=(0, 1.03), ylim=(0, 1.03))
    ax.set_xlabel("probability of the most probable class")
    ax.set_ylabel("fraction of trials that were right")
    new.legend(loc="outside upper center")
    return new


draw = Drawing(__file__, STUDY, "seed 0", pictures)

if __name__ == "__main__":
    draw.main()
