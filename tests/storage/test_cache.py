"""The cache of models: its place, its limit, its removal, and several processes at once."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import cpam_bayes as cb
from cpam_bayes.storage.cache import (
    cache_content,
    cache_directory,
    make_room,
    model_file,
    read_model,
    write_model,
)

MODEL = {"matrix": np.arange(1000.0)}


def name_of(number: int) -> str:
    return hashlib.sha256(str(number).encode()).hexdigest()[:32]


@pytest.fixture
def directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("CPAM_BAYES_CACHE", str(tmp_path / "cache"))
    monkeypatch.delenv("CPAM_BAYES_CACHE_GIB", raising=False)
    return tmp_path / "cache"


def stored(numbers: range) -> list[Path]:
    """Models, the first one used longest ago."""
    paths = [model_file(name_of(i)) for i in numbers]
    for i, path in enumerate(paths):
        write_model(path, MODEL)
        os.utime(path, (1e9 + i, 1e9 + i))
    return paths


def test_the_models_used_least_recently_leave_first(directory: Path) -> None:
    paths = stored(range(10))
    size = paths[0].stat().st_size
    assert read_model(paths[0]) is not None  # used now: the last to leave
    make_room(directory, 6 * size)
    assert [path.exists() for path in paths] == [True] + 5 * [False] + 4 * [True]


def test_a_cache_within_its_limit_is_left_alone_and_a_new_model_makes_its_own_room(
    directory: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    paths = stored(range(4))
    make_room(directory, sum(path.stat().st_size for path in paths))
    assert all(path.exists() for path in paths)
    monkeypatch.setenv("CPAM_BAYES_CACHE_GIB", str(1.5 * paths[0].stat().st_size / 2**30))
    (new,) = stored(range(4, 5))
    assert list(directory.iterdir()) == [new], "the newest stays however small the limit is"


def test_only_files_of_this_package_are_counted_and_removed(directory: Path) -> None:
    stored(range(2))
    (directory / f"{name_of(7)}.npz").write_bytes(b"of an earlier version")
    (directory / f"{name_of(8)}-local4.arrays.damaged").write_bytes(b"set aside")
    (directory / "paper").mkdir()
    for name in ("mine.npz", "notes.arrays", "paper/table.results"):
        (directory / name).write_text("not a model")
    assert cache_content(directory).files == 4
    result = cb.cache(clear=True)
    assert (result.removed.files, result.content.files, result.content.size) == (4, 0, 0)
    assert sorted(p.name for p in directory.iterdir()) == ["mine.npz", "notes.arrays", "paper"]


@pytest.mark.parametrize("given", ["much", "-1", "0", "nan", "inf"])
def test_a_limit_that_is_none_is_refused_before_anything_is_built(
    directory: Path, monkeypatch: pytest.MonkeyPatch, given: str
) -> None:
    monkeypatch.setenv("CPAM_BAYES_CACHE_GIB", given)
    with pytest.raises(ValueError, match=f"CPAM_BAYES_CACHE_GIB: received '{given}'"):
        model_file(name_of(0))


def test_the_cache_lies_where_the_system_keeps_caches(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    monkeypatch.delenv("CPAM_BAYES_CACHE", raising=False)
    if sys.platform == "linux":
        assert cache_directory() == tmp_path / "xdg" / "cpam_bayes"
    assert cache_directory().name == "cpam_bayes"
    monkeypatch.setenv("CPAM_BAYES_CACHE", str(tmp_path / "own"))
    assert cache_directory() == tmp_path / "own"


SHARING = """
import sys
from pathlib import Path
import numpy as np
from cpam_bayes.storage.cache import make_room, read_model, write_model
directory, first = Path(sys.argv[1]), int(sys.argv[2])
found = 0
for i in range(200):
    number = (first + i) % 7
    path = directory / f"{number:032x}.arrays"
    stored = read_model(path)
    if stored is None:
        write_model(path, {"matrix": np.full(500, number)})
    else:
        assert (stored["matrix"] == number).all()
        found += 1
    make_room(directory, 15_000)
print(found)
"""


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EROFS, errno.EACCES])
def test_a_disk_that_is_full_or_read_only_costs_the_model_and_not_the_answer(
    directory: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    def fails(path: Path, model: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr("cpam_bayes.storage.arrays.write_arrays", fails)
    path = model_file(name_of(0))
    write_model(path, MODEL)
    assert read_model(path) is None


def test_several_processes_read_write_and_make_room_at_once(directory: Path) -> None:
    running = [
        subprocess.Popen(
            [sys.executable, "-c", SHARING, str(directory), str(i)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for i in range(3)
    ]
    for process in running:
        out, err = process.communicate(timeout=120)
        assert (process.returncode, err) == (0, "")
        assert int(out) > 0
    assert all(path.suffix == ".arrays" for path in directory.iterdir())


def test_the_command_has_the_keys_of_the_contract_and_clears(
    run: Callable[..., tuple[int, str, str]], directory: Path
) -> None:
    paths = stored(range(3))
    shown = json.loads(run("cache", "--json")[1])
    assert shown["files"] == 3
    assert shown["bytes"] == sum(path.stat().st_size for path in paths)
    assert (shown["directory"], shown["limit_bytes"]) == (str(directory), 4 * 2**30)
    status, out, err = run("cache", "--clear")
    assert (status, err) == (0, "")
    assert "3 models of plates" in out
    assert json.loads(run("cache", "--json")[1])["files"] == 0
