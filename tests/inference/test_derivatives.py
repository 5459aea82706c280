"""Gradients and curvatures of log densities, and scores over which priors are standard normal."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm, t

from cpam_bayes.inference.derivatives import (
    MAX_SCORE,
    Expansion,
    NormalScores,
    coordinates,
    expand,
    expand_likelihood,
    expand_u,
    hessian_u,
    log_density,
)
from cpam_bayes.inference.posterior import NOISE_PRIOR, Posterior, plate_posterior
from cpam_bayes.parameters import ScaledStudentT, TruncatedNormal, Uniform
from cpam_bayes.plate import Measurement
from cpam_bayes.priors import Prior
from tests.linear_model import MEAN_HZ, SLOPE_HZ, LinearModel, measurement
from tests.toy_models import ToyModel, listed, parameters

ERROR = np.array([1e-3, 2e-3, 1e-3, 3e-3])


def curved(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Five frequencies that are not linear in two parameters."""
    mean, slope = np.append(MEAN_HZ, 500.0), np.vstack((SLOPE_HZ, [5.0, 5.0]))
    z = x @ slope.T
    return mean + z + 0.01 * z**2, (1.0 + 0.02 * z)[:, :, None] * slope


PRIORS = {
    "uniform": parameters(a=Uniform(-2.0, 2.0), b=Uniform(-2.0, 2.0)),
    "normal": parameters(
        a=TruncatedNormal(0.1, 0.3, -2.0, 2.0), b=TruncatedNormal(0.0, 0.5, -np.inf, np.inf)
    ),
    "student": parameters(a=ScaledStudentT(0.4, 4.0, -2.0, 2.0), b=Uniform(-2.0, 2.0)),
}


def some_posterior(case: str) -> Posterior:
    model = ToyModel(PRIORS.get(case, PRIORS["uniform"]), curved)
    error = np.append(ERROR, 1e-3)
    inferred = measurement(None, resolution=1.0)
    if case == "student noise":
        return plate_posterior(model, inferred, error, degrees_of_freedom=4.0)
    if case == "absolute noise":
        return plate_posterior(model, inferred, error, likelihood="absolute")
    if case == "own deviations":
        return plate_posterior(model, listed(inferred.frequencies, np.array([1.0, 3.0, 2.0, 5.0])), error)
    if case == "incomplete":
        gaps = Measurement(inferred.frequencies[[0, 1, 3]], 1.0, None, None, ("",) * 3, complete=False)
        return plate_posterior(model, gaps, error)
    return plate_posterior(model, inferred, error)


CASES = [*PRIORS, "student noise", "absolute noise", "own deviations", "incomplete"]


def vectors(posterior: Posterior, m: int = 12) -> np.ndarray:
    x = posterior.parameters.sample(np.random.default_rng(0), m)
    inside = (x > posterior.parameters.lower + 0.01) & (x < posterior.parameters.upper - 0.01)
    return np.where(inside, x, 0.05)


@pytest.mark.parametrize("case", CASES)
def test_gradients_are_limits_of_differences_and_a_stack_gives_what_each_vector_gives(case: str) -> None:
    own = some_posterior(case)
    axes, x = coordinates(own), vectors(own)
    u, steps = axes.to_u(x), np.eye(x.shape[1])
    np.testing.assert_allclose(axes.to_x(u), x, rtol=1e-14)
    e = expand_u(own, axes, u)
    np.testing.assert_allclose(e.value, log_density(own, axes, u), rtol=1e-12)

    def differences(h: float) -> np.ndarray:
        up, down = ([log_density(own, axes, u + s * h * step) for step in steps] for s in (1.0, -1.0))
        return np.transpose(np.subtract(up, down)) / (2.0 * h)

    extrapolated = (4.0 * differences(1e-4) - differences(2e-4)) / 3.0
    size = np.abs(e.gradient).max(axis=1, keepdims=True)
    # rounding of a log probability of some 1e3 over the step of 1e-4, beside gradients of some 1e2
    np.testing.assert_array_less(np.abs(e.gradient - extrapolated) / size, 1e-6)
    # summed pairings are differenced: rounding over the square of the step
    near = {"rtol": 1e-9} if own.measurement.complete else {"rtol": 1e-4, "atol": 1e-2}
    together = expand(own, x)
    np.testing.assert_allclose(together.value, own.log_prob(x), rtol=1e-12)
    for i in range(5):
        alone = expand(own, x[i : i + 1])
        np.testing.assert_allclose(alone.gradient[0], together.gradient[i], **near)
        np.testing.assert_allclose(alone.curvature[0], together.curvature[i], **near)


