"""Several swarms, polished, and what is said of a constant then; identification by sampling."""

from dataclasses import replace

import numpy as np
import pytest

import cpam_bayes as cb
from cpam_bayes.answer import Verdict
from cpam_bayes.forward_model.model import converged_model
from cpam_bayes.identification import search as searching
from cpam_bayes.identification.search import Optimum, search
from cpam_bayes.inference.ensemble import EnsembleSettings
from cpam_bayes.plate.reader import builtin
from cpam_bayes.questions.identify.emcee import sample
from tests.identification.test_sizes import NOISE, known

# F, Hz^2, and E1, GPa, of the best optimum of B1, and of the one where a single swarm of seed 1 ends.
BEST_B1, WRONG_B1 = 13.062, 883.1


@pytest.mark.slow
def test_a_single_swarm_may_agree_on_a_wrong_optimum_and_several_do_not() -> None:
    one = cb.identify("B1", seed=1, swarms=1, residuals="absolute")
    assert one.status == "converged"
    assert one.estimate.swarm.value == pytest.approx(WRONG_B1, rel=1e-3)
    several = cb.identify("B1", seed=1, residuals="absolute")
    assert several.status == "converged"
    assert several.estimate.swarm.value == pytest.approx(BEST_B1, rel=1e-3)
    assert several.estimate.optima[0].swarms >= 2


def test_the_single_swarm_is_the_first_of_several_and_is_not_polished() -> None:
    one = search(builtin("A1"), 3, swarms=1)
    np.testing.assert_array_equal(one.optima[0].x, one.swarm.best)
    several = search(builtin("A1"), 3, swarms=12)
    np.testing.assert_array_equal(several.swarm.personal_bests, one.swarm.personal_bests)
    assert several.optima[0].value <= one.swarm.value
    with pytest.raises(ValueError, match="swarms: received 0, accepted: 1 or more"):
        cb.identify("A1", swarms=0)


def test_an_optimum_has_no_slope_where_no_bound_holds_it() -> None:
    found = search(builtin("C1"), 0, swarms=12)
    x = found.optima[0].x
    measurement, unknowns = searching.required(builtin("C1"))
    f = measurement.frequencies

    def value(at: np.ndarray) -> float:
        return float(searching.misfit(found.model.predict(at).frequencies[:, : len(f)], f, "absolute")[0])

    width = unknowns.upper - unknowns.lower
    free = (x > unknowns.lower + 1e-4 * width) & (x < unknowns.upper - 1e-4 * width)
    assert free.any()
    for i in np.flatnonzero(free):
        step = 1e-4 * width[i] * np.eye(len(x))[i]
        around = value(x + step), value(x - step)
        assert min(around) >= found.optima[0].value * (1.0 - 1e-9)
        # a central difference, beside the curvature over the same step
        assert abs(around[0] - around[1]) < 0.05 * (sum(around) - 2.0 * found.optima[0].value)


def test_a_budget_of_swarms_that_agree_on_nothing_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    def alone(*args: object) -> tuple[Optimum, ...]:
        return (Optimum(builtin("A1").unknowns.lower, 1.0, 1),)

    monkeypatch.setattr(searching, "_distinct", alone)
    found = search(builtin("A1"), 0, swarms=4)
    assert found.swarms == 4
    assert found.swarm.status == "budget"
    assert "there may be a better one" in found.swarm.message


def test_constants_that_differ_between_optima_are_not_determined() -> None:
    result = cb.identify("B2", seed=0, residuals="absolute")
    constants = {c.name: c for c in result.estimate.constants}
    assert len(result.optima) > 1
    # 53 GPa beside 110 GPa, of nearly one misfit
    assert constants["E1"].value / 1e9 == pytest.approx(53.2, rel=0.01)
    assert any(v / 1e9 == pytest.approx(109.9, rel=0.01) for v in constants["E1"].elsewhere)
    assert constants["E1"].verdict is not Verdict.DATA
    document = result.to_dict()
    assert [o["found_by"] for o in document["optima"]] == [o.swarms for o, _ in result.optima]
    assert [o["objective"] for o in document["optima"]] == sorted(o["objective"] for o in document["optima"])
    assert document["optima"][0]["rms_percent"] == pytest.approx(document["rms_percent"], rel=1e-3)
    assert "optima" in result.figures()


