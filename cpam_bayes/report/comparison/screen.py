"""The screen of `paper`."""

from __future__ import annotations

from cpam_bayes.comparison.records import (
    NOT_REPRODUCIBLE,
    Misfit,
    PaperResult,
    Row,
    SimulationError,
    WellPosed,
    kind_of,
)
from cpam_bayes.comparison.summary import computed_rows, notes
from cpam_bayes.formatting import signed, significant
from cpam_bayes.paper import printed_table
from cpam_bayes.report.comparison.captions import figures_of
from cpam_bayes.report.sections import COMPUTATION, Section
from cpam_bayes.report.tables import Table, headed, remarks

__all__ = ["misfit_cells", "row_cells", "sections"]


def sections(result: PaperResult) -> tuple[Section, ...]:
    """The rows, the misfit of the printed constants, the audit of the print."""
    drawn = figures_of(result)
    return (
        Section(
            "Table by table",
            tuple(_rows(result, number) for number in result.numbers),
            tuple(name for name in ("differences", "frequencies") if name in drawn),
            folded=False,
        ),
        Section(
            "Misfit of the printed constants",
            (_misfits(result.misfits),),
            tuple(name for name in ("misfits",) if name in drawn),
        ),
        Section("Is the problem well posed", (_well_posed(result.well_posed),)),
        Section("What the paper's simulation gets wrong", (_simulation(result.simulation_errors),)),
        Section(
            "Audit of the print",
            (remarks("Misprints and contradictions in the print", notes(result)),),
        ),
        Section(COMPUTATION, (_computed(result),)),
    )


def row_cells(row: Row) -> tuple[str, ...]:
    """A row as text: specimen, source, quantity, printed, ours, difference, interval, verdict."""
    interval = ""
    if row.q025 is not None and row.q975 is not None:
        interval = f"{significant(row.q025)} to {significant(row.q975)}"
    return (
        row.specimen,
        row.source,
        row.quantity,
        row.printed,
        _ours(row),
        "" if row.difference_percent is None else signed(row.difference_percent, 1),
        interval,
        row.verdict,
    )


def misfit_cells(m: Misfit) -> tuple[str, ...]:
    """A misfit as text."""
    return (
        str(m.table),
        m.specimen,
        m.case,
        m.source,
        significant(m.objective),
        significant(m.our_objective),
        significant(m.rms_percent, 3),
        significant(m.our_rms_percent, 3),
        f"{m.swarms_found} of {m.swarms}",
        str(m.swarms_converged),
        " ".join(m.on_bounds),
    )


def _ours(row: Row) -> str:
    if row.ours is None:
        return ""
    if isinstance(row.ours, tuple):
        return f"[{', '.join(f'{angle:g}' for angle in row.ours)}]"
    return significant(row.ours, 5 if row.quantity.endswith("_hz") else 4)


def _rows(result: PaperResult, number: int) -> Table:
    rows = computed_rows(result.rows, number)
    columns = headed("specimen", "by", "quantity", "#printed", "#ours", "#%", "95 % interval", "verdict")
    flagged = frozenset(i for i, row in enumerate(rows) if kind_of(row.verdict) == NOT_REPRODUCIBLE)
    title = f"Table {number}: {printed_table(number).title}"
    return Table(title, columns, tuple(row_cells(row) for row in rows), flagged)


def _misfits(misfits: tuple[Misfit, ...]) -> Table:
    columns = headed(
        *("#table", "specimen", "constants", "by", "#F Hz2", "#least F", "#rms %", "#least F's rms %"),
        *("#swarms", "#converged", "on a bound"),
    )
    title = "Printed constants against their own frequencies, and the least F that the swarms found"
    return Table(title, columns, tuple(misfit_cells(m) for m in misfits))


def _well_posed(conditions: tuple[WellPosed, ...]) -> Table:
    columns = headed(
        *("#table", "specimen", "#unknowns", "#left %", "exists", "#rank", "#condition", "#optima"),
        *("#stacking sequences", "% of each constant per % of noise"),
    )
    rows = tuple(
        (
            *(str(c.table), c.specimen, f"{c.unknowns} of {c.frequencies}"),
            "" if c.left_percent is None else significant(c.left_percent, 2),
            {True: "yes", False: "no", None: ""}[c.exists],
            *(str(c.rank), "" if c.condition is None else significant(c.condition, 2), str(c.optima)),
            "" if c.layups is None else str(c.layups),
            "  ".join(
                f"{name.partition('_')[0]} {'-' if value is None else significant(value, 2)}"
                for name, value in c.percent_per_percent.items()
            ),
        )
        for c in conditions
    )
    title = "Does a solution exist, is there one only, is it stable (Hadamard)"
    return Table(title, columns, rows)


def _simulation(errors: tuple[SimulationError, ...]) -> Table:
    columns = headed(
        *("#table", "plate", "#printed rms %", "#plain rms %", "claim", "#probability", "#extended rms %"),
        "#log Bayes factor",
    )
    rows = tuple(
        (
            *(
                str(e.table),
                e.specimen,
                "" if e.printed_rms_percent is None else significant(e.printed_rms_percent, 3),
            ),
            significant(e.plain_rms_percent, 3),
            f"{e.claim}: {', '.join(e.causes)}" if e.causes else e.claim,
            f"{e.probability:.2f}",
            "" if e.extended_rms_percent is None else significant(e.extended_rms_percent, 3),
            "" if e.log_bayes_factor is None else signed(e.log_bayes_factor, 1),
        )
        for e in errors
    )
    return Table("The paper's simulation, diagnosed against the measured frequencies", columns, rows)


def _computed(result: PaperResult) -> Table:
    rows = tuple(
        (task, str(record["version"]), str(record["date"]), f"{float(record['seconds']):.0f}")
        for task, record in result.computed.items()
    )
    return Table("Computations", headed("what", "version", "date", "#s"), rows)
