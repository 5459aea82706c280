"""Coordinates without bounds: there and back, and their Jacobian."""

from __future__ import annotations

import numpy as np
from scipy.special import expit

from cpam_bayes.inference.derivatives import Coordinates
from cpam_bayes.inference.unbounded import whole_line

LOWER, UPPER = np.array([-1.0, 2.0, -np.inf, -np.inf]), np.array([3.0, np.inf, 0.5, np.inf])
LINE = whole_line(Coordinates(np.ones(4), np.zeros(4, dtype=bool), LOWER, UPPER, LOWER, UPPER))


def test_points_come_back_and_keep_to_the_bounds() -> None:
    v = np.random.default_rng(0).normal(size=(200, 4), scale=4.0)
    u = LINE.to_u(v)
    assert np.all((u >= LOWER) & (u <= UPPER))
    # next to an upper bound u has digits to 1e-16, of which v = log of the distance keeps 1e-16 e^|v|
    np.testing.assert_allclose(LINE.to_v(u), v, rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(u[:, 0], -1.0 + 4.0 * expit(v[:, 0]), rtol=1e-13)
    np.testing.assert_allclose(u[:, 1], 2.0 + np.exp(v[:, 1]), rtol=1e-13)
    np.testing.assert_allclose(u[:, 2], 0.5 - np.exp(-v[:, 2]), rtol=1e-13, atol=1e-13)
    np.testing.assert_array_equal(u[:, 3], v[:, 3])


def test_jacobian_is_the_limit_of_differences() -> None:
    v = np.random.default_rng(1).normal(size=(50, 4))
    h = 1e-5
    slope = (LINE.to_u(v + h) - LINE.to_u(v - h)) / (2 * h)
    np.testing.assert_allclose(LINE.log_jacobian(v), np.log(slope).sum(axis=1), atol=1e-8)


def test_bounds_themselves_have_a_place() -> None:
    v = LINE.to_v(np.array([[-1.0, 2.0, 0.5, 7.0], [3.0, 2.0, 0.5, -7.0]]))
    assert np.all(np.isfinite(v))
    np.testing.assert_allclose(LINE.to_u(v)[0], [-1.0, 2.0, 0.5, 7.0], atol=1e-10)