@pytest.mark.slow
def test_constants_of_a_model_that_misfits_the_stated_noise_are_not_determined() -> None:
    """C1's printed frequencies leave 1.3 % whatever the constants are."""
    c1 = builtin("C1")
    assert c1.measurement is not None
    believed = replace(c1, measurement=replace(c1.measurement, relative_std=0.001))
    point, inferred = (cb.identify(specimen).estimate for specimen in (believed, c1))
    assert point.rms > 8 * 0.001
    assert {c.verdict for c in point.constants} <= {Verdict.MISFIT, Verdict.PRIOR}
    assert point.constants[0].verdict is Verdict.MISFIT
    assert "determine none of the constants" in cb.identify(believed).summary()
    # whatever is stated, the misfit decides how wide the intervals are
    for stated, from_misfit in zip(point.constants, inferred.constants, strict=True):
        assert 0.5 < stated.sd / from_misfit.sd < 2.0


@pytest.mark.parametrize(("centre", "models"), [(None, 2), (builtin("A1").unknowns.upper, 1)])
def test_a_plate_model_is_converged_anew_where_that_helps_and_no_centre_was_given(
    monkeypatch: pytest.MonkeyPatch, centre: np.ndarray | None, models: int
) -> None:
    said: list[str] = []
    monkeypatch.setattr(searching, "discretisation_error", lambda full, x: np.full(full.n_modes, 1e-2))
    found = search(builtin("A1"), 0, swarms=12, centre=centre, notify=said.append)
    assert sum("converging the plate model there" in text for text in said) == models - 1
    if centre is not None:
        np.testing.assert_array_equal(found.centre, centre)


SETTINGS = EnsembleSettings(walkers=24, round_steps=500, effective=500.0)


@pytest.mark.slow
def test_of_exact_data_the_posterior_is_that_of_the_jacobian_about_the_truth_and_predicts_them() -> None:
    plate = known("A1", {})
    sampled = sample(plate, seed=0, settings=SETTINGS)
    assert sampled.result.status == "converged"
    constants = sampled.constants.values()
    for constant in constants:
        # data without noise: the posterior is centred on the truth but for its skewness
        assert abs(constant.value - constant.reference) < 0.5 * constant.sd
        assert constant.interval[0] < constant.reference < constant.interval[1]
        assert constant.verdict is Verdict.DATA
    truth = np.array([[c.reference for c in constants]])
    prediction = converged_model(plate, plate.unknowns, 6).predict(truth, jacobian=True)
    weighted = prediction.jacobian[0] / (NOISE * prediction.frequencies[0])[:, None]
    expected = np.sqrt(np.diag(np.linalg.inv(weighted.T @ weighted)))
    # 500 effective samples give an sd to 3 %; the model is linear over these spreads to about 2 %
    np.testing.assert_allclose([c.sd for c in constants], expected, rtol=0.12)
    # at a draw the data are chi2_2 away (two constants), a replicate list chi2_6 (six frequencies):
    # P(chi2_6 > chi2_2) = 1 - E[exp(-G)] = 1 - (1/2)^3 with G = chi2_6 / 2 a Gamma(3) variable;
    # 1000 draws of which at least 500 are effective give it to 0.015
    assert sampled.p_value == pytest.approx(0.875, abs=0.05)


@pytest.mark.slow
def test_a_wrong_model_has_a_low_predictive_p_value() -> None:
    plate = known("A1", {})
    f = plate.measurement.frequencies * np.array([1.0, 1.02, 0.98, 1.02, 0.98, 1.02])
    wrong = replace(plate, measurement=replace(plate.measurement, frequencies=np.sort(f)))
    found = sample(wrong, seed=0, settings=SETTINGS)
    assert found.p_value < 0.01
