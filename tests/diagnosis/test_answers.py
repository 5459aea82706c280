"""Answers from weighed hypotheses: other priors, constants, p-values, signatures, detection limits."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.stats import chi2, kstest, norm

from cpam_bayes.diagnosis import signatures
from cpam_bayes.diagnosis.answers import detectability, optima
from cpam_bayes.diagnosis.answers.detectability import Detectable, detectable, linear_oracle, shift_lines
from cpam_bayes.diagnosis.answers.optima import averaged_constants, prior_sensitivity, reweighed
from cpam_bayes.diagnosis.comparison import REPEATABILITY_PRIOR
from cpam_bayes.diagnosis.evidence import weighing
from cpam_bayes.diagnosis.fit import explains, misfit_beyond_noise
from cpam_bayes.diagnosis.hypotheses import NONE, OTHER, Hypothesis, claim_of
from cpam_bayes.diagnosis.signatures import Signature, alike, cosine, nearest_of, projector_of, signature_of
from cpam_bayes.effects import ListChange
from cpam_bayes.effects.effect import MISREADING
from cpam_bayes.inference.log_density import CorrelatedDensity
from cpam_bayes.parameters import Parameter, ParameterSet, Uniform
from tests.diagnosis import toy_plates as toy
from tests.diagnosis.toy_plates import ANYTHING, BENT, BUMP, DENT, DENTED, F0, NOISE, NOTHING, SD, A
from tests.toy_models import ToyModel


def weigh(own, *singles):
    return weighing.weigh([own], toy.of_one(NOTHING, *singles), sets=False)


def with_and_without(f, relative=NOISE):
    return weigh(toy.with_causes(f, BENT, relative=relative), toy.hypothesis(BENT))


def exact_factor(f, *causes):
    return toy.exact_log_evidence(f, NOISE * f, *causes) - toy.exact_log_evidence(f, NOISE * f)


def factor_over_noise(f, prior, size, a):
    """Log Bayes factor of a bump of this prior size, with noise inferred at the points a of its prior."""
    log_p = [[toy.exact_log_evidence(f, s * f, *some) for s in a] for some in ([(BUMP, size)], [])]
    log_p += prior.log_density(a)
    with_bump, without = np.log(np.trapezoid(np.exp(log_p - np.max(log_p)), a))
    return float(with_bump - without)


@pytest.mark.parametrize("factor", [3.0, 1.0 / 3.0])
@pytest.mark.parametrize("size", [0.0, 0.006, 0.02])
def test_probabilities_are_those_of_the_other_prior(size, factor):
    f = toy.measured(size * BUMP)
    found = with_and_without(f)
    other = reweighed(found, factor)
    bent = other.best_of("bent")
    missed = found.best_of("bent").log_bayes_factor - exact_factor(f, (BUMP, 0.02))  # error of the evidence
    assert bent.log_bayes_factor - missed == pytest.approx(exact_factor(f, (BUMP, factor * 0.02)), abs=0.08)
    odds = 0.2 * np.exp(bent.log_bayes_factor)
    assert bent.probability == pytest.approx(odds / (1.0 + odds), rel=1e-9)
    assert sum(t.probability for t in other.tested) == pytest.approx(1.0)


@pytest.mark.parametrize("factor", [3.0, 1.0 / 3.0])
def test_the_prior_of_an_inferred_repeatability_is_scaled_too(factor):
    f, a = toy.measured(), np.geomspace(1e-5, 0.3, 2001)
    found = with_and_without(f, None)
    bent = reweighed(found, factor).best_of("bent")
    factors = [factor_over_noise(f, REPEATABILITY_PRIOR.rescaled(k), k * 0.02, a) for k in (1.0, factor)]
    moved = bent.log_bayes_factor - found.best_of("bent").log_bayes_factor
    assert moved == pytest.approx(factors[1] - factors[0], abs=0.1)


@pytest.mark.parametrize(("size", "stands"), [(0.0, True), (0.03, True), (0.006, False)])
def test_a_claim_stands_if_it_is_the_same_with_all_scales(size, stands):
    def claim(w):
        factors = {c: w.log_bayes_factor((c,)) for c in w.by_cause()}
        return claim_of({**w.by_cause(), OTHER: 0.0}, {**factors, OTHER: -np.inf})

    found = with_and_without(toy.measured(size * BUMP))
    sensitivity = prior_sensitivity(found, claim(found), claim)
    assert sensitivity.claim_stands is stands
    assert [*sensitivity.probabilities] == [reweighed(found, k).by_cause() for k in (3.0, 1.0 / 3.0)]


def test_constants_are_those_of_the_mixture_of_all_hypotheses():
    """Two normal posteriors, 0.7 and 0.3, and a negligible one far away."""
    bent = toy.cause("bent", toy.whole_normal(0.02))
    own = toy.case(toy.a_list(F0, NOISE), [(bent, toy.straight(np.ones(8)))])
    p, tested = (np.arange(20000) + 0.5) / 20000, []
    none, other = Hypothesis(NONE, NONE, prior=0.5), toy.hypothesis(bent)
    for of, share, *normal in ((none, 0.7, 1.0, 0.01), (other, 0.3, 1.1, 0.03), (other, 1e-7, 9.0, 0.1)):
        each = toy.with_evidence(own, of, share)
        draws = np.tile(norm.ppf(p, *normal)[:, None], (1, each.marginal.draws.shape[1]))
        marginal = replace(each.marginal, draws=draws, log_weight=np.full(len(p), -np.log(len(p))))
        tested.append(replace(each, marginal=marginal))
    mean, sd, *interval = averaged_constants(weighing.Weighed(tuple(tested), ()))["E1"]
    assert mean == pytest.approx(1.03, abs=1e-6)
    assert sd == pytest.approx(np.sqrt(0.7 * 0.01**2 + 0.3 * 0.03**2 + 0.21 * 0.1**2), rel=1e-3)
    below = 0.7 * norm.cdf(interval, 1.0, 0.01) + 0.3 * norm.cdf(interval, 1.1, 0.03)
    assert below == pytest.approx([0.025, 0.975], abs=1.5e-4)
    # quantiles of a few draws of equal weights lie between them
    few = optima.weighted_quantiles(np.array([3.0, 1.0, 2.0, 4.0]), np.full(4, 0.25), [0.125, 0.5, 0.875])
    np.testing.assert_allclose(few, [1.0, 2.5, 4.0])


def weighed_list(f, of, relative):
    return toy.with_evidence(toy.with_causes(f, BENT, relative=relative), of)


def direct(f, sigma, *directions):
    """p-value and misfit beyond noise of the toy plate with normal priors, by ridge regression."""
    slope = np.column_stack([SD * A, *(sd * d for d, sd in directions)]) * (f / sigma)[:, None]
    hat = slope @ np.linalg.inv(slope.T @ slope + np.eye(slope.shape[1])) @ slope.T
    r = f * np.log(f / F0) / sigma
    r = r - hat @ r
    beyond = np.sqrt(max(np.mean((r**2 - 1.0) * (sigma / f) ** 2), 0.0))
    return float(chi2.sf(r @ r, len(f) - np.trace(hat))), float(beyond)


@pytest.mark.parametrize("size", [0.0, 0.004, 0.01, 0.03])
def test_a_stated_repeatability_gives_the_chi_square_of_the_residuals_and_their_misfit(size):
    f = toy.measured(size * BUMP)
    p, beyond = direct(f, NOISE * f)
    plain = weighed_list(f, NOTHING, NOISE)
    assert explains(plain) == pytest.approx(p, rel=1e-3)
    assert (beyond > 0.0) == (size > 0.005)
    assert misfit_beyond_noise(plain) == pytest.approx(beyond, rel=0.03)
    extended = explains(weighed_list(f, toy.hypothesis(BENT), NOISE))
    assert extended == pytest.approx(direct(f, NOISE * f, (BUMP, 0.02))[0], rel=0.02)
    assert extended > 0.05


def test_an_inferred_repeatability_is_averaged_over_its_prior():
    f = F0 * (1.0 + A @ [0.03, -0.04] + 0.03 * BUMP)
    found = explains(weighed_list(f, NOTHING, None))
    p = (np.arange(8000) + 0.5) / 8000  # many points: the tail near the end of the prior explains it best
    expected = np.mean([direct(f, a * f)[0] for a in REPEATABILITY_PRIOR.ppf(p)])
    assert found == pytest.approx(expected, rel=0.03)


def test_a_misfit_of_many_times_any_repeatability_is_not_explained_by_noise():
    f = F0 * (1.0 + 0.45 * np.array([1.0, -1.0, 1.0, 1.0, -1.0, -1.0, 1.0, -1.0]))
    assert explains(weighed_list(f, NOTHING, None)) < 1e-6
    # a scatter of all modes that nothing explains is part of that hypothesis
    assert explains(weighed_list(f, ANYTHING, NOISE)) > explains(weighed_list(f, NOTHING, NOISE)) < 1e-12


def test_p_values_of_lists_by_the_model_itself_are_uniform():
    rng, found = np.random.default_rng(1), []
    for _ in range(200):
        f = F0 * (1.0 + A @ (SD * rng.standard_normal(2))) * (1.0 + NOISE * rng.standard_normal(8))
        found.append(explains(weighed_list(f, NOTHING, NOISE)))
    assert kstest(found, "uniform").pvalue > 0.01


def test_a_step_to_where_the_plate_buckles_is_not_taken(monkeypatch):
    f = toy.measured()
    tested = weighed_list(f, NOTHING, NOISE)
    whole = explains(tested)

    def buckled(self, x):
        return np.empty(0, dtype=int), np.empty((0, len(f))), None

    monkeypatch.setattr(CorrelatedDensity, "predict_inside", buckled)
    assert explains(tested) == pytest.approx(whole, rel=1e-3)  # a Gauss-Newton step leaves the optimum


def weighed(*effects, relative=NOISE, other=False, scatter=0.0):
    own = toy.with_causes(F0 * (1.0 + scatter * toy.SCATTER), *effects, relative=relative)
    return weigh(own, *([ANYTHING] if other else []), *(toy.hypothesis(e) for e in effects))


def oracle_of(found, n):
    return linear_oracle(found, shift_lines(found.tested, found.none.marginal), n, np.random.default_rng(0))


def limits(found):
    return {entry.cause: entry for entry in detectable(found)}


def smallest(found, name="bent"):
    return limits(found)[name].smallest


def log_odds(oracle, shifts):
    log_weight = dict(zip(oracle.causes, oracle.log_weights(shifts), strict=True))
    return {cause: weight - log_weight[NONE] for cause, weight in log_weight.items()}


def test_evidences_of_simulated_lists_are_exact():
    oracle = oracle_of(weighed(BENT, DENTED), 16)
    shift = np.stack([np.zeros(8), 0.01 * BUMP, 0.02 * BUMP - 0.005 * DENT])
    odds = log_odds(oracle, shift)
    assert set(odds) == {NONE, "bent", "dented"}
    for (i, j), (name, direction) in product(np.ndindex(16, 3), (("bent", BUMP), ("dented", DENT))):
        f = F0 * np.exp(oracle.noise[i] + shift[j])
        expected = exact_factor(f, (direction, 0.02)) + np.log(0.1 / 0.5)
        assert odds[name][i, j] == pytest.approx(expected, abs=0.03 + 0.02 * abs(expected))


def test_an_inferred_noise_is_integrated_over_its_prior():
    found = weighed(BENT, relative=None, scatter=NOISE)
    oracle, shift = oracle_of(found, 8), 0.01 * BUMP
    prior = found.none.marginal.comparison.parameters.parameters[-1].prior
    a = np.geomspace(prior.lower, prior.upper, 3001)
    for noise, odds in zip(oracle.noise, log_odds(oracle, shift[None])["bent"][:, 0], strict=True):
        expected = factor_over_noise(F0 * np.exp(noise + shift), prior, 0.02, a) + np.log(0.2)
        assert odds == pytest.approx(expected, abs=0.5 + 0.1 * abs(expected))


NEAR = BUMP + 0.45 * DENT  # similar to the first cause: the cosine of the visible parts is 0.9


@pytest.mark.parametrize(("other", "prior"), [(DENT, 0.1), (NEAR, 0.01)])
def test_the_power_of_a_claim_is_that_of_lists_that_are_simulated(other, prior):
    """The rule for claims, on exact evidences of 400 lists with the size found and their own noise."""
    own = toy.case(toy.a_list(F0, NOISE), [(BENT, toy.straight(BUMP)), (DENTED, toy.straight(other))])
    entry = limits(weigh(own, toy.hypothesis(BENT), toy.hypothesis(DENTED, prior)))["bent"]
    assert entry.probability_of_claim == pytest.approx(0.95, abs=0.02)
    rng = np.random.default_rng(7)

    def power(size):
        claims = []
        for _ in range(400):
            f = F0 * np.exp(size * BUMP) * (1.0 + NOISE * rng.standard_normal(8))
            bent, rival = (exact_factor(f, (d, 0.02)) for d in (BUMP, other))
            weight = np.array([0.1 * np.exp(bent), prior * np.exp(rival), 0.5])
            # 3 nats before none follow from the probability, 3 nats before the other cause do not
            claims.append(weight[0] >= 0.9 * weight.sum() and bent >= rival + 3.0)
        return float(np.mean(claims))

    assert power(entry.smallest) == pytest.approx(0.95, abs=0.035)  # 400 lists: one per cent
    assert power(0.8 * entry.smallest) < 0.85


def test_a_cause_that_cannot_be_told_from_another_is_seen_as_their_class():
    alone, both = weighed(BENT), weighed(BENT, toy.TWIN)
    for name in ("bent", "twin"):
        assert smallest(both, name) == pytest.approx(smallest(alone), rel=0.15)
    assert detectable(alone) == detectable(weighed(BENT))


def test_sizes_are_those_of_the_cause_with_its_sign_and_slope_and_none_of_what_constants_absorb():
    every = weighed(toy.WARP, BENT, toy.HEAVY, toy.STIFF, other=True)
    found, root = limits(every), oracle_of(weighed(BENT), 64).root
    for name, slope in (("warp", 2), ("heavy", 1), ("bent", 1)):
        assert found[name].parameter is not None
        direction = toy.SHIFTS[name](np.array([1.0]))[0][0]
        # between three and ten standard deviations of what the constants cannot imitate
        assert 3.0 < np.linalg.norm(root @ direction) * smallest(every, name) ** slope < 12.0
    assert {NONE, OTHER}.isdisjoint(found)
    assert found["stiff"].smallest is None
    assert found["stiff"].probability_of_claim < 0.05


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_size_is_that_of_the_sign_that_shows_less(sign):
    def limit(weaker):
        """Detection limit of a cause that shifts the modes less with one sign than with the other."""

        def shift(t):
            slope = np.where(sign * t > 0.0, weaker, 1.0)[:, None] * BUMP
            return t[:, None] * slope, slope

        return smallest(weigh(toy.case(toy.a_list(F0, NOISE), [(BENT, shift)]), toy.hypothesis(BENT)))

    assert limit(0.5) == pytest.approx(2.0 * limit(1.0), rel=0.1)
    assert limit(0.0) is None


def test_what_is_wrong_with_a_list_has_no_size_and_a_cause_that_of_a_variant_that_has_one():
    found = weighed(BENT)
    of_list = replace(found.none, hypothesis=Hypothesis("mode_identity", "list", "mode 1 missed", prior=0.1))
    entry = limits(replace(found, tested=(*found.tested, of_list)))["mode_identity"]
    assert entry == Detectable("mode_identity", None, None, None)
    sized = found.best_of("bent")
    gross = replace(sized.hypothesis, variant="gross", parameters=())
    first = replace(sized, hypothesis=gross, shift=None, probability=0.9)
    both = limits(replace(found, tested=(first, *found.tested)))["bent"]
    assert both.parameter == sized.hypothesis.parameters[0]
    assert both.smallest is not None


def test_a_cause_with_a_place_has_the_size_at_the_median_place(monkeypatch):
    """Half of the places show the cause only half as well."""
    local = replace(BENT, parameters=(*BENT.parameters, Parameter("place", "", Uniform(0.0, 1.0), 0.5)))

    def function(x):
        bare, slope = toy.plate_model().function(x[:, :2])
        of_size = F0 * np.where(x[:, 3:] > 0.5, 0.5, 1.0) * BUMP
        f = bare + x[:, 2:3] * of_size
        return f, np.concatenate((slope, of_size[..., None], np.zeros_like(of_size)[..., None]), axis=2)

    own = toy.case(toy.a_list(F0, NOISE), [])
    own.extended[local.name, ""] = ToyModel(toy.CONSTANTS.union(ParameterSet(local.parameters)), function)
    shown = np.zeros((19, 8))  # only whether its shifts are known matters, not their values
    sized = replace(toy.with_evidence(own, toy.hypothesis(local), 0.2), shift=shown)
    tested = weighing.Weighed((toy.with_evidence(own, NOTHING, 0.8), sized), ())
    lines = shift_lines(tested.tested, tested.none.marginal)
    assert len(lines) == 16
    assert np.exp([line.log_prior for line in lines]).sum() == pytest.approx(0.1)
    steep = [np.abs(line.shift[-1]).max() / line.size[-1] for line in lines]
    np.testing.assert_allclose(sorted(steep), [0.5] * 8 + [1.0] * 8, rtol=0.05)
    monkeypatch.setattr(detectability, "_PLACES", 16)
    assert smallest(tested) == pytest.approx(2.0 * smallest(weighed(BENT)), rel=0.1)


FINE = 0.001
PLAIN = Hypothesis(NONE, NONE)
DIRECTIONS = {"bump": BUMP, "more bump": -2.0 * BUMP, "bump and stiffer": BUMP + A @ [0.5, -1.0]}
DIRECTIONS |= {"dent": DENT, "stiffer": A @ [0.6, 0.3]}
SHAPES = {name: toy.straight(d) for name, d in DIRECTIONS.items()} | {"even": toy.even(DENT)}
EFFECTS = {name: toy.cause(name, toy.whole_normal(0.1 if name == "even" else 0.02)) for name in SHAPES}


def signature(of, f):
    own = toy.case(toy.a_list(f, FINE), [(effect, SHAPES[name]) for name, effect in EFFECTS.items()])
    asked = of if isinstance(of, Hypothesis) else toy.hypothesis(EFFECTS[of])
    none = weighing.marginal_of([own], PLAIN, (0,))
    tested = weighing.Tested(asked, (0,), weighing.marginal_of([own], asked, (0,), none=none))
    return signature_of(tested, none, projector_of(none))


SLOPES = SD * A / FINE  # derivatives with respect to the constants' scores, in units of the noise


def test_the_projection_is_the_precision_with_the_constants_integrated_and_absorbs_their_mean():
    projector = projector_of(weighing.marginal_of([toy.case(toy.a_list(F0, FINE))], PLAIN, (0,)))
    marginal = np.linalg.inv(np.eye(8) + SLOPES @ SLOPES.T)  # of a linear model with Gaussian priors
    shift = np.random.default_rng(0).standard_normal(8)
    visible = projector.root @ shift
    assert visible @ visible == pytest.approx(shift @ marginal @ shift, rel=1e-9)
    shift = SLOPES @ [0.8, -0.3]
    expected = np.linalg.solve(SLOPES.T @ SLOPES + np.eye(2), SLOPES.T @ shift)
    np.testing.assert_allclose(projector.absorb @ shift, expected, rtol=1e-9)


def test_a_shift_that_the_constants_can_make_is_absorbed_and_another_is_visible():
    absorbed = signature("stiffer", F0 * (1.0 + A @ [0.02, 0.01]))
    assert absorbed.is_absorbed
    assert absorbed.visible_fraction < 0.05  # a standard deviation of the constants is 25 to 50 of the noise
    size = absorbed.bias / SD  # scores per relative change of a constant
    assert size[0] / size[1] == pytest.approx(2.0, rel=0.02)
    found = signature("dent", F0 * (1.0 + 0.01 * DENT))
    assert not found.is_absorbed
    left = DENT - A @ np.linalg.lstsq(A, DENT, rcond=None)[0]
    # the constants' priors are wide compared with the noise: nearly a plain projection
    assert found.visible_fraction == pytest.approx(np.linalg.norm(left) / np.linalg.norm(DENT), abs=0.01)
    assert cosine(absorbed, found) == 0.0


# for an even cause it is not the mean of its two peaks
@pytest.mark.parametrize(("of", "size"), [("dent", 0.012), ("dent", -0.012), ("even", 0.2**2)])
def test_the_shift_has_the_size_and_sign_that_the_data_suggest(of, size):
    found = signature(of, F0 * (1.0 + size * DENT))
    np.testing.assert_allclose(found.shift * FINE, size * DENT, atol=0.1 * abs(size))


def test_the_largest_shift_is_that_of_one_catalogue_standard_deviation():
    assert signature("bump", F0).largest == pytest.approx(0.0, abs=1e-12)  # a normal size's mean is zero
    assert signature(toy.misread(3), F0).largest == pytest.approx(MISREADING.prior.scale, rel=0.01)


def test_causes_whose_visible_shifts_are_parallel_are_alike():
    f = F0 * (1.0 + 0.01 * BUMP)
    found = {name: signature(name, f) for name in DIRECTIONS}
    names = list(found)
    by_name = {n: {names[j] for j in alike(list(found.values()), i)} for i, n in enumerate(names)}
    same = {"bump", "more bump", "bump and stiffer"}
    assert by_name == {name: same - {name} if name in same else set() for name in names}
    assert abs(cosine(found["bump"], found["bump and stiffer"])) > 0.99  # added within the constants' span


LIKE, UNLIKE = [(0.951, 1.0), (1.0, 0.101)], [(0.949, 1.0), (1.0, 0.099)]


@pytest.mark.parametrize(("likeness", "seen"), LIKE + UNLIKE)
def test_signatures_are_equal_from_a_cosine_of_0_95_where_a_tenth_of_both_is_visible(likeness, seen):
    shifts = np.array([[1.0, 0.0], [likeness, np.sqrt(1.0 - likeness**2)]])
    one, other = (Signature(shift, shift, seen, np.zeros(2), 0.0) for shift in shifts)
    assert alike([one, other], 0) == ((1,) if (likeness, seen) in LIKE else ())


def test_the_nearest_shift_is_one_that_is_there():
    target = np.array([1.0, 0.0])
    size = np.linspace(0.0, 1.0, 21)[:, None]  # the nearest opposite shift is almost zero
    opposite = -size * target + 1e-6
    assert nearest_of(opposite, target) == 3  # 0.15: the one before is slightly too small
    assert signatures.Menu(opposite, np.ones(21)).cosine(target) == pytest.approx(1.0, abs=1e-6)
    assert nearest_of(size * [1.0, 0.5], target) == 16  # at 0.8
    assert nearest_of(1e-3 * size * target, target) == 20


def test_a_missed_mode_shifts_all_that_follow():
    missed = Hypothesis("mode_identity", "list", listed=ListChange(missed=(5,)))
    found = signature(missed, np.delete(F0 * (1.0 + A @ [0.01, 0.02]), 5))
    assert found.shift.shape == (7,)
    assert np.abs(found.shift[5:]).min() > 10.0 * FINE  # the wrong pairing bends the plain model
    assert found.visible_fraction > 0.3


def test_causes_with_one_signature_are_told_apart_by_fits():
    by_signature = {"turned": ("skew", "inner"), "skew": ("turned",), "mass": (), "load": ()}
    peak = {"turned": 30.0, "skew": 22.9, "inner": 23.1, "mass": 28.1, "load": 27.9}
    probability = {"turned": 0.98, "skew": 1e-4, "inner": 5e-3, "mass": 4e-3, "load": 4e-3}
    found = signatures.with_equal_fits(by_signature, peak, probability)
    # e^7.1 behind: skew is another cause; inner plies at e^6.9 are not; fits within e^2 are equal
    assert found["turned"] == ("inner", "mass")
    assert set(found["skew"]) == {"turned", "inner", "mass", "load"}  # a better fit imitates a worse one
    for p, stays in ((0.0097, False), (0.0099, True)):  # with 1 % of the probability it stays in the class
        shared = signatures.with_equal_fits(by_signature, peak, {**probability, "skew": p})
        assert ("skew" in shared["turned"]) is stays
    # without fits only signatures are compared
    assert signatures.with_equal_fits(by_signature, {}, probability)["turned"] == ("skew", "inner")


def test_fits_are_compared_of_what_is_probable_and_of_what_looks_like_the_leading_cause():
    probability = {"turned": 0.8, "mass": 0.0041, "load": 0.0039, "skew": 1e-6, NONE: 0.1}
    tested = {c: weighing.Tested(Hypothesis(c, c), (0,), None) for c in probability if c != NONE}
    compared = signatures.compared_by_fits(tested, probability, {"turned": ("skew",)})
    assert set(compared) == {"turned", "mass", "skew"}
