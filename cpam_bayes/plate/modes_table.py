"""Tables of measured modes, long or wide, as rows: a frequency of a mode in a hit.

Tables are as instruments and spreadsheets write them: any separator, decimal points or commas, lines above
the heads. What is wrong is said by line and column.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

from cpam_bayes.plate.problems import received
from cpam_bayes.plate.spreadsheet import Delimited, Row, read_delimited

__all__ = ["COLUMNS", "Hit", "ModesTable", "TableProblem", "read_modes_table"]

_HEADS: Final = """
mode: mode, mode number, mode no, no, nr, #, modus, eigenmode, eigenform, moden, ordnung, ordre, modo, n°
label: label, mode label, bezeichnung
hz: hz, frequency, freq, natural frequency, natural freq, eigenfrequency, resonance frequency, f, fn, frequenz
hz: eigenfrequenz, resonanzfrequenz, fréquence, frequence, fréquence propre, frecuencia, frecuencia natural
hz: frequenza, frequenza propria, frequência, frequentie, częstotliwość, частота, 频率, 周波数
hit: hit, repeat, tap, run, trial, impact, measurement, schlag, messung, anschlag, versuch, coup, essai
hit: mesure, golpe, ensayo, medición, colpo, prova, misura, slag, meting
sd: sd, std, std dev, stdev, standard deviation, standardabweichung, stabw, écart-type, ecart-type, ecart type
damping: damping, damping ratio, zeta, dämpfung, dämpfungsgrad, amortissement, smorzamento
weight: weight, gewicht, poids
"""
_LINES: Final = [line.partition(": ") for line in _HEADS.strip().splitlines()]
COLUMNS: Final[Mapping[str, tuple[str, ...]]] = {
    name: tuple(head for other, _, heads in _LINES if other == name for head in heads.split(", "))
    for name in dict.fromkeys(name for name, _, _ in _LINES)
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


def read_modes_table(
    text: str, named: Mapping[str, Sequence[str]] | None = None
) -> tuple[ModesTable | None, tuple[TableProblem, ...]]:
    """The rows of a table of modes, or everything that is wrong with it.

    A long table has a column of frequencies. A wide one has a row a hit and a column a mode, or a row a mode
    and a column a hit; it is read as the long one with the same cells.

    named : column -> its heads in this table, where they are not what `COLUMNS` has
    """
    given = {head.casefold(): name for name, heads in (named or {}).items() for head in heads}

    def columns_of(heads: Sequence[str], *, guess: bool = True) -> list[tuple[str, str]]:
        """The columns of a line of heads; guess : one alone in Hz that is not known has the frequencies."""
        found = [(given[h.casefold()], _split(h)[1]) if h.casefold() in given else _column(h) for h in heads]
        # a head with a separator is a line that another one divides, one with digits a line above
        in_hz = [i for i, h in enumerate(heads) if _IN_HZ.fullmatch(h)]
        if guess and len(in_hz) == 1 and not any(name == "hz" for name, _ in found):
            found[in_hz[0]] = ("hz", _split(heads[in_hz[0]])[1])
        return found

    def is_header(heads: Sequence[str], *, guess: bool = False) -> bool:
        if given:
            return bool({h.casefold() for h in heads} & given.keys())
        in_hz = any(name == "hz" for name, _ in columns_of(heads, guess=guess))
        return _wide(heads) is not None or (in_hz and not any(map(_NUMBER.fullmatch, heads)))

    found = read_delimited(text, is_header) or read_delimited(text, partial(is_header, guess=True))
    if found is None:
        accepted = "a line of heads with a column hz, and mode or label; or a row a hit and a column a mode"
        if given:
            accepted = "heads that are in the table"
            return None, (TableProblem(0, "", f"no head of [measurement.columns], {accepted}"),)
        cure = '; name it in [measurement.columns]: hz = "HEAD"'
        return None, (TableProblem(0, "", f"no column of frequencies, accepted: {accepted}{cure}"),)
    found = _with_units(found)
    columns = columns_of(found.heads)
    several = [i for i, (name, _) in enumerate(columns) if name == "hz"] if given else []
    across = several if len(several) > 1 else None
    if across is None and not any(name == "hz" for name, _ in columns):
        across = _wide(found.heads)
    heads = {head.casefold() for head in found.heads}
    absent = [h for named_heads in (named or {}).values() for h in named_heads if h.casefold() not in heads]
    accepted = f"no such head, accepted: {', '.join(found.heads[:20])}"
    problems = [TableProblem(found.line, head, accepted) for head in absent]
    if across is not None:
        found, unequal = _long(found, across)
        if unequal is not None:
            return None, (unequal,)
        columns = [_column(head) for head in found.heads]
    problems += [*_of_heads(found, columns), *_of_cells(found, columns)]
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


_IN_HZ: Final = re.compile(r"[^\d;,|\t\[(]+[\[(/ ]+k?hz[\])]?", re.IGNORECASE)
# A column a mode: 1, mode 1, f1, f_1; a label of nodal lines; a column a hit: hit 1.
_NUMBERED: Final = re.compile(r"(.*?)[ _.#]*([0-9]{1,3})\.?")
_LABEL: Final = re.compile(r"\(\d+ ?[,;] ?\d+\)")
# What a cell has where a hit does not show a mode, and rows that sum up those above.
_NOT_SEEN: Final = ("-", "\N{EN DASH}", "n/a", "na", "nan", "#n/a", "#nv", "x", "?")
_SUMMARY: Final = re.compile(
    r"(mean|average|avg|mittel|moyenne|media|promedio|std|sd|stdev|stabw|standard|[ée]cart|min|max|median|cov)\b.*|"
    r"mittelwert.*|standardabweichung.*|s\.?d\.?|\N{GREEK SMALL LETTER SIGMA}"
)


def _wide(heads: Sequence[str]) -> list[int] | None:
    """The columns with a frequency each, of modes or of hits; None where the heads are of no wide table."""
    texts = [_split(head)[0] for head in heads]
    labelled = [i for i, text in enumerate(texts) if _LABEL.fullmatch(text)]
    if len(labelled) > 1:
        return labelled
    series: dict[str, list[tuple[int, int]]] = {}
    for i, text in enumerate(texts):
        match = _NUMBERED.fullmatch(text)
        if match is not None:
            series.setdefault(match[1], []).append((i, int(match[2])))
    for stem, found in series.items():
        known = stem == "" or _KNOWN.get(stem) in ("mode", "hz", "hit")
        if known and len(found) > 1 and [number for _, number in found] == list(range(1, len(found) + 1)):
            return [i for i, _ in found]
    return None


def _long(table: Delimited, across: Sequence[int]) -> tuple[Delimited, TableProblem | None]:
    """A wide table as a long one, and what cannot be; across : the columns with frequencies."""
    texts = [_split(head) for head in table.heads]
    units = {texts[i][1] for i in across} - {""}
    if len(units) > 1:
        what = f"units {' and '.join(sorted(units))} beside each other, accepted: one of all modes"
        return table, TableProblem(table.line, "", what)
    stem = _NUMBERED.fullmatch(texts[across[0]][0])
    by_hit = stem is not None and _KNOWN.get(stem[1]) == "hit"
    kinds = [_column(head)[0] for head in table.heads]
    key = next(
        (i for i, kind in enumerate(kinds) if i not in across and (kind in ("hit", "mode", "label"))), None
    )
    labelled = stem is None
    rows = []
    for count, row in enumerate(table.rows, 1):
        beside = [cell for i, cell in enumerate(row.cells[: len(kinds)]) if i not in across]
        if any(_SUMMARY.fullmatch(cell.casefold()) for cell in beside):
            continue
        if len(row.cells) > len(kinds):
            rows.append(row)  # refused with its line
            continue
        own = row.cells[key] if key is not None and row.cells[key] else str(count)
        for at, i in enumerate(across, 1):
            cell = "" if row.cells[i].casefold() in _NOT_SEEN else row.cells[i]
            other = table.heads[i] if labelled else str(at)
            rows.append(Row(row.line, (own, other, cell) if by_hit else (other, own, cell)))
    hz = f"hz [{units.pop()}]" if units else "hz"
    first = (
        "label"
        if (labelled and not by_hit) or (by_hit and key is not None and kinds[key] == "label")
        else "mode"
    )
    return replace(table, heads=(first, "hit", hz), rows=tuple(rows)), None


def _with_units(table: Delimited) -> Delimited:
    """The table with the units of a line below the heads in these."""
    if not table.rows:
        return table
    units = [cell.casefold().strip("[]() ") for cell in table.rows[0].cells]
    if not {"hz", "khz"} & set(units) or any(unit not in ("", "hz", "khz", "%", "-", "1") for unit in units):
        return table
    heads = tuple(f"{h} [{u}]" if u else h for h, u in zip(table.heads, units, strict=False))
    return replace(table, heads=heads, rows=table.rows[1:])


def _split(head: str) -> tuple[str, str]:
    """The text of a head and its unit, "" for none, in lower case."""
    text = head.casefold().replace("ζ", "zeta")
    text = text.lstrip("#% ") or text  # heads that begin as a comment
    if _LABEL.fullmatch(text):
        return text, ""
    bracketed = _BRACKETS.match(text)
    text, unit = (bracketed[1], bracketed[2]) if bracketed else (text, "")
    text = " ".join(re.split(r"[\s_.]+", text)).strip()
    name, _, last = text.replace("/", " ").replace(",", " ").rpartition(" ")
    if not unit and last in ("hz", "khz", "%") and name:
        return name.strip().removesuffix(" in"), last
    return text, unit


def _column(head: str) -> tuple[str, str]:
    """The column that a head names, "" for none that is known, and its unit in lower case."""
    text, unit = _split(head)
    return (_KNOWN[text], unit) if text in _KNOWN else ("", "")


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
    """The problem with a cell, "" for none."""
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
