"""Figures of `paper`: differences by table, frequencies of Table 5, misfits of the printed constants."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from cpam_bayes.comparison.records import AGREES, NOT_REPRODUCIBLE, WITHIN, PaperResult, Row, kind_of
from cpam_bayes.paper.layups import PAPER
from cpam_bayes.report.comparison.captions import figures_of

_COLOURS = {AGREES: "#4878a8", WITHIN: "#8a8a8a", NOT_REPRODUCIBLE: "#c1440e"}
_MISPRINTED_PERCENT = 50.0


def figures(result: PaperResult) -> dict[str, Figure]:
    """All figures of the tables that were computed, by name."""
    compared = [row for row in result.rows if row.difference_percent is not None]
    draw = {
        "differences": lambda: _differences(compared),
        "frequencies": lambda: _frequencies([row for row in compared if row.table == 5]),
        "misfits": lambda: _misfits(result),
    }
    return {name: draw[name]() for name in figures_of(result)}


def _differences(rows: list[Row]) -> Figure:
    numbers = sorted({row.table for row in rows})
    figure = Figure(figsize=(7.0, 3.6), layout="constrained")
    axes = figure.subplots()
    for kind, colour in _COLOURS.items():
        of_kind = [row for row in rows if kind_of(row.verdict) == kind]
        # spread by their place in the table, so that rows do not hide each other
        places = [numbers.index(r.table) + 0.35 * np.sin(7.0 * i) for i, r in enumerate(of_kind)]
        values = [r.difference_percent or 0.0 for r in of_kind]
        axes.plot(places, values, "o", ms=3, alpha=0.7, color=colour, label=kind)
    axes.set_yscale("symlog", linthresh=1.0)
    axes.axhline(0.0, color="0.4", linewidth=0.7)
    axes.set_xticks(range(len(numbers)), [str(n) for n in numbers])
    axes.set_xlabel("table of the paper")
    axes.set_ylabel("printed over computed, less one, %")
    axes.legend(fontsize="small", frameon=False)
    return figure


def _frequencies(rows: list[Row]) -> Figure:
    names = list(dict.fromkeys(row.specimen for row in rows))
    figure = Figure(figsize=(7.0, 3.6), layout="constrained")
    axes = figure.subplots()
    for i, name in enumerate(names):
        off = [row.difference_percent or 0.0 for row in rows if row.specimen == name]
        shown = [(k, v) for k, v in enumerate(off) if abs(v) < _MISPRINTED_PERCENT]
        places = [i + 0.8 * (k + 0.5) / len(off) - 0.4 for k, _ in shown]
        axes.bar(places, [v for _, v in shown], 0.7 / len(off), color="#4878a8" if i % 2 else "#c1440e")
    axes.axhline(0.0, color="0.4", linewidth=0.7)
    axes.set_xticks(range(len(names)), names)
    axes.set_xlabel("plate, its modes from the left; a misprinted frequency is left out")
    axes.set_ylabel("Table 5 over converged, less one, %")
    return figure


def _misfits(result: PaperResult) -> Figure:
    own = [m for m in result.misfits if m.source.startswith(PAPER)]
    figure = Figure(figsize=(7.0, 3.6), layout="constrained")
    axes = figure.subplots()
    places = np.arange(len(own))
    axes.bar(places - 0.2, [m.rms_percent for m in own], 0.38, color="#c1440e", label="printed constants")
    axes.bar(places + 0.2, [m.our_rms_percent for m in own], 0.38, color="#4878a8", label="least F found")
    axes.set_yscale("log")
    counts = {m.case: m.case.split()[0] for m in own}
    names = [m.specimen if m.table == 9 else f"{m.specimen}\n{counts[m.case]}" for m in own]
    axes.set_xticks(places, names, fontsize="small")
    axes.set_ylabel("rms misfit of the frequencies, %")
    axes.legend(fontsize="small", frameon=False)
    return figure
