"""What lists would have shown: the oracle's evidences and the power of a claim against direct simulation."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cpam_bayes.diagnosis.answers import detectability
from cpam_bayes.diagnosis.answers.detectability import (
    Detectable,
    LinearOracle,
    ShiftLine,
    detectable,
    linear_oracle,
    shift_lines,
)
from cpam_bayes.diagnosis.comparison import PlateCase
from cpam_bayes.diagnosis.evidence import weighing
from cpam_bayes.diagnosis.hypotheses import DISCREPANCY, NONE, OTHER, Hypothesis
from cpam_bayes.effects import Effect
from cpam_bayes.parameters import Parameter, ParameterSet, ScaledStudentT, Uniform
from tests.diagnosis.toy_plates import (
    BUMP,
    CONSTANTS,
    DENT,
    F0,
    NOISE,
    SCATTER,
    A,
    Array,
    a_list,
    case,
    cause,
    even,
    exact_log_evidence,
    hypothesis,
    plate_model,
    straight,
    whole_normal,
)
from tests.toy_models import ToyModel

NOTHING = Hypothesis(NONE, NONE, prior=0.5)
ANYTHING = Hypothesis(OTHER, OTHER, parameters=(DISCREPANCY,), prior=0.05)
BENT, TWIN = cause("bent", whole_normal(0.02)), cause("twin", whole_normal(0.02))
DENTED = cause("dented", whole_normal(0.02))
WARP = cause("warp", ScaledStudentT(0.1, 4.0, -0.8, 0.8), is_even=True)
STIFF = cause("stiff", whole_normal(0.02))
HEAVY = cause("heavy", ScaledStudentT(0.02, 4.0, 0.0, 0.16))
SHIFTS = {
    "bent": straight(BUMP),
    "twin": straight(BUMP + 0.02 * DENT),
    "dented": straight(DENT),
    "warp": even(DENT),
    "stiff": straight(A @ [0.5, 0.5]),
    "heavy": straight(-np.abs(DENT)),
}


def weighed(
    *effects: Effect, relative: float | None = NOISE, other: bool = False, scatter: float = 0.0
) -> weighing.Weighed:
    """Of a list at the prior means."""
    own = case(a_list(F0 * (1.0 + scatter * SCATTER), relative), [(e, SHIFTS[e.name]) for e in effects])
    some = [NOTHING, *([ANYTHING] if other else []), *(hypothesis(e, 0.1) for e in effects)]
    return weighing.weigh([own], [(h, (0,)) for h in some], pairs=False)


def oracle_of(found: weighing.Weighed, n: int = 64) -> tuple[LinearOracle, tuple[ShiftLine, ...]]:
    lines = shift_lines(found.tested, found.none.marginal)
    return linear_oracle(found, lines, n, np.random.default_rng(0)), lines


def by_cause(found: tuple[Detectable, ...]) -> dict[str, Detectable]:
    return {entry.cause: entry for entry in found}


def log_evidences(f: Array, *directions: tuple[Array, float]) -> float:
    return exact_log_evidence(f, NOISE * F0, *directions)


def test_evidences_of_simulated_lists_are_exact() -> None:
    found = weighed(BENT, DENTED)
    oracle, _ = oracle_of(found, 16)
    shift = np.stack([np.zeros(8), 0.01 * BUMP, 0.02 * BUMP - 0.005 * DENT])
    log_weight = oracle.log_weights(shift)
    assert set(oracle.causes) == {NONE, "bent", "dented"}
    at = {name: i for i, name in enumerate(oracle.causes)}
    for i in range(16):
        for j in range(3):
            f = F0 * np.exp(oracle.noise[i] + shift[j])
            plain = log_evidences(f)
            for name, direction in (("bent", BUMP), ("dented", DENT)):
                expected = log_evidences(f, (direction, 0.02)) + np.log(0.1) - plain - np.log(0.5)
                odds = log_weight[at[name], i, j] - log_weight[at[NONE], i, j]
                # the toy's frequencies are linear, the oracle's are so in their logarithm
                assert odds == pytest.approx(expected, abs=0.03 + 0.02 * abs(expected))


def test_an_inferred_noise_is_integrated_over_its_prior() -> None:
    found = weighed(BENT, relative=None, scatter=NOISE)
    oracle, _ = oracle_of(found, 8)
    prior = found.none.marginal.comparison.parameters.parameters[-1].prior
    a = np.geomspace(prior.lower, prior.upper, 3001)
    shift = 0.01 * BUMP
    log_weight = oracle.log_weights(shift[None])
    at = {name: i for i, name in enumerate(oracle.causes)}
    for i in range(8):
        f = F0 * np.exp(oracle.noise[i] + shift)

        def integral(*directions: tuple[Array, float], f: Array = f) -> float:
            each = np.array([exact_log_evidence(f, s * F0, *directions) for s in a])
            each += prior.log_density(a)
            return float(np.log(np.trapezoid(np.exp(each - each.max()), a)) + each.max())

        expected = integral((BUMP, 0.02)) - integral() + np.log(0.2)
        odds = float(log_weight[at["bent"], i, 0] - log_weight[at[NONE], i, 0])
        assert odds == pytest.approx(expected, abs=0.5 + 0.1 * abs(expected))


def test_the_power_of_a_claim_is_that_of_lists_that_are_simulated() -> None:
    """The claim's rule on exact evidences of 400 lists of their own noise, at the size that was found."""
    found = weighed(BENT, DENTED)
    entry = by_cause(detectable(found))["bent"]
    assert entry.smallest is not None
    assert entry.probability_of_claim == pytest.approx(0.95, abs=0.02)
    rng = np.random.default_rng(7)

    def power(size: float) -> float:
        claims = []
        for _ in range(400):
            f = F0 * (1.0 + size * BUMP) * (1.0 + NOISE * rng.standard_normal(8))
            log_odds = [log_evidences(f, (d, 0.02)) - log_evidences(f) + np.log(0.2) for d in (BUMP, DENT)]
            weight = np.exp([*log_odds, 0.0])
            # 3 nats before none follow from the probability; of equal priors the other one must be told apart
            claims.append(weight[0] / weight.sum() >= 0.9 and log_odds[0] >= log_odds[1] + 3.0)
        return float(np.mean(claims))

    # 400 lists: one per cent
    assert power(entry.smallest) == pytest.approx(0.95, abs=0.035)
    assert power(0.8 * entry.smallest) < 0.85


