"""Hypotheses weighed on plates with evidences in closed form: sets of causes, incomplete lists."""

from dataclasses import replace
from itertools import combinations, product

import numpy as np
import pytest
from scipy.special import logsumexp

from cpam_bayes.diagnosis.answers.detectability import detectable, linear_oracle, shift_lines
from cpam_bayes.diagnosis.cases import neighbours, with_pairing
from cpam_bayes.diagnosis.diagnose import diagnose_cases
from cpam_bayes.diagnosis.evidence import sets
from cpam_bayes.diagnosis.evidence import weighing as pairs
from cpam_bayes.diagnosis.evidence.scan import misfit_probability
from cpam_bayes.diagnosis.evidence.sets import SetSettings
from cpam_bayes.diagnosis.evidence.weighing import weigh
from cpam_bayes.diagnosis.hypotheses import NONE, Hypothesis, go_together, inclusion_of, set_scales, together
from cpam_bayes.diagnosis.signatures import menu_of, projector_of, signature_of
from cpam_bayes.effects import ListChange
from cpam_bayes.forward_model.composed import ComposedModel
from cpam_bayes.mechanics.modes import RigidBodyError
from tests.diagnosis import toy_plates as toy
from tests.diagnosis.toy_plates import ANYTHING, BENT, BUMP, CONSTANTS, DENT, F0, NOISE, NOTHING, SD, A
from tests.toy_models import ToyModel

NORMAL = toy.whole_normal(0.02)
DENTED = toy.cause("dented", toy.whole_normal(0.01))
TURNED = toy.cause("turned", toy.whole_normal(0.015))
SHIFTS = {"bent": (BUMP, 0.02), "dented": (DENT, 0.01), "turned": (np.roll(BUMP, 3), 0.015)}
SINGLES = tuple(toy.hypothesis(effect) for effect in (BENT, DENTED, TURNED))
EVERY = toy.of_one(NOTHING, ANYTHING, *SINGLES)
TWO = 0.03 * DENT + 0.03 * BUMP


def plate(shift, *, n=8, name="toy", specimen=""):
    effects = [(e, toy.straight(SHIFTS[e.name][0])) for e in (BENT, DENTED, TURNED)]
    return toy.case(toy.a_list(toy.measured(shift)[:n], NOISE), effects, name=name, specimen=specimen)


def exact(own, *causes):
    """Log evidence in closed form; approximate for large shifts, since effects multiply in the model."""
    f = own.measurement.frequencies
    return toy.exact_log_evidence(f, NOISE * f, *(SHIFTS[name] for name in causes if name != NONE))


@pytest.mark.parametrize("size", [0.0, 0.004, 0.01])
def test_probabilities_are_priors_times_exact_evidences(size):
    own, told = plate(size * BUMP), []
    found = weigh([own], toy.of_one(NOTHING, *SINGLES), sets=False, so_far=told.append)
    assert set(told[-1]) == set(found.by_cause())
    assert all(sum(shares.values()) == pytest.approx(1.0) for shares in told)
    factor = {h.cause: exact(own, h.cause) - exact(own) for h in (NOTHING, *SINGLES)}
    weight = {h.cause: h.prior * np.exp(factor[h.cause]) for h in (NOTHING, *SINGLES)}
    for t in found.tested:
        expected = weight[t.hypothesis.cause] / sum(weight.values())  # the log evidence's error is 0.03
        p = found.by_cause()[t.hypothesis.cause]
        assert p == pytest.approx(expected, abs=0.06 * expected * (1 - expected) + 1e-9)
        assert t.log_bayes_factor == pytest.approx(factor[t.hypothesis.cause], abs=0.1)


@pytest.fixture(scope="module")
def two():
    return weigh([plate(TWO)], EVERY)


