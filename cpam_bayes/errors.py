"""User errors: in plate files and layups, and arguments of a wrong type."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache, wraps
from inspect import Parameter, signature
from numbers import Integral, Real
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Final, Literal, ParamSpec, TypeVar, Union, get_args, get_origin, get_type_hints

_WINDOW = 60


class PlateFileError(ValueError):
    """All errors of one plate file, one problem per line.

    problems : each "file:line: key: what was wrong, the value received, what is accepted"
    gaps : the problems that only report a missing value
    found : (problem, path of its key, phrase without the place) for the problems of a key
    source : the file
    choices : headings of its table that may be the frequencies, where nothing else is wrong
    """

    def __init__(
        self,
        *problems: str,
        gaps: tuple[str, ...] = (),
        found: tuple[tuple[str, tuple[str | int, ...], str], ...] = (),
        source: str = "",
        choices: tuple[str, ...] = (),
    ) -> None:
        super().__init__(*problems)
        self.gaps = gaps
        self.found = found
        self.source = source
        self.choices = choices

    @property
    def problems(self) -> tuple[str, ...]:
        """The problems in the order of their lines."""
        return tuple(str(problem) for problem in self.args)

    def __str__(self) -> str:
        return "\n".join(self.problems)


class LowFrequencyError(PlateFileError):
    """First frequencies far below any mode of the plate as its file states it."""


class ArgumentError(TypeError, ValueError):
    """An argument of a type that a function does not take."""

    def __init__(self, name: str, received: str, accepted: str) -> None:
        super().__init__(name, received, accepted)

    def __str__(self) -> str:
        name, received, accepted = self.args
        return f"{name}: received {received}, accepted: {accepted}"


class LayupError(ValueError):
    """A layup that cannot be read, with the place where reading stopped."""

    def __init__(self, text: str, position: int, what: str) -> None:
        super().__init__(text, position, what)

    @property
    def text(self) -> str:
        """The layup as received."""
        return str(self.args[0])

    @property
    def position(self) -> int:
        """Index into the text, from 0."""
        return int(self.args[1])

    @property
    def what(self) -> str:
        """The problem, and the values that are accepted."""
        return str(self.args[2])

    def __str__(self) -> str:
        shown, caret = _excerpt(self.text, self.position)
        return f"{self.what} (character {self.position + 1})\n  {shown}\n  {' ' * caret}^"


def _excerpt(text: str, position: int) -> tuple[str, int]:
    """Cut a long text around `position`; unprintable characters would move the caret."""
    start = max(0, position - _WINDOW) if len(text) > 2 * _WINDOW else 0
    stop = min(len(text), position + _WINDOW) if len(text) > 2 * _WINDOW else len(text)
    shown = "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in text[start:stop])
    head = "..." if start else ""
    tail = "..." if stop < len(text) else ""
    return f"{head}{shown}{tail}", len(head) + position - start


P = ParamSpec("P")
R = TypeVar("R")

_WORDS: Final[dict[Any, str]] = {
    int: "a whole number",
    float: "a number",
    bool: "True or False",
    str: "a text",
    Path: "a path",
    os.PathLike: "a path",
    Mapping: "a mapping",
    NoneType: "None",
}
_MAX_SHOWN: Final = 60


def checked(verb: Callable[P, R]) -> Callable[P, R]:
    """Wrap a function to reject arguments whose type does not match the annotation.

    Raises ``ArgumentError``, a ``TypeError`` and ``ValueError``, with the name of the argument, what was
    received and what is accepted. Values are left to the function.
    """

    @cache
    def annotations() -> tuple[Mapping[str, Any], Mapping[str, Parameter]]:
        return get_type_hints(verb), signature(verb).parameters

    @wraps(verb)
    def refusing(*args: P.args, **kwargs: P.kwargs) -> R:
        hints, parameters = annotations()
        for name, value in _given(parameters, args, kwargs):
            hint = hints.get(name, Any)  # self has none
            if not _fits(value, hint):
                accepted = " or ".join(dict.fromkeys(_words(hint)))
                one = f"; one is written as [{_shown(value)}]" if _fits([value], hint) else ""
                raise ArgumentError(name, _shown(value), accepted + one)
        return verb(*args, **kwargs)

    return refusing


def _given(
    parameters: Mapping[str, Parameter], args: Sequence[Any], kwargs: Mapping[str, Any]
) -> Iterator[tuple[str, Any]]:
    """Names and values of the arguments given; missing ones are left to Python."""
    places = [p for p in parameters.values() if p.kind is not Parameter.KEYWORD_ONLY]
    for i, value in enumerate(args):
        if i < len(places):
            yield places[i].name, value
        elif places and places[-1].kind is Parameter.VAR_POSITIONAL:
            yield places[-1].name, value
    yield from ((name, value) for name, value in kwargs.items() if name in parameters)


def _fits(value: object, hint: Any) -> bool:
    """Whether a value matches an annotation."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        return any(_fits(value, option) for option in inner)
    if origin is Literal:
        return isinstance(value, str)
    if origin in (Sequence, tuple):
        kind: Any = tuple if origin is tuple else Sequence
        listed = isinstance(value, kind) or (origin is Sequence and hasattr(value, "__array__"))
        return listed and not isinstance(value, str | bytes) and all(_fits(v, inner[0]) for v in value)  # type: ignore[attr-defined]
    kind = origin or hint
    if kind is Any:
        return True
    if kind is bool:
        return isinstance(value, bool) or type(value).__name__ == "bool"  # numpy's own
    if kind in (int, float):
        return isinstance(value, Integral if kind is int else Real) and not isinstance(value, bool)
    if getattr(kind, "_is_protocol", False):
        return all(hasattr(value, name) for name in vars(kind) if not name.startswith("_"))
    return isinstance(value, kind)


def _words(hint: Any) -> Iterator[str]:
    """The values that an annotation accepts, in words."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        for option in inner:
            yield from _words(option)
    elif origin is Literal:
        yield " ".join(map(str, inner))
    elif origin in (Sequence, tuple):
        (words,) = set(_words(inner[0]))
        yield f"a {'tuple' if origin is tuple else 'sequence'} of which each is {words}"
    else:
        kind = origin or hint
        yield _WORDS.get(kind, f"a {kind.__name__}" if hasattr(kind, "__name__") else str(kind))


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= _MAX_SHOWN else f"{text[:_MAX_SHOWN]}... ({type(value).__name__})"
