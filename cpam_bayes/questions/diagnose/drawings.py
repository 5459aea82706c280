"""Drawings of a diagnosis: findings on the plate, fit of each mode, causes, limits, constants."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.answer import Constant
from cpam_bayes.diagnosis.diagnose import Cause, Diagnosis
from cpam_bayes.diagnosis.extension import FrequencyRow
from cpam_bayes.diagnosis.hypotheses import CLAIM_RULES, NONE
from cpam_bayes.diagnosis.places import images_of
from cpam_bayes.diagnosis.signatures import ALIKE, cosine
from cpam_bayes.effects import Effect, PlateFacts
from cpam_bayes.formatting import listed
from cpam_bayes.plate import Plate, to_user, unit_of
from cpam_bayes.questions.diagnose.document import (
    DiagnosisResult,
    answer_constants,
    detectable_rows,
    detectable_size,
    fit_constants,
    leading,
    place_of,
    places_of,
    probability_text,
    size_text,
    taken_peaks,
    title_of,
)
from cpam_bayes.render.figures import (
    BEFORE,
    MEASURED,
    PREDICTED,
    REFERENCE,
    draw_shape,
    extent_of,
    headed,
    new_figure,
)
from cpam_bayes.render.plate import plate_caption, plate_drawing
from cpam_bayes.render.report import Caption, Drawing
from cpam_bayes.render.spectrum import peak_drawings

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


Array = NDArray[Any]

_BARS: Final = 12
# Minimum drawn angle, degrees, and standard deviations spanned by the ellipse of a place.
_SHOWN_DEG, _ELLIPSE_SD = 5.0, 2.0


def drawings(result: DiagnosisResult) -> tuple[Drawing, ...]:
    """All drawings: the plate with the findings, the fit of each mode, then the evidence."""
    d = result.diagnosis
    drawn = [_plate(result), _residuals(result), _causes(d)]
    if len(_with_signatures(d)) > 1:
        drawn.append(_signatures(d))
    if any(row.in_sd is not None for row in detectable_rows(d)):
        drawn.append(_detectable(d))
    if answer_constants(d):
        drawn.append(_constants(d))
    return (*drawn, *peak_drawings(result.plates[0], taken_peaks(result)))


def _names(d: Diagnosis) -> str:
    return " ".join(case.name for case in d.cases)


def _plate(result: DiagnosisResult) -> Drawing:
    """The plates, with the claimed causes drawn on those that have them."""
    d, plain = result.diagnosis, plate_caption(result.plates)
    found = _claimed(d)
    if not found:
        return plate_drawing(result.plates)
    named = listed([title_of(d, c.name) for c in found], "or")
    text = f"Orange: what was found, {named}; its images, which no frequency tells apart, are open."
    caption = Caption(f"{text} {plain.text}", f"{plain.alt} Found: {named}.")
    return plate_drawing(result.plates, partial(_draw_found, result, found), caption)


def _claimed(d: Diagnosis) -> tuple[Cause, ...]:
    """The claimed causes: one, the members of a class, or a set."""
    if d.claim.kind == "pair":
        return (d.several,)
    if d.claim.kind in ("named", "class"):
        return tuple(c for c in d.causes if c.name in d.claim.causes)
    return ()


def _draw_found(result: DiagnosisResult, found: Sequence[Cause], axes: Axes, i: int) -> None:
    """Marks of the claimed causes on the i-th plate, mm."""
    d, plate = result.diagnosis, result.plates[i].plate
    texts = []
    for cause in found:
        if d.cases[i].name not in cause.plates:
            continue
        for effect in cause.hypothesis.records:
            if effect.is_anywhere:
                _draw_place(axes, d, cause, effect, plate)
            elif effect.edges is not None:
                _draw_edges(axes, plate, effect.edges(d.cases[i].models.facts))
            elif effect.drawn == "corner":
                _draw_corner(axes, effect, plate, d.cases[i].models.facts)
            elif effect.drawn:
                _draw_angle(axes, cause, effect, plate)
            size = size_text(cause, (effect,))
            texts.append(f"{effect.title}{', ' if size else ''}{size}")
    said = "\n".join(texts).replace("+-", "\N{PLUS-MINUS SIGN}")
    axes.set_title(said, fontsize=9, color=PREDICTED)


def _draw_place(axes: Axes, d: Diagnosis, cause: Cause, effect: Effect, plate: Plate) -> None:
    """A mass as a dot or a patch by its extent, with the ellipse of the place; image places are hollow."""
    from matplotlib.patches import Ellipse, Rectangle

    place = place_of(cause, plate, effect)
    if place is None:
        return
    sd_x, sd_y = (1e3 * v for v in place[1])
    a, b = 1e3 * plate.length, 1e3 * plate.width
    _, _, *rest = effect.coordinates
    for k, (px, py) in enumerate((1e3 * x, 1e3 * y) for x, y in places_of(d, cause, effect)):
        width, height = 2.0 * _ELLIPSE_SD * sd_x, 2.0 * _ELLIPSE_SD * sd_y
        axes.add_patch(
            Ellipse((px, py), width, height, facecolor="none", edgecolor=PREDICTED, linewidth=0.8, ls=":")
        )
        if effect.local == "point" or not rest:
            axes.plot(px, py, "o", mfc="none" if k else PREDICTED, mec=PREDICTED, markersize=9)
            continue
        reach = cause.parameters[rest[0].name][0] * min(a, b)
        style: dict[str, Any] = {
            "facecolor": "none" if k else PREDICTED,
            "edgecolor": PREDICTED,
            "alpha": 0.35,
        }
        if effect.local == "rectangle":
            axes.add_patch(Rectangle((px - reach, py - reach), 2.0 * reach, 2.0 * reach, **style))
        else:
            axes.add_patch(Ellipse((px, py), 2.0 * reach, 2.0 * reach, **style))


def _draw_edges(axes: Axes, plate: Plate, edges: Sequence[int]) -> None:
    """Highlight edges, given by number."""
    a, b = 1e3 * plate.length, 1e3 * plate.width
    ends = (((0, 0), (0, b)), ((0, a), (0, 0)), ((a, a), (0, b)), ((0, a), (b, b)))
    for i in edges:
        axes.plot(*ends[i], color=PREDICTED, linewidth=4.0, zorder=4)


def _draw_corner(axes: Axes, effect: Effect, plate: Plate, facts: PlateFacts) -> None:
    """The square of a missing corner; hollow at corners that no frequency distinguishes from it."""
    from matplotlib.patches import Rectangle

    assert effect.place is not None
    a, b = 1e3 * plate.length, 1e3 * plate.width
    side = effect.place[2] * min(a, b)
    for k, (x, y) in enumerate(images_of((effect.place[0], effect.place[1]), [facts])):
        at = (x * (a - side), y * (b - side))
        face = "none" if k else PREDICTED
        axes.add_patch(Rectangle(at, side, side, facecolor=face, edgecolor=PREDICTED, alpha=0.35, zorder=4))


def _draw_angle(axes: Axes, cause: Cause, effect: Effect, plate: Plate) -> None:
    """An angle, small ones enlarged: of the corners as a dashed outline, of plies as dashed lines."""
    a, b = 1e3 * plate.length, 1e3 * plate.width
    mean = cause.parameters[effect.parameters[0].name][0]
    angle = np.deg2rad(np.sign(mean or 1.0) * max(abs(mean), _SHOWN_DEG))
    if effect.drawn == "corners":
        shift = 0.5 * b * np.tan(angle)
        x = np.array([-shift, a - shift, a + shift, shift, -shift])
        axes.plot(x, [0, 0, b, b, 0], color=PREDICTED, linewidth=1.2, linestyle="--", zorder=4)
        return
    reach = 0.3 * min(a, b)
    for offset in (-0.12, 0.0, 0.12):
        x0, y0 = a / 2, b / 2 + offset * b
        dx, dy = reach * np.cos(angle), reach * np.sin(angle)
        axes.plot((x0 - dx, x0 + dx), (y0 - dy, y0 + dy), color=PREDICTED, linewidth=0.8, linestyle="--")


def _residuals(result: DiagnosisResult) -> Drawing:
    claimed = result.extended is not None
    text = (
        "Residual of each frequency. Blue: without what was found; orange: with it. "
        if claimed
        else "Residual of each frequency. "
    )
    text += (
        "Noise explains a bar whose whisker reaches zero. Below each bar: the shape of its mode, red up and "
        "blue down."
    )
    rows = result.plain.frequencies if result.extended is None else result.extended.frequencies
    alt = f"Residuals by mode: {', '.join(map(_residual, rows))}."
    return Drawing("residuals", partial(_residuals_figure, result), Caption(text, alt))


def _residual(row: FrequencyRow) -> str:
    left = "no mode" if row.residual_percent is None else f"{row.residual_percent:+.2f} %"
    return f"{row.measured:.6g} Hz {left}"


def _residuals_figure(result: DiagnosisResult) -> Figure:
    """Relative residuals of every frequency, one row of panels per plate, with mode shapes below."""
    d, before = result.diagnosis, result.plain.frequencies
    after = None if result.extended is None else result.extended.frequencies
    names = list(dict.fromkeys(row.plate for row in before))
    most = max(sum(row.plate == name for row in before) for name in names)
    figure = new_figure(max(6.0, 0.85 * most + 1.2), 3.6 * len(names) + 0.5)
    panels = figure.subfigures(len(names), 1, squeeze=False).ravel()
    for i, (panel, name) in enumerate(zip(panels, names, strict=True)):
        plain = [row for row in before if row.plate == name]
        extended = None if after is None else [row for row in after if row.plate == name]
        _draw_residuals(panel, result, i, plain, extended)
    title = f"{_names(d)}: misfit {100 * d.baseline.rms:.2f} %"
    if d.extended is not None:
        title += f", with what was found {100 * d.extended.rms:.2f} %"
    headed(panels[0], title)
    return figure


def _draw_residuals(
    panel: Any,
    result: DiagnosisResult,
    i: int,
    before: Sequence[FrequencyRow],
    after: Sequence[FrequencyRow] | None,
) -> None:
    n = len(before)
    grid = panel.add_gridspec(2, n, height_ratios=(3.2, 1.0))
    axes = panel.add_subplot(grid[0, :])
    x = np.arange(n)
    axes.axhline(0.0, color="0.5", linewidth=0.8)
    if after is None:
        _bars(axes, x, 0.6, before, BEFORE, "plain model")
    else:
        _bars(axes, x - 0.18, 0.34, before, BEFORE, "without what was found")
        _bars(axes, x + 0.18, 0.34, after, PREDICTED, "with it")
    axes.plot([], [], color=MEASURED, linewidth=1.0, label="2 sd of noise and prediction")
    axes.set_xticks(x, [f"{row.measured:.6g} Hz" for row in before], fontsize=9)
    axes.set(xlim=(-0.5, n - 0.5), ylabel="predicted / measured - 1, %")
    axes.set_ylim(*_limits([*before, *(after or ())]))
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(loc="upper right", frameon=False, fontsize=9, ncols=3)
    if len(result.plates) > 1:
        axes.set_title(result.plates[i].name, fontsize=9, loc="left")
    plate, shapes = result.plates[i].plate, result.mode_shapes[i]
    extent = extent_of(plate.length, plate.width)
    for k, (plain, row) in enumerate(zip(before, after or before, strict=True)):
        below = panel.add_subplot(grid[1, k])
        if row.mode is None or row.number is None:
            below.set_axis_off()
            below.set_title("no mode", fontsize=9)
            continue
        in_plane = row.mode.in_plane_fraction > 0.5
        draw_shape(below, shapes[row.number - 1], extent, plate.edges, in_plane=in_plane, linewidth=0.6)
        label = row.mode.label
        if plain.mode is not None and plain.number != row.number:
            label = f"not {plain.mode.label}\n{label}"
        below.set_title(label, fontsize=9, pad=2)


def _bars(axes: Axes, x: Array, width: float, rows: Sequence[FrequencyRow], color: str, label: str) -> None:
    """Bars of residuals, each with two standard deviations of noise and prediction."""
    y = np.array([0.0 if row.residual_percent is None else row.residual_percent for row in rows])
    sd = np.array([0.0 if row.predicted is None else _sd_percent(row) for row in rows])
    axes.bar(x, y, width, color=color, label=label)
    axes.errorbar(x, y, yerr=2.0 * sd, fmt="none", ecolor=MEASURED, elinewidth=1.0)


def _sd_percent(row: FrequencyRow) -> float:
    return 100.0 * float(np.hypot(row.sigma, row.predicted_sd)) / row.measured


def _limits(rows: Sequence[FrequencyRow]) -> tuple[float, float]:
    """Axis limits of the residuals, with room for the legend; whiskers may be cut off."""
    shown = [row for row in rows if row.predicted is not None]
    largest = max((abs(row.residual_percent or 0.0) for row in shown), default=0.0)
    whisker = float(np.median([2.0 * _sd_percent(row) for row in shown])) if shown else 1.0
    end = 1.1 * max(largest + whisker, 0.1)
    return -end, 1.3 * end


def _causes(d: Diagnosis) -> Drawing:
    most = ", ".join(f"{title_of(d, c.name)} {probability_text(c.probability)}" for c in leading(d, 0.05, 5))
    text = (
        f"Probability of each cause; a claim needs the black mark: {CLAIM_RULES.plain:g} for nothing wrong, "
        f"{CLAIM_RULES.sure:g} for an error. ln B weighs an error against nothing wrong: three and "
        "more speak for it. Orange: what is claimed."
    )
    return Drawing("causes", partial(_causes_figure, d), Caption(text, f"Probabilities: {most}."))


def _causes_figure(d: Diagnosis) -> Figure:
    shown = leading(d, 0.0, _BARS)
    figure = new_figure(7.0, 1.3 + 0.27 * len(shown))
    axes = figure.add_subplot()
    y = np.arange(len(shown))
    colors = [PREDICTED if c.name in d.claimed else BEFORE if c.name == NONE else REFERENCE for c in shown]
    axes.barh(y, [c.probability for c in shown], 0.65, color=colors)
    for at, cause in zip(y, shown, strict=True):
        axes.text(1.06, float(at), probability_text(cause.probability), va="center", fontsize=9)
        if cause.name != NONE:
            factor = f"{round(cause.log_bayes_factor, 1) + 0.0:+.1f}"
            axes.text(1.45, float(at), factor, va="center", ha="right", fontsize=9)
    axes.text(1.06, -0.9, "probability", va="center", fontsize=9)
    axes.text(1.45, -0.9, "ln B", va="center", ha="right", fontsize=9)
    axes.set_yticks(y, [_with_plates(d, c) for c in shown], fontsize=9)
    axes.invert_yaxis()
    needed = [CLAIM_RULES.plain if c.name == NONE else CLAIM_RULES.sure for c in shown]
    axes.plot(needed, y, "|", color="black", markersize=13, markeredgewidth=1.6, label="needed for a claim")
    axes.set(xlim=(0, 1.5), xticks=np.linspace(0, 1, 6), xlabel="probability")
    figure.legend(loc="outside lower center", frameon=False, fontsize=9)
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.tick_params(axis="y", length=0)
    headed(figure, f"{_names(d)}: probability of each cause")
    return figure


def _with_plates(d: Diagnosis, cause: Cause) -> str:
    """The title of a cause, with its plates unless all have it."""
    some = len(d.cases) > 1 and len(cause.plates) < len(d.cases)
    return title_of(d, cause.name) + (f", {', '.join(cause.plates)}" if some else "")


def _with_signatures(d: Diagnosis) -> list[str]:
    """Single causes with a visible signature, the most probable first."""
    return [c.name for c in d.causes if c.name in d.signatures and not c.is_set and not c.absorbed]


def _alike_together(d: Diagnosis) -> list[str]:
    """Single causes with a visible signature, ordered so that similar ones are neighbours."""
    names = _with_signatures(d)
    ordered: list[str] = []
    while names:
        last = d.signatures[ordered[-1]] if ordered else None
        nearest = max(names, key=lambda n: 0.0 if last is None else abs(cosine(last, d.signatures[n])))
        ordered.append(nearest)
        names.remove(nearest)
    return ordered


def _signatures(d: Diagnosis) -> Drawing:
    caption = Caption(
        "Two causes with a dark, framed cell move the frequencies in the same proportions: these frequencies "
        "cannot tell one from the other.",
        f"Likeness of the causes' signatures; framed where the cosine is above {ALIKE:g}.",
    )
    return Drawing("signatures", partial(_signatures_figure, d), caption)


def _signatures_figure(d: Diagnosis) -> Figure:
    """Cosines between the causes' signatures, with the constants projected out."""
    names = _alike_together(d)
    signatures = [d.signatures[name] for name in names]
    matrix = np.array([[cosine(a, b) for b in signatures] for a in signatures])
    size = 3.2 + 0.27 * len(names)
    figure = new_figure(size + 0.8, size)
    axes = figure.add_subplot()
    drawn = axes.imshow(np.abs(matrix), cmap="Greys", vmin=0.0, vmax=1.0)
    for i, j in np.argwhere(np.abs(matrix) > ALIKE):
        if i != j:
            axes.plot(j, i, "s", mfc="none", mec=PREDICTED, markersize=9, markeredgewidth=1.4)
    titles = [title_of(d, name) for name in names]
    axes.set_xticks(range(len(names)), titles, rotation=90, fontsize=9)
    axes.set_yticks(range(len(names)), titles, fontsize=9)
    headed(figure, f"{_names(d)}: which causes look alike")
    bar = figure.colorbar(drawn, ax=axes, shrink=0.8)
    bar.set_label(f"|cosine| of signatures; framed: above {ALIKE:g}", fontsize=9)
    return figure


