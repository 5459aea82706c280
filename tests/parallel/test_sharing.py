"""Shared-out work gives what serial work gives, whatever happens to the workers."""

import os
import pickle
import signal
import subprocess
import sys
import textwrap
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import nullcontext
from multiprocessing import get_context
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from cpam_bayes.parallel import WorkersLostError, lasting, observed, open_executor, run
from cpam_bayes.parallel.executors import Ticket, work_through
from tests.parallel import work

MATRIX = np.random.default_rng(0).normal(size=(30, 40))
N = 23


@pytest.fixture(scope="module")
def two() -> Iterator[Executor | None]:
    with open_executor("processes", 2) as executor:
        yield executor


@pytest.fixture(scope="module")
def one() -> Iterator[Executor | None]:
    with open_executor(processes=1) as executor:
        yield executor


@pytest.fixture
def executor(request: pytest.FixtureRequest) -> Iterator[Executor | None]:
    if request.param == "threads":
        with ThreadPoolExecutor(3) as found:
            yield found
    elif request.param == "pool":
        with ProcessPoolExecutor(2, get_context("spawn")) as found:
            yield found
    else:
        yield request.getfixturevalue(request.param)


@pytest.mark.parametrize("batch_size", [None, 1, 4, 100])
@pytest.mark.parametrize("executor", ["one", "two", "threads"], indirect=True)
def test_results_are_those_of_the_serial_run_in_the_order_of_the_items(
    executor: Executor, batch_size: int | None
) -> None:
    seeds = list(range(100, 100 + N))
    expected = [work.noisy_norm(MATRIX, seed) for seed in seeds]
    assert run(work.noisy_norm, MATRIX, seeds) == expected
    assert run(work.noisy_norm, MATRIX, seeds, executor, batch_size=batch_size) == expected


@pytest.mark.parametrize("executor", ["two", "threads"], indirect=True)
def test_an_observer_is_told_of_all_that_is_shared_out(executor: Executor) -> None:
    seen: list[tuple[int, int]] = []
    with observed(lambda done, total: seen.append((done, total))):
        run(work.noisy_norm, MATRIX, range(3), executor)
        run(work.noisy_norm, MATRIX, range(2))
        run(work.noisy_norm, MATRIX, ())
    run(work.noisy_norm, MATRIX, range(3), executor)
    assert seen == [(0, 3), (1, 3), (2, 3), (3, 3), (0, 2), (1, 2), (2, 2)]


@pytest.mark.parametrize("executor", ["two", "threads"], indirect=True)
def test_every_result_is_told_once_with_its_index(executor: Executor) -> None:
    for where in (None, executor):
        told: list[tuple[int, int]] = []
        asked = (work.square_or_kill_always, -1, range(N), where)
        found = run(*asked, on_result=lambda *pair, told=told: told.append(pair))
        assert sorted(told) == list(enumerate(found))


CUBE = np.random.default_rng(2).normal(size=(20, 30, 40))


@pytest.mark.parametrize("shared", [MATRIX[::2, ::3], CUBE.transpose(0, 2, 1)], ids=["strided", "permuted"])
def test_memory_layout_does_not_tell_the_serial_run_from_a_shared_one(
    two: Executor, shared: np.ndarray
) -> None:
    # products of strided arrays take other paths in BLAS, with other rounding
    vectors = np.random.default_rng(1).normal(size=(2 * shared.shape[-1], 3))[::2]
    items = [vectors[:, i] for i in range(3)]
    here = run(work.column_sum, shared, items)
    there = run(work.column_sum, shared, items, two)
    assert np.array_equal(here, there)


def test_a_serial_run_leaves_its_items_as_they_were_and_takes_what_cannot_be_pickled(two: Executor) -> None:
    items = [np.random.default_rng(i) for i in range(3)]
    assert run(work.draw, None, items) == run(work.draw, None, items)
    assert run(lambda shared, item: shared(item), lambda x: x + 1, [1, 2]) == [2, 3]
    assert run(work.noisy_norm, MATRIX, [], two) == run(work.noisy_norm, MATRIX, []) == []


def test_the_shared_object_is_restored_once_in_each_process(tmp_path: Path, two: Executor) -> None:
    log, pipe = tmp_path / "log", tmp_path / "pipe"
    os.mkfifo(pipe)
    found = run(work.meeting, work.Counted(str(pipe), str(log)), range(N), two, batch_size=1)
    processes = {str(process) for _, process in found}
    assert len(processes) == 2
    assert sorted(work.lines(log)) == sorted(processes)


def test_a_worker_keeps_the_shared_object_of_the_current_call_only(one: Executor) -> None:
    for factor in (1.0, 2.0, 3.0):
        (kept,) = run(work.sums_of_kept, factor * MATRIX, [0], one)
        assert kept == [float(np.sum(factor * MATRIX))]


