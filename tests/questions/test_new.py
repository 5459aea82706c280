"""A new plate file is valid or lists what it lacks; at a terminal `new` asks until the answer is valid."""

import io
import json
import os
import subprocess
import sys
import tomllib

import pytest

import cpam_bayes as cb
from cpam_bayes.errors import PlateFileError
from cpam_bayes.questions.new import MATERIALS, QUESTIONS
from tests.plate_file import refused

FULL = ("--size", "310", "228", "3.1", "--mass", "340.7", "--edges", "FFFF", "--frequencies", "80.2", "146.3")
SHEET = ("--constants", "132", "9.1", "0.31", "4.8")


@pytest.fixture
def path(tmp_path):
    return tmp_path / "panel.toml"


@pytest.mark.parametrize("material", MATERIALS)
def test_a_file_of_a_plate_that_is_known_is_read_as_it_is(run, tmp_path, material):
    path, kind = tmp_path / "panel 12.toml", MATERIALS[material]
    layup = () if material == "metal" else ("--layup", "[0/90]_s")
    sheet = ("--material", material, "--constants", *kind.constants.values())
    status, out, err = run("new", path, *FULL, *layup, *sheet, "--json")
    assert (status, err) == (0, "")
    assert (json.loads(out)["path"], json.loads(out)["missing"]) == (str(path), [])
    specimen = cb.read_plate(path)
    plate, own = specimen.plate, specimen.material
    assert (specimen.name, plate.length, plate.mass) == ("panel 12", 0.31, 0.3407)
    assert own.symmetry == kind.symmetry
    assert specimen.measurement.frequencies.tolist() == [80.2, 146.3]
    assert list(specimen.unknowns.names) == list(own.constants)
    for parameter in specimen.unknowns.parameters:
        assert parameter.prior.lower < own.complete()[parameter.name] < parameter.prior.upper
    assert (specimen.air_density, specimen.sensors, dict(plate.sd)) == (None, (), {})  # only what was given
    assert "ten places" not in path.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("material", "constants", "bounds"),
    [
        ("carbon", (300.0, 9.1, 0.31, 4.8), {"E1_GPa": [60.0, 450.0], "E2_GPa": [4.0, 16.0]}),
        ("carbon", (132.0, 3.0, 0.31, 4.8), {"E1_GPa": [60.0, 250.0], "E2_GPa": [1.5, 16.0]}),
        ("metal", (69.0, 0.46), {"nu12": [0.15, 0.495]}),
    ],
)
def test_bounds_hold_the_constants_of_the_data_sheet(tmp_path, material, constants, bounds):
    path = tmp_path / "p.toml"
    sheet = {"material": material, "constants": constants, "layup": None if material == "metal" else "[0_8]"}
    known = {"size_mm": (310, 228, 3), "mass_g": 340, "edges": "FFFF", "frequencies_hz": (80, 146)}
    text = cb.new(path, **known, **sheet).text
    unknowns = tomllib.loads(text)["unknowns"]
    assert {key: unknowns[key] for key in bounds} == bounds
    assert text.count("wider than usual") == 1
    cb.read_plate(path)


def test_what_is_not_known_is_said_and_stands_in_comments_that_fill_the_gaps(path):
    new = cb.new(path)
    keys = [problem.partition(":")[0] for problem in new.to_dict()["missing"]]
    of_plate = (f"plate.{key}" for key in ("length_mm", "width_mm", "thickness_mm", "edges", "layup"))
    of_material = (f"material.{key}" for key in MATERIALS["carbon"].constants)
    assert sorted(keys) == sorted(("plate", *of_plate, *of_material, "measurement"))
    with pytest.raises(PlateFileError) as caught:
        cb.read_plate(path)
    assert len(caught.value.problems) == len(keys)
    lines = new.text.splitlines()
    filled = [line[2:] if line.startswith("# ") and " = " in line else line for line in lines]
    # a file takes one of two ways to give frequencies, and a list of sd or sensors needs its head
    text = "\n".join(line for line in filled if not line.startswith("table"))
    for head in ("[plate.sd]", "[[sensor]]", "[environment]"):
        text = text.replace(f"# {head}", head)
    assert set(tomllib.loads(text)) >= {"plate", "material", "unknowns", "sensor", "measurement"}
    path.write_text(text, encoding="utf-8")
    specimen = cb.read_plate(path)
    assert (specimen.measurement.complete, bool(specimen.plate.sd)) == (False, True)


