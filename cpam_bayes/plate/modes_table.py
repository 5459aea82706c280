"""Tables of measured modes, long or wide, as rows of hits.

Tables are as instruments and spreadsheets write them: any separator, decimal points or commas, lines above
the headings. Errors are reported by line and column.
"""

from __future__ import annotations

import difflib
import itertools
import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np

from cpam_bayes.plate.instruments import Delimited, Row, SheetError, delimited, sheets
from cpam_bayes.plate.text import and_more, received

_HEADS: Final = """
mode: mode, mode number, mode no, no, nr, #, modus, eigenmode, eigenform, moden, ordnung, ordre, modo, n°, mod
mode: modennummer, modusnummer, moden-nr, mode nr, mode n°, n° mode, número de modo, numero modo, nummer
label: label, mode label, bezeichnung
hz: hz, frequency, freq, natural frequency, natural freq, eigenfrequency, resonance frequency, f, fn, frequenz
hz: eigenfrequenz, resonanzfrequenz, fréquence, frequence, fréquence propre, frecuencia, frecuencia natural
hz: frequenza, frequenza propria, frequenza naturale, frequência, frequência natural, frequentie, frekans
hz: eigenfrequentie, częstotliwość, częstotliwość własna, frekvens, egenfrekvens, частота, 频率, 周波数
hit: hit, repeat, tap, run, trial, impact, measurement, schlag, messung, anschlag, versuch, coup, essai
hit: mesure, golpe, ensayo, medición, colpo, prova, misura, slag, meting
sd: sd, std, std dev, stdev, standard deviation, standardabweichung, stabw, écart-type, ecart-type, ecart type
damping: damping, damping ratio, zeta, dämpfung, dämpfungsgrad, lehrsche dämpfung, amortissement, smorzamento
damping: amortiguamiento, amortecimento, demping, dämpning, tłumienie
weight: weight, gewicht, poids
height: height, peak height, höhe, hauteur, signal to noise, snr
"""
_LINES: Final = [line.partition(": ") for line in _HEADS.strip().splitlines()]
COLUMNS: Final[Mapping[str, tuple[str, ...]]] = {
    name: tuple(head for other, _, heads in _LINES if other == name for head in heads.split(", "))
    for name in dict.fromkeys(name for name, _, _ in _LINES)
}
"""The columns that are read, each with its known headings."""

# Units in brackets or at the end of a heading, and their factor to the unit of the column.
_UNITS: Final[Mapping[str, Mapping[str, float]]] = {
    "hz": {"": 1.0, "hz": 1.0, "khz": 1e3},
    "sd": {"": 1.0, "hz": 1.0, "khz": 1e3},
    "damping": {"": 1.0, "-": 1.0, "1": 1.0, "%": 0.01},
}
# Headings of the column that names the specimen.
_SPECIMEN: Final = (
    *(
        "plate",
        "panel",
        "specimen",
        "sample",
        "coupon",
        "platte",
        "probe",
        "probekörper",
        "prüfkörper",
        "plaque",
    ),
    *("éprouvette", "échantillon", "placa", "probeta", "piastra", "provino", "plaat", "próbka"),
)
_BRACKETS: Final = re.compile(r"^([^\[(]*?)\s*[\[(]\s*([^\[\]()]*?)\s*[\])]$")
_KNOWN: Final = {head: name for name, heads in COLUMNS.items() for head in heads}
# A number, with thousands separators where these cannot be a decimal mark, and perhaps a unit.
_NUMBER: Final = re.compile(
    r"([+-]?(?:\d{1,3}(?:[ '\u2019]\d{3})+(?:[.,]\d+)?|\d{1,3}(?:\.\d{3})+,\d+|\d{1,3}(?:,\d{3})+\.\d+"
    r"|\d+(?:[.,]\d*)?|[.,]\d+)(?:[eE][+-]?\d+)?) ?(hz|khz|%)?",
    re.IGNORECASE,
)
_BESIDE: Final = re.compile(r"[ \t]*[;\t][ \t]*| +(?!k?hz)", re.IGNORECASE)
# Three digits after a mark, as after a thousands separator.
_THOUSANDS: Final = re.compile(r"[1-9]\d{0,2}[.,]\d{3}")
ASTRAY: Final = 1.2
"""Hits further than this factor from the median of their mode are misread, or of another mode."""
_MOST_PROBLEMS: Final = 100
_LONGEST: Final = 200


