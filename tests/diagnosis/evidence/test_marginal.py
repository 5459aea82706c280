"""Densities of lists under a hypothesis; marginal likelihoods against closed forms, quadrature and emcee."""

from collections.abc import Callable
from dataclasses import replace

import emcee
import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, norm

from cpam_bayes.diagnosis.comparison import REPEATABILITY_PRIOR, comparison_of
from cpam_bayes.diagnosis.evidence import weighing
from cpam_bayes.diagnosis.evidence.marginal import Marginal, laplace_marginal
from cpam_bayes.diagnosis.evidence.sampled import sampled_marginal
from cpam_bayes.diagnosis.hypotheses import DISCREPANCY, OTHER, Hypothesis
from cpam_bayes.effects import Effect, ListChange
from cpam_bayes.inference.log_density import CorrelatedDensity
from cpam_bayes.parameters import ScaledStudentT
from cpam_bayes.priors import Prior
from tests.diagnosis import toy_plates as toy
from tests.diagnosis.toy_plates import ANYTHING, BENT, BUMP, F0, NOISE, SD, A, Array, case, hypothesis

PLAIN = Hypothesis("none", "none")
NARROW_WARP = toy.cause("warp", toy.whole_normal(0.1), is_even=True)
NOISY = F0 * (1.0 + 0.004 * np.array([1.0, -0.5, 0.3, 2.0, -1.0, 0.2, 0.9, -1.4]))
SHIFTED = Hypothesis(OTHER, OTHER, parameters=(DISCREPANCY,), prior=0.06, correlation_length=0.0)
SMOOTH = replace(SHIFTED, correlation_length=0.8)


def rounded(relative: float | None, of: Hypothesis | None = None) -> CorrelatedDensity:
    """A list that is rounded to 1 Hz, by default of a warped plate."""
    plate = case(toy.a_list(NOISY, relative, 1.0), [(NARROW_WARP, toy.even(BUMP))])
    return comparison_of([plate], of or hypothesis(NARROW_WARP))


def two_lists(of: Hypothesis = PLAIN) -> CorrelatedDensity:
    plates = [
        case(toy.a_list(f, None), name=name, specimen="one") for name, f in (("a", NOISY), ("b", 1.001 * F0))
    ]
    return comparison_of(plates, of)


def without_the_third(comparison: CorrelatedDensity) -> CorrelatedDensity:
    return replace(comparison, listed=comparison.listed.without(2), left_out=2)


CASES = {
    "given noise": rounded(0.003),
    "inferred noise": rounded(None),
    "discrepancy": rounded(0.003, SHIFTED),
    "inferred noise and discrepancy": rounded(None, SHIFTED),
    "smooth discrepancy": rounded(0.003, SMOOTH),
    "inferred noise and smooth discrepancy": rounded(None, SMOOTH),
    "two lists": two_lists(),
    "two lists and a smooth discrepancy": two_lists(SMOOTH),
    "one frequency left out of a smooth one": without_the_third(rounded(None, SMOOTH)),
    "one frequency left out": without_the_third(rounded(None)),
}
EVERY = pytest.mark.parametrize("comparison", CASES.values(), ids=CASES.keys())


def scores(comparison: CorrelatedDensity, m: int = 3) -> Array:
    return 0.7 * np.random.default_rng(1).standard_normal((m, comparison.parameters.size))


@EVERY
def test_the_gradient_is_the_difference_quotient(comparison: CorrelatedDensity) -> None:
    for z in scores(comparison):
        expected = toy.differences(lambda v: comparison.log_density(v)[:, None], z, 1e-5)[0]
        found = comparison.expand(z[None])
        assert found.value[0] == pytest.approx(comparison.log_density(z[None])[0], rel=1e-12)
        np.testing.assert_allclose(found.gradient[0], expected, rtol=1e-6, atol=1e-5)


