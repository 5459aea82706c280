"""Drawings of a modal test: its spectrum with each peak labelled, and its stability diagram."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.answer import FrequencyRow
from cpam_bayes.formatting import significant
from cpam_bayes.plate import Measurement, Specimen
from cpam_bayes.plate.modal_analysis.fit import Taken
from cpam_bayes.plate.modal_analysis.peaks import ModalTest
from cpam_bayes.render.figures import MEASURED, PREDICTED, new_figure
from cpam_bayes.render.report import Caption, Column, Drawing, Rows, Section

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST_DRAWN: Final = 12
# Smallest drawn value, as a fraction of the largest.
_FLOOR: Final = 1e-12


class Mark(NamedTuple):
    """A marked frequency of a spectrum, Hz, its label, and whether it is a mode."""

    frequency: float
    said: str
    is_mode: bool


def test_drawings(test: ModalTest, title: str, marks: Sequence[Mark]) -> tuple[Drawing, ...]:
    """The spectrum with marks, and the stability diagram."""
    n_modes = sum(mark.is_mode for mark in marks)
    counted = f"{title}: {n_modes} modes"
    return (
        Drawing(
            "spectrum",
            partial(_spectrum, test, counted, marks),
            Caption(
                "The responses (grey, every hit) with each peak identified: a red line is a mode, a dotted "
                "grey one says what else it is.",
                f"Spectrum with {n_modes} modes and {len(marks) - n_modes} other peaks.",
            ),
        ),
        Drawing(
            "stability",
            partial(_stability, test, counted, [mark.frequency for mark in marks if mark.is_mode]),
            Caption(
                "Each point is a pole of a model with as many poles as its height says; filled ones are "
                "stable: also in the order below. A mode is a column of filled points at a peak of the "
                "responses (grey). Red lines are the modes: look at a line without a column, and at a column "
                "without one.",
                f"Stability diagram of {len(test.stabilisation.orders)} poles with {n_modes} modes.",
            ),
        ),
    )


class _Peak(NamedTuple):
    """A candidate peak, or hum.

    probability : of being a mode, before the model is consulted; None for a non-candidate
    damping : ratio
    predicted : Hz, of the mode it is paired with; None for none
    certainty : probability of the label, None where unknown
    """

    frequency: float
    probability: float | None
    damping: float | None
    predicted: float | None
    taken: str
    certainty: float | None = None


def _percent(value: float) -> str:
    return significant(100.0 * value, 2)


def _hz(value: float) -> str:
    return f"{value:.5g}"


_COLUMNS: Final = (
    Column("Hz", "hz", lambda p: p.frequency, _hz, number=True),
    Column("mode by height %", "mode_probability", lambda p: p.probability, _percent, number=True),
    Column("damping %", "damping", lambda p: p.damping, _percent, number=True),
    Column("predicted Hz", "predicted_hz", lambda p: p.predicted, _hz, number=True),
    Column("classified as", "taken", lambda p: p.taken),
    Column("probability %", "probability", lambda p: p.certainty, _percent, number=True),
)


def peak_rows(measurement: Measurement | None, rows: Iterable[FrequencyRow]) -> Rows:
    """The candidate peaks of a measurement with their labels; empty for a list.

    rows : of the answer, one for each measured frequency; others are ignored
    """
    if measurement is None or measurement.mode_probability is None:
        return Rows("peaks", _COLUMNS, ())
    of = {row.measured: row for row in rows}
    poles = () if measurement.test is None else measurement.test.poles
    otherwise = {one.frequency: one.taken.value for one in poles if one.taken is Taken.SECOND_HIT}
    peaks = []
    for i, f in enumerate(measurement.frequencies.tolist()):
        row = of.get(f)
        certainty = None if row is None else row.probability
        row = None if row is None or row.predicted is None else row
        damping = None if measurement.damping is None else float(measurement.damping[i])
        taken = (
            otherwise.get(f, "no mode") if row is None else f"mode {row.number} {row.label or ''}".rstrip()
        )
        predicted = None if row is None else row.predicted
        peaks.append(_Peak(f, float(measurement.mode_probability[i]), damping, predicted, taken, certainty))
    peaks += [
        _Peak(one.frequency, None, one.damping, None, one.taken.value)
        for one in poles
        if one.taken is Taken.HUM
    ]
    return Rows("peaks", _COLUMNS, tuple(sorted(peaks, key=lambda peak: peak.frequency)))


def peak_sections(specimen: Specimen, peaks: Rows) -> tuple[Section, ...]:
    """Section of the candidates with the spectrum, and the stability diagram folded; empty for a list."""
    if not peaks.rows:
        return ()
    drawn = specimen.measurement is not None and specimen.measurement.test is not None
    table = peaks.table("What each peak is")
    figures = ("spectrum",) if drawn else ()
    own = Section("Peaks", (table,), figures=figures, folded=False)
    return (own, Section("Stability diagram", figures=("stability",))) if drawn else (own,)


def peak_keys(peaks: Rows) -> dict[str, Any]:
    """The key `peaks` of a document, missing for a list."""
    return {"peaks": peaks.records()} if peaks.rows else {}


def peak_drawings(specimen: Specimen, peaks: Rows) -> tuple[Drawing, ...]:
    """The drawings of `peak_sections`."""
    test = None if specimen.measurement is None else specimen.measurement.test
    if test is None or not peaks.rows:
        return ()
    marks = [Mark(peak.frequency, peak.taken, peak.predicted is not None) for peak in peaks.rows]
    return test_drawings(test, specimen.name, marks)


def line_sizes(
    test: ModalTest, frf: NDArray[np.complex128]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Frequencies in the range, and the root mean square of responses (m, n) there."""
    f = test.responses.frequencies
    shown = (f >= test.low) & (f <= test.high)
    size = np.sqrt(np.mean(np.abs(frf[:, shown]) ** 2, axis=0))
    return f[shown], np.maximum(size, size.max() * _FLOOR)