@dataclass(frozen=True, slots=True)
class TableProblem:
    """One error of a table: the line, 0 for the whole, the column, "" for all, and what is wrong.

    kind : of an error that is reported once per column, "" for any other
    choices : headings that may be those of the frequencies
    """

    line: int
    column: str
    what: str
    kind: str = ""
    choices: tuple[str, ...] = ()

    def __str__(self) -> str:
        """The place and the phrase."""
        place = [f"line {self.line}"] if self.line else []
        place += [f"column {self.column}"] if self.column else []
        return f"{', '.join(place)}: {self.what}" if place else self.what


@dataclass(frozen=True, slots=True)
class Hit:
    """One row: the frequency of a mode in one hit.

    line : in the file. mode, label, hit : as written, "" where not given. hz : None where the hit does not
    show the mode. sd : Hz, damping : ratio, height : of its peak over the background, None where not given.
    weight : 0 leaves the row out.
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

    unused : headings of the columns that are not read. step : of the last digit, Hz. units : of the headings,
    in lower case, by column, "" where there is none.
    """

    hits: tuple[Hit, ...]
    columns: tuple[str, ...]
    unused: tuple[str, ...]
    step: float
    units: Mapping[str, str]


def read_modes_table(
    text: str, named: Mapping[str, Sequence[str]] | None = None
) -> tuple[ModesTable | None, tuple[TableProblem, ...]]:
    """The rows of a table of modes, or all its errors.

    A long table has a column of frequencies. A wide one has a row per hit and a column per mode, or the
    reverse; it is read as the long one with the same cells.

    named : column -> its headings in this table, where they are not in `COLUMNS`
    """
    given = {head.casefold(): name for name, heads in (named or {}).items() for head in heads}
    is_named = "hz" in given.values()

    def columns_of(heads: Sequence[str], *, guess: bool = True) -> list[tuple[str, str]]:
        """The columns of a line of headings; guess : a single unknown one in Hz has the frequencies."""
        found = [(given[h.casefold()], _split(h)[1]) if h.casefold() in given else _column(h) for h in heads]
        if is_named:
            other = [
                name == "hz" and h.casefold() not in given for h, (name, _) in zip(heads, found, strict=True)
            ]
            found = [("", "") if is_other else c for is_other, c in zip(other, found, strict=True)]
        # a heading with a separator is a line to be split by another, one with digits a line above the table
        in_hz = [i for i, h in enumerate(heads) if _IN_HZ.fullmatch(h)]
        if guess and len(in_hz) == 1 and not any(name == "hz" for name, _ in found):
            found[in_hz[0]] = ("hz", _split(heads[in_hz[0]])[1])
        return found

    def is_header(heads: Sequence[str], *, guess: bool = False) -> bool:
        if given:
            return bool({h.casefold() for h in heads} & given.keys())
        in_hz = any(name == "hz" for name, _ in columns_of(heads, guess=guess))
        return _wide(heads) is not None or (in_hz and not any(map(_NUMBER.fullmatch, heads)))

    known, guessed = (delimited(text, partial(is_header, guess=guess)) for guess in (False, True))
    candidates = list(itertools.islice(itertools.chain(known, guessed), _MOST_HEADS))
    # a line above the headings may share their words, but has no numbers below them
    found = next((one for one in candidates if _has_frequencies(one, columns_of(one.heads))), None)
    found = found or next(iter(candidates), None) or (None if given else _without_heads(text))
    if found is None and given:
        what = "no head of [measurement.columns], accepted: heads that are in the table"
        return None, (TableProblem(0, "", what),)
    if found is None:
        return None, (_without_frequencies(text),)
    found = _turned(_with_units(found))
    columns = columns_of(found.heads)
    is_stated = any("hz" in head.casefold() for head in found.heads)
    several = [i for i, (name, _) in enumerate(columns) if name == "hz"] if given else []
    across = several if len(several) > 1 else None
    if across is None and not any(name == "hz" for name, _ in columns):
        across = _wide(found.heads)
    heads = {head.casefold() for head in found.heads}
    absent = [h for named_heads in (named or {}).values() for h in named_heads if h.casefold() not in heads]
    accepted = f"no such head, accepted: {', '.join(found.heads[:20])}"
    problems = [TableProblem(found.line, head, accepted) for head in absent]
    if across is not None:
        problems += _of_specimens(found, [("hz", "") if i in across else c for i, c in enumerate(columns)])
        found, unequal = _long(found, across)
        if unequal is not None:
            return None, (unequal,)
        columns = [_column(head) for head in found.heads]
    else:
        found = _without_summaries(found, columns)
        problems += _of_specimens(found, columns)
    problems += [*_of_heads(found, columns), *_of_cells(found, columns)]
    if not problems and not any(name == "hz" for name, _ in columns):
        problems = [_without_frequencies(text)]
    if not problems:
        problems = list(_doubts(found, columns, is_stated=is_stated, is_named=is_named))[:1]
    if not problems and not found.rows:
        problems = [TableProblem(found.line, "", "no rows below the heads, accepted: one a mode and hit")]
    if problems:
        return None, once(problems)
    names = tuple(name for name, _ in columns if name)
    unused = tuple(
        head
        for head, (name, _) in zip(found.heads, columns, strict=True)
        if head.isprintable() and head and not name
    )
    hits = tuple(_hit(row, columns) for row in found.rows)
    return ModesTable(hits, names, unused, _step(found, columns), dict(columns)), ()


