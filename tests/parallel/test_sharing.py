"""Distributed work gives the results of serial work, wherever it runs and whatever happens to the workers."""

import fcntl
import operator
import os
import pickle
import signal
import subprocess
import sys
import textwrap
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import dask
import distributed
import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from cpam_bayes.parallel import WorkersLostError, executors, lasting, observed, open_executor, run
from cpam_bayes.parallel.executors import Outcome, Ticket, copied, read_shared, work_through, write_shared
from tests.parallel import work

MATRIX = np.random.default_rng(0).normal(size=(30, 40))
N = 23
SPECS = ("", "Serial", "dask://host", "dask://:1", "dask://h:0", "dask://h:65536", "tls://h:1/2", "tcp://h:1")
NOBODY, NOBODY_TLS = "dask://127.0.0.1:1", "tls://127.0.0.1:1"
ENCRYPTED = {"distributed.comm.require-encryption": True}
CERTIFICATE = r"a certificate or key that Dask is set to use cannot be read \(.*No such file"
UNREADABLE = {f"distributed.comm.tls.{key}": "none.pem" for key in ("ca-file", "client.cert")}
NO_EXECUTORS = [
    *((s, None, {}, f"executor: received '{s}', accepted: processes, serial or dask:") for s in SPECS),
    ("serial", 2, {}, "number of workers: received 2 with executor .* with processes only"),
    (NOBODY, 2, {}, "number of workers: received 2 with executor .* with processes only"),
    (None, 0, {}, "number of workers: received 0, accepted: 1"),
    (NOBODY, None, {}, "received dask://127.0.0.1:1, but no Dask scheduler answers"),
    (NOBODY_TLS, None, {}, "Dask has no certificates; set ca-file, client.cert and client.key"),
    (NOBODY_TLS, None, UNREADABLE, CERTIFICATE),
    (NOBODY, None, ENCRYPTED, "require encryption; write tls:// for dask://"),
]
ENDS = [  # Events at a worker's start and at the first result; the owner's exit status and output.
    ("os.killpg(0, signal.SIGINT)", "None", (0, "interrupted\n", "")),
    ("pass", "os.killpg(0, signal.SIGINT)", (0, "interrupted\n", "")),
    ("pass", "os.kill(os.getpid(), signal.SIGKILL)", (-signal.SIGKILL,)),
]
LARGE = np.arange(1 << 19, dtype=float).reshape(-1, 64)
SMALL = np.arange(3)
UNSENT = ["It was raised while sending items 0 to 1."]
ARRAYS = [LARGE, LARGE.T, LARGE[:, ::2], LARGE.astype(np.int32), SMALL, np.empty((0, 4))]


@pytest.fixture(scope="module")
def two():
    with open_executor("processes", 2) as executor:
        yield executor


@pytest.fixture(scope="module")
def one():
    with open_executor(processes=1) as executor:
        yield executor


@pytest.fixture
def executor(request):
    if request.param in ("one", "two"):
        yield request.getfixturevalue(request.param)
        return
    is_pool = request.param == "pool"
    with ProcessPoolExecutor(2, get_context("spawn")) if is_pool else ThreadPoolExecutor(3) as found:
        yield found


@pytest.mark.parametrize("batch_size", [None, 1, 4, 100])
@pytest.mark.parametrize("executor", ["one", "two", "threads"], indirect=True)
def test_results_are_those_of_the_serial_run_and_each_is_told_once(executor, batch_size):
    seeds, observations = list(range(100, 100 + N)), []
    expected = [work.noisy_norm(MATRIX, seed) for seed in seeds]
    for where in (None, executor):
        told, asked = [], (work.noisy_norm, MATRIX, seeds, where)
        with observed(lambda *seen: observations.append(seen)):
            found = run(*asked, batch_size=batch_size, on_result=lambda *pair, told=told: told.append(pair))
            assert run(work.noisy_norm, MATRIX, [], where) == []
        assert found == expected == run(*asked)
        assert sorted(told) == list(enumerate(expected))
    assert observations == 2 * [(done, N) for done in range(N + 1)]


def test_memory_layout_does_not_tell_the_serial_run_from_a_shared_one(two):
    cube = np.random.default_rng(2).normal(size=(20, 30, 40))  # strided arrays take other paths in BLAS
    for shared in (MATRIX[::2, ::3], cube.transpose(0, 2, 1)):
        items = list(np.random.default_rng(1).normal(size=(3, 2 * shared.shape[-1]))[:, ::2])
        here, there = (run(operator.matmul, shared, items, where) for where in (None, two))
        assert np.array_equal(here, there)


def test_a_serial_run_leaves_its_items_as_they_were_and_takes_what_cannot_be_pickled():
    def drawn(shared: None, item: np.random.Generator) -> float:
        return float(item.normal())

    items = [np.random.default_rng(i) for i in range(3)]
    assert run(drawn, None, items) == run(drawn, None, items)
    assert run(lambda shared, item: shared(item), lambda x: x + 1, [1, 2]) == [2, 3]


