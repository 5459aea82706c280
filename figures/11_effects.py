"""Effect of every cause on the modes of a plate, and the part that the constants cannot imitate.

python figures/11_effects.py [--help]
"""

from __future__ import annotations

from typing import Any

import numpy as np
from journal import DOUBLE_MM, LIGHT, ORANGE, Drawing, Picture, figure, listed
from matplotlib.axes import Axes
from matplotlib.figure import Figure

COLUMNS = 4
# Below this fraction of its shift a cause counts as absorbed.
ABSORBED = 0.02


def pictures(found: dict[str, Any]) -> list[Picture]:
    effects = found["effects"]
    absorbed = [
        e["cause"] for e in effects if _norm(e["projected_percent"]) < ABSORBED * _norm(e["shift_percent"])
    ]
    said = (
        f" Less than {100 * ABSORBED:g} % of the shift stays visible for {listed(absorbed)}."
        if absorbed
        else ""
    )
    return [
        Picture(
            "11_effects",
            _all(found),
            "Relative shift of each mode by every cause that has a size or is an error of the list.",
            "Titles: cause, size and plate; bars: modes in order. Grey: shift; orange: what the constants "
            f"cannot absorb, priors ignored.{said}",
        )
    ]


def _norm(values: list[float]) -> float:
    return float(np.linalg.norm(values))


def _all(found: dict[str, Any]) -> Figure:
    effects = found["effects"]
    rows = -(-len(effects) // COLUMNS)
    new = figure(DOUBLE_MM, 12 + 27 * rows)
    grid = new.subplots(rows, COLUMNS, squeeze=False).ravel()
    for axes, effect in zip(grid, effects, strict=False):
        _panel(axes, effect)
    for axes in grid[len(effects) :]:
        axes.set_axis_off()
    handles, labels = grid[0].get_legend_handles_labels()
    new.legend(handles, labels, loc="outside lower center", ncols=2)
    for axes in grid[max(len(effects) - COLUMNS, 0) : len(effects)]:
        axes.set_xlabel("mode")
    new.supylabel("relative shift of the frequency, %", fontsize=7.5)
    return new


def _panel(axes: Axes, effect: dict[str, Any]) -> None:
    shift, left = (np.array(effect[key]) for key in ("shift_percent", "projected_percent"))
    x = np.arange(1, len(shift) + 1)
    axes.bar(x - 0.2, shift, 0.38, color=LIGHT, label="shift")
    axes.bar(x + 0.2, left, 0.38, color=ORANGE, label="not absorbed by the constants")
    axes.axhline(0.0, color="0.4", linewidth=0.7)
    axes.set_xticks(x)
    axes.tick_params(axis="x", length=0)
    axes.locator_params(axis="y", nbins=4)
    axes.margins(y=0.12)
    axes.set_title(f"{effect['cause']}\n{_size(effect)}, {effect['plate']}", fontsize=7.5)


def _size(effect: dict[str, Any]) -> str:
    if effect["unit"] == "mode":
        return f"mode {effect['size']:g} missed"
    return f"{effect['size']:.3g} {effect['unit']}".strip()


draw = Drawing(__file__, "11_effects", "no random numbers", pictures)

if __name__ == "__main__":
    draw.main()
