"""The solvers of `forward` and the decks of `export`, as a user and a script see them."""

import json
import os
import re
from pathlib import Path

import numpy as np
import pytest

import cpam_bayes as cb
from cpam_bayes.forward_model.calculix.run import PROGRAM_VARIABLE
from tests.meshes import grid, rectangle
from tests.plate_file import refused

PLATE = """\
name = "plate 7"

[plate]
length_mm = 200.0
width_mm = 100.0
thickness_mm = 3.0
{weight}
edges = "{edges}"
mesh = "plate.msh"

[material]
isotropic = true
E1_GPa = 69.0
nu12 = 0.33

[unknowns]
E1_GPa = [10.0, 200.0]
"""


@pytest.fixture
def with_mesh(tmp_path):
    """Write a mesh and a plate file that names it, and return the plate file's path."""

    def write(quads, edges="FFFF", weight="density_kg_m3 = 2700.0"):
        quads.write(tmp_path / "plate.msh")
        path = tmp_path / "plate.toml"
        path.write_text(PLATE.format(edges=edges, weight=weight), encoding="utf-8")
        return path

    return write


def answer(run, *argv):
    """The document of a command that has nothing to complain about."""
    status, out, err = run(*argv, "--json", "--quiet")
    assert (status, err) == (0, "")
    return json.loads(out)


def frequencies(document):
    return np.array([mode["frequency_hz"] for mode in document["modes"]])


def described(document):
    return [(mode["kind"], mode["label"]) for mode in document["modes"]]


def holed():
    """200 x 100 mm with an elliptic hole in the middle."""

    def f(r, a):
        angle = 2 * np.pi * a
        square = np.maximum(np.abs(np.cos(angle)), np.abs(np.sin(angle)))
        radius = (1 - r) * 0.4 + r / square
        return 100 + 100 * radius * np.cos(angle), 50 + 50 * radius * np.sin(angle)

    return grid(np.linspace(0, 1, 7), np.linspace(0, 1, 33), f, closed=True).without("x0", "y0", "x1", "y1")


def test_elements_and_ritz_agree_with_kinds_and_labels(run):
    elements = answer(run, "forward", "A1", "--solver", "fem")
    ritz = answer(run, "forward", "A1", "--solver", "ritz")
    assert described(elements) == described(ritz)
    # each says how far it may be off, and they are not further apart
    apart = np.abs(frequencies(elements) / frequencies(ritz) - 1.0)
    assert np.all(apart < elements["relative_error_estimate"] + ritz["relative_error_estimate"])
    assert elements["solver"].startswith("finite elements")
    assert elements["no_error_estimate"] is None


def test_a_plate_with_a_mesh_is_computed_with_elements_whose_error_is_said_to_be_unknown(run, with_mesh):
    path = with_mesh(rectangle(200.0, 100.0, 8, 4))
    document = answer(run, "forward", path, "--modes", "2")
    by_fem = answer(run, "forward", path, "--modes", "2", "--solver", "fem")
    assert document == by_fem | {"seconds": document["seconds"]}
    assert document["relative_error_estimate"] is None
    assert [mode["relative_error_estimate"] for mode in document["modes"]] == [None, None]
    assert document["no_error_estimate"].startswith("not known")
    out = cb.forward(path, 2).summary(verbose=True)
    assert re.search(r"error +not known: the mesh of a file is the only one", out)
    assert re.search(r"outline +the mesh .*plate.msh", out)
    assert "32 8-node elements of plate.msh, 20000 mm2" in out


def test_a_holed_plate_that_was_weighed_is_denser_than_its_rectangle(with_mesh):
    path = with_mesh(holed(), weight="mass_g = 100.0")
    # 20000 mm2 less an ellipse of 40 x 20 mm, 32 chords round
    area = 20000.0 - 16 * np.sin(np.pi / 16) * 40 * 20
    density = 0.1 / (area * 1e-6 * 3e-3)
    result = cb.forward(path, 4)
    assert f"{density:.6g} kg/m3 from the weighed mass, 100 g" in result.summary(verbose=True)
    assert result.plot("modes").axes


def test_a_mesh_that_is_no_plate_is_refused_as_is_a_sensor_over_a_hole(run, with_mesh):
    path = with_mesh(rectangle(0.2, 0.1, 4, 2))
    refused(run("forward", path, "--quiet"), "mesh ", "plate.msh: it extends over 0.2 x 0.1, the plate over")
    path = with_mesh(holed())
    path.write_text(path.read_text() + "[[sensor]]\nmass_g = 1.0\nx_mm = 100.0\ny_mm = 50.0\n")
    refused(run("forward", path, "--quiet"), "point (x, y) = (0.1, 0.05) m is not on the plate's mesh")


