"""Mixtures of Student-t densities."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_t

from cpam_bayes.inference.student_mixture import Mixture, draw, fit, log_mixture, single, split, widened

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
