"""Problems of a plate file and their wording, and raw tables that are not trusted yet."""

from __future__ import annotations

import json
import math
import re
import reprlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

from cpam_bayes.errors import PlateFileError

KeyPath = tuple[str | int, ...]
Data = Mapping[str, Any]

_BARE = re.compile(r"[A-Za-z0-9_-]+")
_MAX_PROBLEMS: Final = 100
# Items of a list that a message shows.
MAX_SHOWN: Final = 6


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing that is wrong: where in the file, and a phrase that says it all, or what makes the phrase.

    A file can be wrong in ten thousand places; only what is shown is put in words.

    is_gap : whether something is missing and nothing wrong
    """

    path: KeyPath
    what: str | Callable[[], str]
    is_gap: bool = False

    def of_material(self, name: str) -> Problem:
        """The same thing, found in a file that was looked at as if it had this material alone."""
        if not name or self.path[0] not in ("material", "unknowns"):
            return self
        return Problem((self.path[0], name, *self.path[1:]), self.what, self.is_gap)

    def under(self, misspelt: Mapping[KeyPath, str]) -> Problem:
        """The same thing at the keys that the file has; misspelt : these -> the known key of each."""
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
    for i, (line, problem) in enumerate(located):
        if len(said) == _MAX_PROBLEMS:
            said[f"{source}: and {len(located) - i} more problems"] = False
            break
        # A mapping given instead of a file has no lines.
        where = f"{source}:{line}" if lines else source
        text = problem.text
        whole = f"{where}: {_key(problem.path)}: {text}"
        if whole not in said:
            found.append((whole, problem.path, text))
        said[whole] = problem.is_gap
    gaps = tuple(text for text, is_gap in said.items() if is_gap)
    return PlateFileError(*said, gaps=gaps, found=tuple(found))


def received(value: object) -> str:
    """A value as it may stand in a message: short, one line, printable."""
    short = reprlib.Repr()
    short.maxstring = short.maxother = short.maxlong = 60
    short.maxlevel = 2
    short.maxlist = MAX_SHOWN
    if isinstance(value, bool):
        return "true" if value else "false"
    return json.dumps(value) if isinstance(value, str) and len(value) <= 60 else short.repr(value)


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
    """A finite number of a table, None when it is missing or no such number."""
    return real(source.get(key))


def real(value: object) -> float | None:
    """A value as a finite number, None when it is none."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        finite = float(value)
    except OverflowError:
        return None
    return finite if math.isfinite(finite) else None


def numbers(source: Data, key: str) -> list[float] | None:
    """A list of finite numbers of a table, None when it is missing or no such list."""
    values = source.get(key)
    if not isinstance(values, list):
        return None
    numbers_read = [real(value) for value in values]
    return None if None in numbers_read else [value for value in numbers_read if value is not None]
