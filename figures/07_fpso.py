"""Fuzzy swarms in search of the stacking sequence of least misfit: success rates, final misfits and cost.

python figures/07_fpso.py [--help]
"""

from __future__ import annotations

from typing import Any

from journal import BLUE, DOUBLE_MM, GREY, ORANGE, SINGLE_MM, Drawing, Picture, figure
from matplotlib.axes import Axes
from matplotlib.figure import Figure

KINDS = {"synthetic": (BLUE, "o", -0.17), "printed": (ORANGE, "s", 0.17)}
WORDS = {"synthetic": "simulated list", "printed": "printed list"}
# Runs closer to the smallest F than this fraction of the margin are drawn at it.
NEAREST = 1e-3


def pictures(data: dict[str, Any]) -> list[Picture]:
    settings = data["settings"]
    runs = sum(c["success"]["rounding"]["of"] for c in data["cases"])
    exact, near = (sum(c["success"][m]["count"] for c in data["cases"]) for m in ("rounding", "one_percent"))
    swarm = (
        f"Swarms of {settings['particles']} particles, up to {settings['iterations']} iterations, "
        f"{settings['seeds']} seeds a case."
    )
    drawn = [
        Picture(
            "07_fpso",
            _cases(data),
            "The fuzzy swarm of the paper: how often it finds the smallest misfit F, how far off it ends, "
            "and its cost.",
            f"{swarm} Left: seeds that end within what rounding the list does to F (circles and squares) or "
            "what 1 % of the frequencies does (diamonds), with 68 % intervals; hollow: the smallest F is "
            "the best known, which makes the rate an upper bound. Middle: F of each run's stacking "
            "sequence less the smallest, over what rounding makes; runs at the left edge reach the "
            f"smallest F. Right: solves; those of an enumeration have derivatives. Of {runs} runs {exact} "
            f"end within rounding of the smallest F, {near} within 1 %.",
        )
    ]
    if data["particles"]:
        points = data["particles"]
        drawn.append(
            Picture(
                "07_fpso_particles",
                _more_particles(points),
                f"More particles for the fuzzy swarm on {points[0]['case']}, simulated list.",
                "Seeds that reach the smallest F to rounding and to 1 % of the frequencies, with 68 % "
                f"intervals. With {points[-1]['particles']} particles "
                f"{points[-1]['success']['rounding']['count']} of {points[-1]['success']['rounding']['of']} "
                "seeds reach it to rounding.",
            )
        )
    return drawn


def _cases(data: dict[str, Any]) -> Figure:
    names = list(dict.fromkeys(c["case"] for c in data["cases"]))
    new = figure(DOUBLE_MM, 50 + 7.5 * len(names))
    axes = new.subplots(1, 3, sharey=True, width_ratios=(1.0, 1.25, 1.0))
    axes[0].set_yticks(range(len(names)), names)
    axes[0].set_ylim(len(names) - 0.5, -0.5)
    for ax in axes:
        for row in range(1, len(names), 2):
            ax.axhspan(row - 0.5, row + 0.5, color="0.95", zorder=0)
        ax.grid(axis="x")
        ax.tick_params(axis="y", length=0)
    _success(axes[0], data["cases"], names)
    _excess(axes[1], data["cases"], names)
    _cost(axes[2], data["cases"], names)
    for ax in axes:
        ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.13), borderaxespad=0.0)
    return new


def _rows(cases: list[dict[str, Any]], names: list[str]) -> list[tuple[dict[str, Any], float, str, str]]:
    return [
        (c, names.index(c["case"]) + KINDS[c["data"]][2], KINDS[c["data"]][0], KINDS[c["data"]][1])
        for c in cases
    ]


