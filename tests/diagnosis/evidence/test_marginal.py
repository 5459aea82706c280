"""Marginal likelihoods against closed forms, fine quadrature and emcee on the same density."""

from collections.abc import Callable
from dataclasses import replace

import emcee
import numpy as np
import pytest
from scipy.special import logsumexp

from cpam_bayes.diagnosis.comparison import comparison_of
from cpam_bayes.diagnosis.evidence import weighing
from cpam_bayes.diagnosis.evidence.marginal import Marginal, laplace_marginal
from cpam_bayes.diagnosis.evidence.sampled import sampled_marginal
from cpam_bayes.diagnosis.hypotheses import Hypothesis
from cpam_bayes.effects import Effect
from cpam_bayes.inference.log_density import LogDensity
from cpam_bayes.parameters import ScaledStudentT
from cpam_bayes.priors import Prior
from tests.diagnosis.toy_plates import (
    ANYTHING,
    BENT,
    BUMP,
    DENT,
    F0,
    NOISE,
    SD,
    WARP,
    A,
    a_list,
    case,
    cause,
    even,
    exact_log_evidence,
    hypothesis,
    log_normal_density,
    measured,
    straight,
    whole_normal,
    with_causes,
)

PLAIN = Hypothesis("none", "none")
# Error, nats, of the evidence by optima and nodes: hypotheses ten nats from the best are sampled.
ROUGHLY = 1.5


def plain(f: np.ndarray, noise: float | None = NOISE) -> LogDensity:
    return comparison_of([case(a_list(f, noise))], PLAIN)


def compared(
    f: np.ndarray, of: Effect, shift: Callable[..., object], noise: float | None = NOISE
) -> LogDensity:
    """A list under the hypothesis of a cause that shifts the modes so."""
    return comparison_of([case(a_list(f, noise), [(of, shift)])], hypothesis(of, 0.1))  # type: ignore[list-item]


def weighed(comparison: LogDensity, sizes: tuple[int, ...] = (2,), least: float = -np.inf) -> Marginal:
    return laplace_marginal(comparison, sizes, np.zeros((1, comparison.parameters.size)), least=least)


def by_quadrature(f: np.ndarray, noise: float, prior: Prior, shape: np.ndarray, linear: float = 0.0) -> float:
    """Log evidence of ln f = ln F0 + A c + shape t (t + linear): c in closed form, t by 20001 points."""
    t = np.linspace(prior.lower, prior.upper, 20001)
    slope = SD * A * f[:, None]
    covariance = slope @ slope.T + np.diag((noise * f) ** 2)
    means = F0 * np.exp(t[:, None] * (t[:, None] + linear) * shape)
    factor = np.linalg.cholesky(np.linalg.inv(covariance))
    z = f * np.log(f / means) @ factor
    log_p = -0.5 * np.sum(z**2, axis=1) - 0.5 * np.linalg.slogdet(2 * np.pi * covariance)[1]
    log_p = log_p + prior.log_density(t)
    weight = np.full(len(t), t[1] - t[0])
    weight[[0, -1]] *= 0.5
    return float(logsumexp(log_p, b=weight))


def test_without_an_effect_a_linear_model_has_its_exact_evidence() -> None:
    f = measured()
    found = weighed(plain(f), ())
    # a Gaussian in scores: only rounding is left
    assert found.log_evidence == pytest.approx(exact_log_evidence(f, NOISE * f), abs=1e-6)


