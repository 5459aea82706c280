"""Normal scores: the priors' moments, distribution functions and tails through a change of variable."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from cpam_bayes.diagnosis.evidence.scores import FARTHEST, Scores, scores_of
from cpam_bayes.inference.noise import NOISE_PRIOR
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


def of(*priors: Prior) -> Scores:
    return scores_of(ParameterSet(tuple(Parameter(f"p{i}", "", p) for i, p in enumerate(priors))))


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
    for bound, end in ((scores.lower, -FARTHEST), (scores.upper, FARTHEST)):
        finite = np.where(np.isfinite(bound), bound, np.sign(bound) * 50.0)
        np.testing.assert_array_equal(scores.to_z(finite[None]), np.full((1, len(bound)), end))
    for z in (-9.0, 9.0):
        x = scores.to_x(np.full((1, len(PRIORS)), z))
        assert np.all((x >= scores.lower) & (x <= scores.upper))


def test_a_set_of_priors_is_one_column_each() -> None:
    z = np.random.default_rng(0).standard_normal((5, len(PRIORS)))
    together = of(*PRIORS.values()).to_x(z)
    alone = np.concatenate([of(p).to_x(z[:, [i]]) for i, p in enumerate(PRIORS.values())], axis=1)
    np.testing.assert_array_equal(together, alone)
