"""What a wider prior of one constant does to the interval of another."""

from __future__ import annotations

import numpy as np
import pytest

from cpam_bayes.identification.reliance import LEAST_WIDENING, reliances

NAMES = ("E1", "E2", "nu12")
PRIOR_SD = np.array([50.0, 1.0, 0.03])
# Frequencies of a cross-ply: they determine E1 + E2, and nothing of nu12.
SUM = np.array([[1.0, 1.0, 0.0]]) / 0.5


def posterior(prior_sd: np.ndarray) -> np.ndarray:
    return np.linalg.inv(SUM.T @ SUM + np.diag(prior_sd**-2.0))


def test_the_widening_is_that_of_the_posterior_with_a_prior_of_twice_the_width() -> None:
    now = posterior(PRIOR_SD)
    found = {(r.name, r.on): r.widening for r in reliances(NAMES, now, PRIOR_SD)}
    then = posterior(PRIOR_SD * np.array([1.0, 2.0, 1.0]))
    expected = np.sqrt(then[0, 0] / now[0, 0]) - 1.0
    assert expected > 0.5
    assert found == {("E1", "E2"): pytest.approx(expected, rel=1e-9)}


def test_a_constant_that_the_data_determine_feeds_no_other() -> None:
    both = np.diag([1.0, 0.01, 1e-6])
    both[0, 1] = both[1, 0] = 0.9 * np.sqrt(both[0, 0] * both[1, 1])
    assert reliances(NAMES, both, PRIOR_SD) == ()


def test_what_else_widens_an_interval_leaves_less_to_the_prior() -> None:
    now = posterior(PRIOR_SD)
    wide = np.sqrt(np.diag(now)) * 10.0
    assert reliances(NAMES, now, PRIOR_SD, wide) == ()
    ((alone,), (less,)) = (reliances(NAMES, now, PRIOR_SD, sd) for sd in (None, np.sqrt(np.diag(now)) * 1.5))
    assert LEAST_WIDENING <= less.widening < alone.widening


def test_a_covariance_that_is_not_known_says_nothing() -> None:
    assert reliances(NAMES, np.full((3, 3), np.nan), PRIOR_SD) == ()
