"""Terminal output: tables as text, also for a file or a pipe, and progress on standard error.

Progress is a bar on a terminal, elsewhere an occasional line.
"""

from __future__ import annotations

import io
import math
import os
import re
import shutil
import sys
import textwrap
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Final, TextIO

from cpam_bayes.parallel import observed
from cpam_bayes.render.report import Heading, Report, Summary, Table
from cpam_bayes.running import Described, Progress

_JOINED: Final = re.compile(r"(?<=\d) (?=%|[A-Za-z]{1,3}\b)|(?<=cpam-bayes) | (?=\+- )|(?<=\+-) ")
"""Spaces at which lines are not broken: before units, within a tolerance, after the command name."""
_WIDTH: Final = 100
"""Line width at which sentences are broken in a pipe or a file."""


def screen_tables(report: Report, *, verbose: bool = False) -> tuple[Table, ...]:
    """The tables of a screen; verbose : with all the sections behind the answer."""
    behind = tuple(table for section in report.sections for table in section.tables if table.rows)
    return (*_first_screen(report.summary), *(behind if verbose else ()))


def _first_screen(summary: Summary) -> tuple[Table, ...]:
    """Slips and headline, tables, then fit, intervals and next step."""
    head = (*summary.slips, *summary.headline.splitlines())
    said = (*summary.lines, *((f"Next: {summary.next_step}",) if summary.next_step else ()))
    return (
        Table(summary.title, (Heading(),), tuple((t,) for t in head), frozenset(range(len(summary.slips)))),
        *summary.tables,
        Table("", (Heading(),), tuple((text,) for text in said)),
    )


def screen_text(tables: Sequence[Table], stream: TextIO) -> str:
    """The tables as text: by rich on a terminal, as plain lines elsewhere."""
    shown = tuple(table for table in tables if table.rows)
    if stream.isatty() and os.environ.get("TERM") not in {None, "dumb", "unknown"}:
        return _terminal_text(shown)
    return "\n".join(plain_text(table) for table in shown)


def plain_text(table: Table) -> str:
    """Aligned columns, two spaces apart, below the title; sentences wrapped at 100 characters."""
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
    """A wrapped sentence; a number stays with its unit, and a command with its arguments."""
    kept = _JOINED.sub("\N{NO-BREAK SPACE}", sentence)
    lines = textwrap.wrap(kept, _WIDTH, initial_indent="  ", subsequent_indent="  ", break_on_hyphens=False)
    return [line.replace("\N{NO-BREAK SPACE}", " ") for line in lines]


def _terminal_text(tables: tuple[Table, ...]) -> str:
    from rich.console import Console

    sheet = io.StringIO()
    # Layups have brackets, which rich would take for its markup.
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


_LINES = 10
# Seconds from which a duration is announced, and iterations and seconds after which it is estimated.
_LONG, _ENOUGH_DONE, _ENOUGH_SECONDS = 60.0, 4, 3.0
# It is announced again where the end is delayed by more than this fraction of the duration.
_LATER = 0.5
# Shorter times, in seconds, are not shown.
_WORTH_SAYING = 10.0


@dataclass(frozen=True, slots=True)
class Terminal:
    """Progress on standard error unless quiet; a `cpam_bayes.running.Watch`."""

    quiet: bool = False

    def announce(self, text: str) -> None:
        """Print a line about the work that begins."""
        announce(text, self.quiet)

    def promise(self, text: str) -> None:
        """Print a line that must precede the answer, even if quiet."""
        announce(text, False)

    def stage(
        self, title: str, total: int, described: Described | None = None, counted: str = ""
    ) -> AbstractContextManager[Progress]:
        """Show the progress of one stage."""
        return progress(title, total, self.quiet, described, counted)


def announce(text: str, quiet: bool) -> None:
    """Print a line on standard error unless quiet."""
    if not quiet and sys.stderr is not None:
        print(text, file=sys.stderr, flush=True)


def timed_lines() -> Callable[[str], None]:
    """A function that prints lines on standard error, each with the seconds since this call."""
    begun = time.perf_counter()

    def tell(text: str) -> None:
        print(f"{time.perf_counter() - begun:7.1f} s  {text}", file=sys.stderr, flush=True)

    return tell


@contextmanager
def progress(
    description: str, total: int, quiet: bool, described: Described | None = None, counted: str = ""
) -> Iterator[Progress]:
    """Show the progress of a work until it ends.

    total : largest number of iterations of a search, or the exact number of ``counted``, such as "plates".
    described : the misfit in words.
    """
    if quiet or sys.stderr is None:
        yield Progress(lambda iteration, best: None, lambda text: None)
        return
    with forecasting() as forecast, forecast.stage(total, is_budget=not counted) as clock:
        if sys.stderr.isatty() and os.environ.get("TERM") not in {None, "dumb", "unknown"}:
            yield from _bar(description, _Count(total, described, counted), clock)
        else:
            yield _said_in_lines(description, _Count(total, described, counted), clock)


