"""How often a single swarm finds the best constants of a plate, and how often several, polished, do.

python figures/20_swarms.py
"""

from __future__ import annotations

import json
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

HERE = Path(__file__).parent
RESULTS = HERE.parent / "studies" / "results"

DPI = 110
COLOURS = {"found": "#7a9e7e", "wrong": "#c1440e", "open": "#e8e8e8"}
WORDS = {"found": "found the best", "wrong": "converged elsewhere", "open": "did not converge"}
WAYS = {"single": "single swarm, as in the paper", "several": "swarms until two agree, polished"}


def draw(results: Path = RESULTS, folder: Path = HERE) -> list[Path]:
    """Draw one bar a plate and way from the study's results in one folder into another."""
    data = json.loads((results / "20_swarms.json").read_text(encoding="utf-8"))
    rows, seeds = data["plates"], data["seeds"]
    figure = Figure(figsize=(7.2, 0.28 * len(rows) + 1.7), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, 2, sharey=True)
    for axes, (way, title) in zip(panels, WAYS.items(), strict=True):
        for k, row in enumerate(rows):
            found, wrong = row[way]["found"], row[way]["wrong"]
            left = 0
            for kind, count in (("found", found), ("wrong", wrong), ("open", seeds - found - wrong)):
                axes.barh(k, count, left=left, color=COLOURS[kind], label=WORDS[kind] if not k else None)
                left += count
        axes.set_title(title, fontsize=10)
        axes.set_xlim(0, seeds)
        axes.set_xlabel(f"runs of {seeds}")
        axes.spines[["top", "right"]].set_visible(False)
    panels[0].set_yticks(range(len(rows)), [row["case"] for row in rows])
    panels[0].invert_yaxis()
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False, fontsize=9)
    path = folder / "20_swarms.png"
    figure.savefig(path, dpi=DPI)
    return [path]


if __name__ == "__main__":
    for path in draw():
        print(path)