def test_several_causes_at_once_are_found_as_a_set_and_probabilities_sum_to_one(two):
    three = TWO + 0.03 * SHIFTS["turned"][0]
    for found, shift, n, near in ((two, TWO, 2, 2.0), (weigh([plate(three)], EVERY), three, 3, 1.0)):
        best, causes = found.tested[0], tuple(SHIFTS)[:n]
        assert (best.hypothesis.family, best.hypothesis.causes) == ("set", causes)
        assert best.marginal.log_evidence == pytest.approx(exact(plate(shift), *causes), abs=near)
        p = [t.probability for t in found.tested]
        assert p == sorted(p, reverse=True)
        assert (sum(p), sum(found.by_cause().values())) == pytest.approx((1.0, 1.0), abs=1e-12)
        assert found.none.log_bayes_factor == 0.0
    assert all(p > 0.9 for p in inclusion_of(found.by_cause()).values())


def test_a_cause_without_a_size_has_a_shift_and_a_signature_and_acts_in_pairs():
    step = 0.04 * DENT

    def function(x):
        f = F0 * np.exp((x - 1.0) @ A.T + step)
        return f, f[..., None] * A

    alone, both = plate(step), plate(step + 0.03 * BUMP)
    for own in (alone, both):
        own.extended["swapped", ""] = ToyModel(CONSTANTS, function)
    swap = toy.hypothesis(replace(toy.cause("swapped", NORMAL), parameters=()))
    every = toy.of_one(NOTHING, ANYTHING, swap, toy.hypothesis(BENT))
    found = weigh([alone], every, sets=False)
    swapped, none = found.tested[0], found.none.marginal
    assert (swapped.hypothesis.cause, swapped.probability > 0.99) == ("swapped", True)
    assert swapped.shift.scores.shape == (1, 0)
    np.testing.assert_allclose(swapped.shift.shift[0], step, atol=1e-12)  # at the plain model's constants
    projector = projector_of(none)
    seen = signature_of(swapped, none, projector)
    assert seen.visible_fraction > 0.5
    assert seen.largest == pytest.approx(np.abs(step).max(), rel=0.1)
    assert menu_of(swapped, none, projector).cosine(seen.visible) == pytest.approx(1.0, abs=1e-3)
    assert "swapped" in {entry.cause for entry in detectable(found)}  # it has a detection limit
    lines = shift_lines(found.tested, none)
    assert "swapped" in linear_oracle(found, lines, 20, np.random.default_rng(0)).causes
    assert set(weigh([both], every).tested[0].hypothesis.causes) == {"swapped", "bent"}


def weighed_beside(others, prior):
    effects = [(BENT, toy.straight(BUMP)), (DENTED, toy.straight(DENT))]
    effects += [(toy.cause(name, NORMAL), toy.straight(shift)) for name, shift in others.items()]
    singles = [toy.hypothesis(effect, prior) for effect, _ in effects]
    return weigh([toy.case(plate(TWO).measurement, effects)], toy.of_one(NOTHING, ANYTHING, *singles))


def test_a_pair_is_found_though_other_causes_look_more_like_it_alone():
    """Four causes are nearly the sum of two: each of them leads, and no pair with one of them is right."""
    left = [1.0, -1.0, 0.5, 0.0, 0.0, -0.5, 0.0, 0.0]
    nearly = {f"nearly {k}": BUMP + DENT + np.roll(left, k) for k in (0, 2, 3, 5)}
    found = weighed_beside(nearly, 0.05)
    alone = [t.hypothesis.cause for t in found.tested if t.hypothesis.cause in (*nearly, "bent", "dented")]
    assert set(alone[:3]) <= set(nearly)
    assert set(found.tested[0].hypothesis.causes) == {"bent", "dented"}
    assert found.by_cause()["bent + dented"] > 0.95
    two = [t.hypothesis for t in found.tested if t.hypothesis.family == "set"]
    assert len({frozenset(h.causes) for h in two}) == len({h.cause for h in two})
    assert len({(h.cause, h.variant) for h in two}) == len(two)