def test_a_worker_keeps_the_shared_object_of_the_current_call_only(one):
    for factor in (1.0, 2.0, 3.0):
        (kept,) = run(work.sums_of_kept, factor * MATRIX, [0], one)
        assert kept == [float(np.sum(factor * MATRIX))]


@pytest.mark.parametrize("executor", ["two", "threads"], indirect=True)
def test_a_worker_that_lacks_the_file_gets_the_shared_object_with_a_batch_and_keeps_it(tmp_path, executor):
    class Elsewhere(Executor):  # whose workers do not see the files of this process
        _max_workers = 2

        def submit(self, fn, /, *args, **kwargs):
            Path(args[1].path).unlink(missing_ok=True)
            return executor.submit(fn, *args, **kwargs)

    log = tmp_path / "log"
    assert run(work.item_of, work.Counted(0, str(log)), range(N), Elsewhere(), batch_size=1) == list(range(N))
    assert len(work.lines(log)) == len(set(work.lines(log))) <= 2


@pytest.mark.slow
@pytest.mark.parametrize("executor", ["two", "pool"], indirect=True)
def test_what_a_killed_worker_was_doing_is_done_by_others(tmp_path, executor):
    flag = tmp_path / "flag"
    found = run(work.square_or_kill, (7, str(flag)), range(N), executor, batch_size=3)
    assert (found, flag.exists()) == ([item * item for item in range(N)], True)


@pytest.mark.slow
def test_an_item_that_kills_every_worker_is_named_once_all_others_are_done():
    told = {}
    lost = pytest.raises(WorkersLostError, match=r"items 3 to 3 of 6 .* lost 4 times")
    with open_executor(processes=1) as executor, lost:
        run(work.square_or_kill, (3, ""), range(6), executor, batch_size=1, on_result=told.__setitem__)
    assert told == {item: item * item for item in range(6) if item != 3}


def test_what_the_scheduler_of_dask_gives_up_is_sent_again_three_times():
    def die(*_: object) -> None:
        raise distributed.KilledWorker("task", SimpleNamespace(address="tcp://worker"), 3)

    class Unlucky(ThreadPoolExecutor):  # whose workers die when they get the batch of item 2
        def submit(self, fn, /, *args, **kwargs):
            return super().submit(die if pickle.loads(args[2]) == [2] else fn, *args, **kwargs)

    told = {}
    lost = pytest.raises(WorkersLostError, match=r"items 2 to 2 of 6 .* lost 4 times .*KilledWorker")
    with Unlucky(2) as executor, lost:
        run(work.square_or_kill, (-1, ""), range(6), executor, batch_size=1, on_result=told.__setitem__)
    assert told == {item: item * item for item in range(6) if item != 2}


@pytest.mark.parametrize("executor", ["two", "threads"], indirect=True)
def test_an_error_of_the_work_comes_as_it_is_with_its_item_and_stops_the_rest(tmp_path, executor):
    for name, where in (("here", None), ("there", executor)):
        log, gate = tmp_path / name, tmp_path / "gate"
        with gate.open("w") as held:
            fcntl.flock(held, fcntl.LOCK_EX)  # which blocks every item after the failing one
            with pytest.raises(LookupError, match="no luck with 12") as caught:
                run(work.fail_at, (12, str(log), str(gate)), range(10, 200), where, batch_size=1)
        assert "item 2 of 190" in caught.value.__notes__[-1]
        assert "12" in work.lines(log)  # at most those waiting in the executor's queue
        assert len(work.lines(log)) < 20
    assert "in fail_at" in caught.value.__notes__[0]  # where in the worker
    with pytest.raises(RuntimeError, match="OddError: odd indeed"):  # which cannot be pickled
        run(work.fail_oddly, None, [0], executor)


@pytest.mark.parametrize(("first", "notes"), [(TypeError("unpickled"), UNSENT), (OSError("disk full"), [])])
def test_what_waits_is_cancelled_when_sending_or_the_caller_fails(first, notes):
    # runs only the first batch: later ones are not sent, or their result is the caller's error
    class Waiting(Executor):
        _max_workers = 2

        def submit(self, fn, /, *args, **kwargs):
            futures.append(Future())
            if len(futures) == 1 and notes:
                futures[0].set_exception(first)
            elif len(futures) == 1:
                futures[0].set_result(Outcome((first, first)))
            return futures[-1]

    def fail(index: int, result: Exception) -> None:
        raise result

    futures: list[Future[Any]] = []
    with pytest.raises(type(first), match=str(first)) as caught:
        run(work.noisy_norm, MATRIX, range(N), Waiting(), batch_size=2, on_result=fail)
    assert getattr(caught.value, "__notes__", []) == notes
    assert {future.cancelled() for future in futures[1:]} == {True}


