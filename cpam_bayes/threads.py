"""One BLAS thread: many small eigenproblems lose more by sharing out than they gain."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from threading import Lock
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


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
    """The limit of this process and how many functions rely on it."""

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

    Newer versions of threadpoolctl let one thread alone do so, while it lives, and ignore all others.
    """
    from threadpoolctl import OpenBLASController

    release = getattr(OpenBLASController, "clear_controlling_thread", None)
    if release is not None:
        release(force=True)


_HOLD = _Hold()
