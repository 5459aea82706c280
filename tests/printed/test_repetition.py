"""Noise on lists of frequencies, eq. (12), and differences between repeated inversions and a posterior."""

from dataclasses import replace

import numpy as np
import pytest

from cpam_bayes.printed import repetition
from cpam_bayes.printed.repetition import INTERPRETATIONS, Evidence, compare, perturbation_sd, perturbed_list

FREQUENCIES = np.array([102.0, 311.0, 342.0, 364.0, 390.0, 612.0])


def test_disorder_is_a_share_of_each_frequency_or_of_the_root_mean_square_for_all_modes() -> None:
    np.testing.assert_allclose(perturbation_sd(FREQUENCIES, 0.05, "relative"), 0.05 * FREQUENCIES, rtol=1e-15)
    # Liu and Han's form by hand: sqrt((3^2 + 4^2) / 2) = 3.5355
    np.testing.assert_allclose(perturbation_sd(np.array([3.0, 4.0]), 0.1, "rms"), 0.35355339, rtol=1e-8)
    with pytest.raises(ValueError, match="received -1e\\+06 Hz, accepted: above zero"):
        perturbed_list(np.array([-1e6]), np.array([1.0]), np.random.default_rng(0))
    spread = np.array([100.0, 300.0, 500.0, 700.0])  # far apart: sorting changes nothing at 1 %
    for reading in INTERPRETATIONS:
        rng, sd = np.random.default_rng(0), perturbation_sd(spread, 0.01, reading)
        lists = np.array([perturbed_list(spread, sd, rng).frequencies for _ in range(4000)])
        np.testing.assert_allclose(lists.std(axis=0), sd, rtol=0.045)  # four standard errors of 4000 draws
        assert np.all(np.abs(lists.mean(axis=0) - spread) < 0.064 * sd)


def test_a_noisy_list_rises_and_says_when_modes_changed_places() -> None:
    rng, sd = np.random.default_rng(1), perturbation_sd(FREQUENCIES, 0.1, "relative")
    found = [perturbed_list(FREQUENCIES, sd, rng) for _ in range(200)]
    assert all(np.all(np.diff(one.frequencies) >= 0.0) for one in found)
    share = np.mean([one.reordered for one in found])
    assert 0.5 < share < 1.0  # 342, 364 and 390 Hz are half a standard deviation apart
    assert not perturbed_list(FREQUENCIES, 1e-5 * sd, rng).reordered


def test_frequencies_that_would_not_be_positive_are_drawn_again_and_counted() -> None:
    rng, f = np.random.default_rng(2), np.array([10.0, 1000.0])
    found = [perturbed_list(f, perturbation_sd(f, 0.1, "rms"), rng) for _ in range(200)]
    assert all(one.frequencies[0] > 0.0 for one in found)
    # 10 Hz is 0.14 sd: a normal draw is below zero with P = 0.444, and P / (1 - P) are rejected
    assert np.mean([one.redrawn for one in found]) == pytest.approx(0.444 / 0.556, abs=0.4)


# Ten inversions in agreement with a posterior N(1, 0.1) far from its bounds.
REPEATED = {"groups": 10, "repetition_mean": 1.02, "repetition_sd": 0.09, "repetition_at_bound": 0.0}
SAMPLED = {"posterior_mean": 1.0, "posterior_sd": 0.1, "effective": 1000.0, "posterior_at_bound": 0.0}
FORM = {"clusters": 1, "peaks": 1, "skewness": 0.1, "contraction": 0.1, "weighting": 1.0}
PLAIN = Evidence(**REPEATED, **SAMPLED, **FORM, reordered=0.0, missed=0.0, offset=0.0, residual=1.0)
WIDE, NARROW = replace(PLAIN, repetition_sd=0.2), replace(PLAIN, repetition_sd=0.03)
SHIFTED = replace(PLAIN, repetition_mean=1.2)
DIFFERING = (WIDE, NARROW, SHIFTED)


def test_agreement_within_chance_has_no_cause_whatever_else_is_seen() -> None:
    found = compare(replace(PLAIN, clusters=2, skewness=2.0, reordered=1.0, repetition_at_bound=0.5))
    assert (found.means_agree, found.sds_agree, found.causes) == (True, True, ())
    assert found.standard_error == pytest.approx(0.09 / np.sqrt(10))
    assert found.sd_ratio == pytest.approx(0.9)


