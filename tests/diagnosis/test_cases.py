"""Which hypotheses plates have and how probable each is, how a list is paired, and the models they need."""

from collections import OrderedDict, defaultdict
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from cpam_bayes.diagnosis.cases import build_models, differing_priors, hypotheses_of, plate_case
from cpam_bayes.diagnosis.comparison import PlateCase
from cpam_bayes.diagnosis.evidence.pairing_search import plain_pairings
from cpam_bayes.diagnosis.hypotheses import (
    NONE,
    OTHER,
    SET,
    Hypothesis,
    single_hypotheses,
    with_leftover,
)
from cpam_bayes.diagnosis.models import diagnosis_parameters
from cpam_bayes.effects import ListChange, PlateFacts, applicable
from cpam_bayes.effects.geometry import OUTLINE
from cpam_bayes.effects.plies import MATERIAL
from cpam_bayes.forward_model import build
from cpam_bayes.plate import builtin, read_plate
from cpam_bayes.plate.reader import builtin_names
from tests.diagnosis.toy_plates import F0, a_list, case, pairs_of


def facts_of(name: str, *, air: bool = False, references: bool = False) -> PlateFacts:
    of = builtin(name)
    return PlateFacts.of(of.plate, of.material.isotropic, air_is_known=air, has_references=references)


def singles(name: str, n: int = 8, *, complete: bool = True, air: bool = False) -> tuple[Hypothesis, ...]:
    return single_hypotheses(facts_of(name, air=air), n, complete=complete)


def of_families(hypotheses: tuple[Hypothesis, ...]) -> dict[str, float]:
    found: dict[str, float] = defaultdict(float)
    for h in hypotheses:
        found[h.family] += h.prior
    return found


# Prior probability that several causes act at once: two, three.
OF_SETS = 0.055 + 0.015
PLATES = [name for name in builtin_names() if not builtin(name).plate.layup.n_unknown]


@pytest.mark.parametrize("name", PLATES)
@pytest.mark.parametrize("complete", [True, False])
def test_priors_and_those_of_sets_sum_to_one(name: str, complete: bool) -> None:
    found = singles(name, complete=complete)
    assert sum(h.prior for h in found) == pytest.approx(1.0 - OF_SETS, abs=1e-12)
    assert found[0] == Hypothesis(NONE, NONE, prior=0.5)
    assert of_families(found)[OTHER] == pytest.approx(0.05)


@pytest.mark.parametrize("name", ["C1", "A2", "D3"])
def test_families_are_equally_probable_and_so_are_the_causes_of_one(name: str) -> None:
    found = singles(name)
    families = of_families(found)
    rest = [p for family, p in families.items() if family not in (NONE, OTHER)]
    np.testing.assert_allclose(rest, (0.45 - OF_SETS) / len(rest), rtol=1e-12)
    by_cause: dict[tuple[str, str], float] = defaultdict(float)
    for h in found:
        by_cause[h.family, h.cause] += h.prior
    for family in families:
        own = [p for (f, _), p in by_cause.items() if f == family]
        np.testing.assert_allclose(own, own[0], rtol=1e-12)


def test_what_nothing_explains_is_as_probable_beside_a_cause_as_beside_none_in_three_forms() -> None:
    found = singles("C1")
    of = next(h for h in found if h.cause == "warp")
    alone, beside = with_leftover(of)
    assert alone.prior == pytest.approx(of.prior / 1.1)
    others = [h for h in found if h.cause == OTHER]
    for forms, prior in ((others, 0.05), (beside, of.prior / 11.0)):
        assert [h.correlation_length for h in forms] == [0.0, 0.25, 0.8]
        assert [h.prior for h in forms] == pytest.approx([prior / 3.0] * 3)
    # half a Student-t of 1 % with four degrees of freedom, whose median is 0.741, cut at 50 %
    prior_of_size = others[0].parameters[0].prior
    assert prior_of_size.ppf(0.5) == pytest.approx(0.00741, rel=1e-3)
    assert prior_of_size.upper == 0.5


