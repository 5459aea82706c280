"""Texts of plate files: opened whatever the path turns out to be, parsed, and with the line of every key."""

from __future__ import annotations

import contextlib
import os
import re
import stat
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from cpam_bayes.errors import PlateFileError
from cpam_bayes.plate.problems import KeyPath, Problem, received

__all__ = ["MAX_BYTES", "decode", "line_numbers", "parse", "read_named_file", "read_regular_file"]

MAX_BYTES: Final = 250_000


def read_regular_file(path: str, source: str, accepted: str, most: int = MAX_BYTES) -> bytes:
    """The content of a file of at most ``most`` bytes.

    source : how messages name the file
    accepted : what it should have been, for messages
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
    """The content of a file that a plate file names under a key, or what is wrong with it.

    directory : where relative paths begin
    accepted, most : as of `read_regular_file`
    """
    path = Path(name) if directory is None else directory / name
    try:
        return read_regular_file(str(path), received(name), accepted, most), []
    except FileNotFoundError:
        what = f"no such file, received {received(name)}, accepted: a path from the plate file"
        if not name.isprintable():
            what += r"; \t and \n in quotes are no path: write / for \ or use single quotes"
        return None, [Problem(key, what)]
    except (PlateFileError, ValueError) as error:
        return None, [Problem(key, str(error))]


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
    """The text of a plate file, UTF-8 or UTF-16 with its mark; raises PlateFileError where it is none."""
    if content.startswith((b"\xff\xfe", b"\xfe\xff")) and len(content) % 2 == 0:
        content = content.decode("utf-16", errors="replace").encode()
    if b"\0" in content:
        raise PlateFileError(f"{source}: a binary file, accepted: a TOML text")
    try:
        return content.decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise PlateFileError(
            f"{source}:{line}: file: not UTF-8 text, received byte 0x{content[error.start]:02x}, "
            "accepted: a TOML text in UTF-8"
        ) from None


# The parser of the standard library takes time quadratic in the parts of one dotted key.
_MAX_KEY_PARTS: Final = 100
_KEY_END = re.compile(r"[=,{}\[\]#\n]")
_PLACE = re.compile(r"\s*\(at (?:line (\d+), column (\d+)|end of document)\)$")


def parse(text: str, source: str) -> Mapping[str, Any]:
    """The content of a TOML text; raises PlateFileError with the line of what is no TOML."""
    for number, line in enumerate(text.split("\n"), start=1):
        if line.count(".") > _MAX_KEY_PARTS:
            parts = max(part.count(".") for part in _KEY_END.split(line.partition("#")[0]))
            if parts > _MAX_KEY_PARTS:
                raise PlateFileError(
                    f"{source}:{number}: file: a key of {parts + 1} parts, accepted: up to {_MAX_KEY_PARTS}"
                )
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise PlateFileError(_not_toml(str(error), text, source)) from None
    except RecursionError:
        raise PlateFileError(f"{source}:1: file: arrays or tables nested too deeply") from None
    except ValueError as error:
        raise PlateFileError(f"{source}:1: file: not valid TOML: {error}") from None


# What a line has that is no TOML, and the cure.
_SLIPS: Final = (
    (re.compile(r"=\s*[+-]?\d+,\d"), "; a decimal point, not a comma: 281.5"),
    (re.compile(r"=\s*[+-]?\d[\d.]*\s*[A-Za-z°%]"), '; the unit is in the key, or a text in quotes: "185 g"'),
    (
        re.compile(
            "[\N{LEFT DOUBLE QUOTATION MARK}\N{RIGHT DOUBLE QUOTATION MARK}\N{DOUBLE LOW-9 QUOTATION MARK}]"
        ),
        '; quotes are "',
    ),
    (re.compile(r'=\s*"[^"]*\\'), "; write / for \\ in a path, or put it in single quotes: 'C:\\data'"),
    (re.compile(r"^[A-Za-z_0-9]+\s*:"), "; = stands between a key and its value"),
    (re.compile(r"=\s*[A-Za-z(]"), '; texts stand in quotes: edges = "FFFF"'),
)


def _not_toml(message: str, text: str, source: str) -> str:
    place = _PLACE.search(message)
    what = _PLACE.sub("", message)
    if place is not None and place.group(1):
        line, where = int(place.group(1)), f" at column {place.group(2)}"
    else:
        line, where = text.rstrip().count("\n") + 1, " at the end of the file"
    shown = text.split("\n")[line - 1].strip() if line <= text.count("\n") + 1 else ""
    quoted = "".join(c if c.isprintable() else " " for c in shown[:60])
    cure = next((said for slip, said in _SLIPS if slip.search(shown)), "")
    return f"{source}:{line}: file: not valid TOML, {what}{where}, received: {quoted}{cure}"


_BLANK = re.compile(r"(?:[ \t\r\n]|#[^\n]*)*")
_SPACE = re.compile(r"[ \t]*")
_BARE = re.compile(r"[A-Za-z0-9_-]+")
_PLAIN = re.compile(r"[^\s,\]}#]+(?: \d[^\s,\]}#]*)?")
_STRINGS: Final = (
    re.compile(r'"""(?:[^"\\]|\\.|"(?!""))*"{3,5}', re.DOTALL),
    re.compile(r"'''(?:[^']|'(?!''))*'{3,5}", re.DOTALL),
    re.compile(r'"(?:[^"\\\n]|\\.)*"'),
    re.compile(r"'[^'\n]*'"),
)


def line_numbers(text: str) -> dict[KeyPath, int]:
    """The line, from 1, of each table, key and array element of a text that is valid TOML.

    A path holds keys, and positions in arrays: ("sensor", 0, "mass_g"). Of a text that is not
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
