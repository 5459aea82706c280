"""BLAS is held to one thread for as long as anybody needs it."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier, Event, current_thread
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from threadpoolctl import threadpool_info, threadpool_limits

from cpam_bayes import running
from cpam_bayes.running import single_blas_thread

Array = NDArray[Any]


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

    with ThreadPoolExecutor(2) as pool:
        last = pool.submit(second)
        pool.submit(first).result(60)
        first_is_out.set()
        assert last.result(60) == 1
    assert blas_threads() == 2


@pytest.fixture
def matrices() -> Array:
    given = np.random.default_rng(3).normal(size=(101, 30, 30))
    return given + given.swapaxes(1, 2)


def test_a_stack_is_shared_out_and_its_answer_is_that_of_one_thread_to_the_last_bit(
    matrices: Array, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = np.linalg.eigvalsh(matrices)
    sizes = []

    def counted(stack: Array) -> Array:
        sizes.append(len(stack))
        return np.linalg.eigvalsh(stack)

    monkeypatch.setattr(running, "cores", lambda: 3)
    found = running.matrix_by_matrix(counted, matrices)
    assert sorted(sizes) == [33, 34, 34]
    np.testing.assert_array_equal(found, expected)


def test_a_worker_shares_out_nothing(matrices: Array, monkeypatch: pytest.MonkeyPatch) -> None:
    names = set()

    def named(stack: Array) -> Array:
        names.add(current_thread().name)
        return np.linalg.eigvalsh(stack)

    monkeypatch.setattr(running, "cores", lambda: 3)
    with running.keep_to_one_core():
        running.matrix_by_matrix(named, matrices)
        assert names == {current_thread().name}
    running.matrix_by_matrix(named, matrices)
    assert len(names) > 1


def test_an_error_in_a_helping_thread_reaches_the_caller(
    matrices: Array, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails_at_the_end(stack: Array) -> Array:
        if stack[-1, 0, 0] == matrices[-1, 0, 0]:
            raise np.linalg.LinAlgError("no convergence")
        return np.linalg.eigvalsh(stack)

    monkeypatch.setattr(running, "cores", lambda: 2)
    with pytest.raises(np.linalg.LinAlgError, match="no convergence"):
        running.matrix_by_matrix(fails_at_the_end, matrices)
