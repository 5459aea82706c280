"""Evidence by importance sampling against closed forms and quadrature."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from cpam_bayes.inference.ensemble import EnsembleSettings
from cpam_bayes.inference.posterior import Posterior, plate_posterior
from cpam_bayes.inference.proposal import AdaptationSettings
from cpam_bayes.inference.sampling import (
    Evidence,
    EvidenceSettings,
    evidence_of,
    importance_evidence,
    reweighted,
    sample_posterior,
)
from cpam_bayes.inference.swarm import SwarmSettings
from cpam_bayes.parameters import TruncatedNormal, Uniform
from cpam_bayes.plate import Measurement
from tests.linear_model import LinearModel, measurement
from tests.toy_models import (
    ToyModel,
    crossing,
    independent,
    integral,
    integral_over_noise,
    parameters,
    two_peaks,
)

SETTINGS = EvidenceSettings(draws=6000, adaptation=AdaptationSettings(draws=1000))


def sampled(own: Posterior, seed: int = 0, settings: EvidenceSettings = SETTINGS) -> Evidence:
    return importance_evidence(own, np.empty((0, own.parameters.size)), seed, settings=settings)


def agrees(found: Evidence, expected: float, near: float = 0.0) -> None:
    """Within four standard errors, and these are small."""
    assert found.status == "reliable"
    assert found.k_hat < 0.7
    assert found.standard_error < 0.05
    assert found.log_evidence == pytest.approx(expected, abs=4.0 * found.standard_error + near)


@pytest.mark.parametrize("off", [-1.0, -5.0, -20.0])
def test_evidence_and_moments_of_a_gaussian_cut_at_a_bound_are_the_closed_form(off: float) -> None:
    """The optimum sits on a bound, up to 20 standard deviations from where it would lie without."""
    found = sampled(independent((off, 5.0)))
    exact = norm.logsf(-off) + np.log(norm.cdf(5) - norm.cdf(-5)) + 2 * np.log(0.1)
    agrees(found, exact)
    assert found.effective_size > 0.3 * SETTINGS.draws
    ratio = np.exp(norm.logpdf(off) - norm.logsf(-off))
    mean, sd = 0.1 * (ratio + off), 0.1 * np.sqrt(1.0 - off * ratio - ratio**2)
    near = 4.0 / np.sqrt(found.effective_size)
    assert found.mean[0] == pytest.approx(mean, abs=near * sd)
    # the sd of an sd is below one over the root of the number of draws, that of an exponential twice that
    assert found.sd[0] == pytest.approx(sd, abs=(1.0 if off == -1.0 else 2.0) * near * sd)
    weights = np.exp(found.log_weights)
    assert weights.sum() == pytest.approx(1.0)
    assert found.draws[:, 0] @ weights == pytest.approx(found.mean[0])
    assert np.all((found.draws >= 0.0) & (found.draws <= 1.0))


WIDE = np.linspace(-2.0, 2.0, 801)


def known(case: str) -> tuple[Posterior, float, float]:
    """A posterior, its log evidence, and how near a quadrature comes to that."""
    if case == "Student-t noise, a normal prior without bounds":
        model = LinearModel(parameters(a=Uniform(-2.0, 2.0), b=TruncatedNormal(-0.2, 0.1, -np.inf, np.inf)))
        own = plate_posterior(model, measurement(0.02), np.zeros(4), degrees_of_freedom=4.0)
        return own, integral(own, (WIDE, np.linspace(-0.9, 0.5, 281))), 1e-3
    if case == "a missing mode":
        kept = measurement(None).frequencies[[0, 1, 3]]
        gaps = Measurement(kept, 0.0, 0.01, None, ("",) * 3, complete=False)
        own = plate_posterior(LinearModel(), gaps, np.zeros(4))
        # the density jumps where a mode leaves the list's range: the grid's step over the peaks' width
        return own, integral(own, (WIDE, WIDE)), 0.01
    if case == "kinks of crossing modes":
        return crossing(), integral(crossing(), (np.linspace(-1.0, 1.0, 1001),) * 2), 5e-3
    if case == "inferred noise":
        own = plate_posterior(LinearModel(), measurement(None), np.zeros(4))
        # noise below 1e-4, left out by the quadrature, has a chance below 1e-6; its steps leave 1e-3
        return own, integral_over_noise(own), 2e-3
    own = independent((5.0, 5.0))  # constraints cut without being normalised again
    half = replace(own, model=replace(own.model, allowed=lambda x: x[:, 0] > x[:, 1]))
    return half, 2 * np.log(0.1 * (norm.cdf(5) - norm.cdf(-5))) + np.log(0.5), 0.0


@pytest.mark.parametrize(
    "case",
    [
        "Student-t noise, a normal prior without bounds",
        "a missing mode",
        "kinks of crossing modes",
        "inferred noise",
        "constraints",
    ],
)
def test_evidence_is_that_of_a_quadrature(case: str) -> None:
    own, expected, near = known(case)
    found = sampled(own)
    assert np.all((found.draws >= own.parameters.lower) & (found.draws <= own.parameters.upper))
    agrees(found, expected, near)


def test_errors_are_those_of_repeated_estimates() -> None:
    own = independent((-1.0, 5.0))
    found = [sampled(own, seed) for seed in range(12)]
    spread = np.std([f.log_evidence for f in found], ddof=1)
    claimed = np.mean([f.standard_error for f in found])
    # chi of 11 degrees of freedom: 0.45 to 1.7 hold it but for 1 in 1000
    assert 0.45 < spread / claimed < 1.7


def test_the_same_seed_gives_the_same_answer_and_another_another() -> None:
    own = two_peaks()
    few = EvidenceSettings(draws=500, adaptation=AdaptationSettings(rounds=2, draws=300))
    one, again, other = (sampled(own, seed, few) for seed in (3, 3, 4))
    assert one.log_evidence == again.log_evidence
    np.testing.assert_array_equal(one.draws, again.draws)
    assert one.log_evidence != other.log_evidence


def test_evidence_of_chains_counts_both_peaks_also_where_they_miss_one() -> None:
    own = two_peaks()
    ensembles = EnsembleSettings(walkers=16, round_steps=100, most_steps=100)
    result = sample_posterior(
        own, 0, settings=ensembles, swarm_settings=SwarmSettings(particles=10, iterations=20)
    )
    right = np.abs(result.chain[..., :1]) * np.array([1.0, 0.0]) + result.chain * np.array([0.0, 1.0])
    expected = integral(own, (WIDE, WIDE))
    for chain in (result.chain, right):
        found = evidence_of(own, replace(result, chain=chain), 0, settings=SETTINGS)
        agrees(found, expected, near=1e-3)
        left = np.exp(found.log_weights)[found.draws[:, 0] < 0].sum()
        assert left == pytest.approx(0.5, abs=4.0 * 0.5 / np.sqrt(found.effective_size))


def test_an_evidence_on_a_narrow_basis_is_that_on_the_whole_one_once_draws_are_reweighted() -> None:
    whole, narrow = (
        plate_posterior(LinearModel(), measurement(noise), np.zeros(4)) for noise in (0.02, 0.022)
    )
    ensembles = EnsembleSettings(walkers=16, round_steps=200, most_steps=400)
    chains = sample_posterior(narrow, 0, settings=ensembles, swarm_settings=SwarmSettings(10, 20))
    found, expected = sampled(narrow), sampled(whole)
    assert abs(found.log_evidence - expected.log_evidence) > 0.1
    weighed = reweighted(found, whole, narrow, chains, 0)
    # of a thousand draws whose weights scatter by a few per cent
    assert weighed.log_evidence == pytest.approx(expected.log_evidence, abs=0.02)
    assert 0.8 < weighed.exact_fraction < 0.999
    assert found.standard_error < weighed.standard_error < 0.02
    assert reweighted(found, narrow, narrow, chains, 0) is found


def test_a_proposal_that_cannot_follow_is_not_called_reliable() -> None:
    """A comb of spikes: forty narrow optima, of which a few components find some."""
    own_parameters = parameters(a=Uniform(-2.0, 2.0), b=Uniform(-2.0, 2.0))

    def comb(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        a, b = x.T
        f = np.stack((100.0 + 30.0 * np.sin(40.0 * a), 200.0 + 30.0 * np.sin(40.0 * b)), axis=1)
        slope = np.zeros((len(x), 2, 2))
        slope[:, 0, 0], slope[:, 1, 1] = 1200.0 * np.cos(40.0 * a), 1200.0 * np.cos(40.0 * b)
        return f, slope

    data = Measurement(np.array([100.0, 200.0]), 0.0, None, np.full(2, 0.05), ("", ""), complete=True)
    own = plate_posterior(ToyModel(own_parameters, comb), data, np.zeros(2))
    once = EvidenceSettings(2000, AdaptationSettings(rounds=2, draws=500), attempts=1)
    assert sampled(own, settings=once).status == "unreliable"


def test_a_posterior_without_support_is_refused() -> None:
    own = independent((3.0,))
    none = replace(own, model=replace(own.model, allowed=lambda x: np.zeros(len(x), dtype=bool)))
    with pytest.raises(ValueError, match="outside the support of the prior"):
        sampled(none)
