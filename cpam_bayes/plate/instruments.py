"""Instrument and spreadsheet files: .csv with any separator, .xlsx, universal files with mode shapes.

pyuff reads datasets 55, 15 or 2411, and 164; whatever a file's unit and origin, shapes are placed in metres
from the corner x = y = 0.
"""

from __future__ import annotations

import csv
import io
import math
import re
import warnings
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.plate.records import MeasuredShapes
from cpam_bayes.plate.schema import MAX_FREQUENCIES
from cpam_bayes.plate.text import Data, Problem, as_utf_8, number, read_named_file, table

_SEPARATORS: Final = ("\t", ";", ",", "|", "  ", " ")
# Two spaces or more: the headings of columns may then contain single spaces.
_WIDE, _SPACES = re.compile(" {2,}"), ("  ", " ")
_DECLARED: Final = "sep="
_COMMENTS: Final = ("#", "%")
# Non-breaking spaces.
_WIDTHS: Final = re.compile("[\N{NO-BREAK SPACE}\N{THIN SPACE}\N{NARROW NO-BREAK SPACE}]")
# Headings are in one of the first lines, and no longer than this.
_LINES_ABOVE, _LONGEST_HEADS = 1000, 100_000


@dataclass(frozen=True, slots=True)
class Row:
    """One line of a table: its number, from 1, and a cell for each column, "" where it has none."""

    line: int
    cells: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Delimited:
    """A table: its headings, on line ``line``, and the rows below; separator : between the cells."""

    line: int
    heads: tuple[str, ...]
    rows: tuple[Row, ...]
    separator: str


class SheetError(ValueError):
    """A workbook that cannot be read."""


# Most rows and columns of a sheet that are read; more is no list of modes.
_MOST_ROWS: Final = 10_000
_MOST_COLUMNS: Final = 500
# Most bytes of an unpacked workbook: a small file can be built to fill the memory.
_MOST_UNPACKED: Final = 50_000_000
_ZIP, _OLD_EXCEL = b"PK\x03\x04", b"\xd0\xcf\x11\xe0"


def sheets(content: bytes) -> Mapping[str, str]:
    """Texts of a file's tables: of a .csv under "", of an .xlsx by the names of its sheets.

    The sheet that was active when the file was saved comes first.

    raises SheetError for a workbook that cannot be read
    """
    if content.startswith(_OLD_EXCEL):
        raise SheetError("an .xls file or one with a password, accepted: .xlsx or .csv")
    if not content.startswith(_ZIP):
        return {"": decode(content)}
    try:
        import openpyxl  # for workbooks alone
    except ImportError:
        raise SheetError("a workbook, which openpyxl reads: install openpyxl, or save it as .csv") from None
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            unpacked = sum(part.file_size for part in archive.infolist())
        if unpacked > _MOST_UNPACKED:
            raise SheetError(f"too large, {unpacked} bytes unpacked, accepted: up to {_MOST_UNPACKED}")
        book = openpyxl.load_workbook(io.BytesIO(content), read_only=True, data_only=True)
        shown = sorted(book.worksheets, key=lambda sheet: sheet is not book.active)
        found = [sheet.iter_rows(max_row=_MOST_ROWS, max_col=_MOST_COLUMNS) for sheet in shown]
        texts = ("\n".join("\t".join(map(_cell, row)) for row in rows) for rows in found)
        return dict(zip((str(sheet.title) for sheet in shown), texts, strict=True))
    except SheetError:
        raise
    except Exception:  # noqa: BLE001 - openpyxl and zipfile raise many kinds for what is no workbook
        raise SheetError("no workbook that can be read, accepted: .xlsx or .csv") from None


def _cell(cell: Any) -> str:
    """The text of a cell of a sheet; numbers to 12 digits, in per cent where so formatted."""
    value = cell.value
    if isinstance(value, int | float) and "%" in cell.number_format:
        return f"{100.0 * value:.12g}%"
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.12g}" if math.isfinite(value) else ""
    text = value.isoformat() if isinstance(value, date) else str(value)
    return " ".join(text.replace('"', " ").split())


def decode(content: bytes) -> str:
    """The text of a file that a spreadsheet saved: UTF-8, UTF-16, or Windows-1252."""
    content = as_utf_8(content)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("cp1252", errors="replace")


def read_delimited(text: str, is_header: Callable[[Sequence[str]], bool]) -> Delimited | None:
    """The table below the first line of headings of a text; None where the first 1000 lines have none."""
    return next(delimited(text, is_header), None)


