"""Constants over all hypotheses: the mixture of their posteriors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import norm

from cpam_bayes.diagnosis.answers.optima import averaged_constants, weighted_quantiles
from cpam_bayes.diagnosis.evidence import weighing
from cpam_bayes.diagnosis.hypotheses import NONE, Hypothesis
from tests.diagnosis.toy_plates import F0, NOISE, a_list, case, cause, hypothesis, straight, whole_normal


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
