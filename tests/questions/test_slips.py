"""Slips of a plate file that explain a gross misfit are named, unless something else explains it."""

import functools
import json
from dataclasses import replace

import numpy as np
import pytest

import cpam_bayes as cb
from cpam_bayes.questions.identify import slips
from cpam_bayes.questions.identify.slips import Slip, corrected_file, explaining_slips
from tests.batches.plates import N_MODES, plate, written
from tests.hybrids import hybrid
from tests.plate_file import SHEET, described

NOISE, SLOW = 0.001, pytest.mark.slow
LIGHT, HEAVY = ({"mass_g": g, "x_mm": x, "y_mm": y} for g, x, y in ((12.0, 260.0, 60.0), (60.0, 40.0, 200.0)))
UNKNOWNS = {"E1_GPa": [80.0, 200.0], "E2_GPa": [5.0, 16.0], "nu12": [0.15, 0.45], "G12_GPa": [2.5, 10.0]}
PLATE = described((310.0, 228.0, 3.1), 1550.0, SHEET, layup="[0_8]", unknowns=UNKNOWNS) | {"name": "p"}


def stated(frequencies, **plate):
    measured = {"frequencies_hz": [float(f) for f in np.sort(frequencies)], "relative_std": NOISE}
    return {**PLATE, "plate": {**PLATE["plate"], **plate}, "measurement": measured}


@functools.cache
def _frequencies(n, file):
    return cb.forward(json.loads(file), n, solver="fem").frequencies


def listed(n=10, sensor=(), **plate):
    """Frequencies of the plate from the other discretisation, with 0.1 % of noise; sensor : left on it."""
    true = {**PLATE, "plate": {**PLATE["plate"], **plate}, "sensor": list(sensor)}
    return _frequencies(n, json.dumps(true)) * (1.0 + NOISE * np.random.default_rng(5).standard_normal(n))


def explaining(file):
    return explaining_slips(cb.read_plate(file))


def found(file):
    return [(slip.kind, slip.number) for slip in explaining(file)]


def changed(place, factor):
    return stated(listed(11) * np.where(np.arange(11) == place, factor, 1.0))


@pytest.mark.slow
def test_sides_exchanged_are_named_and_written_anew(tmp_path):
    path = written(tmp_path / "p.toml", stated(listed(), length_mm=228.0, width_mm=310.0))
    text = path.read_text(encoding="utf-8").replace("length_mm = 228.0\n", "length_mm = 228.0   # x\n")
    path.write_text(text, encoding="utf-8")
    answer = cb.identify(str(path), seed=0)
    (sides,) = answer.explained_by
    assert sides.kind == "sides"
    assert sides.rms < 2.0 * NOISE < 0.1 * answer.estimate.rms
    assert "With length and width exchanged (or the layup turned by 90 degrees) it fits to" in answer.slips[0]
    text = answer.texts()["corrected.toml"]
    assert "length_mm = 310.0   # x\nwidth_mm = 228.0\n" in text
    path.write_text(text, encoding="utf-8")
    again = cb.read_plate(path)
    assert (again.plate.length, again.plate.width, explaining_slips(again)) == (0.31, 0.228, ())


def test_standard_deviations_of_sides_are_exchanged_with_them():
    specimen = cb.read_plate(stated(listed(), sd={"length_mm": 0.2, "width_mm": 1.2}))
    (sides,) = (slip for slip in slips._plates(specimen) if slip.kind == "sides")
    edited = [sides.edits["plate", "sd", side] for side in ("length_mm", "width_mm")]
    assert (edited, sides.corrected.plate.sd) == ([1.2, 0.2], {"length": 1.2e-3, "width": 0.2e-3})


@pytest.mark.parametrize(
    ("file", "expected"),
    [
        pytest.param(lambda: stated(listed(edges="CFFF"), edges="FCFF"), [("edges", 0)], marks=SLOW),
        (lambda: stated(np.delete(listed(11), 3)), [("missed", 4)]),
        (lambda: stated(np.append(listed(11)[:10], 250.0)), [("false", 4)]),
        (lambda: changed(10, 10.0), [("decimal", 11)]),
        (lambda: changed(2, 1.12), [("misread", 3)]),
        (lambda: changed(2, 1.75), [("misread", 5)]),  # misread so much that it moves up two ranks
        pytest.param(lambda: stated(listed(edges="CFCF"), edges="SFSF"), [("supports", 0)], marks=SLOW),
        pytest.param(lambda: stated(listed(sensor=[LIGHT])), [], marks=SLOW),  # a mass is no slip of the file
        (lambda: stated(listed(sensor=[HEAVY])), []),
    ],
    ids=("edges", "missed", "false", "decimal", "misread", "misread, sorted", "supports", "light", "heavy"),
)
def test_a_slip_is_named(file, expected):
    assert found(file()) == expected


