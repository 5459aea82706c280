"""Models and densities of lists under a hypothesis; evidences by closed forms, quadrature and emcee."""

from dataclasses import replace

import emcee
import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, norm

from cpam_bayes.diagnosis.comparison import REPEATABILITY_PRIOR, comparison_of
from cpam_bayes.diagnosis.evidence import weighing
from cpam_bayes.diagnosis.evidence.marginal import laplace_marginal
from cpam_bayes.diagnosis.evidence.sampled import sampled_marginal
from cpam_bayes.diagnosis.hypotheses import DISCREPANCY, Hypothesis
from cpam_bayes.effects import ListChange
from cpam_bayes.effects.effect import FREQUENCY_SCALE, VISCOELASTIC
from cpam_bayes.forward_model.composed import Change, ComposedModel, Part
from cpam_bayes.parameters import Parameter, ParameterSet, ScaledStudentT
from tests.diagnosis import toy_plates as toy
from tests.diagnosis.toy_plates import (
    ANYTHING,
    BENT,
    BUMP,
    CONSTANTS,
    DENT,
    F0,
    NOISE,
    SD,
    A,
    case,
    hypothesis,
)
from tests.toy_models import ToyModel

PLAIN = Hypothesis("none", "none")
NARROW_WARP = toy.cause("warp", toy.whole_normal(0.1), is_even=True)
NOISY = F0 * (1.0 + 0.004 * np.array([1.0, -0.5, 0.3, 2.0, -1.0, 0.2, 0.9, -1.4]))
SMOOTH = replace(ANYTHING, correlation_length=0.8)


def rounded(relative, of=None):
    """A list rounded to 1 Hz, by default of a warped plate."""
    plate = case(toy.a_list(NOISY, relative, 1.0), [(NARROW_WARP, toy.even(BUMP))])
    return comparison_of([plate], of or hypothesis(NARROW_WARP))


def two_lists(of=PLAIN):
    lists = {name: toy.a_list(f, None) for name, f in (("a", NOISY), ("b", 1.001 * F0))}
    return comparison_of([case(listed, name=name, specimen="one") for name, listed in lists.items()], of)


def without_the_third(comparison):
    return replace(comparison, listed=comparison.listed.without(2), left_out=2)


CASES = {
    "given noise": rounded(0.003),
    "inferred noise": rounded(None),
    "discrepancy": rounded(0.003, ANYTHING),
    "inferred noise and discrepancy": rounded(None, ANYTHING),
    "smooth discrepancy": rounded(0.003, SMOOTH),
    "inferred noise and smooth discrepancy": rounded(None, SMOOTH),
    "two lists": two_lists(),
    "two lists and a smooth discrepancy": two_lists(SMOOTH),
    "one frequency left out of a smooth one": without_the_third(rounded(None, SMOOTH)),
    "one frequency left out": without_the_third(rounded(None)),
}
EVERY = pytest.mark.parametrize("comparison", CASES.values(), ids=CASES.keys())


def scores(comparison, m=3):
    return 0.7 * np.random.default_rng(1).standard_normal((m, comparison.parameters.size))


@EVERY
def test_the_gradient_is_the_difference_quotient(comparison):
    for z in scores(comparison):
        expected = toy.differences(lambda v: comparison.log_density(v)[:, None], z, 1e-5)[0]
        found = comparison.expand(z[None])
        assert found.value[0] == pytest.approx(comparison.log_density(z[None])[0], rel=1e-12)
        np.testing.assert_allclose(found.gradient[0], expected, rtol=1e-6, atol=1e-5)


@EVERY
def test_the_likelihood_is_that_of_the_covariance_and_a_frequency_given_the_others_a_ratio(comparison):
    x, listed = comparison.scores.to_x(scores(comparison)), comparison.listed.frequencies
    covariance = comparison.covariance(x)
    away = listed * np.log(listed / comparison.predict(x)[0])

    def log_p(at):
        pairs = zip(away[:, at], covariance[:, at][:, :, at], strict=True)
        return np.array([multivariate_normal.logpdf(d, cov=own) for d, own in pairs])

    every = np.arange(len(listed))
    np.testing.assert_allclose(comparison.log_likelihood(x), log_p(every), rtol=1e-9)
    np.testing.assert_allclose(comparison.variance(x), np.diagonal(covariance, axis1=1, axis2=2), rtol=1e-12)
    for i in every:
        expected = log_p(every) - log_p(np.delete(every, i))
        np.testing.assert_allclose(comparison.log_conditional(x)[:, i], expected, rtol=1e-9)


