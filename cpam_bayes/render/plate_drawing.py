"""A plate drawn to scale: edges, sensors, and its plies from the bottom to the top."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from cpam_bayes.plate import Plate, Specimen
from cpam_bayes.plate.edges import CONDITIONS, EdgeCondition, conditions
from cpam_bayes.plate.laminate import equal_plies
from cpam_bayes.plate.layup import Layup
from cpam_bayes.render.figures import headed, new_figure
from cpam_bayes.render.report import Caption, Drawing
from cpam_bayes.render.sentences import plate_sentence

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["PLATE", "Overlay", "plate_caption", "plate_drawing", "plate_figure"]

_INK, _SURFACE, _SENSOR = "#333333", "#eef2f6", "#b3261e"
# Width of a held edge's band and room for its words, fractions of the longer side.
_BAND, _ROOM = 0.045, 0.2
# Plies whose angles are written on them; more are told by colour alone.
_MOST_WRITTEN = 20
_MOST_KEYS = 10


PLATE: Final = "plate"
"""Name of the drawing of the plate."""
Overlay = Callable[["Axes", int], None]
"""Draws something onto the plate of a number, millimetres."""


def plate_figure(specimens: Sequence[Specimen], overlay: Overlay | None = None) -> Figure:
    """The plates, one below the other, each with its plies beside it; overlay : what else is on them."""
    figure = new_figure(6.0, 3.5 * len(specimens))
    panels = figure.subfigures(len(specimens), 1, squeeze=False).ravel()
    for i, (panel, specimen) in enumerate(zip(panels, specimens, strict=True)):
        top, plies = panel.subplots(1, 2, width_ratios=(3.4, 1.0))
        _draw_top(top, specimen)
        if overlay is not None:
            overlay(top, i)
        if specimen.material.isotropic:
            _draw_isotropic(plies, specimen.plate)
        else:
            _draw_plies(plies, specimen.plate.layup)
        headed(panel, specimen.name)
    return figure


def _draw_top(axes: Axes, specimen: Specimen) -> None:
    """The plate from above, millimetres."""
    from matplotlib.patches import Rectangle

    plate = specimen.plate
    a, b = 1e3 * plate.length, 1e3 * plate.width
    longer = max(a, b)
    band, room = _BAND * longer, _ROOM * longer
    axes.add_patch(Rectangle((0, 0), a, b, facecolor=_SURFACE, edgecolor="none"))
    ends = (((0, 0), (0, b)), ((0, 0), (a, 0)), ((a, 0), (a, b)), ((0, b), (a, b)))
    bands = (
        ((-band, 0), band, b),
        ((0, -band), a, band),
        ((a, 0), band, b),
        ((0, b), a, band),
    )
    words = (
        (-1.6 * band, b / 2, "right", "center", 90),
        (a / 2, -1.6 * band, "center", "top", 0),
        (a + 1.6 * band, b / 2, "left", "center", 90),
        (a / 2, b + 1.6 * band, "center", "bottom", 0),
    )
    for edge, ((x0, y0), (x1, y1)), strip, (x, y, ha, va, turn) in zip(
        conditions(plate.edges), ends, bands, words, strict=True
    ):
        _draw_edge(axes, edge, (x0, x1), (y0, y1), strip)
        axes.text(x, y, edge.name, ha=ha, va=va, rotation=turn, fontsize=9, color=_INK)
    if plate.mesh is not None:
        axes.text(a / 2, b / 2, "outline: the mesh file", ha="center", va="center", fontsize=9, color=_INK)
    for sensor in specimen.sensors:
        x, y = 1e3 * sensor.x, 1e3 * sensor.y
        axes.plot(x, y, "o", color=_SENSOR, markersize=8)
        side = "right" if x > a / 2 else "left"
        said = f" {1e3 * sensor.mass:g} g "
        axes.annotate(said, (x, y), (0, 7 if y < b / 2 else -7), textcoords="offset points", ha=side,
                      va="bottom" if y < b / 2 else "top", fontsize=9, color=_SENSOR)  # fmt: skip
    _draw_axes(axes, 0.22 * min(a, b))
    size = f"{a:.10g} x {b:.10g} x {1e3 * plate.thickness:.10g} mm"
    axes.text(a / 2, b / 2 if plate.mesh is None else 0.62 * b, size, ha="center", va="center", fontsize=10)
    axes.set(xlim=(-room, a + room), ylim=(-room, b + room), aspect="equal")
    axes.set_axis_off()


def _draw_edge(
    axes: Axes,
    edge: EdgeCondition,
    x: tuple[float, float],
    y: tuple[float, float],
    strip: tuple[tuple[float, float], float, float],
) -> None:
    from matplotlib.patches import Rectangle

    axes.plot(x, y, color=_INK, linewidth=2.4 if edge.mark == "hatching" else 1.2, zorder=3)
    if edge.mark == "hatching":
        axes.add_patch(
            Rectangle(*strip, facecolor="white", edgecolor=_INK, hatch="////", linewidth=0.0, zorder=2)
        )
    elif edge.mark == "triangles":
        n = 9
        (x0, y0), width, height = strip
        along_x = width > height
        places = (np.arange(n) + 0.5) / n
        px = x0 + (places * width if along_x else width / 2)
        py = y0 + (height / 2 if along_x else places * height)
        axes.plot(*np.broadcast_arrays(px, py), "^", mfc="white", mec=_INK, markersize=5, zorder=2)


def _draw_axes(axes: Axes, reach: float) -> None:
    arrow = {"arrowstyle": "->", "color": _INK, "linewidth": 1.2}
    axes.annotate("", (reach, 0), (0, 0), arrowprops=arrow)
    axes.annotate("", (0, reach), (0, 0), arrowprops=arrow)
    axes.text(reach, 0.1 * reach, "x", fontsize=9, ha="center", va="bottom", color=_INK)
    axes.text(0.1 * reach, reach, "y", fontsize=9, ha="left", va="center", color=_INK)


def _draw_isotropic(axes: Axes, plate: Plate) -> None:
    from matplotlib.patches import Rectangle

    axes.add_patch(Rectangle((0, 0), 1, 1, facecolor=_SURFACE, edgecolor=_INK, linewidth=0.8))
    axes.text(0.5, 0.5, "isotropic", ha="center", va="center", rotation=90, fontsize=9)
    axes.set(xlim=(0, 1), ylim=(-0.02, 1.02))
    axes.set_axis_off()
    axes.set_title(f"{1e3 * plate.thickness:g} mm", fontsize=9)


def _draw_plies(axes: Axes, layup: Layup) -> None:
    """The plies as a stack, the lowest at the bottom, coloured by angle; unknown ones hatched."""
    from matplotlib.patches import Patch, Rectangle

    n = layup.n_plies
    stack = layup.plies or equal_plies(n)
    levels = n * (stack.interfaces + 0.5)
    for k, (angle, unknown) in enumerate(zip(layup.angles_deg, layup.unknown_index, strict=True)):
        style: dict[str, Any] = {"facecolor": "white", "hatch": ".."} if unknown >= 0 else {
            "facecolor": _colour(float(angle))
        }  # fmt: skip
        bottom, height = levels[k], levels[k + 1] - levels[k]
        axes.add_patch(Rectangle((0, bottom), 1, height, edgecolor=_INK, linewidth=0.5, **style))
        if n <= _MOST_WRITTEN:
            name = layup.kinds[k].name if layup.kinds else ""
            said = name + ("?" if unknown >= 0 else f"{angle:g}")
            box = {"facecolor": "white", "edgecolor": "none", "pad": 0.6}
            axes.text(0.5, bottom + height / 2, said, ha="center", va="center", fontsize=8, bbox=box)
    axes.set(xlim=(0, 1), ylim=(-0.02 * n, 1.02 * n))
    axes.set_axis_off()
    axes.set_title(f"{n} plies", fontsize=9)
    if n > _MOST_WRITTEN:
        known = sorted({float(a) for a in layup.angles_deg if np.isfinite(a)})
        keys = [Patch(facecolor=_colour(a), edgecolor=_INK, label=f"{a:g} deg") for a in known[:_MOST_KEYS]]
        if layup.n_unknown:
            keys.append(Patch(facecolor="white", edgecolor=_INK, hatch="..", label="unknown"))
        axes.legend(handles=keys, loc="upper center", bbox_to_anchor=(0.5, 0.0), frameon=False, fontsize=9)


def _colour(angle_deg: float) -> Any:
    """The same colour for -90 and 90 degrees, as in the figures of `sequence`."""
    from matplotlib import colormaps

    return colormaps["twilight_shifted"]((angle_deg + 90.0) / 180.0, alpha=0.55)


def plate_caption(specimens: Sequence[Specimen]) -> Caption:
    """Caption of the drawing of one plate, or of several."""
    stated = {letter for s in specimens for letter in s.plate.edges}
    sensors = any(s.sensors for s in specimens)
    parts = ["The plate as the model has it, seen from above"]
    parts += [c.caption for letter, c in CONDITIONS.items() if letter in stated and c.caption]
    if sensors:
        parts.append("a red dot is a mass attached to the plate")
    if not all(s.material.isotropic for s in specimens):
        parts.append("beside it the plies from the bottom to the top, like colours at like angles")
    text = (
        "; ".join(parts)
        + ". Whatever was on the plate in the laboratory and is not drawn is not in the model."
    )
    return Caption(text, " ".join(plate_sentence(s) for s in specimens))


def plate_drawing(
    specimens: Sequence[Specimen], overlay: Overlay | None = None, caption: Caption | None = None
) -> Drawing:
    """The plates that were asked about; overlay : what else is drawn on them, with its caption."""
    return Drawing(PLATE, partial(plate_figure, specimens, overlay), caption or plate_caption(specimens))