def test_moments_of_a_linear_model_are_those_of_the_gaussian() -> None:
    f = measured()
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
    two_fold, prior, f = -0.15, whole_normal(0.1), measured()

    def shift(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return t[:, None] * (t[:, None] - two_fold) * BUMP, (2.0 * t[:, None] - two_fold) * BUMP

    of = cause("bent", prior)
    plates = [case(a_list(f, NOISE), [(of, shift)])]
    found = weighing.weigh(
        plates, [(replace(PLAIN, prior=0.9), (0,)), (hypothesis(of, 0.1), (0,))], sets=False
    ).best_of("bent")
    expected = by_quadrature(f, NOISE, prior, BUMP, -two_fold)
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
    f = measured(size * BUMP, noise)
    expected = exact_log_evidence(f, noise * f, (BUMP, 0.02))
    found = sampled_marginal(weighed(compared(f, BENT, straight(BUMP), noise)))
    assert found.log_evidence == pytest.approx(expected, abs=3.0 * found.error)
    assert found.error < 0.05


@pytest.mark.parametrize("size", [0.0, 0.05, 0.12, 0.3])
@pytest.mark.parametrize(
    "prior", [ScaledStudentT(0.1, 4.0, -0.8, 0.8), whole_normal(0.1)], ids=["t", "normal"]
)
def test_an_even_effect_has_both_its_peaks_in_the_evidence(size: float, prior: Prior) -> None:
    f = measured(size**2 * BUMP)
    warp = cause("warp", prior, is_even=True)
    expected = by_quadrature(f, NOISE, prior, BUMP)
    found = weighed(compared(f, warp, even(BUMP)))
    # what decides which hypotheses are sampled
    assert found.log_evidence == pytest.approx(expected, abs=ROUGHLY)
    sampled = sampled_marginal(found)
    assert sampled.log_evidence == pytest.approx(expected, abs=3.0 * sampled.error)
    assert sampled.error < 0.05
    # neither sign is preferred
    above = np.exp(sampled.log_weight) @ (sampled.draws[:, 2] > 0.0)
    assert above == pytest.approx(0.5, abs=0.06)


@pytest.mark.parametrize("size", [-0.02, 0.0, 0.05])
def test_a_one_sided_effect_may_pile_up_at_zero(size: float) -> None:
    """ln f = ln F0 + A c + bump t, t >= 0, where the data may ask for a negative t."""
    prior = ScaledStudentT(0.02, 4.0, 0.0, 0.16)
    f = measured(size * BUMP)
    # a likelihood that falls from zero on may do so within 1e-4
    t = np.concatenate(([0.0], np.geomspace(1e-7, 0.16, 4000)))
    slope = SD * A * f[:, None]
    covariance = slope @ slope.T + np.diag((NOISE * f) ** 2)
    log_p = np.array([log_normal_density(f, F0 * np.exp(v * BUMP), covariance) for v in t])
    log_p = log_p + prior.log_density(t)
    weight = np.exp(log_p - log_p.max())
    total = np.trapezoid(weight, t)
    expected = np.log(total) + log_p.max()
    laplace = weighed(compared(f, cause("dust", prior), straight(BUMP)))
    assert laplace.log_evidence == pytest.approx(expected, abs=ROUGHLY)
    found = sampled_marginal(laplace)
    assert found.log_evidence == pytest.approx(expected, abs=3.0 * found.error)
    mean = np.trapezoid(weight * t, t) / total
    sd = np.sqrt(np.trapezoid(weight * (t - mean) ** 2, t) / total)
    # 512 weighted points
    assert found.moments()[0][2] == pytest.approx(mean, abs=0.15 * sd)
    assert found.moments()[1][2] == pytest.approx(sd, rel=0.15)


def test_importance_sampling_says_its_own_error() -> None:
    warp = cause("warp", ScaledStudentT(0.1, 4.0, -0.8, 0.8))
    z = []
    for k in range(12):
        f = measured(0.012 * np.roll(BUMP, k))
        found = sampled_marginal(weighed(compared(f, warp, even(BUMP))))
        assert 0.0 < found.error < 0.1
        z.append((found.log_evidence - by_quadrature(f, NOISE, warp.parameters[0].prior, BUMP)) / found.error)
    # a Sobol sequence is at least as good as chance
    assert np.sqrt(np.mean(np.square(z))) < 1.5


def test_inferred_noise_is_integrated_by_importance_sampling() -> None:
    f = measured(noise=0.006)
    comparison = plain(f, None)
    prior = comparison.parameters["relative_std"].prior
    # even in the logarithm: the density is smooth there
    s = np.exp(np.linspace(np.log(prior.lower), np.log(prior.upper), 4001))
    log_p = np.array([exact_log_evidence(f, v * f) for v in s]) + prior.log_density(s) + np.log(s)
    expected = logsumexp(log_p, b=np.log(s[1] / s[0]))
    laplace = weighed(comparison, ())
    found = sampled_marginal(laplace)
    assert found.log_evidence == pytest.approx(expected, abs=3.0 * found.error)
    # Laplace's method alone misses the skewness of the noise's score
    assert laplace.log_evidence == pytest.approx(expected, abs=0.4)


def test_a_hopeless_hypothesis_is_not_refined() -> None:
    comparison = compared(measured(0.004 * BUMP), BENT, even(BUMP))
    assert len(weighed(comparison, least=1e6).z) < len(weighed(comparison).z)


def test_shares_of_optima_and_nodes_sum_to_one_and_are_the_same_each_time() -> None:
    f, warp = measured(0.012 * BUMP), cause("warp", ScaledStudentT(0.1, 4.0, -0.8, 0.8))
    given, inferred = (compared(f, warp, even(BUMP), noise) for noise in (NOISE, None))
    found = weighed(given)
    assert np.all(np.diff(found.weight) <= 0.0)
    assert found.weight.sum() == pytest.approx(1.0, abs=1e-12)
    assert np.exp(found.log_weight).sum() == pytest.approx(1.0, abs=1e-12)
    first, second = (sampled_marginal(weighed(inferred)) for _ in range(2))
    assert first.log_evidence == second.log_evidence
    np.testing.assert_array_equal(first.draws, second.draws)


def test_what_lies_outside_the_constraints_carries_nothing() -> None:
    comparison = plain(measured(noise=0.05), 0.05)
    middle = 1.03
    part = comparison.model.parts[0]
    cut = replace(part, bare=replace(part.bare, allowed=lambda x: x[:, 0] < middle))  # type: ignore[type-var]
    half = replace(comparison, model=replace(comparison.model, parts=(cut,)))
    whole, found = (sampled_marginal(weighed(c, ())) for c in (comparison, half))
    share = np.exp(whole.log_weight) @ (whole.draws[:, 0] < middle)
    # of 512 points
    assert found.log_evidence - whole.log_evidence == pytest.approx(np.log(share), abs=0.1)
    assert np.all(found.draws[np.isfinite(found.log_weight), 0] < middle)


@pytest.mark.parametrize(
    ("of", "shift", "relative"),
    [
        (hypothesis(BENT, 0.1), BUMP, NOISE),
        (hypothesis(BENT, 0.1), BUMP, None),
        (hypothesis(WARP, 0.1), DENT, NOISE),
        (ANYTHING, BUMP, NOISE),
        (ANYTHING, BUMP, None),
    ],
    ids=["given noise", "inferred noise", "even", "discrepancy", "discrepancy and inferred noise"],
)
def test_emcee_and_importance_sampling_agree(
    of: Hypothesis, shift: np.ndarray, relative: float | None
) -> None:
    own = with_causes(measured(0.012 * shift), *of.effects, relative=relative)
    t = weighing.Tested(of, (0,), sampled_marginal(weighing.marginal_of([own], of, (0,))))
    comparison = t.marginal.comparison
    rng = np.random.default_rng(0)
    start = comparison.scores.to_z(rng.permutation(t.marginal.resampled(40)))
    start += 0.1 * rng.standard_normal(start.shape)
    sampler = emcee.EnsembleSampler(*start.shape, comparison.log_density, vectorize=True)
    sampler.random_state = np.random.RandomState(0).get_state()
    sampler.run_mcmc(start, 1500)
    draws = comparison.scores.to_x(sampler.get_chain(discard=300, flat=True))
    mean, sd = t.marginal.moments()
    weight = np.exp(t.marginal.log_weight)
    size = 1.0 / np.sum(weight**2)  # effective, of importance sampling
    if of.effects and of.effects[0].even:
        # two peaks of either sign: their square is what is known
        column = t.columns[0]
        squares = draws[:, column] ** 2
        np.testing.assert_allclose(squares.mean(), weight @ t.marginal.draws[:, column] ** 2, rtol=0.05)
        # walkers do not cross from one sign to the other, importance sampling has both
        assert weight @ (t.marginal.draws[:, column] > 0.0) == pytest.approx(0.5, abs=0.05)
    # four standard errors of a mean and of a standard deviation; chains have at least 1000 effective samples
    error = np.sqrt(1.0 / size + 1.0 / 1000.0)
    np.testing.assert_array_less(np.abs(draws.mean(axis=0) - mean) / sd, 4.0 * error)
    np.testing.assert_allclose(draws.std(axis=0), sd, rtol=4.0 * error)