def delimited(text: str, is_header: Callable[[Sequence[str]], bool]) -> Iterator[Delimited]:
    """Candidate tables, one for each line of headings among the first 1000 lines of a text.

    Empty lines, lines of dashes and comments (# or %) are skipped, and a line "sep=;" sets the separator.
    A line with any other separator is not split at spaces.

    is_header : whether cells are the headings of the table sought
    """
    lines = text.splitlines()
    separators: tuple[str, ...] = _SEPARATORS
    for i, line in enumerate(lines[:_LINES_ABOVE]):
        if len(line) > _LONGEST_HEADS:
            continue
        if line.strip().casefold().startswith(_DECLARED) and len(line.strip()) > len(_DECLARED):
            separators = (line.strip()[len(_DECLARED)],)
            continue
        for separator in separators:
            if separator in _SPACES and any(other in line for other in _SEPARATORS if other not in _SPACES):
                continue
            heads = _cells(line, separator)
            # words of one heading may be as many spaces apart as headings are
            below = next(_rows(lines, i + 1, separator, 0), None) if separator == " " else None
            if is_header(heads) and (below is None or len(below.cells) == len(heads)):
                rows = tuple(_rows(lines, i + 1, separator, len(heads)))
                yield Delimited(i + 1, tuple(heads), rows, separator)
                break


def _rows(lines: Sequence[str], first: int, separator: str, n_columns: int) -> Iterator[Row]:
    for at, line in enumerate(lines[first:], start=first + 1):
        if not line:
            continue
        cells = _cells(line, separator)
        if not re.search(r"\w", line) or not any(cells) or line.lstrip().startswith(_COMMENTS):
            continue
        if separator == "  " and len(cells) != n_columns:
            cells = _cells(line, " ")
        yield Row(at, (*cells, *[""] * (n_columns - len(cells))))


def _cells(line: str, separator: str) -> list[str]:
    # spaces at the ends of a line separate nothing, tabs there are empty cells
    stripped = line.strip(" \r\n")
    try:
        if separator == "  ":
            return _WIDE.split(stripped)
        split = next(csv.reader([stripped], delimiter=separator, skipinitialspace=True), [])
    except csv.Error:  # a line without an end to its quotes or cells
        return []
    cells = [_WIDTHS.sub(" ", cell).strip() for cell in split]
    while cells and not cells[-1]:
        cells.pop()
    return cells


Array = NDArray[Any]

# Datasets of node coordinates, of a shape, and of units.
_NODES, _SHAPE, _UNITS = (15, 2411), 55, 164
# Analysis types of a dataset 55 that are modes: normal, complex of displacement, complex of velocity.
_NORMAL, _COMPLEX = 2, (3, 7)
# The delimiter of datasets, and the most datasets that a file may have.
_MARK: Final = b"    -1"
_MARK_LINE: Final = re.compile(rb"^ {4}-1[ \t]*\r?$", re.MULTILINE)
_MOST_SETS: Final = 10_000
# Node numbers have ten columns. Squares of values beyond the size, or their sums, may overflow.
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
    """The library pyuff; raises ``UniversalFileError`` where it is not installed."""
    with warnings.catch_warnings():  # it changes the filters of its importer
        try:
            import pyuff as library
        except ImportError:
            raise UniversalFileError(_MISSING) from None
    return cast(ModuleType, library)


