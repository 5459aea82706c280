"""Tables of measured modes, long or wide: rows of hits, and one frequency a mode with its scatter.

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
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm, t

from cpam_bayes.plate.instruments import Delimited, Row, SheetError, read_delimited, sheets
from cpam_bayes.plate.schema import MAX_FREQUENCIES
from cpam_bayes.plate.text import Data, Problem, number, read_named_file, received, table

__all__ = [
    "COLUMNS",
    "Hit",
    "ModesTable",
    "TableProblem",
    "modes_of",
    "read_modes_table",
    "small_sample_factor",
    "table_of",
]


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
height: height, peak height, höhe, hauteur, signal to noise, snr
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
    show the mode. sd : Hz, damping : ratio, height : of its peak over what is there beside it, None where not
    given. weight : 0 leaves the row out.
    """

    line: int
    mode: str
    label: str
    hit: str
    hz: float | None
    sd: float | None
    damping: float | None
    weight: float
    height: float | None = None


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
    "height": "a height above 0",
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
        height=values.get("height"),
    )


def _step(table: Delimited, columns: Sequence[tuple[str, str]]) -> float:
    """The step of the last digit that the frequencies are written with, Hz."""
    at = next(i for i, (name, _) in enumerate(columns) if name == "hz")
    parts = [re.split(r"[.,]", row.cells[at]) for row in table.rows if row.cells[at]]
    decimals = max((len(part[1]) for part in parts if len(part) == 2 and part[1].isdigit()), default=0)
    return float(10.0**-decimals * _UNITS["hz"][columns[at][1]])


Array = NDArray[Any]

# Probability below the upper end of an interval of 95 %.
_UPPER: Final = 0.975
# Hits further than this factor from the median of their mode are misread, or of another mode.
_ASTRAY: Final = 1.2
# Damping above this is more than a composite plate has, 0.0005 to 0.03.
_MUCH_DAMPING: Final = 0.05


@dataclass(frozen=True, slots=True)
class TableModes:
    """The modes of a table, ascending.

    frequencies : (n,) Hz, means over hits
    sd : (n,) Hz of a single hit; None where nothing tells it
    labels : "" where there is none
    damping : (n,) ratios, nan where there is none; None where no mode has one
    hits : (n,) that a mode was seen in
    left_out : modes that no row with a weight has, as they are named
    unused : heads of the columns that are not read
    remarks : what may be a slip, a sentence each
    """

    frequencies: Array
    sd: Array | None
    labels: tuple[str, ...]
    damping: Array | None
    hits: Array
    left_out: tuple[str, ...]
    unused: tuple[str, ...]
    remarks: tuple[str, ...]

    def fields(self, name: str) -> dict[str, Any]:
        """The fields of a `Measurement` that the table gives; name : of the table, as in the plate file."""
        return {
            "frequencies": self.frequencies,
            "frequency_sd": self.sd,
            "labels": self.labels,
            "damping": self.damping,
            "origin": f"{name}: {self.origin}",
            "remarks": tuple(f"{name}: {remark}" for remark in self.remarks),
        }

    @property
    def origin(self) -> str:
        """The origin of the frequencies, in words."""
        fewest, most = int(self.hits.min()), int(self.hits.max())
        span = f"{most}" if fewest == most else f"{fewest} to {most}"
        said = ["one hit a mode" if most == 1 else f"means of {span} hits a mode"]
        if self.left_out:
            said.append(f"left out: {', '.join(self.left_out)}")
        if self.unused:
            said.append(f"columns not used: {', '.join(self.unused)}")
        return "; ".join(said)


@dataclass(frozen=True, slots=True)
class _Mode:
    """A mode with its rows; mean, variance : of a single hit, nan for one hit; freedom : of the variance."""

    name: str
    label: str
    rows: tuple[Hit, ...]
    mean: float
    variance: float
    freedom: float
    stated: float


def small_sample_factor(freedom: float) -> float:
    """By what a standard deviation from few hits is enlarged, t_{0.975}(freedom) / 1.96.

    A normal density with the enlarged one has the 95 % interval of Student's t, which is that of a further
    hit when the standard deviation itself is estimated (Gelman et al., Bayesian Data Analysis, section 3.2).
    """
    return float(t.ppf(_UPPER, freedom) / norm.ppf(_UPPER))


