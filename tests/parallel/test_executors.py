"""Where work is done, and what all items share."""

import argparse
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import dask
import distributed
import numpy as np
import pytest

from cpam_bayes.command import add_executor_options
from cpam_bayes.parallel import executors, open_executor, read_spec
from cpam_bayes.parallel.executors import copied, read_shared, write_shared


@pytest.mark.parametrize(
    "spec",
    [
        "processes",
        "serial",
        "dask://10.0.0.7:8786",
        "dask://[::1]:8786",
        "tls://10.0.0.7:8786",
        "tls://[::1]:8786",
    ],
)
def test_names_of_executors_are_accepted(spec: str) -> None:
    assert read_spec(spec) == spec


SPECS = (
    "",
    "ray",
    "Serial",
    "dask",
    "dask://",
    "dask://host",
    "dask://:1",
    "dask://h:0",
    "dask://h:65536",
    "tls://host",
    "tls://h:0",
    "tcp://h:1",
)
NOBODY = "dask://127.0.0.1:1"


@pytest.mark.parametrize(
    ("spec", "workers", "said"),
    [
        *((s, None, f"executor: received '{s}', accepted: processes, serial or dask:") for s in SPECS),
        ("serial", 2, "number of workers: received 2 with executor .* with processes only"),
        (NOBODY, 2, "number of workers: received 2 with executor .* with processes only"),
        (None, 0, "number of workers: received 0, accepted: 1"),
        (NOBODY, None, "received dask://127.0.0.1:1, but no Dask scheduler answers"),
    ],
)
def test_what_cannot_be_an_executor_is_refused(spec: str | None, workers: int | None, said: str) -> None:
    with pytest.raises(ValueError, match=said), open_executor(spec, workers, patience=0.2):
        pass


def test_without_dask_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with (
        pytest.raises(ValueError, match=r"Dask is not installed; install cpam-bayes\[dask\]"),
        open_executor("dask://127.0.0.1:1"),
    ):
        pass


TLS = "distributed.comm.tls"


@pytest.mark.parametrize(
    ("spec", "settings", "said"),
    [
        ("tls://127.0.0.1:1", {}, "Dask has no certificates; set ca-file, client.cert and client.key"),
        (
            "tls://127.0.0.1:1",
            {f"{TLS}.ca-file": "none.pem", f"{TLS}.client.cert": "none.pem"},
            r"a certificate or key that Dask is set to use cannot be read \(.*No such file",
        ),
        (
            NOBODY,
            {"distributed.comm.require-encryption": True},
            "require encryption; write tls:// for dask://",
        ),
    ],
)
def test_encryption_is_as_dask_is_set_or_the_cure_is_named(
    spec: str, settings: dict[str, object], said: str
) -> None:
    with dask.config.set(settings), pytest.raises(ValueError, match=said), open_executor(spec, patience=0.2):
        pass


def test_an_address_with_tls_reaches_dask_with_tls(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def client(address: str, **_: object) -> None:
        asked.append(address)
        raise OSError

    monkeypatch.setattr(distributed, "Client", client)
    monkeypatch.setattr(distributed.Security, "get_connection_args", lambda *_: {"ssl_context": 1})
    with pytest.raises(ValueError, match="no Dask scheduler answers"), open_executor("tls://[::1]:8786/"):
        pass
    assert asked == ["tls://[::1]:8786"]


def test_the_number_of_workers_is_what_the_executor_says_and_serial_work_has_none() -> None:
    with (
        ThreadPoolExecutor(3) as threads,
        open_executor(processes=2) as pool,
        open_executor("serial") as none,
    ):
        assert executors.workers_of(threads) == 3
        assert pool is not None
        assert executors.workers_of(pool) == 2
        assert none is None


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


LARGE = np.arange(1 << 19, dtype=float).reshape(-1, 64)
SMALL = np.arange(3)


def written(value: object, path: Path) -> Path:
    with path.open("wb") as file:
        write_shared(value, file)
    return path


@pytest.mark.parametrize(
    "array", [LARGE, LARGE.T, LARGE[:, ::2], LARGE.astype(np.int32), SMALL, np.empty((0, 4))]
)
def test_arrays_of_any_order_size_and_type_come_back(array: np.ndarray, tmp_path: Path) -> None:
    path = written({"name": [array, SMALL, array + 1], "a": (1, "b")}, tmp_path / "shared")
    found = read_shared(path)
    path.unlink()  # which the arrays outlive
    assert found["a"] == (1, "b")
    for one, expected in zip(found["name"], (array, SMALL, array + 1), strict=True):
        assert one.dtype == expected.dtype
        np.testing.assert_array_equal(one, expected)


def test_who_writes_into_a_shared_array_has_a_copy_and_the_same_array_is_written_once(tmp_path: Path) -> None:
    path = written((LARGE, LARGE), tmp_path / "shared")
    assert path.stat().st_size < LARGE.nbytes + 1000
    (one, _), (other, _) = read_shared(path), read_shared(path)
    one[0] = -1.0
    np.testing.assert_array_equal(other, LARGE)
    np.testing.assert_array_equal(read_shared(path)[0], LARGE)


def test_a_copy_in_this_process_shares_nothing() -> None:
    small, large = copied((SMALL, LARGE))
    assert not np.shares_memory(large, LARGE)
    assert not np.shares_memory(small, SMALL)
    large[0] = -1.0
    np.testing.assert_array_equal(LARGE[0], np.arange(64.0))