def test_what_is_wrong_is_refused_and_nothing_is_written(run, tmp_path):
    for argv, said in (
        (("--edges", "FFFX"), "plate.edges: malformed"),
        (("--layup", "[0/9x]"), "plate.layup: malformed layup"),
        (("--frequencies", "200", "100"), "descending frequencies"),
        (("--table", "none.csv"), "no such file"),
    ):
        refused(run("new", tmp_path / "panel.toml", *argv), said)
        assert list(tmp_path.iterdir()) == []


ANSWERS = (
    *("310 228 3.1", "340.7", "carbon", "132 9.1 0.31 4.8", "[0/90]_2s", "ffff"),
    *("0.02", "0.6 300 220", "yes", "", "80.2 146.3 218.6"),
)


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def asked(run, path, monkeypatch):
    """Run `new` with these lines typed: status, standard output and error, and the unread lines."""

    def answering(*lines, argv=()):
        terminal = Terminal("".join(f"{line}\n" for line in lines))
        monkeypatch.setattr(sys, "stdin", terminal)
        return *run("new", path, *argv), terminal.read()

    return answering


def test_the_answers_are_the_plate_and_the_file_that_of_the_options(run, asked, path, tmp_path):
    status, out, err, _ = asked(*ANSWERS)
    assert status == 0
    assert all(q.text in err and q.text not in out for q in QUESTIONS)
    read = cb.read_plate(path)
    assert (read.name, read.plate.length, read.plate.mass) == ("panel", 0.31, 0.3407)
    assert (read.plate.layup.n_plies, dict(read.plate.sd)) == (8, {"thickness": 2e-5})
    assert read.measurement.frequencies.tolist() == [80.2, 146.3, 218.6]
    assert (read.sensors[0].mass, read.sensors[0].x, read.air_density) == (6e-4, 0.3, 1.2)
    other = tmp_path / "other" / "panel.toml"
    other.parent.mkdir()
    measured = ("--thickness-sd", "0.02", "--accelerometer", "0.6", "300", "220", "--air", "1.2")
    options = (*FULL, "218.6", "--material", "carbon", *SHEET, "--layup", "[0/90]_2s", *measured)
    status, _, err = run("new", other, *options)
    assert (status, err) == (0, "")
    assert other.read_text("utf-8") == path.read_text("utf-8")


# Wrong answers to a question, and the messages.
NUMBERS, SIZES = "accepted: numbers separated by spaces", "accepted: length, width and thickness"
TYPED = ("80,146", "80,146,218", "80,2 146.3")
WRONG = {
    0: {"310 by 228": NUMBERS, "310 228": SIZES, "3.1 2.2 310": "not a plate"},
    1: {"1 2": "accepted: one number", "0.3407": "is the mass in kg?"},
    2: {"wood": "accepted: carbon glass"},
    3: {"132 9.1": "accepted: E1_GPa, E2_GPa, nu12 and G12_GPa", "9.1 132 0.31 4.8": "eq. (9)"},
    4: {"[0/9x]": "malformed layup"},
    5: {"FFFX": "plate.edges: malformed"},
    6: {"little": "accepted: one number"},
    7: {"0.6": "accepted: mass in g, x and y in mm", "0.6 400 220": "outside the plate"},
    8: {"perhaps": "accepted: yes or no"},
    9: {"none.csv": "no such file"},
    10: {**dict.fromkeys(TYPED, NUMBERS), "200 100": "descending frequencies"},
}


def test_what_cannot_be_is_asked_again_and_back_ends_at_the_first_question(asked, path):
    lines = [line for at, right in enumerate(ANSWERS) for line in (*WRONG[at], right)]
    status, _, rest, left = asked(*lines)
    assert (status, left) == (0, "")
    for said in (said for wrong in WRONG.values() for said in wrong.values()):
        before, found, rest = rest.partition(said)
        assert found, before
    read = cb.read_plate(path)
    assert (read.plate.mass, read.plate.edges, read.measurement.size) == (0.3407, "FFFF", 3)
    path.unlink()  # back skips questions that were not asked
    in_cm = ("31 22.8 0.31", "340.7", "<")
    status, _, err, _ = asked("<", *in_cm, "300 280 3", "680", "metal", "<", *ANSWERS[2:])
    assert status == 0
    assert "are the sizes in mm? (< goes back to the last question)" in err
    read = cb.read_plate(path)
    assert (read.plate.thickness, read.material.isotropic) == (0.003, False)