def _without_heads(text: str) -> Delimited | None:
    """A column of numbers, alone or beside mode numbers, as a table; None for any other text."""
    lines = [(i, line.strip()) for i, line in enumerate(text.splitlines(), 1)]
    rows = tuple(Row(i, tuple(_BESIDE.split(line))) for i, line in lines if line and line[0] not in "#%")
    cells = [row.cells for row in rows]
    counted = [str(i) for i in range(1, len(rows) + 1)]
    if len(rows) < 2 or not all(len(of) == len(cells[0]) and _NUMBER.fullmatch(of[-1]) for of in cells):
        return None
    if len(cells[0]) == 1:
        return Delimited(0, ("frequency",), rows, ";")
    is_counted = len(cells[0]) == 2 and [of[0] for of in cells] == counted
    return Delimited(0, ("mode", "frequency"), rows, ";") if is_counted else None


# How to name the column of the frequencies.
_NAMED: Final = 'name it in [measurement.columns]: hz = "HEAD"'


def _without_frequencies(text: str) -> TableProblem:
    long = "a line of heads above the numbers with a column hz, and mode or label"
    what = f"no column of frequencies, accepted: {long}; or a row a hit and a column a mode; {_NAMED}"
    return TableProblem(0, "", what, choices=_numbered_columns(text))


def _numbered_columns(text: str) -> tuple[str, ...]:
    """The headings above numbers, for a table without a known column of frequencies."""

    def is_header(heads: Sequence[str]) -> bool:
        return len(heads) > 1 and not any(map(_NUMBER.fullmatch, heads))

    for one in itertools.islice(delimited(text, is_header), _MOST_HEADS):
        rows = [row.cells for row in one.rows[:_ROWS_TRIED] if len(row.cells) == len(one.heads)]
        found = tuple(
            head
            for i, head in enumerate(one.heads)
            if head
            and head.isprintable()
            and one.heads.count(head) == 1
            and not _column(head)[0]
            and any(_NUMBER.fullmatch(row[i]) for row in rows)
        )
        if found:
            return found
    return ()


