"""Figures of `diagnose`: residuals with mode shapes, causes, which of them look alike, constants."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from cpam_bayes.diagnosis.claim import PLAIN, SURE
from cpam_bayes.diagnosis.diagnose import Diagnosis
from cpam_bayes.diagnosis.hypotheses import NONE, OTHER
from cpam_bayes.diagnosis.paired_modes import FrequencyRow
from cpam_bayes.diagnosis.plates import DiagnosisResult
from cpam_bayes.diagnosis.signatures import ALIKE, cosine
from cpam_bayes.formatting import listed
from cpam_bayes.report.diagnosis.rows import (
    ConstantRow,
    averaged_rows,
    constant_rows,
    detectable_rows,
    leading,
    shows_constants,
    shows_detectable,
    shows_signatures,
    with_signatures,
)
from cpam_bayes.report.diagnosis.words import detectable_size, probability_text
from cpam_bayes.report.mode_shapes import draw_shape, extent_of

Array = NDArray[Any]

_GREY, _BLUE, _ORANGE = "#8a8a8a", "#4878a8", "#c1440e"
_BARS = 12


def figures(result: DiagnosisResult) -> dict[str, Figure]:
    """All figures of a diagnosis by name."""
    d = result.diagnosis
    drawn = {"residuals": _residuals(result), "causes": _causes(d)}
    if shows_signatures(d):
        drawn["signatures"] = _signatures(d)
    if shows_detectable(d):
        drawn["detectable"] = _detectable(d)
    if shows_constants(d):
        drawn["constants"] = _constants(d)
    return drawn


def _residuals(result: DiagnosisResult) -> Figure:
    """Relative residuals of every frequency, a plate a row, its mode shape below it."""
    d, before = result.diagnosis, result.plain.frequencies
    after = None if result.extended is None else result.extended.frequencies
    names = list(dict.fromkeys(row.plate for row in before))
    most = max(sum(row.plate == name for row in before) for name in names)
    figure = Figure(figsize=(max(6.0, 0.85 * most + 1.2), 3.6 * len(names) + 0.5), layout="constrained")
    panels = figure.subfigures(len(names), 1, squeeze=False).ravel()
    for i, (panel, name) in enumerate(zip(panels, names, strict=True)):
        plain = [row for row in before if row.plate == name]
        extended = None if after is None else [row for row in after if row.plate == name]
        _draw_plate(panel, result, i, plain, extended)
    title = f"{_title(d)}: misfit of the plain model {100 * d.baseline.rms:.2f} %"
    if d.extended is not None:
        title += f", of the extended one {100 * d.extended.rms:.2f} %"
    panels[0].suptitle(title, fontsize=10)
    return figure


def _draw_plate(
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
    width = 0.6 if after is None else 0.34
    _bars(axes, x - (0.0 if after is None else 0.18), width, before, _BLUE, "plain model")
    if after is not None:
        _bars(axes, x + 0.18, width, after, _ORANGE, "extended model")
    axes.plot([], [], color="0.25", linewidth=1.0, label="2 sd of noise and prediction")
    axes.set_xticks(x, [f"{row.measured:.6g} Hz" for row in before], fontsize=8)
    axes.set(xlim=(-0.5, n - 0.5), ylabel="predicted / measured - 1, %")
    axes.set_ylim(*_limits([*before, *(after or ())]))
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(loc="upper right", frameon=False, fontsize=8, ncols=3)
    if len(result.plates) > 1:
        axes.set_title(result.plates[i].name, fontsize=9, loc="left")
    plate, shapes = result.plates[i].plate, result.mode_shapes[i]
    extent = extent_of(plate.length, plate.width)
    for k, (plain, row) in enumerate(zip(before, after or before, strict=True)):
        below = panel.add_subplot(grid[1, k])
        if row.mode is None or row.number is None:
            below.set_axis_off()
            below.set_title("no mode", fontsize=7)
            continue
        in_plane = row.mode.in_plane_fraction > 0.5
        draw_shape(below, shapes[row.number - 1], extent, plate.edges, in_plane=in_plane, linewidth=0.6)
        label = row.mode.label
        if plain.mode is not None and plain.number != row.number:
            label = f"not {plain.mode.label}\n{label}"
        below.set_title(label, fontsize=7, pad=2)


def _bars(axes: Axes, x: Array, width: float, rows: Sequence[FrequencyRow], color: str, label: str) -> None:
    """Residuals, each with two standard deviations of noise and prediction."""
    y = np.array([0.0 if row.residual_percent is None else row.residual_percent for row in rows])
    sd = np.array([0.0 if row.predicted is None else _sd_percent(row) for row in rows])
    axes.bar(x, y, width, color=color, label=label)
    axes.errorbar(x, y, yerr=2.0 * sd, fmt="none", ecolor="0.25", elinewidth=1.0)


def _sd_percent(row: FrequencyRow) -> float:
    return 100.0 * float(np.hypot(row.sigma, row.predicted_sd)) / row.measured


def _limits(rows: Sequence[FrequencyRow]) -> tuple[float, float]:
    """Of the residuals, with room for the key; whiskers may be cut."""
    shown = [row for row in rows if row.predicted is not None]
    largest = max((abs(row.residual_percent or 0.0) for row in shown), default=0.0)
    whisker = float(np.median([2.0 * _sd_percent(row) for row in shown])) if shown else 1.0
    end = 1.1 * max(largest + whisker, 0.1)
    return -end, 1.3 * end


def _causes(d: Diagnosis) -> Figure:
    """Probabilities of the leading causes, none and other among them."""
    shown = leading(d, 0.0, _BARS)
    names = [cause.name for cause in shown]
    figure = Figure(figsize=(5.8, 1.3 + 0.27 * len(names)), layout="constrained")
    axes = figure.add_subplot()
    y = np.arange(len(names))
    colors = [_ORANGE if c.name in d.claimed else _GREY if c.name in (NONE, OTHER) else _BLUE for c in shown]
    axes.barh(y, [c.probability for c in shown], 0.65, color=colors)
    for at, cause in zip(y, shown, strict=True):
        axes.text(1.06, float(at), probability_text(cause.probability), va="center", fontsize=9)
        if cause.name != NONE:
            factor = f"{round(cause.log_bayes_factor, 1) + 0.0:+.1f}"
            axes.text(1.45, float(at), factor, va="center", ha="right", fontsize=9)
    axes.text(1.06, -0.9, "probability", va="center", fontsize=8)
    axes.text(1.45, -0.9, "ln B", va="center", ha="right", fontsize=8)
    axes.set_yticks(y, [_with_place(d, c) for c in shown], fontsize=9)
    axes.invert_yaxis()
    needed = [PLAIN if c.name == NONE else SURE for c in shown]
    axes.plot(needed, y, "|", color="black", markersize=13, markeredgewidth=1.6, label="needed for a claim")
    axes.set(xlim=(0, 1.5), xticks=np.linspace(0, 1, 6), xlabel="probability")
    figure.legend(loc="outside lower center", frameon=False, fontsize=8)
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.tick_params(axis="y", length=0)
    axes.set_title(f"{_title(d)}: {_claimed(d)}", fontsize=10, pad=12)
    return figure


def _claimed(d: Diagnosis) -> str:
    """The claim in a few words."""
    names = listed(d.claim.causes, "or" if d.claim.kind == "class" else "and")
    return {
        "none": "no cause is claimed",
        "other": "claimed is an error outside the catalogue",
        "undecided": "undecided, no cause is claimed",
        "class": f"claimed is one of {names}",
    }.get(d.claim.kind, f"claimed is {names}")


def _with_place(d: Diagnosis, cause: Any) -> str:
    parts = [cause.name]
    if len(d.cases) > 1 and len(cause.plates) < len(d.cases):
        parts.append(f"of {', '.join(cause.plates)}")
    return " ".join(parts)


def _alike_together(d: Diagnosis) -> list[str]:
    """Single causes that leave something to be seen, ordered so that those alike stand together."""
    names = with_signatures(d)
    ordered: list[str] = []
    while names:
        last = d.signatures[ordered[-1]] if ordered else None
        nearest = max(names, key=lambda n: 0.0 if last is None else abs(cosine(last, d.signatures[n])))
        ordered.append(nearest)
        names.remove(nearest)
    return ordered


def _signatures(d: Diagnosis) -> Figure:
    """Cosines between the causes' signatures, the constants projected out."""
    names = _alike_together(d)
    signatures = [d.signatures[name] for name in names]
    matrix = np.array([[cosine(a, b) for b in signatures] for a in signatures])
    size = 1.9 + 0.27 * len(names)
    figure = Figure(figsize=(size + 0.8, size), layout="constrained")
    axes = figure.add_subplot()
    drawn = axes.imshow(np.abs(matrix), cmap="Greys", vmin=0.0, vmax=1.0)
    for i, j in np.argwhere(np.abs(matrix) > ALIKE):
        if i != j:
            axes.plot(j, i, "s", mfc="none", mec=_ORANGE, markersize=9, markeredgewidth=1.4)
    axes.set_xticks(range(len(names)), names, rotation=90, fontsize=8)
    axes.set_yticks(range(len(names)), names, fontsize=8)
    axes.set_title(f"{_title(d)}: which causes look alike", fontsize=10)
    bar = figure.colorbar(drawn, ax=axes, shrink=0.8)
    bar.set_label(
        f"|cosine| of signatures, constants projected out\nframed: above {ALIKE:g}, not to be told apart",
        fontsize=8,
    )
    return figure


