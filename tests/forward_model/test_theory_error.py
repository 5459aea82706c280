"""Errors of the model: three dimensions beside first-order theory, by rule and on bricks, and air."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import cpam_bayes as cb
from cpam_bayes.forward_model import model as plate_model
from cpam_bayes.forward_model import three_dimensions as rule
from cpam_bayes.forward_model.build import reduced_model
from cpam_bayes.forward_model.calculix.run import solve_modes
from cpam_bayes.forward_model.known_errors import common_sd
from cpam_bayes.forward_model.model import air_shifts, converged_model, reference_constants
from cpam_bayes.forward_model.three_dimensions import THEORY_LEVEL, THEORY_SHEAR, theory_bias, theory_error
from cpam_bayes.mechanics.problem import THEORY_ALONE
from cpam_bayes.plate import Specimen, builtin, to_user, user_name
from cpam_bayes.render.plate import air_text
from tests.hybrids import hybrid
from tests.plate_file import described

RESULTS = Path(__file__).parents[2] / "studies" / "results" / "16_theory_error.json"
SAVED = json.loads(RESULTS.read_text(encoding="utf-8"))
CARBON = {"isotropic": False, "E1_GPa": 130.0, "E2_GPa": 9.0, "nu12": 0.3, "G12_GPa": 5.0}
UNKNOWNS = {"E1_GPa": [90.0, 170.0], "E2_GPa": [6.0, 12.0], "nu12": [0.1, 0.5], "G12_GPa": [3.0, 7.0]}


def carbon(layup: str, edges: str = "FFFF", thickness_mm: float = 3.6, **tables: Any) -> Specimen:
    size = 240.0, 180.0, thickness_mm
    return cb.read_plate(described(size, 1580.0, CARBON, layup=layup, edges=edges, **tables))


def test_alike_plies_have_no_stress_at_a_free_edge_others_turn_and_unknown_ones_are_refused() -> None:
    for layup in ("[0]", "[30_4]", "[90]"):
        assert max(rule.edge_layer(carbon(layup), axis) for axis in (0, 1)) < 1e-12
    here, turned = carbon("[0/30/-60/90]"), carbon("[90/-60/30/0]")
    assert rule.edge_layer(here, 0) == pytest.approx(rule.edge_layer(turned, 1), rel=1e-9)
    with pytest.raises(ValueError, match="known layup"):
        theory_error(carbon("[?/90]_s"), [100.0])


@pytest.mark.parametrize(
    ("layup", "middle_mm", "tolerance"),
    # one ply in place of two has half the points, for an integral that is of first order in them
    [("[a0/b45_2/a90]_s", 0.5, 1e-9), ("[a0/b45/a90]_s", 1.0, 0.01)],
)
def test_plies_of_two_equal_materials_have_the_error_of_one(layup: str, middle_mm: float, tolerance) -> None:
    plain = carbon("[0/45_2/90]_s", thickness_mm=4.0)
    both = hybrid(length_mm=240.0, width_mm=180.0, thickness_mm=4.0, layup=layup)
    plies = (("a", 0.5), ("b", middle_mm))
    both["ply"] = [{"name": name, "material": name, "thickness_mm": t} for name, t in plies]
    of_carbon = {key: value for key, value in CARBON.items() if key != "isotropic"}
    both["material"] = dict.fromkeys("ab", of_carbon | {"density_kg_m3": 1580.0})
    of_two, f = cb.read_plate(both), [300.0, 900.0]
    assert_allclose(rule.edge_layer(of_two, 0), rule.edge_layer(plain, 0), rtol=tolerance)
    assert_allclose(theory_error(of_two, f), theory_error(plain, f), rtol=tolerance)


def saved_cases() -> list[dict[str, Any]]:
    # bricks of thin plates clamped all round are not accurate enough for a comparison
    return [c for c in SAVED["cases"] if max(m["bricks_error_percent"] for m in c["modes"]) < 0.15]


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def test_the_rule_takes_the_bias_of_shear_off_and_states_what_it_leaves() -> None:
    taken = []
    for case in saved_cases():
        columns = ("difference_percent", "rule_percent", "bricks_error_percent", "bias_percent")
        off, rule, of_bricks, bias = np.array([[m[key] for key in columns] for m in case["modes"]]).T
        left = rms(off - bias)
        assert left < 3.0 * np.hypot(rms(rule), rms(of_bricks)), case["case"]
        if rms(off) > 0.05 and case["layup"] in ("[0/90]_2s", "[0]") and case["edges"] == "FFFF":
            taken.append(left < 0.8 * rms(off))
    assert len(taken) > 7
    assert np.mean(taken) > 0.8


def test_the_bias_is_what_bricks_show_and_free_edges_lower_all_modes_within_their_common_error() -> None:
    for layup in ("[0/90]_2s", "[0]"):
        measured, predicted, _ = mean_shift(layup)
        assert measured > 1e-4
        assert predicted == pytest.approx(measured, rel=0.5)
    for layup in ("[0/45/-45/90]_s", "[45/-45]_2s"):
        measured, predicted, level = mean_shift(layup)
        assert -2.0 * level < measured - predicted < -0.3 * level


def mean_shift(layup: str) -> tuple[float, float, float]:
    """Mean ln f of bricks minus theory, the rule's bias, and its error common to all modes."""
    of_layup = [c for c in saved_cases() if c["layup"] == layup and "carbon" in c["case"]]
    (case,) = (c for c in of_layup if c["edges"] == "FFFF" and "h/b = 1/25" in c["case"])
    plate, f = carbon(layup, thickness_mm=7.2), np.array([m["ritz_hz"] for m in case["modes"]])
    measured = float(np.mean(np.log([m["bricks_hz"] / m["ritz_hz"] for m in case["modes"]])))
    predicted = float(np.mean(np.log(theory_bias(plate).of(f) / f)))
    return measured, predicted, rule.common_theory_errors(plate)[THEORY_LEVEL]


