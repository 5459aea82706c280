"""Differences between Ritz, finite elements and bricks.

python figures/02_agreement.py [--help]
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from journal import (
    BAND,
    BLUE,
    DARK,
    DOUBLE_MM,
    ORANGE,
    Drawing,
    Picture,
    bare,
    figure,
    listed,
    subscripts,
)
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

ELEMENTS, BRICKS = ORANGE, BLUE
COLUMNS = 2


def pictures(found: dict[str, Any]) -> list[Picture]:
    limit = found["limit_percent"]
    plates = [*found["specimens"], *found["unsymmetric"]]
    bricks = {abs(r["bricks"]["worst_percent"]): _plate(r) for r in plates if r["bricks"]}
    without = [row["plate"] for row in plates if not row["bricks"]]
    not_run = f"; they were not run on {listed(without)}" if without else ""
    elements = max(abs(row["worst_percent"]) for row in plates)
    combinations = [row for plate in found["edges"] for row in plate["rows"]]
    worst = max(combinations, key=lambda row: abs(row["worst_percent"]))
    failed = sum(not row["passes"] for row in combinations)
    boxed = " (boxed)" if failed else ""
    drawn = [
        Picture(
            "02_agreement",
            _specimens(plates, limit),
            "Finite elements and three-dimensional bricks against the Ritz model, plate by plate.",
            "Relative difference of the worst mode. Finite elements of the same plate theory are within "
            f"{elements:.3f} % of the Ritz model on all {len(plates)} plates (grey: {limit:g} %, the limit). "
            + (
                f"CalculiX bricks, which show the error of the theory itself, are up to {max(bricks):.2f} % "
                f"apart, on {bricks[max(bricks)]}{not_run}."
                if bricks
                else "No bricks were computed."
            ),
        )
    ]
    if combinations:
        drawn.append(
            Picture(
                "02_agreement_edges",
                _all_edges(found["edges"], limit),
                "Finite elements against the Ritz model for all combinations of edge conditions.",
                "Magnitude of the relative difference of the worst mode, %, by the conditions of opposite "
                f"edges: F free, S simply supported, C clamped. Of {len(combinations)} combinations, some "
                f"shown twice, {failed} are beyond the limit of {limit:g} %{boxed}; the largest difference "
                f"is {abs(worst['worst_percent']):.3f} %.",
            )
        )
    return drawn


def _specimens(rows: list[dict[str, Any]], limit: float) -> Figure:
    new = figure(DOUBLE_MM, 30 + 4.6 * len(rows))
    axes = new.subplots()
    axes.axvspan(-limit, limit, color=BAND, label=f"{limit:g} %, the limit for elements")
    bricks = [(r["bricks"]["worst_percent"], i) for i, r in enumerate(rows) if r["bricks"]]
    if bricks:
        x, y = zip(*bricks, strict=True)
        axes.plot(x, y, "s", ms=4.5, color=BRICKS, label="CalculiX bricks, three-dimensional")
    elements = [r["worst_percent"] for r in rows]
    axes.plot(elements, range(len(rows)), "o", ms=4.5, color=ELEMENTS, label="elements, the same theory")
    axes.axvline(0, color=DARK, linewidth=0.8)
    axes.set_yticks(range(len(rows)), [_name(r) for r in rows])
    axes.set(ylim=(len(rows) - 0.5, -0.5), xlabel="worst mode: frequency / that of the Ritz model - 1, %")
    axes.grid(axis="y")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    bare(axes)
    return new


def _plate(row: Mapping[str, Any]) -> str:
    return f"{row['plate']} with the layup {row['layup']}"


def _name(row: Mapping[str, Any]) -> str:
    return f"{row['plate']}  {subscripts(row['layup'])}  {row['edges']}  {row['modes']} modes"


def _all_edges(plates: list[dict[str, Any]], limit: float) -> Figure:
    rows = -(-len(plates) // COLUMNS)
    new = figure(DOUBLE_MM, 88 * rows)
    panels = new.subplots(rows, COLUMNS, squeeze=False).ravel()
    images = [_edges(axes, plate, limit) for axes, plate in zip(panels, plates, strict=False)]
    for axes in panels[len(plates) :]:
        axes.set_axis_off()
    bar = new.colorbar(images[0], ax=panels, shrink=0.5, aspect=30, extend="max", location="bottom")
    bar.set_label("magnitude of the relative difference of the worst mode, %")
    return new


def _edges(axes: Axes, plate: Mapping[str, Any], limit: float) -> AxesImage:
    """Differences as an image over the edge conditions across x and across y."""
    worst = {}
    for r in plate["rows"]:
        x0, y0, x1, y1 = r["edges"]
        worst[x0 + x1, y0 + y1] = abs(r["worst_percent"])
        if not plate["mirrored"]:  # the same plate turned by 180 degrees
            worst[x1 + x0, y1 + y0] = abs(r["worst_percent"])
    names = sorted({pair for pairs in worst for pair in pairs}, key=lambda p: ["FSC".index(e) for e in p])
    values = np.array([[worst.get((across_x, across_y), np.nan) for across_y in names] for across_x in names])
    image = axes.imshow(values, cmap="cividis_r", vmin=0.0, vmax=limit)
    for i, j in np.argwhere(np.isfinite(values)):
        v = values[i, j]
        box = {"edgecolor": "red", "facecolor": "none", "pad": 1} if v > limit else None
        color = "white" if v > 0.45 * limit else "black"
        axes.text(j, i, f"{v:.3f}"[1:], ha="center", va="center", fontsize=7, color=color, bbox=box)
    axes.set_xticks(range(len(names)), names)
    axes.set_yticks(range(len(names)), names)
    axes.set_xlabel("edges y = 0, y = width")
    axes.set_ylabel("edges x = 0, x = length")
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    modes = plate["rows"][0]["modes"]
    axes.set_title(f"{plate['plate']} with {subscripts(plate['layup'])}, {modes} modes")
    return image


draw = Drawing(__file__, "02_agreement", "no random numbers", pictures)

if __name__ == "__main__":
    draw.main()
