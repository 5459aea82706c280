"""Tables of text, for a terminal and for a file or a pipe."""

from __future__ import annotations

import io
import os
from dataclasses import dataclass
from typing import TextIO

__all__ = ["Column", "Table", "facts", "headed", "remarks", "screen_text"]


@dataclass(frozen=True, slots=True)
class Column:
    """A heading and whether the cells below it are numbers, which stand to the right."""

    heading: str = ""
    number: bool = False


@dataclass(frozen=True, slots=True)
class Table:
    """A title and rows of text; columns without any heading make a plain list.

    flagged : rows that a reader must not overlook, coloured on a terminal; their words say so too.
    """

    title: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[str, ...], ...]
    flagged: frozenset[int] = frozenset()

    @property
    def headings(self) -> tuple[str, ...] | None:
        """The headings, or None where no column has one."""
        texts = tuple(column.heading for column in self.columns)
        return texts if any(texts) else None


def headed(*headings: str) -> tuple[Column, ...]:
    """Columns by their headings; a heading after "#" is of numbers, which stand to the right."""
    return tuple(Column(heading.removeprefix("#"), heading.startswith("#")) for heading in headings)


def facts(title: str, rows: tuple[tuple[str, str], ...]) -> Table:
    """A list of names and what is to be said of them."""
    return Table(title, (Column(), Column()), rows)


def remarks(title: str, sentences: tuple[str, ...], *, flagged: bool = False) -> Table:
    """A list of sentences."""
    marked = frozenset(range(len(sentences))) if flagged else frozenset()
    return Table(title, (Column(),), tuple((sentence,) for sentence in sentences), marked)


def screen_text(tables: tuple[Table, ...], stream: TextIO) -> str:
    """The tables as a stream shows them best: with rich on a terminal, in plain lines elsewhere."""
    shown = tuple(table for table in tables if table.rows)
    if stream.isatty() and os.environ.get("TERM") not in {None, "dumb", "unknown"}:
        return _terminal_text(shown)
    return "\n".join(plain_text(table) for table in shown)


def plain_text(table: Table) -> str:
    """Aligned columns, two spaces apart, below the title."""
    lines = [table.headings, *table.rows] if table.headings else [*table.rows]
    filled = [line for line in lines if line is not None]
    widths = [max(len(line[i]) for line in filled) for i in range(len(table.columns))]
    text = [table.title]
    for line in filled:
        cells = (
            cell.rjust(width) if column.number else cell.ljust(width)
            for cell, column, width in zip(line, table.columns, widths, strict=True)
        )
        text.append(f"  {'  '.join(cells)}".rstrip())
    return "\n".join(text) + "\n"


def _terminal_text(tables: tuple[Table, ...]) -> str:
    import shutil

    from rich.console import Console

    sheet = io.StringIO()
    # Layups are written with brackets, which rich would take for its own markup.
    console = Console(
        file=sheet,
        force_terminal=True,
        width=shutil.get_terminal_size((100, 24)).columns,
        markup=False,
        highlight=False,
        emoji=False,
    )
    for table in tables:
        console.print(_rich_table(table))
        if table.headings is None:  # the others end with an empty line of their own
            console.print()
    return sheet.getvalue()


def _rich_table(table: Table) -> object:
    from rich import box
    from rich.table import Table as RichTable

    drawn = RichTable(
        title=table.title,
        title_justify="left",
        title_style="bold",
        show_header=table.headings is not None,
        box=box.SIMPLE_HEAD if table.headings else None,
        pad_edge=True,
    )
    for column in table.columns:
        drawn.add_column(column.heading, justify="right" if column.number else "left", overflow="fold")
    for i, row in enumerate(table.rows):
        drawn.add_row(*row, style="yellow" if i in table.flagged else None)
    return drawn