def test_every_cause_that_the_plate_may_have_is_there() -> None:
    for name in ("C1", "A2"):
        assert {h.cause for h in singles(name)} == {
            NONE,
            OTHER,
            *(effect.name for effect in applicable(facts_of(name))),
        }


def test_variants_of_a_cause_share_its_prior_evenly_and_a_slip_of_the_pen_has_a_tenth() -> None:
    found = singles("C1")
    masses = [h for h in found if h.cause == "sensor_mass"]
    assert len(masses) == 1
    # a gross error has a tenth of the prior of its size
    (angle,) = [h for h in found if h.cause == "misorientation"]
    assert angle.parameters[0].prior.fraction == 0.1
    assert {h.cause for h in found if h.is_gross} == {"outlier"}
    misread = [h for h in found if h.cause == "outlier"]
    whole = sum(h.prior for h in misread)
    assert sum(h.prior for h in misread if h.is_gross) == pytest.approx(0.1 * whole)


def test_any_frequency_may_be_misread_any_mode_missed_or_false() -> None:
    n = 7
    found = singles("C1", n)
    misread = [h.listed for h in found if h.cause == "outlier"]
    assert [change.misread for change in misread[:n]] == [(i,) for i in range(n)]
    moved = {(*change.missed, change.spurious) for change in misread[n:]}
    assert moved == {(k, i) for k in range(n) for i in range(n) if i != k}
    of_list = [h for h in found if h.cause == "mode_identity"]
    one_missed = [h.listed.missed for h in of_list if len(h.listed.missed) == 1]
    assert one_missed == [(k,) for k in range(n)]
    assert [h.listed.spurious for h in of_list if h.listed.spurious is not None] == list(range(n))
    two = [h.listed.missed for h in of_list if len(h.listed.missed) == 2]
    assert len(two) == n * (n + 1) // 2
    whole = sum(h.prior for h in of_list)
    assert sum(h.prior for h in of_list if len(h.listed.missed) == 2) == pytest.approx(0.1 * whole)


def test_air_that_the_file_states_is_no_cause_and_an_incomplete_list_lacks_modes_by_its_pairing() -> None:
    assert any(h.cause == "air" for h in singles("C1"))
    assert all(h.cause != "air" for h in singles("C1", air=True))
    found = singles("C1", complete=False)
    assert all(h.cause != "mode_identity" for h in found)
    # and a frequency in another place is a false one and a missed one
    assert [h.listed.misread for h in found if h.cause == "outlier"] == [(i,) for i in range(8)]


def toys(*plates: tuple[str, str]) -> list[PlateCase]:
    """Free aluminium plates by their names and specimens."""
    return [case(a_list(F0, 0.002), name=name, specimen=specimen) for name, specimen in plates]


def test_plates_of_one_material_have_causes_of_their_own_and_in_common() -> None:
    found = hypotheses_of(toys(("one", "one"), ("two", "two")))
    assert found[0][0].cause == NONE
    assert len({(h.cause, h.variant, plates) for h, plates in found}) == len(found)
    lengths = {plates: h.prior for h, plates in found if h.cause == "length"}
    assert set(lengths) == {(0, 1), (0,), (1,)}
    assert lengths[0, 1] == pytest.approx(lengths[0,] + lengths[1,])
    # what is wrong with a list is wrong with one list
    assert {plates for h, plates in found if h.listed != ListChange()} == {(0,), (1,)}


def test_tests_of_one_specimen_share_its_flaws_and_not_their_lists() -> None:
    found = hypotheses_of(toys(("one", "same"), ("two", "same")))
    assert {plates for h, plates in found if h.cause == "length"} == {(0, 1)}
    assert {plates for h, plates in found if h.cause == "outlier"} == {(0,), (1,)}
    assert sum(h.prior for h, _ in found) == pytest.approx(1.0 - OF_SETS)


