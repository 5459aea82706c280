"""Identification by sampling, on an aluminium plate whose constants are known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray

from cpam_bayes.answer import Verdict
from cpam_bayes.forward_model.model import converged_model
from cpam_bayes.inference.ensemble import EnsembleSettings
from cpam_bayes.plate import Specimen
from cpam_bayes.questions.identify.emcee import SampledResult, sample
from tests.identification.test_starting import NOISE, known

SETTINGS = EnsembleSettings(walkers=24, round_steps=500, effective=500.0)


@pytest.fixture(scope="module")
def known_plate() -> Specimen:
    return known("A1", {})


@pytest.fixture(scope="module")
def sampled(known_plate: Specimen) -> SampledResult:
    return sample(known_plate, seed=0, settings=SETTINGS)


def test_true_constants_lie_well_inside_their_intervals(sampled: SampledResult) -> None:
    assert sampled.result.status == "converged"
    for constant in sampled.constants.values():
        # data without noise: the posterior is centred on the truth but for its skewness
        assert abs(constant.value - constant.reference) < 0.5 * constant.sd
        assert constant.interval[0] < constant.reference < constant.interval[1]
        assert constant.verdict is Verdict.DATA


def test_spread_is_what_the_jacobian_and_the_noise_give(
    known_plate: Specimen, sampled: SampledResult
) -> None:
    model = converged_model(known_plate, known_plate.unknowns, 6)
    x = np.array([[c.reference for c in sampled.constants.values()]])
    prediction = model.predict(x, jacobian=True)
    weighted = prediction.jacobian[0] / (NOISE * prediction.frequencies[0])[:, None]
    expected = np.sqrt(np.diag(np.linalg.inv(weighted.T @ weighted)))
    # 500 effective samples give an sd to 3 %; the model is linear over these spreads to about 2 %
    np.testing.assert_allclose([c.sd for c in sampled.constants.values()], expected, rtol=0.12)


def test_predictive_p_value_of_noise_free_data_is_that_of_two_chi_squares(
    sampled: SampledResult,
) -> None:
    # at a draw the data are chi2_2 away (two constants), a replicate list chi2_6 (six frequencies):
    # P(chi2_6 > chi2_2) = 1 - E[exp(-G)] = 1 - (1/2)^3 with G = chi2_6 / 2 a Gamma(3) variable;
    # 1000 draws of which at least 500 are effective give it to 0.015
    assert sampled.p_value == pytest.approx(0.875, abs=0.05)


@pytest.mark.slow
def test_a_wrong_model_has_a_low_predictive_p_value(known_plate: Specimen) -> None:
    f = known_plate.measurement.frequencies * np.array([1.0, 1.02, 0.98, 1.02, 0.98, 1.02])
    wrong = replace(known_plate, measurement=replace(known_plate.measurement, frequencies=np.sort(f)))
    found = sample(wrong, seed=0, settings=SETTINGS)
    assert found.p_value < 0.01


@pytest.mark.slow
def test_a_list_without_its_third_mode_is_paired_around_the_gap(known_plate: Specimen) -> None:
    assert known_plate.measurement is not None
    own = known_plate.measurement
    gap = replace(own, frequencies=np.delete(own.frequencies, 2), labels=("",) * 5, complete=False)
    found = sample(replace(known_plate, measurement=gap), seed=0, settings=SETTINGS)
    np.testing.assert_array_equal(found.pairing.mode, [0, 1, 3, 4, 5])
    np.testing.assert_array_equal(found.pairing.missed, [2])
    for constant in found.constants.values():
        assert constant.interval[0] < constant.reference < constant.interval[1]


def test_the_posterior_file_opens_in_plain_arviz(tmp_path: Path, sampled: SampledResult) -> None:
    sampled.save(tmp_path)
    data = xarray.open_datatree(str(tmp_path / "posterior.nc"))
    groups = {"posterior", "log_likelihood", "log_prior", "posterior_predictive", "observed_data"}
    assert groups <= set(data.children)
    assert data.log_likelihood["frequencies_hz"].dims == ("chain", "draw", "mode")
    assert data.posterior["E1_GPa"].mean().item() == pytest.approx(69.0, abs=0.5)
    pointwise = data.log_likelihood["frequencies_hz"].sum("mode")
    prior = data["log_prior"].to_dataset().to_dataarray().sum("variable")
    difference = data.sample_stats["lp"] - pointwise - prior
    np.testing.assert_allclose(difference, 0.0, atol=1e-8)
