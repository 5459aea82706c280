"""What the rows come to: verdicts by table, the audit of the print, the largest disagreements in words."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Final

from cpam_bayes.comparison.records import (
    AGREES,
    INPUT,
    NOT_REPRODUCIBLE,
    WITHIN,
    Misfit,
    PaperResult,
    Row,
    kind_of,
)
from cpam_bayes.formatting import significant
from cpam_bayes.paper import PrintedTable, percentage_checks, printed_table
from cpam_bayes.paper.layups import PAPER

__all__ = [
    "KINDS",
    "computed_rows",
    "disagreements",
    "means_of_ten",
    "notes",
    "percentage_counts",
    "verdict_counts",
]

KINDS: Final = (AGREES, WITHIN, NOT_REPRODUCIBLE, INPUT)
# Inversions behind a printed mean.
_GROUPS: Final = 10
_AGREEMENTS: Final = ("follows", "before rounding", "does not follow")


def verdict_counts(rows: Sequence[Row], table: int) -> dict[str, int]:
    """Verdict -> how many rows of a table have it."""
    computed = [kind_of(row.verdict) for row in rows if row.table == table]
    return {kind: computed.count(kind) for kind in KINDS}


def percentage_counts(table: int) -> dict[str, int]:
    """How many of a table's percentages follow from their rows, could before rounding, or do not."""
    computed = [check.agreement for check in percentage_checks(table)]
    return {kind: computed.count(kind) for kind in _AGREEMENTS}


def notes(result: PaperResult) -> tuple[str, ...]:
    """Misprints and what else contradicts itself in the tables, in sentences."""
    return tuple(note for number in result.numbers for note in _notes(printed_table(number)))


def _notes(table: PrintedTable) -> Iterator[str]:
    for row, column, misprint in table.misprints:
        where = ", ".join(part for part in (row.specimen, row.source, column) if part)
        cell = row.values[column]
        said = cell.text if misprint.print == "value" else f"{cell.percent} %"
        yield f"Table {table.number}, {where}, printed {said}: {misprint.note}"
    yield from (f"Table {table.number}: {note}" for note in table.notes)


def computed_rows(rows: Sequence[Row], table: int) -> tuple[Row, ...]:
    """Rows of a table that are no inputs."""
    return tuple(row for row in rows if row.table == table and row.verdict != INPUT)


def means_of_ten(result: PaperResult) -> str:
    """What the printed means of ten inversions can show, in Tables 10 to 14, and what they cannot."""
    noisy: dict[tuple[int, str], list[Row]] = {}
    for row in result.rows:
        if "printed_percent" in row.details:
            noisy.setdefault((row.table, row.quantity), []).append(row)
    rows = [row for series in noisy.values() for row in series]
    if not rows:
        return ""
    hidden = sum(abs(row.details["printed_percent"] or 0.0) < _standard_error_percent(row) for row in rows)
    printed, ours = (
        sum(_grows([row.details[key] or 0.0 for row in series]) for series in noisy.values())
        for key in ("printed_percent", "our_percent")
    )
    return (
        "Noise is eq. (12) as a level times the root mean square frequency, one standard deviation for all "
        "modes, added to the measured list; the layup is known here, and was sought with the constants in "
        f"the paper. {hidden} of {len(rows)} printed changes are smaller than one standard error of a mean "
        "of ten inversions as repeated here: such a mean cannot show them. "
        f"For {printed} of {len(noisy)} constants the printed change keeps its sign and grows from 1 to 5 to "
        f"10 %; for ours, of independent noise at each level, that is so for {ours}. A mean shows the bias "
        "of the inversion, not the spread of the constants, which the posterior interval is."
    )


def _standard_error_percent(row: Row) -> float:
    """Standard error of a mean of ten in percent of our mean."""
    mean = row.ours if isinstance(row.ours, float) else math.nan
    return 100.0 * (row.details["repetition_sd"] or 0.0) / math.sqrt(_GROUPS) / abs(mean)


