"""How often fuzzy swarms find the sequence with the smallest misfit, how far off they end, and the cost.

python figures/07_fpso.py
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes

STUDY = Path(__file__).stem
HERE = Path(__file__).parent

# Okabe and Ito's colours, told apart by the colour-blind and in grey.
BLUE, ORANGE, GREY = "#0072B2", "#D55E00", "#777777"
KINDS = {"synthetic": (BLUE, "o", -0.17), "printed": (ORANGE, "s", 0.17)}
STYLE = {"font.size": 9.0, "axes.titlesize": 9.5, "legend.fontsize": 8.0, "axes.axisbelow": True}
# Runs nearer to the smallest F than this share of the margin are drawn at it.
NEAREST = 1e-3


def draw(results: Path, folder: Path) -> list[Path]:
    """Draw the study's results, read from one folder, into another."""
    data = json.loads((results / f"{STUDY}.json").read_text(encoding="utf-8"))
    names = list(dict.fromkeys(c["case"] for c in data["cases"]))
    settings = data["settings"]
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(
            *(1, 4),
            figsize=(13.0, 2.6 + 0.32 * len(names)),
            layout="constrained",
            width_ratios=(1.0, 1.2, 1.2, 1.0),
        )
        for ax in axes[:3]:
            ax.set_yticks(range(len(names)), names if ax is axes[0] else [""] * len(names))
            ax.set_ylim(len(names) + 1.6, -0.5)  # room for a legend
            for row in range(1, len(names), 2):
                ax.axhspan(row - 0.5, row + 0.5, color="0.96", zorder=0)
        _success(axes[0], data["cases"], names)
        _excess(axes[1], data["cases"], names)
        _cost(axes[2], data["cases"], names)
        _ladder(axes[3], data["particles"])
        for ax in axes:
            ax.spines[["top", "right"]].set_visible(False)
        figure.suptitle(
            f"Fuzzy swarms of {settings['particles']} particles, up to {settings['iterations']} iterations, "
            f"{settings['seeds']} seeds",
            fontsize=10.5,
        )
        path = folder / f"{STUDY}.png"
        figure.savefig(path, dpi=150, metadata={"Software": None})
        plt.close(figure)
    return [path]


def _rows(cases: list[dict[str, Any]], names: list[str]) -> list[tuple[dict[str, Any], float, str, str]]:
    return [
        (c, names.index(c["case"]) + KINDS[c["data"]][2], KINDS[c["data"]][0], KINDS[c["data"]][1])
        for c in cases
    ]


def _success(ax: Axes, cases: list[dict[str, Any]], names: list[str]) -> None:
    for c, y, colour, marker in _rows(cases, names):
        # what is measured against an upper bound of the minimum is hollow
        face = "white" if c["smallest"]["source"] == "best known" else colour
        for name, style in (("one_percent", "D"), ("rounding", marker)):
            s = c["success"][name]
            faint = name == "one_percent"
            ax.plot(
                *([100 * s["low"], 100 * s["high"]], [y, y]),
                color=colour,
                linewidth=3.5 if faint else 1.2,
                alpha=0.25 if faint else 1.0,
            )
            share = 100 * s["count"] / s["of"]
            ax.plot(share, y, style, ms=3.5 if faint else 5, color=colour, mfc=face, ls="", clip_on=False)
    for kind, (colour, marker, _) in KINDS.items():
        ax.plot([], [], marker, ms=5, color=colour, label=f"{kind} data, to rounding")
    ax.plot([], [], "D", ms=3.5, color=GREY, label="to 1 % of the frequencies")
    ax.set_xlim(-3, 103)
    ax.set_xlabel("seeds that reach the smallest F, %\n(bars: 68 % intervals; hollow: smallest F known)")
    ax.set_title("Success")
    ax.grid(axis="x", color="0.9")
    ax.legend(loc="lower right", framealpha=1.0)


def _excess(ax: Axes, cases: list[dict[str, Any]], names: list[str]) -> None:
    for c, y, colour, marker in _rows(cases, names):
        excess = [
            max((r["F_fitted"] - c["smallest"]["F"]) / c["margins"]["rounding"], NEAREST) for r in c["runs"]
        ]
        ax.plot(excess, [y] * len(excess), marker, ms=3.5, color=colour, alpha=0.45, mew=0)
        own = max((c["reference"]["F"] - c["smallest"]["F"]) / c["margins"]["rounding"], NEAREST)
        one_percent = c["margins"]["one_percent"] / c["margins"]["rounding"]
        ax.plot(one_percent, y, "|", ms=9, color=GREY, mew=1.2)
        if c["data"] == "printed":
            ax.plot(own, y, "x", ms=6, color="black", mew=1.3)
    ax.plot([], [], "x", color="black", ls="", label="printed sequence, or the plate's own")
    ax.plot([], [], "|", ms=9, color=GREY, mew=1.2, ls="", label="1 % of the frequencies")
    ax.axvline(1.0, color=GREY, linewidth=0.8, label="rounding")
    ax.set_xscale("log")
    ax.set_xlabel("(F of a run's sequence - smallest F) /\nwhat rounding to the resolution makes")
    ax.set_title("How far off the seeds end")
    ax.grid(axis="x", color="0.9")
    ax.legend(loc="lower left", framealpha=1.0)


def _cost(ax: Axes, cases: list[dict[str, Any]], names: list[str]) -> None:
    for c, y, colour, marker in _rows(cases, names):
        cost = c["cost"]
        ax.plot(cost["swarm_solves"], y, marker, ms=5, color=colour)
        face = colour if cost["enumerated"] else "white"
        ax.plot(cost["enumeration_solves"], y, "D", ms=5, color=colour, mfc=face)
    ax.plot([], [], "o", color=GREY, label="one swarm, mean")
    ax.plot([], [], "D", color=GREY, label="enumeration, done")
    ax.plot([], [], "D", color=GREY, mfc="white", label="enumeration, extrapolated")
    ax.set_xscale("log")
    ax.set_xlabel("solves\n(those of enumeration with derivatives)")
    ax.set_title("Cost")
    ax.grid(axis="x", color="0.9")
    ax.legend(loc="lower right", framealpha=1.0)


def _ladder(ax: Axes, points: list[dict[str, Any]]) -> None:
    x = [p["particles"] for p in points]
    for name, style, label in (("rounding", "o-", "to rounding"), ("one_percent", "D--", "to 1 %")):
        own = [p["success"][name] for p in points]
        rate = [100 * s["count"] / s["of"] for s in own]
        low = [r - 100 * s["low"] for r, s in zip(rate, own, strict=True)]
        high = [100 * s["high"] - r for r, s in zip(rate, own, strict=True)]
        ax.errorbar(x, rate, (low, high), fmt=style, ms=4, color=BLUE, linewidth=1.2, label=label)
    ax.legend(loc="upper left")
    ax.set_xscale("log")
    ax.set_xticks(x, [str(n) for n in x])
    ax.set_xticks([], minor=True)
    ax.set_ylim(-3, 103)
    ax.set_xlabel("particles")
    ax.set_ylabel("seeds that reach the smallest F, %")
    ax.set_title(f"More particles: {points[0]['case']}, synthetic data")
    ax.grid(axis="y", color="0.9")


if __name__ == "__main__":
    for _path in draw(HERE.parent / "studies" / "results", HERE):
        print(_path.name)
