"""Noise on lists of frequencies, eq. (12)."""

from __future__ import annotations

import numpy as np
import pytest

from cpam_bayes.repetition.perturbation import (
    INTERPRETATIONS,
    Interpretation,
    perturbation_sd,
    perturbed_list,
)

FREQUENCIES = np.array([102.0, 311.0, 342.0, 364.0, 390.0, 612.0])


def test_relative_disorder_is_a_share_of_each_frequency() -> None:
    np.testing.assert_allclose(perturbation_sd(FREQUENCIES, 0.05, "relative"), 0.05 * FREQUENCIES, rtol=1e-15)


def test_rms_disorder_is_a_share_of_the_root_mean_square_for_all_modes() -> None:
    # Liu and Han's form by hand: sqrt((3^2 + 4^2) / 2) = 3.5355
    np.testing.assert_allclose(perturbation_sd(np.array([3.0, 4.0]), 0.1, "rms"), 0.35355339, rtol=1e-8)


def test_both_readings_add_the_same_energy_of_noise() -> None:
    relative, rms = (perturbation_sd(FREQUENCIES, 0.1, reading) for reading in INTERPRETATIONS)
    assert np.sum(relative**2) == pytest.approx(np.sum(rms**2))


@pytest.mark.parametrize("reading", INTERPRETATIONS)
def test_noise_has_the_standard_deviation_asked_for(reading: Interpretation) -> None:
    rng = np.random.default_rng(0)
    spread = np.array([100.0, 300.0, 500.0, 700.0])  # far apart: sorting changes nothing at 1 %
    sd = perturbation_sd(spread, 0.01, reading)
    lists = np.array([perturbed_list(spread, sd, rng).frequencies for _ in range(4000)])
    # an sd of 4000 draws is known to 1.1 %, a mean to 1.6 % of the sd; four of these
    np.testing.assert_allclose(lists.std(axis=0), sd, rtol=0.045)
    assert np.all(np.abs(lists.mean(axis=0) - spread) < 0.064 * sd)


def test_a_noisy_list_rises_and_says_when_modes_changed_places() -> None:
    rng = np.random.default_rng(1)
    found = [
        perturbed_list(FREQUENCIES, perturbation_sd(FREQUENCIES, 0.1, "relative"), rng) for _ in range(200)
    ]
    for one in found:
        assert np.all(np.diff(one.frequencies) >= 0.0)
    share = np.mean([one.reordered for one in found])
    assert 0.5 < share < 1.0  # 342, 364 and 390 Hz are half a standard deviation apart
    quiet = perturbed_list(FREQUENCIES, perturbation_sd(FREQUENCIES, 1e-6, "relative"), rng)
    assert not quiet.reordered


def test_frequencies_that_would_not_be_positive_are_drawn_again_and_counted() -> None:
    rng = np.random.default_rng(2)
    f = np.array([10.0, 1000.0])
    found = [perturbed_list(f, perturbation_sd(f, 0.1, "rms"), rng) for _ in range(200)]
    assert all(one.frequencies[0] > 0.0 for one in found)
    # 10 Hz are 0.14 of the standard deviation: a normal draw is below zero with P = 0.444, and
    # P / (1 - P) draws are thrown away on average
    assert np.mean([one.redrawn for one in found]) == pytest.approx(0.444 / 0.556, abs=0.4)


def test_noise_on_a_frequency_that_is_not_positive_is_refused() -> None:
    with pytest.raises(ValueError, match="received -1e\\+06 Hz, accepted: above zero"):
        perturbed_list(np.array([-1e6]), np.array([1.0]), np.random.default_rng(0))


def test_the_same_seed_gives_the_same_list() -> None:
    sd = perturbation_sd(FREQUENCIES, 0.1, "relative")
    first, again = (perturbed_list(FREQUENCIES, sd, np.random.default_rng([3, 1])) for _ in range(2))
    np.testing.assert_array_equal(first.frequencies, again.frequencies)
