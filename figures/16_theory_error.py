"""First-order theory against bricks: the difference of every mode, and the rule that represents it.

python figures/16_theory_error.py [--help]
"""

from __future__ import annotations

from typing import Any

import numpy as np
from journal import BAND, BLUE, DOUBLE_MM, GREEN, GREY, ORANGE, PURPLE, Drawing, Picture, figure
from matplotlib.figure import Figure

# Plates whose bricks are not exact enough are left out.
WORST_BRICKS_PERCENT = 0.2
MARKS = {
    "unidirectional": (GREY, "o"),
    "cross-ply": (BLUE, "s"),
    "quasi-isotropic": (ORANGE, "^"),
    "angle-ply": (GREEN, "D"),
    "other": (PURPLE, "v"),
}


def pictures(data: dict[str, Any]) -> list[Picture]:
    cases = [c for c in data["cases"] if _rms(c, "bricks_error_percent") <= WORST_BRICKS_PERCENT]
    within = sum(_rms_left(c) <= 2.0 * _rms(c, "rule_percent") for c in cases)
    return [
        Picture(
            "16_theory_error",
            _panels(cases),
            "First-order shear deformation theory against three dimensions, and the rule for the difference.",
            f"Ritz model less bricks on {len(cases)} plates. Left: every mode against thickness. Right: rms "
            "over a plate's modes against the rule's standard deviation; open: as computed, filled: bias "
            f"removed. Grey: up to twice that standard deviation, as on {within} of {len(cases)} plates; "
            "the rule was fitted to them.",
        )
    ]


def _panels(cases: list[dict[str, Any]]) -> Figure:
    new = figure(DOUBLE_MM, 85)
    modes, rule = new.subplots(1, 2)
    labelled: set[str] = set()
    for case in cases:
        kind = _kind(case["case"])
        colour, marker = MARKS[kind]
        difference = np.array([m["difference_percent"] for m in case["modes"]])
        label = kind if kind not in labelled else None
        labelled.add(kind)
        thickness = np.full(len(difference), 100 * case["h_over_short_side"])
        modes.plot(thickness, difference, marker, ms=2.5, mew=0, alpha=0.6, color=colour)
        sd = _rms(case, "rule_percent")
        rule.plot(sd, _rms(case, "difference_percent"), marker, color=colour, mfc="none", mew=0.6, alpha=0.6)
        rule.plot(sd, _rms_left(case), marker, color=colour, ls="", label=label)
    modes.axhline(0.0, color="0.4", linewidth=0.7)
    modes.set(xlabel="thickness over the short side, %", ylabel="Ritz model less bricks, %", xlim=(0.0, None))
    ends = np.array([0.008, 1.5])
    rule.plot(ends, ends, color="0.4", linewidth=0.7)
    rule.fill_between(ends, 1e-4, ends * 2, color=BAND, lw=0, zorder=0)
    rule.set(
        xlabel="standard deviation by the rule, rms over modes, %",
        ylabel="Ritz model less bricks, rms over modes, %",
        xscale="log",
        yscale="log",
        ylim=(0.002, 2.0),
    )
    rule.xaxis.set_major_formatter("{x:g}")
    rule.yaxis.set_major_formatter("{x:g}")
    if labelled:
        new.legend(loc="outside lower center", ncols=len(labelled))
    return new


def _kind(name: str) -> str:
    return next((kind for kind in MARKS if f", {kind}" in name), "other")


def _rms_left(case: dict[str, Any]) -> float:
    left = [m["difference_percent"] - m["bias_percent"] for m in case["modes"]]
    return float(np.sqrt(np.mean(np.square(left))))


def _rms(case: dict[str, Any], key: str) -> float:
    return float(np.sqrt(np.mean([m[key] ** 2 for m in case["modes"]])))


draw = Drawing(__file__, "16_theory_error", "no random numbers", pictures)

if __name__ == "__main__":
    draw.main()
