"""The fourteen tables of the paper in printed digits, read from the package's data.

Known misprints are kept beside the digits. Percentages are checked against the numbers of their own rows.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from itertools import product
from typing import Any, Final, Literal, get_args

Role = Literal["input", "measured", "computed", "identified"]


@dataclass(frozen=True, slots=True)
class Misprint:
    """A definite misprint, and the reason; the printed digits are kept.

    print : what is wrong: the value, the percentage beside it, or only its sign "%".
    """

    print: Literal["value", "percent", "sign"]
    note: str


@dataclass(frozen=True, slots=True)
class PrintedValue:
    """One cell.

    text : as printed.
    percent : the percentage printed beside it, without its sign "%"; empty where there is none.
    misprints : of either.
    """

    text: str
    percent: str = ""
    misprints: tuple[Misprint, ...] = ()

    @property
    def number(self) -> float | None:
        """The value as a number, or None where a text is printed."""
        try:
            return float(self.text)
        except ValueError:
            return None

    @property
    def angles_deg(self) -> tuple[int, ...]:
        """The ply angles of a printed stacking sequence, empty where the cell holds none."""
        inside = self.text.strip("[]") if self.text.startswith("[") and "," in self.text else ""
        return tuple(int(angle) for angle in inside.split(",")) if inside else ()

    def misprinted(self, part: Literal["value", "percent"]) -> bool:
        """Whether the value, or the percentage, is known to be wrong."""
        return any(m.print == part for m in self.misprints)


@dataclass(frozen=True, slots=True)
class PrintedRow:
    """One row of a table.

    part : "a" or "b" of Table 9, empty elsewhere.
    specimen : plate, or material where a table has rows of materials.
    source : of the measurement, computation or identification.
    values : by column; empty cells are left out.
    """

    part: str
    specimen: str
    source: str
    role: Role
    values: Mapping[str, PrintedValue]

    @property
    def level_percent(self) -> float | None:
        """The level of noise of a row of Tables 10 to 14; None for the one without noise, and elsewhere."""
        level, is_noisy, _ = self.source.partition(_DISORDER)
        return float(level) if is_noisy else None


@dataclass(frozen=True, slots=True)
class PrintedTable:
    """One of the fourteen tables; notes : on disagreements in it that are not one cell's misprint."""

    number: int
    title: str
    columns: tuple[str, ...]
    rows: tuple[PrintedRow, ...]
    notes: tuple[str, ...]

    def row(self, specimen: str, source: str, part: str = "") -> PrintedRow:
        """The row of a specimen and a source.

        Raises
        ------
        KeyError
            If the table has no such row.
        """
        for row in self.rows:
            if (row.specimen, row.source, row.part) == (specimen, source, part):
                return row
        raise KeyError(f"Table {self.number}: no row {specimen}, {source}")

    def percent_error(self, column: str, level_percent: float) -> float | None:
        """The percentage printed at a level of noise, or None where there is no such constant or level."""
        for row in self.rows:
            if row.level_percent == level_percent and column in row.values:
                return float(row.values[column].percent)
        return None

    @property
    def misprints(self) -> tuple[tuple[PrintedRow, str, Misprint], ...]:
        """All misprints with their rows and columns, in the order of the rows."""
        return tuple(
            (row, column, misprint)
            for row in self.rows
            for column, value in row.values.items()
            for misprint in value.misprints
        )


NUMBERS: Final = tuple(range(1, 15))
WITHOUT_NOISE: Final = "free disorder"
"""Source of the row of Tables 10 to 14 without added noise."""
_DISORDER: Final = " % disorder"


@cache
def content(number: int) -> Mapping[str, Any]:
    """The content of a table's file."""
    resource = files("cpam_bayes") / "data" / "paper" / f"table_{number}.toml"
    return tomllib.loads(resource.read_text(encoding="utf-8"))


@cache
def printed_table(number: int) -> PrintedTable:
    """One of the fourteen tables, as printed.

    Raises
    ------
    ValueError
        If the paper has no such table.

    Examples
    --------
    >>> from cpam_bayes.printed.tables import printed_table
    >>> printed_table(5).row("D1", "ABAQUS").values["f9_hz"].text
    '1029'
    """
    if number not in NUMBERS:
        raise ValueError(f"table: received {number!r}, accepted: {NUMBERS[0]} to {NUMBERS[-1]}")
    read = content(number)
    rows = read["row"] if "row" in read else tuple(_noise_rows(read))
    columns = tuple(read["columns"] if "columns" in read else _noise_columns(read))
    misprints = read.get("misprint", [])
    return PrintedTable(
        number=read["table"],
        title=read["title"],
        columns=columns,
        rows=tuple(_row(row, columns, misprints) for row in rows),
        notes=tuple(read.get("notes", ())),
    )


