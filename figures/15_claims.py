"""What is claimed of lists with hidden causes: right, wrong or nothing, beside other methods.

python figures/15_claims.py [--help]
"""

from __future__ import annotations

from typing import Any

from journal import BLUE, DOUBLE_MM, ORANGE, SKY, Drawing, Picture, figure, stacked
from matplotlib.figure import Figure

STUDY = "15_claims"
COLOURS = {
    "claimed and right": BLUE,
    "other": SKY,
    "none": "#BBBBBB",
    "undecided": "#DDDDDD",
    "claimed and wrong": ORANGE,
    "error": "#000000",
}
SETS = {"final": "final set", "rows": "known failures", "tuning": "tuning set"}
THIS = "diagnosis"
NAMES = {THIS: "this diagnosis"}
# Millimetres of a bar.
BAR_MM = 6.0


def pictures(data: dict[str, Any]) -> list[Picture]:
    return [
        _picture(name, engines, data["lists"].get(name), data["noise"])
        for name, engines in data["sets"].items()
        if engines
    ]


def _picture(name: str, engines: dict[str, Any], lists: int | None, noise: float) -> Picture:
    answers = engines.get(THIS) or next(iter(engines.values()))
    total, right, wrong = (
        sum(row[key] for row in answers["by_kind"])
        for key in ("lists", "claimed and right", "claimed and wrong")
    )
    asked = f" of {lists}" if lists else ""
    return Picture(
        f"{STUDY}_{name}",
        _panels(engines),
        f"What is claimed of lists with hidden causes, {SETS.get(name, name)}.",
        f"Lists of independent elements with {100 * noise:g} % noise. Left: this diagnosis by what was "
        "hidden. Right: this diagnosis and others on the same lists. Number of lists in brackets. Of "
        f"{total}{asked} lists answered {right} are claimed and right, {wrong} claimed and wrong.",
    )


def _panels(engines: dict[str, Any]) -> Figure:
    """This diagnosis by what was hidden, and all methods on the same lists."""
    kinds, methods = _by_kind(engines), _by_method(engines)
    new = figure(DOUBLE_MM, 28 + BAR_MM * max(len(kinds), len(methods)))
    left, right = new.subplots(1, 2)
    stacked(left, kinds, COLOURS, "lists")
    left.set_title("This diagnosis, by what was hidden")
    stacked(right, methods, COLOURS, "lists")
    right.set_title("By method")
    handles, labels = left.get_legend_handles_labels()
    new.legend(handles, labels, loc="outside lower center", ncols=len(COLOURS))
    return new


def _by_kind(engines: dict[str, Any]) -> dict[str, dict[str, int]]:
    answers = engines.get(THIS) or next(iter(engines.values()))
    return {f"{r['what']} ({r['lists']})": {c: r[c] for c in COLOURS} for r in answers["by_kind"]}


def _by_method(engines: dict[str, Any]) -> dict[str, dict[str, int]]:
    order = [n for n in NAMES if n in engines] + [n for n in engines if n not in NAMES]
    return {
        f"{NAMES.get(name, name).replace('_', ' ')} ({engines[name]['lists']})": {
            c: sum(r[c] for r in engines[name]["by_kind"]) for c in COLOURS
        }
        for name in order
    }


draw = Drawing(__file__, STUDY, "seed 0", pictures)

if __name__ == "__main__":
    draw.main()