def test_the_coefficients_are_those_that_the_study_fits() -> None:
    (case,) = (c for c in SAVED["cases"] if c["case"] == "carbon, quasi-isotropic, CFFF, h/b = 1/25")
    shear, free, clamps, *scatter = SAVED["fit"]["coefficients"]
    plate = carbon("[0/45/-45/90]_s", "CFFF", 7.2)
    f = np.array([m["ritz_hz"] for m in case["modes"]])
    w, edges = rule.shear_frequency(plate, f), np.array(rule.edge_sums(plate))
    bias, common = theory_bias(plate), rule.common_theory_errors(plate)
    assert bias.slope == pytest.approx(shear * w[0] / f[0], rel=0.02)
    assert common[THEORY_SHEAR] == pytest.approx(500.0 * bias.slope, rel=1e-12)
    assert common[THEORY_LEVEL] == pytest.approx(np.hypot(*([free, clamps] * edges)), rel=0.03)
    of_edges, of_shear = np.hypot(*(scatter[1:] * edges)), common[THEORY_SHEAR] * f / 1000.0
    assert_allclose(theory_error(plate, f), np.sqrt(1e-8 + (scatter[0] * w) ** 2 + of_edges**2), rtol=0.02)
    every = np.sqrt(theory_error(plate, f) ** 2 + common[THEORY_LEVEL] ** 2 + of_shear**2)
    assert_allclose([0.01 * m["bias_percent"] for m in case["modes"]], f / bias.of(f) - 1.0, rtol=1e-9)
    assert_allclose([0.01 * m["rule_percent"] for m in case["modes"]], every, rtol=1e-9)


def test_predictions_and_their_slopes_have_the_bias() -> None:
    plate = carbon("[0/45/-45/90]_s", unknowns=UNKNOWNS)
    bias = theory_bias(plate)
    theory, model = (reduced_model(plate, plate.unknowns, 6, bias=b) for b in (THEORY_ALONE, bias))
    x = plate_model.reference_vector(plate, plate.unknowns)[None]
    found = model.predict(x, jacobian=True)
    assert_allclose(found.frequencies, bias.of(theory.predict(x).frequencies), rtol=1e-12)
    assert_allclose([m.frequency for m in model.full.modes(x[0])], found.frequencies[0], rtol=2e-4)
    for i, each in enumerate(x[0] * 1e-4):
        step = each * np.eye(x.shape[1])[i]
        after, before = model.predict(x + step).frequencies[0], model.predict(x - step).frequencies[0]
        assert_allclose(found.jacobian[0, :, i], (after - before) / (2 * each), rtol=1e-4)


