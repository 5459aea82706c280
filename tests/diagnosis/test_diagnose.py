"""From plates to an answer: claim, extended fit by importance sampling and by emcee, and gain."""

from dataclasses import replace

import numpy as np
import pytest

from cpam_bayes.diagnosis import fit as gain
from cpam_bayes.diagnosis.diagnose import diagnose_cases
from cpam_bayes.diagnosis.evidence import weighing
from cpam_bayes.diagnosis.evidence.sampled import sampled_marginal
from cpam_bayes.diagnosis.hypotheses import NONE, OTHER, Claim, Hypothesis
from cpam_bayes.effects import ListChange
from cpam_bayes.effects.effect import MISREADING
from tests.diagnosis import toy_plates as toy
from tests.diagnosis.toy_plates import ANYTHING, BENT, BUMP, DENT, DENTED, F0, NOISE, NOTHING, SD, A

FALSE = [
    Hypothesis("mode_identity", "list", f"frequency {i + 1} false", listed=ListChange(spurious=i), prior=0.01)
    for i in range(8)
]
WILD = 0.05 * np.array([1.0, 1.0, -1.0, 1.0, -1.0, -1.0, 1.0, 1.0])  # no cause shifts the modes like this


def plate(shift, *effects, name="toy"):
    return toy.with_causes(toy.measured(shift), *effects, name=name)


def diagnosed(own, *singles, gain=False, sets=True):
    every = toy.of_one(NOTHING, ANYTHING, *singles)
    return diagnose_cases([own], hypotheses=every, gain=gain, sets=sets, power=False)


@pytest.mark.parametrize(
    ("shift", "effects", "kind", "causes"),
    [
        (0.0 * BUMP, (BENT, DENTED), "none", set()),
        (0.04 * BUMP + 0.04 * DENT, (BENT, DENTED), "pair", {"bent", "dented"}),
        (0.03 * BUMP, (BENT, toy.TWIN, DENTED), "class", {"bent", "twin"}),
        (WILD, (BENT, DENTED), "other", set()),
    ],
)
def test_each_claim_has_its_members_and_its_fit(shift, effects, kind, causes):
    found = diagnosed(plate(shift, *effects), *(toy.hypothesis(e) for e in effects), sets=kind != "other")
    assert (found.claim.kind, set(found.claim.causes)) == (kind, causes)
    by_name = {cause.name: cause for cause in found.causes}
    assert sum(c.probability for c in found.causes) == pytest.approx(1.0)
    assert {NONE, OTHER, "bent", "dented"} <= set(by_name)
    assert (found.extended is None) == (found.members == ()) == (kind == "none")
    assert found.gain is None
    if kind == "pair":
        assert found.extended.rms < 2 * NOISE
    if kind == "class":
        assert by_name["bent"].indistinguishable_from == ("twin",)
        assert sum(share for _, share in found.members) == pytest.approx(1.0)
        assert {t.hypothesis.cause for t, _ in found.members} == causes


def test_a_cause_is_named_with_its_size_its_fit_and_its_gain():
    own = plate(0.03 * BUMP, BENT, DENTED)
    found = diagnosed(own, toy.hypothesis(BENT), toy.hypothesis(DENTED), gain=True)
    assert (found.claim.kind, found.claim.causes) == ("named", ("bent",))
    plain, with_it = (exact_evidences(own.measurement.frequencies, *some)[0] for some in ((), [(BUMP, 0.02)]))
    for factor in (found.causes[0].log_bayes_factor, found.gain.log_bayes_factor):
        assert factor == pytest.approx(with_it - plain, abs=0.15)
    mean, sd, unit = found.causes[0].parameters["size of bent"]
    assert abs(mean - 0.03) < 3 * sd
    assert (unit, found.gain.stable) == ("", 1.0)
    assert found.extended.rms < NOISE < found.baseline.rms  # the list's own noise remains
    assert (found.gain.rms_before, found.gain.rms_after) == (
        found.baseline.rms_as_stated,
        found.extended.rms_as_stated,
    )
    assert found.extended.p_value > 0.05 > 1e-3 > found.baseline.p_value
    for name, truth in (("E1", 1.03), ("G12", 0.96)):  # unlike the plain model, the extended one covers them
        mean, sd, low, high = found.extended.constants[name]
        assert low < mean < high
        assert abs(mean - truth) < 3.5 * sd
        assert high - low == pytest.approx(3.92 * sd, rel=0.1)


def test_an_even_cause_is_told_by_its_magnitude():
    found = diagnosed(plate(0.15**2 * DENT, toy.WARP), toy.hypothesis(toy.WARP))
    assert found.claim.causes == ("warp",)
    mean, sd, _ = found.causes[0].parameters["size of warp"]
    assert mean == pytest.approx(0.15, abs=3 * sd)
    assert sd < 0.02


# The last one equals its neighbour: a list rounded to 1 Hz may hold a number twice.
@pytest.mark.parametrize(("at", "share"), [(2, 0.5), (7, 0.5), (4, 0.0)])
def test_a_false_peak_is_found_and_the_rest_refitted(at, share):
    f = toy.measured()
    listed = np.insert(f[:7], at, f[at - 1] + share * (f[at] - f[at - 1]))
    found = diagnosed(toy.with_causes(listed, BENT), toy.hypothesis(BENT), *FALSE, gain=True)
    assert found.claim.causes == ("mode_identity",)
    assert found.causes[0].variant in {f"frequency {i + 1} false" for i in ({at} if share else {at - 1, at})}
    # all eight frequencies are in the answer, the false one as measured
    assert found.extended.predicted.shape == found.baseline.predicted.shape == (8,)
    np.testing.assert_allclose(found.extended.predicted, listed, rtol=3 * NOISE)
    if share:
        assert found.extended.predicted[at] == pytest.approx(listed[at], rel=1e-12)
    assert found.extended.rms < NOISE
    assert np.isfinite(found.gain.held_out).tolist() == [True] * 8


