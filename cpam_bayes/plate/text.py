"""Texts of plate files: opened safely, parsed, their values converted; and their errors.

Values as users write them become those of the schema: numbers with units or commas, edges in words, lists.
Only unambiguous values are converted; the schema refuses all others. An error is a `Problem` with its place;
all problems of a file are raised together.
"""

from __future__ import annotations

import contextlib
import difflib
import itertools
import json
import math
import os
import re
import reprlib
import stat
import tomllib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from cpam_bayes.errors import PlateFileError
from cpam_bayes.plate.edges import letters_of

KeyPath = tuple[str | int, ...]
Data = Mapping[str, Any]

_BARE = re.compile(r"[A-Za-z0-9_-]+")
_MAX_PROBLEMS: Final = 100
# Most names of a directory that are compared with the one given.
_MOST_BESIDE: Final = 1000
# Items of a list that a message shows.
MAX_SHOWN: Final = 6


@dataclass(frozen=True, slots=True)
class Problem:
    """One error: its place in the file, and a phrase or a function that makes the phrase.

    A file can have ten thousand errors; only those shown are put in words.

    is_gap : whether something is only missing
    choices : headings of a table, one of which has the frequencies
    """

    path: KeyPath
    what: str | Callable[[], str]
    is_gap: bool = False
    choices: tuple[str, ...] = ()

    def of_material(self, name: str) -> Problem:
        """The problem at its place in the file; it was found as if this material were the only one."""
        if not name or self.path[0] not in ("material", "unknowns"):
            return self
        return Problem((self.path[0], name, *self.path[1:]), self.what, self.is_gap)

    def under(self, misspelt: Mapping[KeyPath, str]) -> Problem:
        """The problem at the keys that the file has; misspelt : these -> the known key of each."""
        for path, known in misspelt.items():
            n = len(path)
            if self.path[:n] == (*path[:-1], known):
                return Problem((*path, *self.path[n:]), self.what, self.is_gap)
        return self

    @property
    def text(self) -> str:
        """The phrase."""
        return self.what if isinstance(self.what, str) else self.what()


Problems = Iterator[Problem]


def plate_file_error(
    source: str, problems: Iterable[Problem], lines: Mapping[KeyPath, int]
) -> PlateFileError:
    """All problems of a file as one error, in the order of their lines."""
    located = sorted(
        ((_line(problem.path, lines), problem) for problem in problems), key=lambda item: item[0]
    )
    said: dict[str, bool] = {}
    found = []
    # errors of a list are reported for the first of its items
    of_list = Counter(problem.path[:-1] for _, problem in located if isinstance(problem.path[-1], int))
    for i, (line, problem) in enumerate(located):
        if len(said) == _MAX_PROBLEMS:
            said[f"{source}: and {len(located) - i} more problems"] = False
            break
        # A mapping given instead of a file has no lines.
        where = f"{source}:{line}" if lines else source
        count = of_list.pop(problem.path[:-1], 0) if isinstance(problem.path[-1], int) else 1
        if not count:
            continue
        text = problem.text + and_more(count - 1, "item")
        whole = f"{where}: {_key(problem.path)}: {text}"
        if whole not in said:
            found.append((whole, problem.path, text))
        said[whole] = problem.is_gap
    gaps = tuple(text for text, is_gap in said.items() if is_gap)
    choices = located[0][1].choices if len(located) == 1 else ()
    return PlateFileError(*said, gaps=gaps, found=tuple(found), source=source, choices=choices)


def received(value: object) -> str:
    """A value as shown in a message: short, one line, printable."""
    short = reprlib.Repr()
    short.maxstring = short.maxother = short.maxlong = 60
    short.maxlevel = 2
    short.maxlist = MAX_SHOWN
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str) and len(value) <= 60:
        return json.dumps(value, ensure_ascii=not value.isprintable())
    return short.repr(value)


def and_more(count: int, what: str) -> str:
    """The words for this many more of the same in a message."""
    return (
        f"; so {'are' if count > 1 else 'is'} {count} more {what}{'s' if count > 1 else ''}" if count else ""
    )


def _line(path: KeyPath, lines: Mapping[KeyPath, int]) -> int:
    while path and path not in lines:
        path = path[:-1]
    return lines.get(path, 1)


