"""Profile likelihoods against closed forms and against a search of everything."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest

from cpam_bayes.forward_model.model import Prediction
from cpam_bayes.inference.diagnostics.profiles import DROP_95, Profile, profile_likelihoods
from cpam_bayes.inference.posterior import Posterior, plate_posterior
from cpam_bayes.parameters import Parameter, ParameterSet, TruncatedNormal, Uniform
from tests.linear_model import MEAN_HZ, SLOPE_HZ, LinearModel, exact_gaussian, measurement


def profiles(posterior: Posterior, names: tuple[str, ...] = ("a", "b"), n: int = 21) -> tuple[Profile, ...]:
    """Profiles that start from draws spread over the support, as of a poor chain."""
    draws = posterior.parameters.sample(np.random.default_rng(5), 4000)
    height = posterior.log_prob(draws)
    kept = height > height.max() - 8.0
    return profile_likelihoods(posterior, names, draws[kept], height[kept], n)


def test_profiles_of_a_linear_model_are_parabolas() -> None:
    data = measurement(0.01)
    mean, covariance = exact_gaussian(data)
    for k, found in enumerate(profiles(plate_posterior(LinearModel(), data, np.zeros(4)))):
        expected = 0.5 * (found.values - mean[k]) ** 2 / covariance[k, k]
        # an optimisation ends when steps promise less than 1e-7 nats
        np.testing.assert_allclose(found.drop, expected, atol=2e-6)
        sd = float(np.sqrt(covariance[k, k]))
        assert found.best == pytest.approx(mean[k], abs=1e-3 * sd)
        # linear in the root of the drop, which a parabola's is
        ends = mean[k] + np.array([-1.0, 1.0]) * np.sqrt(2.0 * DROP_95) * sd
        np.testing.assert_allclose((found.lower, found.upper), ends, atol=2e-3 * sd)
        assert (found.lower_open, found.upper_open) == (False, False)


def test_where_bounds_hold_the_other_parameter_the_profile_is_that_of_a_search() -> None:
    # at 30 % noise the bounds of b at -2 and 2 are reached from both ends of a
    posterior = plate_posterior(LinearModel(), measurement(0.3), np.zeros(4))
    (found,) = profiles(posterior, ("a",))
    b = np.linspace(-2.0, 2.0, 4001)
    best = [posterior.log_likelihood(np.column_stack((np.full_like(b, a), b))).max() for a in found.values]
    at_best = posterior.log_likelihood(np.column_stack((np.full_like(b, found.best), b))).max()
    # the grids of the search miss a maximum by at most 1e-4 nats
    np.testing.assert_allclose(found.drop, at_best - np.array(best), atol=2e-4)
    assert np.all(found.drop >= 0.0)


def test_inferred_noise_is_maximised_over_with_its_prior() -> None:
    posterior = plate_posterior(LinearModel(), measurement(None), np.zeros(4))
    (found,) = profiles(posterior, ("a",), n=7)
    f = posterior.measurement.frequencies
    height = []
    for a in (*found.values, found.best):
        # relative noise weighs by 1 / f^2 whatever its amplitude, so b is found first
        residual, slope = (f - MEAN_HZ - SLOPE_HZ[:, 0] * a) / f, SLOPE_HZ[:, 1] / f
        b = float(slope @ residual / (slope @ slope))
        s = np.geomspace(1e-4, 0.1, 20_001)
        x = np.column_stack((np.full_like(s, a), np.full_like(s, b), s))
        height.append(float((posterior.log_prob(x) + np.log(s)).max()))
    # an optimisation ends when steps promise less than 1e-7 nats
    np.testing.assert_allclose(found.drop, height[-1] - np.array(height[:-1]), atol=2e-6)


def test_the_prior_of_a_profiled_parameter_does_not_enter() -> None:
    @dataclass(frozen=True)
    class Informed(LinearModel):
        parameters: ParameterSet = field(
            default=ParameterSet(
                (
                    Parameter("a", "", TruncatedNormal(-1.0, 0.02, -2.0, 2.0)),
                    Parameter("b", "", Uniform(-2.0, 2.0)),
                )
            )
        )

    data = measurement(0.01)
    mean, covariance = exact_gaussian(data)
    (found, _) = profiles(plate_posterior(Informed(), data, np.zeros(4)))
    expected = 0.5 * (found.values - mean[0]) ** 2 / covariance[0, 0]
    np.testing.assert_allclose(found.drop, expected, rtol=1e-6, atol=2e-6)


def test_an_interval_that_reaches_a_bound_is_open_there() -> None:
    (found,) = profiles(plate_posterior(LinearModel(), measurement(3.0), np.zeros(4)), ("b",))
    assert found.lower_open
    assert found.upper_open
    assert (found.lower, found.upper) == (-2.0, 2.0)
    assert np.all(found.drop < DROP_95)


def test_a_region_in_two_parts_is_spanned_and_counted() -> None:
    @dataclass(frozen=True)
    class Even(LinearModel):
        def predict(self, x: np.ndarray, *, jacobian: bool = False) -> Prediction:
            x = np.atleast_2d(x)
            slope = np.repeat(SLOPE_HZ[None], len(x), axis=0)
            slope[:, :, 0] *= 2.0 * x[:, :1]
            square = np.column_stack((x[:, 0] ** 2, x[:, 1]))
            return Prediction(MEAN_HZ + square @ SLOPE_HZ.T, slope if jacobian else None)

    data = measurement(0.01)
    mean, covariance = exact_gaussian(data)
    (found,) = profiles(plate_posterior(Even(), data, np.zeros(4)), ("a",), n=201)
    np.testing.assert_allclose(
        found.drop, 0.5 * (found.values**2 - mean[0]) ** 2 / covariance[0, 0], atol=2e-6
    )
    assert found.parts == 2
    end = float(np.sqrt(mean[0] + np.sqrt(2.0 * DROP_95 * covariance[0, 0])))
    # the root of the drop is bent by a^2 between grid points 0.01 apart
    assert (-found.lower, found.upper) == pytest.approx((end, end), abs=1e-3)


def test_student_t_noise_has_its_own_profile() -> None:
    posterior = plate_posterior(LinearModel(), measurement(0.01), np.zeros(4), degrees_of_freedom=3.0)
    (found,) = profiles(posterior, ("a",), n=9)
    b = np.linspace(-1.0, 0.5, 6001)
    height = [
        posterior.log_likelihood(np.column_stack((np.full_like(b, a), b))).max()
        for a in (*found.values, found.best)
    ]
    np.testing.assert_allclose(found.drop, height[-1] - np.array(height[:-1]), atol=1e-4)