def once(problems: Sequence[TableProblem]) -> tuple[TableProblem, ...]:
    """The problems, with all of one kind in a column merged into one."""
    counts = Counter((p.column, p.kind) for p in problems)
    first = {(p.column, p.kind) if p.kind else (p.column, p): p for p in reversed(problems)}
    kept = [p for p in problems if p in first.values()][:_MOST_PROBLEMS]
    return tuple(
        replace(p, what=p.what + and_more(counts[p.column, p.kind] - 1 if p.kind else 0, "line"))
        for p in kept
    )


def _has_frequencies(table: Delimited, columns: Sequence[tuple[str, str]]) -> bool:
    """Whether a row that fits the headings has a number in a column of frequencies."""
    at = _wide(table.heads) or [i for i, (name, _) in enumerate(columns) if name == "hz"]
    rows = [row.cells for row in table.rows[:_ROWS_TRIED] if len(row.cells) == len(table.heads)]
    return any(_NUMBER.fullmatch(row[i]) for row in rows for i in at)


# No tapped plate has all its frequencies below this, Hz.
_LOW: Final = 10.0
# Most lines tried as headings, and rows below that are checked for each.
_MOST_HEADS: Final = 20
_ROWS_TRIED: Final = 100
_IN_HZ: Final = re.compile(r"[^\d;,|\t\[(]+[\[(/ ]+k?hz[\])]?", re.IGNORECASE)
# A column per mode: 1, mode 1, f1, f_1; a label of nodal lines; a column per hit: hit 1.
_NUMBERED: Final = re.compile(
    r"(?P<stem>.*?)[ _.#]*(?P<n>[0-9]{1,3})\.?|(?P<at>[0-9]{1,3})(?:st|nd|rd|th|er?|[ªº°])? (?P<of>\D+)"
)
_OF: Final = re.compile(r"^(?:of|der|des|du|de|del|do|van|von|di) (?:the )?")
_LABEL: Final = re.compile(r"\(\d+ ?[,;] ?\d+\)")
# Cells where a hit does not show a mode, and names of summary rows.
_NOT_SEEN: Final = ("-", "\N{EN DASH}", "n/a", "na", "nan", "#n/a", "#nv", "x", "?")
_SUMMARY: Final = re.compile(
    r"(mean|average|avg|mittel|moyenne|moy|m[ée]dia|promedio|gemiddelde|średnia|std|sd|stdev|stabw|"
    r"standard|[ée]cart|min|max|median|cov|cv|vk|var|rsd|mw|range|spannweite|sum|summe|total)\b.*|mittelwert.*|"
    r"standardabweichung.*|s\.?d\.?|[σμø]|\N{DIAMETER SIGN}|x̄|x̅"
)


def _wide(heads: Sequence[str]) -> list[int] | None:
    """The columns of frequencies, one per mode or per hit; None where the table is not wide."""
    texts = [_split(head)[0] for head in heads]
    labelled = [i for i, text in enumerate(texts) if _LABEL.fullmatch(text)]
    if len(labelled) > 1:
        return labelled
    series: dict[str, list[tuple[int, int]]] = {}
    for i, text in enumerate(texts):
        numbered = _numbered(text)
        if numbered is not None:
            series.setdefault(numbered[0], []).append((i, numbered[1]))
    for stem, found in series.items():
        known = stem == "" or _KNOWN.get(stem) in ("mode", "hz", "hit")
        numbers = [number for _, number in found]
        # bare numbers may be data; named modes may begin at 7, and have gaps
        counted = numbers == (sorted(set(numbers)) if stem else list(range(1, len(found) + 1)))
        if known and len(found) > 1 and counted:
            return [i for i, _ in found]
    return None


