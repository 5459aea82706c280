"""What the model leaves out: three dimensions beside first-order theory, by rule and on bricks, and air."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import cpam_bayes as cb
from cpam_bayes.forward_model.calculix import solve_modes
from cpam_bayes.forward_model.model import (
    NO_PARAMETERS,
    ROOM_AIR,
    air_shifts,
    converged_model,
    reference_constants,
)
from cpam_bayes.forward_model.three_dimensions import edge_layer, theory_error
from cpam_bayes.plate import Specimen, builtin
from cpam_bayes.plate.layup import parse_layup
from cpam_bayes.render.plate import air_text
from tests.hybrids import hybrid
from tests.plate_file import described

SAVED = Path(__file__).parents[2] / "studies" / "results" / "16_theory_error.json"


def carbon(layup: str, edges: str = "FFFF", thickness_mm: float = 3.6) -> Specimen:
    material = {"isotropic": False, "E1_GPa": 130.0, "E2_GPa": 9.0, "nu12": 0.3, "G12_GPa": 5.0}
    size = 240.0, 180.0, thickness_mm
    return cb.read_plate(described(size, 1580.0, material, layup=layup, edges=edges))


@pytest.mark.parametrize("layup", ["[0]", "[30_4]", "[90]"])
def test_plies_that_are_all_alike_leave_no_stress_at_a_free_edge_and_others_turn_with_the_plate(
    layup: str,
) -> None:
    assert max(edge_layer(carbon(layup), axis) for axis in (0, 1)) < 1e-12
    here, turned = carbon("[0/30/-60/90]"), carbon("[90/-60/30/0]")
    assert edge_layer(here, 0) == pytest.approx(edge_layer(turned, 1), rel=1e-9)


@pytest.mark.parametrize(
    ("layup", "middle_mm", "tolerance"),
    # one ply for two has half as many points, of an integral that is of first order in them
    [("[a0/b45_2/a90]_s", 0.5, 1e-9), ("[a0/b45/a90]_s", 1.0, 0.01)],
)
def test_plies_of_two_equal_materials_have_the_error_of_one(
    layup: str, middle_mm: float, tolerance: float
) -> None:
    plain = carbon("[0/45_2/90]_s", thickness_mm=4.0)
    both = hybrid(length_mm=240.0, width_mm=180.0, thickness_mm=4.0, layup=layup)
    both["ply"] = [
        {"name": "a", "material": "a", "thickness_mm": 0.5},
        {"name": "b", "material": "b", "thickness_mm": middle_mm},
    ]
    of_carbon = {"E1_GPa": 130.0, "E2_GPa": 9.0, "nu12": 0.3, "G12_GPa": 5.0, "density_kg_m3": 1580.0}
    both["material"] = {"a": of_carbon, "b": of_carbon}
    of_two, f = cb.read_plate(both), [300.0, 900.0]
    assert_allclose(edge_layer(of_two, 0), edge_layer(plain, 0), rtol=tolerance)
    assert_allclose(theory_error(of_two, f), theory_error(plain, f), rtol=tolerance)


def test_edge_layer_is_thin_where_plies_alternate_often() -> None:
    few, many = (edge_layer(carbon(f"[0/45/-45/90]_{n}s"), 0) for n in (1, 3))
    assert 0.1 < many / few < 0.4


def test_only_free_edges_have_a_layer() -> None:
    f = [100.0]
    held, free = (theory_error(carbon("[0/45/-45/90]_s", e), f)[0] for e in ("CCCC", "FFFF"))
    # what a clamp adds itself is 0.018 h times the perimeter over the area
    assert held == pytest.approx(0.018 * 3.6 * 840.0 / (240.0 * 180.0), rel=0.05)
    assert free > 2 * held


def test_error_grows_with_thickness_and_frequency() -> None:
    thin, thick = (theory_error(carbon("[0/90]_2s", "FFFF", h), [500.0, 1500.0]) for h in (1.2, 7.2))
    assert np.all(thick > thin)
    assert thick[1] > thick[0]


def test_a_layup_with_unknown_angles_is_refused() -> None:
    plate = carbon("[0/90]_2s")
    unknown = replace(plate, plate=replace(plate.plate, layup=parse_layup("[?/90]_s")))
    with pytest.raises(ValueError, match="known layup"):
        theory_error(unknown, [100.0])


def test_rule_covers_what_bricks_show() -> None:
    # The rule is one number for a plate's scatter: root mean squares of ten modes lie within a factor of
    # 2.5 of it, less the error of the bricks themselves.
    for case in json.loads(SAVED.read_text(encoding="utf-8"))["cases"]:
        error, bricks, rule = (
            np.sqrt(np.mean([m[key] ** 2 for m in case["modes"]]))
            for key in ("difference_percent", "bricks_error_percent", "rule_percent")
        )
        assert error - bricks < 2.5 * rule, case["case"]
        assert error + bricks + 0.01 > rule / 2.5, case["case"]


def test_saved_rule_is_the_rule() -> None:
    cases = json.loads(SAVED.read_text(encoding="utf-8"))["cases"]
    (case,) = (c for c in cases if c["case"] == "carbon, quasi-isotropic, FFFF, h/b = 1/50")
    f = [m["ritz_hz"] for m in case["modes"]]
    rule = [m["rule_percent"] / 100 for m in case["modes"]]
    assert_allclose(theory_error(carbon("[0/45/-45/90]_s"), f), rule, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.needs_ccx
def test_free_edges_of_turned_plies_are_softer_in_three_dimensions() -> None:
    plate = carbon("[0/45/-45/90]_s", thickness_mm=7.2)
    ritz = cb.forward(plate, 4).frequencies
    bricks = solve_modes(plate, reference_constants(plate), 4, in_plane=100).frequencies
    difference = ritz / bricks - 1.0
    assert np.all(difference > 0.0)
    # a mesh of 100 elements in the plane is within 0.05 % in these modes
    assert difference.max() == pytest.approx(0.8e-2, abs=0.05e-2)


@pytest.mark.parametrize("name", ["C1", pytest.param("A2", marks=pytest.mark.slow)])
def test_the_shift_is_that_of_converged_frequencies_in_air(name):
    specimen = builtin(name)
    in_vacuum, in_air = (
        converged_model(replace(specimen, air_density=rho), NO_PARAMETERS, 4).predict([[]]).frequencies[0]
        for rho in (None, ROOM_AIR)
    )
    # both spaces are good to 1e-4 of a frequency, and the ratio to far less
    assert air_shifts(specimen, 4) == pytest.approx(in_air / in_vacuum - 1.0, abs=2e-5)


def test_air_lowers_bending_and_leaves_in_plane_modes_alone():
    shifts = air_shifts(builtin("D3"), 5)
    # the fifth mode of D3 moves in its plane
    assert (shifts[:4] < -1e-3).all()
    assert abs(shifts[4]) < 1e-5


def test_the_head_of_a_screen_says_what_air_is_in_the_model_or_would_change():
    specimen = builtin("C1")
    assert air_text(specimen, air_shifts(specimen)) == (
        "not in the model; 1.2 kg/m3 would lower the first 6 frequencies by 0.40 to 0.63 %"
    )
    in_air = replace(specimen, air_density=1.15)
    assert air_text(in_air, air_shifts(in_air)) == "1.15 kg/m3, in the model"
    unknown = replace(builtin("F1"), measurement=None)
    assert air_text(unknown, air_shifts(unknown)).startswith("not in the model")
