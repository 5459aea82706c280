"""Importance sampling along bent ridges and beside known optima, against densities of known integral."""

from __future__ import annotations

import numpy as np
import pytest

from cpam_bayes.inference.adaptive_importance import Rounds, adaptive_importance
from cpam_bayes.inference.derivatives import Expansion
from cpam_bayes.inference.importance import staged_importance
from cpam_bayes.inference.student_mixture import Mixture, shrunk_moments

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


def test_the_integral_along_a_bent_ridge_is_found_where_refitting_alone_does_not() -> None:
    found = adaptive_importance(log_density, expand, about_the_optimum(), refit)
    assert found.log_evidence[0] == pytest.approx(LOG_Z, abs=0.1)
    assert found.effective_size[0] > 400.0
    refitted = staged_importance(log_density, about_the_optimum(), 12, (0.125,) * 8, refit)
    assert abs(refitted.log_evidence[0] - LOG_Z) > 0.2


def test_moments_are_those_of_the_ridge() -> None:
    found = adaptive_importance(log_density, expand, about_the_optimum(), refit)
    y, _ = straight(found.points[0])
    np.testing.assert_allclose(found.weight[0] @ y, 0.0, atol=0.2)
    np.testing.assert_allclose(found.weight[0] @ y**2, 1.0, atol=0.3)


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
