"""Marginal likelihoods of the diagnosis less those of a slow reference, over the distance from the best.

python figures/18_evidence_reference.py [--help]
"""

from __future__ import annotations

from typing import Any

from journal import BAND, BLUE, GREY, ORANGE, SINGLE_MM, Drawing, Picture, figure
from matplotlib.figure import Figure

# Agreement that is asked for, nats, and the distance within which it is.
AGREED, NEAR = 0.3, 8.0
_TICKS = (0.3, 3, 30, 300, 3000, 30000)


def pictures(data: dict[str, Any]) -> list[Picture]:
    summary = data["summary"]
    return [
        Picture(
            "18_evidence_reference",
            _differences(data["cases"]),
            "Log marginal likelihoods of the diagnosis less those of a slow and independent reference.",
            f"All hypotheses of {summary['cases']} simulated lists, over how far they are below the best "
            f"hypothesis of their list. Grey: {AGREED:g} nats, the agreement that is asked for within "
            f"{NEAR:g} nats of the best; {summary['near_agreed']} of {summary['near']} hypotheses there are "
            f"within it. Beyond, {summary['far_not_too_high']} of {summary['far']} are not too high. Both "
            "axes are linear inside and logarithmic outside the grey area.",
        )
    ]


def _differences(cases: list[dict[str, Any]]) -> Figure:
    new = figure(SINGLE_MM, 78)
    axes = new.subplots()
    axes.fill_between((0.0, NEAR), -AGREED, AGREED, color=BAND, lw=0, zorder=0)
    for case in cases:
        best = max(row["slow"] for row in case["hypotheses"])
        below = [best - row["slow"] for row in case["hypotheses"]]
        difference = [row["fast"] - row["slow"] for row in case["hypotheses"]]
        colour, marker = (BLUE, "o") if case["noise_stated"] else (ORANGE, "s")
        axes.plot(below, difference, marker, color=colour, ls="", alpha=0.8, mew=0)
    axes.axhline(0.0, color=GREY, linewidth=0.7)
    axes.plot([], [], "o", color=BLUE, label="noise stated")
    axes.plot([], [], "s", color=ORANGE, label="noise inferred")
    axes.set_xscale("symlog", linthresh=NEAR)
    axes.set_yscale("symlog", linthresh=AGREED)
    axes.set(xlabel="below the best hypothesis, nats", ylabel="diagnosis less reference, nats")
    axes.set_xlim(-0.3, None)
    axes.set_xticks((0, 2, 4, 6, 8, 100, 1000), ("0", "2", "4", "6", "8", "100", "1000"))
    furthest = max((abs(y) for line in axes.lines for y in line.get_ydata()), default=AGREED)
    ticks = [t for t in _TICKS if t <= max(furthest, AGREED)]
    places = [-t for t in reversed(ticks)] + [0.0, *ticks]
    axes.set_yticks(places, [f"{t:g}" for t in places])
    axes.minorticks_off()
    new.legend(loc="outside upper center", ncols=2)
    return new


draw = Drawing(__file__, "18_evidence_reference", "seed 0", pictures)

if __name__ == "__main__":
    draw.main()