def test_a_flaw_is_about_the_tests_in_which_it_can_act() -> None:
    free, clamped = toys(("one", "same"), ("two", "same"))
    specimen = clamped.models.specimen
    held = replace(specimen, plate=replace(specimen.plate, edges="CFFF"))
    facts = PlateFacts.of(held.plate, held.material.isotropic)
    clamped = replace(clamped, models=replace(clamped.models, specimen=held, facts=facts))
    found = hypotheses_of([free, clamped])
    assert {plates for h, plates in found if h.cause == "support"} == {(0,)}
    assert {plates for h, plates in found if h.cause == "clamp_rotation"} == {(1,)}
    assert {plates for h, plates in found if h.cause == "length"} == {(0, 1)}
    assert sum(h.prior for h, _ in found) == pytest.approx(1.0 - OF_SETS)
    # places differ from test to test; a cause is no more probable for that
    forms = {h.variant for h, plates in found if h.cause == "damage"}
    assert len(forms) == 2
    prior = {c: sum(h.prior for h, _ in found if h.cause == c) for c in ("damage", "sensor_mass")}
    alone = {c: sum(h.prior for h, _ in hypotheses_of([clamped]) if h.cause == c) for c in prior}
    assert prior["damage"] / prior["sensor_mass"] == pytest.approx(alone["damage"] / alone["sensor_mass"])


@pytest.mark.parametrize(
    "plates",
    [
        (("one", "one"),),
        (("one", "one"), ("two", "two")),
        (("one", "same"), ("two", "same"), ("three", "three")),
    ],
)
def test_hypotheses_of_plates_begin_with_none_and_share_all_the_probability(
    plates: tuple[tuple[str, str], ...],
) -> None:
    found = hypotheses_of(toys(*plates))
    assert found[0][0].cause == NONE
    assert sum(h.prior for h, _ in found) == pytest.approx(1.0 - OF_SETS)
    if len(plates) == 1:
        assert all(of == (0,) for _, of in found)


def test_constants_that_files_give_different_priors_are_named() -> None:
    same = toys(("one", "one"), ("two", "two"))
    assert differing_priors(same) == ()
    own = same[1].models
    wider = tuple(
        replace(p, prior=replace(p.prior, scale=2.0 * p.prior.scale)) if p.name == "E1" else p  # type: ignore[type-var, union-attr]
        for p in own.parameters.parameters
    )
    other = replace(same[1], models=replace(own, parameters=replace(own.parameters, parameters=wider)))
    assert differing_priors([same[0], other]) == ("E1",)


def test_another_list_shares_the_models() -> None:
    first = toys(("one", "one"))[0]
    second = replace(first, measurement=a_list(1.01 * F0, 0.003))
    assert second.models is first.models
    assert second.extended is first.extended
    assert second.measurement.relative_std == 0.003


def test_a_plate_without_a_list_or_without_unknowns_is_refused() -> None:
    own = builtin("A1")
    nothing = own.unknowns.without(*own.unknowns.names)
    for of, said in (
        (replace(own, measurement=None), "measurement"),
        (replace(own, unknowns=nothing), "unknowns"),
    ):
        with pytest.raises(ValueError, match=rf"\[{said}\] is missing"):
            plate_case(of)


@pytest.mark.slow
def test_a_plates_list_is_paired_in_order_and_an_incomplete_one_by_what_is_probable() -> None:
    own = builtin("A1")
    assert own.measurement is not None
    ordered = plate_case(own)
    np.testing.assert_array_equal(ordered.modes, np.arange(own.measurement.size))
    assert ordered.models.n_modes == own.measurement.size + 2
    # the aluminium plate measured without its second mode, which the file says may be
    f = np.delete(own.measurement.frequencies, 1)
    short = replace(own.measurement, frequencies=f, labels=("",) * len(f), complete=False)
    found = plate_case(replace(own, measurement=short))
    assert found.measurement.size == len(f)
    kept, first = plain_pairings([found], 0.02)
    for lists in (kept[0], first[0]):
        np.testing.assert_array_equal(lists.cases[0].modes, np.delete(np.arange(len(f) + 1), 1))
    # constants are normal about the reference where its standard deviation is given
    prior = found.models.parameters["E1"].prior
    assert prior.sd / prior.mean == pytest.approx(0.1, rel=0.02)


