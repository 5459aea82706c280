"""Hypotheses weighed on plates whose evidences are known in closed form."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from cpam_bayes.diagnosis.answers.detectability import detectable, linear_oracle, shift_lines
from cpam_bayes.diagnosis.comparison import PlateCase, comparison_of, effect_columns
from cpam_bayes.diagnosis.evidence import sets
from cpam_bayes.diagnosis.evidence import weighing as pairs
from cpam_bayes.diagnosis.evidence.scan import misfit_probability
from cpam_bayes.diagnosis.evidence.sets import SetSettings
from cpam_bayes.diagnosis.evidence.weighing import Weighed, weigh
from cpam_bayes.diagnosis.hypotheses import (
    NONE,
    Hypothesis,
    causes_in,
    go_together,
    inclusion_of,
    set_scales,
    together,
)
from cpam_bayes.diagnosis.signatures import menu_of, projector_of, signature_of
from cpam_bayes.effects import ListChange
from cpam_bayes.forward_model.composed import ComposedModel
from cpam_bayes.mechanics.modes import RigidBodyError
from tests.diagnosis.toy_plates import (
    ANYTHING,
    BENT,
    BUMP,
    DENT,
    F0,
    NOISE,
    NOTHING,
    SD,
    A,
    Array,
    a_list,
    case,
    cause,
    exact_log_evidence,
    hypothesis,
    log_normal_density,
    measured,
    misread,
    pairs_of,
    stepped,
    straight,
    whole_normal,
    with_slip,
)

DENTED = cause("dented", whole_normal(0.01))
TWIN = np.roll(BUMP, 3)
TURNED = cause("turned", whole_normal(0.015))
SINGLES = tuple(hypothesis(effect, 0.1) for effect in (BENT, DENTED, TURNED))
SHIFTS = {"bent": (BUMP, 0.02), "dented": (DENT, 0.01), "turned": (TWIN, 0.015)}


def plate(shift: Array, *, n: int = 8, name: str = "toy", specimen: str = "") -> PlateCase:
    effects = [(e, straight(SHIFTS[e.name][0])) for e in (BENT, DENTED, TURNED)]
    return case(a_list(measured(shift)[:n], NOISE), effects, name=name, specimen=specimen)


def of_one(*hypotheses: Hypothesis) -> list[tuple[Hypothesis, tuple[int, ...]]]:
    return [(h, (0,)) for h in hypotheses]


EVERY = of_one(NOTHING, ANYTHING, *SINGLES)
TWO = 0.03 * DENT + 0.03 * BUMP


def exact(case: PlateCase, name: str) -> float:
    f = case.measurement.frequencies
    return exact_log_evidence(f, NOISE * f, *([SHIFTS[name]] if name in SHIFTS else []))


@pytest.fixture(scope="module")
def two() -> Weighed:
    """Of a list with two causes at once."""
    return weigh([plate(TWO)], EVERY)


@pytest.mark.parametrize("size", [0.0, 0.004, 0.01])
def test_probabilities_are_priors_times_exact_evidences(size: float) -> None:
    own = plate(size * BUMP)
    told: list[Mapping[str, float]] = []
    found = weigh([own], of_one(NOTHING, *SINGLES), sets=False, so_far=told.append)
    assert set(told[-1]) == set(found.by_cause())
    assert all(sum(shares.values()) == pytest.approx(1.0) for shares in told)
    log_weight = {h.cause: np.log(h.prior) + exact(own, h.cause) for h in (NOTHING, *SINGLES)}
    top = max(log_weight.values())
    total = sum(np.exp(v - top) for v in log_weight.values())
    by_cause = found.by_cause()
    for name, value in log_weight.items():
        # importance sampling's error of a log evidence is 0.03, so that of a probability p (1 - p) times it
        expected = np.exp(value - top) / total
        assert by_cause[name] == pytest.approx(expected, abs=0.06 * expected * (1 - expected) + 1e-9)
    for t in found.tested:
        expected_factor = exact(own, t.hypothesis.cause) - exact(own, NONE)
        assert t.log_bayes_factor == pytest.approx(expected_factor, abs=0.1)


def test_two_causes_at_once_are_found_as_a_pair_and_probabilities_fall_and_sum_to_one(two: Weighed) -> None:
    best = two.tested[0].hypothesis
    assert best.family == "set"
    assert set(best.causes) == {"bent", "dented"}
    f = plate(TWO).measurement.frequencies
    expected = exact_log_evidence(f, NOISE * f, SHIFTS["bent"], SHIFTS["dented"])
    # relative shifts of two effects multiply: 0.03^2 of a frequency beside a noise of 0.002
    assert two.tested[0].marginal.log_evidence == pytest.approx(expected, abs=2.0)
    p = [t.probability for t in two.tested]
    assert sum(p) == pytest.approx(1.0, abs=1e-12)
    assert p == sorted(p, reverse=True)
    assert sum(two.by_cause().values()) == pytest.approx(1.0, abs=1e-12)
    assert two.none.log_bayes_factor == 0.0


def test_a_cause_without_a_size_has_a_shift_and_a_signature_and_acts_in_pairs() -> None:
    step = 0.04 * DENT
    alone, both = plate(step), plate(step + 0.03 * BUMP)
    stated = {id(own): stepped(own, "swapped", step) for own in (alone, both)}
    bent = hypothesis(BENT, 0.1)
    found = weigh([alone], of_one(NOTHING, ANYTHING, stated[id(alone)], bent), sets=False)
    swapped, none = found.tested[0], found.none.marginal
    assert (swapped.hypothesis.cause, found.tested[0].probability > 0.99) == ("swapped", True)
    assert swapped.shift is not None
    assert swapped.shift.scores.shape == (1, 0)
    projector = projector_of(none)
    # a shift of the bare frequencies at the constants of the plain model
    np.testing.assert_allclose(swapped.shift.shift[0], step, atol=1e-12)
    seen = signature_of(swapped, none, projector)
    assert seen.visible_fraction > 0.5
    assert seen.largest == pytest.approx(np.abs(step).max(), rel=0.1)
    menu = menu_of(swapped, none, projector)
    assert menu is not None
    assert menu.cosine(seen.visible) == pytest.approx(1.0, abs=1e-3)
    # it stands among the causes that detection limits of others are of
    assert "swapped" in {entry.cause for entry in detectable(found)}
    lines = shift_lines(found.tested, none)
    assert "swapped" in linear_oracle(found, lines, 20, np.random.default_rng(0)).causes
    pair = weigh([both], of_one(NOTHING, ANYTHING, stated[id(both)], bent)).tested[0].hypothesis
    assert set(pair.causes) == {"swapped", "bent"}


def test_a_pair_is_found_though_other_causes_look_more_like_it_alone() -> None:
    """Four causes are nearly the sum of two: each of them leads, and no pair with one of them is right."""
    nearly = {
        f"nearly {k}": BUMP + DENT + np.roll([1.0, -1.0, 0.5, 0.0, 0.0, -0.5, 0.0, 0.0], k)
        for k in (0, 2, 3, 5)
    }
    decoys = {name: cause(name, whole_normal(0.02)) for name in nearly}
    effects = [(BENT, straight(BUMP)), (DENTED, straight(DENT))]
    effects += [(effect, straight(nearly[name])) for name, effect in decoys.items()]
    singles = [hypothesis(effect, 0.05) for effect, _ in effects]
    found = weigh([case(plate(TWO).measurement, effects)], of_one(NOTHING, ANYTHING, *singles))
    alone = [t.hypothesis.cause for t in found.tested if t.hypothesis.cause in (*nearly, "bent", "dented")]
    assert set(alone[:3]) <= set(nearly)
    assert set(found.tested[0].hypothesis.causes) == {"bent", "dented"}
    assert found.by_cause()["bent + dented"] > 0.95
    two = [t.hypothesis for t in found.tested if t.hypothesis.family == "set"]
    assert len({frozenset(h.causes) for h in two}) == len({h.cause for h in two})
    assert len({(h.cause, h.variant) for h in two}) == len(two)


def test_a_pair_is_found_though_one_cause_happens_to_explain_the_list() -> None:
    # a flexible cause, a mass anywhere for instance, can come near to two others at once
    likeness = BUMP + DENT + 0.105 * np.array([1.0, -1.0, 0.5, 1.0, 1.0, -1.0, 0.0, 1.0])
    happens = cause("happens", whole_normal(0.02))
    effects = [(BENT, straight(BUMP)), (DENTED, straight(DENT)), (happens, straight(likeness))]
    singles = [hypothesis(effect, 0.1) for effect, _ in effects]
    found = weigh([case(plate(TWO).measurement, effects)], of_one(NOTHING, ANYTHING, *singles))
    alone = next(t for t in found.tested if t.hypothesis.cause == "happens" and not t.hypothesis.has_leftover)
    assert misfit_probability(alone.marginal) > 1e-3
    assert found.by_cause().get("bent + dented", 0.0) > 0.4


def test_a_pair_is_the_same_whichever_cause_is_first() -> None:
    scales = {2: 2.0}
    assert together(SINGLES[:2], scales) == together(SINGLES[1::-1], scales)
    turned = replace(SINGLES[0], variant="to the left"), replace(SINGLES[1], variant="at a corner")
    assert together(turned, scales).variant == "to the left / at a corner"
    assert causes_in(together(turned, scales).cause) == ("bent", "dented")


def test_pairs_are_ranked_though_the_prior_medians_break_the_constraints(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    admissible = ComposedModel.admissible

    def off_the_medians(model: ComposedModel, x: Array) -> Array:
        return np.asarray(admissible(model, x) & (np.abs(x[:, :2] - 1.0).max(axis=1) > 1e-9))

    monkeypatch.setattr(ComposedModel, "admissible", off_the_medians)
    assert weigh([plate(TWO)], EVERY).tested[0].hypothesis.cause == "bent + dented"


def test_pairs_that_time_does_not_allow_leave_the_answer_cut_short(
    two: Weighed, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert not two.is_cut_short
    monkeypatch.setattr(pairs, "is_time_up", lambda: True)
    assert weigh([plate(TWO)], EVERY).is_cut_short


def test_a_cause_that_does_not_show_beside_another_is_not_fitted_with_it() -> None:
    own = plate(0.015 * DENT)
    found, alone = (weigh([own], EVERY, sets=some) for some in (True, False))
    assert all("dented" not in t.hypothesis.causes for t in found.tested if t.hypothesis.family == "set")
    assert found.by_cause()["dented"] == pytest.approx(alone.by_cause()["dented"], abs=1e-3)
    assert found.unaccounted < 0.01


def test_sets_that_are_not_fitted_are_unaccounted_for(two: Weighed, monkeypatch: pytest.MonkeyPatch) -> None:
    assert two.unaccounted < 0.01
    monkeypatch.setattr(sets, "SETS", SetSettings(fitted=0, fitted_further=0))
    found = weigh([plate(TWO)], EVERY)
    assert {t.hypothesis.family for t in found.tested} & {"set"} == set()
    # of the set that is true here, fitted, more: nodes of sizes are few
    assert two.by_cause()["bent + dented"] > found.unaccounted > 0.95


def test_three_causes_at_once_are_found_and_each_is_included() -> None:
    own = plate(0.03 * (DENT + BUMP + SHIFTS["turned"][0]))
    found = weigh([own], EVERY)
    assert set(found.tested[0].hypothesis.causes) == {"bent", "dented", "turned"}
    assert all(p > 0.9 for p in inclusion_of(found.by_cause()).values())
    f = own.measurement.frequencies
    expected = exact_log_evidence(f, NOISE * f, *SHIFTS.values())
    # relative shifts of effects multiply
    assert found.tested[0].marginal.log_evidence == pytest.approx(expected, abs=1.0)


def test_the_priors_of_sets_are_those_of_their_number() -> None:
    scales = set_scales(SINGLES)
    (three,) = (together(some, scales) for some in combinations(SINGLES, 3))
    assert three.prior == pytest.approx(0.015)
    assert three.parts == tuple(sorted(SINGLES, key=lambda h: h.cause))
    assert set_scales(SINGLES[:2])[3] == 0.0
    pair = together(SINGLES[:2], scales)
    assert together((pair, SINGLES[2]), scales) == three
    assert go_together(pair, SINGLES[2])
    assert not go_together(pair, SINGLES[0])


def test_no_pair_is_looked_at_where_none_leads() -> None:
    found = weigh([plate(0.0 * DENT)], EVERY)
    assert found.tested[0].hypothesis.cause == NONE
    assert all(t.hypothesis.family != "set" for t in found.tested)


@pytest.mark.parametrize("i", [0, 3, 5])
def test_the_misread_frequency_is_found_again_beside_a_gross_cause(i: int) -> None:
    """Alone, another frequency looks misread: that one was the only one to be tried beside the cause."""
    errors = [misread(k) for k in range(8)]
    own = plate(with_slip(i, 0.03) + 0.04 * DENT)
    alone = weigh([own], of_one(NOTHING, ANYTHING, *SINGLES, *errors), sets=False)
    assert next(t for t in alone.tested if t.hypothesis.cause == "outlier").hypothesis.listed.misread != (i,)
    found = weigh([own], of_one(NOTHING, ANYTHING, *SINGLES, *errors))
    best = found.tested[0]
    assert best.hypothesis.causes == ("dented", "outlier")
    assert best.hypothesis.listed.misread == (i,)
    assert found.by_cause()[best.hypothesis.cause] > 0.9


def test_an_outlier_and_a_cause_of_the_plate_each_have_their_size_in_the_model_of_both() -> None:
    both = (misread(3), SINGLES[1])
    (pair,) = pairs_of(both, both)
    comparison = comparison_of([plate(with_slip(3, 0.2) + 0.02 * DENT)], pair)
    names = comparison.parameters.names
    assert {names[c] for c in effect_columns(comparison, pair)} == {"misreading", "size of dented"}
    assert comparison.model.parts[0].misread == ((3, names.index("misreading")),)


def test_pairs_share_their_prior_in_proportion_to_the_product_of_the_causes() -> None:
    pairs = pairs_of(SINGLES, SINGLES)
    assert sum(p.prior for p in pairs) == pytest.approx(0.055)
    heavy = (replace(SINGLES[0], prior=0.3), *SINGLES[1:])
    found = {p.causes: p.prior for p in pairs_of(heavy, heavy)}
    assert found["bent", "dented"] == pytest.approx(3.0 * found["dented", "turned"])
    assert sum(found.values()) == pytest.approx(0.055)


def test_what_cannot_act_together_is_no_pair() -> None:
    excluded = {"clamp_rotation": ("clamp_slip",), "clamp_slip": (), "clamp_length": ()}
    of_clamp = [
        Hypothesis(name, "clamp", effects=(cause(name, whole_normal(0.1), excludes=names),), prior=0.1)
        for name, names in excluded.items()
    ]
    found = {p.causes for p in pairs_of(of_clamp, of_clamp)}
    assert found == {("clamp_length", "clamp_rotation"), ("clamp_length", "clamp_slip")}
    lists = [misread(0), Hypothesis("mode_identity", "list", listed=ListChange(missed=(1,)), prior=0.1)]
    assert pairs_of(lists, lists) == ()
    # two variants of one cause
    assert pairs_of((misread(0), misread(1)), (misread(0), misread(1))) == ()


def test_a_plate_that_cannot_be_told_from_a_rigid_body_is_named_and_left_out() -> None:
    own = plate(np.zeros(8))

    def soft(x: Array) -> tuple[Array, Array]:
        raise RigidBodyError("a frequency of nothing")

    model = own.extended["bent", ""]
    own.extended["bent", ""] = replace(model, function=soft)  # type: ignore[call-arg]
    found = weigh([own], of_one(NOTHING, *SINGLES), sets=False)
    assert len(found.not_tested) == 1
    assert found.not_tested[0].startswith("bent: ")
    assert {t.hypothesis.cause for t in found.tested} == {NONE, "dented", "turned"}
    assert sum(t.probability for t in found.tested) == pytest.approx(1.0)


def test_two_plates_of_one_material_share_constants_with_a_scatter() -> None:
    cases = [plate(0.0 * DENT, name="one"), plate(0.02 * DENT, n=6, name="two")]
    scatter = 0.02
    found = weigh(cases, [(NOTHING, (0, 1))], scatter=scatter)
    f = np.concatenate([c.measurement.frequencies for c in cases])
    rows = [np.arange(8), np.arange(6)]
    slopes = [SD * A[r] * c.measurement.frequencies[:, None] for r, c in zip(rows, cases, strict=True)]
    shared = np.concatenate(slopes)
    covariance = shared @ shared.T + np.diag((NOISE * f) ** 2)
    for at, slope in zip((slice(0, 8), slice(8, 14)), slopes, strict=True):
        own = slope * scatter / SD
        covariance[at, at] += own @ own.T
    expected = log_normal_density(f, np.concatenate([F0, F0[:6]]), covariance)
    # a product of a constant and a deviation is not quite linear, and the scatter is cut at four sd
    assert found.none.marginal.log_evidence == pytest.approx(expected, abs=0.1)


def test_a_cause_of_one_plate_is_not_that_of_the_other() -> None:
    cases = [plate(0.0 * DENT, name="one"), plate(0.03 * DENT, name="two")]
    hypotheses = [(NOTHING, (0, 1)), *((SINGLES[1], at) for at in ((0, 1), (0,), (1,)))]
    found = weigh(cases, hypotheses, sets=False)
    assert found.tested[0].plates == (1,)
    assert found.tested[0].probability > 0.9


def test_two_tests_of_one_specimen_share_its_flaw_and_have_no_scatter() -> None:
    cases = [plate(0.03 * DENT, name=name, specimen="same") for name in ("one", "two")]
    found = weigh(cases, [(NOTHING, (0, 1)), (SINGLES[1], (0, 1))], sets=False)
    best = found.tested[0]
    assert best.hypothesis.cause == "dented"
    assert best.marginal.comparison.parameters.names == ("E1", "G12", "size of dented")
    alone = weigh(cases[:1], of_one(NOTHING, SINGLES[1]), sets=False).tested[0]
    ratio = best.marginal.moments()[1][2] / alone.marginal.moments()[1][2]
    # the same list twice: half the variance
    assert ratio == pytest.approx(np.sqrt(0.5), rel=0.1)


def test_no_second_error_of_the_list_is_ranked_where_one_leads() -> None:
    whole = plate(0.06 * DENT)
    f = np.delete(whole.measurement.frequencies, 2)
    own = replace(whole, measurement=a_list(f, NOISE), modes=np.arange(7))
    missed = Hypothesis("mode_identity", "list", listed=ListChange(missed=(2,)), prior=0.1)
    errors = [misread(k) for k in range(7)]
    found = weigh([own], of_one(NOTHING, ANYTHING, *SINGLES, missed, *errors))
    sets = [t.hypothesis for t in found.tested if t.hypothesis.family == "set"]
    assert any(h.listed.missed for h in sets)
    assert all(sum(part.family == "list" for part in h.parts) <= 1 for h in sets)