def _key(path: KeyPath) -> str:
    said = ""
    for part in path:
        if isinstance(part, int):
            said += f" item {part + 1}"
        else:
            name = part if _BARE.fullmatch(part) else received(part)
            said += f".{name}" if said else name
    return said or "file"


def table(data: Data, *path: str) -> Data:
    """The table at a path, empty when it is missing or no table."""
    for key in path:
        inner = data.get(key)
        data = inner if isinstance(inner, dict) else {}
    return data


def number(source: Data, key: str) -> float | None:
    """A finite number in a table, None where it is missing or something else."""
    return real(source.get(key))


def real(value: object) -> float | None:
    """A value as a finite number, None if it is not one."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        finite = float(value)
    except OverflowError:
        return None
    return finite if math.isfinite(finite) else None


def numbers(source: Data, key: str) -> list[float] | None:
    """A list of finite numbers in a table, None where it is missing or something else."""
    values = source.get(key)
    if not isinstance(values, list):
        return None
    numbers_read = [real(value) for value in values]
    return None if None in numbers_read else [value for value in numbers_read if value is not None]


MAX_BYTES: Final = 250_000


def read_regular_file(path: str, source: str, accepted: str, most: int = MAX_BYTES) -> bytes:
    """The content of a file of at most ``most`` bytes.

    source : name of the file in messages
    accepted : what the file should be, for messages
    raises FileNotFoundError where there is none, PlateFileError where it cannot be read
    """
    try:
        _require_small_file(os.stat(path), source, accepted, most)
        # Not blocking, and checked again: the path may have become a pipe in between.
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
        with os.fdopen(handle, "rb") as file:
            _require_small_file(os.fstat(file.fileno()), source, accepted, most)
            content = file.read(most + 1)
    except FileNotFoundError:
        raise
    except (OSError, ValueError) as error:
        if isinstance(error, PlateFileError):
            raise
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise PlateFileError(f"{source}: cannot be read: {reason}") from None
    if len(content) > most:
        raise PlateFileError(_too_large(source, "more", most))
    return content


def read_named_file(
    key: KeyPath, name: str, directory: Path | None, accepted: str, most: int = MAX_BYTES
) -> tuple[bytes | None, list[Problem]]:
    """The content of a file that a plate file names under a key, or its problems.

    directory : base of relative paths
    accepted, most : as in `read_regular_file`
    """
    path = Path(name) if directory is None else directory / name
    try:
        return read_regular_file(str(path), received(name), accepted, most), []
    except FileNotFoundError:
        near = nearest_file(path)
        cure = f"; the nearest there is {received(near)}" if near else ""
        what = f"no such file, received {received(name)}, accepted: a path from the plate file{cure}"
        if not name.isprintable():
            what += r"; \t and \n in quotes are no path: write / for \ or use single quotes"
        return None, [Problem(key, what)]
    except (PlateFileError, ValueError) as error:
        return None, [Problem(key, str(error))]


def nearest_file(path: Path) -> str:
    """The most similar name of a file beside a path, "" for none."""
    try:
        beside = [Path(other) for other in itertools.islice(os.listdir(path.parent), _MOST_BESIDE)]
    except (OSError, ValueError):
        return ""
    alike = [other for other in beside if path.suffix.casefold() in ("", other.suffix.casefold())]
    stems = {other.stem.casefold(): other.name for other in alike}
    close = difflib.get_close_matches(path.stem.casefold(), stems, n=1, cutoff=0.6)
    return stems[close[0]] if close else ""


def _require_small_file(status: os.stat_result, source: str, accepted: str, most: int) -> None:
    if stat.S_ISDIR(status.st_mode):
        raise PlateFileError(f"{source}: a directory, accepted: {accepted}")
    if not stat.S_ISREG(status.st_mode):
        raise PlateFileError(f"{source}: a pipe or device, accepted: a regular file")
    if status.st_size > most:
        raise PlateFileError(_too_large(source, f"{status.st_size} bytes", most))


def _too_large(source: str, size: str, most: int) -> str:
    return f"{source}: too large, received {size}, accepted: up to {most} bytes"


def decode(content: bytes, source: str) -> str:
    """The text of a plate file, UTF-8 or UTF-16; raises PlateFileError where it is not text."""
    content = as_utf_8(content)
    if b"\0" in content:
        raise PlateFileError(f"{source}: a binary file, accepted: a TOML text")
    try:
        return content.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise PlateFileError(
            f"{source}:{line}: file: not UTF-8 text, received byte 0x{content[error.start]:02x}, "
            "accepted: a TOML text in UTF-8; save it with that encoding"
        ) from None


def as_utf_8(content: bytes) -> bytes:
    """The content of a text file in UTF-8; UTF-16, with or without byte order mark, is converted."""
    marked = content.startswith((b"\xff\xfe", b"\xfe\xff"))
    # without a mark: Latin letters have a zero byte beside them
    little = not marked and 2 * content[1::2].count(0) > len(content[1::2])
    if len(content) % 2 or not (marked or little):
        return content
    return content.decode("utf-16" if marked else "utf-16-le", errors="replace").encode()


# The parser of the standard library takes time quadratic in the parts of one dotted key.
_MAX_KEY_PARTS: Final = 100
_KEY_END = re.compile(r"[=,{}\[\]#\n]")
_PLACE = re.compile(r"\s*\(at (?:line (\d+), column (\d+)|end of document)\)$")


def parse(text: str, source: str, is_sealed: bool = False) -> Mapping[str, Any]:
    """The content of a TOML text; raises PlateFileError with the line that is not TOML.

    is_sealed : messages show nothing of the text
    """
    for number, line in enumerate(text.split("\n"), start=1):
        if line.count(".") > _MAX_KEY_PARTS:
            parts = max(part.count(".") for part in _KEY_END.split(line.partition("#")[0]))
            if parts > _MAX_KEY_PARTS:
                raise PlateFileError(
                    f"{source}:{number}: file: a key of {parts + 1} parts, accepted: up to {_MAX_KEY_PARTS}"
                )
    commas = None if is_sealed else _DECIMAL_COMMAS.search(text)
    if commas:
        at = text.count("\n", 0, commas.start()) + 1
        raise PlateFileError(
            f"{source}:{at}: {commas[1]}: are these decimal commas? {commas[3]},{commas[4]} is two numbers, "
            f"received {received(' '.join(commas[2].split()))}, accepted: {commas[3]}.{commas[4]}, or a "
            "space after every comma"
        )
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise PlateFileError(_not_toml(str(error), text, source, is_sealed)) from None
    except RecursionError:
        raise PlateFileError(f"{source}:1: file: arrays or tables nested too deeply") from None
    except ValueError as error:
        raise PlateFileError(f"{source}:1: file: not valid TOML: {error}") from None


# Whole numbers in pairs, separated by commas and spaces: 80,2, 146,3.
_DECIMAL_COMMAS: Final = re.compile(
    r"^[ \t]*(\w+_(?:hz|GPa)|nu12)[ \t]*=\s*(\[\s*(\d+),(\d+)(?:,\s+\d+,\d+)+,?\s*\])", re.MULTILINE
)
# Patterns in lines that are not TOML, and the advice in the line's own words.
_SLIPS: Final = (
    (re.compile(r"^[^\"'#]*([\"'])(?:(?!\1).)*$"), "; a quote is missing: a text begins and ends with one"),
    (re.compile(r"=\s*(\d{1,2}\.\d{1,2}\.\d{2,4})\b"), r'; a date stands in quotes: "\1"'),
    (
        re.compile(r"=\s*\[\s*([\d.]+) ?(?![eE][+-]?\d)([A-Za-z%]+)"),
        r"; the unit is in the key: \1, not \1 \2",
    ),
    (re.compile(r"=\s*\[\s*([\d.]+)\s*-\s*([\d.]+)\s*\]"), r"; a comma stands between two ends: [\1, \2]"),
    (
        re.compile(r"=\s*\[(?=[^\]\"']*(?:;|\d\s+[+-]?\d))[^\]\"']*?(?<![\w.,])([+-]?\d+),(\d+)(?![\w.,])"),
        r"; a decimal point, not a comma: \1.\2",
    ),
    (
        re.compile(
            r"=\s*\[[^\]\"']*?(?<![\w.,+-])(-?[\d.]*\d(?:[eE][+-]?\d+)?)\s*(?:;\s*|\s)"
            r"(-?\d[\d.]*(?:[eE][+-]?\d+)?)(?![\w.]*,\d)"
        ),
        r"; commas part the numbers of a list: \1, \2",
    ),
    (re.compile(r"=\s*[({]?\s*\d+(?:\.\d+|,\d+)?\s*,\s"), "; a list stands in [ ]"),
    (re.compile(r"=\s*([+-]?\d+),(\d+)"), r"; a decimal point, not a comma: \1.\2"),
    (re.compile(r"=\s*([+-]?)(\.\d+)"), r"; a digit on each side of a point: \g<1>0\2"),
    (re.compile(r"=\s*([+-]?\d+\.)\s*(?:#|$)"), r"; a digit on each side of a point: \g<1>0"),
    (re.compile(r"=\s*[+-]?[\d.]+\s*(?:;|/|\(|--)"), "; # begins a comment"),
    (re.compile(r"=\s*(?:True|False|TRUE|FALSE)\b"), "; true and false are in small letters"),
    (re.compile(r"=\s*(?:#|$)"), "; the value is missing"),
    (re.compile(r"^(?!\[[\w.]+\]$)\W?[A-Za-z_.]+\W?$"), "; a table is headed [plate]"),
    (
        re.compile(r"^\w+(?:\s+\w+\s*=|\s+[^\s=:])"),
        "; a key has no spaces and = stands after it",
    ),
    (
        re.compile(r"=\s*([+-]?\d[\d.]*)\s*(?![eE][+-]?\d)([A-Za-z°%]+)"),
        r'; the unit is in the key, or a text in quotes: "\1 \2"',
    ),
    (
        re.compile(
            "[\N{LEFT DOUBLE QUOTATION MARK}\N{RIGHT DOUBLE QUOTATION MARK}\N{DOUBLE LOW-9 QUOTATION MARK}"
            "\N{LEFT SINGLE QUOTATION MARK}\N{RIGHT SINGLE QUOTATION MARK}\N{SINGLE LOW-9 QUOTATION MARK}"
            "\N{LEFT-POINTING DOUBLE ANGLE QUOTATION MARK}`]|=\\s*''"
        ),
        '; quotes are "',
    ),
    (re.compile(r'=\s*"[^"]*\\'), r"; write / for \\ in a path, or put it in single quotes: 'C:\\data'"),
    (re.compile(r"^[A-Za-z_0-9]+\s*:"), "; = stands between a key and its value"),
    (re.compile(r"=\s*([A-Za-z(][^#]*?)\s*(?:#|$)"), r'; texts stand in quotes: "\1"'),
)


# The same by the message of the parser.
_TOLD: Final = (
    (re.compile("^Cannot"), "; a key and a table stand once"),
    (re.compile("^Unclosed array"), "; is a ] missing, here or above?"),
)


def _not_toml(message: str, text: str, source: str, is_sealed: bool) -> str:
    place = _PLACE.search(message)
    what = _PLACE.sub("", message)
    if place is not None and place.group(1):
        line, where = int(place.group(1)), f" at column {place.group(2)}"
    else:
        line, where = text.rstrip().count("\n") + 1, " at the end of the file"
    if is_sealed:
        return f"{source}:{line}: file: not valid TOML"
    shown = text.split("\n")[line - 1].strip() if line <= text.count("\n") + 1 else ""
    quoted = "".join(c if c.isprintable() else " " for c in shown[:60])
    slips = (*((slip, said, shown) for slip, said in _SLIPS), *((slip, said, what) for slip, said in _TOLD))
    cure = next((match.expand(said) for slip, said, where in slips if (match := slip.search(where))), "")
    return f"{source}:{line}: file: not valid TOML, {what}{where}, received: {quoted}{cure}"


_BLANK = re.compile(r"(?:[ \t\r\n]|#[^\n]*)*")
_SPACE = re.compile(r"[ \t]*")
_PLAIN = re.compile(r"[^\s,\]}#]+(?: \d[^\s,\]}#]*)?")
_STRINGS: Final = (
    re.compile(r'"""(?:[^"\\]|\\.|"(?!""))*"{3,5}', re.DOTALL),
    re.compile(r"'''(?:[^']|'(?!''))*'{3,5}", re.DOTALL),
    re.compile(r'"(?:[^"\\\n]|\\.)*"'),
    re.compile(r"'[^'\n]*'"),
)


