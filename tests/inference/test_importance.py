"""Importance sampling of stacks of densities: evidence, error, effective size and k-hat."""

from __future__ import annotations

import arviz
import numpy as np
import pytest

from cpam_bayes.inference.importance import (
    Weighted,
    effective_size,
    pareto_shape,
    staged_importance,
    weighted,
)
from cpam_bayes.inference.student_mixture import Mixture, log_mixture, shrunk_moments

LOG_Z = np.array([0.0, -40.0, 300.0])


def target(z: np.ndarray) -> np.ndarray:
    """Three densities of two variables whose integrals are known: Gaussians of other widths."""
    width = np.array([1.0, 0.5, 2.0])[:, None]
    squared = np.sum((z - 0.3) ** 2, axis=2) / width**2
    return LOG_Z[:, None] - 0.5 * squared - np.log(2.0 * np.pi) - 2.0 * np.log(width)


def proposal(freedom: float = 5.0) -> Mixture:
    share = np.tile([0.7, 0.3, 0.0], (3, 1))
    centre = np.tile([[0.0, 0.0], [1.0, 0.5], [9.0, 9.0]], (3, 1, 1))
    return Mixture(share, centre, np.tile(np.eye(2), (3, 3, 1, 1)), freedom)


def refit(mixture: Mixture, points: np.ndarray, log_weight: np.ndarray) -> Mixture:
    return shrunk_moments(mixture, points, log_weight, least=0.1, wider=1.1, prior_points=3.0)


@pytest.mark.parametrize("stages", [(1.0,), (0.25, 0.25, 0.5)], ids=["at once", "refitted"])
def test_evidences_of_a_stack_are_found_within_their_errors(stages: tuple[float, ...]) -> None:
    found = staged_importance(target, proposal(), 11, stages, refit)
    assert np.all(np.abs(found.log_evidence - LOG_Z) < 4.0 * found.standard_error)
    assert np.all(found.standard_error < 0.04)
    assert np.all(found.k_hat < 0.7)
    np.testing.assert_allclose(found.weight.sum(axis=1), 1.0, rtol=1e-12)


def test_refitting_makes_the_weights_more_even() -> None:
    once, thrice = (staged_importance(target, proposal(), 11, s, refit) for s in ((1.0,), (0.25, 0.25, 0.5)))
    assert np.all(thrice.effective_size[1:] > 1.2 * once.effective_size[1:])


def test_a_stack_is_what_each_density_gives_alone() -> None:
    together = staged_importance(target, proposal(), 9, (0.5, 0.5), refit)
    for i in range(3):
        p = proposal()
        own = Mixture(p.share[[i]], p.centre[[i]], p.factor[[i]], p.degrees_of_freedom)
        alone = staged_importance(
            lambda z, i=i: target(np.repeat(z, 3, axis=0))[[i]], own, 9, (0.5, 0.5), refit
        )
        for name in Weighted.__slots__:
            np.testing.assert_allclose(getattr(alone, name)[0], getattr(together, name)[i], rtol=1e-9)


def test_a_gaussian_proposal_that_is_the_target_leaves_no_error() -> None:
    gaussian = Mixture(np.ones((1, 1)), np.zeros((1, 1, 3)), np.eye(3)[None, None], np.inf)
    found = staged_importance(lambda z: log_mixture(gaussian, z) + 2.0, gaussian, 6)
    np.testing.assert_allclose(found.log_evidence, 2.0, atol=1e-12)
    np.testing.assert_allclose(found.effective_size, 64.0, rtol=1e-9)
    assert found.standard_error[0] < 1e-12


def test_points_without_density_have_no_evidence() -> None:
    found = weighted(np.zeros((2, 4, 1)), np.array([[-np.inf] * 4, [0.0, 0.0, -np.inf, -np.inf]]))
    np.testing.assert_allclose(found.log_evidence, [-np.inf, np.log(0.5)])
    assert found.effective_size[1] == pytest.approx(2.0)
    assert effective_size(np.full(4, -np.inf)) == 0.0


@pytest.mark.parametrize("n", [25, 128, 512, 20_000])
@pytest.mark.parametrize("seed", range(5))
def test_k_hat_is_that_of_arviz(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    log_weight = rng.standard_normal(n) * rng.uniform(0.1, 4.0) - 700.0
    _, k_hat = arviz.psislw(log_weight.copy())
    assert pareto_shape(log_weight) == pytest.approx(float(k_hat), rel=1e-9)


@pytest.mark.parametrize("shape", [0.2, 0.5, 0.9])
def test_k_hat_is_the_shape_of_pareto_weights(shape: float) -> None:
    uniform = (np.arange(40_000) + 0.5) / 40_000
    # 425 weights in the tail, the prior counts as 10 of them
    assert pareto_shape(-shape * np.log(uniform)) == pytest.approx(shape, abs=0.1)
