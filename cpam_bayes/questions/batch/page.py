"""The report of a batch: its plates, limits and control chart."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np

from cpam_bayes.answer import Verdict
from cpam_bayes.batches.limits import OF_MEDIAN_RANGE, SIGMAS
from cpam_bayes.batches.plate_row import PlateRow, RowConstant
from cpam_bayes.batches.population import LEAST_PLATES, Population, PopulationConstant
from cpam_bayes.formatting import listed, significant, with_spread
from cpam_bayes.plate import to_user, unit_of
from cpam_bayes.questions.batch.result import SURE, BatchResult, document, plates
from cpam_bayes.questions.batch.verdicts import (
    certificate_section,
    four_verdicts,
    limit_step,
    why_not_judged,
)
from cpam_bayes.render.figures import MEASURED, headed, new_figure
from cpam_bayes.render.report import (
    COMPUTATION,
    Caption,
    Column,
    Drawing,
    Report,
    Rows,
    Section,
    Table,
    facts,
)
from cpam_bayes.result import present

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Rows on the first screen, plates named as outside the limits, and as not described, in a sentence.
_MOST_ROWS, _MOST_NAMES, _MOST_WRONG = 40, 10, 3
# Plates named below the axis of the control chart, and those with upright names.
_MOST_TICKS, _MOST_UPRIGHT = 40, 6
# Standard deviation of normal values over their median absolute deviation.
_NORMAL: Final = 1.4826
_OUTSIDE: Final = "#b3261e"
_FAILED: Final = (Column("file", "file", lambda row: row.file), Column("why", "why", lambda row: row.message))


@present.register
def _present(result: BatchResult) -> Report:
    table, constants = plates(result), _constants(result)
    failed = Rows("failed", _FAILED, result.failed)
    first = "Plates" if len(result.rows) <= _MOST_ROWS else f"The first {_MOST_ROWS} plates"
    remarks = facts(
        "Warnings of the identifications", ((row.name, row.message) for row in result.done if row.message)
    )
    drawings = _drawings(result)
    return Report(
        summary=result.screen(
            headline=_headline(result),
            tables=(
                constants.table("The batch"),
                _scatters(result.population).table("The material: means and scatter from plate to plate"),
                plates(result, _MOST_ROWS).table(first),
                failed.table("Plates without an answer"),
            ),
            lines=_lines(result),
            next_step=_next_step(result),
        ),
        sections=(
            certificate_section(result),
            Section("Control chart", (), tuple(drawing.name for drawing in drawings), folded=False),
            Section(
                "All plates",
                (*((table.table("All plates"),) if len(result.rows) > _MOST_ROWS else ()), remarks),
            ),
            Section(COMPUTATION, (_computation(result),)),
        ),
        document=document(result),
        drawings=drawings,
        rows=(table, constants),
    )


def _headline(result: BatchResult) -> str:
    n, done = len(result.rows), len(result.done)
    said = [f"{done} of {n} plates have an answer." if n > 1 else f"{done} of 1 plate has an answer."]
    if result.limits:
        said = [four_verdicts(result)]
    elif wrong := [row for row in result.done if not row.is_judged]:
        each = [f"{row.name} ({why_not_judged(result, row)})" for row in wrong[:_MOST_WRONG]]
        more = [f"{len(wrong) - _MOST_WRONG} more"] if len(wrong) > _MOST_WRONG else []
        said.append(f"The model does not describe {listed([*each, *more], 'and')}.")
    if result.diagnosis and result.done:
        clean = sum(row.diagnosis is not None and row.diagnosis.claim == "none" for row in result.done)
        said.append(f"The model fits {clean}.")
    names = list(dict.fromkeys(row.name for name in result.constants for row in result.outside(name)))
    if names:
        more = [f"{len(names) - _MOST_NAMES} more"] if len(names) > _MOST_NAMES else []
        said.append(f"Outside the control limits: {listed([*names[:_MOST_NAMES], *more], 'and')}.")
    return " ".join(said)


def _lines(result: BatchResult) -> tuple[str, ...]:
    """Lines on the fit and on the content of the intervals."""
    if not result.done:
        return ()
    worst = max(result.done, key=lambda row: row.rms)
    typical = significant(100.0 * float(np.median([row.rms for row in result.done])), 2)
    fit = f"Fit {typical} % (median of the plates); the worst is {worst.name}"
    return (
        f"{fit}, {significant(100.0 * worst.rms, 2)} %.",
        "The intervals contain noise, tolerances and data sheet of each plate, but no other model "
        "error. (open): not determined by the frequencies.",
    )


def _next_step(result: BatchResult) -> str:
    if result.failed:
        return "correct the files that failed and run the batch again; with --store the others are kept."
    if step := limit_step(result):
        return step
    apart = next((row for name in result.constants for row in result.outside(name)), None)
    if apart is not None and not result.diagnosis:
        return f"what is wrong with {apart.name}?  cpam-bayes diagnose {apart.file}"
    if not result.diagnosis and (missed := _missing(result)) is not None:
        return f"is it the plate or the test of {missed.name}?  cpam-bayes diagnose {missed.file}"
    one_material = len({row.material for row in result.done}) == 1
    if result.population is None and one_material and len(result.done) >= LEAST_PLATES:
        return "add --hierarchical for the mean constants of the material and their scatter."
    return "" if result.diagnosis else "add --diagnosis: is anything wrong with a plate or its list?"


def _missing(result: BatchResult) -> PlateRow | None:
    """The first plate that fails a limit."""
    each = ((row, result.probability(row, limit)) for limit in result.limits for row in result.judged)
    return next((row for row, met in each if met is not None and met <= 1.0 - SURE), None)


def _computation(result: BatchResult) -> Table:
    rows = [
        ("constants", "swarms on standardised residuals, as in identify"),
        ("limits", "a normal distribution with value and sd of the constant, cut at its bounds"),
        ("models", f"{result.models} for {len(result.rows)} plates: lists are scaled to the sizes of the "
         "first plate of their geometry"),
        ("control limits", f"median +- {SIGMAS:g} sd, the sd {OF_MEDIAN_RANGE:.4g} times the median moving "
         "range of neighbours in the list, which a few bad plates do not widen"),
    ]  # fmt: skip
    if result.population is not None:
        rows.append(
            ("mean and scatter", "hierarchical model of Gaussian plates, sampled by emcee; the prior of the "
             "scatter is a half-Student-t of scale 5 %")
        )  # fmt: skip
    rows += [("from the store", f"{result.from_store} plates"), ("time", f"{result.seconds:.1f} s")]
    return facts("Computation", rows)


def _values(result: BatchResult, name: str) -> list[RowConstant]:
    """One constant of all judged plates that have it."""
    return [c for row in result.judged if (c := row.constant(name)) is not None]


def _median(result: BatchResult, name: str) -> float:
    return float(np.median([to_user(name, c.value) for c in _values(result, name)]))


def _median_text(result: BatchResult, name: str) -> str:
    """The median, to the digits of the scatter between plates, or of a single plate's sd."""
    scatter = _scatter(result, name)
    spread = scatter if np.isfinite(scatter) and scatter > 0.0 else _own_sd(result, name)
    return with_spread(_median(result, name), spread)[0]


