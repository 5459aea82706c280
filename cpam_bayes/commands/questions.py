"""What `new` asks at a terminal: one line a question, an empty line for what is not known."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from cpam_bayes.commands import MATERIALS

Given = dict[str, Any]

# Typed in place of an answer, it takes the one before back.
_BACK: Final = "<"
# Between numbers: spaces, a semicolon, a comma before a space, a sign of multiplication.
_BETWEEN: Final = re.compile(r"(?:\s*[;x*\N{MULTIPLICATION SIGN}]\s*|,?\s+)", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Question:
    """A line that is asked for.

    key : the argument of `cpam_bayes.new` that it fills
    read : the line to its value; raises ValueError for what it is not
    """

    key: str
    text: str
    read: Callable[[str], Any]


def _numbers(text: str) -> tuple[float, ...]:
    """Numbers with points or, all of them, with commas; one alone with a comma may be two, and is refused."""
    parts = _BETWEEN.split(text.strip())
    both = "." in text and any("," in part for part in parts)
    try:
        if both or (len(parts) == 1 and "," in text):
            raise ValueError
        return tuple(_number(part) for part in parts)
    except ValueError:
        raise ValueError(
            f"received {text!r}, accepted: numbers with spaces between them, such as 310 228 3.1"
        ) from None


def _number(text: str) -> float:
    try:
        return float(text.replace(",", "."))
    except ValueError:
        raise ValueError(f"received {text!r}, accepted: one number, such as 340.7") from None


def _material(text: str) -> str:
    return text.casefold()


QUESTIONS: Final = (
    Question("size_mm", "Length (along x), width and thickness in mm, such as 310 228 3.1", _numbers),
    Question("mass_g", "Mass of the bare plate in g", _number),
    Question("material", f"Material, one of {' '.join(MATERIALS)}; left empty: {MATERIALS[0]}", _material),
    Question("layup", 'Layup in degrees, bottom to top, such as [0/90]_2s or [0_8]; "?" is unknown', str),
    Question(
        "edges", "Edges x=0, y=0, x=length, y=width: F free, S supported, C clamped, such as FFFF", str.upper
    ),
    Question("table", "Table of measured modes, its path from the plate file; left empty: asked next", str),
    Question("frequencies_hz", "Measured frequencies in Hz, ascending, with spaces between them", _numbers),
)


def asked(check: Callable[[Given], object]) -> Given:
    """What a user at a terminal knows of a plate, as arguments of `cpam_bayes.new`.

    check : raises ValueError for what cannot be; the question is then asked again
    """
    print(
        f"What is known of the plate? An empty line for what is not; {_BACK} takes the answer before back; "
        "Ctrl-C ends.",
        file=sys.stderr,
    )
    at, before = 0, [Given()]  # what was known before each of the questions so far
    while at < len(QUESTIONS):
        given = before[at]
        answered = given if _left_out(QUESTIONS[at], given) else _answer(QUESTIONS[at], given, check)
        if answered is None:
            at = max((i for i in range(at) if not _left_out(QUESTIONS[i], before[i])), default=0)
            continue
        at += 1
        before[at:] = [answered]
    return before[-1]


def _left_out(question: Question, given: Given) -> bool:
    """Whether what was said answers the question already."""
    of_metal = question.key == "layup" and given.get("material") == "metal"
    return of_metal or (question.key == "frequencies_hz" and "table" in given)


def _answer(question: Question, given: Given, check: Callable[[Given], object]) -> Given | None:
    """What is known with the answer, None where the answer before is to be given again."""
    while True:
        print(f"{question.text}: ", end="", file=sys.stderr, flush=True)
        try:
            text = input().strip()
        except EOFError:
            raise ValueError("the questions were not answered to the end; nothing is written") from None
        if not text:
            return given
        if text == _BACK:
            return None
        try:
            told = {**given, question.key: question.read(text)}
            check(told)
        except ValueError as error:
            back = f" ({_BACK} goes back to the answer before)" if given else ""
            print(f"  {error}{back}", file=sys.stderr)
        else:
            return told