@pytest.mark.parametrize(
    "size", ["310 x 228 x 3.1", "310x228x3,1", "310 228 3,1", "310, 228, 3.1", "310;228;3.1"]
)
def test_numbers_are_read_as_they_are_written_by_hand(asked, path, size):
    assert asked(size, "340,7", *[""] * 8, "80,2 146,3 218,6")[0] == 0
    read = tomllib.loads(path.read_text("utf-8"))
    sizes = [read["plate"][key] for key in ("length_mm", "width_mm", "thickness_mm", "mass_g")]
    assert sizes == [310.0, 228.0, 3.1, 340.7]
    assert read["measurement"]["frequencies_hz"] == [80.2, 146.3, 218.6]


def test_a_metal_has_no_layup_and_a_table_no_list(run, asked, path, tmp_path):
    (tmp_path / "modes.csv").write_text("mode;hz\n1;80,2\n2;146,3\n", encoding="utf-8")
    status, _, _, left = asked("300 280 3", "680", "Metal", "69 0.33", "FFFF", "", "", "no", "modes.csv", "")
    assert (status, left) == (0, "\n"), "the list is not asked for"
    plate = cb.read_plate(path)
    assert plate.material.isotropic
    assert plate.measurement.frequencies.tolist() == [80.2, 146.3]
    of_table = ("--size", "300", "280", "3", "--mass", "680", "--edges", "FFFF")
    metal = ("--material", "metal", "--constants", "69", "0.33", "--table", "modes.csv", "--quiet")
    path.unlink()
    assert run("new", path, *of_table, *metal)[0] == 0
    assert cb.read_plate(path).measurement.frequencies.tolist() == [80.2, 146.3]
    # advice on where to support and hit appears as soon as the plate is known
    assert cb.new(tmp_path / "size.toml", size_mm=(300, 200, 3)).handling is None
    sheet = {"material": "metal", "constants": (69.0, 0.33), "edges": "FFFF"}
    known = cb.new(tmp_path / "known.toml", size_mm=(300, 200, 3), mass_g=486, **sheet)
    assert known.handling.sentence in known.summary().replace("\n  ", " ")


def test_an_end_of_the_answers_writes_nothing_and_a_script_is_asked_nothing(asked, path, tmp_path):
    refused(asked(*ANSWERS[:3])[:3], "not all questions were answered")
    assert list(tmp_path.iterdir()) == []
    for argv in (("--json",), ("--edges", "FFFF")):
        status, _, err, left = asked(*ANSWERS, argv=argv)
        assert (status, err) == (0, "")
        assert left.startswith(ANSWERS[0])
        path.unlink()
    assert asked(*[""] * 11)[0] == 0  # empty lines leave everything open
    text = path.read_text("utf-8")
    path.unlink()
    assert cb.new(path).text == text


@pytest.mark.parametrize("argv", [(), FULL])
def test_a_file_that_is_there_is_refused_before_the_first_question(asked, path, argv):
    path.write_text("mine", encoding="utf-8")
    status, _, err, _ = asked(*ANSWERS, argv=argv)
    assert (status, err) == (2, f"error: {path}: exists; give another name\n")
    assert path.read_text("utf-8") == "mine"


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="a terminal of POSIX")
def test_a_real_terminal_is_asked(tmp_path):
    terminal, stdin = os.openpty()
    command = [sys.executable, "-m", "cpam_bayes", "new", "panel.toml"]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=stdin, stdout=pipe, stderr=pipe, cwd=tmp_path) as running:
        os.write(terminal, b"\n\n\n\n\nFFFF\n\n\n\n\n\n")
        _, err = running.communicate(timeout=60)
    os.close(terminal)
    os.close(stdin)
    assert running.returncode == 0
    assert b"Length (along x)" in err
    assert 'edges = "FFFF"' in (tmp_path / "panel.toml").read_text("utf-8")