def _scatter(result: BatchResult, name: str) -> float:
    """Scatter between plates, from the median absolute deviation."""
    values = np.array([to_user(name, c.value) for c in _values(result, name)])
    if len(values) < LEAST_PLATES:
        return float("nan")
    return _NORMAL * float(np.median(np.abs(values - np.median(values))))


def _own_sd(result: BatchResult, name: str) -> float:
    return float(np.median([to_user(name, c.sd) for c in _values(result, name)]))


def _determined(result: BatchResult, name: str) -> str:
    found = _values(result, name)
    return f"{sum(c.verdict is Verdict.DATA for c in found)} of {len(found)}"


def _outside(result: BatchResult, name: str) -> str:
    return " ".join(row.name for row in result.outside(name))


def _constants(result: BatchResult) -> Rows:
    """Median, scatter between plates and sd of a single plate for each constant."""
    of = partial
    columns = (
        Column("", "name", str),
        Column("median", None, of(_median_text, result), number=True),
        Column(None, "median", of(_median, result)),
        Column(
            "sd between plates",
            "sd_of_plates",
            of(_scatter, result),
            lambda v: significant(v, 2),
            number=True,
        ),
        Column("sd of one plate", "sd_of_one", of(_own_sd, result), lambda v: significant(v, 2), number=True),
        Column("unit", "unit", unit_of),
        Column("determined in", "determined_in", of(_determined, result)),
        Column("outside the control limits", "outside", of(_outside, result)),
    )
    return Rows("constants", columns, tuple(name for name in result.constants if _values(result, name)))


