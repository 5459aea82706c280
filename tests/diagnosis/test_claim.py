"""The rules of claims, by tables of evidences whose claims were derived by hand.

The numbers of the rules stand here again and are not imported: a changed rule fails.
"""

from __future__ import annotations

from collections.abc import Mapping

import pytest

from cpam_bayes.diagnosis.hypotheses import NONE, OTHER, Claim, claim_of


def claimed(
    probability: Mapping[str, float],
    log_evidence: Mapping[str, float] | None = None,
    unexplained: str | None = None,
) -> Claim:
    """unexplained : hypotheses that leave a misfit, separated by commas; all for "*"."""
    whole = {NONE: 0.0, OTHER: 0.0, **probability}
    evidence = dict.fromkeys(whole, -20.0) | {NONE: 0.0}
    evidence |= {name: 10.0 for name, p in probability.items() if name not in (NONE, OTHER) and p >= 0.1}
    evidence |= dict(log_evidence or {})
    bad = (unexplained or "").split(",")
    return claim_of(whole, evidence, lambda name: name not in bad and bad != ["*"])


@pytest.mark.parametrize(
    ("probability", "log_evidence", "kind", "causes", "p"),
    [
        # nothing wrong from a half on, whatever the evidence of a cause
        ({NONE: 0.5, "a": 0.5}, {"a": 10.0}, "none", "", 0.5),
        ({NONE: 0.499, "a": 0.3, "b": 0.201}, {}, "undecided", "ab", 0.501),
        ({NONE: 0.97, "a": 0.03}, {}, "none", "", 0.97),
        # one cause from 0.9 on
        ({"a": 0.9, OTHER: 0.1}, {}, "named", "a", 0.9),
        ({"a": 0.899, OTHER: 0.101}, {}, "undecided", "a", 0.899),
        # 3 nats above what is without it
        ({NONE: 0.05, "a": 0.95}, {"a": 3.0}, "named", "a", 0.95),
        ({NONE: 0.05, "a": 0.95}, {"a": 2.99}, "undecided", "a", 0.95),
        ({OTHER: 0.05, "a": 0.95}, {"a": 9.0, OTHER: 6.0}, "named", "a", 0.95),
        ({OTHER: 0.05, "a": 0.95}, {"a": 9.0, OTHER: 6.01}, "undecided", "a", 0.95),
        # a cause that is not so far behind joins: priors alone name nothing
        ({"a": 0.95, "b": 0.05}, {"a": 9.0, "b": 6.0}, "named", "a", 0.95),
        ({"a": 0.95, "b": 0.05}, {"a": 9.0, "b": 6.01}, "class", "ab", 1.0),
        # but not with less than a hundredth of the leading probability
        ({"a": 0.991, "b": 0.009}, {"a": 9.0, "b": 8.0}, "named", "a", 0.991),
        ({"a": 0.989, "b": 0.011}, {"a": 9.0, "b": 8.0}, "class", "ab", 1.0),
        # the fewest causes of which one acts, whether or not they look alike
        ({"a": 0.5, "b": 0.3, "c": 0.12, "d": 0.06, NONE: 0.02}, {"d": 2.0}, "class", "abc", 0.92),
        ({"a": 0.5, "b": 0.3, "d": 0.1, "c": 0.08}, {"c": 2.0}, "class", "abd", 0.9),
        ({"a": 0.91, "b": 0.09}, {"a": 9.0, "b": 8.0}, "class", "ab", 1.0),
        # six of a class at most
        (dict(zip("abcdef", (0.4, 0.2, 0.1, 0.1, 0.06, 0.05), strict=True)), {}, "class", "abcdef", 0.91),
        (dict.fromkeys("abcdefg", 0.13), {}, "undecided", "abc", 0.39),
        # two that each act with 0.9
        ({"a + b": 0.93, "a": 0.05, "c": 0.02}, {}, "pair", "ab", 0.93),
        ({"a + b": 0.9, "a": 0.05, "c": 0.05}, {}, "pair", "ab", 0.9),
        ({"a + b": 0.89, "a": 0.11}, {}, "named", "a", 1.0),
        # one that acts whatever is beside it
        ({"a + b": 0.5, "a + c": 0.43, "c + d": 0.05, "a": 0.02}, {}, "named", "a", 0.95),
        # and so do the causes of a set that is not so far behind
        ({"a": 0.95, "c + d": 0.05}, {"a": 10.0, "c + d": 7.0}, "named", "a", 0.95),
        ({"a": 0.95, "c + d": 0.05}, {"a": 10.0, "c + d": 7.01}, "class", "acd", 1.0),
        ({"a": 0.95, "a + b": 0.05}, {"a": 10.0, "a + b": 12.0}, "named", "a", 1.0),
        # three at once, each with 0.9
        ({"a + b + c": 0.9, "a + b": 0.1}, {}, "pair", "abc", 0.9),
        ({"a + b + c": 0.89, "a + b": 0.11}, {}, "pair", "ab", 1.0),
        ({"a + b": 0.46, "a + c": 0.44, "b + d": 0.1}, {"b + d": 2.0}, "named", "a", 0.9),
        # other, and what no rule decides: the three most probable
        ({OTHER: 0.9, "a": 0.1}, {OTHER: 9.0}, "other", "", 0.9),
        ({OTHER: 0.89, "a": 0.11}, {OTHER: 9.0}, "undecided", "a", 0.11),
        ({OTHER: 0.3, "a": 0.1, "b": 0.25, "c": 0.2, "d": 0.15}, {}, "undecided", "bcd", 0.6),
        ({NONE: 0.1, "a + b": 0.4, "b": 0.3, "c": 0.2}, {"none": 9.0}, "undecided", "bac", 0.9),
        ({NONE: 0.4, OTHER: 0.6}, {}, "undecided", "", 0.0),
    ],
)
def test_the_claim(
    probability: dict[str, float], log_evidence: dict[str, float], kind: str, causes: str, p: float
) -> None:
    found = claimed(probability, log_evidence)
    assert (found.kind, found.causes) == (kind, tuple(causes))
    assert found.probability == pytest.approx(p)


@pytest.mark.parametrize(
    ("probability", "unexplained", "kind"),
    [
        ({"a": 0.97, "b": 0.02, OTHER: 0.01}, None, "named"),
        # what leaves a misfit is not claimed: with other it is an error that nothing known explains
        ({"a": 0.97, "b": 0.02, OTHER: 0.01}, "a", "other"),
        ({"a": 0.5, "b": 0.49, OTHER: 0.01}, "a", "undecided"),
        ({NONE: 0.95, "a": 0.05}, "none", "other"),
        ({"a + b": 0.95, "a": 0.05}, "a + b", "other"),
        # below a thousandth it does not matter
        ({"a": 0.8992, "b": 0.0992, "c": 0.0008, "d": 0.0008}, "a,c", "undecided"),
        ({"a": 0.8982, "b": 0.0992, "c": 0.0018, "d": 0.0008}, "a,c", "other"),
    ],
)
def test_nothing_is_claimed_that_does_not_explain_the_lists(
    probability: dict[str, float], unexplained: str | None, kind: str
) -> None:
    evidence = {"b": 2.0} if probability.get("b", 0.0) < 0.4 else {}
    assert claimed(probability, evidence, unexplained).kind == kind


def test_nothing_is_claimed_where_time_was_up() -> None:
    found = claim_of({NONE: 0.0, OTHER: 0.0, "a": 1.0}, {NONE: 0.0, "a": 20.0}, is_cut_short=True)
    assert (found.kind, found.causes) == ("undecided", ("a",))
