"""Printed percentages beside the ones that follow from the numbers of their own rows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import Final, Literal

from cpam_bayes.paper.records import PrintedRow, PrintedTable, PrintedValue
from cpam_bayes.paper.tables import WITHOUT_NOISE, printed_table

__all__ = ["PercentageCheck", "last_digit", "percentage_checks", "possible_percent"]

Agreement = Literal["follows", "before rounding", "does not follow"]

# Table -> row that its percentages refer to. Table 9 has the row of carbon/epoxy; glass/epoxy stands in
# Table 3.
_REFERENCES: Final = {6: "Reference value [12]", 7: "Reference value [12]", 8: "Reference value [12]"}
_GLASS: Final = ("C3", "C4", "D3", "D4")


@dataclass(frozen=True, slots=True)
class PercentageCheck:
    """One printed percentage, recomputed.

    reference : what it refers to, as printed.
    recomputed : from the digits of the print, percent.
    lowest, highest : that the value and, in Tables 10 to 14, the reference allow before they were rounded.
    agreement : "follows" from the digits, rounded or cut off; only "before rounding"; or "does not follow".
    """

    table: int
    row: PrintedRow
    column: str
    printed: str
    reference: str
    recomputed: float
    lowest: float
    highest: float
    agreement: Agreement


def percentage_checks(number: int) -> tuple[PercentageCheck, ...]:
    """All percentages of a table, recomputed; empty where it prints none."""
    return tuple(_checks(printed_table(number)))


def _checks(table: PrintedTable) -> Iterator[PercentageCheck]:
    for row in table.rows:
        for column, value in row.values.items():
            reference = _reference(table, row, column) if value.percent else None
            if reference is not None:
                yield _check(table.number, row, column, value, reference)


def _check(
    number: int, row: PrintedRow, column: str, value: PrintedValue, reference: PrintedValue
) -> PercentageCheck:
    # references of Tables 6 to 9 are given numbers, those of Tables 10 to 14 are results that were rounded
    lowest, highest = possible_percent(value.text, reference.text, exact_reference=number < 10)
    recomputed = 100.0 * (float(value.text) / float(reference.text) - 1.0)
    printed, unit = float(value.percent), last_digit(value.percent)
    agreement: Agreement = "does not follow"
    if abs(printed - recomputed) < unit * (1.0 + 1e-9):
        agreement = "follows"
    elif lowest - unit <= printed <= highest + unit:
        agreement = "before rounding"
    return PercentageCheck(
        number, row, column, value.percent, reference.text, recomputed, lowest, highest, agreement
    )


def possible_percent(amount: str, reference: str, *, exact_reference: bool) -> tuple[float, float]:
    """Least and greatest 100 (amount / reference - 1) that the digits allow, each half a unit off."""
    amounts = _interval(amount)
    references = (float(reference),) if exact_reference else _interval(reference)
    possible = [100.0 * (a / r - 1.0) for a, r in product(amounts, references)]
    return min(possible), max(possible)


def last_digit(text: str) -> float:
    """One unit of the last digit printed."""
    return float(10.0 ** -len(text.partition(".")[2]))


def _interval(text: str) -> tuple[float, float]:
    half = last_digit(text) / 2
    return float(text) - half, float(text) + half


def _reference(table: PrintedTable, row: PrintedRow, column: str) -> PrintedValue | None:
    if table.number in _REFERENCES:
        rows = [r for r in table.rows if r.source == _REFERENCES[table.number]]
    elif table.number == 9 and row.specimen in _GLASS:
        rows = [r for r in printed_table(3).rows if r.specimen == "glass/epoxy"]
    elif table.number == 9:
        rows = [r for r in table.rows if r.role == "input"]
    else:
        rows = [r for r in table.rows if r.source == WITHOUT_NOISE]
    return rows[0].values.get(column)
