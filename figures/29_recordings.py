"""Constants identified from recorded hits, relative to the true ones.

python figures/29_recordings.py [--help]
"""

from __future__ import annotations

from typing import Any

import numpy as np
from journal import DOUBLE_MM, ORANGE, SKY, Drawing, Picture, figure
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

NAMES = {"E1_GPa": "E1", "E2_GPa": "E2", "nu12": "nu12", "G12_GPa": "G12"}


def pictures(data: dict[str, Any]) -> list[Picture]:
    counts = data["counts"]
    return [
        Picture(
            "29_recordings",
            _constants(data["cases"]),
            "Constants of plates identified from recorded hits, over the true ones.",
            "95 % intervals, one a plate, the widest on top: "
            f"{counts['inside']} of {counts['constants']} hold the true value. {counts['paired_right']} of "
            f"{counts['paired']} peaks that were taken for a mode were of it.",
        )
    ]


def _constants(cases: list[dict[str, Any]]) -> Figure:
    new = figure(DOUBLE_MM, 78)
    for axes, (key, name) in zip(new.subplots(1, len(NAMES)), NAMES.items(), strict=True):
        found = [c["constants"][key] for c in cases if key in c["constants"]]
        found.sort(key=lambda one: (one["high"] - one["low"]) / one["true"])
        for row, one in enumerate(found):
            ends = np.array([one["low"], one["high"]]) / one["true"]
            axes.plot(ends, (row, row), color=SKY if one["inside"] else ORANGE, lw=1.4)
        axes.axvline(1.0, color="0.3", lw=0.7)
        axes.set(title=name, xlabel="interval over the true value", yticks=[])
        axes.spines["left"].set_visible(False)
    held = ((SKY, "holds the true value"), (ORANGE, "does not"))
    lines = [Line2D([], [], color=colour, lw=1.4, label=label) for colour, label in held]
    new.legend(handles=lines, loc="outside lower center", ncols=2)
    return new


draw = Drawing(__file__, "29_recordings", "seed 37", pictures)

if __name__ == "__main__":
    draw.main()
