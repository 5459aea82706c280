"""Files that are whole or not there: drafts, sealed files, the cache of models."""

from __future__ import annotations

import errno
import hashlib
import io
import json
import os
import pickle
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import cpam_bayes as cb
from cpam_bayes.storage import (
    cache_content,
    cache_directory,
    draft_directory,
    draft_file,
    make_room,
    model_file,
    put_in_place,
    read_arrays,
    read_model,
    read_sealed,
    sweep,
    write_arrays,
    write_model,
    write_sealed,
)

# Drafts


KILLED = """
import os, signal, sys
from pathlib import Path
from cpam_bayes.storage import draft_directory, draft_file
place = Path(sys.argv[1])
with draft_directory(place) as directory, draft_file(place) as (path, file):
    (directory / "figures").mkdir()
    (directory / "figures" / "one.png").write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def kill_a_writer(place: Path) -> list[Path]:
    """Drafts that a killed process left."""
    before = set(place.iterdir())
    done = subprocess.run([sys.executable, "-c", KILLED, str(place)], check=False, timeout=60)
    assert done.returncode == -9
    return sorted(set(place.iterdir()) - before)


def test_what_a_killed_process_left_is_swept_and_nothing_else(tmp_path: Path) -> None:
    others = {tmp_path / "results.json", tmp_path / ".cpam-bayes.toml"}
    with draft_directory(tmp_path) as own, draft_file(tmp_path) as (mine, _):
        for path in others:
            path.write_text("")
        assert len(kill_a_writer(tmp_path)) == 2
        sweep(tmp_path)
        assert set(tmp_path.iterdir()) == {own, mine, *others}
    assert set(tmp_path.iterdir()) == others


def test_the_next_draft_in_a_directory_sweeps_it(tmp_path: Path) -> None:
    left = kill_a_writer(tmp_path)
    with draft_file(tmp_path):
        assert not any(path.exists() for path in left)


@pytest.mark.parametrize(
    "name", [".cpam-bayes-00000000-1-x", ".cpam-bayes-x8fs7d"], ids=["other machine", "nobody"]
)
def test_drafts_of_unknown_processes_are_swept_after_a_day(tmp_path: Path, name: str) -> None:
    draft = tmp_path / name
    draft.mkdir()
    sweep(tmp_path)
    assert draft.exists()
    written = draft.stat().st_mtime - 86_401.0
    os.utime(draft, (written, written))
    sweep(tmp_path)
    assert not draft.exists()


def test_a_link_that_looks_like_a_draft_is_not_followed(tmp_path: Path) -> None:
    kept = tmp_path / "kept"
    kept.mkdir()
    (kept / "file").write_text("mine")
    (left, _) = kill_a_writer(tmp_path)
    link = tmp_path / f"{left.name}link"
    link.symlink_to(kept)
    sweep(tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["kept"]
    assert (kept / "file").read_text() == "mine"


# Sealed files


ARRAYS = {
    "stack": np.arange(60.0).reshape(3, 4, 5),
    "name": np.array("a text"),
    "block_2": np.linspace(0.0, 1.0, 40),
}


def test_what_was_written_is_read_back_bit_for_bit_under_its_name_alone(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "model.arrays"
    write_arrays(path, ARRAYS)
    stored = read_arrays(path)
    assert stored is not None
    assert stored.keys() == ARRAYS.keys()
    for name, array in ARRAYS.items():
        np.testing.assert_array_equal(stored[name], array)
    assert [p.name for p in tmp_path.iterdir()] == ["model.arrays"]
    other = tmp_path / "other.arrays"
    other.write_bytes(path.read_bytes())
    assert read_arrays(other) is None, "a whole file under the name of another"
    assert caplog.messages
    caplog.clear()
    assert read_sealed(tmp_path / "none.arrays") is None
    assert caplog.messages == [], "a file that is not there is no damaged file"


class Trap:
    def __reduce__(self) -> tuple[object, tuple[str]]:
        return pytest.fail, ("a pickle was opened",)


def test_nothing_is_unpickled_even_from_a_file_with_the_right_checksum(tmp_path: Path) -> None:
    saved = io.BytesIO()
    np.save(saved, np.array([Trap()], dtype=object), allow_pickle=True)
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w") as file:
        file.writestr("stack.npy", saved.getvalue())
    for content in (archive.getvalue(), pickle.dumps(Trap()), b"", b"PK\x03\x04"):
        path = tmp_path / "model.arrays"
        write_sealed(path, content)
        assert read_sealed(path) == content
        assert read_arrays(path) is None
        assert not path.exists()


def test_a_write_that_fails_leaves_what_was_there_and_no_draft(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "model.arrays"
    write_sealed(path, b"before")

    def full(handle: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError, match="No space left"):
        write_sealed(path, b"after")
    assert read_sealed(path) == b"before"
    assert [p.name for p in tmp_path.iterdir()] == ["model.arrays"]


@pytest.mark.parametrize("kind", ["link", "dangling link", "directory", "pipe"])
def test_only_a_regular_file_is_replaced(tmp_path: Path, kind: str) -> None:
    import os

    draft, path, aim = tmp_path / "draft", tmp_path / "file", tmp_path / "aim"
    draft.write_text("new")
    if kind == "link":
        aim.write_text("somebody's")
    if "link" in kind:
        path.symlink_to(aim)
    elif kind == "directory":
        path.mkdir()
    else:
        os.mkfifo(path)
    before = path.lstat()
    with pytest.raises(FileExistsError, match="a directory, link, pipe or device is in its place"):
        put_in_place(draft, path)
    assert path.lstat().st_ino == before.st_ino
    assert aim.exists() == (kind == "link")
    regular = tmp_path / "regular"
    regular.write_text("old")
    put_in_place(draft, regular)
    assert regular.read_text() == "new"


# The cache of models


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
from cpam_bayes.storage import make_room, read_model, write_model
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

    monkeypatch.setattr("cpam_bayes.storage.write_arrays", fails)
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