def _numbered(text: str) -> tuple[str, int] | None:
    """The word and the number of a heading such as mode 1, 1st mode, frequency of mode 1, 1; else None."""
    for quantity in COLUMNS["hz"]:
        rest = _OF.sub("", text.removeprefix(f"{quantity} ").removesuffix(f" {quantity}"))
        match = _NUMBERED.fullmatch(rest)
        if rest != text and match and _KNOWN.get(match["of"] or match["stem"]) in ("mode", "hit"):
            break
    else:
        match = _NUMBERED.fullmatch(text)
    if match is None:
        return None
    return (match["of"], int(match["at"])) if match["of"] else (match["stem"], int(match["n"]))


def _turned(table: Delimited) -> Delimited:
    """A table with a column per mode and a row per quantity, transposed; any other unchanged."""
    across = _wide(table.heads)
    rows = [row for row in table.rows if len(row.cells) == len(table.heads)]
    if across is None:
        return table
    names = [" ".join(c for i, c in enumerate(row.cells) if i not in across and c) for row in rows]
    hz = [i for i, name in enumerate(names) if _column(name)[0] == "hz" or _IN_HZ.fullmatch(name)]
    if len(hz) != 1:
        return table
    first = "label" if _LABEL.fullmatch(table.heads[across[0]]) else "mode"
    turned = (Row(rows[hz[0]].line, (table.heads[i], *(row.cells[i] for row in rows))) for i in across)
    return replace(table, heads=(first, *names), rows=tuple(turned))


def _without_summaries(table: Delimited, columns: Sequence[tuple[str, str]]) -> Delimited:
    """The table without rows of means and scatter, known by their first, mode, label or hit column."""
    at = [
        i
        for i, (name, _) in enumerate(columns)
        if name in ("mode", "label", "hit") or (i == 0 and name != "hz")
    ]
    rows = (row for row in table.rows if not any(_SUMMARY.fullmatch(row.cells[i].casefold()) for i in at))
    return replace(table, rows=tuple(rows))


def _long(table: Delimited, across: Sequence[int]) -> tuple[Delimited, TableProblem | None]:
    """A wide table as a long one, and its error, if any; across : the columns with frequencies."""
    texts = [_split(head) for head in table.heads]
    kinds = [_column(head)[0] for head in table.heads]
    key = next(
        (i for i, kind in enumerate(kinds) if i not in across and (kind in ("hit", "mode", "label"))), None
    )
    units = {texts[i][1] for i in across} - {""}
    units |= {_split(row.cells[0])[1] for row in table.rows if 0 not in across} & {"hz", "khz"}
    if len(units) > 1:
        what = f"units {' and '.join(sorted(units))} beside each other, accepted: one of all modes"
        return table, TableProblem(table.line, "", what)
    numbered = [_numbered(texts[i][0]) for i in across]
    stem = "" if numbered[0] is None else numbered[0][0]
    by_hit = _KNOWN.get(stem) == "hit" or (_KNOWN.get(stem) != "mode" and _rows_agree(table, across))
    labelled = numbered[0] is None
    rows = []
    for count, row in enumerate(table.rows, 1):
        beside = [cell for i, cell in enumerate(row.cells[: len(kinds)]) if i not in across]
        if any(_SUMMARY.fullmatch(cell.casefold()) for cell in beside):
            continue
        if len(row.cells) > len(kinds):
            rows.append(row)  # refused with its line
            continue
        own = row.cells[key] if key is not None and row.cells[key] else str(count)
        for i, counted in zip(across, numbered, strict=True):
            other = table.heads[i] if counted is None else str(counted[1])
            rows.append(Row(row.line, (own, other, row.cells[i]) if by_hit else (other, own, row.cells[i])))
    hz = f"hz [{units.pop()}]" if units else "hz"
    first = (
        "label"
        if (labelled and not by_hit) or (by_hit and key is not None and kinds[key] == "label")
        else "mode"
    )
    return replace(table, heads=(first, "hit", hz), rows=tuple(rows)), None