@EVERY
def test_the_curvature_is_the_information_of_the_residuals(comparison):
    """Of a Gaussian whose mean and covariance depend on the scores, plus one per score from the prior."""
    (z,), to_x = scores(comparison, 1), comparison.scores.to_x
    n, listed = len(z), comparison.listed.frequencies
    inverse = np.linalg.inv(comparison.covariance(to_x(z[None]))[0])
    slope = toy.differences(lambda z: listed * np.log(listed / comparison.predict(to_x(z))[0]), z, 1e-5)
    covariance = toy.differences(lambda z: comparison.covariance(to_x(z)).reshape(len(z), -1), z, 1e-5)
    moved = inverse @ covariance.T.reshape(n, *inverse.shape)
    expected = np.eye(n) + slope.T @ inverse @ slope + 0.5 * np.einsum("iab,jba->ij", moved, moved)
    np.testing.assert_allclose(comparison.expand(z[None]).curvature[0], expected, rtol=1e-5, atol=1e-5)


def test_what_nothing_explains_adds_to_the_variance_and_is_alike_in_modes_near_each_other():
    x, given = np.array([[1.0, 1.0, 0.02]]), (0.003 * NOISY) ** 2 + 1.0 / 12
    white = rounded(0.003, ANYTHING)
    assert white.discrepancy == 2
    np.testing.assert_allclose(white.variance(x)[0], given + (0.02 * NOISY) ** 2, rtol=1e-12)
    relative = (rounded(0.003, SMOOTH).covariance(x)[0] - np.diag(given)) / np.outer(NOISY, NOISY) / 0.02**2
    np.testing.assert_allclose(np.diag(relative), 1.0, rtol=1e-9)
    apart = np.log(NOISY[0] / NOISY[3])
    assert relative[0, 3] == pytest.approx(0.95 * np.exp(-0.5 * (apart / 0.8) ** 2), rel=1e-9)


def test_each_list_has_its_own_repeatability_and_discrepancy():
    comparison, n = two_lists(SMOOTH), len(F0)
    names = [comparison.parameters.names[c] for c in comparison.amplitudes]
    assert names == ["relative_std of a", "relative_std of b"]
    x = np.ones((1, comparison.parameters.size))
    x[0, list(comparison.nuisance)] = (0.001, 0.004, 0.01)
    noise = comparison.variance(x)[0] / comparison.listed.frequencies**2
    np.testing.assert_allclose(noise, np.repeat([0.001**2 + 0.01**2, 0.004**2 + 0.01**2], n), rtol=1e-4)
    assert not comparison.covariance(x)[0, :n, n:].any()


def test_a_repeatability_that_is_left_out_is_of_the_order_of_two_per_mille():
    """docs/priors.md: 95 % of it in 0.04 to 0.9 %, none above 2 %."""
    low, middle, high = REPEATABILITY_PRIOR.ppf([0.025, 0.5, 0.975])
    assert low == pytest.approx(0.0004, rel=0.1)
    assert middle == pytest.approx(0.002, rel=0.01)
    assert high == pytest.approx(0.009, rel=0.05)
    assert REPEATABILITY_PRIOR.upper == 0.02 < DISCREPANCY.prior.upper / 20
    assert DISCREPANCY.prior.ppf(0.05) < low * 2


def test_noise_of_each_frequency_overrules_the_relative_one_and_errors_of_solver_and_theory_add():
    sd, one = np.linspace(0.1, 0.8, len(F0)), np.ones(len(F0))
    plate = case(toy.a_list(NOISY, 0.003))
    of_each = case(replace(toy.a_list(NOISY, 0.003), frequency_sd=sd))
    solver = replace(plate, models=replace(plate.models, error=0.004 * one))
    both = replace(solver, models=replace(solver.models, theory_error=0.012 * one))
    for own, expected in ((of_each, sd), (solver, 0.005 * NOISY), (both, 0.013 * NOISY)):
        comparison = comparison_of([own], PLAIN)
        np.testing.assert_allclose(comparison.variance(np.ones((1, 2)))[0], expected**2, rtol=1e-12)
        assert comparison.noise is None