@pytest.mark.parametrize("executor", ["two", "threads"], indirect=True)
def test_a_worker_that_lacks_the_file_gets_the_shared_object_with_a_batch(
    tmp_path: Path, executor: Executor
) -> None:
    class Elsewhere(Executor):
        """Workers that do not see the files of this process."""

        _max_workers = 2

        def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
            Path(args[1].path).unlink(missing_ok=True)
            return executor.submit(fn, *args, **kwargs)

    log = tmp_path / "log"
    counted = work.Counted(0, str(log))
    found = run(work.process_of_counted, counted, range(N), Elsewhere(), batch_size=1)
    assert [item for item, _ in found] == list(range(N))
    assert len(work.lines(log)) == len(set(work.lines(log))) <= 2


@pytest.mark.slow
@pytest.mark.parametrize("executor", ["two", "pool"], indirect=True)
def test_what_a_killed_worker_was_doing_is_done_by_others(tmp_path: Path, executor: Executor) -> None:
    flag = tmp_path / "flag"
    found = run(work.square_or_kill_once, str(flag), range(N), executor, batch_size=3)
    assert found == [item * item for item in range(N)]
    assert flag.exists()


@pytest.mark.slow
def test_an_item_that_kills_every_worker_is_named_once_all_others_are_done() -> None:
    told: dict[int, int] = {}
    with (
        open_executor(processes=1) as executor,
        pytest.raises(WorkersLostError, match=r"items 3 to 3 of 6 .* lost 4 times"),
    ):
        run(work.square_or_kill_always, 3, range(6), executor, batch_size=1, on_result=told.__setitem__)
    assert told == {item: item * item for item in range(6) if item != 3}


@pytest.mark.parametrize("losses", [1, 3, 4])
def test_what_the_scheduler_of_dask_gives_up_is_sent_again_three_times(losses: int) -> None:
    from distributed import KilledWorker

    class Unlucky(ThreadPoolExecutor):
        """The workers that get the batch of item 2 die, at first."""

        deaths = 0

        def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
            if pickle.loads(args[2]) == [2] and self.deaths < losses:
                self.deaths += 1
                lost: Future[Any] = Future()
                lost.set_exception(KilledWorker("task", SimpleNamespace(address="tcp://worker"), 3))
                return lost
            return super().submit(fn, *args, **kwargs)

    told: dict[int, int] = {}
    with Unlucky(2) as executor:
        lost = pytest.raises(WorkersLostError, match=r"items 2 to 2 of 6 .* lost 4 times .*KilledWorker")
        with lost if losses > 3 else nullcontext():
            asked = (work.square_or_kill_always, -1, range(6), executor)
            run(*asked, batch_size=1, on_result=told.__setitem__)
        assert told == {item: item * item for item in range(6) if losses <= 3 or item != 2}
        assert executor.deaths == losses


@pytest.mark.parametrize("executor", ["two", "threads"], indirect=True)
def test_an_error_of_the_work_comes_as_it_is_with_its_item_and_stops_the_rest(
    tmp_path: Path, executor: Executor
) -> None:
    for name, where in (("here", None), ("there", executor)):
        log = tmp_path / name
        with (
            work.held_back(tmp_path / "gate") as gate,
            pytest.raises(LookupError, match="no luck with 12") as caught,
        ):
            run(work.fail_at_gate, (12, str(log), gate), range(10, 200), where, batch_size=1)
        assert "item 2 of 190" in caught.value.__notes__[-1]
        # at most those that were waiting in the queue of the executor
        assert "12" in work.lines(log)
        assert len(work.lines(log)) < 20


def test_an_error_of_the_work_shows_where_in_the_worker_it_was_raised(tmp_path: Path, one: Executor) -> None:
    with pytest.raises(LookupError) as caught:
        run(work.fail_at, (0, str(tmp_path / "log")), [0], one)
    assert "in fail_at" in caught.value.__notes__[0]
    with pytest.raises(RuntimeError, match="OddError: odd indeed"):  # which cannot be pickled
        run(work.fail_oddly, None, [0], one)


def test_an_error_of_the_caller_stops_the_rest(tmp_path: Path, two: Executor) -> None:
    def refuse(index: int, result: int) -> None:
        raise OSError("disk full")

    log = tmp_path / "log"
    with pytest.raises(OSError, match="disk full"):
        run(work.fail_at, (-1, str(log)), range(200), two, batch_size=1, on_result=refuse)
    assert len(work.lines(log)) < 20


def test_what_waits_is_cancelled_when_something_fails() -> None:
    class Waiting(Executor):
        """Does nothing but the first batch, which it fails to send."""

        _max_workers = 2

        def __init__(self) -> None:
            self.futures: list[Future[Any]] = []

        def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
            self.futures.append(Future())
            if len(self.futures) == 1:
                self.futures[0].set_exception(TypeError("cannot pickle"))
            return self.futures[-1]

    executor = Waiting()
    with pytest.raises(TypeError, match="cannot pickle"):
        run(work.noisy_norm, MATRIX, range(N), executor)
    assert len(executor.futures) > 1
    assert all(future.cancelled() for future in executor.futures[1:])


