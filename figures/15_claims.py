"""What is claimed of lists with hidden causes: right, wrong or nothing, beside other methods.

python figures/15_claims.py [--help]
"""

from __future__ import annotations

from typing import Any

from journal import BLUE, DOUBLE_MM, ORANGE, SKY, Drawing, Picture, bare, figure
from matplotlib.axes import Axes
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
        "hidden. Right: this diagnosis and other methods, each on the lists that it and this diagnosis "
        f"both answered; their number in brackets. Of {total}{asked} lists answered so far {right} are "
        f"claimed and right, {wrong} claimed and wrong.",
    )


def _panels(engines: dict[str, Any]) -> Figure:
    """This diagnosis by what was hidden, and all methods on the same lists."""
    kinds, methods = _by_kind(engines), _by_method(engines)
    new = figure(DOUBLE_MM, 28 + BAR_MM * max(len(kinds), len(methods)))
    left, right = new.subplots(1, 2)
    _bars(left, kinds)
    left.set_title("This diagnosis, by what was hidden")
    _bars(right, methods)
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


def _bars(ax: Axes, rows: dict[str, dict[str, int]]) -> None:
    """Fraction of each category, one bar a row, stacked."""
    names = list(rows)
    base = [0.0] * len(names)
    for category, colour in COLOURS.items():
        percent = [100.0 * rows[n][category] / max(sum(rows[n].values()), 1) for n in names]
        ax.barh(range(len(names)), percent, 0.75, left=base, color=colour, label=category)
        base = [b + s for b, s in zip(base, percent, strict=True)]
    ax.set_yticks(range(len(names)), names)
    ax.set_ylim(len(names) - 0.5, -0.5)
    ax.set(xlim=(0.0, 100.0), xlabel="fraction of the lists, %")
    bare(ax)


draw = Drawing(__file__, STUDY, "seed 0", pictures)

if __name__ == "__main__":
    draw.main()
