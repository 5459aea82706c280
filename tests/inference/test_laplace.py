"""Derivatives of log densities, normal scores, optimisation, and Laplace's method about the optima."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import lsq_linear
from scipy.stats import multivariate_normal, norm, t

from cpam_bayes.inference.laplace import POLISHED, Optima, find_optima, maximised
from cpam_bayes.inference.optimise import maximise, polish
from cpam_bayes.inference.posterior import NOISE_PRIOR, Posterior, gauss_newton_covariance, plate_posterior
from cpam_bayes.inference.scores import Expansion, NormalScores, distinct
from cpam_bayes.mechanics.modes import RigidBodyError
from cpam_bayes.parameters import ScaledStudentT, TruncatedNormal, Uniform
from cpam_bayes.plate import Measurement
from cpam_bayes.priors import Prior
from tests import toy_models
from tests.linear_model import MEAN_HZ, SLOPE_HZ, LinearModel, exact_gaussian, measurement
from tests.toy_models import ToyModel, integral, listed, parameters

ERROR = np.array([1e-3, 2e-3, 1e-3, 3e-3])


def curved(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    slope = np.vstack((SLOPE_HZ, [5.0, 5.0]))
    z = x @ slope.T
    return np.append(MEAN_HZ, 500.0) + z + 0.01 * z**2, (1.0 + 0.02 * z)[:, :, None] * slope


EVEN = Uniform(-2.0, 2.0)
PRIORS = {
    "uniform": parameters(a=EVEN, b=EVEN),
    "normal": parameters(a=TruncatedNormal(0.1, 0.3, -2, 2), b=TruncatedNormal(0, 0.5, -np.inf, np.inf)),
    "student": parameters(a=ScaledStudentT(0.4, 4.0, -2.0, 2.0), b=EVEN),
}
NOISES = {"student noise": {"degrees_of_freedom": 4.0}, "absolute noise": {"likelihood": "absolute"}}
CASES = [*PRIORS, *NOISES, "own deviations", "incomplete"]


def some_posterior(case: str) -> Posterior:
    model, data = ToyModel(PRIORS.get(case, PRIORS["uniform"]), curved), measurement(None, resolution=1.0)
    if case == "own deviations":
        data = listed(data.frequencies, np.array([1.0, 3.0, 2.0, 5.0]))
    if case == "incomplete":
        data = Measurement(data.frequencies[[0, 1, 3]], 1.0, None, None, ("",) * 3, complete=False)
    return plate_posterior(model, data, np.append(ERROR, 1e-3), **NOISES.get(case, {}))


@pytest.mark.parametrize("case", CASES)
def test_gradients_are_limits_of_differences_and_a_stack_gives_what_each_vector_gives(case: str) -> None:
    own = some_posterior(case)
    z = np.random.default_rng(0).normal(size=(12, own.parameters.size))
    x, steps = own.scores.to_x(z), np.eye(z.shape[1])
    e = own.expand(z)
    np.testing.assert_allclose(e.value, own.log_density(z), rtol=1e-12)
    prior = own.scores.log_prior(z) - own.parameters.log_prior(x)  # apart from the scores' Jacobian
    np.testing.assert_allclose(e.value, own.log_prob(x) + prior, rtol=1e-9)

    def differences(h: float) -> np.ndarray:
        up, down = ([own.log_density(z + s * h * step) for step in steps] for s in (1.0, -1.0))
        return np.transpose(np.subtract(up, down)) / (2.0 * h)

    extrapolated = (4.0 * differences(1e-4) - differences(2e-4)) / 3.0
    size = np.abs(e.gradient).max(axis=1, keepdims=True)
    np.testing.assert_array_less(np.abs(e.gradient - extrapolated) / size, 1e-6)  # rounding over the step
    # sums over pairings are differenced: rounding over the square of the step
    near = {"rtol": 1e-9} if own.measurement.complete else {"rtol": 1e-4, "atol": 1e-2}
    together = own.expand_likelihood(x)
    for i in range(5):
        alone = own.expand_likelihood(x[i : i + 1])
        np.testing.assert_allclose(alone.gradient[0], together.gradient[i], **near)
        np.testing.assert_allclose(alone.curvature[0], together.curvature[i], **near)


def test_where_the_constraints_are_broken_the_gradient_is_zero_and_the_model_is_not_asked() -> None:
    own = some_posterior("uniform")

    def asked(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        assert np.all(x[:, 0] < 1.0)
        return curved(x)

    allowed = ToyModel(own.model.parameters, asked, allowed=lambda x: x[:, 0] < 1.0)
    e = replace(own, model=allowed).expand_likelihood(np.array([[1.5, 0.0, 0.01], [0.1, 0.0, 0.01]]))
    np.testing.assert_array_equal(np.isfinite(e.value), [False, True])
    np.testing.assert_array_equal(np.any(e.gradient != 0.0, axis=1), [False, True])


def test_curvature_is_the_expected_one_for_student_t_noise() -> None:
    """Fisher information by quadrature of the squared score, for the location and the log scale."""
    nu, x = 4.0, np.array([[0.3, 0.1, 0.02]])
    own = plate_posterior(LinearModel(), measurement(None), np.zeros(4), degrees_of_freedom=nu)

    def location(z: float) -> float:
        return ((nu + 1) * z / (nu + z**2)) ** 2 * float(t.pdf(z, nu))

    def log_scale(z: float) -> float:
        return ((nu + 1) * z**2 / (nu + z**2) - 1.0) ** 2 * float(t.pdf(z, nu))

    by_location, by_scale = (quad(f, -np.inf, np.inf)[0] for f in (location, log_scale))
    found = own.expand_likelihood(x).curvature[0]
    weighted = SLOPE_HZ / (0.02 * own.measurement.frequencies[:, None])
    np.testing.assert_allclose(found[:2, :2], by_location * weighted.T @ weighted, rtol=1e-7)
    assert found[2, 2] * 0.02**2 == pytest.approx(4 * by_scale, rel=1e-7)


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
        x = scores.to_x(np.array([[z]]))[0, 0]
        share = quad(lambda t: np.exp(prior.log_density(t)), prior.lower, x, epsabs=1e-11, limit=200)[0]
        assert share == pytest.approx(norm.cdf(z), abs=1e-8)
    x = scores.to_x(z := np.linspace(-4.0, 4.0, 33)[:, None])
    assert np.all(np.diff(x[:, 0]) > 0.0)
    # scipy's quantiles of Student's t are accurate to 3e-8 scales about the centre
    np.testing.assert_allclose(scores.to_z(x), z, atol=1e-7)
    z, x = z[[12, 19]], x[[12, 19]]
    np.testing.assert_allclose(scores.slope(x, z), norm.pdf(z) / np.exp(prior.log_density(x)), rtol=1e-9)


def test_scores_are_finite_on_bounds_and_mirrored_where_priors_are() -> None:
    scores = of(*EVERY_PRIOR.values())
    lower, upper = scores.parameters.lower, scores.parameters.upper
    reach = np.where([name.startswith("normal") for name in EVERY_PRIOR], 37.0, 7.0)
    for bound, end in ((lower, -reach), (upper, reach)):
        finite = np.where(np.isfinite(bound), bound, np.sign(bound) * 50.0)
        np.testing.assert_array_equal(scores.to_z(finite[None]), end[None])
    for z in (-9.0, 9.0):
        x = scores.to_x(np.full((1, len(EVERY_PRIOR)), z))
        assert np.all((x >= lower) & (x <= upper))
    z = np.linspace(-6.5, 6.5, 27)[:, None]
    one, mirrored = (of(EVERY_PRIOR[f"normal far in the {side} tail"]) for side in ("upper", "lower"))
    np.testing.assert_allclose(one.to_x(z), -mirrored.to_x(-z), rtol=1e-14)  # 1 - Phi has seven digits


def test_a_likelihood_over_parameters_becomes_a_posterior_over_scores() -> None:
    """Gradient by differences; curvature of a linear model plus its prior."""
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
NEAR = 2.7e-5  # remaining gain 1e-9 over the least curvature 2.9: sqrt(2 * 1e-9 / 2.9)


def least_squares(u: np.ndarray, rows: np.ndarray) -> Expansion:
    """-|A u - b|^2 / 2 with a different b for every optimisation."""
    r = u @ A.T - B[rows]
    return Expansion(-0.5 * np.sum(r**2, axis=1), -r @ A, np.tile(A.T @ A, (len(u), 1, 1)))


def kink(u: np.ndarray, rows: np.ndarray) -> Expansion:
    """A ridge -|8 (x - y)| - ((x + y) / 2 - 0.8)^2: on each side the slope leads into the ridge."""
    x, y = u.T
    middle, side = (x + y) / 2 - 0.8, np.sign(x - y)
    gradient = np.stack((-8.0 * side - middle, 8.0 * side - middle), axis=1)
    return Expansion(-8.0 * np.abs(x - y) - middle**2, gradient, np.full((len(u), 2, 2), 0.5))


def polished(target, u: np.ndarray, at: Expansion) -> tuple[np.ndarray, Expansion, bool]:
    return polish(lambda u: target(u, np.zeros(len(u), dtype=int)).value, target, u, at, LOWER, UPPER)


def test_bounded_least_squares_ends_where_an_independent_program_does_and_outside_the_support_stays() -> None:
    def watched(u: np.ndarray, rows: np.ndarray) -> Expansion:
        assert np.all((u >= LOWER) & (u <= UPPER))
        return least_squares(u, rows)

    start = np.array([[5.0, 5.0], *np.random.default_rng(0).uniform(-1.0, 1.0, size=(2, 2))])
    found = maximise(watched, start, LOWER, UPPER)
    assert found.converged.all()
    for i in range(3):
        expected = lsq_linear(A, B[i], bounds=(LOWER, UPPER), tol=1e-14).x
        np.testing.assert_allclose(found.u[i], expected, atol=NEAR)
    assert np.any(found.u == LOWER)  # one optimum is on a bound
    assert np.any(np.abs(found.u) < 0.9)
    u, _, verified = polished(watched, found.u[0], found.expansion.of(np.array([0])))  # polls keep an optimum
    assert verified
    np.testing.assert_array_equal(u, found.u[0])

    def holed(u: np.ndarray, rows: np.ndarray) -> Expansion:
        found = least_squares(u, rows)
        return Expansion(np.where(u[:, 0] > 0.5, -np.inf, found.value), found.gradient, found.curvature)

    found = maximise(holed, np.array([[0.9, 0.0], [0.0, 0.0]]), LOWER, UPPER)
    assert not found.converged[0]
    np.testing.assert_array_equal(found.u[0], [0.9, 0.0])
    assert np.isfinite(found.expansion.value[1])


def test_steps_that_shrink_at_a_kink_are_seen_through_by_polls() -> None:
    stuck = maximise(kink, np.array([[-0.9, -0.5]]), LOWER, UPPER)
    assert stuck.expansion.value[0] < -0.5  # on the ridge every step loses; the top is 0 at (0.8, 0.8)
    u, found, verified = polished(kink, stuck.u[0], stuck.expansion)
    assert found.value[0] > stuck.expansion.value[0] + 0.4
    assert verified == (found.value[0] > -0.05)
    np.testing.assert_allclose(u, [0.8, 0.8], atol=0.25)


def of_number(z: np.ndarray, value: np.ndarray, curvature: np.ndarray, *, depth: float) -> list[int]:
    """Optimum that each end belongs to, one by one: the first better one within a standard deviation."""
    found = [-1] * len(z)
    for i in np.argsort(-value, kind="stable"):
        if not np.isfinite(value[i]) or value[i] < value.max() - depth:
            continue
        kept = [k for k in np.argsort(-value, kind="stable") if found[k] == k]
        near = [k for k in kept if (z[i] - z[k]) @ curvature[k] @ (z[i] - z[k]) <= 1.0]
        found[i] = int(near[0]) if near else int(i)
    return found


@pytest.mark.parametrize("seed", range(5))
def test_ends_that_are_copies_of_a_better_one_have_its_number_in_a_stack_too(seed: int) -> None:
    rng = np.random.default_rng(seed)
    z, value, roots = (rng.normal(size=(4, 12, *shape)) for shape in ((2,), (), (2, 2)))
    curvature = roots @ np.swapaxes(roots, 2, 3)
    value[0, :3] = -np.inf
    value[1] = -np.inf
    found = distinct(z, value, curvature, 1.0, depth=2.0)
    for i in range(4):
        if i != 1:
            assert found[i].tolist() == of_number(z[i], value[i], curvature[i], depth=2.0)
        np.testing.assert_array_equal(found[i], distinct(z[i], value[i], curvature[i], 1.0, depth=2.0))
    assert np.all(found[1] == -1)
    near = np.array([[0.0], [0.5]]), np.array([0.0, -3.0]), np.ones((2, 1, 1))  # a far lower end is separate
    assert distinct(*near, 1.0).tolist() == [0, 0]
    assert distinct(*near, 1.0, drop=1.0).tolist() == [0, 1]


def optima_of(posterior: Posterior, *known: tuple[float, ...]) -> Optima:
    start = posterior.scores.to_z(np.array(known).reshape(-1, posterior.parameters.size))
    return find_optima(posterior, start, log2_draws=0 if known else None, settings=POLISHED)


MEAN, SD = np.array([0.1, -0.2]), np.array([0.3, 0.5])
A_PRIOR, B_PRIOR = (TruncatedNormal(m, sd, -np.inf, np.inf) for m, sd in zip(MEAN, SD, strict=True))
NORMAL = parameters(a=A_PRIOR, b=B_PRIOR)


def test_evidence_of_a_linear_model_with_normal_priors_is_the_closed_form() -> None:
    data = measurement(0.01)
    own = plate_posterior(LinearModel(NORMAL), data, np.zeros(4))
    optima = optima_of(own)
    assert len(optima.z) == 1
    of_prior = np.diag(SD**2) @ SLOPE_HZ.T
    spread = np.diag((0.01 * data.frequencies) ** 2) + SLOPE_HZ @ of_prior
    off = data.frequencies - MEAN_HZ - SLOPE_HZ @ MEAN
    assert optima.log_mass[0] == pytest.approx(multivariate_normal.logpdf(off, cov=spread), abs=1e-8)
    at = MEAN + of_prior @ np.linalg.solve(spread, off)
    np.testing.assert_allclose(own.scores.to_x(optima.z[0]), at, atol=1e-5)


def test_a_density_less_its_prior_is_the_likelihood_over_scores() -> None:
    own, z = some_posterior("uniform"), np.random.default_rng(0).normal(size=(4, 3))
    left = own.expand(z).without_prior(z, np.ones(3))
    constant = own.scores.log_prior(np.zeros((1, 3)))[0]
    np.testing.assert_allclose(left.value, own.log_likelihood(own.scores.to_x(z)) + constant, rtol=1e-12)
    slope = own.scores.slope(own.scores.to_x(z), z)
    likelihood = own.expand_likelihood(own.scores.to_x(z))
    np.testing.assert_allclose(left.gradient, likelihood.gradient * slope, rtol=1e-9, atol=1e-9)
    curvature = likelihood.curvature * slope[:, :, None] * slope[:, None, :]
    np.testing.assert_allclose(left.curvature, curvature, rtol=1e-9, atol=1e-9)
    own = plate_posterior(LinearModel(NORMAL), measurement(0.05), np.zeros(4))  # maximum likelihood
    z = maximised(own, np.zeros((1, 2)), 60, 1e-12, weight=1.0).z[0]
    np.testing.assert_allclose(own.scores.to_x(z), exact_gaussian(measurement(0.05))[0], atol=1e-5)


def test_noise_that_is_inferred_is_near_a_gaussian_in_its_score() -> None:
    rng = np.random.default_rng(5)
    slope, f = rng.normal(size=(16, 2), scale=10.0), 100.0 * np.arange(10, 26)
    data = listed(f + rng.normal(size=16) * 0.001 * f, None)
    own = plate_posterior(toy_models.linear(f, slope, PRIORS["uniform"]), data, np.zeros(16))
    # with k frequencies the next term of the expansion is about 3 / k
    assert optima_of(own).log_mass[0] == pytest.approx(toy_models.integral_over_noise(own), abs=0.25)


def test_optima_are_as_many_as_the_peaks_that_starts_lead_to() -> None:
    own = toy_models.two_peaks()
    assert len(optima_of(own, (0.9, 0.1)).z) == 1
    assert len(optima_of(own, (0.9, 0.1), (0.8, 0.0), (-0.9, 0.5)).z) == 2
    np.testing.assert_allclose(np.sort(own.scores.to_x(optima_of(own).z)[:, 0]), [-1.0, 1.0], atol=0.01)
    none = replace(own, model=replace(own.model, allowed=lambda x: np.zeros(len(x), dtype=bool)))
    with pytest.raises(RigidBodyError, match="at no start"):
        optima_of(none)


@pytest.mark.parametrize("start", [(-0.5, 0.7), (-0.4, 0.2), (-0.1, 0.9), (0.0, 0.0)])
def test_a_start_on_the_wrong_side_of_a_crossing_finds_the_optimum(start: tuple[float, float]) -> None:
    own = toy_models.crossing()
    optima = find_optima(own, own.scores.to_z(np.array([start])), settings=POLISHED)
    np.testing.assert_allclose(own.scores.to_x(optima.z[0]), [0.4, 0.7], atol=0.01)


def test_an_incomplete_list_has_an_optimum_where_its_complete_part_lies() -> None:
    f = np.delete(MEAN_HZ + SLOPE_HZ @ np.array([0.4, -0.3]), 2)
    gaps = Measurement(f, 0.0, 0.002, None, ("",) * 3, complete=False)
    own = plate_posterior(LinearModel(), gaps, np.zeros(4))
    optima = optima_of(own)
    best = own.scores.to_x(optima.z[0])
    np.testing.assert_allclose(best, [0.4, -0.3], atol=1e-3)  # met exactly; flat priors shift by 1e-3
    sd = np.sqrt(np.diag(gauss_newton_covariance(own, best)))  # other pairings have their own optima
    edges = tuple(np.linspace(c - 5 * s, c + 5 * s, 201) for c, s in zip(best, sd, strict=True))
    assert optima.log_mass[0] == pytest.approx(integral(own, edges), abs=2e-3)


def test_an_optimum_at_the_edge_of_the_constraints_is_found() -> None:
    own, edge = toy_models.independent((3.0, 7.0)), np.linspace((0.1, 0.7), (0.7, 0.1), 601)
    below = replace(own, model=replace(own.model, allowed=lambda x: x[:, 0] + x[:, 1] < 0.8))
    highest = edge[np.argmax(own.log_density(own.scores.to_z(edge)))]
    # polls reach 0.01 standard deviations of 0.1, and along the edge the top is flat
    np.testing.assert_allclose(own.scores.to_x(optima_of(below).z[0]), highest, atol=0.02)


def test_covariance_adds_the_variance_of_the_priors() -> None:
    own = plate_posterior(LinearModel(), measurement(0.01), np.zeros(4))
    _, covariance = exact_gaussian(measurement(0.01))
    found = gauss_newton_covariance(own, np.array([0.1, 0.2]))
    # 4^2 / 12 is the variance of the uniform priors
    np.testing.assert_allclose(np.linalg.inv(found), np.linalg.inv(covariance) + 0.75 * np.eye(2), rtol=1e-9)
