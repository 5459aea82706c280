"""Cost of the forward solver against accuracy, number of modes and number of parameters.

python figures/03_solver_growth.py [--help]
"""

from __future__ import annotations

from typing import Any

from journal import BLUE, DOUBLE_MM, GREEN, GREY, ORANGE, Drawing, Picture, figure
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator

BASES = {
    ("C1", "enriched"): (BLUE, "-", "o"),
    ("C1", "plain"): (BLUE, "--", "o"),
    ("D1", "enriched"): (ORANGE, "-", "s"),
    ("D1", "plain"): (ORANGE, "--", "s"),
}
COSTS = {
    "full": ("full solve", ORANGE, "-", "s"),
    "derivatives": ("reduced, with derivatives", GREEN, "-", "^"),
    "reduced": ("reduced", BLUE, "-", "o"),
    "lapack": ("LAPACK alone on its sizes", GREY, "--", ""),
}
GOAL = 2e-4


def pictures(data: dict[str, Any]) -> list[Picture]:
    last = data["modes"][-1]
    return [
        Picture(
            "03_solver_growth",
            _costs(data),
            "Time of a solve against accuracy, number of modes and number of parameters.",
            "Left: a full solve of C1 (six modes) and D1 (ten) by the error that it reaches, with and "
            "without edge exponentials in the basis; grey: 0.02 %, the tolerance. Middle and right: C1, "
            f"one parameter set, by the full solver and by the reduced model in stacks of {data['stack']}. "
            "At the end of a line: how many times the cheapest point of its kind, measured in the same "
            "run. With ply angles among the parameters the matrices part into two blocks instead of four. "
            f"At {last['modes']} modes a reduced solve takes {1e3 * last['reduced_s']:.2f} ms, a full one "
            f"{1e3 * last['full_s']:.1f} ms on the machine of the study.",
        )
    ]


def _costs(data: dict[str, Any]) -> Figure:
    new = figure(DOUBLE_MM, 78)
    axes = new.subplots(1, 3)
    _accuracy(axes[0], data["accuracy"])
    _growth(axes[1], data["modes"], "modes")
    axes[1].set(xlabel="number of modes", title="C1, four constants")
    _growth(axes[2], data["parameters"], "parameters")
    _mark_angles(axes[2], data["parameters"])
    axes[2].set(xlabel="number of parameters", title="C1, six modes")
    limits = [ax.get_ylim() for ax in axes[1:]]
    for ax in axes[1:]:
        ax.set_ylabel("time of one parameter set, ms")
        ax.set_ylim(min(low for low, _ in limits), max(high for _, high in limits))
    for ax in axes:
        ax.grid(True, which="major")
    handles, labels = axes[0].get_legend_handles_labels()
    costs, names = axes[1].get_legend_handles_labels()
    new.legend([*handles, *costs], [*labels, *names], loc="outside lower center", ncols=4)
    return new


def _accuracy(ax: Axes, points: list[dict[str, Any]]) -> None:
    for (plate, basis), (colour, line, marker) in BASES.items():
        shown = [p for p in points if (p["plate"], p["basis"]) == (plate, basis)]
        # differences below the error of the reference itself mean nothing
        shown = [p for p in shown if p["error"] > p["reference_error"]]
        if not shown:
            continue
        label = f"{plate}, " + ("edge exponentials" if basis == "enriched" else "polynomials alone")
        x, y = [100 * p["error"] for p in shown], [1e3 * p["full_s"] for p in shown]
        face = colour if basis == "enriched" else "white"
        ax.loglog(x, y, line, color=colour, marker=marker, markerfacecolor=face, label=label)
        _ratio(ax, x[-1], y[-1], shown[-1]["full_ratio"], colour)
    ax.axvline(100 * GOAL, color=GREY, linewidth=0.8)
    ax.invert_xaxis()
    ax.margins(x=0.2, y=0.08)
    ax.set(xlabel="largest error of a frequency, %", ylabel="time of a full solve, ms")
    ax.set_title("Full solve")
    ax.yaxis.set_major_formatter("{x:g}")


def _growth(ax: Axes, points: list[dict[str, Any]], kind: str) -> None:
    x = [p[kind] for p in points]
    for name, (label, colour, line, marker) in COSTS.items():
        y = [1e3 * p[f"{name}_s"] for p in points]
        ax.semilogy(x, y, line, color=colour, marker=marker or None, label=label)
        if name != "lapack":
            # with many modes the two cost the same
            shift = {"full": -7, "derivatives": 4}.get(name, 1) if kind == "modes" else 1
            _ratio(ax, x[-1], y[-1], points[-1][f"{name}_ratio"], colour, shift)
    ax.xaxis.set_major_locator(FixedLocator(x))
    ax.margins(x=0.2, y=0.1)
    ax.yaxis.set_major_formatter("{x:g}")


def _ratio(ax: Axes, x: float, y: float, ratio: float, colour: str, shift: float = 1.0) -> None:
    """Write beside a point, ``shift`` points up, its cost relative to the cheapest point of its kind."""
    ax.annotate(*(f"{ratio:.0f} x", (x, y), (5, shift)), textcoords="offset points", color=colour, fontsize=7)


def _mark_angles(ax: Axes, points: list[dict[str, Any]]) -> None:
    first = next((p["parameters"] for p in points if p["names"][-1].startswith("angle")), None)
    if first is not None:
        ax.axvline(first - 0.5, color=GREY, linewidth=0.8)
        for text, shift, side in (("constants", -4, "right"), ("and ply angles", 4, "left")):
            ax.annotate(
                *(text, (first - 0.5, 0.02), (shift, 0), ("data", "axes fraction"), "offset points"),
                ha=side,
                va="bottom",
                color=GREY,
                fontsize=7,
            )


draw = Drawing(__file__, "03_solver_growth", "seeds 0 and 1 of the training sets", pictures)

if __name__ == "__main__":
    draw.main()