CAUSES = ("air", "shear_ratio", "sensor_mass")


@pytest.fixture(scope="module")
def whole() -> PlateCase:
    return plate_case(read_plate("C1"))


@pytest.fixture
def c1(whole: PlateCase) -> PlateCase:
    return replace(whole, extended={}, of_another_material=[])


def some_of(c1: PlateCase) -> list[tuple[Hypothesis, tuple[int, ...]]]:
    return [entry for entry in hypotheses_of([c1]) if entry[0].cause in CAUSES]


def test_models_are_the_same_from_workers_and_on_demand(
    c1: PlateCase, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[tuple[int, int]] = []
    monkeypatch.setattr(build, "_made", OrderedDict())
    with ThreadPoolExecutor(2) as pool:
        build_models([c1], some_of(c1), pool, lambda done, total: seen.append((done, total)))
    assert seen == [(0, 3), (1, 3), (2, 3), (3, 3)]
    assert len(c1.extended) == 3
    build.forget_models()
    on_demand = replace(c1, extended={})
    for hypothesis, _ in some_of(c1):
        (effect,) = hypothesis.effects
        model, built = on_demand.with_effect(effect), c1.extended[effect.name, effect.variant]
        assert model is not built
        x = model.parameters.sample(np.random.default_rng(0), 20)
        x = x[model.admissible(x)]
        np.testing.assert_array_equal(model.predict(x).frequencies, built.predict(x).frequencies)


def test_models_at_hand_are_not_built_again(c1: PlateCase) -> None:
    build_models([c1], some_of(c1))
    seen: list[tuple[int, int]] = []
    build_models([c1], some_of(c1), None, lambda *n: seen.append(n))
    assert not seen


def test_effect_that_cannot_be_sent_is_left_to_be_built_when_asked_for(c1: PlateCase) -> None:
    hypothesis, plates = some_of(c1)[0]
    effect = replace(hypothesis.effects[0], change=lambda problem, facts: problem)
    build_models([c1], [(replace(hypothesis, effects=(effect,)), plates)])
    assert not c1.extended


def test_a_size_that_plates_share_is_one_that_each_of_them_can_have() -> None:
    cases = [plate_case(builtin(name)) for name in ("C1", "C2")]
    # a square plate and an oblong one: a corner is less of the latter
    areas = [
        min(s.length, s.width) / max(s.length, s.width) for s in (builtin(n).plate for n in ("C1", "C2"))
    ]
    assert areas[1] < areas[0]
    shared = [
        h for h, plates in hypotheses_of(cases, (OUTLINE,)) if h.cause == "outline" and len(plates) == 2
    ]
    assert len(shared) == 4
    for h in shared:
        assert h.effects[0].parameters[0].prior.upper <= h.effects[0].place[2] ** 2 * areas[1]
    for own in cases:
        build_models([own], [(shared[0], (0,))])
        assert len(own.extended) == 1


def test_only_the_search_bounds_are_left_of_the_constants() -> None:
    specimen = builtin("C2")
    wide = diagnosis_parameters(specimen, other_material=True)
    assert wide.names == specimen.unknowns.names
    assert [p.prior for p in wide.parameters] == [p.prior for p in specimen.unknowns.parameters]
    assert wide.parameters[0].prior != diagnosis_parameters(specimen).parameters[0].prior


def test_it_is_as_probable_as_another_slip_of_the_pen_and_pairs_with_nothing() -> None:
    found = single_hypotheses(facts_of("C2", references=True), 6, complete=True)
    material = next(h for h in found if h.cause == MATERIAL.name)
    assert material.other_material
    alone = next(h for h in found if h.cause == "viscoelastic")  # the one cause of its family
    assert material.prior == pytest.approx(0.1 * alone.prior)
    assert all(MATERIAL.name not in p.causes for p in pairs_of((*found[2:6], material), found))
    assert all(h.family != SET for h in found)
    without = single_hypotheses(facts_of("C2"), 6, complete=True)
    assert MATERIAL.name not in {h.cause for h in without}