def _detectable(d: Diagnosis) -> Drawing:
    caption = Caption(
        "The further left, the smaller the error that would have shown, in standard deviations of the prior "
        "of its size. Right of the dotted line only an error larger than usual shows.",
        "The smallest size of each cause that these frequencies would have shown with 95 % probability.",
    )
    return Drawing("detectable", partial(_detectable_figure, d), caption)


def _detectable_figure(d: Diagnosis) -> Figure:
    """Detection limit of each cause, in sd of its prior."""
    from matplotlib.ticker import LogLocator, NullLocator

    rows = [row for row in detectable_rows(d) if row.probability is not None]
    rows.sort(key=lambda row: (row.in_sd is None, row.in_sd))
    sizes = [row.in_sd for row in rows if row.in_sd is not None]
    left, right = 0.5 * min(*sizes, 1.0), 4.0 * max(*sizes, 1.0)
    figure = new_figure(7.0, 0.9 + 0.22 * len(rows))
    axes = figure.add_subplot()
    axes.axvline(1.0, color=REFERENCE, linewidth=0.8, linestyle=":")
    for y, row in enumerate(rows):
        if row.in_sd is not None:
            axes.hlines(y, left, row.in_sd, color="0.85", linewidth=1.0)
            axes.plot(row.in_sd, y, "o", color=BEFORE, markersize=6)
        axes.annotate(
            detectable_size(row),
            (row.in_sd or left, y),
            (7, 0),
            textcoords="offset points",
            va="center",
            fontsize=9,
            color="0.5" if row.in_sd is None else "black",
            bbox={"color": "white", "pad": 0.5},
        )
    axes.set_yticks(range(len(rows)), [row.title for row in rows], fontsize=9)
    axes.set(xscale="log", xlim=(left, right), ylim=(len(rows) - 0.3, -0.7))
    axes.set_xlabel("detection limit / standard deviation of its prior")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_locator(NullLocator())
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.tick_params(axis="y", length=0)
    headed(figure, f"{_names(d)}: detection limits")
    return figure


