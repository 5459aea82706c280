"""Log probability against densities written down by hand, on a model that is linear."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.stats import norm, t

from cpam_bayes.measurement import Measurement
from cpam_bayes.model import Prediction
from cpam_bayes.parameters import Parameter, ParameterSet, Uniform
from cpam_bayes.posterior import NOISE, NOISE_PRIOR, Posterior, plate_posterior
from tests.linear_model import LinearModel, measurement


def test_gaussian_log_probability_is_the_sum_of_its_parts() -> None:
    model = LinearModel()
    data = measurement(relative_std=0.01, resolution=1.0)
    error = np.array([1e-3, 2e-3, 1e-3, 3e-3])
    posterior = plate_posterior(model, data, error)
    x = np.array([0.3, -0.2])
    f = model.predict(x[None]).frequencies[0]
    sigma = np.sqrt((0.01 * data.frequencies) ** 2 + 1 / 12 + (error * f) ** 2)
    expected = norm.logpdf(data.frequencies, f, sigma).sum() - 2 * np.log(4.0)
    assert posterior.log_prob(x)[0] == pytest.approx(expected, abs=1e-12)


def test_student_t_noise_has_its_density() -> None:
    model, data = LinearModel(), measurement(relative_std=0.01)
    posterior = plate_posterior(model, data, np.zeros(4), degrees_of_freedom=4.0)
    x = np.array([[0.5, 0.5]])
    f = model.predict(x).frequencies[0]
    expected = t.logpdf(data.frequencies, 4.0, f, 0.01 * data.frequencies).sum()
    assert posterior.log_likelihood(x)[0] == pytest.approx(expected, abs=1e-12)


def test_noise_that_the_file_leaves_out_is_a_parameter_with_a_prior() -> None:
    posterior = plate_posterior(LinearModel(), measurement(relative_std=None), np.zeros(4))
    assert posterior.parameters.names == ("a", "b", NOISE)
    x = np.array([[0.1, 0.2, 0.02]])
    f = LinearModel().predict(x[:, :2]).frequencies[0]
    listed = posterior.measurement.frequencies
    expected = norm.logpdf(listed, f, 0.02 * listed).sum()
    expected += NOISE_PRIOR.log_density(0.02) - 2 * np.log(4.0)
    assert posterior.log_prob(x)[0] == pytest.approx(float(expected), abs=1e-12)


def test_outside_the_support_the_model_is_not_asked_and_the_density_is_zero() -> None:
    @dataclass(frozen=True)
    class Watched(LinearModel):
        def predict(self, x: np.ndarray, *, jacobian: bool = False) -> Prediction:
            assert np.all(np.abs(x) <= 2.0)
            assert np.all(self.admissible(x))
            return super().predict(x, jacobian=jacobian)

        def admissible(self, x: np.ndarray) -> np.ndarray:
            return np.asarray(x.sum(axis=-1) < 2.5)

    posterior = plate_posterior(Watched(), measurement(relative_std=0.01), np.zeros(4))
    found = posterior.log_prob(np.array([[0.0, 0.0], [9.0, 0.0], [1.9, 1.9], [np.nan, 0.0]]))
    assert np.isfinite(found[0])
    np.testing.assert_array_equal(found[1:], -np.inf)


def test_a_complete_list_without_its_third_mode_is_far_less_probable_than_an_incomplete_one() -> None:
    model = LinearModel()
    truth = model.predict(np.zeros((1, 2))).frequencies[0]
    kept = np.delete(truth, 2)
    gaps = Measurement(kept, 0.0, 0.005, None, ("",) * 3, complete=False)
    full = Measurement(kept, 0.0, 0.005, None, ("",) * 3, complete=True)
    error = np.zeros(4)
    x = np.zeros((1, 2))
    assert plate_posterior(model, gaps, error).log_likelihood(x) > -20.0
    assert Posterior(model, full, model.parameters, error).log_likelihood(x) < -1000.0


def test_parameters_of_the_model_keep_their_order() -> None:
    assert LinearModel().parameters == ParameterSet(
        (Parameter("a", "", Uniform(-2.0, 2.0)), Parameter("b", "", Uniform(-2.0, 2.0)))
    )
