"""The same work on a Dask cluster of this machine: a scheduler and two worker processes."""

import json
import os
import signal
import subprocess
import sys
from contextlib import contextmanager, suppress

import numpy as np
import pytest
from distributed import Client

from cpam_bayes import __version__
from cpam_bayes.forward_model.build import reduced_model
from cpam_bayes.inference.posterior import plate_posterior
from cpam_bayes.parallel import WorkersLostError, open_executor, run
from cpam_bayes.plate import read_specimen
from tests.parallel import work

pytestmark = pytest.mark.slow
OLD = ('__version__ = "0.0.1"', r"the Dask worker tcp://\S+ has 0\.0\.1; install the same version")
BROKEN = ('raise ImportError("not here")', r"the Dask worker tcp://\S+ cannot import it \(.*not here")


@contextmanager
def _started(directory, path, *words):
    with (directory / "log").open("ab") as log:
        program = subprocess.Popen(
            [sys.executable, "-m", "dask", *words, "--host", "127.0.0.1", "--no-dashboard"],
            stdout=log, stderr=log, cwd=directory, start_new_session=True,
            env={**os.environ, "PYTHONPATH": os.pathsep.join([*path, *sys.path])},
        )  # fmt: skip
    try:
        yield program
    finally:
        with suppress(ProcessLookupError):
            os.killpg(program.pid, signal.SIGKILL)
        program.wait()


def _scheduler(directory):
    return _started(directory, [], "scheduler", "--port", "0", "--scheduler-file", str(directory / "address"))


def _workers(directory, n, *path):
    options = ("--nworkers", str(n), "--nthreads", "1", "--memory-limit", "0")
    place = ("--scheduler-file", str(directory / "address"), "--local-directory", str(directory))
    return _started(directory, list(path), "worker", *options, *place)


def _client(directory):
    """Client that waits for the scheduler's file, as workers do."""
    return Client(scheduler_file=str(directory / "address"), timeout=120, set_as_default=False)


def _spec(directory):
    with _client(directory):
        return json.loads((directory / "address").read_text())["address"].replace("tcp://", "dask://")


@pytest.fixture(scope="module")
def directory(tmp_path_factory):
    return tmp_path_factory.mktemp("dask")


@pytest.fixture(scope="module")
def spec(directory):
    with _scheduler(directory), _workers(directory, 2):
        with _client(directory) as client:
            client.wait_for_workers(2, timeout=120)
        yield _spec(directory)


def test_the_posterior_of_a_plate_is_the_same_bit_for_bit_when_a_worker_is_killed_too(spec, tmp_path):
    specimen = read_specimen("C1")
    model = reduced_model(specimen, specimen.unknowns, specimen.measurement.size)
    posterior = plate_posterior(model, specimen.measurement, model.full.error)

    counted, flag = work.Counted(0, str(tmp_path / "log")), tmp_path / "killed"
    here = np.array(run(work.log_probabilities, (posterior, counted, ""), range(24)))
    assert np.isfinite(here[:, :-1]).any(axis=1).all()
    with open_executor(spec) as cluster:
        for batch_size in (1, 5, None):
            log = tmp_path / f"log {batch_size}"
            shared = (posterior, work.Counted(0, str(log)), "")
            there = run(work.log_probabilities, shared, range(24), cluster, batch_size=batch_size)
            assert np.array_equal(here[:, :-1], np.array(there)[:, :-1])  # all but the process id
            assert all(found.flags.writeable for found in there)  # like those of a serial run
            processes = {f"{found[-1]:.0f}" for found in there}
            assert str(os.getpid()) not in processes
            assert sorted(work.lines(log)) == sorted(processes)
        # the workers lack this program's main module and definitions inside functions
        assert run(lambda shared, item: shared(item), lambda x: x + 1, [1, 2], cluster) == [2, 3]
        shared = (posterior, counted, str(flag))
        there = run(work.log_probabilities, shared, range(24), cluster, batch_size=4)
    assert flag.exists()
    assert np.array_equal(here[:, :-1], np.array(there)[:, :-1])


@pytest.mark.parametrize(("source", "message"), [OLD, BROKEN])
def test_a_worker_without_this_version_is_refused(spec, directory, tmp_path, source, message):
    package = tmp_path / "cpam_bayes"
    package.mkdir()
    (package / "__init__.py").write_text(source)
    (package / "parallel.py").touch()
    with _workers(directory, 1, str(tmp_path)):
        with _client(directory) as client:
            client.wait_for_workers(3, timeout=120)
        refusal = pytest.raises(ValueError, match=f"this process has cpam_bayes {__version__}.*{message}")
        with refusal, open_executor(spec):
            pass


def test_a_scheduler_without_workers_is_an_error_and_one_that_goes_away_ends_the_work(tmp_path):
    with _scheduler(tmp_path) as scheduler:
        spec = _spec(tmp_path)
        lacking = pytest.raises(ValueError, match=f"the Dask scheduler {spec} has no workers")
        with lacking, open_executor(spec, patience=0.5):
            pass

        def stop(index: int, result: int) -> None:
            with suppress(ProcessLookupError):  # results already on their way may arrive after the first
                os.killpg(scheduler.pid, signal.SIGKILL)
            scheduler.wait()

        gone = pytest.raises(WorkersLostError, match=r"the Dask scheduler at tcp://127\.0\.0\.1:\d+ is gone")
        with _workers(tmp_path, 1), open_executor(spec, patience=10) as executor, gone:
            run(work.square_or_kill, (-1, ""), range(5000), executor, batch_size=1, on_result=stop)
