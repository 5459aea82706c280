"""Sandwiches: error of first-order theory against the softness of the core, and the expected error.

python figures/22_sandwiches.py [--help]
"""

from __future__ import annotations

from typing import Any

import numpy as np
from journal import BAND, BLUE, DOUBLE_MM, GREEN, ORANGE, Drawing, Picture, figure
from matplotlib.figure import Figure

MARKS = {0.05: (BLUE, "s"), 0.1: (ORANGE, "^"), 0.2: (GREEN, "o")}
# Differences below this are those of thick plates without a core, %.
LEAST_PERCENT = 0.05


def pictures(data: dict[str, Any]) -> list[Picture]:
    cases = data["cases"]
    n_modes = sum(len(case["modes"]) for case in cases)
    return [
        Picture(
            "22_sandwiches",
            _panels(cases),
            "First-order theory of sandwiches against three dimensions, by the softness of the core.",
            "How much too low the frequencies of the Ritz model are against 20-node bricks: "
            f"{n_modes} modes of {len(cases)} sandwiches with faces of 0.05, 0.1 and 0.2 of the thickness. "
            "Left: by Young's modulus of the faces over the shear modulus of the core. Right: against what "
            "is expected of faces that bend by themselves; grey: within a factor of two. Dashed: the limit "
            "of 5 %, beyond which the answer is not to be used. Differences below "
            f"{LEAST_PERCENT:g} % are not drawn.",
        )
    ]


def _panels(cases: list[dict[str, Any]]) -> Figure:
    new = figure(DOUBLE_MM, 85)
    by_ratio, rule = new.subplots(1, 2, sharey=True)
    labelled: set[float] = set()
    for case in cases:
        face = case["face"]
        colour, marker = MARKS[face]
        low = np.array([m["too_low_percent"] for m in case["modes"]])
        expected = np.array([m["expected_percent"] for m in case["modes"]])
        drawn = low > LEAST_PERCENT
        label = f"faces {face:g} h" if face not in labelled else None
        labelled.add(face)
        style: dict[str, Any] = {"ms": 3, "mew": 0, "alpha": 0.6, "color": colour, "ls": ""}
        by_ratio.plot(np.full(int(drawn.sum()), case["ratio"]), low[drawn], marker, **style)
        rule.plot(np.maximum(expected[drawn], 1e-3), low[drawn], marker, label=label, **style)
    ends = np.array([LEAST_PERCENT, 100.0])
    rule.plot(ends, ends, color="0.4", linewidth=0.7)
    rule.fill_between(ends, ends / 2, ends * 2, color=BAND, lw=0, zorder=0)
    for panel in (by_ratio, rule):
        panel.axhline(5.0, color="0.4", linewidth=0.7, ls="--")
        panel.set(xscale="log", yscale="log", ylim=(LEAST_PERCENT, 100.0))
        panel.yaxis.set_major_formatter("{x:g}")
    rule.set(xlim=ends, xlabel="expected, %")
    rule.xaxis.set_major_formatter("{x:g}")
    by_ratio.set(xlabel="E of the faces over G of the core", ylabel="frequency too low, %")
    new.legend(loc="outside lower center", ncols=len(labelled))
    return new


draw = Drawing(__file__, "22_sandwiches", "no random numbers", pictures)

if __name__ == "__main__":
    draw.main()
