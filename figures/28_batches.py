"""Verdicts of a batch on good plates, a thin one, one with a mass left on, and two near the limit.

python figures/28_batches.py [--help]
"""

from __future__ import annotations

from typing import Any

from journal import AMBER, BLUE, LIGHT, ORANGE, SINGLE_MM, Drawing, Picture, figure, stacked
from matplotlib.figure import Figure

COLOURS = {"pass": BLUE, "fail": ORANGE, "cannot be judged": AMBER, "too close to call": LIGHT}


def pictures(data: dict[str, Any]) -> list[Picture]:
    rows = data["verdicts"]
    return [
        Picture(
            "28_batches",
            _shares(rows),
            "Verdicts of a batch by the true state of the plate.",
            f"{len(data['cases'])} drawn batches of twelve plates against a limit on E1. Right is pass, "
            "fail, cannot be judged, and too close to call, from the top.",
        )
    ]


def _shares(rows: list[dict[str, Any]]) -> Figure:
    new = figure(SINGLE_MM, 42)
    axes = new.subplots()
    stacked(axes, {row["kind"]: row for row in rows}, COLOURS, "plates", edgecolor="0.3", linewidth=0.4)
    new.legend(loc="outside lower center", ncols=2)
    return new


draw = Drawing(__file__, "28_batches", "seed 28", pictures)

if __name__ == "__main__":
    draw.main()
