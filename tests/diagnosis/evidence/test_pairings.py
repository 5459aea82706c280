"""Incomplete lists: evidences are sums over pairings, against all pairings in closed form."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from scipy.special import logsumexp

from cpam_bayes.diagnosis.cases import neighbours, with_pairing
from cpam_bayes.diagnosis.comparison import PlateCase
from cpam_bayes.diagnosis.diagnose import diagnose_cases
from cpam_bayes.diagnosis.evidence.weighing import Weighed, weigh
from cpam_bayes.diagnosis.hypotheses import NONE, Hypothesis
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
    hypothesis,
    log_normal_density,
    measured,
    misread,
    straight,
    whole_normal,
)

DENTED = cause("dented", whole_normal(0.01))
SHIFTS = {"bent": (BUMP, 0.02), "dented": (DENT, 0.01)}
SINGLES = tuple(hypothesis(effect, 0.1) for effect in (BENT, DENTED))
MISSED, FALSE = 0.1, 0.1


def gappy(
    shift: Array | float = 0.0, lacks: tuple[int, ...] = (3,), false: tuple[float, ...] = (555.0,)
) -> Array:
    """A list without some modes and with false peaks, Hz."""
    return np.sort(np.append(np.delete(measured(shift), lacks), false))


def plate(f: Array, labels: dict[int, int] | None = None, name: str = "toy") -> PlateCase:
    """A plate with an incomplete list; labels : modes of some of its frequencies."""
    text = tuple("a label" if i in (labels or {}) else "" for i in range(len(f)))
    listed = replace(
        a_list(f, NOISE), complete=False, labels=text, missed_probability=MISSED, false_peaks=FALSE
    )
    own = case(listed, [(e, straight(SHIFTS[e.name][0])) for e in (BENT, DENTED)], name=name)
    fixed = np.array(list((labels or {}).values()), dtype=int)
    modes = np.empty(len(f), dtype=int)
    free = iter(np.setdiff1d(np.arange(len(F0)), fixed))
    for i in range(len(f)):
        modes[i] = (labels or {}).get(i, -1)
        if modes[i] < 0:
            modes[i] = next(free)
    return replace(own, modes=modes)


def pairings(n: int, labels: dict[int, int]) -> Iterator[Array]:
    """All pairings that keep the order of what has no label."""
    rows = [i for i in range(n) if i not in labels]
    columns = [k for k in range(len(F0)) if k not in labels.values()]
    for r in range(min(len(rows), len(columns)) + 1):
        for chosen in combinations(rows, r):
            for modes in combinations(columns, r):
                pairing = np.full(n, -1)
                pairing[list(labels)] = list(labels.values())
                pairing[list(chosen)] = modes
                if r or labels:
                    yield pairing


def exact(f: Array, cause: str, labels: dict[int, int] | None = None) -> float:
    """Log evidence summed over all pairings, each the density of a linear model with normal priors."""
    values = []
    for pairing in pairings(len(f), labels or {}):
        kept = pairing >= 0
        modes = pairing[kept]
        below = set(range(modes.max() + 1)) | ({k for k in range(len(F0)) if F0[k] <= f[-1]} - set(modes))
        missed = len(below if not kept[-1] else set(range(modes.max() + 1))) - len(modes)
        slope = SD * A[modes]
        if cause in SHIFTS:
            direction, sd = SHIFTS[cause]
            slope = np.column_stack((slope, sd * direction[modes]))
        slope = slope * f[kept, None]
        density = log_normal_density(f[kept], F0[modes], slope @ slope.T + np.diag((NOISE * f[kept]) ** 2))
        values.append(
            density
            + len(modes) * np.log1p(-MISSED)
            + missed * np.log(MISSED)
            + (~kept).sum() * np.log(FALSE / f[-1])
        )
    return float(logsumexp(values))


def evidence(found: Weighed, cause: str) -> float:
    return float(logsumexp([t.marginal.log_evidence for t in found.tested if t.hypothesis.cause == cause]))


def of_one(*hypotheses: Hypothesis) -> list[tuple[Hypothesis, tuple[int, ...]]]:
    return [(h, (0,)) for h in hypotheses]


# Importance sampling's error is 0.03; pairings 12 nats below the best are left out.
TOLERANCE = 0.1


@pytest.mark.parametrize(
    ("shift", "lacks", "false"),
    [
        (0.0, (3,), (555.0,)),
        pytest.param(0.01 * BUMP, (3,), (555.0,), marks=pytest.mark.slow),
        (0.02 * BUMP, (1,), ()),
        # the false peak lies above the highest mode of the list
        pytest.param(0.0, (7,), (660.0,), marks=pytest.mark.slow),
    ],
)
def test_an_evidence_is_the_sum_over_all_pairings(
    shift: Array | float, lacks: tuple[int, ...], false: tuple[float, ...]
) -> None:
    f = gappy(shift, lacks, false)
    found = weigh([plate(f)], of_one(NOTHING, *SINGLES), sets=False)
    for name in (NONE, "bent", "dented"):
        assert evidence(found, name) == pytest.approx(exact(f, name), abs=TOLERANCE)
    factor = exact(f, "bent") - exact(f, NONE)
    assert found.log_bayes_factor(("bent",)) == pytest.approx(factor, abs=2 * TOLERANCE)
    weight = np.array([np.log(h.prior) + exact(f, h.cause) for h in (NOTHING, *SINGLES)])
    expected = np.exp(weight - logsumexp(weight))
    for h, p in zip((NOTHING, *SINGLES), expected, strict=True):
        assert found.by_cause()[h.cause] == pytest.approx(p, abs=0.05)


def test_the_cause_is_found_though_the_plain_model_pairs_the_list_otherwise() -> None:
    f = gappy(0.06 * BUMP, (4,), ())
    found = weigh([plate(f)], of_one(NOTHING, *SINGLES), sets=False)
    truth = np.delete(np.arange(8), 4)
    assert not np.array_equal(found.none.cases[0].modes, truth)
    best = found.tested[0]
    assert best.hypothesis.cause == "bent"
    np.testing.assert_array_equal(best.cases[0].modes, truth)
    assert evidence(found, "bent") == pytest.approx(exact(f, "bent"), abs=TOLERANCE)
    assert found.by_cause()["bent"] > 0.99


def test_a_labelled_frequency_keeps_its_mode_and_the_others_are_summed_over() -> None:
    # without the label the fourth frequency is more probably the fourth mode
    f = gappy()
    labels = {3: 4, 7: 7}
    found = weigh([plate(f, labels)], of_one(NOTHING, *SINGLES), sets=False)
    for t in found.tested:
        assert all(t.cases[0].modes[i] == mode for i, mode in labels.items())
    for name in (NONE, "bent", "dented"):
        assert evidence(found, name) == pytest.approx(exact(f, name, labels), abs=TOLERANCE)


def test_a_wrong_label_is_believed() -> None:
    f = gappy(false=())
    found = weigh([plate(f, {0: 1})], of_one(NOTHING), sets=False)
    assert {int(t.cases[0].modes[0]) for t in found.tested} == {1}


def test_a_misread_frequency_of_an_incomplete_list_is_found() -> None:
    f = gappy(0.0, (5,), ())
    f[2] *= 1.06
    errors = [misread(i, 0.02) for i in range(len(f))]
    found = weigh([plate(f)], of_one(NOTHING, *SINGLES, *errors), sets=False)
    best = found.best_of("outlier")
    assert best.hypothesis.listed.misread == (2,)
    np.testing.assert_array_equal(best.cases[0].modes, np.delete(np.arange(8), 5))


def test_a_complete_list_beside_an_incomplete_one_keeps_its_pairing() -> None:
    whole = case(
        a_list(F0 * (1.0 + A @ [0.03, -0.04]), NOISE),
        [(e, straight(SHIFTS[e.name][0])) for e in (BENT, DENTED)],
        name="whole",
        specimen="toy",
    )
    gaps = plate(gappy(0.0, (2,), ()))
    every = [(h, (0, 1)) for h in (NOTHING, *SINGLES)]
    found = weigh([whole, gaps], every, sets=False)
    assert found.tested[0].hypothesis.cause == NONE
    for t in found.tested:
        np.testing.assert_array_equal(t.cases[0].modes, np.arange(8))
    np.testing.assert_array_equal(found.none.cases[1].modes, np.delete(np.arange(8), 2))


def test_the_answer_shows_false_peaks_and_missed_modes_of_each_fit() -> None:
    f = gappy(0.03 * BUMP)
    d = diagnose_cases([plate(f)], hypotheses=of_one(NOTHING, ANYTHING, *SINGLES), sets=False)
    assert d.claim.causes == ("bent",)
    assert d.extended is not None
    assert d.gain is not None
    assert len(d.extended.measured) == len(f) == len(d.gain.held_out)
    modes = d.members[0][0].cases[0].modes
    np.testing.assert_array_equal(modes, [0, 1, 2, 4, 5, -1, 6, 7][: len(f)])
    # the plain model's evidence is over its pairings
    assert d.baseline.log_evidence == pytest.approx(exact(f, NONE), abs=TOLERANCE)
    assert d.gain.log_bayes_factor == pytest.approx(exact(f, "bent") - exact(f, NONE), abs=2 * TOLERANCE)


def test_the_prior_of_a_pairing_counts_paired_missed_and_false() -> None:
    own = plate(gappy())
    paired = with_pairing(own, np.array([0, 1, 2, 4, 5, -1, 6, -1]), missed_above=1)
    expected = 6 * np.log(0.9) + 2 * np.log(0.1) + 2 * np.log(0.1 / own.measurement.frequencies[-1])
    assert paired.log_pairing == pytest.approx(expected, rel=1e-12)


def test_neighbouring_pairings_keep_order_and_labels() -> None:
    own = plate(gappy(), {2: 3})
    at = with_pairing(own, np.array([0, 1, 3, 2, -1, 5, 6, 7]))
    found = neighbours(at)
    for modes in found:
        assert modes[2] == 3
        others = np.delete(modes, 2)
        assert np.all(np.diff(others[others >= 0]) > 0)
        assert 3 not in others
    assert any(np.array_equal(modes, [0, 1, 3, 2, 4, 5, 6, 7]) for modes in found)
    assert any(np.array_equal(modes, [0, 1, 3, 2, 5, -1, 6, 7]) for modes in found)
