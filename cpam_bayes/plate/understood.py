"""Values as users write them, made those of the schema: numbers with units or commas, edges in words, lists.

Only what can mean one thing is changed; all else is left to the schema, which refuses it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, Final

from cpam_bayes.plate.edges import letters_of

__all__ = ["UNITS", "number_of", "numbers_of", "understood"]

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
"""Ending of a key -> the units that a text may have instead, and their factor; the first that fits counts."""
_LISTS: Final = ("frequencies_hz", "frequency_sd_hz")
_LAYUPS: Final = ("layup", "sequence_layup")
_NUMBER: Final = re.compile(r"\s*([+-]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][+-]?\d+)?)\s*(\S.*?)?\s*")
# As many digits after a comma as thousands have, and a number before it: 1,234 may be either.
_THOUSANDS: Final = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}")
# Between numbers: spaces, a semicolon, a comma before a space, a sign of multiplication.
_BETWEEN: Final = re.compile(r"(?:\s*[;x*\N{MULTIPLICATION SIGN}]\s*|,?\s+)", re.IGNORECASE)
# Tables in tables of a plate file, and its priors, are no deeper.
_DEEPEST: Final = 5


def number_of(text: str, units: Mapping[str, float] | None = None) -> float | None:
    """A number with a point or a comma and perhaps a unit; None where it is none, or may be two."""
    match = _NUMBER.fullmatch(text)
    if match is None or _THOUSANDS.fullmatch(match[1]):
        return None
    factor = 1.0 if match[2] is None else (units or {}).get(match[2].casefold())
    value = float(match[1].replace(",", "."))
    # 9.8 mm are no 9.799999999999999 mm: a factor below 1 divides
    return None if factor is None else value * factor if factor >= 1.0 else value / round(1.0 / factor)


def numbers_of(text: str) -> tuple[float, ...] | None:
    """Numbers with points or, all of them, with commas; None for anything else.

    One number alone with a comma may be two.
    """
    parts = _BETWEEN.split(text.strip())
    if ("." in text and any("," in part for part in parts)) or (len(parts) == 1 and "," in text):
        return None
    values = [number_of(part) for part in parts]
    return None if None in values else tuple(value for value in values if value is not None)


def understood(data: Mapping[str, Any], depth: int = 0) -> dict[str, Any]:
    """The content of a plate file, or of a table in it, with the values that the schema has for them."""
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
    """A number, a list of numbers or a prior."""
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
