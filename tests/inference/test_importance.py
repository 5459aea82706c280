"""Mixtures of Student-t densities, proposals made from them, and importance sampling with these."""

import numpy as np
import pytest
from arviz_stats.base import array_stats
from scipy.stats import multivariate_t

from cpam_bayes.inference.importance import Proposal, Rounds, importance
from cpam_bayes.inference.posterior import Posterior, plate_posterior
from cpam_bayes.inference.sampling import JUMPS, sampled_about
from cpam_bayes.inference.scores import Expansion
from cpam_bayes.inference.student_mixture import Mixture, effective_size, log_mixture, pareto_shape, weighted
from cpam_bayes.parameters import TruncatedNormal, Uniform
from cpam_bayes.priors import Prior
from tests.linear_model import LinearModel, measurement
from tests.toy_models import ToyModel, independent, listed, parameters, two_peaks

CENTRE = np.array([0.3, -0.5, 0.8])
SCALE = np.array([[1.0, 0.6, -0.2], [0.6, 2.0, 0.5], [-0.2, 0.5, 0.7]])


@pytest.mark.parametrize("nu", [np.inf, 4.0])
def test_density_is_the_weighted_sum_of_parts_by_an_independent_program(nu: float) -> None:
    share, centres, scales = np.array([0.3, 0.7]), (CENTRE, -CENTRE), (SCALE, 3.0 * SCALE)
    x = np.random.default_rng(0).normal(size=(30, 3), scale=3.0)
    parts = [multivariate_t(c, s, df=nu).pdf(x) for c, s in zip(centres, scales, strict=True)]
    found = log_mixture(Mixture(share, np.stack(centres), np.linalg.cholesky(scales), nu), x)
    np.testing.assert_allclose(found, np.log(share @ parts), rtol=1e-12)


LOG_OF = np.array([0.0, -40.0, 300.0])


def target(z: np.ndarray) -> np.ndarray:
    """Three densities of two variables with known integrals: Gaussians of different widths."""
    width = np.array([1.0, 0.5, 2.0])[:, None]
    squared = np.sum((z - 0.3) ** 2, axis=2) / width**2
    return LOG_OF[:, None] - 0.5 * squared - np.log(2.0 * np.pi) - 2.0 * np.log(width)


ALL_ROUNDS = Rounds(9, most=4, enough=np.inf, good=np.inf, least_share=0.1, wider=1.1, prior_points=3.0)


def test_evidences_of_a_stack_are_found_within_their_errors_and_refitting_makes_weights_more_even() -> None:
    centre = np.tile([[0.0, 0.0], [1.0, 0.5], [9.0, 9.0]], (3, 1, 1))
    proposal = Mixture(np.tile([0.7, 0.3, 0.0], (3, 1)), centre, np.tile(np.eye(2), (3, 3, 1, 1)), 5.0)
    one_round = Rounds(11, most=1, least=1)
    (once, _), (again, mixtures) = (importance(target, proposal, of) for of in (one_round, ALL_ROUNDS))
    for found in (once, again):
        assert found.points.shape == (3, 2048, 2)
        assert np.all(np.abs(found.log_evidence - LOG_OF) < 4.0 * found.standard_error)
        assert np.all(found.standard_error < 0.04)
        assert np.all(found.k_hat < 0.7)
        weight = found.weight
        np.testing.assert_allclose(weight.sum(axis=1), 1.0, rtol=1e-12)
        np.testing.assert_allclose(found.effective_size, 1.0 / np.sum(weight**2, axis=1), rtol=1e-9)
        np.testing.assert_allclose(found.standard_error, weight.std(axis=1) * 2**5.5, rtol=1e-9)
        np.testing.assert_allclose(found.k_hat, [pareto_shape(w) for w in np.log(weight)], rtol=1e-9)
    assert np.all(again.effective_size[1:] > 1.2 * once.effective_size[1:])
    # each density gives what it gives alone
    second = Mixture(proposal.share[1:2], proposal.centre[1:2], proposal.factor[1:2], 5.0)

    def of_second(z: np.ndarray) -> np.ndarray:
        return target(np.repeat(z, 3, axis=0))[1:2]

    alone, mixture = importance(of_second, second, ALL_ROUNDS)
    np.testing.assert_allclose(alone.log_evidence[0], again.log_evidence[1], rtol=1e-12)
    np.testing.assert_allclose(mixture.factor[0], mixtures.factor[1], rtol=1e-9)


