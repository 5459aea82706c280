"""Angles that the paper's lists allow, how many sequences, and the noise that would determine C1's.

python figures/08_sequences.py
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

DPI = 130
BLUE, RED, GREY = "#4878a8", "#c0392b", "#808080"
COLUMNS = 3


def draw(results: Path = RESULTS, folder: Path = HERE) -> list[Path]:
    """Draw the pictures from the study's results in one folder into another."""
    found = json.loads((results / "08_sequences.json").read_text(encoding="utf-8"))
    return [
        _saved(_maps(found["cases"]), folder / "08_sequences.png"),
        _saved(_counts(found["cases"], found["noise"]), folder / "08_sequences_counted.png"),
        _saved(_cost(found["cost"]), folder / "08_sequences_cost.png"),
    ]


def _saved(figure: Figure, path: Path) -> Path:
    figure.savefig(path, dpi=DPI)
    return path


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _maps(cases: list[dict[str, Any]]) -> Figure:
    """Probability of every angle, one panel a case, on a scale of its own."""
    rows = -(-len(cases) // COLUMNS)
    columns = min(COLUMNS, len(cases))
    figure = _figure(max(8.0, 3.6 * columns), 0.9 + 2.0 * rows)
    panels = np.atleast_1d(figure.subplots(rows, columns)).ravel()
    for empty in panels[len(cases) :]:
        empty.set_axis_off()
    for axes, case in zip(panels, cases, strict=False):
        p, grid = np.array(case["angle_marginals"]), np.array(case["angle_grid_deg"])
        step = grid[1] - grid[0]
        edges = np.append(grid - step / 2, grid[-1] + step / 2)
        k = len(p)
        axes.pcolormesh(edges, np.arange(k + 1) + 0.5, p, cmap="Greys", vmin=0.0)
        plies = np.arange(k) + 1
        axes.plot(case["most_probable"]["angles_deg"], plies, "o", ms=7, mfc="none", mec=RED)
        shown = case["printed"] or case["own"]
        axes.plot(shown["angles_deg"], plies, "x", ms=5, color=BLUE, mew=1.6)
        axes.set(xticks=np.arange(-90, 91, 45), yticks=plies)
        axes.invert_yaxis()
        axes.set_title(f"{case['case']}: {_counted(case['credible_95_count'])} in the 95 % set", fontsize=9)
        axes.tick_params(labelsize=8)
    figure.supxlabel("angle, degrees", fontsize=9)
    figure.supylabel("unknown angle, from the bottom", fontsize=9)
    figure.suptitle(
        "Probability of each angle (dark: more); circle: most probable, cross: printed or own sequence",
        fontsize=10,
    )
    return figure


def _counted(n: int) -> str:
    """A number with thin spaces between thousands."""
    return f"{n:,}".replace(",", "\N{THIN SPACE}")


def _counts(cases: list[dict[str, Any]], noise: list[dict[str, Any]]) -> Figure:
    figure = _figure(10.5, max(3.6, 1.4 + 0.3 * len(cases)))
    left, right = figure.subplots(1, 2)
    _numbers(left, cases)
    _noise(right, noise)
    return figure


def _numbers(axes: Axes, cases: list[dict[str, Any]]) -> None:
    """Sequences on the grid, in the 95 % set, and their effective number."""
    y = np.arange(len(cases))
    for key, marker, color, label in (
        ("enumerated", "|", GREY, "on the grid"),
        ("credible_95_count", "o", BLUE, "in the 95 % set"),
        ("effective_count", "d", RED, "effective number"),
    ):
        axes.plot([c[key] for c in cases], y, marker, ms=7, color=color, label=label)
    axes.set_yticks(y, [c["case"] for c in cases], fontsize=8)
    axes.set(xscale="log", xlabel="sequences", ylim=(len(cases) - 0.5, -0.5))
    axes.grid(axis="x", color="0.9")
    axes.legend(frameon=False, fontsize=8, loc="upper center", bbox_to_anchor=(0.5, 1.14), ncols=3)
    axes.spines[["top", "right", "left"]].set_visible(False)


def _noise(axes: Axes, noise: list[dict[str, Any]]) -> None:
    """Probability of the true class against the noise that is stated."""
    for own, color in zip(noise, (BLUE, RED), strict=False):
        levels = own["levels"]
        axes.plot(
            [100 * r["relative_std"] for r in levels],
            [r["class_probability"] for r in levels],
            "o-",
            color=color,
            label=own["layup"],
        )
    axes.axhline(0.95, color="0.6", lw=0.8, ls="--")
    axes.set(xscale="log", xlabel="noise, % of each frequency", ylabel="probability of C1's own class")
    axes.set(ylim=(-0.03, 1.05))
    if noise:
        levels = sorted({100 * r["relative_std"] for own in noise for r in own["levels"]})
        axes.set_xticks(levels, [f"{level:g}" for level in levels], rotation=45)
        axes.set_xticks([], minor=True)
        axes.legend(frameon=False, fontsize=8)
    axes.spines[["top", "right"]].set_visible(False)


def _cost(cost: list[dict[str, Any]]) -> Figure:
    """Wall-clock time and peak memory against the number of unknown angles, one line a noise."""
    figure = _figure(8.5, 3.6)
    left, right = figure.subplots(1, 2)
    levels = sorted({c["relative_std"] for c in cost}, reverse=True)
    for noise, color in zip(levels, (BLUE, RED), strict=False):
        own = [c for c in cost if c["relative_std"] == noise]
        angles = [c["unknown_angles"] for c in own]
        label = f"noise {100 * noise:g} %"
        left.plot(angles, [c["seconds"] for c in own], "o-", color=color, label=label)
        right.plot(angles, [c["peak_gib"] for c in own], "o-", color=color, label=label)
    left.set(ylim=(0.0, None), ylabel="seconds")
    right.set(ylim=(0.0, None), ylabel="peak memory, GiB")
    for axes in (left, right):
        axes.set(xlabel="unknown angles", xticks=sorted({c["unknown_angles"] for c in cost}))
        axes.spines[["top", "right"]].set_visible(False)
    if cost:
        left.legend(frameon=False, fontsize=8)
    return figure


if __name__ == "__main__":
    for _path in draw():
        print(_path.name)
