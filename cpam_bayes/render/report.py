"""The report of an answer: one record, of which screen, page, document and tables are renderings.

A question's `present(result)` makes the `Report`. Nothing here knows a screen or HTML.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "COMPUTATION",
    "Caption",
    "Column",
    "Drawing",
    "Heading",
    "Report",
    "Rows",
    "Section",
    "Summary",
    "Table",
    "facts",
    "merged",
    "modes_caption",
    "remarks",
]

COMPUTATION: Final = "How this was computed"
"""Title of the section that stands last on a page."""


@dataclass(frozen=True, slots=True)
class Heading:
    """A heading of a table of text, and whether the cells below it are numbers, which stand to the right."""

    text: str = ""
    number: bool = False


@dataclass(frozen=True, slots=True)
class Table:
    """A title and rows of text; columns without any heading make a plain list.

    flagged : rows that a reader must not overlook, coloured on a terminal; their words say so too.
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
    """Names and what is to be said of them."""
    return Table(title, (Heading(), Heading()), tuple(rows))


def remarks(title: str, sentences: Iterable[str], *, flagged: bool = False) -> Table:
    """A list of sentences."""
    rows = tuple((sentence,) for sentence in sentences)
    return Table(title, (Heading(),), rows, frozenset(range(len(rows))) if flagged else frozenset())


@dataclass(frozen=True, slots=True)
class Column:
    """One quantity of a row, declared once for screen, page, document, CSV and data frame.

    heading : on a screen and a page, None where they do not show it
    key : in JSON, CSV and data frames, None where they do not hold it
    value : of a row; None leaves the cell empty
    text : the value as it is read
    number : stands to the right
    """

    heading: str | None
    key: str | None = None
    value: Callable[[Any], Any] = lambda row: None
    text: Callable[[Any], str] = str
    number: bool = False

    def cell(self, row: Any) -> str:
        """The text of a row's cell; "" where there is nothing."""
        value = self.value(row)
        return "" if value is None else self.text(value)


@dataclass(frozen=True, slots=True)
class Rows:
    """Rows of one kind with their columns.

    name : of the CSV file and the JSON key
    flagged : rows that a reader must not overlook
    """

    name: str
    columns: tuple[Column, ...]
    rows: tuple[Any, ...]
    flagged: Callable[[Any], bool] = lambda row: False

    def table(self, title: str) -> Table:
        """The rows for a reader; a column without a cell disappears."""
        shown = [c for c in self.columns if c.heading is not None]
        cells = {c: [c.cell(row) for row in self.rows] for c in shown}
        kept = [c for c in shown if any(cells[c])]
        headings = tuple(Heading(c.heading or "", c.number) for c in kept)
        marked = frozenset(i for i, row in enumerate(self.rows) if self.flagged(row))
        return Table(title, headings, tuple(zip(*(cells[c] for c in kept), strict=True)), marked)

    def records(self) -> list[dict[str, Any]]:
        """The rows for a document, a CSV file or a data frame."""
        return [{c.key: c.value(row) for c in self.columns if c.key is not None} for row in self.rows]


@dataclass(frozen=True, slots=True)
class Caption:
    """The words beside a figure.

    text : what to see in the figure
    alt : what the figure shows, for a reader who cannot see it
    """

    text: str
    alt: str


@dataclass(frozen=True, slots=True)
class Drawing:
    """A figure, drawn when it is asked for, with the words beside it."""

    name: str
    draw: Callable[[], Figure]
    caption: Caption


@dataclass(frozen=True, slots=True)
class Section:
    """A part of what stands behind an answer.

    tables : those without rows are not shown
    figures : names of drawings, which stand on a page before the tables
    folded : on a page, whether a reader opens the section before its content is shown
    """

    title: str
    tables: tuple[Table, ...] = ()
    figures: tuple[str, ...] = ()
    folded: bool = True


@dataclass(frozen=True, slots=True)
class Summary:
    """The first screen: at most 12 lines and 120 words besides rows that were asked for.

    title : what was asked, "identify panel 12"
    headline : the answer, the number first
    tables : the constants, or other rows that were asked for
    lines : how well the model fits; what the intervals contain and the largest error that they do not
    next_step : what to do now, one sentence; "" for nothing
    slips : what most likely ruins the answer, with the cure; these stand above everything else
    warnings : reasons not to trust a number; a screen has them on standard error, a page below the answer
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
    """All that is shown of an answer.

    sections : what stands behind it: after `--verbose`, folded on a page
    document : the JSON document
    drawings : by name, the one that answers first
    rows : tables for CSV files and data frames, the main one first
    """

    summary: Summary
    sections: tuple[Section, ...] = ()
    document: Mapping[str, Any] = field(default_factory=dict)
    drawings: tuple[Drawing, ...] = ()
    rows: tuple[Rows, ...] = ()

    @property
    def written(self) -> tuple[Rows, ...]:
        """The tables that are written; where there is none, the single values of the document in one row."""
        if self.rows:
            return self.rows
        single = {k: v for k, v in self.document.items() if not isinstance(v, list | tuple | Mapping)}
        columns = tuple(Column(None, key, lambda row, key=key: row[key]) for key in single)  # type: ignore[misc]
        return (Rows("answer", columns, (single,)),)


def modes_caption(modes: Sequence[tuple[float, str]]) -> Caption:
    """The words beside mode shapes; modes : frequency, Hz, and label of each."""
    listed = ", ".join(f"{label} at {frequency:.4g} Hz" for frequency, label in modes)
    return Caption(
        "Red moves up while blue moves down. On the black lines the plate stands still: a support there "
        "does not disturb the mode, and a sensor or a tap there does not see the mode. A deformed grid is "
        "a mode in the plane of the plate.",
        f"Shapes of {len(modes)} modes: {listed}.",
    )


def merged(sections: Sequence[Section]) -> tuple[Section, ...]:
    """Sections of one title as one, where the last of them stands."""
    found: dict[str, Section] = {}
    for section in sections:
        before = found.pop(section.title, replace(section, tables=(), figures=()))
        found[section.title] = replace(
            section,
            tables=(*before.tables, *section.tables),
            figures=(*before.figures, *section.figures),
        )
    return tuple(found.values())
