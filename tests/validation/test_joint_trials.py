"""Plates diagnosed together: sisters without the flaw, further tests of the plate with it."""

import numpy as np
import pytest

from cpam_bayes.validation.diagnosis.hiding import Hidden, Trial, hide
from cpam_bayes.validation.diagnosis.joint_trials import Laboratory, _simulated, laboratory, run_joint_trial
from cpam_bayes.validation.diagnosis.truths import true_frequencies

TRIAL = Trial("one", ("warp",), 8.0)


@pytest.fixture(scope="module")
def own() -> Laboratory:
    return laboratory("C1", 6, noise=0.002, resolution=0.1, tests=())


@pytest.fixture(scope="module")
def hidden(own: Laboratory) -> Hidden:
    found = hide(own.alone, TRIAL, TRIAL.rng(own.alone))
    assert isinstance(found, Hidden)
    return found


@pytest.mark.slow
def test_a_sister_is_another_specimen_of_the_same_material(own: Laboratory) -> None:
    specimens = [b.case.models.specimen for b in (own.alone, *own.sisters)]
    assert len({s.specimen for s in specimens}) == 3
    assert len({s.material.name for s in specimens}) == 1
    assert own.setups == ("alone", "one sister", "two sisters")


@pytest.mark.slow
def test_a_sister_lacks_the_flaw_and_another_test_of_the_plate_has_it(
    own: Laboratory, hidden: Hidden
) -> None:
    quiet = np.random.default_rng(0)
    clean = true_frequencies(own.alone, (), hidden.at.x, np.empty(0), 6)
    flawed = true_frequencies(own.alone, hidden.causes, hidden.at.x, hidden.sizes, 6)
    assert np.abs(flawed / clean - 1.0).max() > 0.005
    lists = [
        _simulated(own.alone, hidden, is_same, hidden.at.x, quiet).measurement.frequencies
        for is_same in (False, True)
    ]
    # five standard deviations of the noise, and rounding
    np.testing.assert_allclose(lists[0], clean, rtol=0.01, atol=0.1)
    np.testing.assert_allclose(lists[1], flawed, rtol=0.01, atol=0.1)
    assert np.linalg.norm(lists[1] / flawed - 1.0) < np.linalg.norm(lists[1] / clean - 1.0)


@pytest.mark.slow
def test_two_sisters_make_a_hidden_cause_more_probable(own: Laboratory) -> None:
    record = run_joint_trial(own, TRIAL)
    alone, with_two = (record["setups"][name] for name in ("alone", "two sisters"))
    assert record["causes"] == ["warp"]
    assert with_two["cause_probability"] > alone["cause_probability"]
    assert with_two["leads"]
    assert np.mean(np.log(with_two["relative_sd"])) < np.mean(np.log(alone["relative_sd"]))


def test_an_unknown_further_test_is_refused() -> None:
    with pytest.raises(KeyError):
        laboratory("C1", 6, noise=0.002, resolution=0.1, tests=("hung upside down",))
