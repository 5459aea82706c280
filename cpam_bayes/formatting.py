"""How numbers are written: as many digits as they are worth."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence

NOT_KNOWN = "-"
# Probabilities below this have digits that depend on the processor.
LEAST_PROBABILITY = 1e-12
# Characters of a name that a file name may not have anywhere, or may not everywhere.
_NOT_IN_FILES = re.compile(r"[^\w.&()+-]+")
_LONGEST_STEM = 80


def file_stem(name: str) -> str:
    """A name that people gave as a file name without ending: what no file system takes becomes "_"."""
    return _NOT_IN_FILES.sub("_", name).strip("._ ")[:_LONGEST_STEM] or "plate"


def fixed(value: float, decimals: int) -> str:
    """A number with so many decimals, without a minus before zero."""
    text = f"{value:.{decimals}f}"
    return text.removeprefix("-") if float(text) == 0.0 else text


def signed(value: float, decimals: int) -> str:
    """A number with so many decimals and its sign, that of zero being plus."""
    text = fixed(value, decimals)
    return text if text.startswith("-") else f"+{text}"


def probable(p: float) -> str:
    """A probability with three digits; what no computation tells from zero is said to be less than 1e-12."""
    return f"{p:.3g}" if p >= LEAST_PROBABILITY else f"< {LEAST_PROBABILITY:g}"


def significant(value: float, digits: int = 4) -> str:
    """A number with so many significant digits, trailing zeros included."""
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
    """Names with commas, and a word before the last."""
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} {word} {names[-1]}"