def _scatters(population: Population | None) -> Rows:
    """Mean constants of the material, their scatter, and the interval of a further plate."""
    columns = (
        Column("", "name", lambda c: c.name),
        Column("mean", None, lambda c: _spread(c.name, c.mean)[0], number=True),
        Column("sd", None, lambda c: _spread(c.name, c.mean)[1], number=True),
        Column("unit", None, lambda c: unit_of(c.name)),
        Column("scatter of plates, 95 %", None, _scatter_text),
        Column("a further plate, 95 %", None, _next_plate_text),
    )
    return Rows("population", columns, () if population is None else population.constants)


def _spread(name: str, quantiles: tuple[float, float, float, float]) -> tuple[str, str]:
    return with_spread(to_user(name, quantiles[0]), to_user(name, quantiles[1]))


def _scatter_text(c: PopulationConstant) -> str:
    return f"{' to '.join(significant(100.0 * v, 2) for v in c.scatter[2:])} %"


def _next_plate_text(c: PopulationConstant) -> str:
    _, sd, *ends = (to_user(c.name, v) for v in c.next_plate)
    return " to ".join(with_spread(end, sd)[0] for end in ends)


def _drawings(result: BatchResult) -> tuple[Drawing, ...]:
    if not result.done:
        return ()
    caption = Caption(
        "Dots: the constants of each plate, bars their 95 % intervals. Line and band: the median of the "
        "plates that the model describes, and three standard deviations of a plate as neighbours in the "
        "list scatter; a red dot lies outside. Dashed: a limit.",
        f"Control chart of {listed(list(result.constants), 'and')} over {len(result.done)} plates.",
    )
    return (Drawing("control_chart", partial(_control_charts, result), caption),)


def _control_charts(result: BatchResult) -> Figure:
    """Each constant over the plates in order, with the control limits for individual values."""
    names, rows = result.constants, result.done
    figure = new_figure(min(max(5.5, 0.2 * len(rows) + 2.0), 12.0), 1.7 * len(names) + 1.0)
    grid = figure.subplots(len(names), 1, squeeze=False, sharex=True).ravel()
    for axes, name in zip(grid, names, strict=True):
        having = [(i, c) for i, row in enumerate(rows) if (c := row.constant(name)) is not None]
        place = np.array([i for i, _ in having])
        value, low, high = (
            np.array([to_user(name, float(getattr(c, key))) for _, c in having])
            for key in ("value", "low", "high")
        )
        chart = result.chart(name)
        red = np.zeros(len(having), dtype=bool)
        if chart is not None:
            beyond = result.outside(name)
            red[[k for k, (i, _) in enumerate(having) if rows[i] in beyond]] = True
            lower, upper = (to_user(name, v) for v in chart.limits)
            axes.axhspan(lower, upper, color="0.93")
            axes.axhline(to_user(name, chart.median), color="0.5", linewidth=1)
        axes.vlines(place, low, high, color="0.6", linewidth=1)
        axes.plot(place[~red], value[~red], "o", color=MEASURED, markersize=3.5)
        axes.plot(place[red], value[red], "o", color=_OUTSIDE, markersize=4.5)
        for limit in result.limits:
            if limit.name == name:
                axes.axhline(to_user(name, limit.value), color=MEASURED, linestyle="--", linewidth=1)
        axes.set_ylabel(f"{name}, {unit_of(name)}" if unit_of(name) else name)
    if len(rows) <= _MOST_TICKS:
        turned = 90 if len(rows) > _MOST_UPRIGHT else 0
        grid[-1].set_xticks(range(len(rows)), [row.name for row in rows], rotation=turned, fontsize="small")
    else:
        grid[-1].set_xlabel("plate, in the order of the batch")
    headed(figure, f"Constants of {len(rows)} plates")
    return figure
