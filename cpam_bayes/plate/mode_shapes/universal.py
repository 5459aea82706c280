"""Modes of a universal file, read by pyuff: datasets 55, 15 or 2411, and 164."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray

__all__ = ["UniversalFileError", "UniversalMode", "UniversalModes", "pyuff", "read_sets", "universal_modes"]

Array = NDArray[Any]

# Datasets of nodes with their places, of a shape, and of units.
_NODES, _SHAPE, _UNITS = (15, 2411), 55, 164
# Analyses of a dataset 55 that are modes: normal ones, complex ones of displacement and of velocity.
_NORMAL, _COMPLEX = 2, (3, 7)
# What stands before and after each dataset, and how many datasets a file may have.
_MARK: Final = b"    -1"
_MARK_LINE: Final = re.compile(rb"^ {4}-1[ \t]*\r?$", re.MULTILINE)
_MOST_SETS: Final = 10_000
# Numbers of nodes have ten columns. What is beyond the size leaves the range of squares and their sums.
_MOST_NODE: Final = 10**10
_MOST_SIZE: Final = 1e100
# Units of length from a thousandth of a nanometre to a terametre.
_LEAST_FACTOR: Final = 1e-12
_MISSING: Final = 'universal files need the library pyuff, accepted: pip install "cpam-bayes[uff]"'


class UniversalFileError(ValueError):
    """A universal file that holds no mode shapes, or cannot be read."""


@dataclass(frozen=True, slots=True, eq=False)
class UniversalMode:
    """One mode of a dataset 55.

    frequency : Hz
    damping : ratio to critical damping, nan where it is not given
    nodes : (n,) numbers
    values : (3, n) displacements along x, y and z, of any scale, real or complex
    """

    frequency: float
    damping: float
    nodes: Array
    values: Array


@dataclass(frozen=True, slots=True, eq=False)
class UniversalModes:
    """The modes of a universal file, ascending, and its nodes.

    places : coordinates (3,) by node, in the file's unit of length
    unit : m, None where the file has no dataset 164
    datasets : types of the datasets that were read
    """

    modes: tuple[UniversalMode, ...]
    places: Mapping[int, Array]
    unit: float | None
    datasets: tuple[int, ...]


def pyuff() -> ModuleType:
    """The library; raises ``UniversalFileError`` where it is not installed."""
    with warnings.catch_warnings():  # it changes the filters of its importer
        try:
            import pyuff as library
        except ImportError:
            raise UniversalFileError(_MISSING) from None
    return cast(ModuleType, library)


def read_sets(content: bytes, types: Sequence[int]) -> list[Mapping[str, Any]]:
    """The datasets of some types of a universal file; others need not be readable.

    Raises ``UniversalFileError`` where pyuff is missing or cannot read one of them.
    """
    library = pyuff()
    marks = content.count(_MARK)
    if marks > 2 * _MOST_SETS:
        raise UniversalFileError(f"received {marks // 2} datasets, accepted: {_MOST_SETS} at most")
    _require_whole(content)
    with TemporaryDirectory() as directory:
        path = Path(directory) / "file.unv"
        path.write_bytes(content)
        try:
            file = library.UFF(str(path))
            found = [int(kind) for kind in file.get_set_types()]
        except Exception as error:  # noqa: BLE001 - pyuff raises Exception itself
            raise UniversalFileError(f"not a universal file: {error}") from None
        sets: list[Mapping[str, Any]] = []
        for i, kind in enumerate(found):
            if kind not in types:
                continue
            try:
                sets.append({**file.read_sets(i), "type": kind})
            except Exception:  # noqa: BLE001 - pyuff raises Exception itself, which says nothing more
                raise UniversalFileError(
                    f"dataset {i + 1}, of type {kind}: cannot be read, accepted: the columns of its format"
                ) from None
    return sets


def _require_whole(content: bytes) -> None:
    """Raise ``UniversalFileError`` where the last dataset has no end, which pyuff passes over."""
    marks = list(_MARK_LINE.finditer(content))
    if len(marks) % 2 and content[marks[-1].end() :].strip():
        line = content.count(b"\n", 0, marks[-1].start()) + 1
        raise UniversalFileError(
            f"cut short: the dataset that begins at line {line} has no end, accepted: whole files, in which "
            "a line -1 ends each dataset"
        )


def universal_modes(content: bytes) -> UniversalModes:
    """The modes of a universal file: every dataset 55 of a normal or a complex mode above 0 Hz.

    Damping is the viscous ratio, or half the hysteretic one; of a complex mode with the eigenvalue s it is
    -Re s / |s|, and the frequency |s| / 2 pi. A dataset 151 is not needed, and 164 may be missing.

    Raises ``UniversalFileError`` where there are no modes or no nodes.
    """
    sets = read_sets(content, (*_NODES, _SHAPE, _UNITS))
    modes = [mode for one in sets if one["type"] == _SHAPE and (mode := _mode(one)) is not None]
    if not modes:
        raise UniversalFileError("no modes, accepted: datasets 55 of normal or complex modes")
    places: dict[int, Array] = {}
    for one in sets:
        if one["type"] in _NODES:
            nodes, coordinates = _of_nodes(one, "xyz")
            places |= dict(zip(nodes.tolist(), coordinates.T, strict=True))
    if not places:
        raise UniversalFileError("no nodes, accepted: a dataset 15 or 2411 beside the modes")
    factors = [float(one["length"]) for one in sets if one["type"] == _UNITS]
    if factors and not _LEAST_FACTOR < factors[0] < 1.0 / _LEAST_FACTOR:
        raise UniversalFileError(
            f"dataset 164: received a factor of length of {factors[0]:g}, accepted: {_LEAST_FACTOR:g} to "
            f"{1.0 / _LEAST_FACTOR:g}"
        )
    return UniversalModes(
        modes=tuple(sorted(modes, key=lambda mode: mode.frequency)),
        places=places,
        unit=1.0 / factors[0] if factors else None,
        datasets=tuple(sorted({int(one["type"]) for one in sets})),
    )


def _mode(one: Mapping[str, Any]) -> UniversalMode | None:
    """The mode of a dataset 55, None of one that is no mode: a forced response, or a rigid-body motion."""
    kind = one.get("analysis_type")
    if kind == _NORMAL:
        frequency, damping = float(one["freq"]), _damping_of(one)
    elif kind in _COMPLEX:
        eigenvalue = complex(one["eig"])
        size = abs(eigenvalue)
        frequency, damping = size / (2.0 * np.pi), -eigenvalue.real / size if size else np.nan
    else:
        return None
    if not (np.isfinite(frequency) and frequency > 0.0):
        return None
    nodes, values = _of_nodes(one, ("r1", "r2", "r3"))
    return UniversalMode(frequency, damping if 0.0 < damping < 1.0 else np.nan, nodes, values)


def _of_nodes(one: Mapping[str, Any], names: Sequence[str]) -> tuple[Array, Array]:
    """The nodes (n,) of a dataset and what it has for each, (len(names), n)."""
    of = f"a dataset {one['type']}"
    numbers, columns = np.asarray(one["node_nums"], dtype=float), [np.asarray(one[name]) for name in names]
    if any(column.shape != numbers.shape for column in columns):
        raise UniversalFileError(f"{of} that ends within a node, accepted: whole datasets")
    values = np.stack(columns)
    if not np.all(np.abs(values) < _MOST_SIZE):
        raise UniversalFileError(
            f"{of} has values that are no numbers, accepted: numbers up to {_MOST_SIZE:g}"
        )
    if not np.all((numbers >= 0.0) & (numbers < _MOST_NODE) & (numbers % 1.0 == 0.0)):
        raise UniversalFileError(f"{of} has nodes that are no whole numbers, accepted: 0 to {_MOST_NODE - 1}")
    return numbers.astype(int), values


def _damping_of(one: Mapping[str, Any]) -> float:
    viscous, hysteretic = (float(one.get(f"modal_damp_{kind}") or 0.0) for kind in ("vis", "his"))
    return viscous or 0.5 * hysteretic