def modes_of(
    table: ModesTable, *, complete: bool, least: float = 0.0
) -> tuple[TableModes | None, tuple[TableProblem, ...]]:
    """One frequency a mode with the scatter of its hits, or everything that is wrong.

    The scatter is that of a single hit, as what all hits share is not in it, enlarged by
    `small_sample_factor`; of a mode with one hit it is the relative scatter of all others together. It is no
    less than the rounding of the table, nor than the mean of stated standard deviations, nor than ``least``.

    complete : whether modes that are left out in between are refused
    least : what a standard deviation is at least, as a fraction of the frequency
    """
    groups, problems = _grouped(table)
    problems += [problem for name, rows in groups for problem in _astray(table, name, rows)]
    modes = [_mode(name, rows) for name, rows in groups]
    used = sorted((mode for mode in modes if mode.rows), key=lambda mode: mode.mean)
    if not problems and not used:
        problems.append(TableProblem(0, "", "no frequency with a weight above 0, accepted: at least one"))
    if problems:
        return None, tuple(problems)
    if len(used) > MAX_FREQUENCIES:
        what = f"too many modes, received {len(used)}, accepted: up to {MAX_FREQUENCIES}"
        return None, (TableProblem(0, "", what),)
    gaps = _gaps(table, groups, used) if complete else []
    if gaps:
        return None, tuple(gaps)
    sd = _scatter(used, table.step)
    if sd is not None:
        sd = np.maximum(sd, least * np.array([mode.mean for mode in used]))
    if sd is not None and not np.all(np.isfinite(sd)):
        lines = [mode.rows[0].line for mode, one in zip(used, sd, strict=True) if not np.isfinite(one)]
        what = "missing, accepted: one for each mode, as others have one"
        return None, tuple(TableProblem(line, "sd", what) for line in lines)
    damping = np.array([_mean_damping(mode.rows) for mode in used])
    return TableModes(
        frequencies=np.array([mode.mean for mode in used]),
        sd=sd,
        labels=tuple(mode.label for mode in used),
        damping=None if np.all(np.isnan(damping)) else damping,
        hits=np.array([len(mode.rows) for mode in used]),
        left_out=tuple(mode.name for mode in modes if not mode.rows),
        unused=table.unused,
        remarks=(*_rounded(used, least), *_damped(damping, table.damping_unit)),
    ), ()


def _astray(table: ModesTable, name: str, every: Sequence[Hit]) -> list[TableProblem]:
    """The hit of a mode that is furthest from the others, where it is none of this mode."""
    rows = [row for row in every if row.hz is not None and row.weight > 0.0]
    f = np.array([row.hz for row in rows])
    if len(rows) < 2:
        return []
    away = np.abs(np.log(f / np.median(f)))
    if away.max() <= np.log(_ASTRAY):
        return []
    at = int(np.argmax(away))
    called = f"mode {name}" if "mode" in table.columns else name
    hit = f", hit {rows[at].hit}" if rows[at].hit else ""
    others = ", ".join(f"{value:g}" for value in np.delete(f, at)[:5])
    what = (
        f"{called}{hit}: received {f[at]:g} Hz beside {others} Hz, accepted: hits of one mode, which agree "
        "to 20 %; correct it, or leave it out by a weight of 0"
    )
    return [TableProblem(rows[at].line, "hz", what)]


def _rounded(modes: Sequence[_Mode], least: float) -> tuple[str, ...]:
    """Repeats that are equal to the last digit, and nothing else that tells the scatter."""
    repeated = [mode for mode in modes if mode.freedom > 0.0]
    is_stated = least > 0.0 or any(np.isfinite(mode.stated) for mode in modes)
    if is_stated or not repeated or any(mode.variance > 0.0 for mode in repeated):
        return ()
    return (
        "the hits of each mode are equal to the last digit, so that they show the rounding alone and no "
        "scatter; state relative_std in [measurement], 0.002 for a usual tap test, or write more digits",
    )


def _damped(damping: Array, unit: str) -> tuple[str, ...]:
    """Damping that is more than a plate has: per cent read as ratios, most likely."""
    most = float(np.max(damping, initial=0.0, where=np.isfinite(damping)))
    if most <= _MUCH_DAMPING:
        return ()
    read = f"{100.0 * most:g} % of critical damping"
    if unit != "%":
        read = f"{most:g} is read as a ratio, {read}"
    cure = "; if per cent is meant, the head is damping [%]" if unit in ("", "1", "-") else ""
    return (f"damping up to {read}, where composite plates have 0.05 to 3 %{cure}",)


def _grouped(table: ModesTable) -> tuple[list[tuple[str, tuple[Hit, ...]]], list[TableProblem]]:
    """Rows by mode, or by label where there are no modes, and slips in them."""
    by = "mode" if "mode" in table.columns else "label" if "label" in table.columns else ""
    groups: dict[str, list[Hit]] = {}
    seen: set[tuple[str, object]] = set()
    labels_of: dict[str, set[str]] = {}
    problems = []
    for row in table.hits:
        key = str(getattr(row, by)) if by else ""
        if not key and by and "hit" in table.columns:
            problems.append(TableProblem(row.line, by, f"missing, accepted: the {by} that was hit"))
            continue
        name = key or f"line {row.line}"
        if row.hit and (name, row.hit) in seen:
            problems.append(
                TableProblem(row.line, "hit", f"hit {row.hit} of {by} {key} a second time, accepted: once")
            )
        seen.add((name, row.hit))
        labels = labels_of.setdefault(name, set())
        labels |= {row.label} - {""}
        if len(labels) > 1:
            problems.append(
                TableProblem(row.line, "label", f"{by} {key} has the labels {' and '.join(sorted(labels))}")
            )
        groups.setdefault(name, []).append(row)
    return [(key, tuple(rows)) for key, rows in groups.items()], problems