def test_a_pair_is_found_though_one_cause_happens_to_explain_the_list():
    # a flexible cause, for instance a mass anywhere, can happen to imitate two others together
    likeness = BUMP + DENT + 0.105 * np.array([1.0, -1.0, 0.5, 1.0, 1.0, -1.0, 0.0, 1.0])
    found = weighed_beside({"happens": likeness}, 0.1)
    alone = next(t for t in found.tested if t.hypothesis.cause == "happens" and not t.hypothesis.has_leftover)
    assert misfit_probability(alone.marginal) > 1e-3
    assert found.by_cause().get("bent + dented", 0.0) > 0.4


def test_pairs_are_ranked_though_the_prior_medians_break_the_constraints(monkeypatch):
    admissible = ComposedModel.admissible

    def off_the_medians(model, x):
        return admissible(model, x) & (np.abs(x[:, :2] - 1.0).max(axis=1) > 1e-9)

    monkeypatch.setattr(ComposedModel, "admissible", off_the_medians)
    assert weigh([plate(TWO)], EVERY).tested[0].hypothesis.cause == "bent + dented"


def test_pairs_that_time_does_not_allow_leave_the_answer_cut_short(two, monkeypatch):
    monkeypatch.setattr(pairs, "is_time_up", lambda: True)
    assert (two.is_cut_short, weigh([plate(TWO)], EVERY).is_cut_short) == (False, True)


def test_sets_that_are_not_fitted_are_unaccounted_for(two, monkeypatch):
    assert two.unaccounted < 0.01
    monkeypatch.setattr(sets, "SETS", SetSettings(fitted=0, fitted_further=0))
    found = weigh([plate(TWO)], EVERY)
    assert "set" not in {t.hypothesis.family for t in found.tested}
    assert two.by_cause()["bent + dented"] > found.unaccounted > 0.95  # more, as the true set is fitted


def test_no_pair_is_looked_at_where_none_leads_nor_one_with_a_cause_that_does_not_show():
    found = weigh([plate(0.0 * DENT)], EVERY)
    assert found.tested[0].hypothesis.cause == NONE
    assert all(t.hypothesis.family != "set" for t in found.tested)
    own = plate(0.015 * DENT)
    found, alone = (weigh([own], EVERY, sets=some) for some in (True, False))
    assert all("dented" not in t.hypothesis.causes for t in found.tested if t.hypothesis.family == "set")
    assert found.by_cause()["dented"] == pytest.approx(alone.by_cause()["dented"], abs=1e-3)
    assert found.unaccounted < 0.01


def test_the_priors_of_sets_are_those_of_their_number_shared_by_the_products_of_their_causes():
    scales = set_scales(SINGLES)
    (three,) = (together(some, scales) for some in combinations(SINGLES, 3))
    assert three.prior == pytest.approx(0.015)
    assert three.parts == tuple(sorted(SINGLES, key=lambda h: h.cause))
    # independent of which cause comes first
    turned = [replace(h, variant=text) for h, text in zip(SINGLES, ("left", "", "right"), strict=True)]
    assert together([together(turned[:0:-1], scales), turned[0]], scales) == together(turned, scales)
    assert together(turned, scales).variant == "left / right"
    assert set_scales(SINGLES[:2])[3] == 0.0
    heavy = (replace(SINGLES[0], prior=0.3), *SINGLES[1:])
    found = {p.causes: p.prior for p in toy.pairs_of(heavy, heavy)}
    assert found["bent", "dented"] == pytest.approx(3.0 * found["dented", "turned"])
    assert sum(found.values()) == pytest.approx(0.055)


