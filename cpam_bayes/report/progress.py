"""Progress on standard error: a bar on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

__all__ = ["announce", "progress"]

_LINES = 10


def announce(text: str, quiet: bool) -> None:
    """One line about what begins."""
    if not quiet and sys.stderr is not None:
        print(text, file=sys.stderr, flush=True)


@contextmanager
def progress(
    description: str, total: int, quiet: bool, described: Callable[[float], str]
) -> Iterator[Callable[[int, float], None]]:
    """Yield a function (iteration, best misfit) to be called as the work goes on.

    total : the budget of iterations, which a search need not use. described : the misfit in words.
    """
    if quiet or sys.stderr is None:
        yield lambda iteration, best: None
    elif sys.stderr.isatty() and os.environ.get("TERM") not in {None, "dumb", "unknown"}:
        yield from _bar(description, total, described)
    else:
        yield _lines(description, total, described)


def _lines(description: str, total: int, described: Callable[[float], str]) -> Callable[[int, float], None]:
    step = max(1, total // _LINES)
    announce(f"{description}: the plate model first, then up to {total} iterations", False)

    def tick(iteration: int, best: float) -> None:
        if iteration % step == 0:
            announce(f"{description}: iteration {iteration} of {total}, {described(best)}", False)

    return tick


def _bar(
    description: str, total: int, described: Callable[[float], str]
) -> Iterator[Callable[[int, float], None]]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.fields[best]}", markup=False),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(description, total=None, best="plate model")

        def tick(iteration: int, best: float) -> None:
            bar.update(
                task,
                total=total,
                completed=iteration,
                best=f"iteration {iteration} of {total}, {described(best)}",
            )

        yield tick