def test_a_false_peak_lies_anywhere_below_the_last_frequency_and_missed_modes_move_what_follows():
    def changed(f, change):
        return comparison_of([case(toy.a_list(f, 0.003))], Hypothesis("mode_identity", "list", listed=change))

    false, kept = changed(NOISY, ListChange(spurious=3)), np.delete(NOISY, 3)
    # frequencies above it have modes one lower
    expected = norm.logpdf(kept * np.log(kept / F0[:7]), 0.0, 0.003 * kept).sum() - np.log(NOISY[-1])
    assert false.log_likelihood(np.ones((1, 2)))[0] == pytest.approx(expected, rel=1e-12)
    assert changed(NOISY[:6], ListChange(missed=(1, 4))).model.parts[0].modes.tolist() == [0, 2, 3, 5, 6, 7]


def constrained(comparison, below):
    (part,) = comparison.model.parts
    cut = replace(part, bare=replace(part.bare, allowed=lambda x: x[:, 0] < below))
    return replace(comparison, model=replace(comparison.model, parts=(cut,)))


def test_points_that_break_the_constraints_have_no_density_and_the_priors_slope():
    comparison = rounded(None)
    forbidden, z = constrained(comparison, 1.0), scores(comparison, 8)
    found, inside = forbidden.expand(z), forbidden.scores.to_x(z)[:, 0] < 1.0
    assert 0 < inside.sum() < len(z)
    np.testing.assert_array_equal(np.isfinite(found.value), inside)
    np.testing.assert_array_equal(forbidden.log_density(z)[~inside], -np.inf)
    np.testing.assert_array_equal(found.gradient[~inside], -z[~inside])
    np.testing.assert_allclose(found.value[inside], comparison.expand(z).value[inside], rtol=1e-13)


ROUGHLY = 1.5  # tolerance of evidences by optima and nodes, nats: those within ten of the best are sampled


def plain(f, noise=NOISE):
    return comparison_of([case(toy.a_list(f, noise))], PLAIN)


def compared(f, of, shift, noise=NOISE):
    return comparison_of([case(toy.a_list(f, noise), [(of, shift)])], hypothesis(of))


def weighed(comparison, sizes=(2,), least=-np.inf):
    return laplace_marginal(comparison, sizes, np.zeros((1, comparison.parameters.size)), least=least)


def by_quadrature(f, prior, shape, t=None):
    """Log evidence of ln f = ln F0 + A c + shape(t) BUMP, c in closed form; and mean and sd of t."""
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


def test_without_an_effect_a_linear_model_has_the_evidence_and_moments_of_the_gaussian():
    f, slope = toy.measured(), A / NOISE
    covariance = np.linalg.inv(slope.T @ slope + np.eye(2) / SD**2)
    expected = 1.0 + covariance @ slope.T @ np.log(f / F0) / NOISE
    sd, laplace = np.sqrt(np.diag(covariance)), weighed(plain(f), ())
    # Gaussian in the scores: only rounding remains
    assert laplace.log_evidence == pytest.approx(toy.exact_log_evidence(f, NOISE * f), abs=1e-6)
    for found, near in ((laplace, 0.01), (sampled_marginal(laplace), 0.03)):
        mean, spread = found.moments()
        np.testing.assert_allclose(mean, expected, atol=near * sd.max())
        np.testing.assert_allclose(spread, sd, rtol=3 * near)
        np.testing.assert_allclose(found.resampled(2048).mean(axis=0), expected, atol=2 * near * sd.max())