def read_sets(content: bytes, types: Sequence[int]) -> list[Mapping[str, Any]]:
    """The datasets of the given types in a universal file; others need not be readable.

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
    """Raise ``UniversalFileError`` where the last dataset is unterminated, which pyuff ignores."""
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
    """The mode of a dataset 55, None if it is no mode: a forced response, or a rigid-body motion."""
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
    """The node numbers (n,) of a dataset and its values at them, (len(names), n)."""
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


# Units that a file without dataset 164 may have, m; the largest that fits the plate is taken.
_POSSIBLE_UNITS: Final = (1.0, 1e-3)
# Most that a node may lie beyond an edge, and least span of the nodes, as fractions of a side.
_BEYOND, _LEAST_SPAN = 0.02, 0.1
_MIN_NODES: Final = 3


def placed_shapes(modes: UniversalModes, length: float, width: float) -> tuple[MeasuredShapes, str]:
    """Shapes at the nodes common to all modes, on a plate of length by width, m; and the placement in words.

    The unit is that of dataset 164, or else the larger one of m and mm with which the nodes lie on the
    plate. The origin is the corner x = y = 0, or the middle of the plate. Raises ``UniversalFileError``
    where the nodes cannot be placed so.
    """
    numbers = [one.nodes for one in modes.modes]
    nodes = np.array(sorted(set.intersection(*(set(n.tolist()) for n in numbers))), dtype=int)
    unplaced = [str(node) for node in nodes if int(node) not in modes.places]
    if unplaced:
        listed = " ".join(unplaced[:6])
        raise UniversalFileError(f"no coordinates of the nodes {listed}, accepted: dataset 15 or 2411 of all")
    if len(nodes) < _MIN_NODES:
        raise UniversalFileError(
            f"{len(nodes)} nodes that all modes have, accepted: {_MIN_NODES} or more, best along all edges"
        )
    places = np.stack([modes.places[int(node)] for node in nodes])
    points, words = _on_plate(places, modes.unit, np.array([length, width]))
    values = np.stack([one.values[:, _columns(one.nodes, nodes)] for one in modes.modes])
    if not np.all(np.any(values != 0.0, axis=(1, 2))):
        raise UniversalFileError("a mode that moves at no node, accepted: a shape of every mode")
    return MeasuredShapes(nodes, points, values), f"{len(nodes)} nodes in {words}"


def _columns(numbers: Array, wanted: Array) -> Array:
    order = np.argsort(numbers, kind="stable")
    return np.asarray(order[np.searchsorted(numbers[order], wanted)])


def _on_plate(places: Array, unit: float | None, sides: Array) -> tuple[Array, str]:
    """Points (n, 2), m from the corner, of places (n, 3); and unit and origin in words."""
    for one in _POSSIBLE_UNITS if unit is None else (unit,):
        scaled = one * places
        if np.ptp(scaled[:, 2]) > _LEAST_SPAN * sides.max():
            continue
        for origin, shift in (("the corner", 0.0 * sides), ("the middle", 0.5 * sides)):
            points = scaled[:, :2] + shift
            inside = np.all((points >= -_BEYOND * sides) & (points <= (1.0 + _BEYOND) * sides))
            if inside and np.any(np.ptp(points, axis=0) > _LEAST_SPAN * sides):
                stated = "" if unit is not None else ", by the size of the plate"
                return np.clip(points, 0.0, sides), f"{_unit_name(one)}{stated}, from {origin}"
    raise UniversalFileError(_off_plate(places, unit, sides))


def _off_plate(places: Array, unit: float | None, sides: Array) -> str:
    spans = " ".join(
        f"{axis} {low:.4g} to {high:.4g}"
        for axis, low, high in zip("xyz", places.min(axis=0), places.max(axis=0), strict=True)
    )
    of = "without a dataset 164" if unit is None else f"in {_unit_name(unit)} by dataset 164"
    return (
        f"nodes that do not lie on the plate, received {spans}, {of}, accepted: the plane z = 0 with x "
        f"from 0 to {1e3 * sides[0]:g} mm and y from 0 to {1e3 * sides[1]:g} mm, or as much about the middle"
    )


def _unit_name(unit: float) -> str:
    names: Sequence[tuple[float, str]] = (
        (1.0, "m"),
        (1e-3, "mm"),
        (1e-2, "cm"),
        (0.0254, "in"),
        (0.3048, "ft"),
    )
    return next((name for size, name in names if abs(unit / size - 1.0) < 1e-3), f"units of {unit:g} m")


_KEY: Final = ("measurement", "shapes")
MAX_UNIVERSAL_BYTES: Final = 20_000_000
"""The size of a file of 100 modes at 3000 nodes, which is read in some seconds."""


@dataclass(frozen=True, slots=True, eq=False)
class ShapeModes:
    """The modes of a universal file, ascending.

    frequencies : (n,) Hz
    damping : (n,) ratios, nan where there is none; None where no mode has one
    origin : what was read, in words
    """

    frequencies: NDArray[np.float64]
    damping: NDArray[np.float64] | None
    shapes: MeasuredShapes
    origin: str

    def fields(self, name: str) -> dict[str, Any]:
        """The fields of a `Measurement` that the file gives; name : of the file, as in the plate file."""
        return {
            "frequencies": self.frequencies,
            "labels": ("",) * len(self.frequencies),
            "damping": self.damping,
            "shapes": self.shapes,
            "origin": f"{name}: {self.origin}",
        }


def shapes_of(data: Data, directory: Path | None) -> tuple[ShapeModes | None, list[Problem]]:
    """The modes of the universal file that a plate file names, and its problems.

    directory : base of relative paths
    """
    name = table(data, "measurement").get("shapes")
    if not isinstance(name, str) or not name:
        return None, []
    content, problems = read_named_file(
        _KEY, name, directory, "a universal file of modes", MAX_UNIVERSAL_BYTES
    )
    plate = table(data, "plate")
    length, width = (number(plate, key) for key in ("length_mm", "width_mm"))
    if content is None or length is None or width is None or min(length, width) <= 0.0:
        return None, problems
    try:
        return read_shapes(content, 1e-3 * length, 1e-3 * width), []
    except UniversalFileError as error:
        return None, [Problem(_KEY, f"{Path(name).name}: {error}")]


def read_shapes(content: bytes, length: float, width: float) -> ShapeModes:
    """The modes of a universal file on a plate of length by width, m.

    Raises ``UniversalFileError`` where there are none, or where their nodes cannot be placed.
    """
    found = universal_modes(content)
    if len(found.modes) > MAX_FREQUENCIES:
        raise UniversalFileError(f"too many modes, received {len(found.modes)}, accepted: {MAX_FREQUENCIES}")
    shapes, where = placed_shapes(found, length, width)
    damping = np.array([mode.damping for mode in found.modes])
    kind = "complex" if np.iscomplexobj(shapes.values) else "real"
    return ShapeModes(
        frequencies=np.array([mode.frequency for mode in found.modes]),
        damping=None if np.all(np.isnan(damping)) else damping,
        shapes=shapes,
        origin=f"datasets {' '.join(map(str, found.datasets))}; {len(found.modes)} {kind} modes at {where}",
    )