def _spectrum(test: ModalTest, title: str, marks: Sequence[Mark]) -> Figure:
    figure = new_figure(9.0, 4.8)
    axes = figure.add_subplot()
    for hit in test.responses.each_hit[:_MOST_DRAWN]:
        axes.semilogy(*line_sizes(test, hit.frf), color="0.6", linewidth=0.7, rasterized=True)
    for frequency, said, is_mode in marks:
        colour = PREDICTED if is_mode else "0.4"
        axes.axvline(frequency, color=colour, linewidth=0.8, linestyle="-" if is_mode else ":")
        axes.annotate(
            f"{frequency:.4g} {said}",
            (frequency, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(2.0, -3.0),
            textcoords="offset points",
            rotation=90,
            fontsize=8,
            color=colour,
            verticalalignment="top",
        )
    _finish(axes, test, title)
    axes.set_ylabel("root mean square of the responses")
    return figure


def _stability(test: ModalTest, title: str, modes: Sequence[float]) -> Figure:
    """Poles by model order over the responses."""
    found, figure = test.stabilisation, new_figure(9.0, 4.8)
    axes = figure.add_subplot()
    behind = axes.twinx()
    behind.semilogy(*line_sizes(test, test.responses.frf), color="0.6", linewidth=0.8)
    behind.set_ylabel("root mean square of the responses")
    axes.set_zorder(behind.get_zorder() + 1)
    axes.patch.set_visible(False)
    for frequency in modes:
        axes.axvline(frequency, color=PREDICTED, linewidth=0.8)
    for stable, filled in ((False, "none"), (True, MEASURED)):
        at = found.stable == stable
        axes.plot(
            found.frequencies[at],
            found.orders[at],
            "o",
            markersize=2.5,
            markerfacecolor=filled,
            markeredgecolor=MEASURED if stable else "0.7",
            markeredgewidth=0.5,
            rasterized=True,
            label="stable: also in the order below" if stable else "new at this order",
        )
    _finish(axes, test, title)
    axes.set(ylim=(0, test.order + 1), ylabel="poles")
    figure.legend(loc="outside lower center", ncols=2, frameon=False, fontsize="small")
    return figure


def _finish(axes: Axes, test: ModalTest, title: str) -> None:
    axes.set(xlim=(test.low, test.high), xlabel="Hz")
    axes.set_title(title, fontsize=10, loc="left")
