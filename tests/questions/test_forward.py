"""`forward` beside a frequency list, its solvers, and the decks of `export`."""

import json
import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import cpam_bayes as cb
from cpam_bayes.forward_model.calculix.run import PROGRAM_VARIABLE
from cpam_bayes.forward_model.labels import label_notices
from cpam_bayes.render.terminal import plain_text
from tests.meshes import grid, rectangle
from tests.plate_file import BAR, described, refused


@pytest.fixture(scope="module")
def carbon():
    result = cb.forward("C1", 3)
    assert len({mode.label for mode in result.modes}) == 3
    return result


def with_list(result, *labels, factor=1.01, complete=True):
    """The result beside a list of its own frequencies times a factor, in the order of the labels."""
    order = [[mode.label for mode in result.modes].index(label) if label else -1 for label in labels]
    free = iter([j for j in range(len(result.modes)) if j not in order])
    frequencies = factor * result.frequencies[[next(free) if j < 0 else j for j in order]]
    listed = replace(result.specimen.measurement, frequencies=frequencies, labels=labels, complete=complete)
    return replace(result, specimen=replace(result.specimen, measurement=listed))


def paired(result):
    return [
        (m["measured_hz"] and round(m["measured_hz"] / m["frequency_hz"], 6), m["paired_by"])
        for m in result.to_dict()["modes"]
    ]


def test_a_label_puts_a_frequency_beside_its_mode_and_the_others_in_order(carbon):
    unlabelled = with_list(carbon, "", "", "")
    assert paired(unlabelled) == 3 * [(1.01, "order")]
    assert paired(with_list(carbon, "", "", "", complete=False)) == 3 * [(None, None)]
    first, second, third = (mode.label for mode in carbon.modes)
    shown = with_list(carbon, second, first, "")
    assert paired(shown) == [(1.01, "label"), (1.01, "label"), (1.01, "order")]
    (table,) = shown.report().summary.tables
    assert [row[-1] for row in table.rows] == ["label", "label", "order"]
    alone = with_list(carbon, third, complete=False)
    assert paired(alone) == [(None, None), (None, None), (1.01, "label")]
    gaps = with_list(carbon, third, "", complete=False)
    assert paired(gaps) == paired(alone)
    assert any("is beside no mode" in said for said in gaps.report().summary.lines)
    measurement = unlabelled.specimen.measurement  # a label of no computed mode is flagged
    assert label_notices(measurement, carbon.modes) == ()
    (said,) = label_notices(replace(measurement, labels=("(9,9)", "", "")), carbon.modes)
    assert said.facts["labels"] == (("(9,9)", measurement.frequencies[0]),)


def test_a_difference_beyond_all_constants_is_a_factor(carbon):
    for factor, said, cell in (
        (1 / 985.0, "They are 985 times the measured ones.", "985 times"),
        (1 / 1.02, "+2.0 to +2.0 %", "+2.00"),
    ):
        summary = with_list(carbon, "", "", "", factor=factor).report().summary
        assert said in summary.headline
        assert cell in plain_text(summary.tables[0])


def handling(edges, n):
    """Where to support and to hit a slender aluminium strip for its first modes."""
    material = {"isotropic": True, "E1_GPa": 70.0, "nu12": 0.0}
    return cb.forward(described((300.0, 20.0, 2.0), 2700.0, material, edges=edges), n).handling


def test_a_strip_is_held_on_the_nodal_lines_of_its_first_mode_and_hit_where_all_modes_move():
    alone = handling("FFFF", 1)  # first nodes of a free beam at 0.2242 of its length; the grid has 40 steps
    (mode,) = alone.modes
    assert (mode.across, mode.lines) == ("x", pytest.approx((67.3, 232.7), abs=300 / 80))
    assert mode.at_hit == pytest.approx(0.7678, abs=1e-3)  # there the first mode moves by 0.7678 of its end
    assert sorted({x for x, _ in alone.pads}) == pytest.approx(mode.lines)
    several = handling("FFFF", 4)
    # at the grid point next to the end the fourth mode moves 0.302 of its end, the first three more
    assert min(m.at_hit for m in several.modes) >= 0.302
    assert "four soft pads" in several.sentence
    held = handling("CFFF", 2)  # a clamped strip needs no pads and is hit at its free end
    assert held.pads == ()
    assert held.hits[0][0] > 270
    assert "pads" not in held.sentence


