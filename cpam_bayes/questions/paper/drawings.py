"""Figures of the comparison with the paper, from its JSON document."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np

from cpam_bayes.printed.tables import PAPER
from cpam_bayes.questions.paper.rows import (
    AGREES,
    FOUR,
    MISPRINTED,
    NOT_REPRODUCIBLE,
    TWO,
    UNDETERMINED,
    UNTOLD,
    WITHIN,
    Record,
)
from cpam_bayes.render.figures import new_figure
from cpam_bayes.render.report import Caption, Drawing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

OF_THE_PAPER: Final = (PAPER, f"{PAPER}, two constants")
"""Sources of the paper's own constants."""

_COLOURS: Final = {
    AGREES: "#4878a8",
    WITHIN: "#8a8a8a",
    UNTOLD: "#c9b458",
    UNDETERMINED: "#c9c9c9",
    NOT_REPRODUCIBLE: "#c1440e",
}


def drawings(document: Record) -> tuple[Drawing, ...]:
    """Figures of the computed tables."""
    compared = [row for row in document["rows"] if row["difference_percent"] is not None]
    simulated = [row for row in compared if row["table"] == 5]
    own = [m for m in document["audit"]["misfits"] if m["source"] in OF_THE_PAPER]
    drawn = (
        (
            compared,
            "differences",
            _draw_differences,
            "Each point is a printed value: at zero the paper and the computation agree. Orange points "
            "cannot be reproduced from the paper's own inputs.",
            "Differences between printed and computed values in percent, by table of the paper.",
        ),
        (
            simulated,
            "frequencies",
            _draw_frequencies,
            "Each bar is a mode: how far a frequency of Table 5 lies from the converged one.",
            "Differences of the frequencies of Table 5 from converged ones, by plate and mode.",
        ),
        (
            own,
            "misfits",
            _draw_misfits,
            "Where the orange bar is higher, other constants fit the plate's frequencies better than the "
            "printed ones.",
            "Misfit of the printed constants beside the least misfit found, by plate.",
        ),
    )
    return tuple(
        Drawing(name, partial(draw, rows), Caption(text, alt))
        for rows, name, draw, text, alt in drawn
        if rows
    )


def _draw_differences(rows: list[Record]) -> Figure:
    numbers = sorted({row["table"] for row in rows})
    figure = new_figure(7.0, 3.6)
    axes = figure.subplots()
    for kind, colour in _COLOURS.items():
        of_kind = [row for row in rows if row["verdict_kind"] == kind]
        # spread by row number, so that points do not hide each other
        places = [numbers.index(r["table"]) + 0.35 * np.sin(7.0 * i) for i, r in enumerate(of_kind)]
        values = [r["difference_percent"] for r in of_kind]
        axes.plot(places, values, "o", ms=3, alpha=0.7, color=colour, label=kind)
    axes.set_yscale("symlog", linthresh=1.0)
    axes.axhline(0.0, color="0.4", linewidth=0.7)
    axes.set_xticks(range(len(numbers)), [str(n) for n in numbers])
    axes.set(xlabel="table of the paper", ylabel="printed over computed, less one, %")
    axes.legend(fontsize="small", frameon=False)
    return figure


def _draw_frequencies(rows: list[Record]) -> Figure:
    names = list(dict.fromkeys(row["specimen"] for row in rows))
    figure = new_figure(7.0, 3.6)
    axes = figure.subplots()
    for i, name in enumerate(names):
        off = [row["difference_percent"] for row in rows if row["specimen"] == name]
        shown = [(k, v) for k, v in enumerate(off) if abs(v) < MISPRINTED]
        places = [i + 0.8 * (k + 0.5) / len(off) - 0.4 for k, _ in shown]
        axes.bar(places, [v for _, v in shown], 0.7 / len(off), color="#4878a8" if i % 2 else "#c1440e")
    axes.axhline(0.0, color="0.4", linewidth=0.7)
    axes.set_xticks(range(len(names)), names)
    axes.set_xlabel("plate, its modes from the left; a misprinted frequency is left out")
    axes.set_ylabel("Table 5 over converged, less one, %")
    return figure


def _draw_misfits(misfits: list[Record]) -> Figure:
    figure = new_figure(7.0, 3.6)
    axes = figure.subplots()
    places = np.arange(len(misfits))
    printed, ours = ([m[key] for m in misfits] for key in ("rms_percent", "our_rms_percent"))
    axes.bar(places - 0.2, printed, 0.38, color="#c1440e", label="printed constants")
    axes.bar(places + 0.2, ours, 0.38, color="#4878a8", label="smallest F found")
    axes.set_yscale("log")
    counts = {TWO: "\ntwo", FOUR: "\nfour"}
    axes.set_xticks(places, [m["specimen"] + counts.get(m["case"], "") for m in misfits], fontsize="small")
    axes.set_ylabel("rms misfit of the frequencies, %")
    axes.legend(fontsize="small", frameon=False)
    return figure