@EVERY
def test_the_likelihood_is_that_of_the_covariance_and_a_frequency_given_the_others_a_ratio(
    comparison: CorrelatedDensity,
) -> None:
    x = comparison.scores.to_x(scores(comparison))
    f, covariance, listed = comparison.predict(x)[0], comparison.covariance(x), comparison.listed.frequencies
    both = list(zip(listed * np.log(listed / f), covariance, strict=True))
    whole = np.array([multivariate_normal.logpdf(away, cov=own) for away, own in both])
    np.testing.assert_allclose(comparison.log_likelihood(x), whole, rtol=1e-9)
    diagonal = np.diagonal(covariance, axis1=1, axis2=2)
    np.testing.assert_allclose(comparison.variance(x), diagonal, rtol=1e-12)
    for i in range(len(listed)):
        others = np.delete(np.arange(len(listed)), i)
        rest = [
            multivariate_normal.logpdf(away[others], cov=own[np.ix_(others, others)]) for away, own in both
        ]
        np.testing.assert_allclose(comparison.log_conditional(x)[:, i], whole - rest, rtol=1e-9)


@EVERY
def test_the_curvature_is_the_information_of_the_residuals(comparison: CorrelatedDensity) -> None:
    """Of a Gaussian whose mean and covariance move, and of the prior, one in every score."""
    (z,), listed = scores(comparison, 1), comparison.listed.frequencies

    def away(z: Array) -> Array:
        f, _ = comparison.predict(comparison.scores.to_x(z))
        return np.asarray(listed * np.log(listed / f))

    def covariance(z: Array) -> Array:
        return comparison.covariance(comparison.scores.to_x(z)).reshape(len(z), -1)

    n, inverse = len(z), np.linalg.inv(comparison.covariance(comparison.scores.to_x(z[None]))[0])
    slope = toy.differences(away, z, 1e-5)
    moved = inverse @ toy.differences(covariance, z, 1e-5).T.reshape(n, *inverse.shape)
    expected = np.eye(n) + slope.T @ inverse @ slope + 0.5 * np.einsum("iab,jba->ij", moved, moved)
    np.testing.assert_allclose(comparison.expand(z[None]).curvature[0], expected, rtol=1e-5, atol=1e-5)


def test_what_nothing_explains_adds_to_the_variance_and_is_alike_in_modes_near_each_other() -> None:
    x = np.array([[1.0, 1.0, 0.02]])
    given = (0.003 * NOISY) ** 2 + 1.0 / 12
    white = rounded(0.003, SHIFTED)
    assert white.discrepancy == 2
    np.testing.assert_allclose(white.variance(x)[0], given + (0.02 * NOISY) ** 2, rtol=1e-12)
    covariance = rounded(0.003, SMOOTH).covariance(x)[0] - np.diag(given)
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


def test_noise_of_each_frequency_overrules_the_relative_one_and_errors_of_solver_and_theory_add() -> None:
    sd, one = np.linspace(0.1, 0.8, len(F0)), np.ones(len(F0))
    plate = case(toy.a_list(NOISY, 0.003))
    solver = replace(plate, models=replace(plate.models, error=0.004 * one))
    both = replace(solver, models=replace(solver.models, theory_error=0.012 * one))
    for own, expected in (
        (case(replace(toy.a_list(NOISY, 0.003), frequency_sd=sd)), sd),
        (solver, 0.005 * NOISY),
        (both, 0.013 * NOISY),
    ):
        comparison = comparison_of([own], PLAIN)
        np.testing.assert_allclose(comparison.variance(np.ones((1, 2)))[0], expected**2, rtol=1e-12)
        assert comparison.noise is None


def test_a_false_peak_lies_anywhere_below_the_last_frequency_and_missed_modes_move_what_follows() -> None:
    plate = case(toy.a_list(NOISY, 0.003))
    false = Hypothesis("mode_identity", "list", listed=ListChange(spurious=3))
    kept = np.delete(NOISY, 3)
    # frequencies above it belong to one mode less
    expected = norm.logpdf(kept * np.log(kept / F0[:7]), 0.0, 0.003 * kept).sum() - np.log(NOISY[-1])
    assert comparison_of([plate], false).log_likelihood(np.ones((1, 2)))[0] == pytest.approx(
        expected, rel=1e-12
    )
    missed = Hypothesis("mode_identity", "list", listed=ListChange(missed=(1, 4)))
    comparison = comparison_of([case(toy.a_list(NOISY[:6], 0.003))], missed)
    np.testing.assert_array_equal(comparison.model.parts[0].modes, [0, 2, 3, 5, 6, 7])


