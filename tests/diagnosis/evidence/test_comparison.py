"""A model against a list: likelihood, gradient and curvature over scores."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from cpam_bayes.diagnosis.comparison import REPEATABILITY_PRIOR, comparison_of
from cpam_bayes.diagnosis.hypotheses import DISCREPANCY, OTHER, Hypothesis
from cpam_bayes.effects import ListChange
from cpam_bayes.inference.log_density import LogDensity
from tests.diagnosis.toy_plates import (
    BUMP,
    F0,
    A,
    a_list,
    case,
    cause,
    differences,
    even,
    hypothesis,
    whole_normal,
)

WARP = cause("warp", whole_normal(0.1), is_even=True)
NOISY = F0 * (1.0 + 0.004 * np.array([1.0, -0.5, 0.3, 2.0, -1.0, 0.2, 0.9, -1.4]))
SHIFTED = Hypothesis(OTHER, OTHER, parameters=(DISCREPANCY,), prior=0.06, correlation_length=0.0)
SMOOTH = replace(SHIFTED, correlation_length=0.8)


def compared(relative: float | None, of: Hypothesis | None = None, resolution: float = 1.0) -> LogDensity:
    plate = case(a_list(NOISY, relative, resolution), [(WARP, even(BUMP))])
    return comparison_of([plate], of or hypothesis(WARP, 0.1))


def two_lists(of: Hypothesis | None = None) -> LogDensity:
    plates = [
        case(a_list(f, None), name=name, specimen="one") for name, f in (("a", NOISY), ("b", 1.001 * F0))
    ]
    return comparison_of(plates, of or Hypothesis("none", "none"))


CASES = {
    "given noise": compared(0.003),
    "inferred noise": compared(None),
    "discrepancy": compared(0.003, SHIFTED),
    "inferred noise and discrepancy": compared(None, SHIFTED),
    "smooth discrepancy": compared(0.003, SMOOTH),
    "inferred noise and smooth discrepancy": compared(None, SMOOTH),
    "two lists": two_lists(),
    "two lists and a smooth discrepancy": two_lists(SMOOTH),
    "one frequency left out of a smooth one": replace(
        compared(None, SMOOTH), listed=compared(None, SMOOTH).listed.without(2), left_out=2
    ),
    "one frequency left out": replace(compared(None), listed=compared(None).listed.without(2), left_out=2),
}
EVERY = pytest.mark.parametrize("comparison", CASES.values(), ids=CASES.keys())


def scores(comparison: LogDensity, m: int = 3) -> np.ndarray:
    return 0.7 * np.random.default_rng(1).standard_normal((m, comparison.parameters.size))


@EVERY
def test_the_gradient_is_the_difference_quotient(comparison: LogDensity) -> None:
    for z in scores(comparison):
        expected = differences(lambda v: comparison.log_density(v)[:, None], z, 1e-5)[0]
        found = comparison.expand(z[None])
        assert found.value[0] == pytest.approx(comparison.log_density(z[None])[0], rel=1e-12)
        np.testing.assert_allclose(found.gradient[0], expected, rtol=1e-6, atol=1e-5)


@EVERY
def test_a_frequency_given_the_others_is_the_ratio_of_two_densities(comparison: LogDensity) -> None:
    x = comparison.scores.to_x(scores(comparison))
    f, _ = comparison.predict(x)
    covariance, listed = comparison.covariance(x), comparison.listed.frequencies
    for i in range(len(listed)):
        others = np.delete(np.arange(len(listed)), i)
        expected = [
            multivariate_normal.logpdf(away, cov=own)
            - multivariate_normal.logpdf(away[others], cov=own[np.ix_(others, others)])
            for away, own in zip(listed * np.log(listed / f), covariance, strict=True)
        ]
        np.testing.assert_allclose(comparison.log_conditional(x)[:, i], expected, rtol=1e-9)


@EVERY
def test_the_curvature_is_the_mean_of_the_gradients_square_over_lists(comparison: LogDensity) -> None:
    """Fisher's identity, with the prior's own curvature, which is one in every score."""
    z, rng, m = scores(comparison, 1), np.random.default_rng(2), 20_000
    x = comparison.scores.to_x(z)
    f = comparison.predict(x)[0]
    residuals = rng.standard_normal((m, f.shape[1])) @ np.linalg.cholesky(comparison.covariance(x)[0]).T
    # scale and discrepancy stay those of the list that was measured: only the residuals are drawn
    listed = comparison.listed.frequencies
    drawn = replace(comparison, model=_Moved(comparison.model, listed * np.exp(-residuals / listed) - f))
    gradients = drawn.expand(np.repeat(z, m, axis=0)).gradient + z
    information = np.cov(gradients.T)
    expected = comparison.expand(z).curvature[0] - np.eye(z.shape[1])
    size = np.sqrt(np.outer(np.diag(expected), np.diag(expected))) + 1e-9
    # a covariance of m draws is known to sqrt(2 / m), 1 %; five times that for the squares' longer tails
    assert np.abs((information - expected) / size).max() < 0.05
    if comparison.discrepancy is not None:
        assert expected[comparison.discrepancy, comparison.discrepancy] > 0.0


class _Moved:
    """A model whose frequencies are moved by constants, (m, n_f)."""

    def __init__(self, model: object, by: np.ndarray) -> None:
        self.model, self.by, self.parameters = model, by, model.parameters  # type: ignore[attr-defined]

    def predict(self, x: np.ndarray, *, jacobian: bool = False) -> object:
        found = self.model.predict(x, jacobian=jacobian)  # type: ignore[attr-defined]
        by = self.by
        if found.frequencies.shape[1] > by.shape[1]:  # the one that is left out
            by = np.insert(by, 2, 0.0, axis=1)
        return replace(found, frequencies=found.frequencies + by)

    def admissible(self, x: np.ndarray) -> np.ndarray:
        return np.ones(len(x), dtype=bool)


def test_the_likelihood_is_a_product_of_gaussians_with_the_noise_of_the_list() -> None:
    comparison = compared(None)
    x = np.array([[1.02, 0.97, 0.1, 0.004]])
    f = F0 * np.exp(A @ [0.02, -0.03] + 0.01 * BUMP)
    sigma = np.sqrt((0.004 * NOISY) ** 2 + 1.0 / 12)
    expected = norm.logpdf(NOISY * np.log(NOISY / f), 0.0, sigma).sum()
    assert comparison.log_likelihood(x)[0] == pytest.approx(expected, rel=1e-12)


def test_a_discrepancy_adds_to_the_variance() -> None:
    comparison = compared(0.003, SHIFTED)
    assert comparison.discrepancy == 2
    x = np.array([[1.0, 1.0, 0.02]])
    expected = (0.003 * NOISY) ** 2 + (0.02 * NOISY) ** 2 + 1.0 / 12
    np.testing.assert_allclose(comparison.variance(x)[0], expected, rtol=1e-12)


@EVERY
def test_the_likelihood_is_that_of_the_covariance(comparison: LogDensity) -> None:
    x = comparison.scores.to_x(scores(comparison))
    f, covariance = comparison.predict(x)[0], comparison.covariance(x)
    listed = comparison.listed.frequencies
    away = listed * np.log(listed / f)
    expected = [multivariate_normal.logpdf(r, cov=c) for r, c in zip(away, covariance, strict=True)]
    np.testing.assert_allclose(comparison.log_likelihood(x), expected, rtol=1e-9)
    diagonal = np.diagonal(covariance, axis1=1, axis2=2)
    np.testing.assert_allclose(comparison.variance(x), diagonal, rtol=1e-12)


def test_a_smooth_discrepancy_is_alike_in_modes_near_each_other() -> None:
    comparison = compared(0.003, SMOOTH)
    x = np.array([[1.0, 1.0, 0.02]])
    covariance = comparison.covariance(x)[0] - np.diag((0.003 * NOISY) ** 2 + 1.0 / 12)
    relative = covariance / np.outer(NOISY, NOISY) / 0.02**2
    np.testing.assert_allclose(np.diag(relative), 1.0, rtol=1e-9)
    apart = np.log(NOISY[0] / NOISY[3])
    assert relative[0, 3] == pytest.approx(0.95 * np.exp(-0.5 * (apart / 0.8) ** 2), rel=1e-9)


def test_each_list_has_its_own_repeatability_and_discrepancy() -> None:
    comparison = two_lists(SMOOTH)
    names = comparison.parameters.names
    assert [names[c] for c in comparison.amplitudes] == ["relative_std of a", "relative_std of b"]
    x = np.ones((1, comparison.parameters.size))
    x[0, list(comparison.nuisance)] = (0.001, 0.004, 0.01)
    n = len(F0)
    noise = comparison.variance(x)[0] / comparison.listed.frequencies**2
    np.testing.assert_allclose(noise[:n], 0.001**2 + 0.01**2, rtol=1e-4)
    np.testing.assert_allclose(noise[n:], 0.004**2 + 0.01**2, rtol=1e-4)
    assert not comparison.covariance(x)[0, :n, n:].any()


def test_a_repeatability_that_is_left_out_is_of_the_order_of_two_per_mille() -> None:
    """docs/priors.md: 95 % of it in 0.04 to 0.9 %, none above 2 %."""
    assert REPEATABILITY_PRIOR.upper == 0.02
    low, middle, high = REPEATABILITY_PRIOR.ppf([0.025, 0.5, 0.975])
    assert low == pytest.approx(0.0004, rel=0.1)
    assert middle == pytest.approx(0.002, rel=0.01)
    assert high == pytest.approx(0.009, rel=0.05)
    assert DISCREPANCY.prior.ppf(0.05) < low * 2
    assert DISCREPANCY.prior.upper > 20 * REPEATABILITY_PRIOR.upper


def test_noise_that_is_given_for_each_frequency_overrules_the_relative_one() -> None:
    sd = np.linspace(0.1, 0.8, len(F0))
    plate = case(replace(a_list(NOISY, 0.003), frequency_sd=sd))
    comparison = comparison_of([plate], Hypothesis("none", "none"))
    np.testing.assert_allclose(comparison.variance(np.ones((1, 2)))[0], sd**2, rtol=1e-12)
    assert comparison.noise is None


def test_errors_of_the_solver_and_of_the_theory_add_to_the_variance() -> None:
    plate = case(a_list(NOISY, 0.003))
    rough = replace(plate, models=replace(plate.models, error=np.full(len(F0), 0.004)))
    comparison = comparison_of([rough], Hypothesis("none", "none"))
    np.testing.assert_allclose(comparison.variance(np.ones((1, 2)))[0], (0.005 * NOISY) ** 2, rtol=1e-12)
    rough = replace(rough, models=replace(rough.models, theory_error=np.full(len(F0), 0.012)))
    comparison = comparison_of([rough], Hypothesis("none", "none"))
    np.testing.assert_allclose(comparison.variance(np.ones((1, 2)))[0], (0.013 * NOISY) ** 2, rtol=1e-12)


def test_a_frequency_left_out_takes_its_own_factor_away_and_no_other() -> None:
    whole = compared(0.003)
    i = 4
    less = replace(whole, listed=whole.listed.without(i), left_out=i)
    z = scores(whole)
    x = whole.scores.to_x(z)
    f, sigma = whole.predict(x)[0][:, i], np.sqrt(whole.variance(x)[:, i])
    expected = norm.logpdf(NOISY[i] * np.log(NOISY[i] / f), 0.0, sigma)
    np.testing.assert_allclose(whole.log_likelihood(x) - less.log_likelihood(x), expected, rtol=1e-9)


def test_a_false_peak_lies_anywhere_below_the_last_frequency() -> None:
    false = Hypothesis("mode_identity", "list", listed=ListChange(spurious=3))
    plate = case(a_list(NOISY, 0.003))
    comparison = comparison_of([plate], false)
    x = np.ones((1, 2))
    kept = np.delete(NOISY, 3)
    # frequencies above it belong to one mode less
    expected = norm.logpdf(kept * np.log(kept / F0[:7]), 0.0, 0.003 * kept).sum() - np.log(NOISY[-1])
    assert comparison.log_likelihood(x)[0] == pytest.approx(expected, rel=1e-12)


def test_missed_modes_move_what_follows() -> None:
    missed = Hypothesis("mode_identity", "list", listed=ListChange(missed=(1, 4)))
    plate = case(a_list(NOISY[:6], 0.003))
    comparison = comparison_of([plate], missed)
    np.testing.assert_array_equal(comparison.model.parts[0].modes, [0, 2, 3, 5, 6, 7])


def test_points_that_break_the_constraints_have_no_density_and_the_priors_slope() -> None:
    comparison = compared(None)
    forbidden = replace(comparison, model=_Forbidding(comparison.model))
    z = scores(comparison, 8)
    found = forbidden.expand(z)
    inside = forbidden.scores.to_x(z)[:, 0] < 1.0
    assert 0 < inside.sum() < len(z)
    np.testing.assert_array_equal(np.isfinite(found.value), inside)
    np.testing.assert_array_equal(forbidden.log_density(z)[~inside], -np.inf)
    np.testing.assert_array_equal(found.gradient[~inside], -z[~inside])
    np.testing.assert_allclose(found.value[inside], comparison.expand(z).value[inside], rtol=1e-13)


class _Forbidding(_Moved):
    def __init__(self, model: object) -> None:
        super().__init__(model, np.zeros((1, len(F0))))

    def admissible(self, x: np.ndarray) -> np.ndarray:
        return np.asarray(x[:, 0] < 1.0)
