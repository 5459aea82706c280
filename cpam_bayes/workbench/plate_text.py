"""A plate file as text that the fields of a page edit key by key; comments and other keys stay.

Typed text is written as it is: a number as a number, anything else as a string, which the reader of plate
files then reports.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from cpam_bayes.plate.checks import SOURCES

NUMBER, WORDS, LIST = "number", "words", "list"
FIELDS: Final[Mapping[str, str]] = {
    "name": WORDS,
    **{f"plate.{key}_mm": NUMBER for key in ("length", "width", "thickness")},
    "plate.mass_g": NUMBER,
    "plate.density_kg_m3": NUMBER,
    "plate.layup": WORDS,
    "plate.edges": WORDS,
    **{f"material.{key}": NUMBER for key in ("E1_GPa", "E2_GPa", "nu12", "G12_GPa")},
    **{f"unknowns.{key}": LIST for key in ("E1_GPa", "E2_GPa", "nu12", "G12_GPa")},
    "environment.air_density_kg_m3": NUMBER,
    "measurement.frequencies_hz": LIST,
    "measurement.relative_std": NUMBER,
    "measurement.resolution_hz": NUMBER,
}
"""Editable key of a plate file -> the form of its value."""
_BESIDE_ROWS: Final = ("frequency_sd_hz", "labels", "left_out", "by_hand")
"""Keys of [measurement] that refer to the rows of its list."""
SENSOR: Final = ("mass_g", "x_mm", "y_mm")
"""Keys of an attached mass."""

_HEADER: Final = re.compile(r"^\s*\[\[?\s*([A-Za-z0-9_.-]+)\s*\]\]?\s*(?:#.*)?$")
_NUMBER: Final = re.compile(r"[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d{1,3})?")
_SEPARATORS: Final = re.compile(r"[;\s|]+")


def content(text: str) -> dict[str, Any]:
    """The values of a plate file; empty for invalid TOML."""
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError):
        return {}


def value_at(data: Mapping[str, Any], key: str) -> Any:
    """The value under a dotted key, None if missing."""
    found: Any = data
    for part in key.split("."):
        found = found.get(part) if isinstance(found, Mapping) else None
    return found


def as_typed(value: object) -> str:
    """A value as it is typed, "" for None."""
    return f"{value:.10g}" if isinstance(value, float) else "" if value is None else str(value)


def sensors_in(data: Mapping[str, Any]) -> list[dict[str, str]]:
    """The attached masses, as typed."""
    return [{k: as_typed(s.get(k)) for k in SENSOR} for s in data.get("sensor", []) if isinstance(s, Mapping)]


def numbers_in(typed: str) -> list[str]:
    """Numbers of a typed or pasted list; a comma in a number is decimal unless it separates the list.

    "102, 311; 342", "102,5 311,2" and a spreadsheet column are all read.
    """
    parts = [part.strip(",") for part in _SEPARATORS.split(typed) if part.strip(",")]
    if any(part.count(",") > 1 for part in parts) or (len(parts) == 1 and re.search(r"\.\d*,", parts[0])):
        parts = [inner for part in parts for inner in part.split(",") if inner]
    return parts


def _number(typed: str) -> str:
    """TOML of a typed number, with a decimal point; of anything else as a string, which is then reported."""
    plain = typed.strip().replace(",", ".")
    if not _NUMBER.fullmatch(plain):
        return json.dumps(typed, ensure_ascii=False)
    return (
        repr(float(plain)) if plain.startswith(("+", ".")) or plain.endswith(".") or _padded(plain) else plain
    )


def _padded(plain: str) -> bool:
    """Whether a number has leading zeros or a point without digits, which TOML rejects."""
    return bool(re.match(r"-?0\d", plain) or re.search(r"\.(?:e|E|$)", plain) or plain.startswith("-."))


def with_value(text: str, key: str, typed: str) -> str:
    """The text with the typed value under a key of `FIELDS`; an empty value removes the key.

    Raises ``KeyError`` for any other key.
    """
    kind, plain = FIELDS[key], typed.strip()
    literal = json.dumps(plain, ensure_ascii=False) if kind == WORDS else _number(plain)
    if kind == LIST:
        parts = numbers_in(plain)
        literal = f"[{', '.join(map(_number, parts))}]" if parts else ""
    return _with_literal(text, key, literal if plain else "")


def _with_literal(text: str, key: str, literal: str) -> str:
    table, _, name = key.rpartition(".")
    lines = text.split("\n")
    start, stop = _block(lines, table)
    if start < 0:
        head = [f"[{table}]", f"{name} = {literal}", ""]
        return "\n".join([*lines, *([] if lines[-1] == "" else [""]), *head]) if literal else text
    for i in range(start, stop):
        if re.match(rf"\s*{re.escape(name)}\s*=", lines[i]):
            end = _end_of_value(lines, i, stop)
            comment = _comment(lines[i]) if end == i + 1 else ""
            kept = [f"{name} = {literal}"] if literal else []
            kept = [f"{kept[0]:<28} {comment}"] if kept and comment else kept
            return "\n".join([*lines[:i], *kept, *lines[end:]])
    if not literal:
        return text
    example = next(
        (i for i in range(start, stop) if re.match(rf"\s*#\s*{re.escape(name)}\s*=", lines[i])), None
    )
    if example is not None:
        comment = _comment(lines[example].lstrip(" #"))
        written = f"{name} = {literal}"
        lines[example] = f"{written:<28} {comment}".rstrip()
        return "\n".join(lines)
    last = max(
        (i + 1 for i in range(start, stop) if lines[i].strip() and not lines[i].startswith("#")),
        default=start,
    )
    return "\n".join([*lines[:last], f"{name} = {literal}", *lines[last:]])


def _block(lines: Sequence[str], table: str) -> tuple[int, int]:
    """Start and end, excluded, of the body of a table; (-1, -1) if it is missing."""
    heads = [(i, found[1]) for i, line in enumerate(lines) if (found := _HEADER.match(line))]
    if not table:
        return 0, heads[0][0] if heads else len(lines)
    for n, (i, name) in enumerate(heads):
        if name == table and not lines[i].lstrip().startswith("[["):
            return i + 1, heads[n + 1][0] if n + 1 < len(heads) else len(lines)
    return -1, -1


def _end_of_value(lines: Sequence[str], first: int, stop: int) -> int:
    """The line after a value that starts in a given line and may span several."""
    for end in range(first + 1, stop + 1):
        if content("\n".join(lines[first:end])):
            return end
    return first + 1


def _comment(line: str) -> str:
    """The comment after a value, "" if none."""
    for at in (i for i, sign in enumerate(line) if sign == "#"):
        if content(line[:at]):
            return line[at:].strip()
    return ""


@dataclass(frozen=True, slots=True)
class Row:
    """A frequency as typed, with its entries; sd, label : as TOML, "" if missing."""

    hz: str
    sd: str = ""
    label: str = ""
    left_out: bool = False
    by_hand: bool = False


def rows_in(data: Mapping[str, Any]) -> list[Row]:
    """The rows of the list in a plate file."""
    measurement = data.get("measurement")
    found = measurement if isinstance(measurement, Mapping) else {}
    listed, sds, labels, left_out, by_hand = (
        values if isinstance(values := found.get(key), list) else []
        for key in ("frequencies_hz", *_BESIDE_ROWS)
    )
    return [
        Row(
            as_typed(hz),
            repr(sds[i]) if i < len(sds) and isinstance(sds[i], int | float) else "",
            json.dumps(labels[i], ensure_ascii=False) if i < len(labels) else "",
            i + 1 in left_out,
            i + 1 in by_hand,
        )
        for i, hz in enumerate(listed)
    ]


def with_rows(text: str, rows: Sequence[Row], *, listed: bool = True) -> str:
    """The text with these rows as its list; a missing standard deviation becomes the median one.

    listed : False where another file has the list, so that only manual changes are written
    """
    sds = sorted(float(row.sd) for row in rows if row.sd)
    usual = repr(sds[len(sds) // 2]) if sds else ""
    beside = {
        "frequencies_hz": [_number(row.hz) for row in rows],
        "frequency_sd_hz": [row.sd or usual for row in rows] if sds else [],
        "labels": [row.label or '""' for row in rows] if any(row.label for row in rows) else [],
        "left_out": [str(i) for i, row in enumerate(rows, 1) if row.left_out],
        "by_hand": [str(i) for i, row in enumerate(rows, 1) if row.by_hand],
    }
    for key, values in list(beside.items())[0 if listed else 3 :]:
        text = _with_literal(text, f"measurement.{key}", f"[{', '.join(values)}]" if values else "")
    return text


def with_file(text: str, key: str, name: str) -> str:
    """The text without its list, and with a file name under a key of [measurement], if there is one."""
    for other in (*SOURCES, "range_hz", *_BESIDE_ROWS, "picked_from"):
        text = _with_literal(text, f"measurement.{other}", "")
    return _with_literal(text, f"measurement.{key}", json.dumps(name, ensure_ascii=False) if name else "")


def with_block(text: str, table: str, body: Sequence[str]) -> str:
    """The text with new lines in a table; comments above its header stay."""
    lines = text.split("\n")
    start, stop = _block(lines, table)
    if start < 0:
        return "\n".join([*lines, f"[{table}]", *body, ""])
    while stop > start and (not lines[stop - 1].strip() or lines[stop - 1].startswith("#")):
        stop -= 1
    return "\n".join([*lines[:start], *body, *lines[stop:]])


def with_sensors(text: str, sensors: Sequence[Mapping[str, str]]) -> str:
    """The text with these attached masses, as typed, in place of all others."""
    kept: list[str] = []
    inside = False
    for line in text.split("\n"):
        if found := _HEADER.match(line):
            inside = found[1] == "sensor"
        if not inside:
            kept.append(line)
    while kept and not kept[-1].strip():
        kept.pop()
    for sensor in sensors:
        kept += ["", "[[sensor]]", *(f"{key} = {_number(sensor.get(key, ''))}" for key in SENSOR)]
    return "\n".join([*kept, ""])