def line_numbers(text: str) -> dict[KeyPath, int]:
    """The line, from 1, of each table, key and array element of a text that is valid TOML.

    A path holds keys, and positions in arrays: ("sensor", 0, "mass_g"). For a text that is not
    valid, or nested beyond Python's recursion, the result covers what was reached.
    """
    scan = _Scan(text)
    with contextlib.suppress(ValueError, RecursionError):
        scan.document()
    return scan.lines


class _Scan:
    def __init__(self, text: str) -> None:
        self.text = text
        self.at = 0
        self.lines: dict[KeyPath, int] = {}
        self._counted = 0
        self._line = 1
        self._arrays: dict[KeyPath, int] = {}

    def document(self) -> None:
        table: KeyPath = ()
        self.skip(_BLANK)
        while self.at < len(self.text):
            if self.text.startswith("[", self.at):
                table = self.header()
            else:
                self.pair(table)
            self.skip(_BLANK)

    def header(self) -> KeyPath:
        line = self.line()
        double = self.text.startswith("[[", self.at)
        self.at += 2 if double else 1
        keys = self.dotted()
        self.skip(_SPACE)
        self.expect("]]" if double else "]")
        path: KeyPath = ()
        for i, key in enumerate(keys):
            path = (*path, key)
            self.lines.setdefault(path, line)
            if path in self._arrays:
                if double and i == len(keys) - 1:
                    self._arrays[path] += 1
                path = (*path, self._arrays[path])
            elif double and i == len(keys) - 1:
                self._arrays[path] = 0
                path = (*path, 0)
        self.lines.setdefault(path, line)
        return path

    def pair(self, table: KeyPath) -> None:
        line = self.line()
        path = table
        for key in self.dotted():
            path = (*path, key)
            self.lines.setdefault(path, line)
        self.skip(_SPACE)
        self.expect("=")
        self.skip(_SPACE)
        self.value(path)

    def value(self, path: KeyPath) -> None:
        opening = self.text[self.at : self.at + 1]
        if opening == "[":
            self.array(path)
        elif opening == "{":
            self.inline_table(path)
        elif opening in ('"', "'"):
            self.string()
        else:
            self.token(_PLAIN)

    def array(self, path: KeyPath) -> None:
        self.expect("[")
        self.skip(_BLANK)
        position = 0
        while not self.text.startswith("]", self.at):
            element = (*path, position)
            self.lines[element] = self.line()
            self.value(element)
            position += 1
            self.skip(_BLANK)
            if self.text.startswith(",", self.at):
                self.at += 1
                self.skip(_BLANK)
            elif not self.text.startswith("]", self.at):
                raise ValueError("array")
        self.expect("]")

    def inline_table(self, path: KeyPath) -> None:
        self.expect("{")
        self.skip(_BLANK)
        while not self.text.startswith("}", self.at):
            self.pair(path)
            self.skip(_BLANK)
            if self.text.startswith(",", self.at):
                self.at += 1
                self.skip(_BLANK)
            elif not self.text.startswith("}", self.at):
                raise ValueError("inline table")
        self.expect("}")

    def dotted(self) -> list[str]:
        keys = []
        while True:
            self.skip(_SPACE)
            if self.text[self.at : self.at + 1] in ('"', "'"):
                keys.append(self.string()[1:-1])
            else:
                keys.append(self.token(_BARE))
            self.skip(_SPACE)
            if not self.text.startswith(".", self.at):
                return keys
            self.at += 1

    def string(self) -> str:
        for pattern in _STRINGS:
            match = pattern.match(self.text, self.at)
            if match:
                self.at = match.end()
                return match.group()
        raise ValueError("string")

    def token(self, pattern: re.Pattern[str]) -> str:
        match = pattern.match(self.text, self.at)
        if not match:
            raise ValueError("token")
        self.at = match.end()
        return match.group()

    def skip(self, pattern: re.Pattern[str]) -> None:
        match = pattern.match(self.text, self.at)
        if match:
            self.at = match.end()

    def expect(self, characters: str) -> None:
        if not self.text.startswith(characters, self.at):
            raise ValueError(characters)
        self.at += len(characters)

    def line(self) -> int:
        """Line of the place reached; places are visited in order, so newlines are counted once."""
        self._line += self.text.count("\n", self._counted, self.at)
        self._counted = self.at
        return self._line