def test_outside_the_support_the_gradient_is_zero_and_the_model_is_not_asked() -> None:
    own = some_posterior("uniform")
    x = np.array([[9.0, 0.0, 0.01], [0.1, 0.0, 0.01]])
    e = expand(own, x)
    assert e.value[0] == -np.inf
    np.testing.assert_array_equal(e.gradient[0], 0.0)
    assert np.isfinite(e.value[1])
    assert np.any(e.gradient[1] != 0.0)


def test_curvature_is_the_expected_one_for_student_t_noise() -> None:
    """Fisher information by quadrature of the squared score, for the location and the log scale."""
    nu = 4.0
    own = replace(
        plate_posterior(LinearModel(), measurement(None), np.zeros(4), degrees_of_freedom=nu), pairing=()
    )
    x = np.array([[0.3, 0.1, 0.02]])
    sigma = 0.02 * own.measurement.frequencies

    def location(z: float) -> float:
        return ((nu + 1) * z / (nu + z**2)) ** 2 * float(t.pdf(z, nu))

    def log_scale(z: float) -> float:
        return ((nu + 1) * z**2 / (nu + z**2) - 1.0) ** 2 * float(t.pdf(z, nu))

    by_location, by_scale = (quad(f, -np.inf, np.inf)[0] for f in (location, log_scale))
    found = expand_likelihood(own, x).curvature[0]
    weighted = SLOPE_HZ / sigma[:, None]
    np.testing.assert_allclose(found[:2, :2], by_location * weighted.T @ weighted, rtol=1e-7)
    assert found[2, 2] * 0.02**2 == pytest.approx(4 * by_scale, rel=1e-7)


def test_curvature_of_a_prior_is_its_own() -> None:
    sd = 0.3
    own = plate_posterior(
        LinearModel(parameters(a=TruncatedNormal(0.1, sd, -2.0, 2.0), b=Uniform(-2.0, 2.0))),
        measurement(0.01),
        np.zeros(4),
    )
    x = np.array([[0.3, 0.1]])
    added = expand(own, x).curvature - expand_likelihood(own, x).curvature
    np.testing.assert_allclose(added[0], np.diag([1.0 / sd**2, 0.0]), rtol=1e-6, atol=1e-6)


def test_exact_hessian_is_the_second_difference_of_the_log_density() -> None:
    own = some_posterior("student noise")
    axes = coordinates(own)
    u = axes.to_u(np.array([0.4, -0.3, 0.01]))
    found = hessian_u(own, axes, u, np.array([0.05, 0.05, 0.4]))
    h, unit = 1e-3, np.eye(3)
    for i in range(3):
        for j in range(3):
            corners = np.stack([u + h * (a * unit[i] + b * unit[j]) for a in (1, -1) for b in (1, -1)])
            second = log_density(own, axes, corners) @ np.array([1, -1, -1, 1]) / (4 * h**2)
            # third derivatives, over a step of a thousandth
            assert -found[i, j] == pytest.approx(second, rel=2e-3, abs=0.05)


EVERY_PRIOR: dict[str, Prior] = {
    "uniform": Uniform(2.0, 5.0),
    "normal": TruncatedNormal(3.0, 0.5, 2.0, 5.0),
    "normal cut on one side": TruncatedNormal(0.0, 1.0, 0.3, np.inf),
    "normal far in the upper tail": TruncatedNormal(0.0, 1.0, 6.0, 9.0),
    "normal far in the lower tail": TruncatedNormal(0.0, 1.0, -9.0, -6.0),
    "student of either sign": ScaledStudentT(0.01, 4.0, -0.08, 0.08),
    "student of one sign": ScaledStudentT(0.02, 4.0, 0.0, 0.16),
    "noise": NOISE_PRIOR,
}


