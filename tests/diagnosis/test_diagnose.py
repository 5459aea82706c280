"""From plates to an answer: claim, extended fit by importance sampling and by emcee, and gain."""

from dataclasses import replace

import numpy as np
import pytest

from cpam_bayes.diagnosis import diagnose as diagnosing
from cpam_bayes.diagnosis import fit as gain
from cpam_bayes.diagnosis.comparison import PlateCase
from cpam_bayes.diagnosis.diagnose import Diagnosis, diagnose_cases
from cpam_bayes.diagnosis.evidence import weighing
from cpam_bayes.diagnosis.evidence.sampled import sampled_marginal
from cpam_bayes.diagnosis.hypotheses import NONE, OTHER, Claim, Hypothesis
from cpam_bayes.effects import Effect, ListChange
from cpam_bayes.effects.effect import MISREADING
from tests.diagnosis.toy_plates import (
    ANYTHING,
    BENT,
    BUMP,
    DENT,
    DENTED,
    F0,
    NOISE,
    NOTHING,
    SD,
    STIFF,
    TWIN,
    WARP,
    A,
    Array,
    exact_log_evidence,
    hypothesis,
    log_normal_density,
    measured,
    misread,
    with_causes,
    with_slip,
)

FALSE = tuple(
    Hypothesis("mode_identity", "list", f"frequency {i + 1} false", listed=ListChange(spurious=i), prior=0.01)
    for i in range(8)
)


def plate(shift: Array, *effects: Effect, name: str = "toy") -> PlateCase:
    return with_causes(measured(shift), *effects, name=name)


def diagnosed(
    monkeypatch: pytest.MonkeyPatch,
    own: PlateCase,
    *singles: Hypothesis,
    gain: bool = True,
    sets: bool = True,
) -> Diagnosis:
    every = [(h, (0,)) for h in (NOTHING, ANYTHING, *singles)]
    monkeypatch.setattr(diagnosing, "hypotheses_of", lambda cases: every)
    return diagnose_cases([own], gain=gain, sets=sets)


def test_a_clean_plate_has_nothing_claimed(monkeypatch: pytest.MonkeyPatch) -> None:
    own = plate(np.zeros(8), BENT, DENTED)
    found = diagnosed(monkeypatch, own, hypothesis(BENT, 0.1), hypothesis(DENTED, 0.1))
    assert found.claim.kind == "none"
    assert found.extended is None
    assert found.gain is None
    assert found.members == ()
    assert sum(c.probability for c in found.causes) == pytest.approx(1.0)
    assert {NONE, OTHER, "bent", "dented"} == {c.name for c in found.causes}


def test_a_cause_is_named_with_its_size_its_fit_and_its_gain(monkeypatch: pytest.MonkeyPatch) -> None:
    own = plate(0.03 * BUMP, BENT, DENTED)
    found = diagnosed(monkeypatch, own, hypothesis(BENT, 0.1), hypothesis(DENTED, 0.1))
    assert found.claim.kind == "named"
    assert found.claim.causes == ("bent",)
    named = found.causes[0]
    f = own.measurement.frequencies
    with_it = exact_log_evidence(f, NOISE * f, (BUMP, 0.02))
    plain = exact_log_evidence(f, NOISE * f)
    assert named.log_bayes_factor == pytest.approx(with_it - plain, abs=0.15)
    mean, sd, unit = named.parameters["size of bent"]
    assert abs(mean - 0.03) < 3 * sd
    assert unit == ""
    assert found.extended is not None
    assert found.gain is not None
    # the list's own noise is left
    assert found.extended.rms < NOISE < found.baseline.rms
    assert found.gain.rms_before == found.baseline.rms
    assert found.gain.rms_after == found.extended.rms
    assert found.gain.log_bayes_factor == pytest.approx(with_it - plain, abs=0.15)
    assert found.gain.stable == 1.0
    assert found.extended.p_value > 0.05
    assert found.baseline.p_value < 1e-3
    # the extended model covers the constants, the plain one was bent away from them
    for name, truth in (("E1", 1.03), ("G12", 0.96)):
        mean, sd, low, high = found.extended.constants[name]
        assert low < mean < high
        assert abs(mean - truth) < 3.5 * sd
        assert high - low == pytest.approx(3.92 * sd, rel=0.1)


def exact_evidences(f: Array, *causes: tuple[Array, float]) -> Array:
    """Of the toy plate with its whole list, then without each frequency."""
    slope = np.column_stack([SD * A, *(sd * d for d, sd in causes)]) * f[:, None]
    covariance = slope @ slope.T + np.diag((NOISE * f) ** 2)
    lists = [np.ones(8, dtype=bool), *(np.arange(8) != i for i in range(8))]
    return np.array([log_normal_density(f[k], F0[k], covariance[np.ix_(k, k)]) for k in lists])


