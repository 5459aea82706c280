"""Angles allowed by the paper's lists, numbers of sequences, and the noise that would determine C1's.

python figures/08_sequences.py [--help]
"""

from __future__ import annotations

from typing import Any

import numpy as np
from journal import BLUE, DOUBLE_MM, GREEN, GREY, ORANGE, Drawing, Picture, bare, counted, figure, subscripts
from matplotlib.axes import Axes
from matplotlib.figure import Figure

COLUMNS = 3


def pictures(found: dict[str, Any]) -> list[Picture]:
    cases, noise = found["cases"], found["noise"]
    likely = sum(
        c["printed"] is not None and c["printed"]["angles_deg"] == c["most_probable"]["angles_deg"]
        for c in cases
    )
    printed = sum(c["printed"] is not None for c in cases)
    drawn = [
        Picture(
            "08_sequences",
            _maps(cases),
            "Posterior probability of each unknown angle, for the cases of Table 9(b).",
            "One panel a case; rows: unknown angles from the bottom of the laminate; darker: more "
            "probable, on a scale of its own in each panel. Circles: most probable stacking sequence; "
            "crosses: the one printed in Table 9(b), or that of the plate where none is printed. The most "
            f"probable stacking sequence is the printed one in {likely} of the {printed} printed cases.",
        ),
        Picture(
            "08_sequences_counted",
            _counts(cases, noise),
            "How many stacking sequences the frequencies leave, and the noise that would determine that of "
            "C1.",
            "Left: stacking sequences on the grid, in the 95 % set, and their effective number "
            "(exponential of the entropy). Right: posterior probability of the class of C1's true layup "
            "against the stated noise; dashed: 0.95.",
        ),
    ]
    if found["cost"]:
        cost = found["cost"]
        most = max(cost, key=lambda c: (c["unknown_angles"], -c["relative_std"]))
        drawn.append(
            Picture(
                "08_sequences_cost",
                _cost(cost),
                "Time and memory of the posterior over stacking sequences against the number of unknown "
                "angles.",
                "Wall time and peak memory, summed over the processes, for simulated lists with two levels "
                f"of noise, on the machine of the study. {most['unknown_angles']} angles, "
                f"{counted(most['enumerated'])} stacking sequences, with {100 * most['relative_std']:g} % "
                f"noise take {most['seconds']:.0f} s and {most['peak_gib']:.1f} GiB.",
            )
        )
    return drawn


