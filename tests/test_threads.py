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


def test_the_limit_is_lifted_at_the_end_of_the_outer_function_even_of_a_failure() -> None:
    inner = single_blas_thread(blas_threads)

    @single_blas_thread
    def fail() -> None:
        assert (inner(), blas_threads()) == (1, 1)
        raise LookupError

    with pytest.raises(LookupError):
        fail()
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


def test_a_stack_is_shared_out_but_by_workers_and_its_answer_is_that_of_one_thread_to_the_last_bit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    matrices = np.random.default_rng(3).normal(size=(101, 30, 30))
    matrices += matrices.swapaxes(1, 2)
    expected = np.linalg.eigvalsh(matrices)
    shares: list[tuple[int, str]] = []

    def counted(stack: Array) -> Array:
        shares.append((len(stack), current_thread().name))
        return np.linalg.eigvalsh(stack)

    def fails_at_the_end(stack: Array) -> Array:
        if stack[-1, 0, 0] == matrices[-1, 0, 0]:
            raise np.linalg.LinAlgError("no convergence")
        return np.linalg.eigvalsh(stack)

    monkeypatch.setattr(running, "cores", lambda: 3)
    with running.keep_to_one_core():
        running.matrix_by_matrix(counted, matrices)
    assert {name for _, name in shares} == {current_thread().name}
    shares.clear()
    found = running.matrix_by_matrix(counted, matrices)
    assert sorted(size for size, _ in shares) == [33, 34, 34]
    assert len({name for _, name in shares}) > 1
    np.testing.assert_array_equal(found, expected)
    with pytest.raises(np.linalg.LinAlgError, match="no convergence"):
        running.matrix_by_matrix(fails_at_the_end, matrices)
