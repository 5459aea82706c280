"""Screening of hypotheses and of pairs of them, on plates whose evidences are known in closed form."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from cpam_bayes.diagnosis.evidence import scan as scanning
from cpam_bayes.diagnosis.evidence.marginal import GRID
from cpam_bayes.diagnosis.evidence.pair_screening import ranked_pairs
from cpam_bayes.diagnosis.evidence.scan import Scan
from cpam_bayes.diagnosis.evidence.screening import Linear
from cpam_bayes.diagnosis.fitting import PlateCase
from cpam_bayes.diagnosis.hypotheses import NONE, Hypothesis, paired
from cpam_bayes.effects import Effect, ListChange
from cpam_bayes.effects.frequency_list import MISREADING
from tests.diagnosis.toy_plates import (
    BUMP,
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
    log_normal_density,
    straight,
    whole_normal,
)

BENT, DENTED = cause("bent", whole_normal(0.02)), cause("dented", whole_normal(0.01))
SHIFTS = {"bent": (BUMP, 0.02), "dented": (DENT, 0.01)}


def plate(shift: Array, *, false_peak: float | None = None) -> PlateCase:
    f = F0 * (1.0 + A @ [0.03, -0.04] + shift) * (1.0 + NOISE * SCATTER)
    if false_peak is not None:
        f = np.sort(np.append(f[:7], false_peak))
    return case(a_list(f, NOISE), [(BENT, straight(BUMP)), (DENTED, straight(DENT))])


def begun(own: PlateCase) -> Scan:
    scan = Scan([own], 0.02)
    scan.begin(Hypothesis(NONE, NONE, prior=0.5), (0,))
    return scan


def screened(scan: Scan, h: Hypothesis) -> scanning.Tested:
    (found,) = scan.corrected(scan.screen(h, (0,)))
    assert not found.marginal.is_refined
    return found


@pytest.mark.parametrize(
    ("effect", "size"), [(BENT, 0.0), (BENT, 0.01), (BENT, 0.03), (DENTED, 0.0), (DENTED, 0.01)]
)
def test_screening_gives_the_evidence_of_a_linear_plate(effect: Effect, size: float) -> None:
    own = plate(size * BUMP)
    found = screened(begun(own), hypothesis(effect, 0.1))
    f = own.measurement.frequencies
    expected = exact_log_evidence(f, NOISE * f, SHIFTS[found.hypothesis.cause])
    # logarithms of shifts of 3 % are linear to 5e-4, a quarter of the noise, in each of eight frequencies
    assert found.marginal.log_evidence == pytest.approx(expected, abs=0.8)


def test_the_shifts_of_a_look_are_those_at_the_plain_models_constants() -> None:
    own = plate(0.01 * BUMP)
    found = screened(begun(own), hypothesis(BENT, 0.1))
    assert found.shift is not None
    # one standard deviation of 0.02 a score; the constants are a few per cent from 1
    np.testing.assert_allclose(found.shift, np.log1p(0.02 * GRID[:, None] * BUMP), atol=0.06 * 0.08)


def test_what_pairs_frequencies_otherwise_has_no_shifts_to_add() -> None:
    own = plate(np.zeros(8), false_peak=350.0)
    false = Hypothesis("mode_identity", "list", listed=ListChange(spurious=4), prior=0.1)
    misread = Hypothesis("outlier", "list", listed=ListChange(misread=4), parameters=(MISREADING,), prior=0.1)
    scan = begun(own)
    assert screened(scan, false).shift is None
    assert screened(scan, misread).shift is not None


def test_a_look_far_from_the_plain_models_optimum_finds_the_false_peak() -> None:
    own = plate(np.zeros(8), false_peak=350.0)
    scan = begun(own)
    found = {
        i: screened(scan, Hypothesis("mode_identity", "list", listed=ListChange(spurious=i), prior=0.1))
        for i in range(8)
    }
    assert max(found, key=lambda i: found[i].marginal.log_evidence) == 4


@pytest.mark.parametrize("sizes", [(0.03, 0.02), (-0.02, 0.015)])
def test_a_pair_looked_at_has_the_evidence_of_the_linear_plate(sizes: tuple[float, float]) -> None:
    own = plate(sizes[0] * BUMP + sizes[1] * DENT)
    scan = begun(own)
    bent, dented = (screened(scan, hypothesis(effect, 0.1)) for effect in (BENT, DENTED))
    pair = paired(bent.hypothesis, dented.hypothesis, 0.1)
    found = scan.screen_pair(pair, bent, dented, scan.linear_none()[0])
    f = own.measurement.frequencies
    expected = exact_log_evidence(f, NOISE * f, SHIFTS["bent"], SHIFTS["dented"])
    # two shifts of 3 % multiply: 1e-3 of a frequency, half the noise
    assert found.marginal.log_evidence == pytest.approx(expected, abs=1.5)
    weight = np.exp(found.marginal.log_weight)
    mean = weight @ found.marginal.draws[:, list(found.columns)]
    np.testing.assert_allclose(mean, sizes, atol=0.004)


def test_a_pair_with_a_cause_of_either_sign_has_both_its_peaks() -> None:
    warp = cause("warp", whole_normal(0.1), is_even=True)
    f = F0 * (1.0 + A @ [0.03, -0.04] + 0.15**2 * DENT + 0.02 * BUMP)
    own = case(a_list(f, NOISE), [(warp, even(DENT)), (BENT, straight(BUMP))])
    scan = begun(own)
    first, second = (screened(scan, hypothesis(effect, 0.1)) for effect in (warp, BENT))
    pair = paired(first.hypothesis, second.hypothesis, 0.1)
    found = scan.screen_pair(pair, first, second, scan.linear_none()[0]).marginal
    above = float(np.exp(found.log_weight) @ (found.draws[:, found.quadrature] > 0.0))
    assert above == pytest.approx(0.5, abs=0.02)
    size = float(np.exp(found.log_weight) @ np.abs(found.draws[:, found.quadrature]))
    assert size == pytest.approx(0.15, abs=0.02)


def test_pairs_are_ranked_by_their_exact_evidences() -> None:
    rng = np.random.default_rng(4)
    directions = 0.01 * rng.standard_normal((6, 8))
    slope, sigma = 0.02 * A, np.full(8, NOISE)
    residual = 0.8 * directions[1] - 1.1 * directions[4] + NOISE * SCATTER
    lists = Linear(residual, slope, sigma[None], np.zeros(1))
    tables = [GRID[:, None] * d for d in directions]
    prior = np.zeros((6, 6))
    found = ranked_pairs(lists, tables, prior, 15)
    exact = {
        (i, j): log_normal_density(
            residual,
            np.zeros(8),
            np.diag(sigma**2)
            + slope @ slope.T
            + np.outer(directions[i], directions[i])
            + np.outer(directions[j], directions[j]),
        )
        for i, j in combinations(range(6), 2)
    }
    assert found[0] == (1, 4)
    # all of a linear plate is Gaussian, so that Laplace's method is exact but for steps cut at half a cell
    assert found[:4] == sorted(exact, key=lambda k: -exact[k])[:4]


def test_what_cannot_go_together_is_not_ranked() -> None:
    lists = Linear(np.full(8, NOISE), 0.02 * A, np.full((1, 8), NOISE), np.zeros(1))
    tables = [0.01 * GRID[:, None] * d for d in (BUMP, DENT, BUMP + DENT)]
    prior = np.zeros((3, 3))
    prior[0, 1] = prior[1, 0] = -np.inf
    assert set(ranked_pairs(lists, tables, prior, 9)) == {(0, 2), (1, 2)}
    assert ranked_pairs(lists, tables[:1], np.zeros((1, 1)), 9) == []
