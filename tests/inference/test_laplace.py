"""Derivatives of log densities, normal scores, optima, and Laplace's approximation about these."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import lsq_linear
from scipy.special import gammaln, log_ndtr
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
from cpam_bayes.inference.laplace import (
    approximate,
    find_optima,
    gauss_newton_covariance,
    laplace_log_evidence,
    maximise,
    polish,
)
from cpam_bayes.inference.posterior import NOISE_PRIOR, Posterior, plate_posterior
from cpam_bayes.parameters import ScaledStudentT, TruncatedNormal, Uniform
from cpam_bayes.plate import Measurement
from cpam_bayes.priors import Prior
from tests.linear_model import MEAN_HZ, SLOPE_HZ, LinearModel, exact_gaussian, measurement
from tests.toy_models import (
    ToyModel,
    crossing,
    independent,
    integral,
    integral_over_noise,
    linear,
    listed,
    parameters,
    two_peaks,
)

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


def test_scores_are_finite_on_bounds_and_mirrored_where_priors_are() -> None:
    scores = of(*EVERY_PRIOR.values())
    lower, upper = scores.parameters.lower, scores.parameters.upper
    for bound, end in ((lower, -MAX_SCORE), (upper, MAX_SCORE)):
        finite = np.where(np.isfinite(bound), bound, np.sign(bound) * 50.0)
        np.testing.assert_array_equal(scores.to_z(finite[None]), np.full((1, len(bound)), end))
    for z in (-9.0, 9.0):
        x = scores.to_x(np.full((1, len(EVERY_PRIOR)), z))
        assert np.all((x >= lower) & (x <= upper))
    z = np.linspace(-6.5, 6.5, 27)[:, None]
    one, mirrored = (of(EVERY_PRIOR[f"normal far in the {side} tail"]) for side in ("upper", "lower"))
    # six standard deviations out, where 1 - Phi has seven digits only
    np.testing.assert_allclose(one.to_x(z), -mirrored.to_x(-z), rtol=1e-14)


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


A = np.array([[2.0, 1.0], [0.5, 1.5], [1.0, -1.0]])
B = np.array([[1.0, -0.4, 0.3], [-9.0, 4.0, 1.0], [0.0, 9.0, -9.0]])
LOWER, UPPER = np.array([-1.0, -1.0]), np.array([1.0, 1.0])
# What is left to gain when an optimisation ends, 1e-9, over the least curvature, 2.9: sqrt(2 * 1e-9 / 2.9).
NEAR = 2.7e-5


def least_squares(u: np.ndarray, rows: np.ndarray) -> Expansion:
    """-|A u - b|^2 / 2 with a b of its own for every optimisation."""
    r = u @ A.T - B[rows]
    bend = np.broadcast_to(A.T @ A, (len(u), 2, 2))
    return Expansion(-0.5 * np.sum(r**2, axis=1), -r @ A, bend)


def kink(u: np.ndarray, rows: np.ndarray) -> Expansion:
    """A ridge -|8 (x - y)| - ((x + y) / 2 - 0.8)^2: along each side the slope leads into the ridge."""
    x, y = u.T
    middle = (x + y) / 2 - 0.8
    side = np.sign(x - y)
    value = -8.0 * np.abs(x - y) - middle**2
    gradient = np.stack((-8.0 * side - middle, 8.0 * side - middle), axis=1)
    return Expansion(value, gradient, np.broadcast_to(0.5 * np.ones((2, 2)), (len(u), 2, 2)))


def test_bounded_least_squares_ends_within_bounds_where_an_independent_program_does() -> None:
    def watched(u: np.ndarray, rows: np.ndarray) -> Expansion:
        assert np.all((u >= LOWER) & (u <= UPPER))
        return least_squares(u, rows)

    start = np.random.default_rng(0).uniform(-1.0, 1.0, size=(3, 2))
    start[0] = 5.0
    found = maximise(watched, start, LOWER, UPPER)
    assert found.converged.all()
    for i in range(3):
        expected = lsq_linear(A, B[i], bounds=(LOWER, UPPER), tol=1e-14).x
        np.testing.assert_allclose(found.u[i], expected, atol=NEAR)
    assert np.any(found.u == LOWER)  # an optimum on bounds is among them
    assert np.any(np.abs(found.u) < 0.9)
    # polls leave a true optimum where it is
    u, _, verified = polish(
        lambda u: least_squares(u, np.zeros(len(u), dtype=int)).value, watched, found, 0, LOWER, UPPER
    )
    assert verified
    np.testing.assert_array_equal(u, found.u[0])


def test_a_start_outside_the_support_stays_and_is_not_converged() -> None:
    def holed(u: np.ndarray, rows: np.ndarray) -> Expansion:
        found = least_squares(u, rows)
        return Expansion(np.where(u[:, 0] > 0.5, -np.inf, found.value), found.gradient, found.curvature)

    found = maximise(holed, np.array([[0.9, 0.0], [0.0, 0.0]]), LOWER, UPPER)
    assert not found.converged[0]
    np.testing.assert_array_equal(found.u[0], [0.9, 0.0])
    assert np.isfinite(found.expansion.value[1])


def test_steps_that_shrink_at_a_kink_are_seen_through_by_polls() -> None:
    start = np.array([[-0.9, -0.5]])
    stuck = maximise(kink, start, LOWER, UPPER)
    # on the ridge every step loses: the optimisation ends far from the top, which is 0 at (0.8, 0.8)
    assert stuck.expansion.value[0] < -0.5

    def value(u: np.ndarray) -> np.ndarray:
        return kink(u, np.zeros(len(u), dtype=int)).value

    u, found, verified = polish(value, kink, stuck, 0, LOWER, UPPER)
    assert found.value[0] > stuck.expansion.value[0] + 0.4
    assert verified == (found.value[0] > -0.05)
    np.testing.assert_allclose(u, [0.8, 0.8], atol=0.25)


NOWHERE = np.empty((0, 2))


def linear_posterior() -> Posterior:
    return plate_posterior(LinearModel(), measurement(0.01), np.zeros(4))


def exact_log_evidence(data: Measurement) -> float:
    """Of the linear model where its bounds are far away: the residual's density over the prior's volume."""
    sd = data.relative_std * data.frequencies
    mean, covariance = exact_gaussian(data)
    height = norm.logpdf(data.frequencies, MEAN_HZ + SLOPE_HZ @ mean, sd).sum() - 2 * np.log(4.0)
    return float(height + np.log(2 * np.pi) + 0.5 * np.linalg.slogdet(covariance)[1])


@pytest.mark.parametrize("hessian", ["gauss-newton", "exact"])
def test_evidence_of_a_linear_model_is_the_closed_form(hessian: str) -> None:
    own = linear_posterior()
    (optimum,) = find_optima(own, NOWHERE, np.random.default_rng(0))
    found = approximate(own, optimum, hessian)
    assert optimum.verified
    assert found.hessian == hessian
    np.testing.assert_allclose(optimum.x, exact_gaussian(measurement(0.01))[0], atol=1e-5)
    # bounds are 10 standard deviations away; differences of the gradient leave 1e-8
    assert found.log_evidence == pytest.approx(exact_log_evidence(measurement(0.01)), abs=1e-6)


@pytest.mark.parametrize("hessian", ["gauss-newton", "exact"])
@pytest.mark.parametrize("off", [(-1.0, 5.0), (0.5, 12.0), (-4.0, -3.0)], ids=["edge", "both ends", "corner"])
def test_evidence_of_a_gaussian_cut_at_its_bounds_is_the_closed_form(
    off: tuple[float, float], hessian: str
) -> None:
    own = independent(off)
    (optimum,) = find_optima(own, NOWHERE, np.random.default_rng(0))
    found = approximate(own, optimum, hessian)
    mean = np.array(off) / 10.0
    np.testing.assert_allclose(optimum.x, np.clip(mean, 0.0, 1.0), atol=1e-4)
    masses = norm.cdf(1.0, mean, 0.1) - norm.cdf(0.0, mean, 0.1)
    # each frequency's density integrates to a tenth of the mass within the bounds
    assert found.log_evidence == pytest.approx(np.log(masses / 10.0).sum(), abs=2e-3)


def test_correlated_gaussian_cut_at_a_corner_is_the_quadrature() -> None:
    slope = np.array([[10.0, 9.0], [1.0, 4.0]])
    model = linear(np.array([100.0, 200.0]), slope, parameters(a=Uniform(0.0, 1.0), b=Uniform(0.0, 1.0)))
    own = plate_posterior(model, listed(np.array([97.5, 203.0]), np.array([2.0, 2.0])), np.zeros(2))
    (optimum,) = find_optima(own, NOWHERE, np.random.default_rng(0))
    assert optimum.x[0] == 0.0
    edges = (np.linspace(0.0, 1.0, 801),) * 2
    assert approximate(own, optimum).log_evidence == pytest.approx(integral(own, edges), abs=2e-3)


def test_a_slope_without_curvature_is_an_exponential() -> None:
    """Far out in the tail of Student-t noise the density is log-convex: only its slope ends it."""
    own_parameters = parameters(a=Uniform(0.0, 1.0), b=Uniform(0.0, 1.0))
    model = linear(np.array([100.0, 200.0]), np.diag([60.0, 10.0]), own_parameters)
    data = listed(np.array([80.0, 205.0]), np.array([1.0, 1.0]))
    own = plate_posterior(model, data, np.zeros(2), degrees_of_freedom=20.0)
    (optimum,) = find_optima(own, NOWHERE, np.random.default_rng(0))
    edges = (np.linspace(0.0, 1.0, 2001), np.linspace(0.0, 1.0, 401))
    gradient = optimum.expansion.gradient[0]
    assert optimum.x[0] == 0.0
    assert hessian_u(own, coordinates(own), optimum.u, np.full(2, 0.01))[0, 0] < 0.0
    assert gradient[0] < -1.0
    found = approximate(own, optimum)
    assert found.hessian == "exact"
    # a tail 21 log(1 + z^2 / 20) is fatter than the exponential of its slope at z = 20 by (1 + 1/21)
    assert found.log_evidence == pytest.approx(integral(own, edges), abs=0.15)


def test_a_student_t_has_the_gaussians_evidence_but_for_its_constant() -> None:
    own = linear_posterior()
    (optimum,) = find_optima(own, NOWHERE, np.random.default_rng(0))
    gaussian, student = (approximate(own, optimum, degrees_of_freedom=nu) for nu in (np.inf, 5.0))
    np.testing.assert_allclose(student.scale, gaussian.scale * 7.0 / 5.0, rtol=1e-9)
    # integral of (1 + z^2 / (nu + n))^-((nu + n) / 2) over that of exp(-z^2 / 2), n = 2
    constant = np.log(7.0 / 2.0) + gammaln(2.5) - gammaln(3.5)
    # 1e-3 of a Student-t of this width lies beyond the bounds
    assert student.log_evidence - gaussian.log_evidence == pytest.approx(constant, abs=2e-3)


def test_a_student_t_on_a_bound_has_the_slopes_half_gaussian() -> None:
    own = independent((-3.0,))
    (optimum,) = find_optima(own, np.array([[0.5]]))
    found = approximate(own, optimum, degrees_of_freedom=1e6)
    exact = np.log(0.1) + float(log_ndtr(-3.0))
    # an exponential of slope 3 instead of the Gaussian's tail, which falls off faster: by a tenth
    assert found.log_evidence == pytest.approx(exact, abs=0.12)
    np.testing.assert_array_equal(found.centre, optimum.u)


def test_noise_that_is_inferred_is_a_gaussian_in_its_logarithm() -> None:
    rng = np.random.default_rng(5)
    slope = rng.normal(size=(16, 2), scale=10.0)
    f = 100.0 * np.arange(10, 26)
    own_parameters = parameters(a=Uniform(-2.0, 2.0), b=Uniform(-2.0, 2.0))
    data = listed(f + rng.normal(size=16) * 0.001 * f, None)
    own = plate_posterior(linear(f, slope, own_parameters), data, np.zeros(16))
    (optimum,) = find_optima(own, np.empty((0, 3)), np.random.default_rng(0))
    axes = coordinates(own)
    # an optimum of the density over log s: over s itself the slope is -1 / s there
    h = 1e-4
    up, down = (log_density(own, axes, (optimum.u + d * np.eye(3)[2])[None])[0] for d in (h, -h))
    assert abs(up - down) / (2 * h) < 1e-3
    # with k frequencies the next term of the expansion is some 3 / k
    assert approximate(own, optimum).log_evidence == pytest.approx(integral_over_noise(own), abs=0.25)


def test_optima_are_as_many_as_the_peaks_that_starts_lead_to() -> None:
    own = two_peaks()
    assert len(find_optima(own, np.array([[0.9, 0.1]]))) == 1
    assert len(find_optima(own, np.array([[0.9, 0.1], [0.8, 0.0], [-0.9, 0.5]]))) == 2
    one, other = find_optima(own, NOWHERE, np.random.default_rng(0))
    assert sorted(round(float(o.x[0]), 3) for o in (one, other)) == [-1.0, 1.0]
    assert one.log_prob == pytest.approx(other.log_prob, abs=1e-6)
    run_together = two_peaks(separation=0.05)  # a^2 is known to 0.1: no dip between a and -a
    assert len(find_optima(run_together, NOWHERE, np.random.default_rng(0))) == 1
    with pytest.raises(ValueError, match="start of an optimisation lies outside"):
        find_optima(own, np.array([[np.nan, 0.0]]))


@pytest.mark.parametrize("start", [(-0.5, 0.7), (-0.4, 0.2), (-0.1, 0.9), (0.0, 0.0)])
def test_a_start_on_the_wrong_side_of_a_crossing_finds_the_optimum(start: tuple[float, float]) -> None:
    own = crossing()
    best = find_optima(own, np.array([start]), np.random.default_rng(0))[0]
    assert best.verified
    np.testing.assert_allclose(best.x, [0.4, 0.7], atol=0.01)


def test_an_incomplete_list_has_an_optimum_where_its_complete_part_lies() -> None:
    truth = np.array([0.4, -0.3])
    f = np.delete(MEAN_HZ + SLOPE_HZ @ truth, 2)
    gaps = Measurement(f, 0.0, 0.002, None, ("",) * 3, complete=False)
    own = plate_posterior(LinearModel(), gaps, np.zeros(4))
    best = find_optima(own, NOWHERE, np.random.default_rng(0))[0]
    # the list is met exactly, and no other pairing is near
    np.testing.assert_allclose(best.x, truth, atol=1e-4)
    # its own Gaussian, in a window of five standard deviations: other pairings have optima of their own
    sd = np.sqrt(np.diag(gauss_newton_covariance(own, best.x)))
    edges = tuple(np.linspace(c - 5 * s, c + 5 * s, 201) for c, s in zip(best.x, sd, strict=True))
    assert approximate(own, best).log_evidence == pytest.approx(integral(own, edges), abs=1e-3)


def test_an_optimum_at_the_edge_of_the_constraints_is_found() -> None:
    own = independent((3.0, 7.0))
    below = replace(own, model=replace(own.model, allowed=lambda x: x[:, 0] + x[:, 1] < 0.8))
    best = find_optima(below, NOWHERE, np.random.default_rng(0))[0]
    # the nearest allowed point to (0.3, 0.7) is (0.2, 0.6); polls come to 0.01 standard deviations of it
    np.testing.assert_allclose(best.x, [0.2, 0.6], atol=0.02)


def test_covariance_adds_the_variance_of_the_priors() -> None:
    own = linear_posterior()
    _, covariance = exact_gaussian(measurement(0.01))
    found = gauss_newton_covariance(own, np.array([0.1, 0.2]))
    # 4^2 / 12 is the variance of the uniform priors
    np.testing.assert_allclose(np.linalg.inv(found), np.linalg.inv(covariance) + 0.75 * np.eye(2), rtol=1e-9)


@pytest.mark.parametrize("nu", [np.inf, 5.0])
def test_a_stack_of_evidences_is_what_each_gives_alone(nu: float) -> None:
    """Optima inside, on an edge and in a corner, of one posterior with moved data each."""
    evidences, parts = [], []
    for off in ((4.0, 6.0), (-2.0, 6.0), (-1.0, 13.0)):
        own = independent(off)
        (optimum,) = find_optima(own, NOWHERE, np.random.default_rng(0))
        axes = coordinates(own)
        e = expand_u(own, axes, optimum.u[None])
        parts.append((e.value, e.gradient, e.curvature, optimum.u[None]))
        evidences.append(approximate(own, optimum, "gauss-newton", nu).log_evidence)
    stacked = [np.concatenate(p) for p in zip(*parts, strict=True)]
    np.testing.assert_allclose(laplace_log_evidence(*stacked, axes, nu), evidences, rtol=1e-9)