def _grows(changes: Sequence[float]) -> bool:
    same_sign = all(change * changes[0] > 0.0 for change in changes)
    return same_sign and all(abs(a) < abs(b) for a, b in pairwise(changes))


def disagreements(result: PaperResult) -> tuple[str, ...]:
    """The most important disagreements in plain words, as far as their tables were computed."""
    return tuple(
        text
        for text in (
            _frequencies(result.rows),
            _own_misfit(result.misfits) if 9 in result.numbers else "",
            _determined(result.rows),
        )
        if text
    )


def _frequencies(rows: Sequence[Row]) -> str:
    """The plate of Table 5 whose printed frequencies are furthest from the converged ones."""
    off: dict[str, list[Row]] = {}
    for row in rows:
        if row.table == 5 and row.difference_percent is not None and abs(row.difference_percent) < 50.0:
            off.setdefault(row.specimen, []).append(row)
    if not off:
        return ""
    name = max(off, key=lambda n: sum(abs(r.difference_percent or 0.0) for r in off[n]) / len(off[n]))
    differences = [row.difference_percent or 0.0 for row in off[name]]
    measured = printed_table(4).row(name, "modal test").values
    beside = [100.0 * (float(r.printed) / float(measured[r.quantity].text) - 1.0) for r in off[name]]
    solvers = [[v for v in row.details.values() if v is not None] for row in off[name]]
    apart = max(100.0 * (max(v) / min(v) - 1.0) for v in solvers)
    return (
        f"Table 5, {name}: the ABAQUS frequencies are {min(differences):+.1f} to {max(differences):+.1f} % "
        f"off what {len(solvers[0])} converged solvers, {apart:.2g} % apart at most, give for the printed "
        f"plate and constants. They are within {max(abs(b) for b in beside):.1f} % of the measured list of "
        "Table 4, which the printed plate does not have."
    )


def _own_misfit(misfits: Sequence[Misfit]) -> str:
    """The specimens of Table 9 whose printed constants miss their own frequencies."""
    identified = [m for m in misfits if m.table == 9 and m.source == PAPER]
    if not identified:
        return ""
    worst = max(identified, key=lambda m: m.rms_percent)
    far = sorted(m.specimen for m in identified if m.rms_percent > 5.0)
    ten = sum(m.objective > 10.0 * m.our_objective for m in identified)
    listed = f"above 5 % for {', '.join(far)}" if far else "below 5 % for all"
    return (
        "Table 9(a): the constants that the paper identified miss their own frequencies: rms "
        f"{listed}, worst {worst.rms_percent:.3g} % for {worst.specimen}, where the best fit within the "
        f"bounds leaves {worst.our_rms_percent:.3g} %. Their F, eq. (7), is more than ten times the least "
        f"one for {ten} of {len(identified)} plates."
    )


def _determined(rows: Sequence[Row]) -> str:
    """Printed digits that the frequencies do not determine: constants and stacking sequences."""
    identified = [r for r in rows if r.table == 9 and r.part == "a" and r.source == PAPER]
    wide = [r for r in identified if r.q025 and r.q975 and r.q975 > 1.5 * r.q025]
    layups = [r for r in rows if r.table == 9 and r.part == "b"]
    if not identified or not layups:
        return ""
    widest = max(identified, key=lambda r: (r.q975 or 0.0) / (r.q025 or 1.0))
    counts = sorted(int(r.details["credible_95_count"] or 0) for r in layups)
    outside = [r.specimen for r in layups if r.verdict != WITHIN]
    return (
        f"Table 9: the lists determine less than is printed. {len(wide)} of {len(identified)} printed "
        f"constants have a 95 % interval whose ends are a factor of 1.5 or more apart; {widest.quantity} of "
        f"{widest.specimen}, printed {widest.printed}, has {significant(widest.q025 or 0.0, 3)} to "
        f"{significant(widest.q975 or 0.0, 3)}. {counts[0]} to {counts[-1]} stacking sequences on the grid "
        f"are in the 95 % sets, and the printed ones of {', '.join(outside) or 'no plate'} are outside or at "
        "the edge."
    )
