"""Tables of spreadsheets and instruments: .csv with any separator, .xlsx, lines above the heads."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import date
from typing import Any, Final

__all__ = ["Delimited", "Row", "SheetError", "decode", "read_delimited", "sheets"]

_SEPARATORS: Final = ("\t", ";", ",", "|", " ")
_DECLARED: Final = "sep="
_COMMENTS: Final = ("#", "%")
# Heads stand in one of the first lines, and these are no longer than this.
_LINES_ABOVE, _LONGEST_HEADS = 1000, 100_000


@dataclass(frozen=True, slots=True)
class Row:
    """One line of a table: its number, from 1, and a cell for each column, "" where it has none."""

    line: int
    cells: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Delimited:
    """A table: its heads, in the line ``line``, and the rows below; separator : between the cells."""

    line: int
    heads: tuple[str, ...]
    rows: tuple[Row, ...]
    separator: str


class SheetError(ValueError):
    """A workbook that cannot be read."""


# Rows and columns of a sheet that are read; more is no list of modes.
_MOST_ROWS: Final = 10_000
_MOST_COLUMNS: Final = 500
_ZIP, _OLD_EXCEL = b"PK\x03\x04", b"\xd0\xcf\x11\xe0"


def sheets(content: bytes) -> tuple[str, ...]:
    """The texts of the tables of a file: one of .csv, one a sheet of .xlsx, the sheet shown first.

    raises SheetError for a workbook that cannot be read
    """
    if content.startswith(_OLD_EXCEL):
        raise SheetError("an .xls file or one with a password, accepted: .xlsx or .csv")
    if not content.startswith(_ZIP):
        return (decode(content),)
    try:
        import openpyxl  # for workbooks alone
    except ImportError:
        raise SheetError("a workbook, which openpyxl reads: install openpyxl, or save it as .csv") from None
    try:
        book = openpyxl.load_workbook(io.BytesIO(content), read_only=True, data_only=True)
        shown = sorted(book.worksheets, key=lambda sheet: sheet is not book.active)
        found = [
            sheet.iter_rows(max_row=_MOST_ROWS, max_col=_MOST_COLUMNS, values_only=True) for sheet in shown
        ]
        return tuple("\n".join("\t".join(map(_cell, row)) for row in rows) for rows in found)
    except Exception:  # noqa: BLE001 - openpyxl and zipfile raise many kinds for what is no workbook
        raise SheetError("no workbook that can be read, accepted: .xlsx or .csv") from None


def _cell(value: Any) -> str:
    """The text of a cell of a sheet; numbers without the rounding of a computed one."""
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.12g}" if math.isfinite(value) else ""
    text = value.isoformat() if isinstance(value, date) else str(value)
    return " ".join(text.replace('"', " ").split())


def decode(content: bytes) -> str:
    """The text of a file that a spreadsheet saved: UTF-8, UTF-16 with its mark, or Windows-1252."""
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        return content.decode("utf-16", errors="replace")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("cp1252", errors="replace")


def read_delimited(text: str, is_header: Callable[[Sequence[str]], bool]) -> Delimited | None:
    """The table of a text from its first line of heads on; None where the first 1000 lines have none.

    Empty lines and comments (# or %) are passed over, and a line "sep=;" says the separator.

    is_header : whether cells are the heads of the table that is looked for
    """
    lines = text.splitlines()
    separators: tuple[str, ...] = _SEPARATORS
    for i, line in enumerate(lines[:_LINES_ABOVE]):
        if len(line) > _LONGEST_HEADS:
            continue
        if line.strip().casefold().startswith(_DECLARED) and len(line.strip()) > len(_DECLARED):
            separators = (line.strip()[len(_DECLARED)],)
            continue
        for separator in separators:
            heads = _cells(line, separator)
            if is_header(heads):
                rows = tuple(_rows(lines, i + 1, separator, len(heads)))
                return Delimited(i + 1, tuple(heads), rows, separator)
    return None


def _rows(lines: Sequence[str], first: int, separator: str, n_columns: int) -> Iterator[Row]:
    for at, line in enumerate(lines[first:], start=first + 1):
        if not line:
            continue
        cells = _cells(line, separator)
        if not any(cells) or line.lstrip().startswith(_COMMENTS):
            continue
        yield Row(at, (*cells, *[""] * (n_columns - len(cells))))


def _cells(line: str, separator: str) -> list[str]:
    # spaces at the ends of a line separate nothing, tabs there are empty cells
    stripped = line.strip(" \r\n")
    try:
        split = next(csv.reader([stripped], delimiter=separator, skipinitialspace=True), [])
    except csv.Error:  # a line without an end to its quotes or cells
        return []
    cells = [cell.strip() for cell in split]
    while cells and not cells[-1]:
        cells.pop()
    return cells
