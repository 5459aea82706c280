"""Scale and shape of the noise, each by itself and together, against scipy's densities."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm, t

from cpam_bayes.inference.noise import NOISE_PRIOR, Likelihood, noise_model
from cpam_bayes.inference.posterior import plate_posterior
from cpam_bayes.parameters import Parameter
from tests.linear_model import LinearModel, measurement

NONE = np.zeros(4)
X = np.array([[0.3, -0.2]])


def log_likelihood(likelihood: Likelihood, nu: float, amplitude: float) -> float:
    posterior = plate_posterior(
        LinearModel(), measurement(None), NONE, likelihood=likelihood, degrees_of_freedom=nu
    )
    return float(posterior.log_likelihood(np.column_stack((X, [amplitude])))[0])


@pytest.mark.parametrize("nu", [np.inf, 4.0])
@pytest.mark.parametrize(("likelihood", "amplitude"), [("relative", 0.004), ("absolute", 1.3)])
def test_every_scale_has_every_shape(likelihood: Likelihood, amplitude: float, nu: float) -> None:
    listed = measurement(None).frequencies
    f = LinearModel().predict(X).frequencies[0]
    sd = amplitude * (listed if likelihood == "relative" else 1.0)
    expected = norm.logpdf(listed, f, sd) if np.isinf(nu) else t.logpdf(listed, nu, f, sd)
    assert log_likelihood(likelihood, nu, amplitude) == pytest.approx(expected.sum(), abs=1e-12)


def test_absolute_noise_of_known_size_is_half_of_f_of_eq_7_over_its_variance() -> None:
    posterior = plate_posterior(LinearModel(), measurement(None), NONE, likelihood="absolute")
    x = np.array([[0.3, -0.2, 2.0], [1.0, 0.4, 2.0]])
    misfit = np.sum(
        (LinearModel().predict(x[:, :2]).frequencies - measurement(None).frequencies) ** 2, axis=1
    )
    difference = np.diff(posterior.log_likelihood(x))[0]
    assert difference == pytest.approx(-np.diff(misfit)[0] / (2 * 2.0**2), rel=1e-12)


def test_rounding_and_the_solver_add_to_both_scales() -> None:
    data, error = measurement(None, resolution=2.0), np.array([0.0, 1e-3, 2e-3, 0.0])
    predicted = np.array([[100.0, 210.0, 290.0, 400.0]])
    for likelihood, own in (("relative", 0.01 * data.frequencies), ("absolute", np.full(4, 0.01))):
        found = noise_model(data, error, likelihood).sd(np.array([0.01]), predicted)[0]  # type: ignore[arg-type]
        expected = np.sqrt(own[:, None] ** 2 + 4.0 / 12 + (error * predicted[0])[None, :] ** 2)
        np.testing.assert_allclose(found, expected, rtol=1e-14)


def test_priors_of_both_amplitudes_are_one_at_the_root_mean_square_frequency() -> None:
    data = measurement(None)
    relative, absolute = (noise_model(data, NONE, scale).parameter for scale in ("relative", "absolute"))
    assert isinstance(relative, Parameter)
    assert isinstance(absolute, Parameter)
    assert (relative.name, relative.prior) == ("relative_std", NOISE_PRIOR)
    assert (absolute.name, absolute.unit) == ("absolute_sd", "Hz")
    rms = np.sqrt(np.mean(data.frequencies**2))
    s = np.array([1e-4, 0.01, 0.1])
    np.testing.assert_allclose(
        absolute.prior.log_density(s * rms) + np.log(rms), relative.prior.log_density(s), rtol=1e-12
    )


def test_standard_deviations_of_the_file_overrule_its_relative_one() -> None:
    sd = np.array([0.1, 0.2, 0.3, 0.4])
    data = replace(measurement(0.01), frequency_sd=sd)
    model = noise_model(data, NONE)
    assert model.parameter is None
    found = model.sd(np.array([model.amplitude]), np.ones((1, 4)))[0]
    np.testing.assert_allclose(found, np.tile(sd[:, None], 4), rtol=1e-15)


@pytest.mark.parametrize("key", ["relative_std", "frequency_sd_hz"])
def test_a_repeatability_of_the_file_and_the_absolute_likelihood_exclude_each_other(key: str) -> None:
    data = measurement(0.01)
    if key == "frequency_sd_hz":
        data = replace(data, frequency_sd=np.ones(4))
    with pytest.raises(ValueError, match=f"measurement.{key}.*leave {key} out"):
        noise_model(data, NONE, "absolute")


@pytest.mark.parametrize("nu", [2.0, 0.0, -1.0, np.nan])
def test_noise_without_a_variance_is_refused(nu: float) -> None:
    with pytest.raises(ValueError, match="degrees of freedom of the noise"):
        noise_model(measurement(0.01), NONE, degrees_of_freedom=nu)


@pytest.mark.parametrize(("nu", "edge"), [(np.inf, norm.ppf(0.9)), (4.0, t.ppf(0.9, 4))])
def test_replicates_are_drawn_from_the_density(nu: float, edge: float) -> None:
    model = noise_model(measurement(0.01), NONE, degrees_of_freedom=nu)
    beyond = np.mean(model.sample(np.random.default_rng(0), (100, 100)) > edge)
    # four binomial standard errors of 10000 draws
    assert beyond == pytest.approx(0.1, abs=4 * np.sqrt(0.09 / 10_000))


def test_the_suggested_amplitude_is_that_of_the_residuals_within_the_prior() -> None:
    residuals = np.array([1.0, -2.0, 2.0, -1.0])
    data = measurement(None)
    assert noise_model(data, NONE, "absolute").suggested(residuals) == pytest.approx(np.sqrt(2.5))
    relative = noise_model(data, NONE)
    assert relative.suggested(residuals) == pytest.approx(
        np.sqrt(np.mean((residuals / data.frequencies) ** 2))
    )
    assert relative.suggested(np.zeros(4)) == 2 * NOISE_PRIOR.lower
    assert relative.suggested(1e6 * residuals) == 0.5 * NOISE_PRIOR.upper
