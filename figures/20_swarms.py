"""Success rates of a single swarm, and of several polished ones, in finding the best constants of a plate.

python figures/20_swarms.py [--help]
"""

from __future__ import annotations

from typing import Any

from journal import BLUE, DOUBLE_MM, ORANGE, Drawing, Picture, bare, figure
from matplotlib.figure import Figure

COLOURS = {"found": BLUE, "wrong": ORANGE, "open": "#DDDDDD"}
WORDS = {
    "found": "found the best optimum",
    "wrong": "converged at another optimum",
    "open": "did not converge",
}
WAYS = {"single": "Single swarm, as in the paper", "several": "Swarms until two agree, polished"}


def pictures(data: dict[str, Any]) -> list[Picture]:
    rows, runs = data["plates"], data["seeds"] * len(data["plates"])
    single, several = (sum(row[way]["found"] for row in rows) for way in WAYS)
    wrong = [sum(row[way]["wrong"] for row in rows) for way in WAYS]
    return [
        Picture(
            "20_swarms",
            _bars(data),
            "How often a single particle swarm, and several that are polished, find the best constants of "
            "a plate.",
            f"{data['seeds']} seeds a plate. A run found the best optimum if its F is within "
            f"{100 * data['close']:g} % of the smallest F known. Single swarms found it in {single} of "
            f"{runs} runs and converged elsewhere in {wrong[0]}; swarms until two agree found it in "
            f"{several} and converged elsewhere in {wrong[1]}.",
        )
    ]


def _bars(data: dict[str, Any]) -> Figure:
    rows, seeds = data["plates"], data["seeds"]
    new = figure(DOUBLE_MM, 30 + 5.5 * len(rows))
    panels = new.subplots(1, 2, sharey=True)
    for axes, (way, title) in zip(panels, WAYS.items(), strict=True):
        for k, row in enumerate(rows):
            found, wrong = row[way]["found"], row[way]["wrong"]
            left = 0
            for kind, count in (("found", found), ("wrong", wrong), ("open", seeds - found - wrong)):
                axes.barh(
                    k, count, 0.75, left=left, color=COLOURS[kind], label=WORDS[kind] if not k else None
                )
                left += count
        axes.set_title(title)
        axes.set(xlim=(0, seeds), xlabel=f"runs of {seeds}")
        axes.xaxis.get_major_locator().set_params(integer=True)
        bare(axes)
    panels[0].set_yticks(range(len(rows)), [row["case"] for row in rows])
    panels[0].set_ylim(len(rows) - 0.5, -0.5)
    handles, labels = panels[0].get_legend_handles_labels()
    new.legend(handles, labels, loc="outside lower center", ncols=3)
    return new


draw = Drawing(__file__, "20_swarms", "seeds 0 to 19", pictures)

if __name__ == "__main__":
    draw.main()
