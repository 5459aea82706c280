"""The constants of the extended model by emcee, against importance sampling and closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cpam_bayes.diagnosis.comparison import PlateCase, comparison_of
from cpam_bayes.diagnosis.evidence import weighing
from cpam_bayes.diagnosis.evidence.sampled import sampled_marginal
from cpam_bayes.diagnosis.evidence.weighing import marginal_of
from cpam_bayes.diagnosis.extension import (
    Resampled,
    compared_posterior,
    note_of,
    resample_members,
    start_positions,
)
from cpam_bayes.diagnosis.hypotheses import DISCREPANCY, NONE, OTHER, Hypothesis
from cpam_bayes.effects import ListChange
from cpam_bayes.effects.effect import MISREADING
from cpam_bayes.inference.derivatives import expand
from cpam_bayes.inference.ensemble import EnsembleSettings
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
    differences,
    even,
    hypothesis,
    straight,
    whole_normal,
)

BENT, DENTED = cause("bent", whole_normal(0.02)), cause("dented", whole_normal(0.02))
WARP = cause("warp", whole_normal(0.1), is_even=True)
ANYTHING = Hypothesis(OTHER, OTHER, parameters=(DISCREPANCY,), prior=0.06)
NOTHING = Hypothesis(NONE, NONE, prior=0.5)
# Short chains: a toy's posterior is crossed in a few steps.
FAST = EnsembleSettings(walkers=40, round_steps=100, effective=2000.0, most_steps=2000)


def plate(shift: Array, relative: float | None = NOISE) -> PlateCase:
    f = F0 * (1.0 + A @ [0.03, -0.04] + shift) * (1.0 + NOISE * SCATTER)
    effects = [(BENT, straight(BUMP)), (DENTED, straight(DENT)), (WARP, even(BUMP))]
    return case(a_list(f, relative), effects)


def made(of: Hypothesis, own: PlateCase) -> weighing.Tested:
    return weighing.Tested(of, (0,), sampled_marginal(marginal_of([own], of, (0,))))


def sampled(of: Hypothesis, own: PlateCase, seed: int = 0) -> tuple[Resampled, weighing.Tested]:
    t = made(of, own)
    return resample_members([(t, 1.0)], seed, FAST), t


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
    found, t = sampled(of, plate(0.012 * BUMP, relative))
    member = found.members[0]
    assert found.converged
    mean, sd = t.marginal.moments()
    weight = np.exp(t.marginal.log_weight)
    size = 1.0 / np.sum(weight**2)  # effective, of importance sampling
    if of.effects and of.effects[0].even:
        # two peaks of either sign: their square is what is known
        column = t.columns[0]
        squares = member.draws[:, column] ** 2
        np.testing.assert_allclose(squares.mean(), weight @ t.marginal.draws[:, column] ** 2, rtol=0.05)
        assert np.mean(member.draws[:, column] > 0.0) == pytest.approx(0.5, abs=0.05)
    # four standard errors of a mean and of a standard deviation; chains have 2000 effective samples
    error = np.sqrt(1.0 / size + 1.0 / 2000.0)
    np.testing.assert_array_less(np.abs(member.mean - mean) / sd, 4.0 * error)
    np.testing.assert_allclose(member.sd, sd, rtol=4.0 * error)


def test_a_linear_model_has_its_gaussian_posterior() -> None:
    own = plate(0.012 * BUMP)
    found, _ = sampled(hypothesis(BENT, 0.1), own)
    f = own.measurement.frequencies
    slope = np.column_stack((A, BUMP)) * F0[:, None] / (NOISE * f)[:, None]
    covariance = np.linalg.inv(slope.T @ slope + np.diag(1.0 / np.array([SD, SD, 0.02]) ** 2))
    mean = np.array([1.0, 1.0, 0.0]) + covariance @ slope.T @ ((f - F0) / (NOISE * f))
    sd = np.sqrt(np.diag(covariance))
    for i, name in enumerate(("E1", "G12")):
        # 2000 effective samples: 0.022 of a standard deviation, four times that; twice that for quantiles
        assert found.constants[name][0] == pytest.approx(mean[i], abs=0.09 * sd[i])
        assert found.constants[name][1] == pytest.approx(sd[i], rel=0.08)
        low, high = mean[i] - 1.96 * sd[i], mean[i] + 1.96 * sd[i]
        assert found.constants[name][2:] == pytest.approx((low, high), abs=0.2 * sd[i])


def test_the_posterior_is_likelihood_times_prior_of_the_comparison() -> None:
    for of, relative in ((hypothesis(BENT, 0.1), None), (ANYTHING, None), (ANYTHING, NOISE)):
        comparison = comparison_of([plate(0.01 * BUMP, relative)], of)
        posterior = compared_posterior(comparison)
        x = comparison.scores.to_x(
            0.5 * np.random.default_rng(0).standard_normal((4, len(comparison.parameters.names)))
        )
        expected = comparison.log_likelihood(x) + comparison.parameters.log_prior(x)
        np.testing.assert_allclose(posterior.log_prob(x), expected, rtol=1e-12)
        gradient = differences(lambda v, p=posterior: p.log_prob(v)[:, None], x[0], 1e-7)[0]
        found = expand(posterior, x[:1]).gradient[0]
        np.testing.assert_allclose(found, gradient, rtol=1e-3, atol=1e-3 * np.abs(gradient).max())


def test_starts_are_all_in_the_support_and_differ() -> None:
    t = made(hypothesis(WARP, 0.1), plate(0.01 * BUMP))
    posterior = compared_posterior(t.marginal.comparison)
    start = start_positions(t.marginal, posterior, 300, np.random.default_rng(0))
    assert np.isfinite(posterior.log_prob(start)).all()
    assert len(np.unique(start, axis=0)) == 300
    # both signs of an even effect
    assert 0.3 < np.mean(start[:, 2] > 0.0) < 0.7


def test_starts_keep_to_the_constraints() -> None:
    t = made(hypothesis(BENT, 0.1), plate(0.01 * BUMP))
    comparison = t.marginal.comparison
    inside = np.quantile(t.marginal.resampled(512)[:, 0], 0.5)
    part = comparison.model.parts[0]
    cut = replace(part, bare=replace(part.bare, allowed=lambda x: x[:, 0] < inside))  # type: ignore[type-var]
    half = replace(comparison, model=replace(comparison.model, parts=(cut,)))
    marginal = sampled_marginal(replace(t.marginal, comparison=half))
    start = start_positions(marginal, compared_posterior(half), 200, np.random.default_rng(0))
    assert start[:, 0].max() < inside


def test_members_are_averaged_by_their_shares() -> None:
    own = plate(0.02 * BUMP)
    first, second = (made(hypothesis(e, 0.1), own) for e in (BENT, DENTED))
    both = resample_members([(first, 0.75), (second, 0.25)], 0, FAST)
    assert [m.fraction for m in both.members] == [0.75, 0.25]
    means = np.array([m.mean[:2] for m in both.members])
    variances = np.array([m.sd[:2] ** 2 for m in both.members])
    mean = np.array([0.75, 0.25]) @ means
    sd = np.sqrt(np.array([0.75, 0.25]) @ (variances + (means - mean) ** 2))
    for i, name in enumerate(("E1", "G12")):
        assert both.constants[name][:2] == pytest.approx((mean[i], sd[i]), rel=1e-12)
    # the even thinning of the chains that quantiles are read from
    assert len(both.draws) == 4000
    np.testing.assert_allclose(both.draws.mean(axis=0), mean, atol=0.05 * sd.max())


def test_members_with_little_of_the_claim_are_left_out() -> None:
    own = plate(0.02 * BUMP)
    of = [made(hypothesis(e, 0.1), own) for e in (BENT, DENTED, WARP)]
    shares = [0.6, 0.36, 0.04]
    found = resample_members(list(zip(of, shares, strict=True)), 0, replace(FAST, effective=200.0))
    assert [m.tested.hypothesis.cause for m in found.members] == ["bent", "dented"]
    assert sum(m.fraction for m in found.members) == pytest.approx(1.0)
    assert found.not_sampled == pytest.approx(0.04)


def test_the_same_seed_gives_the_same_chains() -> None:
    own = plate(0.012 * BUMP)
    first, second, other = (sampled(hypothesis(BENT, 0.1), own, seed)[0] for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.draws, second.draws)
    assert not np.array_equal(first.draws, other.draws)


def test_what_is_no_parameter_of_the_plate_is_said() -> None:
    own = plate(np.zeros(8))
    false = Hypothesis("mode_identity", "list", listed=ListChange(spurious=2))
    missed = Hypothesis("mode_identity", "list", listed=ListChange(missed=(1, 4)))
    slipped = Hypothesis("outlier", "list", listed=ListChange(misread=5), parameters=(MISREADING,))
    short = case(a_list(own.measurement.frequencies[:6], NOISE))
    assert note_of(made(false, own)) == "frequency 3 is taken as false and left out"
    assert "mode 2 and 5" in note_of(made(missed, short))
    assert "frequency 6 is taken as misread" in note_of(made(slipped, own))
    assert "scatter of all modes" in note_of(made(ANYTHING, own))
    assert note_of(made(hypothesis(BENT, 0.1), own)) == ""
