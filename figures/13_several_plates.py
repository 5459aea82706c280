"""What a sister plate and further tests add: probability of the hidden cause, cause by cause.

python figures/13_several_plates.py [--help]
"""

from __future__ import annotations

from typing import Any

import numpy as np
from journal import DOUBLE_MM, Drawing, Picture, figure
from matplotlib.figure import Figure


def pictures(data: dict[str, Any]) -> list[Picture]:
    setups = data["setups"]
    alone, best = setups[0], max(setups, key=lambda s: s["cause_probability"])
    layup, n_listed, noise, _, ratio = data["plate"]
    wrong = sum(s["claimed and wrong"] for s in setups)
    return [
        Picture(
            "13_several_plates",
            _table(data),
            "Probability of the hidden cause by what else is measured.",
            f"Flaws of {ratio:g} times the noise in lists of {n_listed} frequencies with {100 * noise:g} % "
            f"noise, {layup}, free edges, {alone['trials']} trials of independent elements. Rows: mean over "
            "the trials of a cause; columns: the list alone, with the list of a sister plate without the "
            f"flaw, or with another test of the same plate. On average {alone['cause_probability']:.2f} "
            f"alone and {best['cause_probability']:.2f} with the most informative addition "
            f"({best['setup']}). Claimed and wrong: {wrong} of {sum(s['trials'] for s in setups)}.",
        )
    ]


def _table(data: dict[str, Any]) -> Figure:
    setups, rows = data["setups"], data["by_cause"]
    names = [s["setup"] for s in setups]
    table = np.array([[row[n] for n in names] for row in rows])
    mean = np.array([s["cause_probability"] for s in setups])
    order = np.argsort(-table[:, 0], kind="stable")
    shown = np.vstack((mean, table[order]))
    new = figure(DOUBLE_MM, 22 + 6.0 * max(len(shown), 6))  # room for the words of the colour bar
    ax = new.subplots()
    image = ax.imshow(shown, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    for (i, j), value in np.ndenumerate(shown):
        ax.text(j, i, f"{value:.2f}", ha="center", va="center", color="w" if value > 0.6 else "k")
    ax.axhline(0.5, color="black", linewidth=1.0)
    ax.set_xticks(range(len(names)), [n.replace(" as well", "\nas well") for n in names])
    ax.set_yticks(range(len(shown)), ["mean of all trials", *(rows[i]["cause"] for i in order)])
    ax.set_ylabel("hidden cause")
    ax.xaxis.tick_top()
    ax.tick_params(length=0)
    ax.spines[:].set_visible(False)
    new.colorbar(image, ax=ax, label="probability of the hidden cause", fraction=0.04, pad=0.02)
    return new


draw = Drawing(__file__, "13_several_plates", "seed 0", pictures)

if __name__ == "__main__":
    draw.main()
