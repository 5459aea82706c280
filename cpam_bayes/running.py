"""Running work: progress, the time limit, a single BLAS thread, and stacks of matrices on all cores.

A time limit ends long work with the best answer so far. Splitting one small matrix over BLAS threads costs
more than it gains. A stack is split into matrices instead: numpy releases the interpreter lock while LAPACK
works on them, and the result for a matrix does not depend on its neighbours, so the answer is the same on
any number of cores.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import cache, wraps
from threading import Lock, local
from typing import Any, Final, ParamSpec, Protocol, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.errors import checked


@dataclass(frozen=True, slots=True)
class Progress:
    """Callbacks of a running computation.

    tick : called with (iterations done, value to show). notify : called with the name of a long step that
    begins. found : called with the current shares of what is compared, by title
    """

    tick: Callable[[int, float], None]
    notify: Callable[[str], None]
    found: Callable[[Mapping[str, float]], None] = lambda shares: None


Described: TypeAlias = Callable[[float], str]
"""The ticked value of a stage in words."""


class Watch(Protocol):
    """A display of the progress of long work: a terminal, a notebook, or none."""

    def announce(self, text: str) -> None:
        """Show one line about what begins."""

    def promise(self, text: str) -> None:
        """Show one line that must precede the answer, whatever else is left out."""

    def stage(
        self, title: str, total: int, described: Described | None = None, counted: str = ""
    ) -> AbstractContextManager[Progress]:
        """Show one stage of the work until it ends.

        total : the budget of iterations, which need not be used up, or the number of ``counted``, such as
        "plates", all of which are processed.
        """


class _Silent:
    def __repr__(self) -> str:
        """The default as shown in signatures by `help`."""
        return "SILENT"

    def announce(self, text: str) -> None:
        del text

    promise = announce

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
    missing : what was left out because of it, as code and facts of a notice
    """

    seconds: float
    end: float
    missing: list[tuple[str, Mapping[str, Any]]] = field(default_factory=list)


_limit: ContextVar[TimeLimit | None] = ContextVar("time_limit", default=None)


@checked
def time_limit(seconds: float | None) -> AbstractContextManager[None]:
    """End the computation inside after about this many seconds, with the best answer so far.

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
    """The time limit in force here, None if there is none."""
    return _limit.get()


def is_time_up() -> bool:
    """Whether the time limit, if there is one, is reached."""
    limit = current_limit()
    return limit is not None and time.monotonic() >= limit.end


def cut_short(code: str, **facts: Any) -> None:
    """Note what the answer lacks because time is up; the text of the code becomes part of a sentence."""
    limit, missing = current_limit(), (code, facts)
    if limit is not None and missing not in limit.missing:
        limit.missing.append(missing)


def time_is_up_error(missing: str) -> TimeIsUpError:
    """The error that says that there is no answer, and why."""
    limit = current_limit()
    seconds = "" if limit is None else f" of {limit.seconds:g} s"
    return TimeIsUpError(f"the time limit{seconds} was reached before there was an answer: {missing}")


P = ParamSpec("P")
R = TypeVar("R")
Array = NDArray[Any]

# Entries of a stack (m, n, n) from which threads pay: they cost 0.1 ms, and the eigenvalues of 50 matrices
# of 20 rows take 0.7 ms.
_WORTH_SHARING = 20_000

_this_thread = local()


def matrix_by_matrix(function: Callable[[Array], Array], stack: Array) -> Array:
    """Apply ``function`` to a stack of matrices (m, n, n), in as many threads as there are cores.

    function : of numpy, treating each matrix of a stack independently, such as ``np.linalg.eigvalsh``.
    Small stacks, and all stacks where ``keep_to_one_core`` is in force, stay in the calling thread.
    """
    n = 1 if getattr(_this_thread, "one_core", False) else cores()
    if n == 1 or stack.size < _WORTH_SHARING or len(stack) < n:
        return function(stack)
    own, *others = np.array_split(stack, n)
    elsewhere = [_helpers(os.getpid()).submit(function, part) for part in others]
    return np.concatenate([function(own), *(part.result() for part in elsewhere)])


@contextmanager
def keep_to_one_core() -> Iterator[None]:
    """Keep this thread from distributing work: it is one of several that run in parallel."""
    before = getattr(_this_thread, "one_core", False)
    _this_thread.one_core = True
    try:
        yield
    finally:
        _this_thread.one_core = before


def cores() -> int:
    """Number of cores that this process may use."""
    allowed = getattr(os, "sched_getaffinity", None)
    return len(allowed(0)) if allowed is not None else os.cpu_count() or 1


@cache
def _helpers(process: int) -> ThreadPoolExecutor:  # a fork inherits the pool but not its threads
    return ThreadPoolExecutor(max(cores() - 1, 1), thread_name_prefix=f"cpam_bayes-{process}")


def single_blas_thread(function: Callable[P, R]) -> Callable[P, R]:
    """The function with BLAS held to one thread while it runs, whichever BLAS numpy was built with.

    BLAS counts its threads for the whole process: while several threads of Python run such functions,
    the first to enter sets the limit and the last to leave lifts it.
    """

    @wraps(function)
    def held(*args: P.args, **kwargs: P.kwargs) -> R:
        with _HOLD.one_thread():
            return function(*args, **kwargs)

    return held


class _Hold:
    """The BLAS limit of this process and the number of functions that rely on it."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._users = 0
        self._limits: Any = None

    @contextmanager
    def one_thread(self) -> Iterator[None]:
        from threadpoolctl import threadpool_limits

        with self._lock:
            if not self._users:
                _release_openblas()
                self._limits = threadpool_limits(limits=1, user_api="blas")
            self._users += 1
        try:
            yield
        finally:
            with self._lock:
                self._users -= 1
                if not self._users:
                    _release_openblas()
                    self._limits.restore_original_limits()


def _release_openblas() -> None:
    """Let this thread set the limit of OpenBLAS.

    Newer versions of threadpoolctl let only one thread do so, while it lives, and ignore all others.
    """
    from threadpoolctl import OpenBLASController

    release = getattr(OpenBLASController, "clear_controlling_thread", None)
    if release is not None:
        release(force=True)


_HOLD = _Hold()