@dataclass(frozen=True, slots=True)
class _Count:
    """Progress of a stage in words; counted : "" for the iterations of a search."""

    total: int
    described: Described | None
    counted: str

    @property
    def _named(self) -> str:
        first, *rest = self.counted.split(" ")
        return " ".join((first.removesuffix("s") if self.total == 1 else first, *rest))

    @property
    def begun(self) -> str:
        """Size of the stage."""
        return f"{self.total} {self._named}" if self.counted else f"up to {self.total} iterations"

    def at(self, iteration: int, best: float) -> str:
        """Number done, and the described value."""
        number = f"{iteration} of {self.total}"
        done = f"{number} {self._named}" if self.counted else f"iteration {number}"
        return done if self.described is None else f"{done}, {self.described(best)}"


class Forecast:
    """Announces work that takes longer than a minute, again whenever the end is delayed.

    Work counts if it has a number of parts: the iterations of a stage, or items given to workers.
    """

    def __init__(self) -> None:
        self._end = -math.inf
        self._items: Clock | None = None
        self._stage: Clock | None = None

    @contextmanager
    def stage(self, total: int, *, is_budget: bool = False) -> Iterator[Clock]:
        """The clock of a stage; work shared out inside it announces no times of its own."""
        before, self._stage = self._stage, Clock(total, self, is_budget=is_budget)
        try:
            yield self._stage
        finally:
            self._stage = before

    def shared_out(self, done: int, total: int) -> None:
        """Record the progress of items given to workers."""
        if self._stage is not None and self._stage.has_told:
            return
        if not done or self._items is None:
            self._items = Clock(total, self)
        self._items.left(done)

    def expect(self, clock: Clock, now: float, whole: float, left: float) -> None:
        """Announce the duration of a part, if it is long and does not end as announced; all in seconds.

        An earlier announcement for this part or the stage around it is corrected.
        """
        if whole < _LONG or now + left <= self._end + _LATER * whole:
            return
        part = self._stage or clock
        longer = f"longer than expected: {clock.about} {duration(left)} left"
        takes = f"this part takes {clock.about} {duration(whole)}"
        announce(longer if part.is_expected else takes, False)
        part.is_expected, self._end = True, now + left


_forecast: ContextVar[Forecast | None] = ContextVar("forecast", default=None)


@contextmanager
def forecasting() -> Iterator[Forecast]:
    """Announce durations above a minute on standard error, for the work inside.

    The estimate is the measured time of the first iterations or items times their number.
    """
    current = _forecast.get()
    if current is not None:
        yield current
        return
    current = Forecast()
    before = _forecast.set(current)
    try:
        with observed(current.shared_out):
            yield current
    finally:
        _forecast.reset(before)


class Clock:
    """Estimates the remaining time from the part done; an upper bound for a budget of iterations.

    forecast : notified of long durations, if any
    """

    def __init__(self, total: int, forecast: Forecast | None = None, *, is_budget: bool = False) -> None:
        self._total, self._forecast = total, forecast
        self.about = "at most about" if is_budget else "about"
        self._first: tuple[int, float] | None = None
        self.has_told = self.is_expected = False

    def left(self, iteration: int) -> str:
        """The remaining time after a comma; "" where it is short or unknown."""
        now = time.monotonic()
        if self._first is None or iteration < self._first[0]:
            self._first = (iteration, now)
        done, past = iteration - self._first[0], now - self._first[1]
        if done <= 0:
            return ""
        seconds = past * (self._total - iteration) / done
        is_known = past >= _ENOUGH_SECONDS and done >= min(_ENOUGH_DONE, self._total // 2)
        if is_known and self._forecast is not None:
            self._forecast.expect(self, now, past + seconds, seconds)
        if seconds < _WORTH_SAYING:
            return ""
        self.has_told = True
        return f", {self.about} {duration(seconds)} left"


def duration(seconds: float) -> str:
    """A duration in words, rounded up: 40 s, 12 min, 3 h 20 min."""
    if seconds <= 55.0:
        return f"{math.ceil(seconds / 5.0) * 5} s"
    minutes = math.ceil(seconds / 60.0)
    hours, rest = divmod(minutes, 60)
    if not hours:
        return f"{minutes} min"
    return f"{hours} h {rest} min" if rest else f"{hours} h"


def _said_in_lines(description: str, count: _Count, clock: Clock) -> Progress:
    step = max(1, count.total // _LINES)
    announce(f"{description}: {count.begun}", False)

    def tick(iteration: int, best: float) -> None:
        left = clock.left(iteration)
        if iteration % step == 0:
            announce(f"{description}: {count.at(iteration, best)}{left}", False)

    return Progress(tick, lambda text: announce(f"{description}: {text}", False))


def _bar(description: str, count: _Count, clock: Clock) -> Iterator[Progress]:
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.fields[what]}", markup=False),
        TimeElapsedColumn(),
    )
    with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(description, total=None, what="plate model")

        def tick(iteration: int, best: float) -> None:
            what = f"{count.at(iteration, best)}{clock.left(iteration)}"
            bar.update(task, total=count.total, completed=iteration, what=what)

        def notify(text: str) -> None:
            bar.update(task, total=None, what=text)

        yield Progress(tick, notify)
