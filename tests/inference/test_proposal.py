"""Proposals that cover a density, and what importance sampling by them is worth."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from cpam_bayes.inference.derivatives import MAX_SCORE, Expansion, NormalScores
from cpam_bayes.inference.posterior import Posterior, plate_posterior
from cpam_bayes.inference.proposal import AdaptationSettings, Proposal, Rounds, adapted, adaptive_importance
from cpam_bayes.inference.student_mixture import (
    Mixture,
    effective_size,
    shrunk_moments,
    staged_importance,
)
from cpam_bayes.parameters import TruncatedNormal, Uniform
from cpam_bayes.priors import Prior
from tests.linear_model import LinearModel, measurement
from tests.toy_models import ToyModel, independent, listed, parameters, two_peaks

BRIEF = AdaptationSettings(draws=600)
# Two components, correlated, over normal scores.
MIXTURE = Mixture(
    np.array([0.7, 0.3]),
    np.array([[-0.5, 0.3], [1.0, -0.8]]),
    np.array([[[0.4, 0.0], [0.2, 0.3]], [[0.3, 0.0], [-0.1, 0.5]]]),
    5.0,
)
BOUNDED = Uniform(-1.0, 3.0)
PRIORS = {
    "two bounds": TruncatedNormal(0.2, 0.5, 0.0, 0.6),
    "a lower bound": TruncatedNormal(0.0, 0.5, 0.1, np.inf),
    "an upper bound": TruncatedNormal(0.0, 0.5, -np.inf, 0.4),
    "no bound": TruncatedNormal(0.0, 0.5, -np.inf, np.inf),
}


def posterior(prior: Prior | None) -> Posterior:
    """One parameter with two bounds, and one with another prior or, for none, the inferred noise."""
    own = parameters(a=BOUNDED) if prior is None else parameters(a=BOUNDED, b=prior)

    def function(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        f = np.stack((100.0 + 5.0 * x[:, 0], 200.0 + 7.0 * x.sum(axis=1)), axis=1)
        return f, np.zeros((*f.shape, own.size))

    sd = None if prior is None else np.ones(2)
    return plate_posterior(ToyModel(own, function), listed(np.array([104.0, 208.0]), sd), np.zeros(2))


def by_hand(prior: Prior | None) -> tuple[Posterior, Proposal]:
    own = posterior(prior)
    return own, Proposal(NormalScores(own.parameters), MIXTURE)


def nodes(proposal: Proposal) -> list[np.ndarray]:
    """Values of each parameter, dense where the density is, up to 1e-12 of the bounds."""
    z = np.linspace(-MAX_SCORE, MAX_SCORE, 1201)
    x = proposal.scores.to_x(np.stack((z, z), axis=1))
    return [x[:, 0], x[:, 1]]


def density(proposal: Proposal, edges: list[np.ndarray]) -> np.ndarray:
    grid = np.stack(np.meshgrid(*edges, indexing="ij"), axis=-1)
    return np.exp(proposal.log_density(grid.reshape(-1, 2))).reshape(grid.shape[:2])


@pytest.mark.parametrize("prior", [*PRIORS.values(), None], ids=[*PRIORS, "the noise"])
def test_the_density_over_the_parameters_integrates_to_one(prior: Prior | None) -> None:
    _, proposal = by_hand(prior)
    edges = nodes(proposal)
    total = np.trapezoid(np.trapezoid(density(proposal, edges), edges[1], axis=1), edges[0])
    # tails beyond 17 hold below 1e-6; the rule leaves 7e-4 at most, an error that falls as its steps squared
    assert total == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("prior", [*PRIORS.values(), None], ids=[*PRIORS, "the noise"])
@pytest.mark.parametrize("make", [np.random.default_rng, np.random.RandomState], ids=["numpy's", "emcee's"])
def test_draws_lie_in_bounds_and_follow_the_density(make: Callable[[int], Any], prior: Prior | None) -> None:
    own, proposal = by_hand(prior)
    n = 20_000
    x = proposal.draw(n, make(0))
    assert np.all((x >= own.parameters.lower) & (x <= own.parameters.upper))
    edges = nodes(proposal)
    height = density(proposal, edges)
    for i in (0, 1):
        marginal = np.trapezoid(height, edges[1 - i], axis=1 - i)
        steps = 0.5 * (marginal[1:] + marginal[:-1]) * np.diff(edges[i])
        below = np.interp(x[:, i], edges[i], np.concatenate(([0.0], np.cumsum(steps))))
        # uniform where the draws have the density: Kolmogorov's bound at 1 in 10 000, and the quadrature
        gap = np.abs(np.sort(below) - (np.arange(n) + 0.5) / n).max()
        assert gap < 2.23 / np.sqrt(n) + 2e-3


def effective_share(own: Posterior, proposal: Proposal) -> float:
    x = proposal.draw(4000, np.random.default_rng(1))
    return effective_size(own.log_prob(x) - proposal.log_density(x)) / 4000


@pytest.mark.parametrize("name", ["a Gaussian", "inferred noise", "a bound", "two peaks"])
def test_an_adapted_proposal_is_near_its_posterior(name: str) -> None:
    own = {
        "a Gaussian": plate_posterior(LinearModel(), measurement(0.01), np.zeros(4)),
        "inferred noise": plate_posterior(LinearModel(), measurement(None), np.zeros(4)),
        "a bound": independent((-1.0, 5.0)),
        "two peaks": two_peaks(),
    }[name]
    start = (
        np.array([[1.0, -0.7], [-1.0, 1.3]])
        if name == "two peaks"
        else np.full((1, own.parameters.size), 0.02)
    )
    found = adapted(own, start, 0, BRIEF)
    # a tenth of the draws is the wide component's
    assert effective_share(own, found) > 0.5


def test_a_seed_fixes_the_proposal_bit_for_bit() -> None:
    own, start = two_peaks(), np.array([[1.0, -0.7]])
    x = own.parameters.sample(np.random.default_rng(2), 20)
    one, again, other = (adapted(own, start, seed, BRIEF).log_density(x) for seed in (3, 3, 4))
    np.testing.assert_array_equal(one, again)
    assert np.any(one != other)


LOG_Z = -12.0
# A standard normal a, b, c seen as (a, SHARP b + BEND a^2, c): the Jacobian is SHARP.
SHARP, BEND = 0.05, 0.7


def straight(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where the standard normal variables are at points (m, 3), and their derivatives (m, 3, 3)."""
    y = np.stack((z[:, 0], (z[:, 1] - BEND * z[:, 0] ** 2) / SHARP, z[:, 2]), axis=1)
    slope = np.tile(np.diag([1.0, 1.0 / SHARP, 1.0]), (len(z), 1, 1))
    slope[:, 1, 0] = -2.0 * BEND * z[:, 0] / SHARP
    return y, slope


