"""Pictures of a noise study, drawn from its JSON document alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cpam_bayes.repetition.sensitivity import SensitivityResult

__all__ = ["draw_constant", "legend_entries", "sensitivity_figures"]

_READING_COLOURS: Final = {"relative": "#1f5f8b", "rms": "#c1440e"}
# Marker and words of the legend.
_MARKS: Final = (
    ("o", "inversions: mean, sd (bar), standard error of the mean (thick)"),
    ("s", "posterior: mean and sd"),
    ("x", "printed in the paper"),
)


def draw_constant(axes: Axes, document: Mapping[str, Any], name: str) -> None:
    """One constant at all levels: differences from the inversion without noise, in percent of it."""
    reference = document["without_noise"]["constants"][name]["value"]
    readings = list(document["levels"][0]["readings"])
    for i, level in enumerate(document["levels"]):
        for j, reading in enumerate(readings):
            values = level["readings"][reading]["constants"][name]
            colour = _READING_COLOURS[reading]
            place = i + (j - (len(readings) - 1) / 2) * 0.44
            for kind, shift in (("repetition", -0.09), ("posterior", 0.09)):
                centre = 100.0 * (values[f"{kind}_mean"] / reference - 1.0)
                spread = 100.0 * values[f"{kind}_sd"] / reference
                open_mark = kind == "posterior"
                axes.errorbar(
                    place + shift,
                    centre,
                    spread,
                    fmt="s" if open_mark else "o",
                    color=colour,
                    markerfacecolor="white" if open_mark else colour,
                    markersize=3.5,
                    linewidth=0.9,
                    capsize=1.5,
                )
            axes.errorbar(
                place - 0.09,
                values["percent_error"],
                values["percent_standard_error"],
                fmt="none",
                ecolor=colour,
                elinewidth=2.6,
            )
        printed = level["constants"][name]["paper_percent_error"]
        if printed is not None:
            axes.plot(i, printed, "x", color="black", markersize=6, zorder=3)
    axes.axhline(0.0, color="0.6", linewidth=0.8, zorder=0)
    axes.set_xticks(range(len(document["levels"])), [f"{v['level_percent']:g}" for v in document["levels"]])
    axes.set_xlim(-0.6, len(document["levels"]) - 0.4)
    constant, _, unit = name.partition("_")
    axes.set_title(f"{document['plate']}: {constant} = {reference:.4g} {unit}".rstrip(), fontsize="medium")


def legend_entries(readings: Sequence[str]) -> list[Any]:
    """Handles that explain markers and colours."""
    from matplotlib.lines import Line2D

    marks = [
        Line2D([], [], color="0.2", linestyle="none", marker=mark, markersize=5, label=words)
        for mark, words in _MARKS
    ]
    marks[1].set_markerfacecolor("white")
    colours = {"relative": "relative: sd a fraction of each frequency", "rms": "rms: one sd for all modes"}
    return marks + [
        Line2D([], [], color=_READING_COLOURS[r], linewidth=3, label=colours[r]) for r in readings
    ]


def sensitivity_figures(document: Mapping[str, Any]) -> dict[str, Figure]:
    """Repetition and posterior of every constant at every level."""
    names = list(document["without_noise"]["constants"])
    figure = Figure(figsize=(max(8.4, 2.6 * len(names) + 0.6), 4.2), layout="constrained")
    grid = np.atleast_1d(figure.subplots(1, len(names)))
    for axes, name in zip(grid, names, strict=True):
        draw_constant(axes, document, name)
        axes.set_xlabel("noise, %")
    grid[0].set_ylabel("difference from the inversion\nwithout noise, %")
    handles = legend_entries(list(document["levels"][0]["readings"]))
    figure.legend(handles=handles, loc="outside lower center", ncols=2, fontsize="small", frameon=False)
    return {"sensitivity": figure}


def figures(result: SensitivityResult) -> dict[str, Figure]:
    """The figures of one noise study."""
    return dict(sensitivity_figures(result.to_dict()))
