"""Progress on standard error: a bar on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import math
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass

from cpam_bayes.result import Progress

__all__ = ["Terminal", "announce", "progress", "timed_lines"]

_LINES = 10
# Less than this is not worth an estimate, seconds.
_WORTH_SAYING = 10.0


@dataclass(frozen=True, slots=True)
class Terminal:
    """Shows progress on standard error unless told to be quiet; a `cpam_bayes.result.Watch`."""

    quiet: bool = False

    def announce(self, text: str) -> None:
        """Show one line about what begins."""
        announce(text, self.quiet)

    def stage(
        self, title: str, total: int, described: Callable[[float], str]
    ) -> AbstractContextManager[Progress]:
        """Show one stage of the work until it ends."""
        return progress(title, total, self.quiet, described)


def announce(text: str, quiet: bool) -> None:
    """One line about what begins."""
    if not quiet and sys.stderr is not None:
        print(text, file=sys.stderr, flush=True)


def timed_lines() -> Callable[[str], None]:
    """A teller of lines on standard error, each with the seconds since it was made."""
    begun = time.perf_counter()

    def tell(text: str) -> None:
        print(f"{time.perf_counter() - begun:7.1f} s  {text}", file=sys.stderr, flush=True)

    return tell


@contextmanager
def progress(
    description: str, total: int, quiet: bool, described: Callable[[float], str]
) -> Iterator[Progress]:
    """Show the progress of a work until it ends.

    total : the budget of iterations, which a search need not use. described : the misfit in words.
    """
    if quiet or sys.stderr is None:
        yield Progress(lambda iteration, best: None, lambda text: None)
    elif sys.stderr.isatty() and os.environ.get("TERM") not in {None, "dumb", "unknown"}:
        yield from _bar(description, total, described)
    else:
        yield _lines(description, total, described)


class _Clock:
    """Estimates from what is done how long the rest of a budget takes."""

    def __init__(self, total: int) -> None:
        self._total = total
        self._first: tuple[int, float] | None = None

    def left(self, iteration: int) -> str:
        """The time that is left at most, with a comma before it; nothing where it is short or not known."""
        now = time.monotonic()
        if self._first is None:
            self._first = (iteration, now)
        done = iteration - self._first[0]
        if done <= 0:
            return ""
        seconds = (now - self._first[1]) * (self._total - iteration) / done
        return f", at most {duration(seconds)} left" if seconds >= _WORTH_SAYING else ""


def duration(seconds: float) -> str:
    """A time in words: 40 s, 12 min, 3 h 20 min."""
    if seconds <= 55.0:
        return f"{math.ceil(seconds / 5.0) * 5} s"
    minutes = math.ceil(seconds / 60.0)
    hours, rest = divmod(minutes, 60)
    if not hours:
        return f"{minutes} min"
    return f"{hours} h {rest} min" if rest else f"{hours} h"


def _lines(description: str, total: int, described: Callable[[float], str]) -> Progress:
    step = max(1, total // _LINES)
    announce(f"{description}: up to {total} iterations", False)
    clock = _Clock(total)

    def tick(iteration: int, best: float) -> None:
        left = clock.left(iteration)
        if iteration % step == 0:
            announce(f"{description}: iteration {iteration} of {total}, {described(best)}{left}", False)

    return Progress(tick, lambda text: announce(f"{description}: {text}", False))


def _bar(description: str, total: int, described: Callable[[float], str]) -> Iterator[Progress]:
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
        clock = _Clock(total)

        def tick(iteration: int, best: float) -> None:
            what = f"iteration {iteration} of {total}, {described(best)}{clock.left(iteration)}"
            bar.update(task, total=total, completed=iteration, what=what)

        def notify(text: str) -> None:
            bar.update(task, total=None, what=text)

        yield Progress(tick, notify)