def constrained(comparison: CorrelatedDensity, below: float) -> CorrelatedDensity:
    """The same where the first constant must be below a limit."""
    part = comparison.model.parts[0]
    cut = replace(part, bare=replace(part.bare, allowed=lambda x: x[:, 0] < below))  # type: ignore[type-var]
    return replace(comparison, model=replace(comparison.model, parts=(cut,)))


def test_points_that_break_the_constraints_have_no_density_and_the_priors_slope() -> None:
    comparison = rounded(None)
    forbidden = constrained(comparison, 1.0)
    z = scores(comparison, 8)
    found = forbidden.expand(z)
    inside = forbidden.scores.to_x(z)[:, 0] < 1.0
    assert 0 < inside.sum() < len(z)
    np.testing.assert_array_equal(np.isfinite(found.value), inside)
    np.testing.assert_array_equal(forbidden.log_density(z)[~inside], -np.inf)
    np.testing.assert_array_equal(found.gradient[~inside], -z[~inside])
    np.testing.assert_allclose(found.value[inside], comparison.expand(z).value[inside], rtol=1e-13)


# Marginal likelihoods

# Error, nats, of the evidence by optima and nodes: hypotheses ten nats from the best are sampled.
ROUGHLY = 1.5


def plain(f: Array, noise: float | None = NOISE) -> CorrelatedDensity:
    return comparison_of([case(toy.a_list(f, noise))], PLAIN)


def compared(
    f: Array, of: Effect, shift: Callable[..., object], noise: float | None = NOISE
) -> CorrelatedDensity:
    """A list under the hypothesis of a cause that shifts the modes so."""
    return comparison_of([case(toy.a_list(f, noise), [(of, shift)])], hypothesis(of))  # type: ignore[list-item]


def weighed(comparison: CorrelatedDensity, sizes: tuple[int, ...] = (2,), least: float = -np.inf) -> Marginal:
    return laplace_marginal(comparison, sizes, np.zeros((1, comparison.parameters.size)), least=least)


def by_quadrature(
    f: Array, prior: Prior, shape: Callable[[Array], Array], t: Array | None = None
) -> tuple[float, float, float]:
    """Log evidence of ln f = ln F0 + A c + shape(t) BUMP, and the mean and standard deviation of t.

    c in closed form, t by the trapezoidal rule, by default over 20001 points of its prior.
    """
    t = np.linspace(prior.lower, prior.upper, 20001) if t is None else t
    slope = SD * A * f[:, None]
    covariance = slope @ slope.T + np.diag((NOISE * f) ** 2)
    away = f * np.log(f / (F0 * np.exp(shape(t)[:, None] * BUMP)))
    log_p = multivariate_normal.logpdf(away, cov=covariance) + prior.log_density(t)
    top = log_p.max()
    density = np.exp(log_p - top)
    total = np.trapezoid(density, t)
    mean = np.trapezoid(density * t, t) / total
    return float(np.log(total) + top), mean, np.sqrt(np.trapezoid(density * (t - mean) ** 2, t) / total)


def test_without_an_effect_a_linear_model_has_its_exact_evidence() -> None:
    f = toy.measured()
    found = weighed(plain(f), ())
    # a Gaussian in scores: only rounding is left
    assert found.log_evidence == pytest.approx(toy.exact_log_evidence(f, NOISE * f), abs=1e-6)


def test_moments_of_a_linear_model_are_those_of_the_gaussian() -> None:
    f = toy.measured()
    slope = A / NOISE
    covariance = np.linalg.inv(slope.T @ slope + np.eye(2) / SD**2)
    expected = 1.0 + covariance @ slope.T @ np.log(f / F0) / NOISE
    sd = np.sqrt(np.diag(covariance))
    laplace = weighed(plain(f), ())
    for found, near in ((laplace, 0.01), (sampled_marginal(laplace), 0.03)):
        mean, spread = found.moments()
        np.testing.assert_allclose(mean, expected, atol=near * sd.max())
        np.testing.assert_allclose(spread, sd, rtol=3 * near)
        np.testing.assert_allclose(found.resampled(2048).mean(axis=0), expected, atol=2 * near * sd.max())