def _constants(d: Diagnosis) -> Drawing:
    names = listed([c.name for c in answer_constants(d)], "and")
    caption = Caption(
        "Blue: the constants as if nothing were wrong. Orange: the answer, averaged over all causes by their "
        "probability. Where the two differ, the constants depend on what is wrong. Dotted: the reference.",
        f"Means and 95 % intervals of {names}.",
    )
    return Drawing("constants", partial(_constants_figure, d), caption)


def _constants_figure(d: Diagnosis) -> Figure:
    """Means and 95 % intervals by the plain model and of the answer, one panel per constant."""
    before, answer = {c.name: c for c in fit_constants(d, d.baseline)}, answer_constants(d)
    figure = new_figure(max(4.5, 1.5 * len(answer) + 0.6), 3.4)
    for axes, constant in zip(figure.subplots(1, len(answer), squeeze=False)[0], answer, strict=True):
        if constant.name in before:
            _interval(axes, 0.0, before[constant.name], BEFORE, "plain model")
        _interval(axes, 1.0, constant, PREDICTED, "answer")
        reference = to_user(constant.name, constant.reference)
        axes.axhline(reference, color=REFERENCE, linewidth=1.0, linestyle=":", label="reference")
        axes.set(xlim=(-0.7, 1.7), xticks=[])
        axes.set_title(", ".join(t for t in (constant.name, unit_of(constant.name)) if t), fontsize=9)
        axes.tick_params(labelsize=9)
        axes.spines[["top", "right", "bottom"]].set_visible(False)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", frameon=False, fontsize=9, ncols=3)
    headed(figure, f"{_names(d)}: constants")
    return figure


def _interval(axes: Axes, x: float, constant: Constant, color: str, label: str) -> None:
    assert constant.interval is not None
    mean, low, high = (to_user(constant.name, v) for v in (constant.value, *constant.interval))
    reach = [[mean - low], [high - mean]]
    axes.errorbar([x], [mean], yerr=reach, fmt="o", color=color, markersize=5, capsize=3, label=label)
