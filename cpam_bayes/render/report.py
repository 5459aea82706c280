"""The report of an answer: one record, of which screen, page, document and tables are renderings.

A question's `present(result)` makes the `Report`. This module knows neither screens nor HTML; it turns
reports into JSON documents, CSV files, workbooks and data frames.
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from cpam_bayes import __version__
from cpam_bayes.plate import Specimen

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COMPUTATION: Final = "How this was computed"
"""Title of the last section of a page."""


@dataclass(frozen=True, slots=True)
class Heading:
    """A column heading, and whether the cells below are numbers, aligned to the right."""

    text: str = ""
    number: bool = False


@dataclass(frozen=True, slots=True)
class Table:
    """A title and rows of text; columns without headings make a plain list.

    flagged : rows that a reader must not overlook, coloured on a terminal and worded accordingly.
    """

    title: str
    columns: tuple[Heading, ...]
    rows: tuple[tuple[str, ...], ...]
    flagged: frozenset[int] = frozenset()

    @property
    def headings(self) -> tuple[str, ...] | None:
        """The headings, or None where no column has one."""
        texts = tuple(column.text for column in self.columns)
        return texts if any(texts) else None


def facts(title: str, rows: Iterable[tuple[str, str]]) -> Table:
    """A two-column table of labels and texts."""
    return Table(title, (Heading(), Heading()), tuple(rows))


def remarks(title: str, sentences: Iterable[str], *, flagged: bool = False) -> Table:
    """A one-column table of sentences."""
    rows = tuple((sentence,) for sentence in sentences)
    return Table(title, (Heading(),), rows, frozenset(range(len(rows))) if flagged else frozenset())


@dataclass(frozen=True, slots=True)
class Column:
    """One quantity of a row, declared once for screen, page, document, CSV and data frame.

    heading : on screen and page, None where it is not shown
    key : in JSON, CSV and data frames, None where it is left out
    value : of a row; None leaves the cell empty
    text : formats the value for a reader
    number : aligned to the right
    """

    heading: str | None
    key: str | None = None
    value: Callable[[Any], Any] = lambda row: None
    text: Callable[[Any], str] = str
    number: bool = False

    def cell(self, row: Any) -> str:
        """The text of a row's cell; "" for None."""
        value = self.value(row)
        return "" if value is None else self.text(value)


@dataclass(frozen=True, slots=True)
class Rows:
    """Rows of one kind and their columns.

    name : of the CSV file and the JSON key
    flagged : rows that a reader must not overlook
    """

    name: str
    columns: tuple[Column, ...]
    rows: tuple[Any, ...]
    flagged: Callable[[Any], bool] = lambda row: False

    def table(self, title: str) -> Table:
        """The rows as text; an empty column disappears."""
        shown = [c for c in self.columns if c.heading is not None]
        cells = {c: [c.cell(row) for row in self.rows] for c in shown}
        kept = [c for c in shown if any(cells[c])]
        headings = tuple(Heading(c.heading or "", c.number) for c in kept)
        marked = frozenset(i for i, row in enumerate(self.rows) if self.flagged(row))
        return Table(title, headings, tuple(zip(*(cells[c] for c in kept), strict=True)), marked)

    def records(self) -> list[dict[str, Any]]:
        """The rows as records for a document, a CSV file or a data frame."""
        return [{c.key: c.value(row) for c in self.columns if c.key is not None} for row in self.rows]


@dataclass(frozen=True, slots=True)
class Caption:
    """The words beside a figure.

    text : what to look for in the figure
    alt : what the figure shows, for a reader who cannot see it
    """

    text: str
    alt: str


@dataclass(frozen=True, slots=True)
class Drawing:
    """A figure with its caption, drawn on request."""

    name: str
    draw: Callable[[], Figure]
    caption: Caption


@dataclass(frozen=True, slots=True)
class Section:
    """One section behind an answer.

    tables : those without rows are not shown
    figures : names of drawings, which precede the tables on a page
    folded : whether a page shows the section closed
    """

    title: str
    tables: tuple[Table, ...] = ()
    figures: tuple[str, ...] = ()
    folded: bool = True


@dataclass(frozen=True, slots=True)
class Summary:
    """The first screen: at most 12 lines and 120 words besides requested rows.

    title : the request, "identify panel 12"
    headline : the answer, the number first
    tables : the constants, or other requested rows
    lines : how well the model fits; what the intervals contain and the largest error that they do not contain
    next_step : one sentence; "" for none
    slips : likely slips that ruin the answer, with the cure; shown above everything else
    warnings : reasons to distrust a number; on standard error, or on a page below the answer
    """

    title: str
    headline: str
    tables: tuple[Table, ...] = ()
    lines: tuple[str, ...] = ()
    next_step: str = ""
    slips: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Report:
    """Everything shown of an answer.

    sections : behind the answer: with `--verbose`, folded on a page
    document : the JSON document
    drawings : the one that answers the question first
    rows : tables for CSV files and data frames, the main one first
    """

    summary: Summary
    sections: tuple[Section, ...] = ()
    document: Mapping[str, Any] = field(default_factory=dict)
    drawings: tuple[Drawing, ...] = ()
    rows: tuple[Rows, ...] = ()

    @property
    def written(self) -> tuple[Rows, ...]:
        """Tables for files; without any, the scalar values of the document as one row."""
        if self.rows:
            return self.rows
        single = {k: v for k, v in self.document.items() if not isinstance(v, list | tuple | Mapping)}
        columns = tuple(Column(None, key, lambda row, key=key: row[key]) for key in single)  # type: ignore[misc]
        return (Rows("answer", columns, (single,)),)


