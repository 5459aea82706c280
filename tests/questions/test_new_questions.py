"""`new` at a terminal asks for what is known, and asks again where an answer cannot be."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import cpam_bayes as cb
from cpam_bayes.questions.new import QUESTIONS

Run = Callable[..., tuple[object, str, str]]

ANSWERS = (
    "310 228 3.1",
    "340.7",
    "carbon",
    "[0/90]_2s",
    "ffff",
    "0.02",
    "0.6 300 220",
    "yes",
    "",
    "80.2 146.3 218.6",
)


class Terminal(io.StringIO):
    """Lines as they are typed."""

    def isatty(self) -> bool:
        return True


def typed(monkeypatch: pytest.MonkeyPatch, *lines: str) -> Terminal:
    terminal = Terminal("".join(f"{line}\n" for line in lines))
    monkeypatch.setattr(sys, "stdin", terminal)
    return terminal


def test_the_answers_are_the_plate(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    typed(monkeypatch, *ANSWERS)
    path = tmp_path / "panel.toml"
    status, out, err = run("new", path)
    assert status == 0
    assert cb.read_plate(path).name == "panel"
    assert all(q.text in err and q.text not in out for q in QUESTIONS)
    plate = cb.read_plate(path)
    assert (plate.plate.length, plate.plate.mass, plate.plate.layup.n_plies) == (0.31, 0.3407, 8)
    assert plate.measurement is not None
    assert plate.measurement.frequencies.tolist() == [80.2, 146.3, 218.6]
    assert dict(plate.plate.sd) == {"thickness": 2e-5}
    assert (plate.sensors[0].mass, plate.sensors[0].x, plate.air_density) == (6e-4, 0.3, 1.2)


def test_the_file_is_that_of_the_options(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    typed(monkeypatch, *ANSWERS)
    run("new", tmp_path / "panel.toml")
    (tmp_path / "other").mkdir()
    options = (
        "--size",
        "310",
        "228",
        "3.1",
        "--mass",
        "340.7",
        "--material",
        "carbon",
        "--layup",
        "[0/90]_2s",
    )
    measured = ("--thickness-sd", "0.02", "--accelerometer", "0.6", "300", "220", "--air", "1.2")
    listed = (*measured, "--edges", "FFFF", "--frequencies", "80.2", "146.3", "218.6")
    status, _, err = run("new", tmp_path / "other" / "panel.toml", *options, *listed)
    assert (status, err) == (0, "")
    first, second = ((tmp_path / p).read_text("utf-8") for p in ("panel.toml", "other/panel.toml"))
    assert first == second


@pytest.mark.parametrize(
    ("at", "wrong", "said"),
    [
        (0, "310 by 228", "accepted: numbers with spaces"),
        (0, "310 228", "accepted: length, width and thickness"),
        (0, "3.1 2.2 310", "not a plate"),
        (1, "1 2", "accepted: one number"),
        (1, "0.3407", "is the mass in kg?"),
        (2, "wood", "accepted: carbon glass"),
        (3, "[0/9x]", "malformed layup"),
        (4, "FFFX", "plate.edges: malformed"),
        (5, "little", "accepted: one number"),
        (6, "0.6", "accepted: mass in g, x and y in mm"),
        (6, "0.6 400 220", "outside the plate"),
        (7, "perhaps", "accepted: yes or no"),
        (8, "none.csv", "no such file"),
        (9, "200 100", "descending frequencies"),
    ],
)
def test_what_cannot_be_is_asked_again(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at: int, wrong: str, said: str
) -> None:
    typed(monkeypatch, *ANSWERS[:at], wrong, *ANSWERS[at:])
    status, _, err = run("new", tmp_path / "panel.toml")
    assert status == 0
    assert said in err
    assert cb.read_plate(tmp_path / "panel.toml").plate.mass == 0.3407


def test_sizes_in_cm_are_taken_back_where_the_mass_shows_them(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    typed(monkeypatch, "31 22.8 0.31", "340.7", "<", *ANSWERS)
    status, _, err = run("new", tmp_path / "panel.toml")
    assert status == 0
    assert "are the sizes in mm? (< goes back to the answer before)" in err
    assert cb.read_plate(tmp_path / "panel.toml").plate.thickness == pytest.approx(3.1e-3)


def test_back_passes_over_what_was_not_asked_and_ends_at_the_first_question(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    typed(monkeypatch, "<", "300 280 3", "680", "metal", "<", *ANSWERS[2:])
    status, _, _ = run("new", tmp_path / "panel.toml")
    assert status == 0
    assert not cb.read_plate(tmp_path / "panel.toml").material.isotropic


@pytest.mark.parametrize(
    "size", ["310 x 228 x 3.1", "310x228x3,1", "310 228 3,1", "310, 228, 3.1", "310;228;3.1"]
)
def test_numbers_are_read_as_they_are_written_by_hand(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, size: str
) -> None:
    typed(monkeypatch, size, "340,7", *ANSWERS[2:9], "80,2 146,3 218,6")
    assert run("new", tmp_path / "panel.toml")[0] == 0
    read = cb.read_plate(tmp_path / "panel.toml")
    assert (read.plate.length, read.plate.thickness, read.plate.mass) == pytest.approx((0.31, 3.1e-3, 0.3407))
    assert read.measurement is not None
    assert read.measurement.frequencies.tolist() == [80.2, 146.3, 218.6]


@pytest.mark.parametrize("numbers", ["80,146", "80,146,218", "80,2 146.3"])
def test_a_comma_that_may_stand_between_numbers_is_asked_again(numbers: str) -> None:
    with pytest.raises(ValueError, match="accepted: numbers with spaces between them"):
        QUESTIONS[-1].read(numbers)


def test_empty_lines_leave_all_open(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    typed(monkeypatch, *[""] * 10)
    status, _, _ = run("new", tmp_path / "panel.toml")
    assert status == 0
    (tmp_path / "other").mkdir()
    assert (tmp_path / "panel.toml").read_text("utf-8") == cb.new(tmp_path / "other" / "panel.toml").text


def test_a_metal_has_no_layup_and_a_table_no_list(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "modes.csv").write_text("mode,hz\n1,80.2\n2,146.3\n", encoding="utf-8")
    left = typed(monkeypatch, "300 280 3", "680", "Metal", "FFFF", "", "", "no", "modes.csv", "not asked for")
    status, _, _ = run("new", tmp_path / "panel.toml")
    assert status == 0
    assert left.read() == "not asked for\n"
    plate = cb.read_plate(tmp_path / "panel.toml")
    assert plate.material.isotropic
    assert plate.measurement is not None
    assert plate.measurement.size == 2


def test_an_end_of_the_answers_writes_nothing(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    typed(monkeypatch, *ANSWERS[:3])
    status, out, err = run("new", tmp_path / "panel.toml")
    assert (status, out) == (2, "")
    assert "not answered to the end" in err
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_is_there_is_refused_before_the_first_question(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "panel.toml").write_text("mine", encoding="utf-8")
    typed(monkeypatch, *ANSWERS)
    status, _, err = run("new", tmp_path / "panel.toml")
    assert status == 2
    assert err == f"error: {tmp_path / 'panel.toml'}: exists; give another name\n"


@pytest.mark.parametrize("argv", [("--json",), ("--edges", "FFFF")])
def test_a_script_is_asked_nothing(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, argv: tuple[str, ...]
) -> None:
    left = typed(monkeypatch, *ANSWERS)
    status, _, err = run("new", tmp_path / "panel.toml", *argv)
    assert (status, err) == (0, "")
    assert left.tell() == 0


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="a terminal of POSIX")
def test_a_real_terminal_is_asked(tmp_path: Path) -> None:
    terminal, stdin = os.openpty()
    command = [sys.executable, "-m", "cpam_bayes", "new", "panel.toml"]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=stdin, stdout=pipe, stderr=pipe, cwd=tmp_path) as running:
        os.write(terminal, "".join(f"{line}\n" for line in ANSWERS).encode())
        _, err = running.communicate(timeout=60)
    os.close(terminal)
    os.close(stdin)
    assert running.returncode == 0
    assert b"Length (along x)" in err
    assert cb.read_plate(tmp_path / "panel.toml").plate.edges == "FFFF"
