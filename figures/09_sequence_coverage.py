"""Rank probabilities of true stacking sequences, and sizes of the credible sets.

python figures/09_sequence_coverage.py [--help]
"""

from __future__ import annotations

from typing import Any

import numpy as np
from journal import BAND, BLUE, DOUBLE_MM, GREY, ORANGE, Drawing, Picture, figure, subscripts
from matplotlib.axes import Axes
from matplotlib.figure import Figure


def pictures(found: dict[str, Any]) -> list[Picture]:
    said = "; ".join(
        f"{c['case']}, {len(c['trials'])} lists: p = {c['p_uniform']:.2f}, median size "
        f"{c['median_set_size']:g}, true one most probable in {100 * c['truth_ranked_first']:.0f} %"
        for c in found["cases"]
    )
    return [
        Picture(
            "09_sequence_coverage",
            _all(found),
            "Coverage of credible sets of stacking sequences at every level, and their sizes.",
            f"Stacking sequences drawn from the prior, lists with {100 * found['noise']:g} % noise. Left: "
            "fraction of randomised sets that hold the true stacking sequence less their level; grey: "
            f"{found['allowed']:g} binomial standard deviations; dashed: 95 %. Right: sizes of the 95 % "
            "sets. p tests that the rank probability of the true one is uniform. "
            f"{said[0].upper()}{said[1:]}.",
        )
    ]


def _all(found: dict[str, Any]) -> Figure:
    cases = found["cases"]
    new = figure(DOUBLE_MM, 10 + 58 * len(cases))
    panels = new.subplots(len(cases), 2, squeeze=False)
    for (left, right), case in zip(panels, cases, strict=True):
        _coverage(left, case, found["allowed"])
        _sizes(right, case)
    handles, labels = panels[0][0].get_legend_handles_labels()
    new.legend(handles, labels, loc="outside lower center", ncols=3)
    return new


def _coverage(axes: Axes, case: dict[str, Any], allowed: float) -> None:
    """Coverage of randomised sets minus their level, at every level."""
    rank_probability = np.sort([t["place"] for t in case["trials"]])
    level = np.linspace(0.0, 1.0, 401)
    covered = np.searchsorted(rank_probability, level, side="right") / len(rank_probability)
    band = allowed * np.sqrt(level * (1.0 - level) / len(rank_probability))
    axes.fill_between(level, -band, band, color=BAND, lw=0, label=f"{allowed:g} binomial sd")
    axes.step(level, covered - level, where="post", color=BLUE, label="coverage - level")
    axes.axhline(0.0, color=GREY, lw=0.8)
    axes.axvline(0.95, color=ORANGE, lw=0.9, ls="--", label="95 %")
    axes.set(xlabel="level of the set", ylabel="coverage - level", xlim=(0.0, 1.0))
    axes.set_title(
        f"{case['case'][0].upper()}{case['case'][1:]}: {subscripts(case['layup'])}, grid of "
        f"{case['step_deg']:g} degrees"
    )


def _sizes(axes: Axes, case: dict[str, Any]) -> None:
    size = np.array([t["set_size"] for t in case["trials"]])
    edges = np.unique(np.round(np.geomspace(1, max(int(size.max()), 30) + 1, 16)))
    axes.hist(size, bins=edges - 0.5, color=BLUE)
    axes.set(xscale="log", xlabel="stacking sequences in the 95 % set", ylabel="lists")
    axes.set_title(f"True one most probable in {100 * case['truth_ranked_first']:.0f} % of {len(size)} lists")


draw = Drawing(__file__, "09_sequence_coverage", "seed 0", pictures)

if __name__ == "__main__":
    draw.main()
