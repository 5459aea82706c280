"""Names of executors, and what is said of those that cannot be had."""

from __future__ import annotations

import argparse
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest

from cpam_bayes.commands.options import add_executor_options
from cpam_bayes.parallel import executors, open_executor, read_spec


@pytest.mark.parametrize("spec", ["processes", "serial", "dask://10.0.0.7:8786", "dask://[::1]:8786"])
def test_names_of_executors_are_accepted(spec: str) -> None:
    assert read_spec(spec) == spec


@pytest.mark.parametrize(
    "spec",
    ["", "ray", "Serial", "dask", "dask://", "dask://host", "dask://:1", "dask://h:0", "dask://h:65536"],
)
def test_other_names_are_refused_with_those_accepted(spec: str) -> None:
    with (
        pytest.raises(ValueError, match=f"executor: received '{spec}', accepted: processes, serial or dask:"),
        open_executor(spec),
    ):
        pass


def test_serial_work_has_no_executor() -> None:
    with open_executor("serial") as executor:
        assert executor is None


@pytest.mark.parametrize("spec", ["serial", "dask://127.0.0.1:1"])
def test_a_number_of_workers_is_for_processes_only(spec: str) -> None:
    with (
        pytest.raises(
            ValueError, match=r"number of workers: received 2 with executor .* with processes only"
        ),
        open_executor(spec, 2),
    ):
        pass


def test_no_workers_are_refused() -> None:
    with (
        pytest.raises(ValueError, match="number of workers: received 0, accepted: 1"),
        open_executor(None, 0),
    ):
        pass


def test_a_scheduler_that_does_not_answer_is_an_error() -> None:
    with (
        pytest.raises(ValueError, match=r"received dask://127\.0\.0\.1:1, but no Dask scheduler answers"),
        open_executor("dask://127.0.0.1:1", patience=0.2),
    ):
        pass


def test_without_dask_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with (
        pytest.raises(ValueError, match=r"Dask is not installed; install cpam-bayes\[dask\]"),
        open_executor("dask://127.0.0.1:1"),
    ):
        pass


def test_the_number_of_workers_is_what_the_executor_says() -> None:
    with ThreadPoolExecutor(3) as threads:
        assert executors.workers_of(threads) == 3
    with open_executor(processes=2) as pool:
        assert pool is not None
        assert executors.workers_of(pool) == 2


def test_the_options_of_the_command_line_are_read() -> None:
    parser = argparse.ArgumentParser()
    add_executor_options(parser)
    args = parser.parse_args(["--executor", "dask://host:8786", "--workers", "3"])
    assert (args.executor, args.workers) == ("dask://host:8786", 3)
    args = parser.parse_args([])
    assert (args.executor, args.workers) == (None, None)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--executor", "ray"], "argument --executor: received 'ray', accepted: processes, serial or dask:"),
        (["--workers", "0"], "argument --workers: received '0', accepted: a whole number from 1"),
        (["--workers", "two"], "argument --workers: received 'two'"),
    ],
)
def test_wrong_options_are_refused(
    options: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    parser = argparse.ArgumentParser()
    add_executor_options(parser)
    with pytest.raises(SystemExit) as left:
        parser.parse_args(options)
    assert left.value.code == 2
    assert message in capsys.readouterr().err