def test_what_errs_in_common_has_a_name_where_parameters_are_shown() -> None:
    common = common_sd(carbon("[0/45/-45/90]_s", "CFFF"))
    assert {THEORY_SHEAR, THEORY_LEVEL} < set(common)
    assert [user_name(name) for name in (THEORY_SHEAR, THEORY_LEVEL)] == ["theory_shear", "theory_level"]
    assert all(to_user(name, 1.0) > 0.0 for name in common)


@pytest.mark.slow
def test_constants_of_a_plate_in_three_dimensions_are_not_biased() -> None:
    # bricks of a quasi-isotropic plate of 7.2 mm, whose free edges lower frequencies by 0.1 to 0.9 %
    (case,) = (c for c in saved_cases() if c["case"] == "carbon, quasi-isotropic, FFFF, h/b = 1/25")
    measured = {"frequencies_hz": [m["bricks_hz"] for m in case["modes"]], "relative_std": 0.0005}
    plate = carbon("[0/45/-45/90]_s", thickness_mm=7.2, unknowns=UNKNOWNS, measurement=measured)
    exact = dict.fromkeys(plate.plate.sizes, 0.0)
    found = cb.identify(replace(plate, plate=replace(plate.plate, sd=exact))).constants
    assert found["E1"].value == pytest.approx(130e9, rel=0.01)
    low, high = found["E1"].interval
    assert low < 130e9 < high


@pytest.mark.slow
@pytest.mark.weekly
@pytest.mark.needs_ccx
def test_free_edges_of_turned_plies_are_softer_in_three_dimensions() -> None:
    plate = carbon("[0/45/-45/90]_s", thickness_mm=7.2)
    ritz = cb.forward(plate, 4).frequencies
    difference = ritz / solve_modes(plate, reference_constants(plate), 4, in_plane=100).frequencies - 1.0
    assert np.all(difference > 0.0)
    assert difference.max() == pytest.approx(0.8e-2, abs=0.05e-2)  # 100 elements: accurate to 0.05 %


@pytest.mark.parametrize("name", ["C1", pytest.param("A2", marks=pytest.mark.slow)])
def test_the_shift_is_that_of_converged_frequencies_in_air(name):
    specimen = builtin(name)
    both = (replace(specimen, air_density=rho) for rho in (None, plate_model.ROOM_AIR))
    models = (converged_model(one, plate_model.NO_PARAMETERS, 4) for one in both)
    in_vacuum, in_air = (model.predict([[]]).frequencies[0] for model in models)
    # both spaces are accurate to 1e-4 of a frequency, and far better in the ratio
    assert air_shifts(specimen)[:4] == pytest.approx(in_air / in_vacuum - 1.0, abs=2e-5)


def test_air_lowers_bending_and_leaves_in_plane_modes_alone():
    shifts = air_shifts(builtin("D3"))
    assert (shifts[:4] < -1e-3).all()  # the fifth mode of D3 is in-plane
    assert abs(shifts[4]) < 1e-5


def test_the_head_of_a_screen_says_what_air_is_in_the_model_or_would_change():
    specimen = builtin("C1")
    would_lower = "1.2 kg/m3 would lower the first 6 frequencies by 0.40 to 0.63 %"
    assert air_text(specimen, air_shifts(specimen)) == f"not in the model; {would_lower}"
    in_air = replace(specimen, air_density=1.15)
    assert air_text(in_air, air_shifts(in_air)) == "1.15 kg/m3, in the model"
    unknown = replace(builtin("F1"), measurement=None)
    assert air_text(unknown, air_shifts(unknown)).startswith("not in the model")