def test_what_is_wrong_with_one_of_two_lists_is_left_out_of_that_list():
    cases = [plate(np.zeros(8), name="one"), plate(toy.with_slip(3, 0.15), name="two")]
    misread = [(toy.misread(i), (k,)) for k in (0, 1) for i in range(8)]
    found = diagnose_cases(cases, hypotheses=[(NOTHING, (0, 1)), (ANYTHING, (0, 1)), *misread], power=False)
    assert (found.claim.causes, found.causes[0].plates) == (("outlier",), ("two",))
    held_out = found.gain.held_out  # the misread one is the twelfth of both lists
    assert int(np.argmax(np.abs(held_out))) == 11
    assert held_out[11] > 5.0
    assert np.abs(np.delete(held_out, 11)).max() < 0.3 * held_out[11]


# Held-out scores: ln p(f_i | others) = ln Z - ln Z without it
@pytest.mark.slow
def test_the_other_frequencies_are_left_out_beside_a_false_one_by_their_own_list(monkeypatch):
    """In two lists of eight, the fourth frequency of the second is the twelfth."""
    cases = [plate(np.zeros(8), name=name) for name in ("one", "two")]
    t = weighing.Tested(FALSE[3], (1,), weighing.marginal_of(cases, FALSE[3], (1,)))
    asked = []

    def recorded(*_, left_out, **__):
        asked.append(left_out)
        return t.marginal

    monkeypatch.setattr(gain, "marginal_of", recorded)
    found = gain.left_out(cases, t, 16, None, 0.02)
    assert asked == [*range(11), *range(11, 15)]
    density = t.marginal.log_evidence - found[11]  # a false peak may lie anywhere below the last frequency
    assert density == pytest.approx(-np.log(cases[1].measurement.frequencies[-1]))


def test_a_misread_frequency_is_predicted_by_the_prior_of_its_error():
    """ln p(f_i | others) with the constants in closed form and an integral over the misreading."""
    own = plate(toy.with_slip(3, 0.15))
    f, sigma, at = own.measurement.frequencies, NOISE * own.measurement.frequencies, 3
    t = toy.with_evidence(own, toy.misread(at))
    t = replace(t, marginal=sampled_marginal(t.marginal))
    found = t.marginal.log_evidence - gain.left_out([own], t, 8, None, 0.02)[at]
    kept, slope = np.arange(8) != at, SD * A * F0[:, None]
    covariance = slope @ slope.T + np.diag(sigma**2)
    answer = np.linalg.solve(covariance[np.ix_(kept, kept)], covariance[kept, at])
    mean = F0[at] + answer @ (f - F0)[kept]
    variance = slope[at] @ slope[at] - answer @ covariance[kept, at]
    m = np.linspace(MISREADING.prior.lower, MISREADING.prior.upper, 20001)
    spread = (1.0 + m) ** 2 * variance + sigma[at] ** 2
    log_density = -0.5 * (f[at] - (1.0 + m) * mean) ** 2 / spread - 0.5 * np.log(2 * np.pi * spread)
    log_density += MISREADING.prior.log_density(m)
    direct = np.log(np.trapezoid(np.exp(log_density), m))
    assert found == pytest.approx(direct, abs=0.1)  # two evidences by importance sampling


def exact_evidences(f, *causes):
    lists = [np.arange(8), *(np.delete(np.arange(8), i) for i in range(8))]
    return np.array([toy.exact_log_evidence(f[k], NOISE * f[k], *causes, modes=k) for k in lists])


def test_held_out_scores_select_the_cause_again_without_each_frequency():
    """For a faint cause: the mixture of plain and extended model, weighted by the other frequencies."""
    own = plate(0.006 * BUMP, BENT)
    found = diagnosed(own, toy.hypothesis(BENT), sets=False)
    bent = found.weighed.best_of("bent")
    assert 0.1 < bent.probability < 0.99
    claim, fit = Claim("named", ("bent",), 0.9), found.baseline
    scored = gain.gain_of([own], found.weighed, claim, [(bent, 1.0)], fit, fit, 0.02)
    f = own.measurement.frequencies
    plain, extended = exact_evidences(f), exact_evidences(f, (BUMP, 0.02))
    mixture = np.logaddexp(plain + np.log(0.5), extended + np.log(0.1))
    expected = (mixture[0] - mixture[1:]) - (plain[0] - plain[1:])
    assert scored.n_hypotheses >= 2
    np.testing.assert_allclose(scored.held_out, expected, atol=0.1)
    assert scored.held_out_difference == pytest.approx(scored.held_out.sum())
    assert scored.held_out_se == pytest.approx(np.sqrt(8) * np.std(scored.held_out, ddof=1))
    ahead = (extended + np.log(0.1) > plain + np.log(0.5))[1:]
    assert scored.stable == pytest.approx(ahead.mean(), abs=1e-12)