def _maps(cases: list[dict[str, Any]]) -> Figure:
    """Probability of every angle, one panel per case, on a scale of its own."""
    rows = -(-len(cases) // COLUMNS)
    new = figure(DOUBLE_MM, 12 + 35 * rows)
    panels = new.subplots(rows, COLUMNS, squeeze=False).ravel()
    for empty in panels[len(cases) :]:
        empty.set_axis_off()
    for axes, case in zip(panels, cases, strict=False):
        p, grid = np.array(case["angle_marginals"]), np.array(case["angle_grid_deg"])
        step = grid[1] - grid[0]
        edges = np.append(grid - step / 2, grid[-1] + step / 2)
        k = len(p)
        axes.pcolormesh(edges, np.arange(k + 1) + 0.5, p, cmap="Greys", vmin=0.0, rasterized=True)
        plies = np.arange(k) + 1
        axes.plot(case["most_probable"]["angles_deg"], plies, "o", ms=5, mfc="none", mec=ORANGE, mew=1.2)
        reference = case["printed"] or case["own"]
        axes.plot(reference["angles_deg"], plies, "x", ms=4.5, color=BLUE, mew=1.4)
        axes.set(xticks=np.arange(-90, 91, 45), yticks=plies)
        axes.set_xlim(-95.0, 95.0)
        axes.invert_yaxis()
        axes.set_title(f"{case['case']}: {counted(case['credible_95_count'])} in the 95 % set", fontsize=7.5)
    new.supxlabel("angle, degrees", fontsize=7.5)
    new.supylabel("unknown angle, from the bottom", fontsize=7.5)
    for style, colour, label in (
        ("o", ORANGE, "most probable"),
        ("x", BLUE, "printed, or that of the plate"),
    ):
        panels[0].plot([], [], style, color=colour, mfc="none", label=label)
    new.legend(loc="outside upper center", ncols=2)
    return new


def _counts(cases: list[dict[str, Any]], noise: list[dict[str, Any]]) -> Figure:
    new = figure(DOUBLE_MM, max(70.0, 30 + 5.0 * len(cases)))
    left, right = new.subplots(1, 2)
    _numbers(left, cases)
    _noise(right, noise)
    return new


def _numbers(axes: Axes, cases: list[dict[str, Any]]) -> None:
    """Numbers of stacking sequences on the grid and in the 95 % set, and their effective number."""
    y = np.arange(len(cases))
    for key, marker, color, label in (
        ("enumerated", "|", GREY, "on the grid"),
        ("credible_95_count", "o", BLUE, "in the 95 % set"),
        ("effective_count", "D", ORANGE, "effective number"),
    ):
        axes.plot([c[key] for c in cases], y, marker, ms=6 if marker == "|" else 4, color=color, label=label)
    axes.set_yticks(y, [c["case"] for c in cases])
    axes.set(xscale="log", xlabel="number of stacking sequences", ylim=(len(cases) - 0.5, -0.5))
    axes.grid(axis="x")
    axes.legend(loc="lower center", bbox_to_anchor=(0.45, 1.0), ncols=3, columnspacing=1.0)
    bare(axes)


def _noise(axes: Axes, noise: list[dict[str, Any]]) -> None:
    """Probability of the true class against the stated noise."""
    for case, color, marker in zip(noise, (BLUE, ORANGE, GREEN), "osD", strict=False):
        levels = case["levels"]
        axes.plot(
            [100 * r["relative_std"] for r in levels],
            [r["class_probability"] for r in levels],
            marker + "-",
            color=color,
            label=subscripts(case["layup"]),
        )
    axes.axhline(0.95, color="0.6", lw=0.8, ls="--")
    axes.set(xscale="log", xlabel="noise, % of each frequency", ylabel="probability of the true class of C1")
    axes.set(ylim=(-0.03, 1.05))
    if noise:
        levels = sorted({100 * r["relative_std"] for case in noise for r in case["levels"]})
        axes.set_xticks(levels, [f"{level:g}" for level in levels], rotation=90)
        axes.set_xticks([], minor=True)
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)


def _cost(cost: list[dict[str, Any]]) -> Figure:
    """Wall time and peak memory against the number of unknown angles, one line per noise level."""
    new = figure(DOUBLE_MM, 62)
    left, right = new.subplots(1, 2)
    levels = sorted({c["relative_std"] for c in cost}, reverse=True)
    for noise, color, marker in zip(levels, (BLUE, ORANGE, GREEN), "osD", strict=False):
        runs = [c for c in cost if c["relative_std"] == noise]
        angles = [c["unknown_angles"] for c in runs]
        label = f"noise {100 * noise:g} %"
        left.plot(angles, [c["seconds"] for c in runs], marker + "-", color=color, label=label)
        right.plot(angles, [c["peak_gib"] for c in runs], marker + "-", color=color, label=label)
    left.set(ylim=(0.0, None), ylabel="wall time, s")
    right.set(ylim=(0.0, None), ylabel="peak memory, GiB")
    for axes in (left, right):
        axes.set(xlabel="unknown angles", xticks=sorted({c["unknown_angles"] for c in cost}))
        axes.grid(axis="y")
    left.legend(loc="upper left")
    return new


draw = Drawing(__file__, "08_sequences", "seed 0", pictures)

if __name__ == "__main__":
    draw.main()
