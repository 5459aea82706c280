"""Probabilities with other priors and constants over all hypotheses: against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import norm

from cpam_bayes.diagnosis.answers.optima import (
    FACTORS,
    averaged_constants,
    prior_sensitivity,
    reweighed,
    weighted_quantiles,
)
from cpam_bayes.diagnosis.comparison import REPEATABILITY_PRIOR
from cpam_bayes.diagnosis.evidence import weighing
from cpam_bayes.diagnosis.hypotheses import NONE, OTHER, Claim, Hypothesis, claim_of
from tests.diagnosis.toy_plates import (
    BUMP,
    F0,
    NOISE,
    SCATTER,
    A,
    Array,
    a_list,
    case,
    cause,
    exact_log_evidence,
    hypothesis,
    straight,
    whole_normal,
)

NOTHING = Hypothesis(NONE, NONE, prior=0.5)
BENT = cause("bent", whole_normal(0.02))


def weighed(f: Array, relative: float | None = NOISE) -> weighing.Weighed:
    own = case(a_list(f, relative), [(BENT, straight(BUMP))])
    return weighing.weigh([own], [(NOTHING, (0,)), (hypothesis(BENT, 0.1), (0,))], pairs=False)


@pytest.mark.parametrize("factor", FACTORS)
@pytest.mark.parametrize("size", [0.0, 0.006, 0.02])
def test_probabilities_are_those_of_the_other_prior(size: float, factor: float) -> None:
    f = F0 * (1.0 + A @ [0.03, -0.04] + size * BUMP) * (1.0 + NOISE * SCATTER)
    found = weighed(f)
    other = reweighed(found, factor)
    plain = exact_log_evidence(f, NOISE * f)
    expected = exact_log_evidence(f, NOISE * f, (BUMP, factor * 0.02)) - plain
    exact = exact_log_evidence(f, NOISE * f, (BUMP, 0.02)) - plain
    bent = other.best_of("bent")
    # the approximation of the evidence itself is not what is tested
    missed = found.best_of("bent").log_bayes_factor - exact
    assert bent.log_bayes_factor - missed == pytest.approx(expected, abs=0.08)
    odds = 0.2 * np.exp(bent.log_bayes_factor)
    assert bent.probability == pytest.approx(odds / (1.0 + odds), rel=1e-9)
    assert sum(t.probability for t in other.tested) == pytest.approx(1.0)


@pytest.mark.parametrize("factor", FACTORS)
def test_the_prior_of_an_inferred_repeatability_is_scaled_too(factor: float) -> None:
    f = F0 * (1.0 + A @ [0.03, -0.04]) * (1.0 + NOISE * SCATTER)
    found = weighed(f, None)
    a = np.geomspace(1e-5, 0.3, 2001)

    def over(factor: float, *directions: tuple[Array, float]) -> float:
        each = np.array([exact_log_evidence(f, s * f, *directions) for s in a])
        density = np.exp(each + REPEATABILITY_PRIOR.rescaled(factor).log_density(a))
        return float(np.log(np.trapezoid(density, a)))

    other = reweighed(found, factor)
    expected = over(factor, (BUMP, factor * 0.02)) - over(factor)
    missed = found.best_of("bent").log_bayes_factor - (over(1.0, (BUMP, 0.02)) - over(1.0))
    assert other.best_of("bent").log_bayes_factor - missed == pytest.approx(expected, abs=0.1)


def test_a_claim_stands_if_it_is_the_same_with_all_scales() -> None:
    def claim(w: weighing.Weighed) -> Claim:
        probability = {**w.by_cause(), OTHER: 0.0}
        factors = {c: w.log_bayes_factor((c,)) for c in w.by_cause()} | {OTHER: -np.inf}
        return claim_of(probability, factors, {})

    for size, stands in ((0.0, True), (0.03, True), (0.006, False)):
        found = weighed(F0 * (1.0 + A @ [0.03, -0.04] + size * BUMP) * (1.0 + NOISE * SCATTER))
        sensitivity = prior_sensitivity(found, claim(found), claim)
        assert sensitivity.claim_stands is stands
        assert len(sensitivity.claims) == len(sensitivity.probabilities) == len(FACTORS)
        assert all(sum(p.values()) == pytest.approx(1.0) for p in sensitivity.probabilities)


# Constants over all hypotheses: the mixture of their posteriors


def test_constants_are_those_of_the_mixture_of_all_hypotheses() -> None:
    """Two normal posteriors, 0.7 and 0.3, and one that is negligible, far away."""
    bent = cause("bent", whole_normal(0.02))
    own = case(a_list(F0, NOISE), [(bent, straight(np.ones(8)))])
    p = (np.arange(20000) + 0.5) / 20000
    tested = []
    for of, probability, mean, sd in (
        (Hypothesis(NONE, NONE, prior=0.5), 0.7, 1.0, 0.01),
        (hypothesis(bent, 0.1), 0.3, 1.1, 0.03),
        (hypothesis(bent, 0.1), 1e-7, 9.0, 0.1),
    ):
        marginal = weighing.marginal_of([own], of, (0,))
        draws = np.tile(norm.ppf(p, mean, sd)[:, None], (1, marginal.draws.shape[1]))
        marginal = replace(marginal, draws=draws, log_weight=np.full(len(p), -np.log(len(p))))
        tested.append(weighing.Tested(of, (0,), marginal, probability=probability))
    found = averaged_constants(weighing.Weighed(tuple(tested), ()))
    assert set(found) == {"E1", "G12"}

    def quantile(q: float) -> float:
        def excess(x: float) -> float:
            return float(0.7 * norm.cdf(x, 1.0, 0.01) + 0.3 * norm.cdf(x, 1.1, 0.03) - q)

        return float(brentq(excess, 0.5, 1.5))

    mean, sd, low, high = found["E1"]
    assert mean == pytest.approx(1.03, abs=1e-6)
    assert sd == pytest.approx(np.sqrt(0.7 * 0.01**2 + 0.3 * 0.03**2 + 0.21 * 0.1**2), rel=1e-3)
    assert low == pytest.approx(quantile(0.025), abs=1e-4)
    assert high == pytest.approx(quantile(0.975), abs=1e-4)


def test_quantiles_of_equal_weights_are_those_of_the_draws() -> None:
    x = np.array([3.0, 1.0, 2.0, 4.0])
    found = weighted_quantiles(x, np.full(4, 0.25), np.array([0.125, 0.5, 0.875]))
    np.testing.assert_allclose(found, [1.0, 2.5, 4.0])
