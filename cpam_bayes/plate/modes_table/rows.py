"""A table of measured modes: its columns, its numbers, and what is wrong with it, by line and column."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from cpam_bayes.plate.modes_table.delimited import Delimited, Row, read_delimited
from cpam_bayes.plate.problems import received

__all__ = ["COLUMNS", "Hit", "ModesTable", "TableProblem", "read_modes_table"]

COLUMNS: Final[Mapping[str, tuple[str, ...]]] = {
    "mode": ("mode", "mode number", "mode no", "no", "nr", "#"),
    "label": ("label", "mode label"),
    "hz": ("hz", "frequency", "freq", "natural frequency", "f", "fn"),
    "hit": ("hit", "repeat"),
    "sd": ("sd", "std", "standard deviation"),
    "damping": ("damping", "damping ratio", "zeta"),
    "weight": ("weight",),
}
"""The columns that are read, each with the heads that it is known by."""

# Units in brackets or at the end of a head, and their factor from the unit of the column.
_UNITS: Final[Mapping[str, Mapping[str, float]]] = {
    "hz": {"": 1.0, "hz": 1.0, "khz": 1e3},
    "sd": {"": 1.0, "hz": 1.0, "khz": 1e3},
    "damping": {"": 1.0, "-": 1.0, "1": 1.0, "%": 0.01},
}
_BRACKETS: Final = re.compile(r"^(.*?)\s*[\[(]\s*(.*?)\s*[\])]$")
_KNOWN: Final = {head: name for name, heads in COLUMNS.items() for head in heads}
_NUMBER: Final = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?")
_MOST_PROBLEMS: Final = 100
_LONGEST: Final = 200


@dataclass(frozen=True, slots=True)
class TableProblem:
    """One thing that is wrong with a table: the line, 0 for the whole, the column, "" for all, and what."""

    line: int
    column: str
    what: str

    def __str__(self) -> str:
        """The place and the phrase that says it all."""
        place = [f"line {self.line}"] if self.line else []
        place += [f"column {self.column}"] if self.column else []
        return f"{', '.join(place)}: {self.what}" if place else self.what


@dataclass(frozen=True, slots=True)
class Hit:
    """One row: a frequency of a mode in one hit.

    line : in the file. mode, label, hit : as written, "" where not given. hz : None where the hit does not
    show the mode. sd : Hz, damping : ratio, both None where not given. weight : 0 leaves the row out.
    """

    line: int
    mode: str
    label: str
    hit: str
    hz: float | None
    sd: float | None
    damping: float | None
    weight: float


@dataclass(frozen=True, slots=True)
class ModesTable:
    """The rows of a table.

    unused : heads of the columns that are not read. step : of the last digit, Hz. damping_unit : of its head,
    "" where there is none.
    """

    hits: tuple[Hit, ...]
    columns: tuple[str, ...]
    unused: tuple[str, ...]
    step: float
    damping_unit: str = ""


def read_modes_table(text: str) -> tuple[ModesTable | None, tuple[TableProblem, ...]]:
    """The rows of a table of modes, or everything that is wrong with it."""
    found = read_delimited(text, lambda heads: any(_column(head)[0] == "hz" for head in heads))
    if found is None:
        accepted = "a line of heads with a column hz, and mode or label"
        return None, (TableProblem(0, "", f"no column of frequencies, accepted: {accepted}"),)
    columns = [_column(head) for head in found.heads]
    problems = [*_of_heads(found, columns), *_of_cells(found, columns)]
    if not problems and not found.rows:
        problems = [TableProblem(found.line, "", "no rows below the heads, accepted: one a mode and hit")]
    if problems:
        return None, tuple(problems[:_MOST_PROBLEMS])
    names = tuple(name for name, _ in columns if name)
    unused = tuple(
        head
        for head, (name, _) in zip(found.heads, columns, strict=True)
        if head.isprintable() and head and not name
    )
    hits = tuple(_hit(row, columns) for row in found.rows)
    unit = dict(columns).get("damping", "")
    return ModesTable(hits, names, unused, _step(found, columns), unit), ()


def _column(head: str) -> tuple[str, str]:
    """The column that a head names, "" for none that is known, and its unit in lower case."""
    text = head.casefold().replace("ζ", "zeta")
    text = text.lstrip("#% ") or text  # heads that begin as a comment
    bracketed = _BRACKETS.match(text)
    text, unit = (bracketed[1], bracketed[2]) if bracketed else (text, "")
    text = " ".join(re.split(r"[\s_.]+", text)).strip()
    if text in _KNOWN:
        return _KNOWN[text], unit
    name, _, last = text.rpartition(" ")
    if not unit and last in ("hz", "khz", "%") and name in _KNOWN:
        return _KNOWN[name], last
    return "", ""


def _of_heads(table: Delimited, columns: Sequence[tuple[str, str]]) -> list[TableProblem]:
    problems = []
    names = [name for name, _ in columns]
    for i, (head, (name, unit)) in enumerate(zip(table.heads, columns, strict=True)):
        if name and name in names[:i]:
            problems.append(TableProblem(table.line, head, f"a second column {name}, accepted: one"))
        if name in _UNITS and unit not in _UNITS[name]:
            accepted = " ".join(u for u in _UNITS[name] if u) or "none"
            problems.append(TableProblem(table.line, head, f"unknown unit {unit}, accepted: {accepted}"))
        near = difflib.get_close_matches(head.casefold(), [h for h in _KNOWN if len(h) > 3], n=1, cutoff=0.8)
        if not name and near:
            problems.append(TableProblem(table.line, head, f"unknown head, the nearest is {near[0]}"))
    if "hit" in names and not {"mode", "label"} & set(names):
        problems.append(
            TableProblem(table.line, "hit", "hits of no mode, accepted: a column mode or label beside it")
        )
    return problems


def _of_cells(table: Delimited, columns: Sequence[tuple[str, str]]) -> list[TableProblem]:
    problems = []
    marks: dict[str, tuple[int, str, str]] = {}  # decimal mark -> where it stands first
    for row in table.rows:
        if len(row.cells) > len(columns):
            many = f"{len(row.cells)} cells for {len(columns)} columns"
            cure = "; decimal commas need another separator, such as ;" if table.separator == "," else ""
            problems.append(TableProblem(row.line, "", f"{many}, accepted: one for each head{cure}"))
            continue
        for cell, head, (name, unit) in zip(row.cells, table.heads, columns, strict=True):
            wrong = _wrong(cell, name, unit)
            if wrong:
                problems.append(TableProblem(row.line, head, wrong))
            elif name in _ACCEPTED:
                for mark in set(cell) & {".", ","}:
                    marks.setdefault(mark, (row.line, head, cell))
    if len(marks) == 2:
        line, head, cell = max(marks.values())
        other = min(marks.values())
        problems.append(
            TableProblem(
                line,
                head,
                f"another decimal mark than in line {other[0]}, received {cell} and {other[2]}, "
                "accepted: one mark in the whole table, none between thousands",
            )
        )
    return problems


_ACCEPTED: Final[Mapping[str, str]] = {
    "hz": "a frequency above 0",
    "sd": "a standard deviation above 0",
    "damping": "a damping ratio of 0 or above and below 1; of values in % the head says [%]",
    "weight": "a number, 0 or above",
}


def _wrong(cell: str, name: str, unit: str) -> str:
    """What is wrong with a cell, "" for nothing."""
    if not (cell.isprintable() and len(cell) <= _LONGEST):
        return f"not a text that can be shown, accepted: up to {_LONGEST} printable characters"
    if name not in _ACCEPTED or not cell:
        return ""
    accepted = _ACCEPTED[name]
    if not _NUMBER.fullmatch(cell):
        return f"not a number, received {received(cell)}, accepted: {accepted}"
    value = _number(cell) * _UNITS.get(name, {}).get(unit, 1.0)
    least_holds = value >= 0.0 if name in ("damping", "weight") else value > 0.0
    if not (least_holds and math.isfinite(value) and (name != "damping" or value < 1.0)):
        return f"out of range, received {cell}, accepted: {accepted}"
    return ""


def _number(cell: str) -> float:
    return float(cell.replace(",", "."))


def _hit(row: Row, columns: Sequence[tuple[str, str]]) -> Hit:
    texts = {"mode": "", "label": "", "hit": ""}
    values: dict[str, float] = {}
    for cell, (name, unit) in zip(row.cells, columns, strict=True):
        if name in texts:
            texts[name] = cell
        elif name and cell:
            values[name] = _number(cell) * _UNITS.get(name, {}).get(unit, 1.0)
    return Hit(
        row.line,
        **texts,
        hz=values.get("hz"),
        sd=values.get("sd"),
        damping=values.get("damping"),
        weight=values.get("weight", 1.0),
    )


def _step(table: Delimited, columns: Sequence[tuple[str, str]]) -> float:
    """The step of the last digit that the frequencies are written with, Hz."""
    at = next(i for i, (name, _) in enumerate(columns) if name == "hz")
    parts = [re.split(r"[.,]", row.cells[at]) for row in table.rows if row.cells[at]]
    decimals = max((len(part[1]) for part in parts if len(part) == 2 and part[1].isdigit()), default=0)
    return float(10.0**-decimals * _UNITS["hz"][columns[at][1]])
