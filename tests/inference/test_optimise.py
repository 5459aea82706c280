"""Damped Gauss-Newton optimisations within bounds, and the polls that leave false optima."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from cpam_bayes.inference.derivatives import Expansion
from cpam_bayes.inference.optimise import maximise, polish

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


def test_bounded_least_squares_ends_where_an_independent_program_does() -> None:
    start = np.random.default_rng(0).uniform(-1.0, 1.0, size=(3, 2))
    found = maximise(least_squares, start, LOWER, UPPER)
    assert found.converged.all()
    for i in range(3):
        expected = lsq_linear(A, B[i], bounds=(LOWER, UPPER), tol=1e-14).x
        np.testing.assert_allclose(found.u[i], expected, atol=NEAR)
    assert np.any(found.u == LOWER)  # an optimum on bounds is among them
    assert np.any(np.abs(found.u) < 0.9)


def test_no_point_outside_the_bounds_is_asked_for() -> None:
    def watched(u: np.ndarray, rows: np.ndarray) -> Expansion:
        assert np.all((u >= LOWER) & (u <= UPPER))
        return least_squares(u, rows)

    maximise(watched, np.full((3, 2), 5.0), LOWER, UPPER)


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


def test_polls_leave_a_true_optimum_where_it_is() -> None:
    maxima = maximise(least_squares, np.zeros((1, 2)), LOWER, UPPER)

    def value(u: np.ndarray) -> np.ndarray:
        return least_squares(u, np.zeros(len(u), dtype=int)).value

    u, _, verified = polish(value, least_squares, maxima, 0, LOWER, UPPER)
    assert verified
    np.testing.assert_array_equal(u, maxima.u[0])
    assert pytest.approx(lsq_linear(A, B[0], bounds=(LOWER, UPPER)).x, abs=NEAR) == u
