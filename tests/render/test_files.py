"""Result files appear when all of them are whole, or not at all."""

import errno
import json
import os

import pytest

from cpam_bayes.questions.plates import BuiltinPlates, plates
from cpam_bayes.render.files import save, staging
from cpam_bayes.render.page import PAGE, command_of

RESULT = plates()


def listed(directory):
    return sorted(str(path.relative_to(directory)) for path in directory.rglob("*"))


def test_without_a_directory_nothing_is_written(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with staging(None) as stage:
        save(RESULT, stage)
    assert listed(tmp_path) == []


def test_an_older_result_is_replaced_and_other_files_stay(tmp_path):
    (tmp_path / "plates.json").write_text("old")
    (tmp_path / "notes.txt").write_text("mine")
    with staging(str(tmp_path)) as stage:
        assert (tmp_path / "plates.json").read_text() == "old"
        save(RESULT, stage)
    assert listed(tmp_path) == ["notes.txt", "plates.json", "report.html"]
    assert json.loads((tmp_path / "plates.json").read_text()) == RESULT.to_dict()


def test_a_saved_answer_is_presented_once(tmp_path):
    made = []

    class Counted(BuiltinPlates):
        def report(self):
            made.append(self)
            return super().report()

    Counted(seed=0, specimens=RESULT.specimens).save(tmp_path)
    assert len(made) == 1


def test_two_runs_into_one_directory_leave_whole_files_of_the_last_and_no_drafts(tmp_path, forward_result):
    with staging(str(tmp_path)) as one, staging(str(tmp_path)) as other:
        save(RESULT, one)
        save(RESULT, other)
        notes = save(forward_result, one)
    assert len(notes) == 1
    assert json.loads((tmp_path / "plates.json").read_text()) == RESULT.to_dict()
    assert json.loads((tmp_path / "forward.json").read_text()) == forward_result.to_dict()
    assert command_of(tmp_path / PAGE) == "forward"
    assert not [name for name in listed(tmp_path) if "cpam-bayes" in name]


def test_the_page_of_another_command_is_kept_under_its_name(tmp_path, forward_result):
    def saved(result):
        with staging(str(tmp_path)) as stage:
            return save(result, stage)

    def command():
        return command_of(tmp_path / PAGE)

    assert saved(RESULT) == ()
    assert saved(RESULT) == ()
    first = (tmp_path / PAGE).read_text("utf-8")
    (note,) = saved(forward_result)
    assert note == f"{tmp_path / PAGE} is now that of forward, that of plates is kept as plates_page.html"
    assert command() == "forward"
    assert (tmp_path / "plates_page.html").read_text("utf-8") == first
    # a page of one command stands at one place
    assert len(saved(RESULT)) == 1
    assert command() == "plates"
    assert {path.name for path in tmp_path.glob("*.html")} == {PAGE, "forward_page.html"}
    (tmp_path / PAGE).write_text("<title>coverage</title>")
    assert command() is None


@pytest.mark.parametrize("end", [KeyboardInterrupt, RuntimeError])
def test_work_that_ends_early_leaves_everything_as_it_was(tmp_path, end):
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "plates.json").write_text("old")
    for name in ("old", "new/deep"):
        with pytest.raises(end), staging(str(tmp_path / name)):
            raise end
    assert listed(tmp_path) == ["old", "old/plates.json"]


READ_ONLY = [f"cannot be written to: {os.strerror(number)}" for number in (errno.EROFS, errno.EACCES)]


@pytest.mark.parametrize(
    ("name", "said"),
    [
        (".", "figures is no directory"),
        *((name, "--out") for name in ("", "a\0b", "x" * 5000)),
        *((name, said) for said in READ_ONLY for name in ("read only", "read only/new")),
    ],
)
def test_a_directory_that_cannot_be_written_to_is_refused_before_the_work(tmp_path, monkeypatch, name, said):
    def fails(*args, **kwargs):
        number = errno.EROFS if said == READ_ONLY[0] else errno.EACCES
        raise OSError(number, os.strerror(number))

    monkeypatch.chdir(tmp_path)
    (tmp_path / "figures").write_text("mine")
    (tmp_path / "read only").mkdir()
    if said in READ_ONLY:
        monkeypatch.setattr("tempfile.mkdtemp", fails)
        monkeypatch.setattr("os.unlink", fails)
    with pytest.raises(ValueError, match=said), staging(name):
        raise AssertionError("the work has begun")
    assert listed(tmp_path) == ["figures", "read only"]
