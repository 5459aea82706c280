"""What is wrong with a plate file, and how it is said."""

from __future__ import annotations

import difflib
import json
import re
import reprlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from types import UnionType
from typing import Annotated, Any, Final, Union, get_args, get_origin, get_type_hints

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from cpam_bayes.errors import PlateFileError
from cpam_bayes.plate.schema import OF_ALL, OF_EACH, TAGS, PlateFile
from cpam_bayes.plate.toml_lines import Path

_MAX_PROBLEMS: Final = 100
# Items of a list that a message shows.
_MAX_SHOWN: Final = 6
_BARE = re.compile(r"[A-Za-z0-9_-]+")

_WRONG: Final = {
    "finite_number": "not a finite number",
    "union_tag_not_found": "not a prior",
    "greater_than": "out of range",
    "greater_than_equal": "out of range",
    "less_than": "out of range",
    "less_than_equal": "out of range",
    "too_short": "wrong length",
    "too_long": "wrong length",
    "string_too_short": "empty text",
    "string_too_long": "text too long",
    "string_pattern_mismatch": "malformed",
    "literal_error": "not a symmetry",
}


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing that is wrong: where in the file, and a phrase that says it all, or what makes the phrase.

    A file can be wrong in ten thousand places; only what is shown is put in words.
    """

    path: Path
    what: str | Callable[[], str]

    def of_material(self, name: str) -> Problem:
        """The same thing, found in a file that was looked at as if it had this material alone."""
        if not name or self.path[0] not in ("material", "unknowns"):
            return self
        return Problem((self.path[0], name, *self.path[1:]), self.what)

    @property
    def text(self) -> str:
        """The phrase."""
        return self.what if isinstance(self.what, str) else self.what()


def plate_file_error(source: str, problems: Iterable[Problem], lines: Mapping[Path, int]) -> PlateFileError:
    """All problems of a file as one error, in the order of their lines."""
    located = sorted(
        ((_line(problem.path, lines), problem) for problem in problems), key=lambda item: item[0]
    )
    said: dict[str, None] = {}
    for i, (line, problem) in enumerate(located):
        if len(said) == _MAX_PROBLEMS:
            said[f"{source}: and {len(located) - i} more problems"] = None
            break
        # A mapping given instead of a file has no lines.
        where = f"{source}:{line}" if lines else source
        said[f"{where}: {_key(problem.path)}: {problem.text}"] = None
    return PlateFileError(*said)


def received(value: object) -> str:
    """A value as it may stand in a message: short, one line, printable."""
    short = reprlib.Repr()
    short.maxstring = short.maxother = short.maxlong = 60
    short.maxlevel = 2
    short.maxlist = _MAX_SHOWN
    if isinstance(value, bool):
        return "true" if value else "false"
    return json.dumps(value) if isinstance(value, str) and len(value) <= 60 else short.repr(value)


def schema_problems(data: Mapping[str, Any]) -> list[Problem]:
    """Unknown keys, missing keys, wrong types and single values out of range."""
    try:
        PlateFile.model_validate(data)
    except ValidationError as error:
        return [
            Problem(_path(item["loc"]), partial(_what, item["type"], _path(item["loc"]), item["input"]))
            for item in error.errors(include_url=False, include_context=False)
        ]
    return []


def _what(kind: str, path: Path, value: object) -> str:
    if kind == "extra_forbidden":
        return _unknown_key(path)
    accepted = _accepted(PlateFile, path) or "see the plate file's documentation"
    if kind == "missing":
        return f"missing, accepted: {accepted}"
    wrong = _WRONG.get(kind, "wrong type")
    if kind == "too_long" and isinstance(value, list) and len(value) > _MAX_SHOWN:
        return f"too many, received {len(value)}, accepted: {accepted}"
    return f"{wrong}, received {received(value)}, accepted: {accepted}"


def _unknown_key(path: Path) -> str:
    key = str(path[-1])
    siblings = _keys_of(PlateFile, path[:-1])
    nearest = difflib.get_close_matches(key, siblings, n=1, cutoff=0.5)
    if key in _TABLE_OF:
        return f"unknown key here, it belongs in {_TABLE_OF[key]}"
    if nearest:
        return f"unknown key, the nearest known key is {nearest[0]}"
    return f"unknown key, accepted: {' '.join(siblings)}"


def _path(location: tuple[int | str, ...]) -> Path:
    """Pydantic's location without the names of the forms of tables and of priors."""
    table, form = location[:1], location[1:2]
    if form not in ((OF_ALL,), (OF_EACH,)):
        return location
    prior = 2 if form == (OF_EACH,) else 1
    inside = location[2:]
    if table == ("unknowns",) and inside[prior : prior + 1] and inside[prior] in TAGS:
        inside = inside[:prior] + inside[prior + 1 :]
    return table + inside


def _line(path: Path, lines: Mapping[Path, int]) -> int:
    while path and path not in lines:
        path = path[:-1]
    return lines.get(path, 1)


def _key(path: Path) -> str:
    said = ""
    for part in path:
        if isinstance(part, int):
            said += f" item {part + 1}"
        else:
            name = part if _BARE.fullmatch(part) else received(part)
            said += f".{name}" if said else name
    return said or "file"


def _accepted(annotation: Any, path: Path) -> str | None:
    """The description of the field at a path of the schema."""
    if get_origin(annotation) is Annotated:
        described = [
            item.description
            for item in annotation.__metadata__
            if isinstance(item, FieldInfo) and item.description
        ]
        if not path and described:
            return described[-1]
        return _accepted(annotation.__origin__, path)
    for inner, rest in _inside(annotation, path):
        accepted = _accepted(inner, rest)
        if accepted:
            return accepted
    return None


def _keys_of(annotation: Any, path: Path) -> list[str]:
    """The keys of the table at a path of the schema."""
    if get_origin(annotation) is Annotated:
        return _keys_of(annotation.__origin__, path)
    if not path and _is_table(annotation):
        return list(annotation.model_fields)
    for inner, rest in _inside(annotation, path):
        keys = _keys_of(inner, rest)
        if keys:
            return keys
    return []


def _inside(annotation: Any, path: Path) -> list[tuple[Any, Path]]:
    """One step along a path into an annotation that is not Annotated."""
    origin = get_origin(annotation)
    if origin in (Union, UnionType):
        return [(option, path) for option in get_args(annotation)]
    if origin is list and path and isinstance(path[0], int):
        return [(get_args(annotation)[0], path[1:])]
    if origin is dict and path:
        return [(get_args(annotation)[1], path[1:])]
    if _is_table(annotation) and path:
        hints = get_type_hints(annotation, include_extras=True)
        if annotation.model_config["extra"] == "allow" and path[0] not in annotation.model_fields:
            return [(hints["__pydantic_extra__"], path)]
        hint = hints.get(str(path[0]))
        return [] if hint is None else [(hint, path[1:])]
    return []


def _is_table(annotation: Any) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)


# Tables that a file may have several of.
_LISTS: Final = ("sensor", "ply")


def _tables() -> dict[str, str]:
    """Which single table a key belongs in, for keys that only one table has."""
    homes: dict[str, list[str]] = {}
    for table in PlateFile.model_fields:
        for key in _keys_of(PlateFile, (table,)) + _keys_of(PlateFile, (table, 0)):
            homes.setdefault(key, []).append(f"[[{table}]]" if table in _LISTS else f"[{table}]")
    homes |= {key: ["the top of the file"] for key in PlateFile.model_fields if key not in homes}
    return {key: places[0] for key, places in homes.items() if len(places) == 1}


_TABLE_OF: Final = _tables()