def test_a_missing_calculix_is_said(run, monkeypatch, tmp_path):
    monkeypatch.setenv(PROGRAM_VARIABLE, str(tmp_path / "none"))
    refused(run("forward", "A1", "--solver", "ccx", "--quiet"), PROGRAM_VARIABLE, "accepted: the path of")
    monkeypatch.delenv(PROGRAM_VARIABLE)
    monkeypatch.setenv("PATH", str(tmp_path))
    refused(run("forward", "A1", "--solver", "ccx", "--quiet"), "not installed", "calculix-ccx")


@pytest.mark.needs_ccx
def test_calculix_computes_with_bricks_by_default_and_with_shells_that_agree_with_ritz(run):
    found = answer(run, "forward", "A1", "--solver", "ccx", "--element", "shell")
    ritz = answer(run, "forward", "A1")
    np.testing.assert_allclose(frequencies(found), frequencies(ritz), rtol=3e-3)
    assert described(found) == described(ritz)
    assert found["relative_error_estimate"] is None
    assert found["no_error_estimate"] == "not estimated"
    bricks = cb.forward("A1", 3, solver="ccx")
    assert re.search(r"solver +CalculiX, 20-node bricks", bricks.summary(verbose=True))
    assert re.search(r"error +not estimated", bricks.summary(verbose=True))
    assert bricks.plot("modes").axes


@pytest.mark.parametrize(
    ("element", "kind", "cards"),
    [
        ("shell", "S8R", ("*ELEMENT, TYPE=S8R", "*SHELL SECTION, COMPOSITE")),
        ("brick", "C3D20R", ("*ELEMENT, TYPE=C3D20R", "*SOLID SECTION")),
    ],
)
def test_export_writes_a_deck_of_each_element(run, tmp_path, element, kind, cards):
    path = tmp_path / "c2.inp"
    argv = ("export", "C2", "--to", "ccx", "--element", element, "--modes", "3", "--out", path)
    document = answer(run, *argv, "--seed", "4")
    text = path.read_text(encoding="ascii")
    for card in ("*HEADING", "*NODE, ", "*ORIENTATION", "ENGINEERING CONSTANTS", "*FREQUENCY\n9\n", *cards):
        assert card in text
    nodes = text.partition("*NODE, NSET=ALL\n")[2].partition("\n*")[0].splitlines()
    blocks = re.findall(r"^\*ELEMENT, TYPE=.*\n((?:[^*].*\n)+)", text, re.M)
    # an element is a line, or two where it has more than 15 nodes
    lines = sum(block.count("\n") for block in blocks)
    assert document["nodes"] == len(nodes)
    assert document["elements"] == lines // (1 if element == "shell" else 2)
    assert document["path"] == str(path)
    assert (document["element"], document["element_type"]) == (element, kind)
    assert (document["modes"], document["rigid_body_motions"]) == (3, 6)
    assert list(tmp_path.iterdir()) == [path]


def test_export_writes_shells_to_a_file_of_the_plates_name_and_over_a_file_with_force_alone(
    run, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "D&G.inp"
    path.write_text("mine")
    refused(run("export", "D&G", "--to", "ccx"), "--out D&G.inp: exists", "--force")
    assert path.read_text() == "mine"
    status, out, err = run("export", "D&G", "--to", "ccx", "--verbose", "--force")
    assert (status, err) == (0, "")
    assert re.search(r"file +D&G.inp\n", out)
    assert re.search(r"elements +\d+ of S8R, shells", out)
    assert "TYPE=S8R" in path.read_text()


def test_export_to_an_impossible_place_is_refused(run, plate_file, tmp_path):
    plate, kept, link, pipe = (tmp_path / name for name in ("plate.toml", "kept.inp", "a.inp", "b.inp"))
    before = Path(plate_file()).read_text()
    kept.write_text("somebody's")
    link.symlink_to(kept)
    os.mkfifo(pipe)
    for out, said in {
        tmp_path: "a directory, accepted: the file to write",
        tmp_path / "none" / "a.inp": "none is no directory",
        "": "--out: received an empty name",
        tmp_path / ("a" * 300): "cannot be written to",
        **dict.fromkeys((Path(os.devnull), link, pipe), "a link, pipe or device, accepted"),
        plate: "the plate file itself",
    }.items():
        refused(run("export", plate, "--to", "ccx", "--force", "--out", out), said)
    assert (plate.read_text(), kept.read_text()) == (before, "somebody's")
    assert link.is_symlink()
    assert pipe.is_fifo()
    assert len(list(tmp_path.iterdir())) == 4
