"""Slips of a plate file that explain a gross misfit: named where they do, not where something else does."""

import functools
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cpam_bayes as cb
from cpam_bayes.plate import Specimen
from cpam_bayes.questions.identify import slips
from cpam_bayes.questions.identify.slips import Slip, corrected_file, explaining_slips
from tests.batches.plates import N_MODES, plate, written
from tests.hybrids import hybrid
from tests.plate_file import described

NOISE = 0.001
PLATE = described(
    (310.0, 228.0, 3.1),
    1550.0,
    {"E1_GPa": 132.0, "E2_GPa": 9.1, "nu12": 0.31, "G12_GPa": 4.8},
    layup="[0_8]",
    unknowns={"E1_GPa": [80.0, 200.0], "E2_GPa": [5.0, 16.0], "nu12": [0.15, 0.45], "G12_GPa": [2.5, 10.0]},
) | {"name": "p"}


def stated(frequencies: Any, **plate: Any) -> dict[str, Any]:
    """The plate file of a list, with what it states of the plate."""
    measured = {"frequencies_hz": [float(f) for f in np.sort(frequencies)], "relative_std": NOISE}
    return {**PLATE, "plate": {**PLATE["plate"], **plate}, "measurement": measured}


@functools.cache
def _frequencies(n: int, file: str) -> Any:
    return cb.forward(json.loads(file), n, solver="fem").frequencies


def listed(n: int = 10, sensor: Any = None, **plate: Any) -> Any:
    """A list of the plate with 0.1 % of noise, made by the other discretisation; sensor : left on it."""
    true = {**PLATE, "plate": {**PLATE["plate"], **plate}, "sensor": sensor or []}
    return _frequencies(n, json.dumps(true)) * (1.0 + NOISE * np.random.default_rng(5).standard_normal(n))


def found(file: dict[str, Any]) -> list[tuple[str, int]]:
    return [(slip.kind, slip.number) for slip in explaining_slips(cb.read_plate(file))]


def changed(place: int, factor: float) -> dict[str, Any]:
    """The plate file of a list with one number that is wrong by a factor."""
    return stated(listed(11) * np.where(np.arange(11) == place, factor, 1.0))


@pytest.mark.slow
def test_sides_exchanged_are_named_and_written_anew(tmp_path: Path) -> None:
    path = written(tmp_path / "p.toml", stated(listed(), length_mm=228.0, width_mm=310.0))
    text = path.read_text(encoding="utf-8").replace("length_mm = 228.0\n", "length_mm = 228.0   # x\n")
    path.write_text(text, encoding="utf-8")
    answer = cb.identify(str(path), seed=0)
    assert [slip.kind for slip in answer.explained_by] == ["sides"]
    assert answer.explained_by[0].rms < 2.0 * NOISE < 0.1 * answer.estimate.rms
    assert "With length and width exchanged (or the layup turned by 90 degrees) it fits to" in answer.slips[0]
    corrected = tmp_path / "corrected.toml"
    corrected.write_text(answer.texts()["corrected.toml"], encoding="utf-8")
    assert "length_mm = 310.0   # x\nwidth_mm = 228.0\n" in corrected.read_text(encoding="utf-8")
    again = cb.read_plate(corrected)
    assert (again.plate.length, again.plate.width) == (0.31, 0.228)
    assert explaining_slips(again) == ()


def test_standard_deviations_of_sides_are_exchanged_with_them() -> None:
    specimen = cb.read_plate(stated(listed(), sd={"length_mm": 0.2, "width_mm": 1.2}))
    (sides,) = (slip for slip in slips._plates(specimen) if slip.kind == "sides")
    assert sides.edits["plate", "sd", "length_mm"] == 1.2
    assert sides.edits["plate", "sd", "width_mm"] == 0.2
    assert sides.corrected.plate.sd == {"length": 1.2e-3, "width": 0.2e-3}


def test_beside_a_sensor_a_turned_layup_is_not_the_sides_exchanged() -> None:
    sensor = [{"mass_g": 12.0, "x_mm": 280.0, "y_mm": 150.0}]
    true = listed(sensor=sensor, layup="[90_8]")
    turned = cb.read_plate({**stated(true), "sensor": sensor})
    assert [slip.kind for slip in explaining_slips(turned)] == ["layup"]


@pytest.mark.parametrize(
    ("file", "expected"),
    [
        pytest.param(
            lambda: stated(listed(edges="CFFF"), edges="FCFF"), ("edges", 0), marks=pytest.mark.slow
        ),
        (lambda: stated(np.delete(listed(11), 3)), ("missed", 4)),
        (lambda: stated(np.append(listed(11)[:10], 250.0)), ("false", 4)),
        (lambda: changed(10, 10.0), ("decimal", 11)),
        (lambda: changed(2, 1.12), ("misread", 3)),
        # misread by so much that it stands two places further on
        (lambda: changed(2, 1.75), ("misread", 5)),
        pytest.param(
            lambda: stated(listed(edges="CFCF"), edges="SFSF"), ("supports", 0), marks=pytest.mark.slow
        ),
    ],
    ids=("edges", "missed", "false", "decimal", "misread", "misread and sorted", "supports"),
)
def test_a_slip_is_named(file: Any, expected: tuple[str, int]) -> None:
    assert found(file()) == [expected]