def test_what_cannot_act_together_is_no_pair():
    excluded = {"clamp_rotation": ("clamp_slip",), "clamp_slip": (), "clamp_length": ()}
    of_clamp = [toy.hypothesis(toy.cause(name, NORMAL, excludes=of)) for name, of in excluded.items()]
    of_clamp = [replace(h, family="clamp") for h in of_clamp]
    found = {p.causes for p in toy.pairs_of(of_clamp, of_clamp)}
    assert found == {("clamp_length", "clamp_rotation"), ("clamp_length", "clamp_slip")}
    missed = Hypothesis("mode_identity", "list", listed=ListChange(missed=(1,)), prior=0.1)
    # two errors of one list, two variants of one cause, and a cause of the pair itself
    for both in ((toy.misread(0), missed), (toy.misread(0), toy.misread(1))):
        assert toy.pairs_of(both, both) == ()
    pair = together(SINGLES[:2], {2: 1.0})
    assert [go_together(pair, h) for h in SINGLES] == [False, False, True]


@pytest.mark.parametrize("i", [0, 3, 5])
def test_the_misread_frequency_is_found_again_beside_a_gross_cause(i):
    """Alone, another frequency looks misread, which used to be the only one tried beside the cause."""
    every = toy.of_one(NOTHING, ANYTHING, *SINGLES, *(toy.misread(k) for k in range(8)))
    own = plate(toy.with_slip(i, 0.03) + 0.04 * DENT)
    alone = weigh([own], every, sets=False)
    assert next(t for t in alone.tested if t.hypothesis.cause == "outlier").hypothesis.listed.misread != (i,)
    found = weigh([own], every)
    best = found.tested[0].hypothesis
    assert (best.causes, best.listed.misread) == (("dented", "outlier"), (i,))
    assert found.by_cause()[best.cause] > 0.9


def test_no_second_error_of_the_list_is_ranked_where_one_leads():
    whole = plate(0.06 * DENT)
    f = np.delete(whole.measurement.frequencies, 2)
    own = replace(whole, measurement=toy.a_list(f, NOISE), modes=np.arange(7))
    missed = Hypothesis("mode_identity", "list", listed=ListChange(missed=(2,)), prior=0.1)
    found = weigh([own], toy.of_one(NOTHING, ANYTHING, *SINGLES, missed, *[toy.misread(k) for k in range(7)]))
    sets = [t.hypothesis for t in found.tested if t.hypothesis.family == "set"]
    assert any(h.listed.missed for h in sets)
    assert all(sum(part.family == "list" for part in h.parts) <= 1 for h in sets)


def test_a_plate_that_cannot_be_told_from_a_rigid_body_is_named_and_left_out():
    own = plate(np.zeros(8))

    def soft(x):
        raise RigidBodyError("a frequency of nothing")

    own.extended["bent", ""] = replace(own.extended["bent", ""], function=soft)
    found = weigh([own], toy.of_one(NOTHING, *SINGLES), sets=False)
    (said,) = found.not_tested
    assert said.startswith("bent: ")
    assert {t.hypothesis.cause for t in found.tested} == {NONE, "dented", "turned"}
    assert sum(t.probability for t in found.tested) == pytest.approx(1.0)


def test_two_plates_of_one_material_share_constants_with_a_scatter():
    cases, scatter = [plate(0.0 * DENT, name="one"), plate(0.02 * DENT, n=6, name="two")], 0.02
    found = weigh(cases, [(NOTHING, (0, 1))], scatter=scatter)
    f = np.concatenate([c.measurement.frequencies for c in cases])
    modes = np.array([*range(8), *range(6)])
    slope, of_one = SD * A[modes] * f[:, None], np.arange(14) < 8
    same_plate = of_one[:, None] == of_one
    covariance = slope @ slope.T * (1.0 + (scatter / SD) ** 2 * same_plate) + np.diag((NOISE * f) ** 2)
    expected = toy.log_normal_density(f, F0[modes], covariance)  # not quite linear, and truncated at four sd
    assert found.none.marginal.log_evidence == pytest.approx(expected, abs=0.1)


