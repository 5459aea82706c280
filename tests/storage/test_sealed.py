"""Sealed files: one is read back as it was written or not at all; test_hostile.py damages them."""

from __future__ import annotations

import io
import pickle
import zipfile
from pathlib import Path

import numpy as np
import pytest

from cpam_bayes.storage import put_in_place, read_arrays, read_sealed, write_arrays, write_sealed

ARRAYS = {
    "stack": np.arange(60.0).reshape(3, 4, 5),
    "name": np.array("a text"),
    "block_2": np.linspace(0.0, 1.0, 40),
}


def test_what_was_written_is_read_back_bit_for_bit(tmp_path: Path) -> None:
    path = tmp_path / "model.arrays"
    write_arrays(path, ARRAYS)
    stored = read_arrays(path)
    assert stored is not None
    assert stored.keys() == ARRAYS.keys()
    for name, array in ARRAYS.items():
        np.testing.assert_array_equal(stored[name], array)
    assert [p.name for p in tmp_path.iterdir()] == ["model.arrays"]


def test_a_whole_file_under_the_name_of_another_is_refused(tmp_path: Path) -> None:
    path, other = tmp_path / "model.arrays", tmp_path / "other.arrays"
    write_arrays(path, ARRAYS)
    other.write_bytes(path.read_bytes())
    assert read_arrays(other) is None
    assert read_arrays(path) is not None


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


def test_a_file_that_is_not_there_is_no_damaged_file(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    assert read_sealed(tmp_path / "model.arrays") is None
    assert caplog.messages == []


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
