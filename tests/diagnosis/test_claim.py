"""The rule of claims, by tables of numbers."""

from __future__ import annotations

from collections.abc import Mapping

import pytest

from cpam_bayes.diagnosis.hypotheses import CLAIM_RULES, NONE, OTHER, Claim, claim_of

PAIRS = {"a + b": ("a", "b"), "c + d": ("c", "d")}


def claimed(
    probability: Mapping[str, float],
    log_evidence: Mapping[str, float] | None = None,
    classes: tuple[str, ...] = (),
    pairs: Mapping[str, tuple[str, ...]] = PAIRS,
) -> Claim:
    """classes : words of one-letter causes that look alike."""
    whole = {NONE: 0.0, OTHER: 0.0, **probability}
    evidence = dict.fromkeys(whole, -20.0) | {NONE: 0.0} | dict(log_evidence or {})
    alike = {c: frozenset().union(*(set(w) - {c} for w in classes if c in w)) for c in whole}
    return claim_of(whole, evidence, alike, {n: p for n, p in pairs.items() if n in whole})


@pytest.mark.parametrize("p", [0.5, 0.51, 1.0])
def test_none_at_a_half_or_more(p: float) -> None:
    assert claimed({NONE: p, "a": 1.0 - p}, {"a": 10.0}) == Claim("none", (), p)


def test_undecided_has_the_probability_that_one_of_its_causes_acts() -> None:
    probability = {"none": 0.0, "other": 0.6, "a": 0.0, "b": 0.05, "c": 0.1, "a + b": 0.25}
    found = claimed(probability, dict.fromkeys(probability, 1.0))
    assert (found.kind, found.causes) == ("undecided", ("a", "b", "c"))
    assert found.probability == pytest.approx(0.4)


def test_just_under_a_half_is_undecided() -> None:
    found = claimed({NONE: 0.499, "a": 0.3, "b": 0.201})
    assert found.kind == "undecided"
    assert found.causes == ("a", "b")
    assert found.probability == pytest.approx(0.501)


def test_one_cause_is_named() -> None:
    found = claimed({NONE: 0.02, "a": 0.95, "b": 0.03}, {"a": 8.0, "b": 1.0})
    assert found == Claim("named", ("a",), 0.95)


@pytest.mark.parametrize(
    ("ahead", "kind"), [(CLAIM_RULES.clear, "named"), (CLAIM_RULES.clear - 0.01, "undecided")]
)
def test_a_cause_is_named_only_three_nats_above_the_best_outsider(ahead: float, kind: str) -> None:
    found = claimed({NONE: 0.02, "a": 0.95, "b": 0.03}, {"a": 8.0, "b": 8.0 - ahead})
    assert found.kind == kind


@pytest.mark.parametrize(
    ("own", "kind"), [(CLAIM_RULES.clear, "named"), (CLAIM_RULES.clear - 0.01, "undecided")]
)
def test_none_is_an_outsider_too(own: float, kind: str) -> None:
    assert claimed({NONE: 0.05, "a": 0.95}, {"a": own}).kind == kind


@pytest.mark.parametrize(("p", "kind"), [(CLAIM_RULES.sure, "named"), (CLAIM_RULES.sure - 0.01, "undecided")])
def test_nine_tenths_name_a_cause_that_stands_alone(p: float, kind: str) -> None:
    assert claimed({NONE: 0.0, "a": p, "b": 1.0 - p}, {"a": 9.0}).kind == kind


def test_causes_that_look_alike_are_a_class() -> None:
    found = claimed(
        {NONE: 0.02, "a": 0.5, "b": 0.3, "c": 0.12, "d": 0.06},
        {"a": 9.0, "b": 8.5, "c": 7.0, "d": 2.0},
        ("abc",),
    )
    assert found.kind == "class"
    assert found.causes == ("a", "b", "c")
    assert found.probability == pytest.approx(0.92)


def test_members_of_a_class_do_not_stand_in_each_others_way() -> None:
    assert claimed({"a": 0.5, "b": 0.45, "c": 0.05}, {"a": 9.0, "b": 8.9, "c": 5.9}, ("ab",)).kind == "class"
    assert (
        claimed({"a": 0.5, "b": 0.45, "c": 0.05}, {"a": 9.0, "b": 8.9, "c": 6.1}, ("ab",)).kind == "undecided"
    )


def test_a_member_is_named_only_where_it_has_nine_tenths_itself() -> None:
    evidence = {"a": 9.0, "b": 6.5}
    assert claimed({"a": 0.995, "b": 0.005}, evidence, ("ab",)) == Claim("named", ("a",), 0.995)
    # the data cannot tell them: that one is a priori more probable is no finding
    assert claimed({"a": 0.92, "b": 0.08}, evidence, ("ab",)) == Claim("class", ("a", "b"), 1.0)
    assert claimed({"a": 0.89, "b": 0.11}, evidence, ("ab",)).kind == "class"