def test_a_second_optimum_at_another_size_counts_where_the_plain_model_explains_the_list():
    two_fold, prior, f = -0.15, toy.whole_normal(0.1), toy.measured()  # 0 and -0.15 shift the modes alike

    def shift(t):
        return t[:, None] * (t[:, None] - two_fold) * BUMP, (2.0 * t[:, None] - two_fold) * BUMP

    of = toy.cause("bent", prior)
    some = toy.of_one(replace(PLAIN, prior=0.9), hypothesis(of))
    found = weighing.weigh([case(toy.a_list(f, NOISE), [(of, shift)])], some, sets=False).best_of("bent")
    expected, *_ = by_quadrature(f, prior, lambda t: t * (t - two_fold))
    assert found.marginal.log_evidence == pytest.approx(expected, abs=0.1)
    assert np.sum(found.marginal.draws[:, 2] < two_fold / 2) > 100


EACH_SIZE = [(size, NOISE) for size in (0.0, 0.004, 0.02, -0.05)]
EACH_NOISE = [(0.017, noise) for noise in (0.01, 1e-3, 1e-4, 2e-5)]  # at last 6e-4 scores wide


@pytest.mark.parametrize(("size", "noise"), EACH_SIZE + EACH_NOISE)
def test_with_a_linear_effect_the_evidence_is_exact_however_narrow_the_posterior(size, noise):
    f = toy.measured(size * BUMP, noise)
    expected = toy.exact_log_evidence(f, noise * f, (BUMP, 0.02))
    found = sampled_marginal(weighed(compared(f, BENT, toy.straight(BUMP), noise)))
    assert found.log_evidence == pytest.approx(expected, abs=3.0 * found.error)
    assert found.error < 0.05


@pytest.mark.parametrize("size", [0.0, 0.05, 0.12, 0.3])
@pytest.mark.parametrize("prior", [toy.WARP.parameters[0].prior, toy.whole_normal(0.1)], ids=["t", "normal"])
def test_an_even_effect_has_both_its_peaks_in_the_evidence(size, prior):
    f, warp = toy.measured(size**2 * BUMP), toy.cause("warp", prior, is_even=True)
    expected, mean, sd = by_quadrature(f, prior, np.square)
    found = weighed(compared(f, warp, toy.even(BUMP)))
    assert found.log_evidence == pytest.approx(expected, abs=ROUGHLY)  # decides which hypotheses are sampled
    sampled = sampled_marginal(found)
    assert sampled.log_evidence == pytest.approx(expected, abs=3.0 * sampled.error)
    assert sampled.error < 0.05
    weight, t = np.exp(sampled.log_weight), sampled.draws[:, 2]  # neither sign is preferred
    assert weight @ (t > 0.0) == pytest.approx(0.5, abs=0.06)
    assert weight @ t**2 == pytest.approx(mean**2 + sd**2, rel=0.05)


@pytest.mark.parametrize("size", [-0.02, 0.0, 0.05])
def test_a_one_sided_effect_may_pile_up_at_zero(size):
    prior, f = ScaledStudentT(0.02, 4.0, 0.0, 0.16), toy.measured(size * BUMP)
    t = np.concatenate(([0.0], np.geomspace(1e-7, 0.16, 4000)))  # may fall off within 1e-4
    expected, mean, sd = by_quadrature(f, prior, lambda t: t, t)
    laplace = weighed(compared(f, toy.cause("dust", prior), toy.straight(BUMP)))
    assert laplace.log_evidence == pytest.approx(expected, abs=ROUGHLY)
    found = sampled_marginal(laplace)
    assert found.log_evidence == pytest.approx(expected, abs=3.0 * found.error)
    assert found.moments()[0][2] == pytest.approx(mean, abs=0.15 * sd)  # 512 weighted points
    assert found.moments()[1][2] == pytest.approx(sd, rel=0.15)


def test_importance_sampling_says_its_own_error():
    z = []
    for k in range(12):
        f = toy.measured(0.012 * np.roll(BUMP, k))
        found = sampled_marginal(weighed(compared(f, toy.WARP, toy.even(BUMP))))
        assert 0.0 < found.error < 0.1
        expected, *_ = by_quadrature(f, toy.WARP.parameters[0].prior, np.square)
        z.append((found.log_evidence - expected) / found.error)
    assert np.sqrt(np.mean(np.square(z))) < 1.5  # a Sobol sequence is at least as good as chance