def _rows_agree(table: Delimited, across: Sequence[int]) -> bool:
    """Whether the numbers of each row are hits of one mode, and those of a column are not."""
    cells = [[row.cells[i] for i in across] for row in table.rows if len(row.cells) == len(table.heads)]
    if len(cells) < 2:
        return False
    f = np.array([[_number(c) if _NUMBER.fullmatch(c) else np.nan for c in row] for row in cells])
    f = f[np.isfinite(f).any(axis=1)]
    f = f[:, np.isfinite(f).any(axis=0)]
    if len(f) < 2 or not np.all(f[np.isfinite(f)] > 0.0):
        return False
    in_rows, in_columns = (np.nanmax(f, axis=i) / np.nanmin(f, axis=i) for i in (1, 0))
    return bool(np.all(in_rows < ASTRAY) and np.any(in_columns > ASTRAY))


def _with_units(table: Delimited) -> Delimited:
    """The table with units from a line below the headings moved into these."""
    if not table.rows:
        return table
    units = [cell.casefold().strip("[]() ") for cell in table.rows[0].cells]
    units[0] = units[0] if units[0] in _UNIT_CELLS else ""
    are_units = all(unit in _UNIT_CELLS or not _NUMBER.fullmatch(unit) for unit in units)
    own = [_split(head)[1] for head in table.heads]
    pairs = [{mine, u} & {*_UNIT_CELLS[1:]} for mine, u in zip(own, units, strict=False)]
    differ = any(len(pair) == 2 and pair & {"khz", "%"} for pair in pairs)
    if not {"hz", "khz"} & set(units) or not are_units or differ:
        return table
    heads = tuple(
        f"{h} [{u}]" if u and not mine else h for h, mine, u in zip(table.heads, own, units, strict=False)
    )
    return replace(table, heads=heads, rows=table.rows[1:])


_UNIT_CELLS: Final = ("", "hz", "khz", "%", "-", "1")


def _split(head: str) -> tuple[str, str]:
    """The text of a heading and its unit, "" for none, in lower case."""
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
    """The column that a heading names, "" if unknown, and its unit in lower case."""
    text, unit = _split(head)
    return (_KNOWN[text], unit) if text in _KNOWN else ("", "")


def _of_heads(table: Delimited, columns: Sequence[tuple[str, str]]) -> list[TableProblem]:
    problems = []
    names = [name for name, _ in columns]
    for i, (head, (name, unit)) in enumerate(zip(table.heads, columns, strict=True)):
        if name and name in names[:i] and len(set(names[:i])) == i:  # of two tables side by side one is said
            of_name = tuple(h for h, (n, _) in zip(table.heads, columns, strict=True) if n == name == "hz")
            is_choice = len(set(of_name)) == len(of_name) > 1
            what = f"a second column {name}, accepted: one{f'; {_NAMED}' if is_choice else ''}"
            problems.append(TableProblem(table.line, head, what, choices=of_name if is_choice else ()))
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
            cure = "; decimal commas need another separator, such as ';'" if table.separator == "," else ""
            problems.append(TableProblem(row.line, "", f"{many}, accepted: one for each head{cure}", "many"))
            continue
        for cell, head, (name, unit) in zip(row.cells, table.heads, columns, strict=True):
            wrong = _wrong(cell, name, unit)
            if wrong:
                problems.append(TableProblem(row.line, head, wrong[1], wrong[0]))
            elif name in ("mode", "label", "hit") and table.separator != ";" and ";" in cell:
                accepted = f"the separator of the heads, {table.separator}, below them too"
                what = f"not parted, received {received(cell)}, accepted: {accepted}"
                problems.append(TableProblem(row.line, head, what, "separator"))
            elif name in _ACCEPTED:
                mark = next((c for c in reversed(cell) if c in ".,"), "")
                if mark:
                    marks.setdefault(mark, (row.line, head, cell))
    if len(marks) == 2 and not problems:
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


