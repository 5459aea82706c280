"""Tables of text, for a terminal and for a file or a pipe."""

from __future__ import annotations

import io
import os
import re
import shutil
import textwrap
from collections.abc import Sequence
from typing import Final, TextIO

from cpam_bayes.render.report import Heading, Report, Summary, Table

__all__ = ["plain_text", "screen_tables", "screen_text"]

_JOINED: Final = re.compile(r"(?<=\d) (?=%|[A-Za-z]{1,3}\b)|(?<=cpam-bayes) | (?=\+- )|(?<=\+-) ")
"""Spaces at which no line is broken: before units, within a tolerance, after the name of the command."""
_WIDTH: Final = 100
"""Characters of a line of a pipe or a file at which sentences are broken."""


def screen_tables(report: Report, *, verbose: bool = False) -> tuple[Table, ...]:
    """The tables of a screen; verbose : with all that stands behind the answer."""
    behind = tuple(table for section in report.sections for table in section.tables if table.rows)
    return (*_first_screen(report.summary), *(behind if verbose else ()))


def _first_screen(summary: Summary) -> tuple[Table, ...]:
    """Headline, table, fit and contents of the intervals, next step."""
    head = (*summary.slips, *summary.headline.splitlines())
    said = (*summary.lines, *((f"Next: {summary.next_step}",) if summary.next_step else ()))
    return (
        Table(summary.title, (Heading(),), tuple((t,) for t in head), frozenset(range(len(summary.slips)))),
        *summary.tables,
        Table("", (Heading(),), tuple((text,) for text in said)),
    )


def screen_text(tables: Sequence[Table], stream: TextIO) -> str:
    """The tables as a stream shows them best: with rich on a terminal, in plain lines elsewhere."""
    shown = tuple(table for table in tables if table.rows)
    if stream.isatty() and os.environ.get("TERM") not in {None, "dumb", "unknown"}:
        return _terminal_text(shown)
    return "\n".join(plain_text(table) for table in shown)


def plain_text(table: Table) -> str:
    """Aligned columns, two spaces apart, below the title; sentences in lines of 100 characters."""
    text = [table.title] if table.title else []
    if len(table.columns) == 1 and table.headings is None:
        for (sentence,) in table.rows:
            text += _lines(sentence) or [""]
        return "\n".join(text) + "\n"
    filled = [*([table.headings] if table.headings else []), *table.rows]
    widths = [max(len(line[i]) for line in filled) for i in range(len(table.columns))]
    for line in filled:
        cells = (
            cell.rjust(width) if column.number else cell.ljust(width)
            for cell, column, width in zip(line, table.columns, widths, strict=True)
        )
        text.append(f"  {'  '.join(cells)}".rstrip())
    return "\n".join(text) + "\n"


def _lines(sentence: str) -> list[str]:
    """A sentence in lines; a number stays with its unit, and a command with its arguments."""
    kept = _JOINED.sub("\N{NO-BREAK SPACE}", sentence)
    lines = textwrap.wrap(kept, _WIDTH, initial_indent="  ", subsequent_indent="  ", break_on_hyphens=False)
    return [line.replace("\N{NO-BREAK SPACE}", " ") for line in lines]


def _terminal_text(tables: tuple[Table, ...]) -> str:
    from rich.console import Console

    sheet = io.StringIO()
    # Layups are written with brackets, which rich would take for its own markup.
    console = Console(
        file=sheet,
        force_terminal=True,
        width=shutil.get_terminal_size((_WIDTH, 24)).columns,
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
        title=table.title or None,
        title_justify="left",
        title_style="bold",
        show_header=table.headings is not None,
        box=box.SIMPLE_HEAD if table.headings else None,
        pad_edge=True,
    )
    for column in table.columns:
        drawn.add_column(column.text, justify="right" if column.number else "left", overflow="fold")
    for i, row in enumerate(table.rows):
        drawn.add_row(*row, style="yellow" if i in table.flagged else None)
    return drawn
