"""BLAS is held to one thread for as long as anybody needs it."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier, Event

import numpy as np  # noqa: F401 - loads BLAS
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from cpam_bayes.threads import single_blas_thread


def blas_threads() -> int:
    return max(info["num_threads"] for info in threadpool_info() if info["user_api"] == "blas")


@pytest.fixture(autouse=True)
def _two_threads() -> Iterator[None]:
    with threadpool_limits(2, user_api="blas"):
        assert blas_threads() == 2
        yield


def test_the_limit_is_lifted_at_the_end_even_of_a_failure() -> None:
    @single_blas_thread
    def fail() -> None:
        assert blas_threads() == 1
        raise LookupError

    with pytest.raises(LookupError):
        fail()
    assert blas_threads() == 2


def test_an_inner_function_does_not_lift_the_limit_of_the_outer() -> None:
    inner = single_blas_thread(blas_threads)

    @single_blas_thread
    def outer() -> tuple[int, int]:
        return inner(), blas_threads()

    assert outer() == (1, 1)
    assert blas_threads() == 2


def test_the_last_thread_to_leave_lifts_the_limit_and_no_other() -> None:
    both_in, first_is_out = Barrier(2), Event()

    @single_blas_thread
    def first() -> None:
        both_in.wait(60)

    @single_blas_thread
    def second() -> int:
        both_in.wait(60)
        first_is_out.wait(60)
        return blas_threads()

    with ThreadPoolExecutor(2) as threads:
        last = threads.submit(second)
        threads.submit(first).result(60)
        first_is_out.set()
        assert last.result(60) == 1
    assert blas_threads() == 2