@pytest.mark.parametrize(
    ("sign", "cause"),
    [
        ({"repetition_at_bound": 0.1}, "bounds"),
        ({"posterior_at_bound": 0.1}, "bounds"),
        ({"contraction": 0.5}, "open"),
        ({"clusters": 2}, "optima"),
        ({"peaks": 2}, "optima"),
        ({"skewness": -0.5}, "skewed"),
        ({"reordered": 0.2}, "reordered"),
        ({"missed": 0.1}, "missed"),
        ({"offset": -0.3}, "misfit"),
    ],
)
@pytest.mark.parametrize("differing", DIFFERING)
def test_each_sign_names_its_cause_and_no_other(differing, sign: dict[str, float], cause: str) -> None:
    assert compare(replace(differing, **sign)).causes == (cause,)
    below = {key: value - 1 if isinstance(value, int) else 0.99 * value for key, value in sign.items()}
    assert compare(replace(differing, **below)).causes == ("unexplained",)


def test_an_inversion_off_the_optimum_of_a_list_that_it_repeats_stopped_early() -> None:
    for differing in DIFFERING:
        assert compare(replace(differing, offset=0.5, residual=0.1)).causes == ("misfit",)
        assert compare(replace(differing, offset=0.5, residual=0.09)).causes == ("stopped",)
        assert compare(replace(differing, offset=0.29, residual=0.0)).causes == ("unexplained",)


def test_other_weights_than_the_noise_explain_a_wider_scatter_only() -> None:
    assert compare(replace(WIDE, weighting=1.25)).causes == ("weights",)
    assert compare(replace(WIDE, weighting=1.2)).causes == ("unexplained",)
    for differing in (NARROW, SHIFTED):
        assert compare(replace(differing, weighting=2.0)).causes == ("unexplained",)
    found = compare(replace(WIDE, repetition_at_bound=0.3, clusters=2, skewness=1.0, weighting=2.0))
    assert found.causes == ("bounds", "optima", "skewed", "weights"), "all that show are listed"
    stuck = compare(replace(PLAIN, repetition_mean=1.3, repetition_sd=0.0, repetition_at_bound=1.0))
    assert (stuck.means_agree, stuck.sds_agree, stuck.causes) == (False, False, ("bounds",))


def test_both_tests_raise_a_false_alarm_in_one_per_cent_and_count_the_posterior_s_own_error() -> None:
    rng, alarms = np.random.default_rng(0), np.zeros(2)
    for x in rng.normal(1.0, 0.1, (4000, 10)):
        found = compare(replace(PLAIN, repetition_mean=float(x.mean()), repetition_sd=float(x.std(ddof=1))))
        alarms += (not found.means_agree, not found.sds_agree)
    assert np.all(np.abs(alarms / 4000 - 0.01) < 0.0064)  # binomial: 0.01 +- 0.0016; four of these
    shifted = replace(PLAIN, repetition_mean=1.12)  # 0.05 by 4 effective draws, 0.028 by ten inversions
    assert not compare(replace(shifted, effective=1e6)).means_agree
    assert compare(replace(shifted, effective=4.0)).means_agree


def test_a_gaussian_sample_is_one_cluster_and_two_separate_ones_are_two() -> None:
    rng = np.random.default_rng(1)
    one, apart = rng.standard_normal((500, 10)), np.repeat([0.0, 12.0], 5)
    assert np.mean([repetition.clusters(x) == 2 for x in one]) < 0.03
    assert np.mean([repetition.clusters(x) == 2 for x in one + apart]) > 0.95
    stray, equal, pairs = [0.0, 0.1, 0.2, 0.3, 0.4, 50.0], [1.0] * 4, [1.0, 1.0, 2.0, 2.0]
    assert [repetition.clusters(np.array(values)) for values in (stray, equal, pairs)] == [1, 1, 2]


def test_separate_peaks_of_a_mixture_are_counted_and_skewness_is_that_of_known_distributions() -> None:
    density_peaks, skewness, rng = repetition.density_peaks, repetition.skewness, np.random.default_rng(2)
    z = rng.standard_normal(20_000)
    assert density_peaks(z) == 1
    assert density_peaks(np.r_[z[:10_000], 6.0 + z[10_000:]]) == 2
    assert density_peaks(np.r_[z[:10_000], 2.0 + z[10_000:]]) == 1  # two apart: a single peak
    assert density_peaks(np.r_[z[:19_600], 8.0 + z[19_600:]]) == 1  # a peak less than a tenth as high
    u = rng.random(20_000)  # flat, or piled up at bounds: as many as piles
    piles = (u, u**4, np.r_[u[:10_000] ** 4, 1.0 - u[10_000:] ** 4], np.ones(100))
    assert [density_peaks(x) for x in piles] == [1, 1, 2, 1]

    assert skewness(rng.standard_normal(100_000)) == pytest.approx(0.0, abs=0.03)
    assert skewness(rng.exponential(size=100_000)) == pytest.approx(2.0, abs=0.15)
    assert skewness(np.ones(5)) == 0.0