def _success(ax: Axes, cases: list[dict[str, Any]], names: list[str]) -> None:
    for c, y, colour, marker in _rows(cases, names):
        # results measured against an upper bound of the minimum are hollow
        face = "white" if c["smallest"]["source"] == "best known" else colour
        for name, style in (("one_percent", "D"), ("rounding", marker)):
            s = c["success"][name]
            faint = name == "one_percent"
            ax.plot(
                *([100 * s["low"], 100 * s["high"]], [y, y]),
                color=colour,
                linewidth=2.6 if faint else 1.0,
                alpha=0.25 if faint else 1.0,
            )
            ax.plot(
                100 * s["count"] / s["of"],
                y,
                style,
                ms=3 if faint else 4,
                color=colour,
                mfc=face,
                clip_on=False,
            )
    for kind, (colour, marker, _) in KINDS.items():
        ax.plot([], [], marker, color=colour, label=f"{WORDS[kind]}, to rounding")
    ax.plot([], [], "D", ms=3, color=GREY, label="to 1 % of the frequencies")
    ax.set_xlim(-3, 103)
    ax.set_xlabel("seeds that reach the smallest F, %")
    ax.set_title("Success")


def _excess(ax: Axes, cases: list[dict[str, Any]], names: list[str]) -> None:
    for c, y, colour, marker in _rows(cases, names):
        rounding = c["margins"]["rounding"]
        excess = [max((r["F_fitted"] - c["smallest"]["F"]) / rounding, NEAREST) for r in c["runs"]]
        ax.plot(excess, [y] * len(excess), marker, ms=2.5, color=colour, alpha=0.45, mew=0)
        ax.plot(c["margins"]["one_percent"] / rounding, y, "|", ms=7, color=GREY, mew=1.0)
        if c["data"] == "printed":
            reference = max((c["reference"]["F"] - c["smallest"]["F"]) / rounding, NEAREST)
            ax.plot(reference, y, "x", ms=4.5, color="black", mew=1.1)
    ax.plot([], [], "x", ms=4.5, color="black", label="printed stacking sequence, or that of the plate")
    ax.plot([], [], "|", ms=7, color=GREY, mew=1.0, ls="", label="1 % of the frequencies")
    ax.axvline(1.0, color=GREY, linewidth=0.8, label="rounding")
    ax.set_xscale("log")
    ax.set_xlabel("(F of a run - smallest F) / effect of rounding")
    ax.set_title("How far off the seeds end")


def _cost(ax: Axes, cases: list[dict[str, Any]], names: list[str]) -> None:
    for c, y, colour, marker in _rows(cases, names):
        cost = c["cost"]
        ax.plot(cost["swarm_solves"], y, marker, color=colour)
        face = colour if cost["enumerated"] else "white"
        ax.plot(cost["enumeration_solves"], y, "D", color=colour, mfc=face)
    ax.plot([], [], "o", color=GREY, label="one swarm, mean")
    ax.plot([], [], "D", color=GREY, label="enumeration, done")
    ax.plot([], [], "D", color=GREY, mfc="white", label="enumeration, extrapolated")
    ax.set_xscale("log")
    ax.set_xlabel("solves")
    ax.set_title("Cost")


def _more_particles(points: list[dict[str, Any]]) -> Figure:
    new = figure(SINGLE_MM, 65)
    ax = new.subplots()
    x = [p["particles"] for p in points]
    for name, style, colour, label in (
        ("rounding", "o-", BLUE, "to rounding"),
        ("one_percent", "D--", ORANGE, "to 1 % of the frequencies"),
    ):
        successes = [p["success"][name] for p in points]
        rate = [100 * s["count"] / s["of"] for s in successes]
        low = [r - 100 * s["low"] for r, s in zip(rate, successes, strict=True)]
        high = [100 * s["high"] - r for r, s in zip(rate, successes, strict=True)]
        ax.errorbar(x, rate, (low, high), fmt=style, color=colour, label=label)
    ax.set_xscale("log")
    ax.set_xticks(x, [str(n) for n in x])
    ax.set_xticks([], minor=True)
    ax.set_ylim(-3, 103)
    ax.set_xlabel("particles")
    ax.set_ylabel("seeds that reach the smallest F, %")
    ax.grid(axis="y")
    new.legend(loc="outside upper center", ncols=2)
    return new


draw = Drawing(__file__, "07_fpso", "seeds 0 to 19", pictures)

if __name__ == "__main__":
    draw.main()