def test_a_second_optimum_at_another_size_counts_where_the_plain_model_explains_the_list() -> None:
    # no size and one of -0.15 shift the modes alike, and the data determine the size about either
    two_fold, prior, f = -0.15, toy.whole_normal(0.1), toy.measured()

    def shift(t: Array) -> tuple[Array, Array]:
        return t[:, None] * (t[:, None] - two_fold) * BUMP, (2.0 * t[:, None] - two_fold) * BUMP

    of = toy.cause("bent", prior)
    plates = [case(toy.a_list(f, NOISE), [(of, shift)])]
    some = toy.of_one(replace(PLAIN, prior=0.9), hypothesis(of))
    found = weighing.weigh(plates, some, sets=False).best_of("bent")
    expected, *_ = by_quadrature(f, prior, lambda t: t * (t - two_fold))
    assert found.marginal.log_evidence == pytest.approx(expected, abs=0.1)
    assert np.sum(found.marginal.draws[:, 2] < two_fold / 2) > 100


# at the last noise the posterior is 6e-4 scores wide
@pytest.mark.parametrize(
    ("size", "noise"),
    [
        *((size, NOISE) for size in (0.0, 0.004, 0.02, -0.05)),
        *((0.017, noise) for noise in (0.01, 1e-3, 1e-4, 2e-5)),
    ],
)
def test_with_a_linear_effect_the_evidence_is_exact_however_narrow_the_posterior(
    size: float, noise: float
) -> None:
    f = toy.measured(size * BUMP, noise)
    expected = toy.exact_log_evidence(f, noise * f, (BUMP, 0.02))
    found = sampled_marginal(weighed(compared(f, BENT, toy.straight(BUMP), noise)))
    assert found.log_evidence == pytest.approx(expected, abs=3.0 * found.error)
    assert found.error < 0.05


@pytest.mark.parametrize("size", [0.0, 0.05, 0.12, 0.3])
@pytest.mark.parametrize(
    "prior", [ScaledStudentT(0.1, 4.0, -0.8, 0.8), toy.whole_normal(0.1)], ids=["t", "normal"]
)
def test_an_even_effect_has_both_its_peaks_in_the_evidence(size: float, prior: Prior) -> None:
    f = toy.measured(size**2 * BUMP)
    warp = toy.cause("warp", prior, is_even=True)
    expected, mean, sd = by_quadrature(f, prior, np.square)
    found = weighed(compared(f, warp, toy.even(BUMP)))
    # what decides which hypotheses are sampled
    assert found.log_evidence == pytest.approx(expected, abs=ROUGHLY)
    sampled = sampled_marginal(found)
    assert sampled.log_evidence == pytest.approx(expected, abs=3.0 * sampled.error)
    assert sampled.error < 0.05
    # neither sign is preferred, and their square is known
    weight, t = np.exp(sampled.log_weight), sampled.draws[:, 2]
    assert weight @ (t > 0.0) == pytest.approx(0.5, abs=0.06)
    assert weight @ t**2 == pytest.approx(mean**2 + sd**2, rel=0.05)


@pytest.mark.parametrize("size", [-0.02, 0.0, 0.05])
def test_a_one_sided_effect_may_pile_up_at_zero(size: float) -> None:
    """The data may ask for a negative size."""
    prior = ScaledStudentT(0.02, 4.0, 0.0, 0.16)
    f = toy.measured(size * BUMP)
    # a likelihood that falls from zero on may do so within 1e-4
    t = np.concatenate(([0.0], np.geomspace(1e-7, 0.16, 4000)))
    expected, mean, sd = by_quadrature(f, prior, lambda t: t, t)
    laplace = weighed(compared(f, toy.cause("dust", prior), toy.straight(BUMP)))
    assert laplace.log_evidence == pytest.approx(expected, abs=ROUGHLY)
    found = sampled_marginal(laplace)
    assert found.log_evidence == pytest.approx(expected, abs=3.0 * found.error)
    # 512 weighted points
    assert found.moments()[0][2] == pytest.approx(mean, abs=0.15 * sd)
    assert found.moments()[1][2] == pytest.approx(sd, rel=0.15)