UNITS: Final[Mapping[str, Mapping[str, float]]] = {
    "kg_m3": {
        "kg/m3": 1.0,
        "kg/m^3": 1.0,
        "kg/m³": 1.0,
        "g/cm3": 1e3,
        "g/cm^3": 1e3,
        "g/cm³": 1e3,
        "g/cc": 1e3,
    },
    "mm": {"mm": 1.0, "cm": 10.0, "m": 1e3, "um": 1e-3, "µm": 1e-3, "in": 25.4, "inch": 25.4},
    "GPa": {"gpa": 1.0, "mpa": 1e-3, "pa": 1e-9, "n/mm2": 1e-3, "n/mm²": 1e-3},
    "hz": {"hz": 1.0, "khz": 1e3},
    "deg": {"deg": 1.0, "°": 1.0},
    "g": {"g": 1.0, "kg": 1e3, "mg": 1e-3},
    "std": {"%": 0.01},
    "nu12": {},
}
"""Suffix of a key -> the units that a text may have instead, and their factors; the first match counts."""
_LISTS: Final = ("frequencies_hz", "frequency_sd_hz")
_LAYUPS: Final = ("layup", "sequence_layup")
_NUMBER: Final = re.compile(r"\s*([+-]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][+-]?\d+)?)\s*(\S.*?)?\s*")
# Three digits after a comma and a number before it: 1,234 may be either.
_THOUSANDS: Final = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}")
# Between numbers: spaces, a semicolon, a comma before a space, a sign of multiplication.
_BETWEEN: Final = re.compile(r"(?:\s*[;x*\N{MULTIPLICATION SIGN}]\s*|,?\s+)", re.IGNORECASE)
# Largest depth of tables within tables, and of priors, in a plate file.
_DEEPEST: Final = 5