def test_a_gaussian_proposal_that_is_the_target_leaves_no_error() -> None:
    gaussian = Mixture(np.ones((1, 1)), np.zeros((1, 1, 3)), np.eye(3)[None, None], np.inf)
    found, left = importance(lambda z: log_mixture(gaussian, z) + 2.0, gaussian, Rounds(6, most=1))
    np.testing.assert_allclose(found.log_evidence, 2.0, atol=1e-12)
    np.testing.assert_allclose(found.effective_size, 64.0, rtol=1e-9)
    assert found.standard_error[0] < 1e-12
    np.testing.assert_array_equal(left.factor, gaussian.factor)


# a fifth, or three roots, of these sizes is an integer: arviz rounds the size of the tail down, we up
@pytest.mark.parametrize("n", [40, 125, 900, 10_000])
@pytest.mark.parametrize("seed", range(5))
def test_k_hat_is_that_of_arviz(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    log_weight = rng.standard_normal(n) * rng.uniform(0.1, 4.0) - 700.0
    _, k_hat = array_stats.psislw(-log_weight)  # takes log likelihoods
    assert pareto_shape(log_weight) == pytest.approx(float(k_hat), rel=1e-9)


# Two correlated components over normal scores.
FACTORS = np.array([[[0.4, 0.0], [0.2, 0.3]], [[0.3, 0.0], [-0.1, 0.5]]])
MIXTURE = Mixture(np.array([0.7, 0.3]), np.array([[-0.5, 0.3], [1.0, -0.8]]), FACTORS, 5.0)
BOUNDED = Uniform(-1.0, 3.0)
BOUNDS = {"two bounds": (0.0, 0.6), "a lower bound": (0.1, np.inf), "an upper bound": (-np.inf, 0.4)}
PRIORS = {name: TruncatedNormal(0.2, 0.5, *bounds) for name, bounds in BOUNDS.items()}
PRIORS["no bound"] = TruncatedNormal(0.0, 0.5, -np.inf, np.inf)


def posterior(prior: Prior | None) -> Posterior:
    """Posterior of a bounded parameter and one with another prior, or for None with inferred noise."""
    own = parameters(a=BOUNDED) if prior is None else parameters(a=BOUNDED, b=prior)

    def function(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        f = np.stack((100.0 + 5.0 * x[:, 0], 200.0 + 7.0 * x.sum(axis=1)), axis=1)
        return f, np.zeros((*f.shape, own.size))

    sd = None if prior is None else np.ones(2)
    return plate_posterior(ToyModel(own, function), listed(np.array([104.0, 208.0]), sd), np.zeros(2))


@pytest.mark.parametrize("prior", [*PRIORS.values(), None], ids=[*PRIORS, "the noise"])
@pytest.mark.parametrize("make", [np.random.default_rng, np.random.RandomState], ids=["numpy's", "emcee's"])
def test_densities_integrate_to_one_and_draws_lie_in_bounds_and_follow_them(make, prior) -> None:
    own = posterior(prior)
    proposal, n = Proposal(own.scores, MIXTURE), 20_000
    x = proposal.draw(n, make(0))
    assert np.all((x >= own.parameters.lower) & (x <= own.parameters.upper))
    z = np.linspace(-7.0, 7.0, 1201)  # values dense where the density is, up to 1e-12 of the bounds
    edges = proposal.scores.to_x(np.stack((z, z), axis=1)).T
    grid = np.stack(np.meshgrid(*edges, indexing="ij"), axis=-1)
    height = np.exp(proposal.log_density(grid.reshape(-1, 2))).reshape(grid.shape[:2])
    total = np.trapezoid(np.trapezoid(height, edges[1], axis=1), edges[0])
    assert total == pytest.approx(1.0, abs=1e-3)  # tails hold below 1e-6; the rule leaves 7e-4 at most
    for i in (0, 1):
        marginal = np.trapezoid(height, edges[1 - i], axis=1 - i)
        steps = 0.5 * (marginal[1:] + marginal[:-1]) * np.diff(edges[i])
        below = np.interp(x[:, i], edges[i], np.concatenate(([0.0], np.cumsum(steps))))
        gap = np.abs(np.sort(below) - (np.arange(n) + 0.5) / n).max()  # Kolmogorov at 1 in 10 000
        assert gap < 2.23 / np.sqrt(n) + 2e-3


POSTERIORS = {
    "a Gaussian": plate_posterior(LinearModel(), measurement(0.01), np.zeros(4)),
    "inferred noise": plate_posterior(LinearModel(), measurement(None), np.zeros(4)),
    "a bound": independent((-1.0, 5.0)),
    "two peaks": two_peaks(),
}


@pytest.mark.parametrize("own", POSTERIORS.values(), ids=POSTERIORS)
def test_the_proposal_that_is_left_is_near_its_posterior(own: Posterior) -> None:
    found = sampled_about(own, np.empty((0, own.parameters.size)), JUMPS)[0]
    x = found.draw(4000, np.random.default_rng(1))
    assert effective_size(own.log_prob(x) - found.log_density(x)) > 0.5 * 4000


LOG_Z = -12.0
SHARP, BEND = 0.05, 0.7  # standard normal a, b, c seen as (a, SHARP b + BEND a^2, c); Jacobian SHARP


def straight(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Standard normal variables at points (m, 3), and their derivatives (m, 3, 3)."""
    y = np.stack((z[:, 0], (z[:, 1] - BEND * z[:, 0] ** 2) / SHARP, z[:, 2]), axis=1)
    slope = np.tile(np.diag([1.0, 1.0 / SHARP, 1.0]), (len(z), 1, 1))
    slope[:, 1, 0] = -2.0 * BEND * z[:, 0] / SHARP
    return y, slope


def expand(z: np.ndarray) -> Expansion:
    y, slope = straight(z)
    value = LOG_Z - 0.5 * np.sum(y**2, axis=1) - 1.5 * np.log(2.0 * np.pi) - np.log(SHARP)
    return Expansion(value, -np.einsum("mij,mi->mj", slope, y), np.swapaxes(slope, 1, 2) @ slope)


CURVATURE = expand(np.zeros((1, 3))).curvature
FACTOR = np.linalg.cholesky(np.linalg.inv(CURVATURE))[None]
LAPLACE = Mixture(np.ones((1, 1)), np.zeros((1, 1, 3)), 1.15 * FACTOR, 6.0)  # across the bend


def test_integral_and_moments_of_a_bent_ridge_are_found_where_refitting_alone_fails_and_of_a_gaussian_soon():
    def log_density(points: np.ndarray) -> np.ndarray:
        return expand(points[0]).value[None]

    found, _ = importance(log_density, LAPLACE, expand=expand)
    assert found.log_evidence[0] == pytest.approx(LOG_Z, abs=0.1)
    assert found.effective_size[0] > 400.0
    y, _ = straight(found.points[0])
    np.testing.assert_allclose(found.weight[0] @ y, 0.0, atol=0.2)
    np.testing.assert_allclose(found.weight[0] @ y**2, 1.0, atol=0.3)
    refitted, _ = importance(log_density, LAPLACE, Rounds(9, most=8, enough=np.inf))
    assert abs(refitted.log_evidence[0] - LOG_Z) > 0.2

    # for a Gaussian it ends as soon as there are enough points
    def of_gaussian(z: np.ndarray) -> Expansion:
        value = expand(np.zeros((1, 3))).value - 0.5 * np.einsum("mi,ij,mj->m", z, CURVATURE[0], z)
        return Expansion(value, -z @ CURVATURE[0], np.tile(CURVATURE, (len(z), 1, 1)))

    rounds, proposal = Rounds(log2_points=8), Mixture(LAPLACE.share, LAPLACE.centre, FACTOR, 6.0)
    found, _ = importance(lambda points: of_gaussian(points[0]).value[None], proposal, rounds, of_gaussian)
    assert found.points.shape[1] == rounds.least << rounds.log2_points
    assert found.log_evidence[0] == pytest.approx(LOG_Z, abs=0.02)


def test_points_without_density_have_no_weight_and_no_evidence() -> None:
    found = weighted(np.zeros((2, 4, 1)), np.array([[-np.inf] * 4, [0.0, 0.0, -np.inf, -np.inf]]))
    np.testing.assert_allclose(found.log_evidence, [-np.inf, np.log(0.5)])
    assert found.effective_size[1] == pytest.approx(2.0)
    assert effective_size(np.full(4, -np.inf)) == 0.0
    nowhere, _ = importance(lambda points: np.full(points.shape[:2], -np.inf), LAPLACE, expand=expand)
    assert nowhere.log_evidence[0] == -np.inf
