"""What sister plates and further tests add: probability of the hidden cause, cause by cause.

python figures/13_several_plates.py
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

HERE = Path(__file__).parent
RESULTS = HERE.parent / "studies" / "results"
STUDY = Path(__file__).stem

DPI = 130


def draw(results: Path = RESULTS, folder: Path = HERE) -> list[Path]:
    """Draw the picture from the study's results in one folder into another."""
    data = json.loads((results / f"{STUDY}.json").read_text(encoding="utf-8"))
    setups, rows = data["setups"], data["by_cause"]
    names = [s["setup"] for s in setups]
    table = np.array([[row[n] for n in names] for row in rows])
    mean = np.array([s["cause_probability"] for s in setups])
    order = np.argsort(-table[:, 0], kind="stable")
    shown = np.vstack((mean, table[order]))
    figure = Figure(figsize=(2.4 + 1.15 * len(names), 1.3 + 0.29 * len(shown)), layout="constrained")
    FigureCanvasAgg(figure)
    ax = figure.subplots()
    image = ax.imshow(shown, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    for (i, j), value in np.ndenumerate(shown):
        ax.text(j, i, f"{value:.2f}", ha="center", va="center", fontsize=8, color="w" if value > 0.6 else "k")
    ax.axhline(0.5, color="black", linewidth=1.2)
    ax.set_xticks(range(len(names)), [n.replace(" as well", "\nas well") for n in names], fontsize=9)
    ax.set_yticks(range(len(shown)), ["mean of all trials", *(rows[i]["cause"] for i in order)], fontsize=9)
    ax.xaxis.tick_top()
    ax.tick_params(length=0)
    ax.spines[:].set_visible(False)
    figure.colorbar(image, ax=ax, label="probability of the hidden cause", fraction=0.04)
    path = folder / f"{STUDY}.png"
    figure.savefig(path, dpi=DPI, metadata={"Software": None})
    return [path]


if __name__ == "__main__":
    for path in draw():
        print(path.relative_to(HERE.parent))
