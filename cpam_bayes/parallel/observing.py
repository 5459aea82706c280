"""Who is told how far shared-out work has come, whoever shares it out."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

__all__ = ["Observer", "observed", "reporting"]

Observer = Callable[[int, int], None]

_observer: ContextVar[Observer | None] = ContextVar("observer_of_shared_work", default=None)


@contextmanager
def observed(observer: Observer) -> Iterator[None]:
    """Tell somebody of all that is shared out inside: the number of items done, from 0, and of all."""
    before = _observer.set(observer)
    try:
        yield
    finally:
        _observer.reset(before)


@contextmanager
def reporting(n: int) -> Iterator[Callable[[], None]]:
    """Report ``n`` items; yields what is called after each. What an item itself shares out is not told."""
    observer, done = _observer.get(), 0
    if observer is None:
        yield lambda: None
        return

    def one_done() -> None:
        nonlocal done
        done += 1
        observer(done, n)

    observer(0, n)
    before = _observer.set(None)
    try:
        yield one_done
    finally:
        _observer.reset(before)
