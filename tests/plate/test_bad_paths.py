"""Whatever a path turns out to be, the answer is one message, and no more is read than a file may have."""

import os

import pytest

from cpam_bayes.errors import PlateFileError
from cpam_bayes.plate import MAX_BYTES, read_specimen
from tests.effort import peak_memory


def refused(path):
    with peak_memory() as peak, pytest.raises(PlateFileError) as caught:
        read_specimen(str(path))
    assert peak() < 2 * MAX_BYTES  # the buffer of one file of that size, and little more
    (problem,) = caught.value.problems
    return problem


def test_a_missing_file_is_refused(tmp_path):
    assert "neither a file nor a built-in" in refused(tmp_path / "none.toml")
    assert "neither a file nor a built-in" in refused("")


@pytest.mark.parametrize(("name", "nearest"), [("C5", "C4"), ("c1", "C1"), ("d&g", "D&G")])
def test_a_name_that_is_nearly_built_in_is_answered_with_the_nearest(name, nearest):
    assert nearest in refused(name)


def test_a_name_like_no_other_is_answered_with_the_list():
    assert "D&G A1 A2 B1" in refused("specimen")


def test_a_directory_is_refused(tmp_path):
    assert "a directory" in refused(tmp_path)


def test_a_binary_file_is_refused(tmp_path):
    path = tmp_path / "plate.toml"
    path.write_bytes(bytes(range(256)) * 10)
    assert "binary" in refused(path)


def test_text_that_is_not_utf_8_is_refused_with_its_line(tmp_path):
    path = tmp_path / "plate.toml"
    path.write_bytes(b"a = 1\nname = '\xe9'\n")
    problem = refused(path)
    assert problem.startswith(f"{path}:2: file: not UTF-8")
    assert "0xe9" in problem


def test_an_empty_file_says_what_is_missing(tmp_path):
    path = tmp_path / "plate.toml"
    path.write_bytes(b"")
    with pytest.raises(PlateFileError) as caught:
        read_specimen(str(path))
    assert [problem.split(": ")[1] for problem in caught.value.problems] == [
        "name",
        "plate",
        "material",
    ]


def test_a_file_of_a_gigabyte_is_refused_unread(tmp_path):
    path = tmp_path / "plate.toml"
    with open(path, "wb") as file:
        file.truncate(10**9)
    assert f"received 1000000000 bytes, accepted: up to {MAX_BYTES}" in refused(path)


def test_a_large_file_of_too_many_frequencies_is_refused_with_one_message(tmp_path, full_text):
    path = tmp_path / "plate.toml"
    numbers = ", ".join(str(i + 1) for i in range(30_000))
    path.write_text(full_text.replace("102, 311, 342, 342, 390, 612.5", numbers))
    assert path.stat().st_size < MAX_BYTES
    with pytest.raises(PlateFileError) as refusal:
        read_specimen(str(path))
    (said,) = refusal.value.problems
    assert said.endswith("too many, received 30000, accepted: a list of 1 to 100 frequencies, ascending")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_a_named_pipe_is_refused_without_waiting_for_a_writer(tmp_path):
    path = tmp_path / "pipe"
    os.mkfifo(path)
    assert "pipe or device" in refused(path)


@pytest.mark.skipif(not os.path.exists("/dev/zero"), reason="this system has no /dev/zero")
def test_a_device_is_refused():
    assert "pipe or device" in refused("/dev/zero")


def test_a_circle_of_links_is_refused(tmp_path):
    (tmp_path / "a").symlink_to(tmp_path / "b")
    (tmp_path / "b").symlink_to(tmp_path / "a")
    assert "cannot be read" in refused(tmp_path / "a")


@pytest.mark.parametrize("name", ["plate\0.toml", "x" * 5000, "\x1b[31m.toml"])
def test_impossible_paths_are_refused_printably(name):
    problem = refused(name)
    assert "\0" not in problem
    assert "\x1b" not in problem


def test_a_file_that_may_not_be_read_is_refused(monkeypatch, tmp_path):
    def forbidden(*_):
        raise PermissionError(13, "Permission denied")

    path = tmp_path / "plate.toml"
    path.write_text("name = 'x'")
    # not by chmod: root, who runs some CI, may read everything
    monkeypatch.setattr(os, "open", forbidden)
    assert "cannot be read: Permission denied" in refused(path)