def of(*priors: Prior) -> NormalScores:
    return NormalScores(parameters(**{f"p{i}": prior for i, prior in enumerate(priors)}))


@pytest.mark.parametrize("prior", EVERY_PRIOR.values(), ids=EVERY_PRIOR)
def test_scores_have_the_distribution_function_of_the_prior_its_slope_and_come_back(prior: Prior) -> None:
    scores = of(prior)
    for z in (-2.0, -0.4, 0.0, 1.5):
        x = float(scores.to_x(np.array([[z]]))[0, 0])
        share, _ = quad(
            lambda t: float(np.exp(prior.log_density(t))), prior.lower, x, epsabs=1e-11, limit=200
        )
        assert share == pytest.approx(norm.cdf(z), abs=1e-8)
    z = np.linspace(-4.0, 4.0, 33)[:, None]
    x = scores.to_x(z)
    assert np.all(np.diff(x[:, 0]) > 0.0)
    # scipy's quantiles of Student's t are good to 3e-8 scales about the centre, where a one-sided prior
    # has its lower tail
    np.testing.assert_allclose(scores.to_z(x), z, atol=1e-7)
    z, x = z[[12, 19]], x[[12, 19]]
    np.testing.assert_allclose(scores.slope(x, z), norm.pdf(z) / np.exp(prior.log_density(x)), rtol=1e-9)


def test_mirrored_priors_have_mirrored_scores() -> None:
    z = np.linspace(-6.5, 6.5, 27)[:, None]
    upper, lower = of(TruncatedNormal(0.0, 1.0, 6.0, 9.0)), of(TruncatedNormal(0.0, 1.0, -9.0, -6.0))
    # six standard deviations out, where 1 - Phi has seven digits only
    np.testing.assert_allclose(upper.to_x(z), -lower.to_x(-z), rtol=1e-14)


def test_parameters_on_their_bounds_have_finite_scores() -> None:
    scores = of(*EVERY_PRIOR.values())
    lower, upper = scores.parameters.lower, scores.parameters.upper
    for bound, end in ((lower, -MAX_SCORE), (upper, MAX_SCORE)):
        finite = np.where(np.isfinite(bound), bound, np.sign(bound) * 50.0)
        np.testing.assert_array_equal(scores.to_z(finite[None]), np.full((1, len(bound)), end))
    for z in (-9.0, 9.0):
        x = scores.to_x(np.full((1, len(EVERY_PRIOR)), z))
        assert np.all((x >= lower) & (x <= upper))


def test_a_likelihood_over_parameters_becomes_a_posterior_over_scores() -> None:
    """Gradient by differences, curvature of a linear model and its prior."""
    scores, rng = of(*EVERY_PRIOR.values()), np.random.default_rng(2)
    n = len(EVERY_PRIOR)
    a = rng.standard_normal((n, n)) / scores.parameters.upper.clip(0.01, 5.0)

    def expand(z: np.ndarray) -> Expansion:
        x = scores.to_x(z)
        r = x @ a.T
        fisher = np.tile(a.T @ a, (len(z), 1, 1))
        return scores.with_prior(Expansion(-0.5 * np.sum(r**2, axis=1), -r @ a, fisher), x, z)

    z, h = rng.standard_normal((1, n)), 1e-5
    e = expand(z)
    prior = norm.logpdf(z[0]).sum()
    assert e.value[0] == pytest.approx(prior - 0.5 * np.sum((scores.to_x(z) @ a.T) ** 2), rel=1e-12)
    steps = h * np.eye(n)
    difference = (expand(z + steps).value - expand(z - steps).value) / (2.0 * h)
    np.testing.assert_allclose(e.gradient[0], difference, rtol=1e-5, atol=1e-6)
    slope = scores.slope(scores.to_x(z), z)[0]
    np.testing.assert_allclose(e.curvature[0], slope[:, None] * (a.T @ a) * slope + np.eye(n), rtol=1e-12)