def test_inferred_noise_is_integrated_by_importance_sampling():
    f = toy.measured(noise=0.006)
    comparison = plain(f, None)
    prior = comparison.parameters["relative_std"].prior
    s = np.exp(np.linspace(np.log(prior.lower), np.log(prior.upper), 4001))  # where the density is smooth
    log_p = np.array([toy.exact_log_evidence(f, v * f) for v in s]) + prior.log_density(s) + np.log(s)
    expected, laplace = logsumexp(log_p, b=np.log(s[1] / s[0])), weighed(comparison, ())
    found = sampled_marginal(laplace)
    assert found.log_evidence == pytest.approx(expected, abs=3.0 * found.error)
    assert laplace.log_evidence == pytest.approx(expected, abs=0.4)  # Laplace misses the skewness


def test_a_hopeless_hypothesis_is_not_refined():
    comparison = compared(toy.measured(0.004 * BUMP), BENT, toy.even(BUMP))
    assert len(weighed(comparison, least=1e6).z) < len(weighed(comparison).z)


def test_shares_of_optima_and_nodes_sum_to_one_and_are_the_same_each_time():
    f = toy.measured(0.012 * BUMP)
    given, inferred = (compared(f, toy.WARP, toy.even(BUMP), noise) for noise in (NOISE, None))
    found = weighed(given)
    assert np.all(np.diff(found.weight) <= 0.0)
    assert (found.weight.sum(), np.exp(found.log_weight).sum()) == pytest.approx((1.0, 1.0), abs=1e-12)
    first, second = (sampled_marginal(weighed(inferred)) for _ in range(2))
    assert first.log_evidence == second.log_evidence
    np.testing.assert_array_equal(first.draws, second.draws)


def test_what_lies_outside_the_constraints_carries_nothing():
    comparison, middle = plain(toy.measured(noise=0.05), 0.05), 1.03
    whole, found = (sampled_marginal(weighed(c, ())) for c in (comparison, constrained(comparison, middle)))
    share = np.exp(whole.log_weight) @ (whole.draws[:, 0] < middle)
    assert found.log_evidence - whole.log_evidence == pytest.approx(np.log(share), abs=0.1)  # 512 points
    assert np.all(found.draws[np.isfinite(found.log_weight), 0] < middle)


@pytest.mark.parametrize("relative", [NOISE, None], ids=["given noise", "inferred noise"])
@pytest.mark.parametrize("of", [hypothesis(BENT), ANYTHING], ids=["a cause", "a discrepancy"])
def test_emcee_and_importance_sampling_agree(of, relative):
    own = toy.with_causes(toy.measured(0.012 * BUMP), *of.effects, relative=relative)
    found = sampled_marginal(weighing.marginal_of([own], of, (0,)))
    comparison, rng = found.comparison, np.random.default_rng(0)
    start = comparison.scores.to_z(rng.permutation(found.resampled(40)))
    start += 0.1 * rng.standard_normal(start.shape)
    sampler = emcee.EnsembleSampler(*start.shape, comparison.log_density, vectorize=True)
    sampler.random_state = np.random.RandomState(0).get_state()
    sampler.run_mcmc(start, 1500)
    draws = comparison.scores.to_x(sampler.get_chain(discard=300, flat=True))
    mean, sd = found.moments()
    error = np.sqrt(np.sum(np.exp(found.log_weight) ** 2) + 1.0 / 1000.0)  # chains of 1000 effective samples
    np.testing.assert_array_less(np.abs(draws.mean(axis=0) - mean) / sd, 4.0 * error)
    np.testing.assert_allclose(draws.std(axis=0), sd, rtol=4.0 * error)


# Model of a hypothesis: several effects, several plates, lists with slips
BARE = toy.plate_model()
(BEND,), (DUST,) = BENT.parameters, toy.WARP.parameters
WITH_BEND = toy.plate_model(shift=toy.straight(BUMP), parameter=BEND)
WITH_DUST = toy.plate_model(shift=toy.even(DENT), parameter=DUST)
EVERY_MODE = np.arange(len(F0))
X = np.array([1.03, 0.95, 0.012, -0.2])


