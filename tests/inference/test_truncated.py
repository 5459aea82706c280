"""Mass and draws of Gaussians and Student-t densities between bounds."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import log_ndtr
from scipy.stats import chi2, multivariate_normal, multivariate_t, norm

from cpam_bayes.inference.student_mixture import log_student_t
from cpam_bayes.inference.truncated import box_draws, log_box_mass

CENTRE = np.array([0.3, -0.5, 0.8])
SCALE = np.array([[1.0, 0.6, -0.2], [0.6, 2.0, 0.5], [-0.2, 0.5, 0.7]])
LOWER, UPPER = np.array([-1.0, -np.inf, 0.0]), np.array([2.0, 0.4, np.inf])


def test_gaussian_mass_is_that_of_an_independent_program() -> None:
    expected = multivariate_normal.cdf(UPPER, CENTRE, SCALE, lower_limit=LOWER, abseps=1e-8, releps=1e-8)
    # the error of 2^10 points that the docstring states
    assert log_box_mass(CENTRE[None], SCALE[None], LOWER, UPPER)[0] == pytest.approx(
        np.log(expected), abs=1e-3
    )


def test_a_stack_gives_what_each_gives_alone() -> None:
    centres, scales = np.stack((CENTRE, -CENTRE)), np.stack((SCALE, 3.0 * SCALE))
    together = log_box_mass(centres, scales, LOWER, UPPER)
    for i in range(2):
        alone = log_box_mass(centres[i : i + 1], scales[i : i + 1], LOWER, UPPER)
        assert together[i] == pytest.approx(alone[0], abs=1e-12)


def test_student_t_mass_is_that_of_the_gaussians_it_mixes() -> None:
    nu, sd = 5.0, np.array([1.0, 0.5])
    lower, upper = np.array([-0.3, -1.0]), np.array([2.0, 0.2])

    def given(w: float) -> float:
        z = np.sqrt(w / nu)
        return float(np.prod(norm.cdf(upper / sd * z) - norm.cdf(lower / sd * z)) * chi2.pdf(w, nu))

    expected = np.log(quad(given, 0.0, np.inf)[0])
    found = log_box_mass(np.zeros((1, 2)), np.diag(sd**2)[None], lower, upper, nu)
    assert found[0] == pytest.approx(expected, abs=1e-3)


def test_a_box_far_in_the_tail_keeps_its_digits() -> None:
    centre = np.array([[60.0, -40.0]])
    found = log_box_mass(centre, np.eye(2)[None], np.full(2, -np.inf), np.array([0.0, np.inf]))
    assert found[0] == pytest.approx(float(log_ndtr(-60.0)), rel=1e-12)


def test_student_t_density_is_that_of_an_independent_program() -> None:
    x = np.random.default_rng(0).normal(size=(20, 3))
    factor = np.linalg.cholesky(SCALE)
    expected = multivariate_t(CENTRE, SCALE, df=4.0).logpdf(x)
    np.testing.assert_allclose(log_student_t(x - CENTRE, factor, 4.0), expected, rtol=1e-12)
    gaussian = multivariate_normal(CENTRE, SCALE).logpdf(x)
    np.testing.assert_allclose(log_student_t(x - CENTRE, factor, np.inf), gaussian, rtol=1e-12)


@pytest.mark.parametrize("nu", [np.inf, 5.0])
def test_draws_lie_between_the_bounds_and_their_density_is_normalised(nu: float) -> None:
    rng = np.random.default_rng(1)
    x, log_q = box_draws(CENTRE, SCALE, LOWER, UPPER, nu, 40_000, rng)
    assert np.all((x >= LOWER) & (x <= UPPER))
    ratio = np.exp(log_student_t(x - CENTRE, np.linalg.cholesky(SCALE), nu) - log_q)
    mass = np.exp(log_box_mass(CENTRE[None], SCALE[None], LOWER, UPPER, nu, 14)[0])
    # importance sampling with these draws gives the mass: four of its standard errors
    assert ratio.mean() == pytest.approx(mass, abs=4.0 * ratio.std() / np.sqrt(len(x)))