HEIGHT: Final = "a height above 0, of the peak over what is there beside it; 20 dB are 10"
"""The accepted heights of a peak, in words."""
_ACCEPTED: Final[Mapping[str, str]] = {
    "hz": "a frequency above 0",
    "sd": "a standard deviation above 0",
    "damping": "a damping ratio of 0 or above and below 1; of values in % the head says [%]",
    "weight": "a number, 0 or above",
    "height": HEIGHT,
}


def _wrong(cell: str, name: str, unit: str) -> tuple[str, str] | None:
    """Kind and description of the error of a cell, None where there is none."""
    if not (cell.isprintable() and len(cell) <= _LONGEST):
        return "text", f"not a text that can be shown, accepted: up to {_LONGEST} printable characters"
    if name not in _ACCEPTED or _is_empty(cell):
        return None
    accepted = _ACCEPTED[name]
    match = _NUMBER.fullmatch(cell)
    if not match or (match[2] and match[2].casefold() not in _UNITS.get(name, {})):
        return "number", f"not a number, received {received(cell)}, accepted: {accepted}"
    value = _number(cell, name, unit)
    least_holds = value >= 0.0 if name in ("damping", "weight") else value > 0.0
    if not (least_holds and math.isfinite(value) and (name != "damping" or value < 1.0)):
        return "range", f"out of range, received {cell}, accepted: {accepted}"
    return None


def _is_empty(cell: str) -> bool:
    return not cell or cell.casefold() in _NOT_SEEN


def _number(cell: str, name: str = "", unit: str = "") -> float:
    """The value of a cell in the unit of its column, converted from the unit beside it or in the heading."""
    match = _NUMBER.fullmatch(cell)
    assert match is not None
    *whole, part = re.split("[.,]", re.sub("[ '\u2019]", "", match[1]))
    value = float(f"{''.join(whole)}.{part}" if whole else part)
    return value * _UNITS.get(name, {}).get((match[2] or unit).casefold(), 1.0)


def _doubts(
    table: Delimited, columns: Sequence[tuple[str, str]], *, is_stated: bool, is_named: bool
) -> Iterator[TableProblem]:
    """Likely misreadings of frequencies: thousands, mode numbers, kHz, split decimal commas, widths.

    is_named : whether the plate file names their column
    """
    at = next(i for i, (name, _) in enumerate(columns) if name == "hz")
    rows = [row.cells for row in table.rows if not _is_empty(row.cells[at])]
    cells, unit = [row[at] for row in rows], columns[at][1]
    if not rows:
        return
    here = partial(TableProblem, table.line, table.heads[at])
    f = np.array([_number(cell, "hz", unit) for cell in cells])
    marked = np.array([bool(set(cell) & {".", ","}) for cell in cells])
    as_thousands = all(_THOUSANDS.fullmatch(cell) for cell, mark in zip(cells, marked, strict=True) if mark)
    spans = np.ptp(np.log(f)), np.ptp(np.log(np.where(marked, 1e3 * f, f)))
    if as_thousands and 0 < marked.sum() < len(f) and spans[0] > spans[1]:
        accepted = "accepted: no mark between thousands"
        yield here(f"a decimal mark or one between thousands, received {', '.join(cells[:3])}, {accepted}")
    elif np.array_equal(f, np.arange(1.0, len(f) + 1.0)) and len(f) > 1:
        yield here(
            f"the numbers of modes, received {', '.join(cells[:3])}, accepted: frequencies; swapped heads?"
        )
    elif f.max() < _LOW and (not is_stated or (as_thousands and marked.all() and unit != "khz")):
        accepted = "accepted: a unit in the head, Hz or kHz, and no mark between thousands"
        yield here(f"too low for a plate in Hz, received {', '.join(cells[:3])}, {accepted}")
    # whole numbers beside whole frequencies and nothing after: decimal parts are likelier than counts
    beside = {row[at + 1] for row in rows} if columns[at + 1 :] else set()
    if (
        table.separator == ","
        and len(beside) > 1
        and columns[at + 1][0] in ("", "damping", "sd")
        and all(cell.isdecimal() for cell in (*cells, *beside))
        and max(map(len, beside)) <= 3
        and not any(any(row[at + 2 :]) for row in rows)
    ):
        accepted = f"accepted: ; between cells, or {cells[0]}.0 where frequencies are whole"
        yield here(f"are these decimal commas? received {cells[0]},{rows[0][at + 1]}, two cells; {accepted}")
    if _column(table.heads[at])[0] != "hz" and not is_named:  # taken for its unit, which widths have too
        for i, head in enumerate(table.heads):
            numbers = [row[i] for row in rows if _NUMBER.fullmatch(row[i])]
            larger = len(numbers) == len(rows) and bool(np.all(np.array(list(map(_number, numbers))) > f))
            if larger and not columns[i][0] and not _split(head)[1]:
                cure = f'[measurement.columns] with hz = "{head}", or another head'
                yield here(f"the frequencies, or {head}? accepted: {cure}", choices=(table.heads[at], head))