def _row(
    row: Mapping[str, Any], columns: Sequence[str], misprints: Sequence[Mapping[str, Any]]
) -> PrintedRow:
    percents = row.get("percents") or [""] * len(row["values"])
    cells = zip(columns[: len(row["values"])], row["values"], percents, strict=True)
    return PrintedRow(
        part=row.get("part", ""),
        specimen=row["specimen"],
        source=row["source"],
        role=row["role"],
        values={
            column: PrintedValue(text, percent, tuple(_misprints_of(row, column, misprints)))
            for column, text, percent in cells
            if text
        },
    )


def _misprints_of(
    row: Mapping[str, Any], column: str, misprints: Sequence[Mapping[str, Any]]
) -> Iterator[Misprint]:
    for misprint in misprints:
        named = ("part", "specimen", "source")
        if misprint["column"] == column and all(
            row.get(key) == misprint[key] for key in named if key in misprint
        ):
            yield Misprint(misprint.get("print", "value"), misprint["note"])


def _noise_columns(read: Mapping[str, Any]) -> list[str]:
    return [*read["constants"], *(["angles_deg"] if "angles_deg" in read else [])]


def _noise_rows(read: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Rows of Tables 10 to 14, whose files are by constant: one without noise, and one per level."""
    common = {"specimen": read["specimen"], "role": "identified"}
    constants, angles = read["constants"].values(), read.get("angles_deg")
    free = [row["free"] for row in constants] + ([str(angles["free"])] if angles else [])
    yield {**common, "source": WITHOUT_NOISE, "values": free}
    for i, level in enumerate(read["levels_percent"]):
        amounts = [row["amount"][i] for row in constants]
        percents = [row["percent_error"][i] for row in constants]
        found = [str(angles["found"][i])] if angles else []
        yield {
            **common,
            "source": f"{level:g}{_DISORDER}",
            "values": amounts + found,
            "percents": percents + [""] * len(found),
        }


PAPER: Final = "CPAM"
"""Source of the rows of the paper's own method."""


@cache
def identified_layups() -> Mapping[str, PrintedValue]:
    """The unknown plies of Table 9(b), outermost first, by specimen."""
    return {row.specimen: row.values["angles_deg"] for row in printed_table(9).rows if row.part == "b"}


Agreement = Literal["follows", "before rounding", "does not follow"]
AGREEMENTS: Final[tuple[Agreement, ...]] = get_args(Agreement)
"""Relations of a percentage to the digits of its row: it follows, may follow before rounding, or does not."""

# Table -> row to which its percentages refer. Table 9 has the row of carbon/epoxy; glass/epoxy is in Table 3.
_REFERENCES: Final = {6: "Reference value [12]", 7: "Reference value [12]", 8: "Reference value [12]"}
_GLASS: Final = ("C3", "C4", "D3", "D4")


@dataclass(frozen=True, slots=True)
class PercentageCheck:
    """One printed percentage, recomputed.

    reference : the number to which it refers, as printed.
    recomputed : from the printed digits, percent.
    lowest, highest : possible before the value and, in Tables 10 to 14, the reference were rounded.
    agreement : "follows" from the digits, rounded or truncated; only "before rounding"; or "does not follow".
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
    # references of Tables 6 to 9 are given numbers, those of Tables 10 to 14 rounded results
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
    """Least and greatest 100 (amount / reference - 1) that the digits allow, with half a unit of rounding."""
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


TABLES: Final = {"A2": 10, "C1": 11, "C3": 12, "D1": 13, "D3": 14}
"""Specimen -> number of its table of constants from frequencies with added noise."""


def perturbation_table(specimen: str) -> PrintedTable | None:
    """The table of a built-in specimen, or None where the paper has none for it."""
    return printed_table(TABLES[specimen]) if specimen in TABLES else None


def contradictions(table: PrintedTable) -> tuple[PercentageCheck, ...]:
    """Printed percentages that their own rows contradict, whatever the rounding.

    Value and reference may each be off by half a unit of their last digit, the percentage by a whole one,
    since some were truncated and not rounded.
    """
    return tuple(check for check in _checks(table) if check.agreement == AGREEMENTS[-1])
