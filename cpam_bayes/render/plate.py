"""The plate and its measurement: in words, drawn to scale, and measured shapes beside the modes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.answer import FrequencyRow
from cpam_bayes.formatting import fixed, listed, significant
from cpam_bayes.forward_model.labels import ShapePairing
from cpam_bayes.forward_model.model import ROOM_AIR
from cpam_bayes.mechanics.modes import Mode
from cpam_bayes.plate import Measurement, Plate, Specimen
from cpam_bayes.plate.edges import CONDITIONS, PLACES, EdgeCondition, conditions
from cpam_bayes.plate.laminate import equal_plies
from cpam_bayes.plate.layup import Layup
from cpam_bayes.render.figures import PREDICTED, extent_of, headed, new_figure, shapes_figure
from cpam_bayes.render.report import Caption, Column, Drawing, Rows, Section, Table, facts, modes_caption

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NO_AIR = "not in the model"
# Shorter side / thickness from which transverse shear hardly affects the lowest modes.
THIN = 20.0


def plate_section(specimen: Specimen, air_shifts: NDArray[np.float64] | None) -> Section:
    """Section of the plate as computed, with its drawing, and of its measurement.

    air_shifts : see `PlateResult.air_shifts`
    """
    tables = (plate_head(specimen, air_shifts), measured_facts(specimen))
    return Section("Plate and measurement", tables, ("plate",), folded=False)


def plate_head(specimen: Specimen, air_shifts: NDArray[np.float64] | None) -> Table:
    """Table of the plate as in its file.

    air_shifts : see `PlateResult.air_shifts`
    """
    plate = specimen.plate
    rows = [
        *((("specimen", specimen.specimen), *specimen.certificate) if specimen.certificate else ()),
        ("source", specimen.source),
        ("size", f"{size_text(plate)} mm, {thickness_class(plate)} ({thickness_ratio(plate)})"),
        ("density", _density(plate)),
        ("material", _material(specimen)),
        ("layup", layup_text(specimen)),
        ("edges", f"{plate.edges}: {edges_text(plate.edges)}"),
    ]
    if plate.mesh is not None:
        rows.append(("outline", f"the mesh {plate.mesh}"))
    rows += [
        ("mass", f"{s.mass * 1e3:g} g at x = {s.x * 1e3:g} mm, y = {s.y * 1e3:g} mm")
        for s in specimen.sensors
    ]
    rows.append(("air", air_text(specimen, air_shifts)))
    rows += [("note", note) for note in specimen.notes]
    return facts(f"Plate {specimen.name}", tuple(rows))


def measured_facts(specimen: Specimen) -> Table:
    """Table of the measured frequencies and their quality."""
    measurement = specimen.measurement
    if measurement is None:
        return facts("Measurement", ())
    listed = ", ".join(
        f"{f:.10g}{f' {label}' if label else ''}"
        for f, label in zip(measurement.frequencies, measurement.labels, strict=True)
    )
    if measurement.frequency_sd is not None:
        low, high = measurement.frequency_sd.min(), measurement.frequency_sd.max()
        span = f"{low:.3g}" if low == high else f"{low:.3g} to {high:.3g}"
        of_table = "of a single hit, from the table" if measurement.origin else "as given"
        made = of_table if measurement.mode_probability is None else measurement.sd_source
        repeatability = f"standard deviation {span} Hz, {made}"
    elif measurement.relative_std is not None:
        repeatability = f"{100.0 * measurement.relative_std:.3g} % of a frequency, as given"
    else:
        repeatability = "not given: inferred from the misfit"
    resolution = f"{measurement.resolution:g} Hz" if measurement.resolution else "not given"
    complete = "no mode is missing between the first and the last"
    rows = (
        (f"{measurement.size} frequencies", f"{listed} Hz"),
        ("resolution", resolution),
        ("repeatability", repeatability),
        ("completeness", complete if measurement.complete else "modes may be missing"),
        *((("read from", measurement.origin),) if measurement.origin else ()),
        *_damping(measurement),
    )
    return facts("Measurement", rows)


def _damping(measurement: Measurement) -> tuple[tuple[str, str], ...]:
    """Rows of damping ratios and loss factors, where measured."""
    ratios, factors = measurement.damping, measurement.loss_factors
    if ratios is None or factors is None:
        return ()
    return (
        ("damping ratio", f"{', '.join(significant(100.0 * float(v), 3) for v in ratios)} %"),
        ("loss factor", ", ".join(significant(float(v), 3) for v in factors)),
    )


def _material(specimen: Specimen) -> str:
    """Names of the materials, with the symmetry where the layup does not show it."""
    said = (
        f"{part.name or name or 'not named'}{', orthotropic' if part.symmetry == 'orthotropic' else ''}"
        for name, part in specimen.material.parts.items()
    )
    return "; ".join(said)


def air_text(specimen: Specimen, air_shifts: NDArray[np.float64] | None) -> str:
    """The air in the model, or its effect by ``air_shifts``, relative, None where not computed."""
    if specimen.air_density:
        return f"{specimen.air_density:.6g} kg/m3, in the model"
    stated = NO_AIR if specimen.air_density is None else "vacuum"
    if air_shifts is None:
        return stated
    lower = -100.0 * air_shifts
    least, most = (fixed(float(v), 2) for v in (lower.min(), lower.max()))
    span = f"{most} %" if least == most else f"{least} to {most} %"
    many = "frequency" if len(lower) == 1 else f"{len(lower)} frequencies"
    return f"{stated}; {ROOM_AIR:g} kg/m3 would lower the first {many} by {span}"


def thickness_class(plate: Plate) -> str:
    """Either "thin" or "thick", by shorter side / thickness."""
    return "thin" if min(plate.length, plate.width) > THIN * plate.thickness else "thick"


def layup_text(specimen: Specimen) -> str:
    """The layup as written, and its number of plies."""
    if specimen.material.isotropic:
        return "isotropic"
    layup = specimen.plate.layup
    return f"{layup.text}, {'1 ply' if layup.n_plies == 1 else f'{layup.n_plies} plies'}"


def edges_text(edges: str) -> str:
    """The edge conditions in words."""
    if len(set(edges)) == 1:
        return f"{CONDITIONS[edges[0]].name} on all four edges"
    said = []
    for letter in dict.fromkeys(edges):
        places = [place for place, e in zip(PLACES, edges, strict=True) if e == letter]
        listed = " and ".join([", ".join(places[:-1]), places[-1]] if len(places) > 1 else places)
        said.append(f"{CONDITIONS[letter].name} at {listed}")
    return "; ".join(said)


def plate_sentence(specimen: Specimen) -> str:
    """The plate as modelled, in a sentence; what it does not name is not in the model."""
    plate = specimen.plate
    mass = plate.total_mass
    weight = f", {mass * 1e3:.4g} g" if plate.mesh is None or plate.mass is not None else ""
    layup = "" if specimen.material.isotropic else f", layup {layup_text(specimen)}"
    air = f"air of {specimen.air_density:g} kg/m3" if specimen.air_density else "no air"
    if specimen.sensors:
        masses = [f"{s.mass * 1e3:g} g at ({s.x * 1e3:g}, {s.y * 1e3:g}) mm" for s in specimen.sensors]
        attached = f"with {listed(masses, 'and')} attached"
    else:
        attached = "nothing attached to the plate"
    return (
        f"The plate in the model: {size_text(plate)} mm{weight}{layup}, {edges_text(plate.edges)}, "
        f"{attached}, {air}."
    )


def size_text(plate: Plate) -> str:
    """Length x width x thickness, mm."""
    return " x ".join(f"{v * 1e3:.10g}" for v in (plate.length, plate.width, plate.thickness))


def thickness_ratio(plate: Plate) -> str:
    """Thickness / shorter side, as 1/n."""
    return f"1/{min(plate.length, plate.width) / plate.thickness:.3g}"


def _density(plate: Plate) -> str:
    """Density, and mass unless it follows only from the mesh."""
    density = f"{plate.density:.6g} kg/m3"
    if plate.mass is not None:
        return f"{density} from the weighed mass, {plate.mass * 1e3:.5g} g"
    if plate.mesh is not None:
        return f"{density} as given"
    return f"{density} as given, {plate.total_mass * 1e3:.5g} g"


_INK, _SURFACE, _SENSOR = "#333333", "#eef2f6", "#b3261e"
# Width of the band of a held edge, and room for its label, in fractions of the longer side.
_BAND, _ROOM = 0.045, 0.2
# Most plies with written angles; beyond, colour alone shows them.
_MOST_WRITTEN = 20
_MOST_KEYS = 10


PLATE: Final = "plate"
"""Name of the drawing of the plate."""
Overlay = Callable[["Axes", int], None]
"""Draws onto the plate with a given index, mm."""


def plate_figure(specimens: Sequence[Specimen], overlay: Overlay | None = None) -> Figure:
    """The plates one below the other, each with its plies; overlay : drawn onto each plate."""
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
    """Colour of an angle, equal for -90 and 90 degrees, as in the figures of `sequence`."""
    from matplotlib import colormaps

    return colormaps["twilight_shifted"]((angle_deg + 90.0) / 180.0, alpha=0.55)


def plate_caption(specimens: Sequence[Specimen]) -> Caption:
    """Caption of the drawing of one or several plates."""
    stated = {letter for s in specimens for letter in s.plate.edges}
    sensors = any(s.sensors for s in specimens)
    parts = ["The plate as modelled, seen from above"]
    parts += [c.caption for letter, c in CONDITIONS.items() if letter in stated and c.caption]
    if sensors:
        parts.append("a red dot is a mass attached to the plate")
    if not all(s.material.isotropic for s in specimens):
        parts.append("beside it the plies, bottom to top, equal angles in equal colours")
    text = (
        "; ".join(parts) + ". Anything on the plate in the laboratory that is not drawn is not in the model."
    )
    return Caption(text, " ".join(plate_sentence(s) for s in specimens))


def plate_drawing(
    specimens: Sequence[Specimen], overlay: Overlay | None = None, caption: Caption | None = None
) -> Drawing:
    """Drawing of the plates asked about; overlay : drawn onto them, described by caption."""
    return Drawing(PLATE, partial(plate_figure, specimens, overlay), caption or plate_caption(specimens))


def measured_modes(
    specimen: Specimen,
    rows: Sequence[FrequencyRow],
    shapes: Sequence[NDArray[np.float64]],
    modes: Sequence[Mode],
) -> Drawing:
    """Shapes (3, n, n) of the modes paired with measured frequencies; rows, shapes, modes : one each."""
    plate = specimen.plate
    figure = partial(
        shapes_figure,
        f"{specimen.name}: modes of the measured frequencies",
        [f"{row.number}: {row.measured:g} Hz measured\n{row.kind} {row.label}" for row in rows],
        shapes,
        [mode.in_plane_fraction > 0.5 for mode in modes],
        extent_of(plate.length, plate.width),
        plate.edges,
    )
    labelled = [(row.measured or 0.0, row.label or row.kind or "") for row in rows]
    return Drawing("modes", figure, modes_caption(labelled))


FIGURE = "modal_assurance"


def assurance_sections(pairing: ShapePairing | None, measurement: Measurement | None) -> tuple[Section, ...]:
    """Section on the mode of each measured shape; empty without shapes."""
    if pairing is None or measurement is None:
        return ()
    return (Section("Measured shapes", (_table(pairing, measurement),), (FIGURE,)),)


def _table(pairing: ShapePairing, measurement: Measurement) -> Table:
    rows = tuple(
        (float(f), pairing.candidates[j] if j >= 0 else None, int(j), mac, p)
        for f, j, mac, p in zip(
            measurement.frequencies, pairing.modes, pairing.assurance, pairing.probability, strict=True
        )
    )
    return Rows("shapes", _ROWS, rows).table("Modal assurance at the reference constants")


_ROWS = (
    Column("measured Hz", value=lambda r: r[0], text=lambda f: f"{f:.10g}", number=True),
    Column("mode", value=lambda r: "none" if r[1] is None else r[1].label),
    Column(
        "model Hz", value=lambda r: r[1] and r[1].frequency, text=lambda f: significant(f, 5), number=True
    ),
    Column("MAC", value=lambda r: r[1] and r[3][r[2]], text=lambda v: f"{v:.3f}", number=True),
    Column(
        "next MAC",
        value=lambda r: (np.delete(r[3], r[2]) if r[1] else r[3]).max(initial=0.0),
        text=lambda v: f"{v:.3f}",
        number=True,
    ),
    Column(
        "probability",
        value=lambda r: r[1] and float(r[4][r[2]]),
        text=lambda v: significant(v, 3),
        number=True,
    ),
)


def shape_keys(pairing: ShapePairing | None, measurement: Measurement | None) -> dict[str, Any]:
    """Keys of the pairing in a JSON document; empty without shapes."""
    if pairing is None or measurement is None:
        return {}
    rows = zip(measurement.frequencies, pairing.modes, pairing.probability, strict=True)
    return {
        "modal_assurance": pairing.assurance.tolist(),
        "shapes": [
            {
                "measured_hz": float(f),
                "mode": None if j < 0 else int(j) + 1,
                "label": None if j < 0 else pairing.candidates[j].label,
                "probability": None if j < 0 else float(p[j]),
            }
            for f, j, p in rows
        ],
    }


# Largest matrix with numbers in its cells; probability from which a candidate is marked.
_MOST_SQUARES, _MARKED = 20, 0.01


def assurance_drawings(
    title: str, pairing: ShapePairing | None, measurement: Measurement | None
) -> tuple[Drawing, ...]:
    """Drawing of measured shapes against modes; empty without shapes."""
    if pairing is None or measurement is None:
        return ()
    n, k = pairing.assurance.shape
    paired = int(np.sum(pairing.modes >= 0))
    caption = Caption(
        "Each row is a measured shape, each column a mode of the model at the reference constants; dark is "
        "similar, 1 identical. A red ring marks the mode paired with a frequency, a grey one another "
        "possible mode. Two dark squares in a row: the measured points do not tell these modes apart, or "
        "the constants differ so much from the reference that the modes have mixed.",
        f"Modal assurance of {n} measured shapes with {k} modes; {paired} are paired.",
    )
    return (Drawing(FIGURE, partial(_matrix, title, pairing, measurement), caption),)


def _matrix(title: str, pairing: ShapePairing, measurement: Measurement) -> Figure:
    n, k = pairing.assurance.shape
    figure = new_figure(1.9 + 0.42 * k, 1.5 + 0.36 * n)
    axes = figure.add_subplot()
    image = axes.imshow(pairing.assurance, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    figure.colorbar(image, ax=axes, label="modal assurance")
    axes.set_xticks(
        range(k), [f"{m.label} {m.frequency:.4g}" for m in pairing.candidates], rotation=90, fontsize=8
    )
    axes.set_yticks(range(n), [f"{f:.5g}" for f in measurement.frequencies], fontsize=8)
    axes.set(xlabel="mode of the model, Hz", ylabel="measured, Hz")
    axes.set_title(f"{title}: measured shapes and the model's", fontsize=10, loc="left")
    if max(n, k) <= _MOST_SQUARES:
        for (i, j), value in np.ndenumerate(pairing.assurance):
            if value >= 0.05:
                color = "white" if value > 0.6 else "0.2"
                axes.text(j, i, f"{value:.2f}", ha="center", va="center", fontsize=8, color=color)
    for i, j in np.argwhere(pairing.probability >= _MARKED):
        colour = PREDICTED if pairing.modes[i] == j else "0.45"
        axes.plot(j, i, "o", markersize=19, markerfacecolor="none", markeredgecolor=colour)
    return figure
