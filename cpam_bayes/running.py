"""Long work: who is shown its progress, and the time limit that ends it with the best answer so far."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Any, Final, Protocol, TypeAlias

from cpam_bayes.errors import checked


@dataclass(frozen=True, slots=True)
class Progress:
    """The reports of a computation while it runs.

    tick : called with (iterations done, value to show). notify : called with what begins that takes long.
    """

    tick: Callable[[int, float], None]
    notify: Callable[[str], None]


Described: TypeAlias = Callable[[float], str]
"""The ticked value of a stage in words."""


class Watch(Protocol):
    """A display of the progress of long work: a terminal, a notebook, or none."""

    def announce(self, text: str) -> None:
        """Show one line about what begins."""

    def stage(
        self, title: str, total: int, described: Described | None = None, counted: str = ""
    ) -> AbstractContextManager[Progress]:
        """Show one stage of the work until it ends.

        total : the budget of iterations, which need not be used up, or the number of ``counted``, such as
        "plates", all of which are done.
        """


class _Silent:
    def __repr__(self) -> str:
        """As signatures in `help` show the default."""
        return "SILENT"

    def announce(self, text: str) -> None:
        del text

    @contextmanager
    def stage(
        self, title: str, total: int, described: Described | None = None, counted: str = ""
    ) -> Iterator[Progress]:
        del title, total, described, counted
        yield Progress(lambda done, value: None, lambda text: None)


SILENT: Final[Watch] = _Silent()
"""Shows nothing: the default of the library."""


class TimeIsUpError(RuntimeError):
    """The time limit was reached before there was anything to answer."""


@dataclass(slots=True)
class TimeLimit:
    """A time limit and the work that it cut.

    seconds : the limit
    end : when it is reached, by the clock of ``time.monotonic``
    missing : what was left out for it, as code and facts of a notice
    """

    seconds: float
    end: float
    missing: list[tuple[str, Mapping[str, Any]]] = field(default_factory=list)


_limit: ContextVar[TimeLimit | None] = ContextVar("time_limit", default=None)


@checked
def time_limit(seconds: float | None) -> AbstractContextManager[None]:
    """End what is computed inside after about so many seconds, with the best answer so far.

    The answer then says first what is missing, and has not reached its goal. Where there is nothing to
    answer yet, ``TimeIsUpError`` is raised. A limit inside another one replaces it; ``None`` lifts it.

    Raises
    ------
    ValueError
        If the limit is not a positive number of seconds.

    Examples
    --------
    >>> import cpam_bayes as cb
    >>> with cb.time_limit(600.0):
    ...     point = cb.identify("A1")
    >>> point.reached_goal
    True
    """
    if seconds is not None and not seconds > 0.0:
        raise ValueError(f"time limit: received {seconds}, accepted: seconds above 0, or None")
    return _limited(seconds)


@contextmanager
def _limited(seconds: float | None) -> Iterator[None]:
    limit = None if seconds is None else TimeLimit(seconds, time.monotonic() + seconds)
    before = _limit.set(limit)
    try:
        yield
    finally:
        _limit.reset(before)


def current_limit() -> TimeLimit | None:
    """The limit that what runs here is under."""
    return _limit.get()


def is_time_up() -> bool:
    """Whether the time limit, if there is one, is reached."""
    limit = current_limit()
    return limit is not None and time.monotonic() >= limit.end


def cut_short(code: str, **facts: Any) -> None:
    """Note what the answer lacks because time is up; the sentence of the code is a part of one."""
    limit, missing = current_limit(), (code, facts)
    if limit is not None and missing not in limit.missing:
        limit.missing.append(missing)


def time_is_up_error(missing: str) -> TimeIsUpError:
    """The error that says that there is no answer, and why."""
    limit = current_limit()
    seconds = "" if limit is None else f" of {limit.seconds:g} s"
    return TimeIsUpError(f"the time limit{seconds} was reached before there was an answer: {missing}")
