"""Evidence by three methods, and moments of posteriors by three methods.

python figures/06_evidence.py [--help]
"""

from __future__ import annotations

from typing import Any

import numpy as np
from journal import BLUE, DARK, DOUBLE_MM, LIGHT, ORANGE, Drawing, Picture, bare, figure, listed, symbol
from matplotlib.axes import Axes
from matplotlib.figure import Figure

COLOURS = {"importance": DARK, "emcee": BLUE, "nested": ORANGE}
MARKERS = {"importance": "o", "emcee": "s", "nested": "D"}
NAMES = {"importance": "importance sampling", "emcee": "emcee", "nested": "nested sampling (dynesty)"}


def pictures(data: dict[str, Any]) -> list[Picture]:
    specimens = data["specimens"]
    z = max(abs(s["evidence_z"]) for s in specimens)
    moments = max(abs(s["worst_z"]) for s in specimens)
    agreeing = sum(s["agrees"] for s in specimens)
    return [
        Picture(
            "06_evidence",
            _all(specimens),
            f"Log evidence and moments of the posteriors of {listed([s['plate'] for s in specimens])} by "
            "several methods.",
            "Left: log evidence less that of importance sampling; hollow: Laplace's approximation, which "
            "states no error. Middle and right: means and standard deviations of every parameter less "
            "those of importance sampling, in posterior standard deviations. Bars: two standard errors. "
            f"Nested and importance sampling differ by at most {z:.1f} standard errors in the evidence; the "
            f"moments of all methods by at most {moments:.1f}. The methods agree on {agreeing} of "
            f"{len(specimens)} specimens.",
        )
    ]


def _all(specimens: list[dict[str, Any]]) -> Figure:
    rows = sum(len(s["parameters"]) for s in specimens)
    new = figure(DOUBLE_MM, 35 + 6.5 * rows)
    left, middle, right = new.subplots(1, 3, width_ratios=(1.1, 1.0, 1.0))
    _evidence(left, specimens)
    _moments(middle, specimens, "mean", "Means")
    _moments(right, specimens, "sd", "Standard deviations")
    right.set_yticklabels([])
    handles, labels = middle.get_legend_handles_labels()
    new.legend(handles, labels, loc="outside lower center", ncols=3)
    return new


def _evidence(axes: Axes, specimens: list[dict[str, Any]]) -> None:
    rows = []
    for specimen in specimens:
        reference = specimen["log_evidence"]["importance"]["value"]
        for method, found in specimen["log_evidence"].items():
            color = COLOURS["nested" if method == "nested" else "importance"]
            # Laplace has no error to show
            axes.errorbar(
                found["value"] - reference,
                len(rows),
                xerr=2 * found.get("error", 0.0),
                fmt=MARKERS["nested" if method == "nested" else "importance"],
                color=color,
                mfc=color if "error" in found else "white",
                capsize=3 if "error" in found else 0,
            )
            rows.append(f"{specimen['plate']}  {method}")
        axes.axhline(len(rows) - 0.5, color=LIGHT, linewidth=0.6)
    axes.axvline(0.0, color="0.5", linewidth=0.8, zorder=0)
    axes.set_yticks(range(len(rows)), rows)
    axes.set(ylim=(len(rows) - 0.5, -0.5))
    axes.set_xlabel("difference, nats")
    axes.set_title("Log evidence")
    bare(axes)


def _moments(axes: Axes, specimens: list[dict[str, Any]], what: str, title: str) -> None:
    """Each method's mean or sd less that of importance sampling, in its standard deviations."""
    rows: list[str] = []
    for specimen in specimens:
        for parameter in specimen["parameters"]:
            base = parameter["importance"]
            for shift, (method, color) in zip((-0.22, 0.0, 0.22), COLOURS.items(), strict=True):
                moments = parameter[method]
                axes.errorbar(
                    (moments[what] - base[what]) / base["sd"],
                    len(rows) + shift,
                    xerr=2 * moments[f"{what}_error"] / base["sd"],
                    fmt=MARKERS[method],
                    ms=3,
                    capsize=2,
                    color=color,
                    label=NAMES[method] if not rows else None,
                )
            rows.append(f"{specimen['plate']}  {symbol(parameter['name'])}")
        axes.axhline(len(rows) - 0.5, color=LIGHT, linewidth=0.6)
    widest = float(np.max(np.abs(axes.get_xlim())))
    axes.axvline(0.0, color="0.5", linewidth=0.8, zorder=0)
    axes.set_yticks(range(len(rows)), rows)
    axes.set(xlim=(-widest, widest), ylim=(len(rows) - 0.5, -0.5))
    axes.set_xlabel("difference, posterior sd")
    axes.set_title(title)
    bare(axes)


draw = Drawing(__file__, "06_evidence", "seed 0", pictures)

if __name__ == "__main__":
    draw.main()
