"""Mixtures of Student-t densities, their mass between bounds, and importance sampling by them."""

import numpy as np
import pytest
from arviz_stats.base import array_stats
from scipy.integrate import quad
from scipy.special import log_ndtr
from scipy.stats import chi2, multivariate_normal, multivariate_t, norm

from cpam_bayes.inference.student_mixture import (
    Mixture,
    Weighted,
    box_draws,
    draw,
    effective_size,
    fit,
    log_box_mass,
    log_mixture,
    log_student_t,
    pareto_shape,
    shrunk_moments,
    single,
    split,
    staged_importance,
    weighted,
    widened,
)

PAIR = Mixture(
    np.array([0.3, 0.7]),
    np.array([[-3.0, 0.0], [3.0, 1.0]]),
    np.linalg.cholesky(np.array([[[1.0, 0.3], [0.3, 0.5]], [[0.4, 0.0], [0.0, 2.0]]])),
    5.0,
)


def test_density_is_the_weighted_sum_of_its_parts() -> None:
    x = np.random.default_rng(0).normal(size=(30, 2), scale=3.0)
    parts = [
        s * multivariate_t(c, f @ f.T, df=5.0).pdf(x)
        for s, c, f in zip(PAIR.share, PAIR.centre, PAIR.factor, strict=True)
    ]
    np.testing.assert_allclose(np.exp(log_mixture(PAIR, x)), np.sum(parts, axis=0), rtol=1e-10)


def test_draws_have_the_moments_of_the_mixture() -> None:
    x = draw(PAIR, 40_000, np.random.default_rng(1))
    mean = PAIR.share @ PAIR.centre
    # covariance of a t of 5 degrees of freedom: 5 / 3 of its scale, and that of the centres
    scale = np.einsum("k,kij,klj->il", PAIR.share, PAIR.factor, PAIR.factor) * 5.0 / 3.0
    away = PAIR.centre - mean
    covariance = scale + np.einsum("k,ki,kj->ij", PAIR.share, away, away)
    error = np.sqrt(np.diag(covariance) / len(x))
    np.testing.assert_array_less(np.abs(x.mean(axis=0) - mean), 4.0 * error)
    # fourth moments of these t densities are large: a few percent
    np.testing.assert_allclose(np.cov(x.T), covariance, rtol=0.05, atol=0.1)


def test_a_fit_finds_the_parts_that_draws_come_from() -> None:
    x = draw(PAIR, 8000, np.random.default_rng(2))
    even = np.full(len(x), 1.0 / len(x))
    start = split(single(x, even, 5.0), x, even, 2)
    found = fit(start, x, even, 60)
    order = np.argsort(found.centre[:, 0])
    # 2400 points in the smaller part: about 2 % of a standard deviation, 3 % of a variance
    np.testing.assert_allclose(found.share[order], PAIR.share, atol=0.02)
    np.testing.assert_allclose(found.centre[order], PAIR.centre, atol=0.15)
    scales = found.factor[order] @ np.swapaxes(found.factor[order], 1, 2)
    np.testing.assert_allclose(scales, PAIR.factor @ np.swapaxes(PAIR.factor, 1, 2), atol=0.15)


def test_a_part_whose_axes_differ_by_many_orders_of_magnitude_is_halved() -> None:
    factor = np.array([[1e11, 0.0], [1e10, 1e-3]])  # its smallest eigenvalue is lost in rounding
    points = np.array([[1e11, 0.0], [-1e11, 0.1]])
    halved = split(Mixture(np.ones(1), np.zeros((1, 2)), factor[None], 8.0), points, np.full(2, 0.5), 2)
    assert np.all(np.isfinite(halved.centre))
    assert np.ptp(halved.centre[:, 0]) > 1e11


def test_weights_count_like_repeated_points() -> None:
    x = draw(PAIR, 300, np.random.default_rng(3))
    times = np.arange(300) % 3 + 1
    weights = times / times.sum()
    repeated = np.repeat(x, times, axis=0)
    even = np.full(len(repeated), 1.0 / len(repeated))
    one, other = fit(PAIR, x, weights, 5), fit(PAIR, repeated, even, 5)
    np.testing.assert_allclose(one.centre, other.centre, rtol=1e-9)
    np.testing.assert_allclose(one.factor, other.factor, rtol=1e-8, atol=1e-12)


def test_a_wide_component_takes_its_share_and_lowers_no_other_further() -> None:
    x = draw(PAIR, 2000, np.random.default_rng(4))
    even = np.full(len(x), 1.0 / len(x))
    wide = widened(PAIR, 0.1, 2.0, x, even)
    assert wide.share.sum() == pytest.approx(1.0)
    assert np.all(log_mixture(wide, x) >= log_mixture(PAIR, x) + np.log(0.9))
    far = np.array([[40.0, -40.0]])
    assert log_mixture(wide, far)[0] > log_mixture(PAIR, far)[0] + 1.0


CENTRE = np.array([0.3, -0.5, 0.8])
SCALE = np.array([[1.0, 0.6, -0.2], [0.6, 2.0, 0.5], [-0.2, 0.5, 0.7]])
LOWER, UPPER = np.array([-1.0, -np.inf, 0.0]), np.array([2.0, 0.4, np.inf])


def test_gaussian_masses_of_a_stack_are_those_of_an_independent_program() -> None:
    centres, scales = np.stack((CENTRE, -CENTRE)), np.stack((SCALE, 3.0 * SCALE))
    found = log_box_mass(centres, scales, LOWER, UPPER)
    for i, (centre, scale) in enumerate(zip(centres, scales, strict=True)):
        expected = multivariate_normal.cdf(UPPER, centre, scale, lower_limit=LOWER, abseps=1e-8, releps=1e-8)
        # the error of 2^10 points that the docstring states
        assert found[i] == pytest.approx(np.log(expected), abs=1e-3)
        alone = log_box_mass(centre[None], scale[None], LOWER, UPPER)
        assert found[i] == pytest.approx(alone[0], abs=1e-12)


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


def test_evidences_of_a_stack_are_found_within_their_errors_and_refitting_makes_weights_more_even() -> None:
    once, thrice = (staged_importance(target, proposal(), 11, s, refit) for s in ((1.0,), (0.25, 0.25, 0.5)))
    for found in (once, thrice):
        assert np.all(np.abs(found.log_evidence - LOG_Z) < 4.0 * found.standard_error)
        assert np.all(found.standard_error < 0.04)
        assert np.all(found.k_hat < 0.7)
        np.testing.assert_allclose(found.weight.sum(axis=1), 1.0, rtol=1e-12)
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


# sizes of which a fifth, or three roots, is a whole number: arviz rounds the number of the tail down, we up
@pytest.mark.parametrize("n", [40, 125, 900, 10_000])
@pytest.mark.parametrize("seed", range(5))
def test_k_hat_is_that_of_arviz(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    log_weight = rng.standard_normal(n) * rng.uniform(0.1, 4.0) - 700.0
    _, k_hat = array_stats.psislw(-log_weight)  # takes log likelihoods
    assert pareto_shape(log_weight) == pytest.approx(float(k_hat), rel=1e-9)
