"""What is claimed of lists with hidden causes: right, wrong or nothing.

python figures/15_claims.py [--help]
"""

from __future__ import annotations

from typing import Any

from journal import BLUE, DOUBLE_MM, ORANGE, SKY, YELLOW, Drawing, Picture, figure, stacked
from matplotlib.figure import Figure

STUDY = "15_claims"
COLOURS = {
    "claimed and right": BLUE,
    "other": SKY,
    "none": "#BBBBBB",
    "undecided": "#DDDDDD",
    "missed": YELLOW,
    "claimed and wrong": ORANGE,
    "error": "#000000",
}
THIS = "diagnosis"
# Millimetres of a bar.
BAR_MM = 6.0


def pictures(data: dict[str, Any]) -> list[Picture]:
    return [
        _picture(name, engines[THIS], data["lists"][name])
        for name, engines in data["sets"].items()
        if THIS in engines
    ]


def _picture(name: str, answers: dict[str, Any], lists: int) -> Picture:
    total, right, wrong = (
        sum(row[key] for row in answers["by_kind"])
        for key in ("lists", "claimed and right", "claimed and wrong")
    )
    return Picture(
        f"{STUDY}_{name}",
        _panels(answers),
        f"What is claimed of lists with hidden causes, {name} set.",
        "Lists of independent elements and of bricks, each of a plate of its own. Left: by what is hidden. "
        "Right: single causes by signal to noise. Number of lists in brackets. Of "
        f"{total} of {lists} lists answered {right} are claimed and right, {wrong} claimed and wrong.",
    )


def _panels(answers: dict[str, Any]) -> Figure:
    kinds, ratios = (_bars(answers[by]) for by in ("by_kind", "by_ratio"))
    new = figure(DOUBLE_MM, 28 + BAR_MM * max(len(kinds), len(ratios)))
    left, right = new.subplots(1, 2)
    stacked(left, kinds, COLOURS, "lists")
    left.set_title("By what is hidden")
    if ratios:
        stacked(right, ratios, COLOURS, "lists")
    right.set_title("Single causes by signal to noise")
    handles, labels = left.get_legend_handles_labels()
    new.legend(handles, labels, loc="outside lower center", ncols=4)
    return new


def _bars(rows: list[dict[str, Any]]) -> dict[str, dict[str, int]]:
    return {f"{r['what'].strip()} ({r['lists']})": {c: r[c] for c in COLOURS} for r in rows}


draw = Drawing(__file__, STUDY, "seeds of the sets", pictures)

if __name__ == "__main__":
    draw.main()