def test_two_tests_of_one_specimen_share_its_flaw_and_have_no_scatter():
    cases = [plate(0.03 * DENT, name=name, specimen="same") for name in ("one", "two")]
    best = weigh(cases, [(NOTHING, (0, 1)), (SINGLES[1], (0, 1))], sets=False).tested[0]
    assert best.hypothesis.cause == "dented"
    assert best.marginal.comparison.parameters.names == ("E1", "G12", "size of dented")
    alone = weigh(cases[:1], toy.of_one(NOTHING, SINGLES[1]), sets=False).tested[0]
    ratio = best.marginal.moments()[1][2] / alone.marginal.moments()[1][2]
    assert ratio == pytest.approx(np.sqrt(0.5), rel=0.1)  # the same list twice: half the variance


# Incomplete lists: an evidence is the sum over all pairings

MISSED, FALSE = 0.1, 0.1
TOLERANCE = 0.1  # importance sampling's error is 0.03; pairings 12 nats below the best are left out
OF_TWO = SINGLES[:2]


def gappy(shift=0.0, lacks=(3,), false=(555.0,)):
    return np.sort(np.append(np.delete(toy.measured(shift), lacks), false))


def incomplete(f, labels=None):
    """A plate with an incomplete list; labels : modes of some of its frequencies."""
    known = dict(labels or {})
    text = tuple("a label" if i in known else "" for i in range(len(f)))
    rates = {"missed_probability": MISSED, "false_peaks": FALSE}
    listed = replace(toy.a_list(f, NOISE), complete=False, labels=text, **rates)
    free = iter(np.setdiff1d(np.arange(len(F0)), list(known.values())))
    modes = np.array([known[i] if i in known else next(free) for i in range(len(f))])
    return replace(plate(np.zeros(8)), measurement=listed, modes=modes)


def pairings(n, labels):
    rows, columns = (list(set(range(k)) - set(of)) for k, of in ((n, labels), (len(F0), labels.values())))
    for r in range(0 if labels else 1, min(len(rows), len(columns)) + 1):
        for chosen, modes in product(combinations(rows, r), combinations(columns, r)):
            pairing = np.full(n, -1)
            pairing[[*labels, *chosen]] = [*labels.values(), *modes]
            yield pairing


def exact_sum(f, name, labels=None):
    values = []
    for pairing in pairings(len(f), labels or {}):
        kept, modes = pairing >= 0, pairing[pairing >= 0]
        below = set(range(modes.max() + 1))
        if not kept[-1]:
            below |= {k for k in range(len(F0)) if F0[k] <= f[-1]}
        causes = [SHIFTS[name]] if name in SHIFTS else []
        density = toy.exact_log_evidence(f[kept], NOISE * f[kept], *causes, modes=modes)
        paired = len(modes) * np.log1p(-MISSED) + (len(below) - len(modes)) * np.log(MISSED)
        values.append(density + paired + (~kept).sum() * np.log(FALSE / f[-1]))
    return float(logsumexp(values))


def weighed_incomplete(f, labels=None):
    """Weighed hypotheses for an incomplete list, their evidences checked against sums over all pairings."""
    found = weigh([incomplete(f, labels)], toy.of_one(NOTHING, *OF_TWO), sets=False)
    for h in (NOTHING, *OF_TWO):
        of = [t.marginal.log_evidence for t in found.tested if t.hypothesis.cause == h.cause]
        assert logsumexp(of) == pytest.approx(exact_sum(f, h.cause, labels), abs=TOLERANCE)
    return found


@pytest.mark.parametrize(
    ("shift", "lacks", "false"),
    [
        pytest.param(0.0, (3,), (555.0,), marks=pytest.mark.slow),
        pytest.param(0.01 * BUMP, (3,), (555.0,), marks=pytest.mark.slow),
        (0.02 * BUMP, (1,), ()),
        pytest.param(0.0, (7,), (660.0,), marks=pytest.mark.slow),  # false peak above the highest mode
    ],
)
def test_an_evidence_is_the_sum_over_all_pairings(shift, lacks, false):
    f = gappy(shift, lacks, false)
    found, exactly = weighed_incomplete(f), [exact_sum(f, h.cause) for h in (NOTHING, *OF_TWO)]
    assert found.log_bayes_factor(("bent",)) == pytest.approx(exactly[1] - exactly[0], abs=2 * TOLERANCE)
    weight = np.log([h.prior for h in (NOTHING, *OF_TWO)]) + exactly
    for h, p in zip((NOTHING, *OF_TWO), np.exp(weight - logsumexp(weight)), strict=True):
        assert found.by_cause()[h.cause] == pytest.approx(p, abs=0.05)