def _of_specimens(table: Delimited, columns: Sequence[tuple[str, str]]) -> list[TableProblem]:
    """The problem with rows of several plates, which are not hits of one."""
    for i, head in enumerate(table.heads):
        names = list(dict.fromkeys(row.cells[i] for row in table.rows if row.cells[i]))
        if not columns[i][0] and _split(head)[0] in _SPECIMEN and len(names) > 1:
            what = f"several plates, received {', '.join(names[:4])}, accepted: a table for each"
            cure = f'; if these are hits of one, [measurement.columns] has hit = "{head}"'
            return [TableProblem(table.line, head, what + cure)]
    return []


def _hit(row: Row, columns: Sequence[tuple[str, str]]) -> Hit:
    texts = {"mode": "", "label": "", "hit": ""}
    values: dict[str, float] = {}
    for cell, (name, unit) in zip(row.cells, columns, strict=True):
        if name in texts:
            texts[name] = cell
        elif name and not _is_empty(cell):
            values[name] = _number(cell, name, unit)
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
    """The step of the last written digit of the frequencies, Hz."""
    at = next(i for i, (name, _) in enumerate(columns) if name == "hz")
    numbers = (_NUMBER.fullmatch(row.cells[at]) for row in table.rows)
    parts = [re.split(r"[.,]", number[1]) for number in numbers if number]
    decimals = max((len(part[-1]) for part in parts if len(part) > 1 and part[-1].isdigit()), default=0)
    return float(10.0**-decimals * _UNITS["hz"][columns[at][1]])


def read_sheets(
    content: bytes, named: Mapping[str, Sequence[str]] | None = None
) -> tuple[ModesTable | None, tuple[TableProblem, ...], tuple[str, ...]]:
    """The rows of the first sheet with a table of modes, its errors, and further sheets with a table."""
    try:
        read = {name: read_modes_table(text, named) for name, text in sheets(content).items()}
    except SheetError as error:
        return None, (TableProblem(0, "", str(error)),), ()
    # an error in a line shows that there is a table; an error of the whole is that there is none
    tables = [name for name, (rows, problems) in read.items() if rows is not None or problems[0].line]
    rows, problems = read[tables[0]] if tables else next(iter(read.values()))
    return rows, problems, tuple(name for name in tables[1:] if read[name][0] is not None)


def is_texts(value: object) -> bool:
    """Whether a value is a list of texts."""
    return isinstance(value, list) and all(isinstance(item, str) for item in value)
