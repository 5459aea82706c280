"""Claims about lists with hidden causes: right, wrong or none.

python figures/15_claims.py [--help]
"""

from __future__ import annotations

from typing import Any

from journal import BLUE, DOUBLE_MM, ORANGE, PURPLE, SKY, YELLOW, Drawing, Picture, figure, stacked
from matplotlib.figure import Figure

STUDY = "15_claims"
# Category -> its text in the legend and its colour; "none" is counted if nothing is hidden.
CATEGORIES = {
    "claimed and right": ("claimed and right", BLUE),
    "none": ("nothing wrong, and right", SKY),
    "other": ("unknown error", PURPLE),
    "undecided": ("undecided", "#DDDDDD"),
    "missed": ("missed", YELLOW),
    "claimed and wrong": ("claimed and wrong", ORANGE),
    "error": ("no answer", "#000000"),
}
# Height of a bar, and of the surroundings of the bars in a row of panels, mm.
BAR_MM, ABOUT_MM = 6.0, 16.0
LEGEND_MM = 10.0


def pictures(data: dict[str, Any]) -> list[Picture]:
    return [
        _picture(name, answers, data["beside"][name], data["lists"][name])
        for name, answers in data["sets"].items()
    ]


def _picture(name: str, answers: dict[str, Any], beside: dict[str, Any], lists: int) -> Picture:
    total, right, wrong = (
        sum(row[key] for row in answers["by_kind"])
        for key in ("lists", "claimed and right", "claimed and wrong")
    )
    compared = (
        f", on the {beside['lists']} lists that all methods answered; the simple methods' thresholds give "
        "the diagnosis's rate of wrong claims on development lists"
        if len(beside["engines"]) > 1
        else ""
    )
    return Picture(
        f"{STUDY}_{name}",
        _panels(answers, beside["engines"]),
        f"Claims on lists with hidden causes, {name} set.",
        "Lists from finite elements and bricks, one plate each; their number in brackets. Above: the "
        f"diagnosis of {total} of {lists} lists by what is hidden: {right} claims right, {wrong} wrong. "
        f"Below: single causes by signal to noise{compared}.",
    )


def _panels(answers: dict[str, Any], engines: dict[str, Any]) -> Figure:
    kinds = answers["by_kind"]
    ratios = {engine: own["by_ratio"] for engine, own in engines.items() if own["by_ratio"]}
    every = [*kinds, *(row for rows in ratios.values() for row in rows)]
    shown = [c for c in CATEGORIES if any(row[c] for row in every)]
    colours = {CATEGORIES[c][0]: CATEGORIES[c][1] for c in shown}
    heights = [ABOUT_MM + BAR_MM * len(rows) for rows in (kinds, *list(ratios.values())[:1])]
    new = figure(DOUBLE_MM, LEGEND_MM + sum(heights))
    above, *below = new.subfigures(len(heights), 1, height_ratios=heights) if ratios else [new]
    axes = above.subplots()
    stacked(axes, _bars(kinds, shown), colours, "lists")
    axes.set_title("By what is hidden")
    new.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=4)
    for part in below:
        row = part.subplots(1, len(ratios), sharey=True, squeeze=False)[0]
        for panel, (engine, rows) in zip(row, ratios.items(), strict=True):
            stacked(panel, _bars(rows, shown), colours, "lists")
            panel.set_title(_words(engine))
        row[0].set_ylabel("signal to noise")
    return new


def _words(engine: str) -> str:
    return engine.replace("_", " ")


def _bars(rows: list[dict[str, Any]], shown: list[str]) -> dict[str, dict[str, int]]:
    return {f"{r['what'].strip()} ({r['lists']})": {CATEGORIES[c][0]: r[c] for c in shown} for r in rows}


draw = Drawing(__file__, STUDY, "seeds of the sets", pictures)

if __name__ == "__main__":
    draw.main()