def modes_caption(modes: Sequence[tuple[float, str]]) -> Caption:
    """Caption of mode shapes; modes : frequency, Hz, and label of each."""
    listed = ", ".join(f"{label} at {frequency:.4g} Hz" for frequency, label in modes)
    return Caption(
        "Red moves up while blue moves down. On the black lines the plate stands still: a support there "
        "does not disturb the mode, and a sensor or a tap there does not see the mode. A deformed grid is "
        "a mode in the plane of the plate.",
        f"Shapes of {len(modes)} modes: {listed}.",
    )


def merged(sections: Sequence[Section]) -> tuple[Section, ...]:
    """Sections with equal titles merged, at the place of the last one."""
    found: dict[str, Section] = {}
    for section in sections:
        before = found.pop(section.title, replace(section, tables=(), figures=()))
        found[section.title] = replace(
            section,
            tables=(*before.tables, *section.tables),
            figures=(*before.figures, *section.figures),
        )
    return tuple(found.values())


# Largest number of characters in the name of a sheet.
_LONGEST_TITLE = 31
_ENGINEERING_GPA = ("Ex", "Ey", "Gxy")


def json_text(document: Mapping[str, Any]) -> str:
    """The text of a JSON document; non-finite numbers become null."""
    return json.dumps(plain(document), indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def plate_keys(command: str, seed: int, specimen: Specimen) -> dict[str, Any]:
    """The first keys of every document about one plate."""
    return {
        "command": command,
        "version": __version__,
        "plate": specimen.name,
        "specimen": specimen.specimen,
        "source": specimen.source,
        "seed": seed,
        **dict(specimen.certificate),
        **_damping_keys(specimen),
    }


def _damping_keys(specimen: Specimen) -> dict[str, Any]:
    """Damping ratios and loss factors of the measured frequencies, where a table gives them."""
    measurement = specimen.measurement
    if measurement is None or measurement.damping is None or measurement.loss_factors is None:
        return {}
    columns = (measurement.frequencies, measurement.damping, measurement.loss_factors)
    return {
        "damping": [
            {"measured_hz": float(f), "damping_ratio": float(ratio), "loss_factor": float(factor)}
            for f, ratio, factor in zip(*columns, strict=True)
        ]
    }


def laminate_keys(laminate: Mapping[str, float]) -> dict[str, dict[str, float]]:
    """Laminate constants by name: D11 to D26 in N m, Ex, Ey, Gxy in GPa, nuxy."""
    units = {name: laminate_unit(name) for name in laminate}
    return {key: {"value": laminate[name] * factor} for name, (key, factor) in units.items()}


def laminate_unit(name: str) -> tuple[str, float]:
    """Key of a laminate constant in documents, unit included, and the factor from SI."""
    return (f"{name}_GPa", 1e-9) if name in _ENGINEERING_GPA else (name, 1.0)


def plain(value: Any) -> Any:
    """Plain containers, numbers and texts; non-finite numbers become None."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def csv_text(rows: Rows) -> str:
    """The rows as CSV: a header of keys, empty cells for unknown values."""
    sheet, columns = io.StringIO(), [c.key for c in rows.columns if c.key is not None]
    writer = csv.DictWriter(sheet, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows({k: "" if v is None else v for k, v in plain(row).items()} for row in rows.records())
    return sheet.getvalue()


def xlsx_bytes(tables: Sequence[Rows]) -> bytes:
    """The tables as a workbook, one sheet each, with a header of keys; a text is never a formula."""
    import openpyxl  # for workbooks alone

    book = openpyxl.Workbook()
    book.remove(book.active)
    for rows in tables:
        sheet = book.create_sheet(rows.name[:_LONGEST_TITLE])
        sheet.append([c.key for c in rows.columns if c.key is not None])
        for at, record in enumerate(rows.records(), 2):
            for column, value in enumerate(plain(record).values(), 1):
                is_plain = value is None or isinstance(value, bool | int | float | str)
                cell = sheet.cell(at, column, value if is_plain else json.dumps(value, ensure_ascii=False))
                if isinstance(cell.value, str):
                    cell.data_type = "s"
        sheet.freeze_panes = "A2"
    held = io.BytesIO()
    book.save(held)
    return held.getvalue()


def data_frame(tables: Sequence[Rows], name: str | None) -> Any:
    """One table of an answer as a pandas data frame, the first unless named.

    raises ValueError if there is no table of that name
    """
    import pandas as pd  # heavy, and a part of xarray

    by_name = {rows.name: rows for rows in tables}
    rows = by_name.get(name) if name is not None else next(iter(tables), None)
    if rows is None:
        raise ValueError(f"to_dataframe: received {name!r}, accepted: {' '.join(by_name) or 'no table'}")
    return pd.DataFrame.from_records(
        rows.records(), columns=[c.key for c in rows.columns if c.key is not None]
    )
