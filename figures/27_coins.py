"""Masses of coins as sealed and as the coin test finds them, on plates of independent elements and of bricks.

python figures/27_coins.py [--help]
"""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
from journal import BLUE, LIGHT, SINGLE_MM, Drawing, Picture, figure
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

CLAIMED = "mass added"
FORMS = {"elements": "o", "bricks": "s"}


def pictures(data: dict[str, Any]) -> list[Picture]:
    lists = [c | {"solver": one["solver"]} for one in data["cases"] for c in one["lists"]]
    coins, repeats = ([c for c in lists if bool(c["sealed_g"]) is there] for there in (True, False))
    inside = sum(c["low_g"] <= c["sealed_g"] <= c["high_g"] for c in coins)
    return [
        Picture(
            "27_coins",
            _masses(coins),
            "Masses of coins, found over sealed, on plates of independent elements and of bricks.",
            f"95 % intervals of the mass, blue where one is claimed; {inside} of "
            f"{len(coins)} hold the sealed mass. Left of 1: lighter than the detection limit of the plate's "
            f"list. Of {len(repeats)} repeats without a coin "
            f"{sum(c['finding'] == CLAIMED for c in repeats)} were "
            "said to have one.",
        )
    ]


def _masses(coins: list[dict[str, Any]]) -> Figure:
    new = figure(SINGLE_MM, 70)
    axes = new.subplots()
    for claimed, solver in product((False, True), FORMS):
        those = [c for c in coins if (c["finding"] == CLAIMED) is claimed and c["limit_g"]]
        those = [c for c in those if c["solver"] == solver]
        colour, form = BLUE if claimed else LIGHT, FORMS[solver]
        sealed, found, low, high, limit = (
            np.array([c[f"{key}_g"] for c in those]) for key in ("sealed", "found", "low", "high", "limit")
        )
        away = np.abs(np.stack((low, high)) - found) / sealed
        axes.errorbar(sealed / limit, found / sealed, away, fmt=form, ms=3, lw=0.7, color=colour)
    axes.axhline(1.0, color="0.3", lw=0.7)
    axes.axvline(1.0, color="0.3", lw=0.7, ls=":")
    axes.set(xscale="log", yscale="log", ylim=(0.05, 20.0))
    axes.set(xlabel="sealed mass over the detection limit", ylabel="found over sealed")
    shown = [("claimed", "o", BLUE), ("not claimed", "o", LIGHT)]
    shown += [(f"on {solver}", form, "0.3") for solver, form in FORMS.items()]
    marks = [Line2D([], [], ls="", marker=m, ms=4, color=c, label=name) for name, m, c in shown]
    new.legend(handles=marks, loc="outside lower center", ncols=2)
    return new


draw = Drawing(__file__, "27_coins", "seed 31", pictures)

if __name__ == "__main__":
    draw.main()
