"""Claims of lists with frozen evidences, which `frozen_claims.toml` holds with the reason for each claim.

The numbers of the rules are repeated in these lists, not imported, so that a changed rule fails.
"""

import tomllib
from pathlib import Path

import pytest

from cpam_bayes.diagnosis.diagnose import claim_from
from cpam_bayes.diagnosis.evidence import marginal
from cpam_bayes.diagnosis.evidence.weighing import Weighed, with_factors
from cpam_bayes.diagnosis.hypotheses import OTHER, Hypothesis, beside, inclusion_of, prior_by_cause

FROZEN = tomllib.loads((Path(__file__).parent / "frozen_claims.toml").read_text("utf-8"))
LISTS = {listed["name"]: listed for listed in FROZEN["list"]}


def rows_of(listed):
    lines = listed["evidences"].strip().splitlines()
    written = [[cell.strip() for cell in line.split("|")] for line in lines]
    named, rows = {tuple(cells[:2]) for cells in written}, []
    for causes, variant, *numbers in written:
        if causes == "each other cause":
            every = [(name, "") for name in FROZEN["causes"] if name not in {cause for cause, _ in named}]
        elif variant == "in each of three forms":
            every = [(causes, form) for form in FROZEN["forms"]]
        elif variant == "each other of 27 modes":
            missed = [(causes, f"mode {k} missed") for k in range(1, 28)]
            every = [each for each in missed if each not in named]
        else:
            every = [(causes, variant)]
        rows += [(*each, [float(n) for n in numbers]) for each in every]
    return rows


def with_evidence(causes, variant, prior, log_evidence):
    length = 0.0 if causes == OTHER or "with a leftover" in variant else None
    of = Hypothesis(causes, causes, variant, prior=prior, correlation_length=length)
    # only differences matter: e^800 overflows
    return marginal.Tested(of, (0,), marginal.Marginal(None, (), 800.0 + log_evidence, *(None,) * 6))


def claim_and_weights(listed, unaccounted=0.0):
    rows = rows_of(listed)
    order = marginal.ranked([with_evidence(causes, variant, *n[:2]) for causes, variant, n in rows])
    prior = prior_by_cause([t.hypothesis for t in order])
    weighed = Weighed(with_factors(order), (), prior, listed.get("cut_short", False), unaccounted)
    p_value, misfit = ({(causes, variant): n[k] for causes, variant, n in rows} for k in (2, 3))
    return claim_from(weighed, lambda t: p_value[t.key[:2]], lambda t: misfit[t.key[:2]]), weighed


@pytest.mark.parametrize("listed", LISTS.values(), ids=LISTS)
def test_the_claim_is_the_one_that_was_derived_by_hand(listed):
    found, weighed = claim_and_weights(listed)
    assert (found.kind, found.causes) == (listed["claim"], tuple(listed["causes"]))
    assert found.probability == pytest.approx(listed["probability"], abs=5e-4)
    assert list(beside(found, inclusion_of(weighed.by_cause()))) == listed.get("beside", [])


@pytest.mark.parametrize(
    ("name", "unaccounted", "claim"),
    [
        # misorientation 0.9496, with layup 0.992: 0.9 of all if 0.05, 0.06 or 0.1 was not weighed
        ("a rival more than three nats behind does not", 0.05, "named"),
        ("a rival more than three nats behind does not", 0.06, "class"),
        ("a rival more than three nats behind does not", 0.1, "undecided"),
        ("a rival more than three nats behind does not", 1.0, "undecided"),
        ("two that each act", 0.2, "undecided"),
        ("other from 0.9 on", 0.2, "undecided"),
    ],
)
def test_nothing_is_claimed_that_sets_not_weighed_could_overturn(name, unaccounted, claim):
    assert claim_and_weights(LISTS[name], unaccounted)[0].kind == claim
