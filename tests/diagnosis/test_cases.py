"""Hypotheses of plates and their probabilities, pairing of lists, and the models that they need."""

from collections import OrderedDict, defaultdict
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from cpam_bayes.diagnosis.cases import build_models, differing_priors, hypotheses_of, plate_case
from cpam_bayes.diagnosis.evidence.pairing_search import plain_pairings
from cpam_bayes.diagnosis.hypotheses import NONE, OTHER, Hypothesis, single_hypotheses, with_leftover
from cpam_bayes.diagnosis.models import diagnosis_parameters
from cpam_bayes.effects import ListChange, PlateFacts, applicable
from cpam_bayes.effects.geometry import OUTLINE
from cpam_bayes.effects.plies import MATERIAL
from cpam_bayes.forward_model import build
from cpam_bayes.plate import builtin, read_plate
from cpam_bayes.plate.reader import builtin_names
from tests.diagnosis.toy_plates import F0, a_list, case, pairs_of

OF_SETS = 0.055 + 0.015  # prior probability that several causes act at once: two, three
PLATES = [name for name in builtin_names() if not builtin(name).plate.layup.n_unknown]


def facts_of(name, **known):
    of = builtin(name)
    return PlateFacts.of(of.plate, of.material.isotropic, **known)


def singles(name, n=8, *, complete=True):
    return single_hypotheses(facts_of(name), n, complete=complete)


def prior(hypotheses):
    return sum(h.prior for h in hypotheses)


@pytest.mark.parametrize("name", PLATES)
@pytest.mark.parametrize("complete", [True, False])
def test_priors_sum_to_one_over_families_that_are_equally_probable_as_are_the_causes_of_one(name, complete):
    found = singles(name, complete=complete)
    assert found[0] == Hypothesis(NONE, NONE, prior=0.5)
    families = defaultdict(lambda: defaultdict(float))
    for h in found[1:]:
        families[h.family][h.cause] += h.prior
    assert families.pop(OTHER) == pytest.approx({OTHER: 0.05})
    for causes in families.values():
        own = (0.45 - OF_SETS) / len(families) / len(causes)
        np.testing.assert_allclose(list(causes.values()), own, rtol=1e-12)
    named = {cause for causes in families.values() for cause in causes}
    effects = {effect.name for effect in applicable(facts_of(name))}
    assert named == effects - (set() if complete else {"mode_identity"})
    in_air = single_hypotheses(facts_of(name, air_is_known=True), 8, complete=complete)  # known air: no cause
    assert {h.cause for h in in_air} == {h.cause for h in found} - {"air"}


def test_what_nothing_explains_is_as_probable_beside_a_cause_as_beside_none_in_three_forms():
    found = singles("C1")
    of = next(h for h in found if h.cause == "warp")
    alone, beside = with_leftover(of)
    assert alone.prior == pytest.approx(of.prior / 1.1)
    others = [h for h in found if h.cause == OTHER]
    for forms, whole in ((others, 0.05), (beside, of.prior / 11.0)):
        assert [h.correlation_length for h in forms] == [0.0, 0.25, 0.8]
        assert [h.prior for h in forms] == pytest.approx([whole / 3.0] * 3)
    prior_of_size = others[0].parameters[0].prior  # half a Student-t of 1 %, nu = 4: median 0.741
    assert prior_of_size.ppf(0.5) == pytest.approx(0.00741, rel=1e-3)
    assert prior_of_size.upper == 0.5