def test_a_worker_of_another_version_and_a_batch_without_items_are_refused():
    with pytest.raises(ValueError, match=r"has cpam_bayes .*, this process 0\.0\.0; install the same"):
        work_through(work.noisy_norm, Ticket("", version="0.0.0"), pickle.dumps([1]))
    with pytest.raises(ValueError, match="batch_size: received 0, accepted: 1 or more"):
        run(work.noisy_norm, MATRIX, [1], batch_size=0)


def test_blas_has_one_thread_here_and_in_any_worker_and_all_of_its_own_after_them():
    def threads() -> list[int]:
        return [info["num_threads"] for info in threadpool_info() if info["user_api"] == "blas"]

    with threadpool_limits(2, user_api="blas"), ThreadPoolExecutor(2) as executor:
        before = threads()
        assert max(before) == 2
        assert run(work.blas_threads, MATRIX, range(2)) == [1, 1]
        assert run(work.blas_threads, MATRIX, range(8), executor, batch_size=1) == [1] * 8
        ticket = Ticket("any", pickled=pickle.dumps(MATRIX))
        assert work_through(work.blas_threads, ticket, pickle.dumps([0, 1])).results == (1, 1)
        assert threads() == before


@pytest.mark.parametrize(("at_start", "on_result", "ended"), ENDS)
def test_workers_leave_without_a_word_with_their_session_or_their_owner(tmp_path, at_start, on_result, ended):
    """A program in a session of its own, whose workers wait forever."""
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
    program = subprocess.Popen(
        [sys.executable, str(path)], text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}, start_new_session=True,
        # a shell that runs the tests in the background makes them and their children ignore interrupts
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    try:
        output, errors = program.communicate(timeout=120)  # its output stays open until workers are gone
    except subprocess.TimeoutExpired:
        os.killpg(program.pid, signal.SIGKILL)
        program.communicate()
        raise
    assert (program.returncode, output, errors)[: len(ended)] == ended


@pytest.mark.parametrize("executor", ["two", "threads"], indirect=True)
def test_what_several_calls_share_is_sent_to_a_process_once(executor, tmp_path):
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


def test_objects_that_last_leave_no_file(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with open_executor("processes", 1) as executor:
        for factor in (1.0, 2.0):
            lasting([factor * MATRIX], executor)
        assert len(list(tmp_path.iterdir())) == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("spec", "workers", "settings", "said"), NO_EXECUTORS)
def test_what_cannot_be_an_executor_is_refused(spec, workers, settings, said):
    refusal = pytest.raises(ValueError, match=said)
    with dask.config.set(settings), refusal, open_executor(spec, workers, patience=0.2):
        pass


def test_without_dask_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    refusal = pytest.raises(ValueError, match=r"Dask is not installed; install cpam-bayes\[dask\]")
    with refusal, open_executor(NOBODY):
        pass


def test_an_address_with_tls_reaches_dask_with_tls(monkeypatch):
    asked = []

    def client(address: str, **_: object) -> None:
        asked.append(address)
        raise OSError

    monkeypatch.setattr(distributed, "Client", client)
    monkeypatch.setattr(distributed.Security, "get_connection_args", lambda *_: {"ssl_context": 1})
    with pytest.raises(ValueError, match="no Dask scheduler answers"), open_executor("tls://[::1]:8786/"):
        pass
    assert asked == ["tls://[::1]:8786"]


def test_the_number_of_workers_is_what_the_executor_says_and_serial_work_has_none(two):
    with ThreadPoolExecutor(3) as threads, open_executor("serial") as none:
        assert ([executors.workers_of(each) for each in (threads, two)], none) == ([3, 2], None)


@pytest.mark.parametrize("array", ARRAYS)
def test_arrays_of_any_order_size_and_type_come_back(array, tmp_path):
    path = tmp_path / "shared"
    with path.open("wb") as file:
        write_shared({"name": [array, SMALL, array + 1], "a": (1, "b")}, file)
    found = read_shared(path)
    path.unlink()  # the arrays outlive it
    assert found["a"] == (1, "b")
    for one, expected in zip(found["name"], (array, SMALL, array + 1), strict=True):
        np.testing.assert_array_equal(one, expected, strict=True)


def test_who_writes_into_a_shared_array_has_a_copy_and_the_same_array_is_written_once(tmp_path):
    path = tmp_path / "shared"
    with path.open("wb") as file:
        write_shared((LARGE, LARGE), file)
    assert path.stat().st_size < LARGE.nbytes + 1000
    (one, _), (other, _) = read_shared(path), read_shared(path)
    one[0] = -1.0
    for unchanged in (other, read_shared(path)[0]):
        np.testing.assert_array_equal(unchanged, LARGE)
    for array, of_this_process in zip((SMALL, LARGE), copied((SMALL, LARGE)), strict=True):
        assert of_this_process.flags.writeable
        assert not np.shares_memory(array, of_this_process)