@pytest.mark.slow
def test_slips_are_weighed_once_where_a_list_is_reached_by_none_but_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    weighed: list[str] = []

    def counted(specimen: Specimen) -> tuple[Slip, ...]:
        weighed.append(specimen.name)
        return explaining_slips(specimen)

    monkeypatch.setattr(slips, "explaining_slips", counted)
    # a point put wrong within the list
    answer = cb.identify(changed(9, 0.1), seed=0)
    assert [(slip.kind, slip.number) for slip in answer.explained_by] == [("decimal", 1)]
    assert weighed == ["p"]


@pytest.mark.parametrize(
    "sensor",
    [
        pytest.param(
            {"mass_g": 12.0, "x_mm": 260.0, "y_mm": 60.0}, id="a light mass", marks=pytest.mark.slow
        ),
        pytest.param({"mass_g": 60.0, "x_mm": 40.0, "y_mm": 200.0}, id="a heavy mass"),
    ],
)
def test_a_mass_left_on_the_plate_is_no_slip_of_its_file(sensor: dict[str, float]) -> None:
    assert found(stated(listed(sensor=[sensor]))) == []


@pytest.mark.parametrize(
    ("true", "said", "kind"),
    [
        ("FCFF", "FFFF", "clamped"),
        ("FFFF", "FCFF", "free"),
        pytest.param("FFFF", "SSSS", "free", marks=pytest.mark.slow),
    ],
)
def test_a_plate_that_was_clamped_or_free_against_its_file_has_its_edges_named(
    true: str, said: str, kind: str
) -> None:
    slips = explaining_slips(cb.read_plate(stated(listed(edges=true), edges=said)))
    assert [(slip.kind, slip.edits) for slip in slips] == [(kind, {("plate", "edges"): true})]


@pytest.mark.slow
def test_a_sensor_tells_the_clamped_edge_from_the_one_opposite() -> None:
    held = plate("held") | {"sensor": [{"mass_g": 20.0, "x_mm": 30.0, "y_mm": 20.0}]}
    clamped = {**held, "plate": {**held["plate"], "edges": "FFCF"}}
    listed = cb.forward(clamped, N_MODES).frequencies.tolist()
    file = {**held, "measurement": {"frequencies_hz": listed, "relative_std": NOISE}}
    assert [slip.corrected.plate.edges for slip in explaining_slips(cb.read_plate(file))] == ["FFCF"]


@pytest.mark.slow
def test_two_slips_of_one_spectrum_are_both_named() -> None:
    square = {"width_mm": 310.0, "edges": "CFFF"}
    both = found(stated(listed(**square), **{**square, "edges": "FCFF"}))
    assert sorted(kind for kind, _ in both) == ["edges", "layup"]


LIST = ("measurement", "frequencies_hz")
SIDES = {("plate", "length_mm"): 1.0, ("plate", "width_mm"): 2.0}
MISSED = {("measurement", "complete"): False}


@pytest.mark.parametrize(
    ("text", "kind", "edits", "corrected"),
    [
        (
            "[measurement]\nfrequencies_hz = [\n 1.0,\n 2.0,\n]\n",
            "missed",
            MISSED,
            "[measurement]\ncomplete = false\nfrequencies_hz = [\n 1.0,\n 2.0,\n]\n",
        ),
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
def test_what_can_be_edited_is_corrected_in_the_file(
    tmp_path: Path, text: str, kind: Any, edits: dict[tuple[str, str], Any], corrected: str | None
) -> None:
    path = tmp_path / "p.toml"
    path.write_text(text, encoding="utf-8")
    specimen = replace(cb.read_plate(stated(listed(11))), source=str(path))
    assert corrected_file(specimen, Slip(kind, 2, 0.0, specimen, edits)) == corrected


@pytest.mark.slow
def test_a_turned_layup_keeps_the_names_of_its_plies() -> None:
    plies = [{"name": "thick", "thickness_mm": 1.0}, {"name": "thin", "thickness_mm": 0.55}]
    true = {**PLATE, "ply": plies, "plate": {**PLATE["plate"], "edges": "CFFF", "layup": "[thick0/thin45]_s"}}
    f = cb.forward(true, 10).frequencies.tolist()
    turned = stated(f, edges="CFFF", layup="[thick90/thin-45]_s")
    (slip,) = explaining_slips(cb.read_plate({**turned, "ply": plies}))
    assert (slip.kind, slip.edits) == ("layup", {("plate", "layup"): "[thick0/thin45/thin45/thick0]"})


def test_nothing_is_tried_of_several_materials() -> None:
    f = cb.forward(hybrid(edges="CFFF"), 8).frequencies.tolist()
    measured = {"frequencies_hz": f, "relative_std": NOISE}
    file = {**hybrid(edges="CFFF", layup="[c90_2/g-45/g45/c0]_s"), "measurement": measured}
    specimen = cb.read_plate({**file, "unknowns": {"carbon": {"E1_GPa": [80.0, 200.0]}}})
    assert explaining_slips(specimen) == ()