def test_work_that_cannot_be_sent_is_said_with_its_items(two: Executor) -> None:
    with pytest.raises((AttributeError, pickle.PicklingError)) as caught:
        run(lambda shared, item: item, None, [1, 2], two, batch_size=2)
    assert "items 0 to 1" in caught.value.__notes__[-1]


def test_a_worker_of_another_version_refuses() -> None:
    with pytest.raises(ValueError, match=r"has cpam_bayes .*, this process 0\.0\.0; install the same"):
        work_through(work.noisy_norm, Ticket("", version="0.0.0"), pickle.dumps([1]))


def test_a_batch_without_items_is_refused() -> None:
    with pytest.raises(ValueError, match="batch_size: received 0, accepted: 1 or more"):
        run(work.noisy_norm, MATRIX, [1], batch_size=0)


def test_blas_has_one_thread_in_workers(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        monkeypatch.setenv(name, "2")
    with open_executor(processes=1) as executor:
        assert run(work.blas_threads, MATRIX, range(2), executor) == [1, 1]


def test_blas_has_one_thread_in_threads_and_all_of_its_own_after_them() -> None:
    def before_and_after() -> list[int]:
        return [info["num_threads"] for info in threadpool_info() if info["user_api"] == "blas"]

    with threadpool_limits(2, user_api="blas"), ThreadPoolExecutor(2) as executor:
        before = before_and_after()
        assert max(before) == 2
        assert run(work.blas_threads, MATRIX, range(8), executor, batch_size=1) == [1] * 8
        assert before_and_after() == before


def test_blas_has_one_thread_in_this_process_and_in_a_worker_of_any_kind() -> None:
    pickled = pickle.dumps(MATRIX)
    with threadpool_limits(2, user_api="blas"):
        assert run(work.blas_threads, MATRIX, range(2)) == [1, 1]
        outcome = work_through(work.blas_threads, Ticket("any", pickled=pickled), pickle.dumps([0, 1]))
    assert outcome.results == (1, 1)


def _script(
    tmp_path: Path, at_start: str = "pass", on_result: str = "None"
) -> subprocess.CompletedProcess[str]:
    """A program of a session of its own whose workers wait for ever; returns when all of them have left."""
    path = tmp_path / "script.py"
    text = f"""
        import os, signal
        from cpam_bayes.parallel import open_executor, run

        def work(shared, item):
            if item:
                signal.pause()
            return item

        if __name__ == "__mp_main__":  # a worker that starts
            {at_start}

        if __name__ == "__main__":
            try:
                with open_executor(processes=2) as executor:
                    run(work, None, range(6), executor, batch_size=1, on_result=lambda *_: {on_result})
            except KeyboardInterrupt:
                print("interrupted")
    """
    path.write_text(textwrap.dedent(text))
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    program = subprocess.Popen(
        [sys.executable, str(path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
        start_new_session=True,
        # a shell that puts the tests in the background has them ignore interrupts, and what they start
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    try:
        # the workers hold its standard output open, so this ends once the last of them is gone
        output, errors = program.communicate(timeout=120)
    except subprocess.TimeoutExpired:
        os.killpg(program.pid, signal.SIGKILL)
        program.communicate()
        raise
    return subprocess.CompletedProcess(program.args, program.returncode, output, errors)


@pytest.mark.parametrize("moment", ["at_start", "on_result"])
def test_an_interrupt_of_the_whole_session_stops_workers_without_a_word(tmp_path: Path, moment: str) -> None:
    done = _script(tmp_path, **{moment: "os.killpg(0, signal.SIGINT)"})
    assert (done.returncode, done.stdout, done.stderr) == (0, "interrupted\n", "")


def test_workers_leave_when_their_owner_is_killed(tmp_path: Path) -> None:
    done = _script(tmp_path, on_result="os.kill(os.getpid(), signal.SIGKILL)")
    assert done.returncode == -signal.SIGKILL


@pytest.mark.parametrize("executor", ["two", "threads"], indirect=True)
def test_what_several_calls_share_is_sent_to_a_process_once(executor: Executor, tmp_path: Path) -> None:
    log = tmp_path / "restored"
    parts = [work.Counted(3, str(log)), work.Counted(4, str(log))]
    for of_call in (10, 20, 30):
        found = run(work.of_lasting, (lasting(list(parts), executor), of_call), range(8), executor)
        assert found == [([3, 4], of_call + item) for item in range(8)]
    if not isinstance(executor, ThreadPoolExecutor):
        assert len(work.lines(log)) == len(parts) * len(set(work.lines(log)))
    parts[1] = work.Counted(5, str(log))
    (found,) = run(work.of_lasting, (lasting(parts, executor), 0), [0], executor)
    assert found == ([3, 5], 0)


def test_objects_that_last_leave_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with open_executor("processes", 1) as executor:
        lasting([MATRIX], executor)
        lasting([2.0 * MATRIX], executor)
        assert len(list(tmp_path.iterdir())) == 1
    assert not list(tmp_path.iterdir())
