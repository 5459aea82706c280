"""Progress on standard error: a bar on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass

from cpam_bayes.result import Progress

__all__ = ["Terminal", "announce", "progress", "timed_lines"]

_LINES = 10


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


def _lines(description: str, total: int, described: Callable[[float], str]) -> Progress:
    step = max(1, total // _LINES)
    announce(f"{description}: up to {total} iterations", False)

    def tick(iteration: int, best: float) -> None:
        if iteration % step == 0:
            announce(f"{description}: iteration {iteration} of {total}, {described(best)}", False)

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

        def tick(iteration: int, best: float) -> None:
            what = f"iteration {iteration} of {total}, {described(best)}"
            bar.update(task, total=total, completed=iteration, what=what)

        def notify(text: str) -> None:
            bar.update(task, total=None, what=text)

        yield Progress(tick, notify)
