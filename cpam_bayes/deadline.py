"""A limit on the time that an answer may take: loops look whether time is up and end with what they have."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field

from cpam_bayes.arguments import checked


class TimeIsUpError(RuntimeError):
    """The time limit was reached before there was anything to answer."""


@dataclass(slots=True)
class TimeLimit:
    """What a limit did.

    seconds : the limit
    end : when it is reached, by the clock of ``time.monotonic``
    missing : what was left out for it
    """

    seconds: float
    end: float
    missing: list[str] = field(default_factory=list)

    @property
    def beginning(self) -> str:
        """What happened, in words."""
        return f"the time limit of {self.seconds:g} s ended the work early: "

    @property
    def sentence(self) -> str:
        """What happened, and what was left out."""
        return self.beginning + "; ".join(self.missing)


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


def cut_short(missing: str) -> None:
    """Note what the answer lacks because time is up."""
    limit = current_limit()
    if limit is not None and missing not in limit.missing:
        limit.missing.append(missing)


def time_is_up_error(missing: str) -> TimeIsUpError:
    """The error that says that there is no answer, and why."""
    limit = current_limit()
    seconds = "" if limit is None else f" of {limit.seconds:g} s"
    return TimeIsUpError(f"the time limit{seconds} was reached before there was an answer: {missing}")
