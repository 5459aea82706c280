"""Singular values and combinations of a linear model, whose covariance is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cpam_bayes.inference.diagnostics.identifiability import combinations
from cpam_bayes.inference.pairing import Pairing
from cpam_bayes.inference.posterior import plate_posterior
from cpam_bayes.plate import Measurement
from tests.linear_model import LinearModel, exact_gaussian, measurement

X = np.array([0.4, -0.3])
PRIOR_SD = 4.0 / np.sqrt(12.0)


def one_to_one(n: int) -> Pairing:
    return Pairing(np.arange(n), np.empty(0, dtype=int), 0.0)


def test_singular_values_are_prior_over_noise_along_the_axes_of_the_covariance() -> None:
    data = measurement(0.01)
    found = combinations(plate_posterior(LinearModel(), data, np.zeros(4)), X, one_to_one(4))
    _, covariance = exact_gaussian(data)
    expected = PRIOR_SD / np.sqrt(np.linalg.eigvalsh(covariance))
    np.testing.assert_allclose([c.singular_value for c in found], np.sort(expected)[::-1], rtol=1e-10)


def test_spread_of_a_combination_is_that_of_its_logarithm_under_the_covariance() -> None:
    data = measurement(0.01)
    found = combinations(plate_posterior(LinearModel(), data, np.zeros(4)), X, one_to_one(4))
    _, covariance = exact_gaussian(data)
    for c in found:
        slope = c.exponents / X  # d ln(product) / dx
        assert c.noise_sd == pytest.approx(float(np.sqrt(slope @ covariance @ slope)), rel=1e-10)
        assert c.prior_sd == pytest.approx(float(PRIOR_SD * np.linalg.norm(slope)), rel=1e-10)
        assert c.exponents[np.abs(c.exponents).argmax()] == 1.0


def test_student_t_noise_informs_less() -> None:
    data = measurement(0.01)
    gaussian, student = (
        combinations(
            plate_posterior(LinearModel(), data, np.zeros(4), degrees_of_freedom=nu), X, one_to_one(4)
        )
        for nu in (np.inf, 4.0)
    )
    for g, s in zip(gaussian, student, strict=True):
        assert s.singular_value == pytest.approx(g.singular_value * np.sqrt(5.0 / 7.0), rel=1e-12)


def test_fewer_frequencies_than_unknowns_leave_a_combination_to_the_prior() -> None:
    data = replace(measurement(0.01), frequencies=measurement(0.01).frequencies[2:3], labels=("",))
    # frequency 3 of the model sees 15 a + 15 b; here it is the only one
    pairing = Pairing(np.array([2]), np.empty(0, dtype=int), 0.0)
    found = combinations(plate_posterior(LinearModel(), data, np.zeros(4)), X, pairing)
    assert len(found) == 2
    assert found[1].singular_value < 1e-10
    assert found[1].noise_sd == np.inf
    assert found[1].contraction < 1e-15
    np.testing.assert_allclose(found[0].exponents * PRIOR_SD / X, found[0].exponents[0] / X[0] * PRIOR_SD)


def test_a_frequency_without_a_mode_does_not_count() -> None:
    data = measurement(0.01)
    spurious = Measurement(np.insert(data.frequencies, 2, 250.0), 0.0, 0.01, None, ("",) * 5, complete=False)
    pairing = Pairing(np.array([0, 1, -1, 2, 3]), np.empty(0, dtype=int), 0.0)
    found = combinations(plate_posterior(LinearModel(), spurious, np.zeros(4)), X, pairing)
    clean = combinations(plate_posterior(LinearModel(), data, np.zeros(4)), X, one_to_one(4))
    for f, c in zip(found, clean, strict=True):
        assert f.singular_value == pytest.approx(c.singular_value, rel=1e-12)