def test_importance_sampling_says_its_own_error() -> None:
    z = []
    for k in range(12):
        f = toy.measured(0.012 * np.roll(BUMP, k))
        found = sampled_marginal(weighed(compared(f, toy.WARP, toy.even(BUMP))))
        assert 0.0 < found.error < 0.1
        expected, *_ = by_quadrature(f, toy.WARP.parameters[0].prior, np.square)
        z.append((found.log_evidence - expected) / found.error)
    # a Sobol sequence is at least as good as chance
    assert np.sqrt(np.mean(np.square(z))) < 1.5


def test_inferred_noise_is_integrated_by_importance_sampling() -> None:
    f = toy.measured(noise=0.006)
    comparison = plain(f, None)
    prior = comparison.parameters["relative_std"].prior
    # even in the logarithm: the density is smooth there
    s = np.exp(np.linspace(np.log(prior.lower), np.log(prior.upper), 4001))
    log_p = np.array([toy.exact_log_evidence(f, v * f) for v in s]) + prior.log_density(s) + np.log(s)
    expected = logsumexp(log_p, b=np.log(s[1] / s[0]))
    laplace = weighed(comparison, ())
    found = sampled_marginal(laplace)
    assert found.log_evidence == pytest.approx(expected, abs=3.0 * found.error)
    # Laplace's method alone misses the skewness of the noise's score
    assert laplace.log_evidence == pytest.approx(expected, abs=0.4)


def test_a_hopeless_hypothesis_is_not_refined() -> None:
    comparison = compared(toy.measured(0.004 * BUMP), BENT, toy.even(BUMP))
    assert len(weighed(comparison, least=1e6).z) < len(weighed(comparison).z)


def test_shares_of_optima_and_nodes_sum_to_one_and_are_the_same_each_time() -> None:
    f = toy.measured(0.012 * BUMP)
    given, inferred = (compared(f, toy.WARP, toy.even(BUMP), noise) for noise in (NOISE, None))
    found = weighed(given)
    assert np.all(np.diff(found.weight) <= 0.0)
    assert found.weight.sum() == pytest.approx(1.0, abs=1e-12)
    assert np.exp(found.log_weight).sum() == pytest.approx(1.0, abs=1e-12)
    first, second = (sampled_marginal(weighed(inferred)) for _ in range(2))
    assert first.log_evidence == second.log_evidence
    np.testing.assert_array_equal(first.draws, second.draws)


def test_what_lies_outside_the_constraints_carries_nothing() -> None:
    comparison, middle = plain(toy.measured(noise=0.05), 0.05), 1.03
    whole, found = (sampled_marginal(weighed(c, ())) for c in (comparison, constrained(comparison, middle)))
    share = np.exp(whole.log_weight) @ (whole.draws[:, 0] < middle)
    # of 512 points
    assert found.log_evidence - whole.log_evidence == pytest.approx(np.log(share), abs=0.1)
    assert np.all(found.draws[np.isfinite(found.log_weight), 0] < middle)


@pytest.mark.parametrize("relative", [NOISE, None], ids=["given noise", "inferred noise"])
@pytest.mark.parametrize("of", [hypothesis(BENT), ANYTHING], ids=["a cause", "a discrepancy"])
def test_emcee_and_importance_sampling_agree(of: Hypothesis, relative: float | None) -> None:
    own = toy.with_causes(toy.measured(0.012 * BUMP), *of.effects, relative=relative)
    found = sampled_marginal(weighing.marginal_of([own], of, (0,)))
    comparison = found.comparison
    rng = np.random.default_rng(0)
    start = comparison.scores.to_z(rng.permutation(found.resampled(40)))
    start += 0.1 * rng.standard_normal(start.shape)
    sampler = emcee.EnsembleSampler(*start.shape, comparison.log_density, vectorize=True)
    sampler.random_state = np.random.RandomState(0).get_state()
    sampler.run_mcmc(start, 1500)
    draws = comparison.scores.to_x(sampler.get_chain(discard=300, flat=True))
    mean, sd = found.moments()
    # four standard errors of a mean and of a standard deviation; chains have at least 1000 effective samples
    error = np.sqrt(np.sum(np.exp(found.log_weight) ** 2) + 1.0 / 1000.0)
    np.testing.assert_array_less(np.abs(draws.mean(axis=0) - mean) / sd, 4.0 * error)
    np.testing.assert_allclose(draws.std(axis=0), sd, rtol=4.0 * error)
