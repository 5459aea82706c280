"""Importance sampling of a hypothesis against emcee on the same density, and against a closed form."""

import emcee
import numpy as np
import pytest

from cpam_bayes.diagnosis.comparison import PlateCase
from cpam_bayes.diagnosis.evidence import weighing
from cpam_bayes.diagnosis.evidence.sampled import sampled_marginal
from cpam_bayes.diagnosis.evidence.weighing import marginal_of
from cpam_bayes.diagnosis.hypotheses import DISCREPANCY, OTHER, Hypothesis
from tests.diagnosis.toy_plates import (
    BUMP,
    DENT,
    F0,
    NOISE,
    SCATTER,
    SD,
    A,
    Array,
    a_list,
    case,
    cause,
    even,
    hypothesis,
    straight,
    whole_normal,
)

BENT, DENTED = cause("bent", whole_normal(0.02)), cause("dented", whole_normal(0.02))
WARP = cause("warp", whole_normal(0.1), is_even=True)
ANYTHING = Hypothesis(OTHER, OTHER, parameters=(DISCREPANCY,), prior=0.06, correlation_length=0.0)
WALKERS = 40


def plate(shift: Array, relative: float | None = NOISE) -> PlateCase:
    f = F0 * (1.0 + A @ [0.03, -0.04] + shift) * (1.0 + NOISE * SCATTER)
    effects = [(BENT, straight(BUMP)), (DENTED, straight(DENT)), (WARP, even(BUMP))]
    return case(a_list(f, relative), effects)


def made(of: Hypothesis, own: PlateCase) -> weighing.Tested:
    return weighing.Tested(of, (0,), sampled_marginal(marginal_of([own], of, (0,))))


@pytest.mark.parametrize(
    ("of", "relative"),
    [
        (hypothesis(BENT, 0.1), NOISE),
        (hypothesis(BENT, 0.1), None),
        (hypothesis(WARP, 0.1), NOISE),
        (ANYTHING, NOISE),
        (ANYTHING, None),
    ],
    ids=["given noise", "inferred noise", "even", "discrepancy", "discrepancy and inferred noise"],
)
def test_emcee_and_importance_sampling_agree(of: Hypothesis, relative: float | None) -> None:
    t = made(of, plate(0.012 * BUMP, relative))
    comparison = t.marginal.comparison
    rng = np.random.default_rng(0)
    start = comparison.scores.to_z(rng.permutation(t.marginal.resampled(WALKERS)))
    start += 0.1 * rng.standard_normal(start.shape)
    sampler = emcee.EnsembleSampler(*start.shape, comparison.log_density, vectorize=True)
    sampler.random_state = np.random.RandomState(0).get_state()
    sampler.run_mcmc(start, 1500)
    draws = comparison.scores.to_x(sampler.get_chain(discard=300, flat=True))
    mean, sd = t.marginal.moments()
    weight = np.exp(t.marginal.log_weight)
    size = 1.0 / np.sum(weight**2)  # effective, of importance sampling
    if of.effects and of.effects[0].even:
        # two peaks of either sign: their square is what is known
        column = t.columns[0]
        squares = draws[:, column] ** 2
        np.testing.assert_allclose(squares.mean(), weight @ t.marginal.draws[:, column] ** 2, rtol=0.05)
        # walkers do not cross from one sign to the other, importance sampling has both
        assert weight @ (t.marginal.draws[:, column] > 0.0) == pytest.approx(0.5, abs=0.05)
    # four standard errors of a mean and of a standard deviation; chains have at least 1000 effective samples
    error = np.sqrt(1.0 / size + 1.0 / 1000.0)
    np.testing.assert_array_less(np.abs(draws.mean(axis=0) - mean) / sd, 4.0 * error)
    np.testing.assert_allclose(draws.std(axis=0), sd, rtol=4.0 * error)


def test_a_linear_model_has_its_gaussian_posterior() -> None:
    own = plate(0.012 * BUMP)
    found = made(hypothesis(BENT, 0.1), own).marginal
    f = own.measurement.frequencies
    slope = np.column_stack((A, BUMP)) * F0[:, None] / (NOISE * f)[:, None]
    covariance = np.linalg.inv(slope.T @ slope + np.diag(1.0 / np.array([SD, SD, 0.02]) ** 2))
    expected = np.array([1.0, 1.0, 0.0]) + covariance @ slope.T @ ((f - F0) / (NOISE * f))
    mean, sd = found.moments()
    # four standard errors of the effective draws
    error = 4.0 / np.sqrt(found.effective_size)
    np.testing.assert_array_less(np.abs(mean - expected) / np.sqrt(np.diag(covariance)), error)
    np.testing.assert_allclose(sd, np.sqrt(np.diag(covariance)), rtol=error)