@pytest.mark.slow
def test_slips_are_weighed_once_where_a_list_is_reached_by_none_but_them(monkeypatch):
    weighed: list[str] = []

    def counted(specimen):
        weighed.append(specimen.name)
        return explaining_slips(specimen)

    monkeypatch.setattr(slips, "explaining_slips", counted)
    answer = cb.identify(changed(9, 0.1), seed=0)  # a misplaced decimal point in the list
    assert [(slip.kind, slip.number) for slip in answer.explained_by] == [("decimal", 1)]
    assert weighed == ["p"]


@pytest.mark.parametrize(
    ("true", "said", "kind"),
    [("FCFF", "FFFF", "clamped"), ("FFFF", "FCFF", "free"), pytest.param("FFFF", "SSSS", "free", marks=SLOW)],
)
def test_a_plate_that_was_clamped_or_free_against_its_file_has_its_edges_named(true, said, kind):
    slips = explaining(stated(listed(edges=true), edges=said))
    assert [(slip.kind, slip.edits) for slip in slips] == [(kind, {("plate", "edges"): true})]


def test_beside_a_sensor_a_turned_layup_is_not_the_sides_exchanged():
    sensor = [{"mass_g": 12.0, "x_mm": 280.0, "y_mm": 150.0}]
    turned = {**stated(listed(sensor=sensor, layup="[90_8]")), "sensor": sensor}
    assert [slip.kind for slip in explaining(turned)] == ["layup"]


@pytest.mark.slow
def test_a_sensor_tells_the_clamped_edge_from_the_one_opposite():
    held = plate("held") | {"sensor": [{"mass_g": 20.0, "x_mm": 30.0, "y_mm": 20.0}]}
    clamped = {**held, "plate": {**held["plate"], "edges": "FFCF"}}
    measured = {"frequencies_hz": cb.forward(clamped, N_MODES).frequencies.tolist(), "relative_std": NOISE}
    assert [slip.corrected.plate.edges for slip in explaining({**held, "measurement": measured})] == ["FFCF"]


@pytest.mark.slow
def test_two_slips_of_one_spectrum_are_both_named_in_the_order_in_which_they_are_tried():
    square = {"width_mm": 310.0, "edges": "CFFF"}
    both = found(stated(listed(**square), **{**square, "edges": "FCFF"}))
    assert [kind for kind, _ in both] == ["layup", "edges"]


LIST = ("measurement", "frequencies_hz")
SIDES = {("plate", "length_mm"): 1.0, ("plate", "width_mm"): 2.0}
MISSED = {("measurement", "complete"): False}
OVER_LINES = "frequencies_hz = [\n 1.0,\n 2.0,\n]\n"


@pytest.mark.parametrize(
    ("text", "kind", "edits", "corrected"),
    [
        (f"[measurement]\n{OVER_LINES}", "missed", MISSED, f"[measurement]\ncomplete = false\n{OVER_LINES}"),
        ('[measurement]\ntable = "modes.csv"\n', "missed", MISSED, None),
        (
            "[measurement]\nfrequencies_hz = [1.0,  # hit [1]\n 2.0]\n",
            "false",
            {LIST: [1.0]},
            "[measurement]\nfrequencies_hz = [1.0]\n",
        ),
        # left_out would number another row of the shorter list
        ("[measurement]\nfrequencies_hz = [1.0, 2.0, 3.0]\nleft_out = [3]\n", "false", {LIST: [1.0]}, None),
        ("plate = {length_mm = 2.0, width_mm = 1.0}\n", "sides", SIDES, None),
    ],
)
def test_what_can_be_edited_is_corrected_in_the_file(tmp_path, text, kind, edits, corrected):
    path = tmp_path / "p.toml"
    path.write_text(text, encoding="utf-8")
    specimen = replace(cb.read_plate(stated(listed(11))), source=str(path))
    assert corrected_file(specimen, Slip(kind, 2, 0.0, specimen, edits)) == corrected


@pytest.mark.slow
def test_a_turned_layup_keeps_the_names_of_its_plies():
    plies = [{"name": "thick", "thickness_mm": 1.0}, {"name": "thin", "thickness_mm": 0.55}]
    true = {**PLATE, "ply": plies, "plate": {**PLATE["plate"], "edges": "CFFF", "layup": "[thick0/thin45]_s"}}
    turned = stated(cb.forward(true, 10).frequencies, edges="CFFF", layup="[thick90/thin-45]_s")
    (slip,) = explaining({**turned, "ply": plies})
    assert (slip.kind, slip.edits) == ("layup", {("plate", "layup"): "[thick0/thin45/thin45/thick0]"})


def test_nothing_is_tried_of_several_materials():
    f = cb.forward(hybrid(edges="CFFF"), 8).frequencies.tolist()
    file = hybrid(edges="CFFF", layup="[c90_2/g-45/g45/c0]_s")
    file |= {"measurement": {"frequencies_hz": f, "relative_std": NOISE}}
    assert explaining({**file, "unknowns": {"carbon": {"E1_GPa": [80.0, 200.0]}}}) == ()