def test_any_frequency_may_be_misread_any_mode_missed_or_false():
    n = 7
    found = singles("C1", n)
    misread = [h for h in found if h.cause == "outlier"]
    assert [h.listed.misread for h in misread[:n]] == [(i,) for i in range(n)]
    moved = {(*h.listed.missed, h.listed.spurious) for h in misread[n:]}
    assert moved == {(k, i) for k in range(n) for i in range(n) if i != k}
    of_list = [h for h in found if h.cause == "mode_identity"]
    assert [h.listed.missed for h in of_list if len(h.listed.missed) == 1] == [(k,) for k in range(n)]
    assert [h.listed.spurious for h in of_list if h.listed.spurious is not None] == list(range(n))
    two = [h for h in of_list if len(h.listed.missed) == 2]
    assert len(two) == n * (n + 1) // 2
    assert prior(two) == pytest.approx(0.1 * prior(of_list))  # a gross error: a tenth of its cause or size
    assert {h.cause for h in found if h.is_gross} == {"outlier"}
    assert prior(h for h in misread if h.is_gross) == pytest.approx(0.1 * prior(misread))
    (angle,) = [h for h in found if h.cause == "misorientation"]
    assert angle.parameters[0].prior.fraction == 0.1
    # in an incomplete list a frequency out of place is a false and a missed one, which its pairings include
    incomplete = [h.listed.misread for h in singles("C1", complete=False) if h.cause == "outlier"]
    assert incomplete == [(i,) for i in range(8)]


def test_another_material_is_as_probable_as_another_slip_of_the_pen_and_pairs_with_nothing():
    found = single_hypotheses(facts_of("C2", has_references=True), 6, complete=True)
    material = next(h for h in found if h.cause == MATERIAL.name)
    assert material.other_material
    alone = next(h for h in found if h.cause == "viscoelastic")  # the only cause of its family
    assert material.prior == pytest.approx(0.1 * alone.prior)
    assert all(MATERIAL.name not in p.causes for p in pairs_of((*found[2:6], material), found))
    specimen = builtin("C2")  # then the constants have only the search bounds
    wide = diagnosis_parameters(specimen, other_material=True)
    assert wide.names == specimen.unknowns.names
    assert [p.prior for p in wide.parameters] == [p.prior for p in specimen.unknowns.parameters]
    assert wide.parameters[0].prior != diagnosis_parameters(specimen).parameters[0].prior


ONE, TWO, SAME = [("one", "one")], [("one", "one"), ("two", "two")], [("one", "same"), ("two", "same")]


def toys(plates):
    return [case(a_list(F0, 0.002), name=name, specimen=specimen) for name, specimen in plates]


def plates_of(found, cause):
    return {plates for h, plates in found if h.cause == cause}


@pytest.mark.parametrize(
    ("plates", "of_plate", "of_list"),
    [
        (ONE, {(0,)}, {(0,)}),
        (TWO, {(0, 1), (0,), (1,)}, {(0,), (1,)}),
        (SAME, {(0, 1)}, {(0,), (1,)}),
        ([*SAME, ("three", "three")], {(0, 1, 2), (0, 1), (2,)}, {(0,), (1,), (2,)}),
    ],
)
def test_a_flaw_is_of_one_specimen_or_of_all_and_an_error_of_a_list_of_that_list(plates, of_plate, of_list):
    found = hypotheses_of(toys(plates))
    assert found[0][0].cause == NONE
    assert prior(h for h, _ in found) == pytest.approx(1.0 - OF_SETS)
    assert len({(h.cause, h.variant, at) for h, at in found}) == len(found)
    assert plates_of(found, "length") == of_plate
    assert {at for h, at in found if h.listed != ListChange()} == of_list
    if plates == TWO:
        lengths = {at: h.prior for h, at in found if h.cause == "length"}
        assert lengths[0, 1] == pytest.approx(lengths[0,] + lengths[1,])


def test_a_flaw_is_about_the_tests_in_which_it_can_act():
    free, clamped = toys(SAME)
    specimen = clamped.models.specimen
    held = replace(specimen, plate=replace(specimen.plate, edges="CFFF"))
    facts = PlateFacts.of(held.plate, held.material.isotropic)
    clamped = replace(clamped, models=replace(clamped.models, specimen=held, facts=facts))
    found = hypotheses_of([free, clamped])
    for cause, plates in (("support", (0,)), ("clamp_rotation", (1,)), ("length", (0, 1))):
        assert plates_of(found, cause) == {plates}
    assert prior(h for h, _ in found) == pytest.approx(1.0 - OF_SETS)
    assert len({h.variant for h, _ in found if h.cause == "damage"}) == 2  # places differ between tests
    causes = ("damage", "sensor_mass")
    both, alone = (
        [prior(h for h, _ in f if h.cause == c) for c in causes] for f in (found, hypotheses_of([clamped]))
    )
    assert both[0] / both[1] == pytest.approx(alone[0] / alone[1])


