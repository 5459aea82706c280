"""Threads: BLAS keeps to one, stacks of matrices are distributed over the cores.

BLAS splits one small matrix over its threads and loses more by that than it gains. A stack is split
into matrices instead: numpy lets go of the interpreter while LAPACK works on them, and what comes out
for a matrix does not depend on its neighbours, so the answer is the same on any number of cores.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache, wraps
from threading import Lock, local
from typing import Any, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

P = ParamSpec("P")
R = TypeVar("R")
Array = NDArray[Any]

# Entries of a stack (m, n, n) from which sharing out pays: it costs a tenth of a millisecond, and
# eigenvalues of 50 matrices of 20 rows take seven tenths.
_WORTH_SHARING = 20_000

_this_thread = local()


def matrix_by_matrix(function: Callable[[Array], Array], stack: Array) -> Array:
    """``function`` of a stack of matrices (m, n, n), in as many threads as there are cores.

    function : numpy's, of a stack, that treats each matrix for itself, such as ``np.linalg.eigvalsh``.
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
    """Let this thread distribute nothing: it is one of several that work side by side."""
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