def _mode(name: str, every: Sequence[Hit]) -> _Mode:
    """Weighted mean and variance of a single hit, with as many degrees of freedom as the weights leave."""
    rows = tuple(row for row in every if row.hz is not None and row.weight > 0.0)
    label = next((row.label for row in every if row.label), "")
    if not rows:
        return _Mode(name, label, (), np.nan, np.nan, 0.0, np.nan)
    f, w = np.array([row.hz for row in rows]), np.array([row.weight for row in rows])
    mean = float(np.average(f, weights=w))
    count = float(w.sum() ** 2 / np.sum(w**2))
    freedom = count - 1.0 if len(rows) > 1 else 0.0
    variance = float(np.average((f - mean) ** 2, weights=w) * count / freedom) if freedom > 0.0 else np.nan
    stated = [row.sd for row in rows if row.sd is not None]
    rms = float(np.sqrt(np.mean(np.square(stated)))) if stated else np.nan
    return _Mode(name, label, rows, mean, variance, freedom, rms)


def _scatter(modes: Sequence[_Mode], step: float) -> Array | None:
    """Standard deviation of a single hit, Hz, nan where nothing tells it; None where nothing tells any."""
    freedom = np.array([mode.freedom for mode in modes])
    mean, variance, stated = (
        np.array([getattr(mode, name) for mode in modes]) for name in ("mean", "variance", "stated")
    )
    repeated = freedom > 0.0
    sd = np.full(len(modes), np.nan)
    for i in np.flatnonzero(repeated):
        sd[i] = np.sqrt(variance[i]) * small_sample_factor(freedom[i])
    if repeated.any():
        whole = float(freedom[repeated].sum())
        relative = np.sqrt(np.sum((freedom * variance / mean**2)[repeated]) / whole)
        alone = ~repeated & np.isnan(stated)
        sd[alone] = relative * mean[alone] * small_sample_factor(whole)
        sd = np.where(np.isnan(sd), np.nan, np.maximum(sd, step / np.sqrt(12.0)))
    sd = np.fmax(sd, stated)
    return None if np.all(np.isnan(sd)) else sd


def _gaps(
    table: ModesTable, groups: Sequence[tuple[str, tuple[Hit, ...]]], used: Sequence[_Mode]
) -> list[TableProblem]:
    """Modes below the last one used that a complete list cannot lack."""
    cure = "accepted: complete = false in [measurement], as the list then lacks a mode"
    highest, seen = used[-1].mean, {mode.name for mode in used}
    problems = []
    for name, rows in groups:
        known = [row.hz for row in rows if row.hz is not None]
        if name not in seen and (not known or float(np.mean(known)) < highest):
            called = f"mode {name}" if "mode" in table.columns else name
            problems.append(TableProblem(rows[0].line, "hz", f"{called} is left out, {cure}"))
    if "mode" in table.columns and all(name.isdecimal() for name, _ in groups):
        numbers = sorted(int(name) for name, _ in groups)
        absent = sorted(set(range(numbers[0], numbers[-1])) - set(numbers))
        if absent:
            listed = ", ".join(map(str, absent[:10]))
            problems.append(TableProblem(0, "mode", f"the numbers lack {listed}, {cure}"))
    return problems


def _mean_damping(rows: Sequence[Hit]) -> float:
    given = [(row.damping, row.weight) for row in rows if row.damping is not None]
    if not given:
        return float("nan")
    ratio, weight = np.array(given).T
    return float(np.average(ratio, weights=weight))


_KEY = ("measurement", "table")


def table_of(data: Data, directory: Path | None) -> tuple[TableModes | None, list[Problem]]:
    """The modes of the table that a plate file names, and what is wrong with it, by line and column.

    directory : where relative paths begin
    """
    measurement = table(data, "measurement")
    name = measurement.get("table")
    if not isinstance(name, str) or not name:
        return None, []
    content, unread = read_named_file(_KEY, name, directory, "a table of modes")
    if content is None:
        return None, unread
    named = {
        column: [heads] if isinstance(heads, str) else heads
        for column, heads in table(data, "measurement", "columns").items()
        if column in COLUMNS and (isinstance(heads, str) or is_texts(heads))
    }
    try:
        read = [read_modes_table(text, named) for text in sheets(content)]
    except SheetError as error:
        return None, [_located(name, TableProblem(0, "", str(error)))]
    # the first sheet with a table of modes
    rows, problems = next((found for found in read if found[0] is not None), read[0])
    modes: TableModes | None = None
    if rows is not None:
        least = max(number(measurement, "relative_std") or 0.0, 0.0)
        modes, problems = modes_of(rows, complete=measurement.get("complete") is not False, least=least)
    return modes, [_located(name, problem) for problem in problems]


def is_texts(value: object) -> bool:
    """Whether a value is a list of texts."""
    return isinstance(value, list) and all(isinstance(item, str) for item in value)


def _located(name: str, problem: TableProblem) -> Problem:
    return Problem(_KEY, f"{Path(name).name} {problem}")