def test_held_out_scores_are_conditional_densities(monkeypatch: pytest.MonkeyPatch) -> None:
    own = plate(0.03 * BUMP, BENT)
    found = diagnosed(monkeypatch, own, hypothesis(BENT, 0.1))
    assert found.gain is not None
    f = own.measurement.frequencies
    with_it, plain = (v[0] - v[1:] for v in (exact_evidences(f, (BUMP, 0.02)), exact_evidences(f)))
    expected = with_it - plain
    # four evidences by importance sampling, 0.03 each
    np.testing.assert_allclose(found.gain.held_out, expected, atol=0.25)
    assert found.gain.held_out_difference == pytest.approx(sum(expected), abs=0.8)
    assert found.gain.held_out_se == pytest.approx(np.sqrt(8) * np.std(expected, ddof=1), rel=0.1)


def test_causes_that_look_alike_are_claimed_as_a_class(monkeypatch: pytest.MonkeyPatch) -> None:
    own = plate(0.03 * BUMP, BENT, TWIN, DENTED)
    found = diagnosed(monkeypatch, own, *(hypothesis(e, 0.1) for e in (BENT, TWIN, DENTED)), gain=False)
    assert found.claim.kind == "class"
    assert set(found.claim.causes) == {"bent", "twin"}
    by_name = {c.name: c for c in found.causes}
    assert by_name["bent"].indistinguishable_from == ("twin",)
    assert sum(share for _, share in found.members) == pytest.approx(1.0)
    assert {t.hypothesis.cause for t, _ in found.members} == {"bent", "twin"}


def test_a_cause_that_the_constants_absorb_is_reported_with_its_bias(monkeypatch: pytest.MonkeyPatch) -> None:
    own = plate(np.zeros(8), STIFF, BENT)
    found = diagnosed(monkeypatch, own, hypothesis(STIFF, 0.1), hypothesis(BENT, 0.1), gain=False)
    absorbed = {c.name: c for c in found.causes}["stiff"]
    assert absorbed.absorbed
    assert absorbed.visible < 0.1
    size = found.signatures["stiff"].shift * NOISE * own.measurement.frequencies / F0
    expected = np.linalg.lstsq(A, size, rcond=None)[0]
    for i, name in enumerate(("E1", "G12")):
        assert absorbed.bias[name] == pytest.approx(expected[i], rel=0.1)
    assert not {c.name: c for c in found.causes}["bent"].absorbed


def test_an_even_cause_is_told_by_its_magnitude(monkeypatch: pytest.MonkeyPatch) -> None:
    own = plate(0.15**2 * DENT, WARP)
    found = diagnosed(monkeypatch, own, hypothesis(WARP, 0.1), gain=False)
    assert found.claim.causes == ("warp",)
    mean, sd, _ = found.causes[0].parameters["size of warp"]
    assert mean == pytest.approx(0.15, abs=3 * sd)
    assert sd < 0.02


def test_two_causes_are_claimed_as_a_pair(monkeypatch: pytest.MonkeyPatch) -> None:
    own = plate(0.04 * BUMP + 0.04 * DENT, BENT, DENTED)
    found = diagnosed(monkeypatch, own, hypothesis(BENT, 0.1), hypothesis(DENTED, 0.1))
    assert found.claim.kind == "pair"
    assert set(found.claim.causes) == {"bent", "dented"}
    assert found.extended is not None
    assert found.extended.rms < 2 * NOISE


def test_what_no_cause_explains_is_other(monkeypatch: pytest.MonkeyPatch) -> None:
    wild = 0.05 * np.array([1.0, 1.0, -1.0, 1.0, -1.0, -1.0, 1.0, 1.0])
    own = plate(wild, BENT)
    found = diagnosed(monkeypatch, own, hypothesis(BENT, 0.1), gain=False, sets=False)
    assert found.claim.kind == "other"
    assert found.claim.causes == ()
    assert found.extended is not None


