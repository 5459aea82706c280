"""Claims on what misled earlier versions and on good plates of bricks, and the constants in their intervals.

python figures/30_patterns.py [--help]
"""

from __future__ import annotations

from typing import Any

from journal import BAND, BLUE, DOUBLE_MM, GREY, ORANGE, YELLOW, Drawing, Picture, bare, figure, stacked
from matplotlib.figure import Figure

COLOURS = {"right": BLUE, "open": "#DDDDDD", "missed": YELLOW, "wrong": ORANGE}
# Coverage that was predicted.
PREDICTED = (0.93, 0.97)


def pictures(data: dict[str, Any]) -> list[Picture]:
    rows = data["patterns"]
    total = {key: sum(row[key] for row in rows) for key in ("lists", "wrong", "inside", "constants")}
    return [
        Picture(
            "30_patterns",
            _patterns(rows),
            "Claims on what misled earlier versions, and on good plates of bricks.",
            f"Left: claims on {total['lists']} lists, their number in brackets; {total['wrong']} are wrong. "
            f"Right: true constants in their 95 % intervals, {total['inside']} of {total['constants']} by "
            "the diagnosis (blue) and with nothing wrong assumed (grey); the band is "
            f"{PREDICTED[0]:g} to {PREDICTED[1]:g}.",
        )
    ]


def _patterns(rows: list[dict[str, Any]]) -> Figure:
    new = figure(DOUBLE_MM, 24 + 6.0 * len(rows))
    claims, held = new.subplots(1, 2, sharey=True, width_ratios=(3, 2))
    named = {f"{r['pattern']} ({r['lists']})": {what: r[what] for what in COLOURS} for r in rows}
    stacked(claims, named, COLOURS, "lists", edgecolor="0.3", linewidth=0.4)
    held.axvspan(*PREDICTED, color=BAND, lw=0)
    for key, colour, form in (("inside_plain", GREY, "s"), ("inside", BLUE, "o")):
        held.plot([r[key] / r["constants"] for r in rows], range(len(rows)), form, color=colour, ls="")
    held.set(xlim=(0.0, 1.03), xlabel="fraction of the constants inside")
    held.grid(axis="y")
    bare(held)
    new.legend(*claims.get_legend_handles_labels(), loc="outside lower left", ncols=len(COLOURS))
    return new


draw = Drawing(__file__, "30_patterns", "seed 126230209", pictures)

if __name__ == "__main__":
    draw.main()