def _detectable(d: Diagnosis) -> Figure:
    """The smallest size of each cause that these data would have shown, in usual sizes."""
    rows = [row for row in detectable_rows(d) if row.probability is not None]
    rows.sort(key=lambda row: (row.in_sd is None, row.in_sd))
    sizes = [row.in_sd for row in rows if row.in_sd is not None]
    left, right = 0.5 * min(*sizes, 1.0), 2.0 * max(*sizes, 1.0)
    figure = Figure(figsize=(5.8, 0.9 + 0.28 * len(rows)), layout="constrained")
    axes = figure.add_subplot()
    for y, row in enumerate(rows):
        end = right if row.in_sd is None else row.in_sd
        axes.barh(y, end - left, 0.65, left=left, color="0.9" if row.in_sd is None else _BLUE)
        x = left if row.in_sd is None else end
        said = detectable_size(row)
        axes.annotate(said, (x, y), (4, 0), textcoords="offset points", va="center", fontsize=8)
    axes.axvline(1.0, color="0.6", linewidth=0.8, linestyle=":")
    axes.set_yticks(range(len(rows)), [row.cause for row in rows], fontsize=8)
    axes.invert_yaxis()
    axes.set(
        xscale="log",
        xlim=(left, 2.0 * right),
        xlabel="smallest size, in usual sizes (dotted: one)",
    )
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.tick_params(axis="y", length=0)
    axes.set_title(f"{_title(d)}: what these data would have shown", fontsize=10)
    return figure