# The last is next to its equal: a list rounded to 1 Hz may hold one number twice.
@pytest.mark.parametrize(("at", "share"), [(2, 0.5), (7, 0.5), (4, 0.0)])
def test_a_false_peak_is_found_and_the_rest_refitted(
    at: int, share: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    f = measured()
    listed = np.insert(f[:7], at, f[at - 1] + share * (f[at] - f[at - 1]))
    found = diagnosed(monkeypatch, with_causes(listed, BENT), hypothesis(BENT, 0.1), *FALSE)
    assert found.claim.causes == ("mode_identity",)
    assert found.causes[0].variant in {f"frequency {i + 1} false" for i in ({at} if share else {at - 1, at})}
    assert found.extended is not None
    # all eight frequencies are in the answer, the false one as it was measured
    assert found.extended.predicted.shape == found.baseline.predicted.shape == (8,)
    np.testing.assert_allclose(found.extended.predicted, listed, rtol=3 * NOISE)
    if share:
        assert found.extended.predicted[at] == pytest.approx(listed[at], rel=1e-12)
    assert found.extended.rms < NOISE
    assert found.gain is not None
    assert found.gain.held_out.shape == (8,)
    assert np.all(np.isfinite(found.gain.held_out))


def test_what_is_wrong_with_one_of_two_lists_is_left_out_of_that_list(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    cases = [plate(np.zeros(8), name="one"), plate(with_slip(3, 0.15), name="two")]
    every = [
        (NOTHING, (0, 1)),
        (ANYTHING, (0, 1)),
        *((h, (k,)) for k in (0, 1) for h in map(misread, range(8))),
    ]
    monkeypatch.setattr(diagnosing, "hypotheses_of", lambda cases: every)
    found = diagnose_cases(cases)
    assert found.claim.causes == ("outlier",)
    assert found.causes[0].plates == ("two",)
    assert found.gain is not None
    # the misread frequency is the twelfth of both lists: under its own cause nothing was known of it
    held_out = found.gain.held_out
    assert int(np.argmax(np.abs(held_out))) == 11
    assert held_out[11] > 5.0
    assert np.abs(np.delete(held_out, 11)).max() < 0.3 * held_out[11]


@pytest.mark.slow
def test_the_frequency_that_a_list_hypothesis_explains_is_told_by_its_own_list(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of two lists of eight, the fourth frequency of the second is the twelfth."""
    cases = [plate(np.zeros(8), name=name) for name in ("one", "two")]
    for of, expected in (
        (misread(3), [*range(16)]),
        # without the false one the list has fifteen
        (FALSE[3], [*range(11), *range(11, 15)]),
    ):
        t = weighing.Tested(of, (1,), weighing.marginal_of(cases, of, (1,)))
        asked: list[int] = []
        clean: list[bool] = []

        def recorded(
            _: object,
            asked_of: Hypothesis,
            *__: object,
            left_out: int,
            asked: list[int] = asked,
            clean: list[bool] = clean,
            t: object = t,
            **___: object,
        ) -> object:
            asked.append(left_out)
            clean.append(asked_of.listed == ListChange() and not asked_of.parameters)
            return t.marginal  # type: ignore[attr-defined]

        monkeypatch.setattr(gain, "marginal_of", recorded)
        found = gain.left_out(cases, t, 16, None, 0.02)
        assert asked == expected
        if of.listed.misread:
            # without the misread frequency the rest of the list has no error
            assert np.flatnonzero(clean).tolist() == [11]
        else:
            # a false peak may lie anywhere below the last frequency
            density = t.marginal.log_evidence - found[11]
            assert density == pytest.approx(-np.log(cases[1].measurement.frequencies[-1]))


def test_a_misread_frequency_is_predicted_by_the_prior_of_its_error() -> None:
    """ln p(f_i | others) with the constants in closed form and an integral over the misreading."""
    own = plate(with_slip(3, 0.15))
    f, sigma, at = own.measurement.frequencies, NOISE * own.measurement.frequencies, 3
    t = weighing.Tested(misread(at), (0,), weighing.marginal_of([own], misread(at), (0,)))
    t = replace(t, marginal=sampled_marginal(t.marginal))
    found = t.marginal.log_evidence - gain.left_out([own], t, 8, None, 0.02)[at]
    kept = np.arange(8) != at
    slope = SD * A * F0[:, None]
    covariance = slope @ slope.T + np.diag(sigma**2)
    answer = np.linalg.solve(covariance[np.ix_(kept, kept)], covariance[kept, at])
    mean = F0[at] + answer @ (f - F0)[kept]
    variance = slope[at] @ slope[at] - answer @ covariance[kept, at]
    m = np.linspace(MISREADING.prior.lower, MISREADING.prior.upper, 20001)
    spread = (1.0 + m) ** 2 * variance + sigma[at] ** 2
    log_density = -0.5 * (f[at] - (1.0 + m) * mean) ** 2 / spread - 0.5 * np.log(2 * np.pi * spread)
    log_density += MISREADING.prior.log_density(m)
    direct = np.log(np.trapezoid(np.exp(log_density), m))
    # two evidences by importance sampling
    assert found == pytest.approx(direct, abs=0.1)


def test_held_out_scores_select_the_cause_again_without_each_frequency(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of a faint cause: the mixture of plain and extended model, weighed by the other frequencies."""
    own = plate(0.006 * BUMP, BENT)
    found = diagnosed(monkeypatch, own, hypothesis(BENT, 0.1), sets=False, gain=False)
    bent = found.weighed.best_of("bent")
    assert 0.1 < bent.probability < 0.99
    scored = gain.gain_of(
        [own],
        found.weighed,
        Claim("named", ("bent",), 0.9),
        [(bent, 1.0)],
        found.baseline,
        found.baseline,
        0.02,
    )
    f = own.measurement.frequencies
    plain, extended = exact_evidences(f), exact_evidences(f, (BUMP, 0.02))
    mixture = np.logaddexp(plain + np.log(0.5), extended + np.log(0.1))
    expected = (mixture[0] - mixture[1:]) - (plain[0] - plain[1:])
    assert scored.n_hypotheses >= 2
    np.testing.assert_allclose(scored.held_out, expected, atol=0.1)
    ahead = (extended + np.log(0.1) > plain + np.log(0.5))[1:]
    assert scored.stable == pytest.approx(ahead.mean(), abs=1e-12)
