"""The fourteen tables of the paper, read from the package's data."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from importlib.resources import files
from typing import Any, Final

from cpam_bayes.paper.records import Misprint, PrintedRow, PrintedTable, PrintedValue

__all__ = ["NUMBERS", "WITHOUT_NOISE", "content", "printed_table"]

NUMBERS: Final = tuple(range(1, 15))
WITHOUT_NOISE: Final = "free disorder"
"""Source of the row of Tables 10 to 14 that no noise was added for."""


@cache
def content(number: int) -> Mapping[str, Any]:
    """The file of a table as it stands."""
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
    >>> from cpam_bayes.paper import printed_table
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
    """Tables 10 to 14, whose files are by constant: one row without noise, and one a level."""
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
            "source": f"{level:g} % disorder",
            "values": amounts + found,
            "percents": percents + [""] * len(found),
        }