def test_thickness_mass_and_density_that_disagree_are_warned_of():
    plate = described((300.0, 200.0, 3.0), 2700.0, {"isotropic": True, "E1_GPa": 70.0, "nu12": 0.33})
    assert not cb.forward(plate, 1).notices
    plate["plate"]["mass_g"] = 437.0  # instead of 486
    (said,) = cb.forward(plate, 1).notices
    assert (said.code, said.severity) == ("thicknesses_apart", "slip")
    assert cb.forward(plate, 1).report().summary.next_step.startswith("gauge and weigh the plate again")
    plate["measurement"] = {"frequencies_hz": [4e3]}  # then a distant list does not suggest other units
    assert [notice.code for notice in cb.forward(plate, 1).notices] == ["thicknesses_apart"]
    del plate["plate"]["mass_g"]
    assert [notice.code for notice in cb.forward(plate, 1).notices] == ["units"]


@pytest.fixture
def with_mesh(tmp_path, plate_file):
    def write(quads, weight="density_kg_m3 = 2700"):
        quads.write(tmp_path / "plate.msh")
        return Path(plate_file(("density_kg_m3 = 2700", f'mesh = "plate.msh"\n{weight}'), text=BAR))

    return write


def answer(run, *argv):
    status, out, err = run(*argv, "--json", "--quiet")
    assert (status, err) == (0, "")
    return json.loads(out)


def frequencies(document):
    return np.array([mode["frequency_hz"] for mode in document["modes"]])


def kinds(document):
    return [(mode["kind"], mode["label"]) for mode in document["modes"]]


def holed():
    def f(r, a):
        angle = 2 * np.pi * a
        radius = (1 - r) * 0.4 + r / np.maximum(np.abs(np.cos(angle)), np.abs(np.sin(angle)))
        return 100 + 100 * radius * np.cos(angle), 50 + 50 * radius * np.sin(angle)

    return grid(np.linspace(0, 1, 7), np.linspace(0, 1, 33), f, closed=True).without("x0", "y0", "x1", "y1")


def test_elements_and_ritz_agree_with_kinds_and_labels(run):
    elements, ritz = (answer(run, "forward", "A1", "--solver", solver) for solver in ("fem", "ritz"))
    assert kinds(elements) == kinds(ritz)
    # each states its possible error, and the difference is within both
    apart = np.abs(frequencies(elements) / frequencies(ritz) - 1.0)
    assert np.all(apart < elements["relative_error_estimate"] + ritz["relative_error_estimate"])
    assert elements["solver"].startswith("finite elements")
    assert elements["no_error_estimate"] is None


def test_a_plate_with_a_mesh_is_computed_with_elements_whose_error_is_said_to_be_unknown(run, with_mesh):
    path = with_mesh(rectangle(200.0, 100.0, 8, 4))
    document = answer(run, "forward", path, "--modes", "2")
    by_fem = answer(run, "forward", path, "--modes", "2", "--solver", "fem")
    assert document == by_fem | {"seconds": document["seconds"]}
    assert [of["relative_error_estimate"] for of in (document, *document["modes"])] == [None] * 3
    assert document["no_error_estimate"].startswith("not known")
    out = cb.forward(path, 2).summary(verbose=True)
    assert re.search(r"error +not known: the mesh of a file is the only one", out)
    assert re.search(r"outline +the mesh .*plate.msh", out)
    assert "32 8-node elements of plate.msh, 20000 mm2" in out


