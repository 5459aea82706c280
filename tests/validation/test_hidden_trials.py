"""Trials that hide something in a list simulated by finite elements, and what is counted of them."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from cpam_bayes.validation.diagnosis.oracle import oracle
from cpam_bayes.validation.diagnosis.trial_statistics import calibration_error, figures
from cpam_bayes.validation.diagnosis.trials import Record, Trial, is_right, run_trial
from cpam_bayes.validation.diagnosis.truths import (
    Bench,
    at_random_place,
    bench,
    linear,
    random_constants,
    size_for,
    true_frequencies,
    variants_of_cause,
)

NOISE, RESOLUTION = 0.002, 0.1
CLAIMS = {"named", "class", "pair", "other"}
# One of a family each: mass, shape of first and of second order, stress, list.
FAMILIES = ("sensor_mass", "warp", "taper_y", "membrane_stress", "outlier")

pytestmark = pytest.mark.slow


@lru_cache
def thin() -> Bench:
    """C1 with ten modes in its list, and the models of all that it may have."""
    return bench("C1", 10, noise=NOISE, resolution=RESOLUTION)


@lru_cache
def record(trial: Trial) -> Record:
    return run_trial(thin(), trial)


def constants() -> np.ndarray:
    return random_constants(thin(), 0.1, np.random.default_rng(3))


def test_elements_of_another_mesh_agree_with_the_model_where_nothing_is_hidden() -> None:
    x = constants()
    found = true_frequencies(thin(), (), x, np.empty(0), 10)
    # a tenth of the noise would be 2e-4
    np.testing.assert_allclose(found, np.exp(linear(thin(), x).log_f[:10]), rtol=2e-4)


@pytest.mark.parametrize("cause", ["sensor_mass", "warp", "misorientation", "membrane_stress"])
def test_elements_and_model_agree_about_an_effect_of_eight_times_the_noise(cause: str) -> None:
    at = linear(thin(), constants())
    h = at_random_place(variants_of_cause(thin(), cause)[0], np.random.default_rng(5))
    sizes = np.array([size_for(at, h, 8.0, 1.0).size])
    found = np.log(true_frequencies(thin(), (h,), at.x, sizes, 10))
    # a quarter of the noise in any mode is 5e-4; what is hidden is sixteen times as much
    np.testing.assert_allclose(found, at.log_f[:10] + NOISE * at.shift(h, sizes)[0], rtol=0, atol=3e-4)


def test_a_size_has_the_signal_to_noise_ratio_that_was_asked_for() -> None:
    at = linear(thin(), constants())
    for cause in ("sensor_mass", "warp", "taper_y", "outlier"):
        for variant in variants_of_cause(thin(), cause)[:2]:
            h = at_random_place(variant, np.random.default_rng(5))
            size = size_for(at, h, 8.0, 1.0).size
            # 97 sizes between which the ratio is taken as linear
            assert np.linalg.norm(at.visible(h, np.array([size]))) == pytest.approx(8.0, rel=0.02)


def test_constants_far_from_the_reference_are_another_material_and_nothing_overflows() -> None:
    found = record(Trial("one", ("material",)))
    assert found["answer"]["claimed"] == ["material"]
    assert linear(thin(), np.full(4, 0.9) * thin().case.models.parameters.upper).root.max() <= 1.0


def test_a_list_that_says_which_mode_it_lacks_is_diagnosed_like_any_other() -> None:
    found = record(Trial("one", ("sensor_mass",), 8.0, lacks=True))
    assert "sensor_mass" in found["answer"]["class"]


def test_what_the_constants_imitate_is_not_seen() -> None:
    at = linear(thin(), constants())
    (h,) = variants_of_cause(thin(), "frequency_scale")
    found = size_for(at, h, 4.0, 1.0)
    assert not found.usable
    assert found.share < 0.1  # every modulus up by twice as much does the same


def test_the_oracle_is_sure_of_the_truth_without_noise_and_of_none_without_a_shift() -> None:
    at = linear(thin(), constants())
    h = variants_of_cause(thin(), "warp")[0]
    shift = at.shift(h, np.array([size_for(at, h, 8.0, 1.0).size]))[0]
    found = oracle(at, shift, np.zeros(10))
    assert next(iter(found.probability)) == "warp"
    assert "warp" in found.alike
    assert next(iter(oracle(at, np.zeros(10), np.zeros(10)).probability)) == "none"


@pytest.mark.parametrize("number", range(3))
def test_nothing_is_claimed_of_a_clean_plate(number: int) -> None:
    answer = record(Trial("clean", number=number))["answer"]
    assert answer["claim"] not in CLAIMS


@pytest.mark.parametrize("cause", FAMILIES)
def test_the_class_of_a_hidden_cause_is_the_most_probable(cause: str) -> None:
    found = record(Trial("one", (cause,), 8.0))
    assert found["reached"]
    assert is_right(found)
    assert found["answer"]["none"] < 0.01


def test_a_cause_that_the_dictionary_lacks_is_not_replaced_by_a_wrong_one() -> None:
    found = record(Trial("outside", ("warp",), 8.0))
    answer = found["answer"]
    assert not is_right(found)  # what is missing cannot lead: the test of the others can fail
    assert answer["claim"] in {"none", "undecided", "other"}
    assert max(p for name, _, p, _ in answer["causes"] if " + " not in name) < 0.9


def test_a_trial_is_repeated_by_its_name_alone() -> None:
    trial = Trial("clean", number=0)
    first, again = record(trial), run_trial(thin(), replace(trial))
    assert {k: v for k, v in first.items() if "seconds" not in k} == {
        k: v for k, v in again.items() if "seconds" not in k
    }


def _predicted(probability: float, right: bool) -> Record:
    answer = {
        "none": 0.0,
        "other": 0.0,
        "class": ["warp" if right else "skew"],
        "class_probability": probability,
        "pair": [],
        "pair_probability": 0.0,
    }
    return {"answer": answer, "causes": ["warp"]}


def test_the_calibration_error_is_the_distance_of_probability_and_frequency() -> None:
    calibrated = [_predicted(0.75, i % 4 > 0) for i in range(400)]
    boasting = [_predicted(0.95, i % 2 > 0) for i in range(400)]
    assert calibration_error(calibrated)[0] == pytest.approx(0.0, abs=1e-12)
    assert calibration_error(boasting)[0] == pytest.approx(0.45)


def test_figures_are_there_with_the_number_of_their_trials() -> None:
    records = {"C1, 10 modes": [record(Trial("clean", number=i)) for i in range(2)]}
    found = {f["name"]: f for f in figures(records)}
    assert found["false claim on clean data"]["n"] == 2
    assert found["false claim on clean data"]["value"] == 0.0
    assert found["class right, signal to noise 8, ten modes"]["value"] is None
