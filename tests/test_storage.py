"""Files that are complete or absent: drafts, sealed files, the place of the cache."""

import io
import os
import pickle
import subprocess
import sys
import zipfile
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from cpam_bayes import storage
from cpam_bayes.storage import draft_directory, draft_file, read_arrays, read_sealed, sweep, write_sealed

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
    before = set(place.iterdir())
    assert subprocess.run([sys.executable, "-c", KILLED, str(place)], timeout=60).returncode == -9
    return sorted(set(place.iterdir()) - before)


def test_what_a_killed_process_left_is_swept_and_nothing_else(tmp_path):
    others = {tmp_path / "results.json", tmp_path / ".cpam-bayes.toml"}
    with draft_directory(tmp_path) as own, draft_file(tmp_path) as (mine, _):
        for path in others:
            path.touch()
        assert len(kill_a_writer(tmp_path)) == 2
        sweep(tmp_path)
        assert set(tmp_path.iterdir()) == {own, mine, *others}
    assert set(tmp_path.iterdir()) == others
    for draft in (draft_file, draft_directory):  # the first one in a directory sweeps it too
        elsewhere = tmp_path / draft.__name__
        elsewhere.mkdir()
        left = kill_a_writer(elsewhere)
        with draft(elsewhere):
            assert not any(path.exists() for path in left)


# from another machine, and from nobody
@pytest.mark.parametrize("name", [".cpam-bayes-00000000-1-x", ".cpam-bayes-x8fs7d"])
def test_drafts_of_unknown_processes_are_swept_after_a_day(tmp_path, name):
    draft = tmp_path / name
    draft.mkdir()
    sweep(tmp_path)
    assert draft.exists()
    written = draft.stat().st_mtime - 86_401.0
    os.utime(draft, (written, written))
    sweep(tmp_path)
    assert not draft.exists()


def test_a_link_that_looks_like_a_draft_is_not_followed(tmp_path):
    kept = tmp_path / "kept"
    kept.mkdir()
    (kept / "file").write_text("mine")
    (left, _) = kill_a_writer(tmp_path)
    link = tmp_path / f"{left.name}link"
    link.symlink_to(kept)
    sweep(tmp_path)
    assert ([p.name for p in tmp_path.iterdir()], (kept / "file").read_text()) == (["kept"], "mine")


def test_what_was_written_is_read_back_bit_for_bit_under_its_name_alone(tmp_path, caplog):
    path, other = tmp_path / "model.arrays", tmp_path / "other.arrays"
    arrays = {"stack": np.arange(60.0).reshape(3, 4, 5), "name": np.array("a text")}
    arrays["block_2"] = np.linspace(0.0, 1.0, 40)
    storage.write_arrays(path, arrays)
    stored = read_arrays(path)
    assert stored.keys() == arrays.keys()
    for name, array in arrays.items():
        np.testing.assert_array_equal(stored[name], array)
    assert [p.name for p in tmp_path.iterdir()] == ["model.arrays"]
    other.write_bytes(path.read_bytes())
    assert read_arrays(other) is None, "a whole file under the name of another"
    assert caplog.messages
    caplog.clear()
    assert read_sealed(tmp_path / "none.arrays") is None
    assert caplog.messages == [], "a file that is not there is no damaged file"


class Trap:
    def __reduce__(self) -> tuple[object, tuple[str]]:
        return pytest.fail, ("a pickle was opened",)


def test_nothing_is_unpickled_even_from_a_file_with_the_right_checksum(tmp_path):
    saved = io.BytesIO()
    np.save(saved, np.array([Trap()], dtype=object), allow_pickle=True)
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w") as file:
        file.writestr("stack.npy", saved.getvalue())
    path = tmp_path / "model.arrays"
    for content in (archive.getvalue(), pickle.dumps(Trap()), b"", b"PK\x03\x04"):
        write_sealed(path, content)
        assert (read_sealed(path), read_arrays(path), path.exists()) == (content, None, False)


def test_a_write_that_fails_leaves_what_was_there_and_no_draft(tmp_path, monkeypatch):
    path = tmp_path / "model.arrays"
    write_sealed(path, b"before")

    def full(handle: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError, match="No space left"):
        write_sealed(path, b"after")
    assert (read_sealed(path), list(tmp_path.iterdir())) == (b"before", [path])


@pytest.mark.parametrize("kind", ["link", "dangling link", "directory", "pipe"])
def test_only_a_regular_file_is_replaced(tmp_path, kind):
    draft, path, aim, regular = (tmp_path / name for name in ("draft", "file", "aim", "regular"))
    draft.write_text("new")
    regular.write_text("old")
    if kind == "link":
        aim.write_text("somebody's")
    make = {"directory": path.mkdir, "pipe": partial(os.mkfifo, path)}
    make.get(kind, partial(path.symlink_to, aim))()
    before = path.lstat()
    with pytest.raises(FileExistsError, match="a directory, link, pipe or device is in its place"):
        storage.put_in_place(draft, path)
    assert (path.lstat().st_ino, aim.exists()) == (before.st_ino, kind == "link")
    storage.put_in_place(draft, regular)
    assert regular.read_text() == "new"


def test_the_cache_lies_where_systems_keep_it_and_former_models_are_named_once(tmp_path, monkeypatch, caplog):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    monkeypatch.delenv("CPAM_BAYES_CACHE", raising=False)
    if sys.platform == "linux":
        assert storage.cache_directory() == tmp_path / "xdg" / "cpam_bayes"
    assert storage.cache_directory().name == "cpam_bayes"
    monkeypatch.setenv("CPAM_BAYES_CACHE", str(tmp_path))
    assert storage.cache_directory() == tmp_path
    (tmp_path / "notes.arrays").write_bytes(b"of somebody else")
    named = []
    for models in ((), (f"{'0' * 32}.arrays", f"{'1' * 32}-local4.arrays")):
        for name in models:
            (tmp_path / name).write_bytes(bytes(2**20))
        storage.name_unused_models.cache_clear()
        for _ in range(2):
            storage.name_unused_models()
        named.append(len(caplog.messages))
    assert named == [0, 1]
    (message,) = caplog.messages
    assert message.startswith(f"{tmp_path} holds 2.0 MiB of plate models")
    storage.name_unused_models.cache_clear()
