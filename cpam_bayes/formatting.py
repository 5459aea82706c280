"""Number formatting, with as many digits as are significant."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence

NOT_KNOWN = "-"
# Probabilities below this have digits that depend on the processor.
LEAST_PROBABILITY = 1e-12
# Characters that all or some file systems refuse in a file name.
_NOT_IN_FILES = re.compile(r"[^\w.&()+-]+")
_LONGEST_STEM = 80


def file_stem(name: str) -> str:
    """A user's name as a file name without suffix; characters that file systems refuse become "_"."""
    return _NOT_IN_FILES.sub("_", name).strip("._ ")[:_LONGEST_STEM] or "plate"


def fixed(value: float, decimals: int) -> str:
    """A number with the given decimals, without a minus sign before zero."""
    text = f"{value:.{decimals}f}"
    return text.removeprefix("-") if float(text) == 0.0 else text


def signed(value: float, decimals: int) -> str:
    """A number with the given decimals and its sign; zero has a plus."""
    text = fixed(value, decimals)
    return text if text.startswith("-") else f"+{text}"


def probable(p: float) -> str:
    """A probability to three digits; values indistinguishable from zero are shown as below 1e-12."""
    return f"{p:.3g}" if p >= LEAST_PROBABILITY else f"< {LEAST_PROBABILITY:g}"


def significant(value: float, digits: int = 4) -> str:
    """A number to the given significant digits, trailing zeros included."""
    if not math.isfinite(value):
        return NOT_KNOWN
    if value == 0.0:
        return "0"
    power = math.floor(math.log10(abs(float(f"{value:.{digits - 1}e}"))))
    if not -4 <= power < 7:
        return f"{value:.{digits - 1}e}"
    decimals = digits - 1 - power
    return f"{value:.{decimals}f}" if decimals >= 0 else f"{round(value, decimals):.0f}"


def with_spread(value: float, sd: float) -> tuple[str, str]:
    """A value and its standard deviation, to two significant digits of the latter."""
    if not (math.isfinite(sd) and sd > 0.0):
        return significant(value), NOT_KNOWN
    decimals = 1 - math.floor(math.log10(float(f"{sd:.1e}")))
    if not 0 <= decimals <= 6:
        return significant(value, 6 if decimals > 6 else 4), significant(sd, 2)
    return fixed(value, decimals), fixed(sd, decimals)


def decimals_of(values: Iterable[float]) -> int:
    """The decimals that a list of numbers was written with, six at most."""
    parts = (f"{value:.6f}".rstrip("0").partition(".")[2] for value in values)
    return max((len(part) for part in parts), default=0)


def listed(names: Sequence[str], word: str) -> str:
    """Names joined by commas, with a word such as "and" before the last."""
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} {word} {names[-1]}"
