"""Worked cases from bricks: residuals before and after, and the probability of each cause.

python figures/17_worked_cases.py [--help]
"""

from __future__ import annotations

import textwrap
from collections import Counter
from typing import Any

import numpy as np
from journal import BLUE, DOUBLE_MM, LIGHT, ORANGE, Drawing, Picture, bare, claimed, figure
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from cpam_bayes.questions.diagnose.document import probability_text

MOST_CAUSES, CASES_A_FIGURE = 5, 6
LABELS = {
    LIGHT: "residual of the plain model; other hypotheses",
    ORANGE: "residual of the extended model",
    BLUE: "true cause",
}


def pictures(data: dict[str, Any]) -> list[Picture]:
    cases = data["cases"]
    verdicts = ", ".join(f"{word} {n}" for word, n in Counter(c["verdict"] for c in cases).items())
    said = (
        "Two panels a plate. Left: residual of each mode by the plain model and, where something is claimed, "
        "by the extended model; the title says what is wrong. Right: posterior probability of the "
        f"{MOST_CAUSES} most probable hypotheses and of the true one; the title says the claim, its "
        "probability and whether it is right. A residual that all modes of a clamped plate share is the "
        f"error of the theory, which is allowed for. Claims on all {len(cases)} plates: {verdicts}."
    )
    parts = [cases[i : i + CASES_A_FIGURE] for i in range(0, len(cases), CASES_A_FIGURE)]
    return [
        Picture(
            "17_worked_cases" + (f"_{number}" if number > 1 else ""),
            _all(part),
            "Diagnoses of plates of three-dimensional bricks with one thing wrong, or nothing"
            + (f", part {number} of {len(parts)}." if len(parts) > 1 else "."),
            said if number == 1 else "As in part 1.",
        )
        for number, part in enumerate(parts, 1)
    ]


def _all(cases: list[dict[str, Any]]) -> Figure:
    new = figure(DOUBLE_MM, 12 + 36.5 * len(cases))
    grid = new.subplots(len(cases), 2, squeeze=False, width_ratios=(1.3, 1.0))
    for (left, right), case in zip(grid, cases, strict=True):
        _residuals(left, case)
        _probabilities(right, case)
    grid[-1][0].set_xlabel("mode")
    handles = [Patch(color=colour, label=label) for colour, label in LABELS.items()]
    new.legend(handles=handles, loc="outside lower center", ncols=3)
    return new


def _residuals(axes: Axes, case: dict[str, Any]) -> None:
    before = _numbers(case["residuals_percent_before"])
    x = np.arange(1, len(before) + 1)
    after = case["residuals_percent_after"]
    axes.bar(x - 0.2, before, 0.38, color=LIGHT)
    extended = np.zeros(0) if after is None else _numbers(after)
    axes.bar(x[: len(extended)] + 0.2, extended, 0.38, color=ORANGE)
    axes.axhline(0.0, color="0.4", linewidth=0.7)
    axes.set_xticks(x)
    axes.set_ylabel("residual, %")
    axes.set_title(textwrap.fill(f"{case['case']}: {case['truth']['size']}", 64), loc="left", fontsize=7.5)


def _probabilities(axes: Axes, case: dict[str, Any]) -> None:
    true = case["truth"]["cause"]
    shown = case["hypotheses"][:MOST_CAUSES]
    shown += [h for h in case["hypotheses"][MOST_CAUSES:] if h["cause"] == true]
    y = np.arange(len(shown))
    p = np.array([h["probability"] for h in shown])
    axes.barh(y, p, 0.65, color=[BLUE if h["cause"] == true else LIGHT for h in shown])
    names = [h["cause"] + (" (true)" if h["cause"] == true else "") for h in shown]
    axes.set_yticks(y, names)
    axes.set(xlim=(0.0, 1.0), ylim=(len(shown) - 0.5, -0.5), xlabel="posterior probability")
    bare(axes)
    claim = claimed(case)
    if case["claim"] == "undecided":
        title = f"undecided; most probable: {', '.join(case['causes'])}"
    else:
        title = f"claim: {claim}, {probability_text(case['probability'])}: {case['verdict']}"
    axes.set_title(textwrap.fill(title, 44), loc="left", fontsize=7.5)


def _numbers(values: list[float | None]) -> np.ndarray:
    return np.array([np.nan if v is None else v for v in values])


draw = Drawing(__file__, "17_worked_cases", "seed 0", pictures)

if __name__ == "__main__":
    draw.main()