def number_of(text: str, units: Mapping[str, float] | None = None) -> float | None:
    """A number with a decimal point or comma and perhaps a unit; None if it is not one, or ambiguous."""
    match = _NUMBER.fullmatch(text)
    if match is None or _THOUSANDS.fullmatch(match[1]):
        return None
    factor = 1.0 if match[2] is None else (units or {}).get(match[2].casefold())
    value = float(match[1].replace(",", "."))
    # 9.8 mm must not be 9.799999999999999 mm: a factor below 1 divides
    return None if factor is None else value * factor if factor >= 1.0 else value / round(1.0 / factor)


def numbers_of(text: str) -> tuple[float, ...] | None:
    """Numbers, all with points or all with commas; None for anything else, or for one with a comma."""
    parts = _BETWEEN.split(text.strip())
    if ("." in text and any("," in part for part in parts)) or (len(parts) == 1 and "," in text):
        return None
    values = [number_of(part) for part in parts]
    return None if None in values else tuple(value for value in values if value is not None)


def understood(data: Mapping[str, Any], depth: int = 0) -> dict[str, Any]:
    """The content of a plate file, or of a table in it, with its values as in the schema."""
    return {key: _value(key, value, depth) for key, value in data.items()} if depth < _DEEPEST else dict(data)


def _value(key: str, value: Any, depth: int) -> Any:
    if key == "edges":
        return letters_of(value)
    if key in _LAYUPS:
        is_list = isinstance(value, list) and all(isinstance(ply, int | float | str) for ply in value)
        return f"[{'/'.join(f'{ply}' for ply in value)}]" if is_list and value else value
    unit = next((UNITS[u] for u in UNITS if key == u or key.endswith(f"_{u}")), None)
    if isinstance(value, str) and key in _LISTS:
        listed = numbers_of(value)
        return value if listed is None else list(listed)
    if unit is not None:
        return _numbers(value, unit)
    if isinstance(value, Mapping):
        return understood(value, depth + 1)
    if isinstance(value, list):
        return [understood(item, depth + 1) if isinstance(item, Mapping) else item for item in value]
    return value


def _numbers(value: Any, units: Mapping[str, float]) -> Any:
    """A number, a list of numbers or a prior, with texts converted."""
    if isinstance(value, str):
        found = number_of(value, units)
        return value if found is None else found
    if isinstance(value, list):
        return [_numbers(item, units) if isinstance(item, str) else item for item in value]
    if isinstance(value, Mapping):
        return {
            key: _numbers(item, units) if isinstance(item, str | list) else item
            for key, item in value.items()
        }
    return value