def test_causes_that_do_not_look_alike_are_no_class() -> None:
    assert claimed({"a": 0.5, "b": 0.5}, {"a": 9.0, "b": 9.0}).kind == "undecided"


def test_a_class_has_six_members_at_most() -> None:
    letters = "abcdefgh"
    assert CLAIM_RULES.most == 6
    small = dict(zip(letters, (0.3, 0.2, 0.2, 0.1, 0.1, 0.06, 0.02, 0.02), strict=True))
    found = claimed(small, dict.fromkeys(letters, 9.0), (letters,))
    assert found.kind == "class"
    assert found.causes == tuple("abcdef")
    assert found.probability == pytest.approx(0.96)
    even = dict.fromkeys(letters, 0.125)
    assert claimed(even, dict.fromkeys(letters, 9.0), (letters,)).kind == "undecided"


def test_two_causes_at_once_are_a_pair() -> None:
    found = claimed({"a + b": 0.93, "a": 0.05, "c": 0.02}, {"a + b": 20.0, "a": 12.0, "c": 1.0})
    assert found == Claim("pair", ("a", "b"), 0.93)


def test_a_cause_is_claimed_where_it_is_open_what_acts_beside_it() -> None:
    probability = {"a + b": 0.5, "c + a": 0.43, "c + d": 0.05, "a": 0.02, "b": 0.0, "c": 0.0, "d": 0.0}
    pairs = {"a + b": ("a", "b"), "c + a": ("c", "a"), "c + d": ("c", "d")}
    # whatever acts beside it, a does
    assert claimed(probability, pairs=pairs) == Claim("named", ("a",), pytest.approx(0.95))
    # a pair is not sure because another one is like it
    found = claimed(probability, classes=("bc",), pairs=pairs)
    assert (found.kind, found.causes, found.probability) == ("named", ("a",), pytest.approx(0.95))


@pytest.mark.parametrize(("pair", "kind"), [("a + b", "named"), ("c + d", "undecided")])
def test_pairs_count_in_the_probabilities_alone(pair: str, kind: str) -> None:
    # their priors are so low that their evidence may well be the larger one
    assert claimed({"a": 0.95, pair: 0.05}, {"a": 10.0, pair: 11.0}) == Claim("named", ("a",), 0.95)
    assert claimed({"a": 0.85, pair: 0.15}, {"a": 10.0, pair: 11.0}).kind == kind


def test_nothing_is_claimed_that_does_not_explain_the_lists() -> None:
    probability = {NONE: 0.0, OTHER: 0.01, "a": 0.97, "b": 0.02}
    evidence = {NONE: 0.0, OTHER: 30.0, "a": 40.0, "b": 35.0}
    alike = {c: frozenset[str]() for c in probability}
    assert claim_of(probability, evidence, alike, {}) == Claim("named", ("a",), 0.97)
    nothing_explains = claim_of(probability, evidence, alike, {}, lambda name: False)
    assert (nothing_explains.kind, nothing_explains.causes) == ("other", ())
    assert claim_of(probability, evidence, alike, {}, lambda name: name == "b").kind == "other"
    assert (
        claim_of({**probability, "a": 0.5, "b": 0.49}, evidence, alike, {}, lambda n: n == "b").kind
        == "undecided"
    )


def test_other_where_nothing_known_explains_the_data() -> None:
    found = claimed({OTHER: 0.94, "a": 0.04, NONE: 0.02}, {OTHER: 9.0})
    assert found == Claim("other", (), 0.94)
    assert claimed({OTHER: 0.89, "a": 0.09, NONE: 0.02}, {OTHER: 9.0}).kind == "undecided"


def test_undecided_names_the_three_most_probable() -> None:
    found = claimed({NONE: 0.1, OTHER: 0.1, "a": 0.1, "b": 0.3, "c": 0.2, "d": 0.15, "e": 0.05})
    assert found.kind == "undecided"
    assert found.causes == ("b", "c", "d")
    assert found.probability == pytest.approx(0.65)


def test_undecided_takes_a_pair_as_both_its_causes() -> None:
    found = claimed({NONE: 0.1, "a + b": 0.4, "b": 0.3, "c": 0.2})
    assert found.causes == ("a", "b", "c")


def test_other_alone_against_none_is_undecided_about_no_cause() -> None:
    found = claimed({NONE: 0.4, OTHER: 0.6})
    assert (found.kind, found.causes) == ("undecided", ())
