"""Modes left out: closed forms against refits, importance sampling against closed forms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from cpam_bayes.identification.sampled import sample
from cpam_bayes.inference.chains.ensemble import EnsembleSettings
from cpam_bayes.inference.chains.sampling import sample_posterior
from cpam_bayes.inference.diagnostics.predictive import cavity, importance_leave_one_out, leave_one_out
from cpam_bayes.inference.pairing import Pairing
from cpam_bayes.inference.posterior import Posterior, plate_posterior
from cpam_bayes.plate import builtin
from tests.linear_model import MEAN_HZ, SLOPE_HZ, LinearModel, exact_gaussian, measurement

ONE_TO_ONE = Pairing(np.arange(4), np.empty(0, dtype=int), 0.0)


def refitted(relative_std: float) -> tuple[np.ndarray, np.ndarray]:
    """Residuals and predictive sd of each frequency from a least-squares fit to the other three."""
    data = measurement(relative_std)
    sigma = relative_std * data.frequencies
    residual, sd = [], []
    for i in range(4):
        kept = np.delete(np.arange(4), i)
        slope, own = SLOPE_HZ[kept], sigma[kept]
        covariance = np.linalg.inv(slope.T @ (slope / own[:, None] ** 2))
        x = covariance @ slope.T @ ((data.frequencies - MEAN_HZ)[kept] / own**2)
        residual.append(data.frequencies[i] - MEAN_HZ[i] - SLOPE_HZ[i] @ x)
        sd.append(np.sqrt(SLOPE_HZ[i] @ covariance @ SLOPE_HZ[i] + sigma[i] ** 2))
    return np.array(residual), np.array(sd)


def test_closed_form_is_the_refit_of_a_linear_model() -> None:
    data = measurement(0.01)
    mean, covariance = exact_gaussian(data)
    sigma = 0.01 * data.frequencies
    residual = data.frequencies - MEAN_HZ - SLOPE_HZ @ mean
    variance = np.einsum("ij,jk,ik->i", SLOPE_HZ, covariance, SLOPE_HZ)
    found = cavity(residual, variance / sigma**2, sigma**2, "optimum")
    expected, sd = refitted(0.01)
    np.testing.assert_allclose(found.residual, expected, rtol=1e-10)
    np.testing.assert_allclose(found.sd, sd, rtol=1e-10)
    # the trace of a hat matrix is the number of parameters
    assert found.leverage.sum() == pytest.approx(2.0, rel=1e-12)


def exact_draws(relative_std: float, n: int) -> tuple[Posterior, np.ndarray, np.ndarray]:
    data = measurement(relative_std)
    draws = np.random.default_rng(2).multivariate_normal(*exact_gaussian(data), size=n)
    posterior = plate_posterior(LinearModel(), data, np.zeros(4))
    return posterior, draws, posterior.predict(draws)


def test_closed_form_from_draws_is_the_refit_within_sampling_error() -> None:
    posterior, draws, predicted = exact_draws(0.01, 40_000)
    found = leave_one_out(posterior, draws, predicted, ONE_TO_ONE, draws[0])
    expected, sd = refitted(0.01)
    # leverages, at most 0.7 here, are known to sqrt(2 / 40000) = 0.7 %: 1 - h to 1.6 %, times three
    np.testing.assert_allclose(found.residual, expected, rtol=0.05, atol=0.02 * sd.min())
    np.testing.assert_allclose(found.sd, sd, rtol=0.025)


def test_a_frequency_without_a_mode_is_not_left_out() -> None:
    posterior, draws, predicted = exact_draws(0.01, 2000)
    pairing = Pairing(np.array([0, -1, 2, 3]), np.array([1]), 0.0)
    found = leave_one_out(posterior, draws, predicted, pairing, draws[0])
    whole = leave_one_out(posterior, draws, predicted, ONE_TO_ONE, draws[0])
    np.testing.assert_array_equal(found.residual, whole.residual[[0, 2, 3]])


def test_heavy_tails_count_less_and_predict_wider() -> None:
    data = measurement(0.01)
    draws = np.random.default_rng(2).multivariate_normal(*exact_gaussian(data), size=2000)
    gaussian, nearly, student = (
        leave_one_out(
            own := plate_posterior(LinearModel(), data, np.zeros(4), degrees_of_freedom=nu),
            draws,
            own.predict(draws),
            ONE_TO_ONE,
            draws[0],
        )
        for nu in (np.inf, 1e7, 4.0)
    )
    np.testing.assert_allclose(nearly.sd, gaussian.sd, rtol=1e-5)
    # information (nu + 1) / (nu + 3) = 5 / 7 of a Gaussian's
    np.testing.assert_allclose(student.leverage, 5 / 7 * gaussian.leverage, rtol=1e-12)
    # v without the datum plus nu / (nu - 2) = 2 times the squared scale
    own = (0.01 * data.frequencies) ** 2
    without = 7 / 5 * own * student.leverage / (1 - student.leverage)
    np.testing.assert_allclose(student.sd**2, without + 2.0 * own, rtol=1e-12)


def test_of_two_optima_the_best_one_is_linearised() -> None:
    posterior, draws, _ = exact_draws(0.01, 2000)
    mean, covariance = exact_gaussian(posterior.measurement)
    twice = np.concatenate((draws, draws + 1.0))
    found = leave_one_out(posterior, twice, posterior.predict(twice), ONE_TO_ONE, mean)
    assert found.basis == "optimum"
    # a Gaussian of the prior's variance 4^2 / 12 about the optimum stands for the uniform prior
    data = posterior.measurement
    sigma = 0.01 * data.frequencies
    with_prior = np.linalg.inv(np.linalg.inv(covariance) + 12 / 16 * np.eye(2))
    leverage = np.einsum("ij,jk,ik->i", SLOPE_HZ, with_prior, SLOPE_HZ) / sigma**2
    np.testing.assert_allclose(found.leverage, leverage, rtol=1e-10)
    residual = data.frequencies - MEAN_HZ - SLOPE_HZ @ mean
    np.testing.assert_allclose(found.residual, residual / (1 - leverage), rtol=1e-10)
    np.testing.assert_allclose(found.sd, sigma / np.sqrt(1 - leverage), rtol=1e-10)


def test_importance_sampling_agrees_with_the_closed_form_where_it_calls_itself_reliable() -> None:
    # eight data of sd 1 about one mean: every leverage is 1 / 8
    rng = np.random.default_rng(4)
    y, theta = rng.standard_normal(8), rng.normal(0.0, np.sqrt(1 / 8), size=(4000, 1))
    theta += y.mean()
    found = importance_leave_one_out(-0.5 * (y - theta) ** 2 - 0.5 * np.log(2.0 * np.pi))
    assert found.reliable
    assert found.k_hat.shape == (8,)
    exact = cavity(y - y.mean(), np.full(8, 1 / 8), np.ones(8), "optimum")
    # eight weighted means over 4000 draws, each good to about 0.4 % of its density
    assert found.log_score == pytest.approx(exact.log_score, abs=0.03)


def test_importance_sampling_says_so_where_one_frequency_holds_everything() -> None:
    # frequency 1 alone sees a here: without it the posterior is wider by orders of magnitude
    rng = np.random.default_rng(0)
    a = rng.normal(0.0, 1.0, size=4000)
    log_density = np.column_stack((-0.5 * a**2 * 0.995, -0.5 * (0.05 * a) ** 2))
    found = importance_leave_one_out(log_density)
    assert not found.reliable
    assert found.k_hat[0] > 0.7 > found.k_hat[1]


@dataclass(frozen=True)
class WithoutOne(Posterior):
    """A posterior that does not look at one frequency."""

    left_out: int = -1

    def log_likelihood(self, x: np.ndarray) -> np.ndarray:
        predicted = self.predict(x)
        density = self.log_density(predicted, self.noise(x, predicted))
        kept = np.delete(np.arange(self.measurement.size), self.left_out)
        return np.asarray(density[:, kept, kept].sum(axis=1))


@pytest.mark.slow
def test_closed_form_on_c1_is_near_sampling_without_a_mode() -> None:
    settings = EnsembleSettings(walkers=24, round_steps=1000, effective=300.0, most_steps=3000)
    found = sample(builtin("C1"), seed=0, settings=settings)
    own = found.posterior
    left_out = found.assessment.left_out
    parts = (own.model, own.measurement, own.parameters, own.noise_model, own.labelled, own.pairing)
    for i in (0, 3):  # the largest leverage and the largest residual
        without = WithoutOne(*parts, left_out=i)
        draws = sample_posterior(without, 1, settings=settings).draws[::7]
        predicted = without.predict(draws)
        noise = np.mean(without.noise(draws, predicted)[:, i, i] ** 2)
        sd = np.sqrt(predicted[:, i].var() + noise)
        residual = own.measurement.frequencies[i] - predicted[:, i].mean()
        # a bound cuts the posterior of E2 and the noise is inferred anew: what a Gaussian leaves out
        assert abs(left_out.residual[i] - residual) < 0.45 * sd
        assert 0.65 < left_out.sd[i] / sd < 1.5
