"""Normal scores: the priors' moments, distribution functions and tails through a change of variable."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from cpam_bayes.inference.derivatives import Expansion
from cpam_bayes.inference.noise import NOISE_PRIOR
from cpam_bayes.inference.standard_normal import MAX_SCORE, NormalScores
from cpam_bayes.parameters import Parameter, ParameterSet, ScaledStudentT, TruncatedNormal, Uniform
from cpam_bayes.priors import Prior

PRIORS: dict[str, Prior] = {
    "uniform": Uniform(2.0, 5.0),
    "normal": TruncatedNormal(3.0, 0.5, 2.0, 5.0),
    "normal cut on one side": TruncatedNormal(0.0, 1.0, 0.3, np.inf),
    "normal far in the upper tail": TruncatedNormal(0.0, 1.0, 6.0, 9.0),
    "normal far in the lower tail": TruncatedNormal(0.0, 1.0, -9.0, -6.0),
    "student of either sign": ScaledStudentT(0.01, 4.0, -0.08, 0.08),
    "student of one sign": ScaledStudentT(0.02, 4.0, 0.0, 0.16),
    "noise": NOISE_PRIOR,
}
EVERY = pytest.mark.parametrize("prior", PRIORS.values(), ids=PRIORS.keys())


def of(*priors: Prior) -> NormalScores:
    return NormalScores(ParameterSet(tuple(Parameter(f"p{i}", "", p) for i, p in enumerate(priors))))


@EVERY
def test_mean_and_sd_over_standard_normal_scores_are_the_priors(prior: Prior) -> None:
    z, weight = np.polynomial.hermite_e.hermegauss(150)
    weight = weight / weight.sum()
    x = of(prior).to_x(z[:, None])[:, 0]
    # Gauss-Hermite quadrature of a smooth but bounded map: 2e-4 of a standard deviation
    mean = weight @ x
    assert mean == pytest.approx(prior.mean, abs=2e-4 * prior.sd)
    assert np.sqrt(weight @ (x - mean) ** 2) == pytest.approx(prior.sd, rel=1e-3)


@EVERY
def test_the_scores_distribution_function_is_that_of_the_prior(prior: Prior) -> None:
    scores = of(prior)
    for z in (-2.0, -0.4, 0.0, 1.5):
        x = float(scores.to_x(np.array([[z]]))[0, 0])
        share, _ = quad(
            lambda t: float(np.exp(prior.log_density(t))), prior.lower, x, epsabs=1e-11, limit=200
        )
        assert share == pytest.approx(norm.cdf(z), abs=1e-8)


@EVERY
def test_scores_come_back_from_parameters(prior: Prior) -> None:
    z = np.linspace(-4.0, 4.0, 33)[:, None]
    scores = of(prior)
    x = scores.to_x(z)
    assert np.all(np.diff(x[:, 0]) > 0.0)
    # scipy's quantiles of Student's t are good to 3e-8 scales about the centre, where a one-sided prior
    # has its lower tail
    np.testing.assert_allclose(scores.to_z(x), z, atol=1e-7)


@EVERY
def test_the_slope_is_the_difference_quotient(prior: Prior) -> None:
    scores, z, h = of(prior), np.linspace(-3.0, 3.0, 13)[:, None], 1e-4
    expected = (scores.to_x(z + h) - scores.to_x(z - h)) / (2 * h)
    # error of the quotient: h^2 times a third derivative of some tens
    np.testing.assert_allclose(scores.slope(scores.to_x(z), z), expected, rtol=2e-6)


def test_the_slope_is_the_density_of_the_score_over_that_of_the_prior() -> None:
    for prior in PRIORS.values():
        scores, z = of(prior), np.array([[-1.1], [0.6]])
        x = scores.to_x(z)
        expected = norm.pdf(z) / np.exp(prior.log_density(x))
        np.testing.assert_allclose(scores.slope(x, z), expected, rtol=1e-9)


def test_mirrored_priors_have_mirrored_scores() -> None:
    z = np.linspace(-6.5, 6.5, 27)[:, None]
    upper, lower = of(TruncatedNormal(0.0, 1.0, 6.0, 9.0)), of(TruncatedNormal(0.0, 1.0, -9.0, -6.0))
    # six standard deviations out, where 1 - Phi has seven digits only
    np.testing.assert_allclose(upper.to_x(z), -lower.to_x(-z), rtol=1e-14)


def test_parameters_on_their_bounds_have_finite_scores() -> None:
    scores = of(*PRIORS.values())
    lower, upper = scores.parameters.lower, scores.parameters.upper
    for bound, end in ((lower, -MAX_SCORE), (upper, MAX_SCORE)):
        finite = np.where(np.isfinite(bound), bound, np.sign(bound) * 50.0)
        np.testing.assert_array_equal(scores.to_z(finite[None]), np.full((1, len(bound)), end))
    for z in (-9.0, 9.0):
        x = scores.to_x(np.full((1, len(PRIORS)), z))
        assert np.all((x >= lower) & (x <= upper))


def test_a_set_of_priors_is_one_column_each() -> None:
    z = np.random.default_rng(0).standard_normal((5, len(PRIORS)))
    together = of(*PRIORS.values()).to_x(z)
    alone = np.concatenate([of(p).to_x(z[:, [i]]) for i, p in enumerate(PRIORS.values())], axis=1)
    np.testing.assert_array_equal(together, alone)


def test_priors_are_standard_normal_over_scores() -> None:
    scores, z = of(*PRIORS.values()), np.random.default_rng(1).standard_normal((20, len(PRIORS)))
    x = scores.to_x(z)
    log_prior = scores.parameters.log_prior(x) + np.log(scores.slope(x, z)).sum(axis=1)
    np.testing.assert_allclose(log_prior, scores.log_prior(z), atol=1e-9)
    np.testing.assert_allclose(scores.log_prior(z), norm.logpdf(z).sum(axis=1), rtol=1e-12)


@EVERY
def test_quantiles_and_distribution_function_are_inverse(prior: Prior) -> None:
    p = np.linspace(0.01, 0.99, 15)
    np.testing.assert_allclose(prior.cdf(prior.ppf(p)), p, atol=3e-8)
    np.testing.assert_array_equal(prior.cdf(np.array([prior.lower, prior.upper])), [0.0, 1.0])
    np.testing.assert_allclose(prior.ppf([0.0, 1.0]), [prior.lower, prior.upper], rtol=1e-7)


def test_a_likelihood_over_parameters_becomes_a_posterior_over_scores() -> None:
    """Gradient by differences, curvature of a linear model and its prior."""
    scores, rng = of(*PRIORS.values()), np.random.default_rng(2)
    n = len(PRIORS)
    a = rng.standard_normal((n, n)) / scores.parameters.upper.clip(0.01, 5.0)

    def expand(z: np.ndarray) -> Expansion:
        x = scores.to_x(z)
        r = x @ a.T
        fisher = np.tile(a.T @ a, (len(z), 1, 1))
        return scores.with_prior(Expansion(-0.5 * np.sum(r**2, axis=1), -r @ a, fisher), x, z)

    z, h = rng.standard_normal((1, n)), 1e-5
    e = expand(z)
    steps = h * np.eye(n)
    difference = (expand(z + steps).value - expand(z - steps).value) / (2.0 * h)
    np.testing.assert_allclose(e.gradient[0], difference, rtol=1e-5, atol=1e-6)
    slope = scores.slope(scores.to_x(z), z)[0]
    np.testing.assert_allclose(e.curvature[0], slope[:, None] * (a.T @ a) * slope + np.eye(n), rtol=1e-12)
