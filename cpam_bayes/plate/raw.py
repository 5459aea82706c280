"""Looking at the raw tables of a plate file without trusting them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from cpam_bayes.plate.problems import Problem
from cpam_bayes.plate.schema import is_hybrid

Data = Mapping[str, Any]
Problems = Iterator[Problem]


def table(data: Data, *path: str) -> Data:
    """The table at a path, empty when it is missing or no table."""
    for key in path:
        inner = data.get(key)
        data = inner if isinstance(inner, dict) else {}
    return data


def per_material(data: Data) -> Iterator[tuple[str, Data]]:
    """The file as if each material were its only one, by name; "" and the file where there is but one."""
    material = data.get("material")
    if not is_hybrid(material):
        yield "", data
        return
    for name, part in table(data, "material").items():
        yield name, {**data, "material": part, "unknowns": table(data, "unknowns", name)}


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
