"""Predictive p-values: against the repeatability that is stated or believed, in closed form on toys."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2, kstest

from cpam_bayes.diagnosis.comparison import REPEATABILITY_PRIOR
from cpam_bayes.diagnosis.evidence import weighing
from cpam_bayes.diagnosis.fit import explains
from cpam_bayes.diagnosis.hypotheses import DISCREPANCY, NONE, OTHER, Hypothesis
from cpam_bayes.inference.log_density import LogDensity
from tests.diagnosis.toy_plates import (
    BUMP,
    F0,
    NOISE,
    SCATTER,
    SD,
    A,
    Array,
    a_list,
    case,
    cause,
    hypothesis,
    straight,
    whole_normal,
)

NOTHING = Hypothesis(NONE, NONE, prior=0.5)
BENT = cause("bent", whole_normal(0.02))


def weighed_list(f: Array, of: Hypothesis, relative: float | None) -> weighing.Tested:
    own = case(a_list(f, relative), [(BENT, straight(BUMP))])
    return weighing.Tested(of, (0,), weighing.marginal_of([own], of, (0,)))


def direct(f: Array, sigma: Array, *directions: tuple[Array, float]) -> float:
    """Of the linear plate with normal priors: ridge regression and its trace."""
    slope = np.column_stack([SD * A, *(sd * d for d, sd in directions)]) * F0[:, None] / sigma[:, None]
    hat = slope @ np.linalg.inv(slope.T @ slope + np.eye(slope.shape[1])) @ slope.T
    r = (f - F0) / sigma
    r = r - hat @ r
    return float(chi2.sf(r @ r, len(f) - np.trace(hat)))


@pytest.mark.parametrize("size", [0.0, 0.004, 0.01])
def test_a_stated_repeatability_gives_the_chi_square_of_the_residuals(size: float) -> None:
    f = F0 * (1.0 + A @ [0.03, -0.04] + size * BUMP) * (1.0 + NOISE * SCATTER)
    sigma = NOISE * f
    assert explains(weighed_list(f, NOTHING, NOISE)) == pytest.approx(direct(f, sigma), rel=1e-3)
    extended = explains(weighed_list(f, hypothesis(BENT, 0.1), NOISE))
    assert extended == pytest.approx(direct(f, sigma, (BUMP, 0.02)), rel=0.02)
    assert extended > 0.05


def test_an_inferred_repeatability_is_averaged_over_its_prior() -> None:
    f = F0 * (1.0 + A @ [0.03, -0.04] + 0.03 * BUMP)
    found = explains(weighed_list(f, NOTHING, None))
    # the tail near the end of the prior explains it best: many points
    p = (np.arange(8000) + 0.5) / 8000
    expected = np.mean([direct(f, a * f) for a in REPEATABILITY_PRIOR.ppf(p)])
    assert found == pytest.approx(expected, rel=0.03)


def test_a_misfit_of_many_times_any_repeatability_is_not_explained_by_noise() -> None:
    f = F0 * (1.0 + 0.45 * np.array([1.0, -1.0, 1.0, 1.0, -1.0, -1.0, 1.0, -1.0]))
    assert explains(weighed_list(f, NOTHING, None)) < 1e-6
    assert explains(weighed_list(f, NOTHING, NOISE)) < 1e-12
    # a scatter of all modes that nothing explains is part of that hypothesis
    other = Hypothesis(OTHER, OTHER, parameters=(DISCREPANCY,), prior=0.05)
    assert explains(weighed_list(f, other, NOISE)) > explains(weighed_list(f, NOTHING, NOISE))


def test_p_values_of_lists_by_the_model_itself_are_uniform() -> None:
    rng = np.random.default_rng(1)
    found = []
    for _ in range(200):
        constants = SD * rng.standard_normal(2)
        f = F0 * (1.0 + A @ constants) * (1.0 + NOISE * rng.standard_normal(8))
        found.append(explains(weighed_list(f, NOTHING, NOISE)))
    assert kstest(found, "uniform").pvalue > 0.01


def test_a_step_to_where_the_plate_buckles_is_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    f = F0 * (1.0 + A @ [0.03, -0.04]) * (1.0 + NOISE * SCATTER)
    tested = weighed_list(f, NOTHING, NOISE)
    whole = explains(tested)

    def buckled(self: LogDensity, x: Array) -> tuple[Array, Array, None]:
        return np.empty(0, dtype=int), np.empty((0, len(f))), None

    monkeypatch.setattr(LogDensity, "predict_inside", buckled)
    # the optimum itself is left, a step of Gauss and Newton from it changes nothing
    assert explains(tested) == pytest.approx(whole, rel=1e-3)