def test_a_holed_plate_that_was_weighed_is_denser_than_its_rectangle(run, with_mesh):
    path = with_mesh(holed(), weight="mass_g = 100.0")
    area = 20000.0 - 16 * np.sin(np.pi / 16) * 40 * 20  # mm2, minus an ellipse of 40 x 20 mm with 32 chords
    result = cb.forward(path, 4)
    assert f"{0.1 / (area * 1e-6 * 3e-3):.6g} kg/m3 from the weighed mass, 100 g" in result.summary(
        verbose=True
    )
    assert result.plot("modes").axes
    # a sensor cannot be in the hole, and a mesh in metres is no plate
    path.write_text(path.read_text() + "[[sensor]]\nmass_g = 1.0\nx_mm = 100.0\ny_mm = 50.0\n")
    refused(run("forward", path, "--quiet"), "point (x, y) = (0.1, 0.05) m is not on the plate's mesh")
    path = with_mesh(rectangle(0.2, 0.1, 4, 2))
    refused(run("forward", path, "--quiet"), "mesh ", "plate.msh: it extends over 0.2 x 0.1, the plate over")


def test_a_missing_calculix_is_said(run, monkeypatch, tmp_path):
    asked = ("forward", "A1", "--solver", "ccx", "--quiet")
    monkeypatch.setenv(PROGRAM_VARIABLE, str(tmp_path / "none"))
    refused(run(*asked), PROGRAM_VARIABLE, "accepted: the path of")
    monkeypatch.delenv(PROGRAM_VARIABLE)
    monkeypatch.setenv("PATH", str(tmp_path))
    refused(run(*asked), "not installed", "calculix-ccx")


@pytest.mark.needs_ccx
def test_calculix_computes_with_bricks_by_default_and_with_shells_that_agree_with_ritz(run):
    found = answer(run, "forward", "A1", "--solver", "ccx", "--element", "shell")
    ritz = answer(run, "forward", "A1")
    np.testing.assert_allclose(frequencies(found), frequencies(ritz), rtol=3e-3)
    assert kinds(found) == kinds(ritz)
    assert (found["relative_error_estimate"], found["no_error_estimate"]) == (None, "not estimated")
    bricks = cb.forward("A1", 3, solver="ccx")
    said = bricks.summary(verbose=True)
    assert re.search(r"solver +CalculiX, 20-node bricks", said)
    assert re.search(r"error +not estimated", said)
    assert bricks.plot("modes").axes


@pytest.mark.parametrize(
    ("element", "kind", "section"),
    [("shell", "S8R", "*SHELL SECTION, COMPOSITE"), ("brick", "C3D20R", "*SOLID SECTION")],
)
def test_export_writes_a_deck_of_each_element(run, tmp_path, element, kind, section):
    path = tmp_path / "c2.inp"
    argv = ("export", "C2", "--to", "ccx", "--element", element, "--modes", "3", "--out", path)
    document, text = answer(run, *argv, "--seed", "4"), path.read_text(encoding="ascii")
    for card in ("*HEADING", "*NODE, ", "*ORIENTATION", "ENGINEERING CONSTANTS", "*FREQUENCY\n9\n"):
        assert card in text
    assert all(card in text for card in (f"*ELEMENT, TYPE={kind}", section))
    nodes = text.partition("*NODE, NSET=ALL\n")[2].partition("\n*")[0].splitlines()
    blocks = re.findall(r"^\*ELEMENT, TYPE=.*\n((?:[^*].*\n)+)", text, re.M)
    lines = sum(block.count("\n") for block in blocks)  # one line, or two for more than 15 nodes
    counts = (len(nodes), lines // (1 if element == "shell" else 2))
    assert (document["nodes"], document["elements"]) == counts
    assert (document["path"], document["element"], document["element_type"]) == (str(path), element, kind)
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
        tmp_path / "none" / "a.inp": "none is not a directory",
        "": "--out: received an empty name",
        tmp_path / ("a" * 300): "cannot be written to",
        **dict.fromkeys((Path(os.devnull), link, pipe), "a link, pipe or device, accepted"),
        plate: "the plate file itself",
    }.items():
        refused(run("export", plate, "--to", "ccx", "--force", "--out", out), said)
    assert (plate.read_text(), kept.read_text()) == (before, "somebody's")
    assert (link.is_symlink(), pipe.is_fifo(), len(list(tmp_path.iterdir()))) == (True, True, 4)