def expand(z: np.ndarray) -> Expansion:
    y, slope = straight(z)
    value = LOG_Z - 0.5 * np.sum(y**2, axis=1) - 1.5 * np.log(2.0 * np.pi) - np.log(SHARP)
    return Expansion(value, -np.einsum("mij,mi->mj", slope, y), np.swapaxes(slope, 1, 2) @ slope)


def log_density(points: np.ndarray) -> np.ndarray:
    return expand(points[0]).value[None]


def about_the_optimum() -> Mixture:
    """Laplace's approximation, which lies across the bend."""
    factor = np.linalg.cholesky(np.linalg.inv(expand(np.zeros((1, 3))).curvature))
    return Mixture(np.ones((1, 1)), np.zeros((1, 1, 3)), 1.15 * factor[None], 6.0)


def refit(mixture: Mixture, points: np.ndarray, log_weight: np.ndarray) -> Mixture:
    return shrunk_moments(mixture, points, log_weight, least=1e-3, wider=1.15, prior_points=4.0)


def test_integral_and_moments_of_a_bent_ridge_are_found_where_refitting_alone_does_not() -> None:
    found = adaptive_importance(log_density, expand, about_the_optimum(), refit)
    assert found.log_evidence[0] == pytest.approx(LOG_Z, abs=0.1)
    assert found.effective_size[0] > 400.0
    y, _ = straight(found.points[0])
    np.testing.assert_allclose(found.weight[0] @ y, 0.0, atol=0.2)
    np.testing.assert_allclose(found.weight[0] @ y**2, 1.0, atol=0.3)
    refitted = staged_importance(log_density, about_the_optimum(), 12, (0.125,) * 8, refit)
    assert abs(refitted.log_evidence[0] - LOG_Z) > 0.2


def test_it_ends_as_soon_as_the_points_are_enough() -> None:
    factor = np.linalg.cholesky(np.linalg.inv(expand(np.zeros((1, 3))).curvature))
    gaussian = expand(np.zeros((1, 3)))

    def value(points: np.ndarray) -> np.ndarray:
        squared = np.einsum("mpi,ij,mpj->mp", points, gaussian.curvature[0], points)
        return np.asarray(gaussian.value[0] - 0.5 * squared)

    def of_gaussian(z: np.ndarray) -> Expansion:
        curvature = np.tile(gaussian.curvature, (len(z), 1, 1))
        return Expansion(value(z[None])[0], -z @ gaussian.curvature[0], curvature)

    rounds = Rounds(log2_points=8)
    proposal = Mixture(np.ones((1, 1)), np.zeros((1, 1, 3)), factor[None], 6.0)
    found = adaptive_importance(value, of_gaussian, proposal, refit, rounds)
    assert found.points.shape[1] == rounds.least << rounds.log2_points
    assert found.log_evidence[0] == pytest.approx(LOG_Z, abs=0.02)


def test_points_without_density_have_no_evidence() -> None:
    def nowhere(points: np.ndarray) -> np.ndarray:
        return np.full(points.shape[:2], -np.inf)

    found = adaptive_importance(nowhere, expand, about_the_optimum(), refit)
    assert found.log_evidence[0] == -np.inf