def normal(name, sd=0.01):
    return Parameter(name, "", toy.whole_normal(sd))


def one_plate(*changes, further=(), misread=()):
    part = Part(BARE, np.array([0, 1]), np.array([-1, -1]), changes, EVERY_MODE, misread)
    return ComposedModel(ParameterSet((*CONSTANTS.parameters, *further)), (part,))


def bend(column=2):
    return Change((BEND.name,), (column,), WITH_BEND)


def assert_predicts(model, x, expected):
    """Check frequencies, and that derivatives equal difference quotients."""
    found = model.predict(x[None], jacobian=True)
    np.testing.assert_allclose(found.frequencies[0], expected, rtol=1e-13)
    assert found.jacobian.shape == (1, len(expected), len(x))
    slopes = toy.differences(lambda v: model.predict(v).frequencies, x)
    # central differences, step 1e-6, of frequencies of about 1e2 Hz: rounding 1e-8, curvature less
    np.testing.assert_allclose(found.jacobian[0], slopes, atol=2e-6 * F0.max(), rtol=2e-7)


def bent(constants, size):
    return np.asarray(WITH_BEND.predict(np.append(constants, size)).frequencies[0])


def test_two_effects_add_their_relative_shifts():
    model = one_plate(bend(), Change((DUST.name,), (3,), WITH_DUST), further=(BEND, DUST))
    bare, dusty = (m.predict(x).frequencies[0] for m, x in ((BARE, X[:2]), (WITH_DUST, X[[0, 1, 3]])))
    assert_predicts(model, X, bent(X[:2], X[2]) * dusty / bare)


@pytest.mark.parametrize("effect", [FREQUENCY_SCALE, VISCOELASTIC], ids=lambda e: e.name)
def test_an_effect_on_the_frequencies_acts_on_those_of_the_plate_with_its_effect(effect):
    own = effect.parameters[0]
    model = one_plate(bend(), Change((own.name,), (3,), None, effect.observe), further=(BEND, own))
    f = bent(X[:2], X[2])
    factor = (f / f[0]) ** (0.02 / np.pi) if effect is VISCOELASTIC else 1.02
    assert_predicts(model, np.append(X[:3], 0.02), f * factor)


def test_a_frequency_that_is_misread_is_multiplied():
    model = one_plate(bend(), further=(BEND, normal("slip", 0.05)), misread=((3, 3),))
    assert_predicts(model, np.append(X[:3], 0.2), np.where(EVERY_MODE == 3, 1.2, 1.0) * bent(X[:2], X[2]))


def test_each_plate_has_its_own_deviation_from_the_shared_constants():
    """The effect of the second plate is the first parameter, then come the constants."""
    scatter, constants = (normal(f"scatter {i}") for i in range(4)), np.array([1, 2])
    one = Part(BARE, constants, np.array([3, 4]), (), EVERY_MODE[:5])
    two = Part(BARE, constants, np.array([5, 6]), (bend(0),), EVERY_MODE[2:])
    model = ComposedModel(ParameterSet((BEND, *CONSTANTS.parameters, *scatter)), (one, two))
    first = BARE.predict(np.array([1.03 * 1.02, 0.95 * 0.99])).frequencies[0, :5]
    second = bent(np.array([1.03 * 1.005, 0.95 * 1.03]), 0.012)[2:]
    x = np.array([0.012, 1.03, 0.95, 0.02, -0.01, 0.005, 0.03])
    assert_predicts(model, x, np.concatenate((first, second)))


def test_plates_are_admissible_where_every_one_of_them_is():
    def part(limit):
        allowed = ToyModel(CONSTANTS, BARE.function, lambda x: x[:, 0] < limit)
        return Part(allowed, np.array([0, 1]), np.array([2, -1]), (), EVERY_MODE)

    parameters = ParameterSet((*CONSTANTS.parameters, normal("scatter")))
    model = ComposedModel(parameters, (part(1.1), part(1.0)))
    x = np.array([[0.9, 1.0, 0.0], [1.05, 1.0, 0.0], [0.9, 1.0, 0.2], [1.2, 1.0, -0.3]])
    np.testing.assert_array_equal(model.admissible(x), [True, False, False, True])