def test_constants_that_files_give_different_priors_are_named():
    first, second = toys(TWO)
    assert differing_priors([first, second]) == ()
    own = second.models
    stiff, shear = own.parameters.parameters
    wider = replace(stiff, prior=replace(stiff.prior, scale=2.0 * stiff.prior.scale))
    own = replace(own, parameters=replace(own.parameters, parameters=(wider, shear)))
    assert differing_priors([first, replace(second, models=own)]) == ("E1",)


@pytest.mark.slow
def test_a_plates_list_is_paired_in_order_and_an_incomplete_one_by_what_is_probable():
    own = builtin("A1")
    ordered = plate_case(own)
    np.testing.assert_array_equal(ordered.modes, np.arange(own.measurement.size))
    assert ordered.models.n_modes == own.measurement.size + 2
    f = np.delete(own.measurement.frequencies, 1)  # without the second mode, which the file allows
    short = replace(own.measurement, frequencies=f, labels=("",) * len(f), complete=False)
    found = plate_case(replace(own, measurement=short))
    assert found.measurement.size == len(f)
    kept, first = plain_pairings([found], 0.02)
    for lists in (kept[0], first[0]):
        np.testing.assert_array_equal(lists.cases[0].modes, np.delete(np.arange(len(f) + 1), 1))
    of_first = found.models.parameters["E1"].prior  # normal about the reference if its sd is given
    assert of_first.sd / of_first.mean == pytest.approx(0.1, rel=0.02)


def test_models_are_the_same_from_workers_and_on_demand_and_built_once(monkeypatch):
    c1 = plate_case(read_plate("C1"))
    some = [(h, at) for h, at in hypotheses_of([c1]) if h.cause in ("air", "shear_ratio", "sensor_mass")]
    seen = []
    monkeypatch.setattr(build, "_made", OrderedDict())
    with ThreadPoolExecutor(2) as pool:
        build_models([c1], some, pool, lambda *n: seen.append(n))
    build_models([c1], some, None, lambda *n: seen.append(n))
    assert seen == [(0, 3), (1, 3), (2, 3), (3, 3)]
    assert len(c1.extended) == 3
    build.forget_models()
    on_demand = replace(c1, extended={})
    for hypothesis, _ in some:
        (effect,) = hypothesis.effects
        model, built = on_demand.with_effect(effect), c1.extended[effect.name, effect.variant]
        assert model is not built
        x = model.parameters.sample(np.random.default_rng(0), 20)
        x = x[model.admissible(x)]
        np.testing.assert_array_equal(model.predict(x).frequencies, built.predict(x).frequencies)
    hypothesis, plates = some[0]  # an effect that cannot be sent is built on demand
    effect = replace(hypothesis.effects[0], change=lambda problem, facts: problem)
    anew = replace(c1, extended={})
    build_models([anew], [(replace(hypothesis, effects=(effect,)), plates)])
    assert not anew.extended


def test_a_size_that_plates_share_is_one_that_each_of_them_can_have():
    cases = [plate_case(builtin(name)) for name in ("C1", "C2")]
    # a square plate and an oblong one: a corner is a smaller part of the latter
    sides = [(c.models.specimen.plate.length, c.models.specimen.plate.width) for c in cases]
    square, oblong = (min(s) / max(s) for s in sides)
    assert oblong < square
    shared = [h for h, plates in hypotheses_of(cases, (OUTLINE,)) if h.cause == "outline" and len(plates) > 1]
    assert len(shared) == 4
    for h in shared:
        assert h.effects[0].parameters[0].prior.upper <= h.effects[0].place[2] ** 2 * oblong
    for own in cases:
        build_models([own], [(shared[0], (0,))])
        assert len(own.extended) == 1
