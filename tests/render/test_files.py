"""Result files appear complete and all together, or not at all; figures are drawn identically every time."""

import errno
import json
import os
import re
from dataclasses import replace

import numpy as np
import pytest

from cpam_bayes.questions.forward import ModeShape
from cpam_bayes.questions.plates import BuiltinPlates, plates
from cpam_bayes.render.figures import save_figures
from cpam_bayes.render.files import save, staging
from cpam_bayes.render.page import PAGE, command_of
from tests.answers import answered

RESULT = plates()
READ_ONLY = [f"cannot be written to: {os.strerror(number)}" for number in (errno.EROFS, errno.EACCES)]
NO_PLACES = [
    (".", "figures is not a writable directory"),
    *((name, "--out") for name in ("", "a\0b", "x" * 5000)),
    *((name, said) for said in READ_ONLY for name in ("read only", "read only/new")),
]


@pytest.fixture(scope="module")
def forward_result():
    return answered("forward")


def listed(directory):
    return sorted(str(path.relative_to(directory)) for path in directory.rglob("*"))


def saved(result, directory):
    with staging(None if directory is None else str(directory)) as stage:
        return save(result, stage)


def test_an_older_result_is_replaced_and_other_files_stay(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert (saved(RESULT, None), listed(tmp_path)) == ((), [])
    document, notes = tmp_path / "plates.json", tmp_path / "notes.txt"
    document.write_text("old")
    notes.write_text("mine")
    with staging(str(tmp_path)) as stage:
        assert document.read_text() == "old"
        save(RESULT, stage)
    assert listed(tmp_path) == ["notes.txt", "plates.json", "report.html"]
    assert json.loads(document.read_text()) == RESULT.to_dict()
    document.unlink()
    document.symlink_to(notes)
    with pytest.raises(FileExistsError, match="a directory, link, pipe or device is in its place"):
        saved(RESULT, tmp_path)
    assert notes.read_text() == "mine"


def test_a_saved_answer_is_presented_once(tmp_path, monkeypatch):
    made, report = [], BuiltinPlates.report
    monkeypatch.setattr(BuiltinPlates, "report", lambda self: made.append(self) or report(self))
    RESULT.save(tmp_path)
    assert made == [RESULT]


def test_two_runs_into_one_directory_leave_whole_files_of_the_last_and_no_drafts(tmp_path, forward_result):
    with staging(str(tmp_path)) as one, staging(str(tmp_path)) as other:
        save(RESULT, one)
        save(RESULT, other)
        notes = save(forward_result, one)
    assert len(notes) == 1
    for result in (RESULT, forward_result):
        assert json.loads((tmp_path / f"{result.command}.json").read_text()) == result.to_dict()
    assert not [name for name in listed(tmp_path) if "cpam-bayes" in name]


def test_the_page_of_another_command_is_kept_under_its_name(tmp_path, forward_result):
    page = tmp_path / PAGE
    assert [saved(RESULT, tmp_path) for _ in range(2)] == [(), ()]
    first = page.read_text("utf-8")
    (note,) = saved(forward_result, tmp_path)
    assert note == f"{page} is now from forward; that from plates is kept as plates_page.html"
    assert (command_of(page), (tmp_path / "plates_page.html").read_text("utf-8")) == ("forward", first)
    assert (len(saved(RESULT, tmp_path)), command_of(page)) == (1, "plates")
    assert {path.name for path in tmp_path.glob("*.html")} == {PAGE, "forward_page.html"}
    page.write_text("<title>coverage</title>")
    assert command_of(page) is None


@pytest.mark.parametrize("end", [KeyboardInterrupt, RuntimeError])
def test_work_that_ends_early_leaves_everything_as_it_was(tmp_path, end):
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "plates.json").write_text("old")
    for name in ("old", "new/deep"):
        with pytest.raises(end), staging(str(tmp_path / name)):
            raise end
    assert listed(tmp_path) == ["old", "old/plates.json"]


@pytest.mark.parametrize(("name", "said"), NO_PLACES)
def test_a_directory_that_cannot_be_written_to_is_refused_before_the_work(tmp_path, monkeypatch, name, said):
    def fails(*args, **kwargs):
        number = errno.EROFS if said == READ_ONLY[0] else errno.EACCES
        raise OSError(number, os.strerror(number))

    monkeypatch.chdir(tmp_path)
    (tmp_path / "figures").write_text("mine")
    (tmp_path / "read only").mkdir()
    for function in ("tempfile.mkdtemp", "os.unlink") if said in READ_ONLY else ():
        monkeypatch.setattr(function, fails)
    with pytest.raises(ValueError, match=said), staging(name):
        raise AssertionError("the work has begun")
    assert listed(tmp_path) == ["figures", "read only"]


def written(figures, directory):
    directory.mkdir()
    save_figures(figures, directory)
    return {path.name: path.read_bytes() for path in directory.iterdir()}


def test_two_figures_on_one_page_share_no_element_name_and_modes_have_their_labels(forward_result, tmp_path):
    files = written(forward_result.figures(), tmp_path / "figures")
    assert {*files} == {f"{name}.{of}" for name in ("handling", "modes", "plate") for of in ("png", "svg")}
    assert not any(b"<dc:date>" in content for content in files.values())
    svgs = [content for name, content in files.items() if name.endswith(".svg")]
    ids = [set(re.findall(rb'id="(m[0-9a-f]{10}|p[0-9a-f]{10})"', content)) for content in svgs]
    assert all(ids)
    assert not ids[0] & ids[1]
    first, _, _ = (axes.get_title() for axes in forward_result.plot("modes").axes if axes.get_title())
    assert re.fullmatch(r"1: 1351\.\d+ Hz\nbending \(1,1\)", first)


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_in_plane_modes_and_modes_of_one_sign_are_drawn_too(forward_result, share, tmp_path):
    ramp = np.add.outer(np.linspace(0, 1, 41), np.linspace(0, 1, 41))
    one = {"modes": (replace(forward_result.modes[0], in_plane_fraction=share),), "error": np.array([1e-5])}
    result = replace(forward_result, shapes=(ModeShape(ramp, -ramp, ramp),), **one)
    assert len(written(result.figures(), tmp_path / "figures")["modes.png"]) > 1000


def test_a_shape_and_its_negative_are_the_same_picture(forward_result, tmp_path):
    turned = replace(forward_result, shapes=tuple(ModeShape(-s.u, -s.v, -s.w) for s in forward_result.shapes))
    answers = enumerate((forward_result, turned))
    first, second = (written(one.figures(), tmp_path / str(i))["modes.png"] for i, one in answers)
    assert first == second
