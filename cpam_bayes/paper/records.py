"""A printed table, in the digits of the print, and the misprints that are known of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

__all__ = ["Misprint", "PrintedRow", "PrintedTable", "PrintedValue", "Role"]

Role = Literal["input", "measured", "computed", "identified"]


@dataclass(frozen=True, slots=True)
class Misprint:
    """What is certainly wrong in the print, and why; the printed digits stay as they are.

    print : the value that cannot be right, the percentage beside it, or only its sign "%".
    """

    print: Literal["value", "percent", "sign"]
    note: str


@dataclass(frozen=True, slots=True)
class PrintedValue:
    """One cell.

    text : as printed.
    percent : the percentage printed beside it, without its sign "%"; empty where there is none.
    misprints : what is wrong of either.
    """

    text: str
    percent: str = ""
    misprints: tuple[Misprint, ...] = ()

    @property
    def number(self) -> float | None:
        """The value, or None where a text is printed."""
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
    source : who measured, computed or identified.
    values : by column; columns that are empty in this row are left out.
    """

    part: str
    specimen: str
    source: str
    role: Role
    values: Mapping[str, PrintedValue]


@dataclass(frozen=True, slots=True)
class PrintedTable:
    """One of the fourteen tables; notes : what does not agree in it without being one cell's misprint."""

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

    @property
    def misprints(self) -> tuple[tuple[PrintedRow, str, Misprint], ...]:
        """All misprints with their rows and columns, in the order of the rows."""
        return tuple(
            (row, column, misprint)
            for row in self.rows
            for column, value in row.values.items()
            for misprint in value.misprints
        )
