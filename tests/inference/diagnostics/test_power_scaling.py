"""Power scaling against densities whose powers are known; bounds that are moved."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from cpam_bayes.inference.diagnostics.power_scaling import PowerScaling, moved_bounds, power_scaling
from cpam_bayes.parameters import Parameter, ParameterSet, TruncatedNormal, Uniform

N = 20_000
NOTHING = np.zeros(N)


def cumulative_js_distance(p: np.ndarray, q: np.ndarray, x: np.ndarray) -> float:
    """Square root of the cumulative Jensen-Shannon divergence of two distribution functions on a grid."""

    def half(p: np.ndarray, q: np.ndarray) -> float:
        integrand = p * np.log2(p / (0.5 * (p + q))) + 0.5 / np.log(2.0) * (q - p)
        return float(np.trapezoid(integrand, x))

    return np.sqrt((half(p, q) + half(q, p)) / float(np.trapezoid(p + q, x)))


def test_sensitivity_to_the_likelihood_is_the_derivative_of_the_distance() -> None:
    # even prior, likelihood N(0, 1): the power a makes the posterior N(0, 1 / a)
    draws = np.random.default_rng(1).standard_normal((N, 1))
    (found,) = power_scaling(("a",), draws, NOTHING, NOTHING, -0.5 * draws[:, 0] ** 2)
    x = np.linspace(draws.min(), draws.max(), 20_001)
    distances = [cumulative_js_distance(norm.cdf(x), norm.cdf(x * np.sqrt(a)), x) for a in (1 / 1.01, 1.01)]
    expected = sum(distances) / (2.0 * np.log2(1.01))
    # the tails that count are those of 20000 draws
    assert found.likelihood == pytest.approx(expected, rel=0.1)
    assert found.prior == 0.0
    assert found.noise_prior == 0.0
    assert found.diagnosis == "likelihood has a say"


def test_a_prior_far_from_the_data_disagrees_with_them() -> None:
    # N(0, 1) times N(8, 1) is N(4, 1 / 2)
    draws = np.random.default_rng(1).normal(4.0, np.sqrt(0.5), size=(N, 1))
    x = draws[:, 0]
    (found,) = power_scaling(("a",), draws, -0.5 * x**2, NOTHING, -0.5 * (x - 8.0) ** 2)
    assert found.diagnosis == "prior and data disagree"
    assert found.prior == pytest.approx(found.likelihood, rel=0.1)  # by symmetry


def test_data_that_say_little_leave_the_prior_strong_and_the_likelihood_weak() -> None:
    draws = np.random.default_rng(1).standard_normal((N, 1))
    x = draws[:, 0]
    (found,) = power_scaling(("a",), draws, -0.5 * x**2, NOTHING, -0.5 * (x / 20.0) ** 2)
    assert found.diagnosis == "prior is strong, likelihood weak"


def test_each_parameter_has_its_own_sensitivity() -> None:
    draws = np.random.default_rng(1).standard_normal((N, 2))
    seen, unseen = power_scaling(("a", "b"), draws, NOTHING, NOTHING, -0.5 * draws[:, 0] ** 2)
    assert seen.diagnosis == "likelihood has a say"
    assert unseen.diagnosis == "likelihood is weak"


@pytest.mark.parametrize(
    ("prior", "noise", "likelihood", "expected"),
    [
        (0.0, 0.0, 0.2, "likelihood has a say"),
        (0.0, 0.06, 0.2, "likelihood and noise prior have a say"),
        (0.06, 0.06, 0.2, "prior and data disagree"),
        (0.06, 0.06, 0.01, "prior is strong, likelihood weak"),
        (0.0, 0.06, 0.01, "likelihood is weak"),
    ],
)
def test_diagnoses_follow_the_published_threshold(
    prior: float, noise: float, likelihood: float, expected: str
) -> None:
    assert PowerScaling("a", prior, noise, likelihood).diagnosis == expected


def test_moving_a_bound_of_an_even_posterior_moves_its_mean_by_half_as_much() -> None:
    parameters = ParameterSet(
        (Parameter("a", "", Uniform(0.0, 1.0)), Parameter("b", "", TruncatedNormal(0.0, 1.0, -5.0, 5.0)))
    )
    rng = np.random.default_rng(3)
    draws = np.column_stack((rng.uniform(0.0, 1.0, N), rng.standard_normal(N)))
    lower, upper = moved_bounds(parameters, draws)  # b's prior is no interval
    # a tenth cut off one side: the mean moves by 0.05 of sd 12^-1/2; known to 20000^-1/2 sd
    for moved, sign in ((lower, 1.0), (upper, -1.0)):
        assert moved.name == "a"
        assert moved.cut == pytest.approx(0.1, abs=0.01)
        assert moved.shift[0] == pytest.approx(sign * 0.05 * np.sqrt(12.0), abs=0.03)
        assert moved.shift[1] == pytest.approx(0.0, abs=0.03)


def test_a_bound_moved_past_all_draws_says_nothing() -> None:
    parameters = ParameterSet((Parameter("a", "", Uniform(0.0, 1.0)),))
    draws = np.random.default_rng(3).uniform(0.0, 0.05, size=(N, 1))
    lower, upper = moved_bounds(parameters, draws)
    assert lower.cut == 1.0
    assert np.isnan(lower.shift[0])
    assert upper.shift[0] == 0.0