def test_a_cause_that_cannot_be_told_from_another_is_seen_as_their_class() -> None:
    alone = by_cause(detectable(weighed(BENT)))["bent"].smallest
    both = by_cause(detectable(weighed(BENT, TWIN)))
    assert alone is not None
    for name in ("bent", "twin"):
        smallest = both[name].smallest
        assert smallest is not None
        assert smallest == pytest.approx(alone, rel=0.15)


def test_what_the_constants_absorb_is_never_seen() -> None:
    found = by_cause(detectable(weighed(STIFF, BENT)))
    assert found["stiff"].smallest is None
    assert found["stiff"].probability_of_claim is not None
    assert found["stiff"].probability_of_claim < 0.05
    assert found["bent"].smallest is not None


def test_sizes_are_those_of_the_cause_with_its_sign_and_its_slope() -> None:
    found = by_cause(detectable(weighed(WARP, BENT, HEAVY, other=True)))
    for name, slope in (("warp", 2), ("heavy", 1), ("bent", 1)):
        entry = found[name]
        assert entry.smallest is not None
        assert entry.parameter is not None
        direction = SHIFTS[name](np.array([1.0]))[0][0]
        # between three and ten standard deviations of what the constants leave
        visible = np.linalg.norm(oracle_of(weighed(BENT))[0].root @ direction)
        assert 3.0 < visible * entry.smallest**slope < 12.0
    assert {NONE, OTHER}.isdisjoint(found)


def test_noise_that_is_larger_hides_larger_sizes_and_the_answer_is_the_same_again() -> None:
    precise, rough = (by_cause(detectable(weighed(BENT, relative=r)))["bent"] for r in (0.001, 0.004))
    assert precise.smallest is not None
    assert rough.smallest is not None
    assert rough.smallest / precise.smallest == pytest.approx(4.0, rel=0.2)
    assert detectable(weighed(BENT)) == detectable(weighed(BENT))


def test_what_is_wrong_with_a_list_has_no_size() -> None:
    missed = Hypothesis("mode_identity", "list", "mode 1 missed", prior=0.1)
    found = weighed(BENT)
    none = found.none
    with_list = replace(found, tested=(*found.tested, replace(none, hypothesis=missed)))
    entry = by_cause(detectable(with_list))["mode_identity"]
    assert entry == Detectable("mode_identity", None, None, None)


def test_the_size_is_that_of_a_variant_that_has_one() -> None:
    found = weighed(BENT)
    sized = found.best_of("bent")
    gross = replace(sized.hypothesis, variant="gross", parameters=())
    first = replace(sized, hypothesis=gross, shift=None, probability=0.9)
    both = by_cause(detectable(replace(found, tested=(first, *found.tested))))
    assert both["bent"].parameter == sized.hypothesis.parameters[0]
    assert both["bent"].smallest is not None


def test_a_cause_with_a_place_has_the_size_at_the_median_place(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half of the places show the cause only half as well."""
    place = Parameter("place", "", Uniform(0.0, 1.0), 0.5)
    local = replace(BENT, parameters=(*BENT.parameters, place))

    def function(x: Array) -> tuple[Array, Array]:
        size, where = x[:, 2], x[:, 3]
        factor = np.where(where > 0.5, 0.5, 1.0)
        bare, slope = plate_model().function(x[:, :2])
        f = bare + F0 * (size * factor)[:, None] * BUMP
        of_size = F0 * factor[:, None] * BUMP
        return f, np.concatenate((slope, of_size[..., None], np.zeros_like(of_size)[..., None]), axis=2)

    own = case(a_list(F0, NOISE), [])
    own.extended[(local.name, "")] = ToyModel(CONSTANTS.union(ParameterSet(local.parameters)), function)  # type: ignore[assignment]
    tested = weighed_by_hand(own, local)
    lines = shift_lines(tested.tested, tested.none.marginal)
    assert len(lines) == 16
    assert np.exp([line.log_prior for line in lines]).sum() == pytest.approx(0.1)
    steep = [np.abs(line.shift[-1]).max() / line.size[-1] for line in lines]
    np.testing.assert_allclose(sorted(steep), [0.5] * 8 + [1.0] * 8, rtol=0.05)
    monkeypatch.setattr(detectability, "_PLACES", 16)
    here = by_cause(detectable(tested))["bent"].smallest
    everywhere = by_cause(detectable(weighed(BENT)))["bent"].smallest
    assert here is not None
    assert everywhere is not None
    assert here == pytest.approx(2.0 * everywhere, rel=0.1)


def weighed_by_hand(own: PlateCase, effect: Effect) -> weighing.Weighed:
    of: Any = [
        weighing.Tested(h, (0,), weighing.marginal_of([own], h, (0,)), probability=p, shift=s)
        for h, p, s in ((NOTHING, 0.8, None), (hypothesis(effect, 0.1), 0.2, np.zeros((19, 8))))
    ]
    return weighing.Weighed(tuple(of), ())