def _constants(d: Diagnosis) -> Figure:
    """Means and 95 % intervals by the plain model and of the answer, a panel a constant."""
    before = constant_rows(d, d.baseline)
    answer = averaged_rows(d) if d.extended is None else constant_rows(d, d.extended)
    after = {row.name: row for row in answer}
    label = "averaged over all hypotheses" if d.extended is None else "extended model"
    figure = Figure(figsize=(max(4.5, 1.5 * len(before) + 0.6), 3.4), layout="constrained")
    for axes, row in zip(figure.subplots(1, len(before), squeeze=False)[0], before, strict=True):
        _interval(axes, 0.0, row, _BLUE, "plain model")
        if row.name in after:
            _interval(axes, 1.0, after[row.name], _ORANGE, label)
        axes.axhline(row.reference, color="0.4", linewidth=1.0, linestyle=":", label="reference")
        axes.set(xlim=(-0.7, 1.7 if after else 0.7), xticks=[])
        axes.set_title(row.name.replace("_", ", "), fontsize=9)
        axes.tick_params(labelsize=8)
        axes.spines[["top", "right", "bottom"]].set_visible(False)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", frameon=False, fontsize=8, ncols=3)
    figure.suptitle(f"{_title(d)}: constants, mean and 95 % interval", fontsize=10)
    return figure


def _interval(axes: Axes, x: float, row: ConstantRow, color: str, label: str) -> None:
    reach = [[row.mean - row.q025], [row.q975 - row.mean]]
    axes.errorbar([x], [row.mean], yerr=reach, fmt="o", color=color, markersize=5, capsize=3, label=label)


def _title(d: Diagnosis) -> str:
    return " ".join(case.name for case in d.cases)
