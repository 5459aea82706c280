"""A new plate file is a good one, or says all that it lacks."""

import json
import tomllib

import pytest

import cpam_bayes as cb
from cpam_bayes.cli import main
from cpam_bayes.errors import PlateFileError
from cpam_bayes.questions.new import MATERIALS

FULL = ("--size", "310", "228", "3.1", "--mass", "340.7", "--edges", "FFFF", "--frequencies", "80.2", "146.3")


def answer(capsys, *argv):
    status = main(["new", *map(str, argv), "--json"])
    out, err = capsys.readouterr()
    return status, json.loads(out) if out else None, err


@pytest.mark.parametrize("material", MATERIALS)
def test_a_file_of_a_plate_that_is_known_is_read_as_it_is(capsys, tmp_path, material):
    path = tmp_path / "panel 12.toml"
    layup = () if material == "metal" else ("--layup", "[0/90]_s")
    status, document, err = answer(capsys, path, *FULL, *layup, "--material", material)
    assert (status, err) == (0, "")
    assert document["path"] == str(path)
    assert document["missing"] == []
    specimen = cb.read_plate(path)
    assert specimen.name == "panel 12"
    assert (specimen.plate.length, specimen.plate.mass) == (0.31, 0.3407)
    assert specimen.material.symmetry == MATERIALS[material].symmetry
    assert specimen.measurement.frequencies.tolist() == [80.2, 146.3]
    reference = specimen.material.complete()
    for parameter in specimen.unknowns.parameters:
        assert parameter.prior.lower < reference[parameter.name] < parameter.prior.upper
    assert [p.name for p in specimen.unknowns.parameters] == list(specimen.material.constants)


def test_what_is_not_known_is_said_and_stands_in_comments(capsys, tmp_path):
    path = tmp_path / "panel.toml"
    status, document, _ = answer(capsys, path)
    assert status == 0
    keys = [problem.partition(":")[0] for problem in document["missing"]]
    of_plate = ("plate.length_mm", "plate.width_mm", "plate.thickness_mm", "plate.edges", "plate.layup")
    assert sorted(keys) == sorted(("plate", *of_plate, "measurement"))
    with pytest.raises(PlateFileError) as caught:
        cb.read_plate(path)
    assert len(caught.value.problems) == len(keys)


def test_nothing_is_stated_of_the_plate_that_was_not_told(capsys, tmp_path):
    path = tmp_path / "panel.toml"
    answer(capsys, path, *FULL, "--layup", "[0]")
    specimen = cb.read_plate(path)
    assert (specimen.air_density, specimen.sensors, dict(specimen.plate.sd)) == (None, (), {})
    assert "ten places" not in path.read_text(encoding="utf-8")


def test_lines_in_comments_are_examples_that_fill_the_gaps(capsys, tmp_path):
    path = tmp_path / "panel.toml"
    answer(capsys, path)
    lines = path.read_text(encoding="utf-8").splitlines()
    filled = [line[2:] if line.startswith("# ") and " = " in line else line for line in lines]
    # of two ways to give frequencies a file takes one, and a list of sd or sensors needs its head
    text = "\n".join(line for line in filled if not line.startswith("table"))
    text = text.replace("# [plate.sd]", "[plate.sd]").replace("# [[sensor]]", "[[sensor]]")
    text = text.replace("# [environment]", "[environment]")
    assert set(tomllib.loads(text)) >= {"plate", "material", "unknowns", "sensor", "measurement"}
    path.write_text(text, encoding="utf-8")
    specimen = cb.read_plate(path)
    assert specimen.measurement.complete is False
    assert specimen.plate.sd


def test_a_table_takes_the_place_of_the_frequencies(capsys, tmp_path):
    (tmp_path / "modes.csv").write_text("mode;hz\n1;80,2\n2;146,3\n", encoding="utf-8")
    path = tmp_path / "panel.toml"
    status, document, _ = answer(capsys, path, *FULL[:8], "--layup", "[0]", "--table", "modes.csv")
    assert (status, document["missing"]) == (0, [])
    assert cb.read_plate(path).measurement.frequencies.tolist() == [80.2, 146.3]


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        (("--edges", "FFFX"), "plate.edges: malformed"),
        (("--layup", "[0/9x]"), "plate.layup: malformed layup"),
        (("--frequencies", "200", "100"), "descending frequencies"),
        (("--table", "none.csv"), "no such file"),
    ],
)
def test_what_is_wrong_is_refused_and_nothing_is_written(capsys, tmp_path, argv, said):
    path = tmp_path / "panel.toml"
    status, document, err = answer(capsys, path, *argv)
    assert (status, document) == (2, None)
    assert said in err
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_is_there_is_never_written_over(capsys, tmp_path):
    path = tmp_path / "panel.toml"
    path.write_text("mine", encoding="utf-8")
    status, _, err = answer(capsys, path, *FULL)
    assert status == 2
    assert "exists; give another name" in err
    assert path.read_text(encoding="utf-8") == "mine"