def test_a_labelled_frequency_keeps_its_mode_and_the_others_are_summed_over():
    labels = {3: 4, 7: 7}  # without the label the fourth frequency is more probably the fourth mode
    for t in weighed_incomplete(gappy(), labels).tested:
        assert {i: t.cases[0].modes[i] for i in labels} == labels


def test_the_cause_is_found_though_the_plain_model_pairs_the_list_otherwise():
    f, truth = gappy(0.06 * BUMP, (4,), ()), np.delete(np.arange(8), 4)
    found = weigh([incomplete(f)], toy.of_one(NOTHING, *OF_TWO), sets=False)
    assert not np.array_equal(found.none.cases[0].modes, truth)
    best = found.tested[0]
    assert best.hypothesis.cause == "bent"
    np.testing.assert_array_equal(best.cases[0].modes, truth)
    assert found.by_cause()["bent"] > 0.99


def test_a_misread_frequency_of_an_incomplete_list_is_found():
    f = gappy(0.0, (5,), ())
    f[2] *= 1.06
    errors = [toy.misread(i, 0.02) for i in range(len(f))]
    best = weigh([incomplete(f)], toy.of_one(NOTHING, *OF_TWO, *errors), sets=False).best_of("outlier")
    assert best.hypothesis.listed.misread == (2,)
    np.testing.assert_array_equal(best.cases[0].modes, np.delete(np.arange(8), 5))


def test_a_complete_list_beside_an_incomplete_one_keeps_its_pairing():
    cases = [plate(np.zeros(8), name="whole", specimen="toy"), incomplete(gappy(0.0, (2,), ()))]
    found = weigh(cases, [(h, (0, 1)) for h in (NOTHING, *OF_TWO)], sets=False)
    assert found.tested[0].hypothesis.cause == NONE
    for t in found.tested:
        np.testing.assert_array_equal(t.cases[0].modes, np.arange(8))
    np.testing.assert_array_equal(found.none.cases[1].modes, np.delete(np.arange(8), 2))


def test_the_answer_shows_false_peaks_and_missed_modes_of_each_fit():
    f = gappy(0.03 * BUMP)
    d = diagnose_cases([incomplete(f)], hypotheses=toy.of_one(NOTHING, ANYTHING, *OF_TWO), sets=False)
    assert d.claim.causes == ("bent",)
    assert len(d.extended.measured) == len(f) == len(d.gain.held_out)
    assert d.members[0][0].cases[0].modes.tolist() == [0, 1, 2, 4, 5, -1, 6, 7]
    plain, bent = (exact_sum(f, name) for name in (NONE, "bent"))  # summed over the plain model's pairings
    assert d.baseline.log_evidence == pytest.approx(plain, abs=TOLERANCE)
    assert d.gain.log_bayes_factor == pytest.approx(bent - plain, abs=2 * TOLERANCE)


def test_neighbouring_pairings_keep_order_and_labels():
    found = neighbours(with_pairing(incomplete(gappy(), {2: 3}), np.array([0, 1, 3, 2, -1, 5, 6, 7])))
    for modes in found:
        others = np.delete(modes, 2)
        assert modes[2] == 3
        assert 3 not in others
        assert np.all(np.diff(others[others >= 0]) > 0)
    for expected in ([0, 1, 3, 2, 4, 5, 6, 7], [0, 1, 3, 2, 5, -1, 6, 7]):
        assert expected in [modes.tolist() for modes in found]
