"""Bases for one sequence against the whole model, and the starts of its optimisation."""

from functools import cache

import numpy as np
import pytest

from cpam_bayes.forward_model.model import training_sets
from cpam_bayes.stacking import posterior as stacking_mixture
from cpam_bayes.stacking.evaluation import of_sequence, scan_library, scanned_starts
from cpam_bayes.stacking.posterior import MixtureSettings, sample_mixture
from tests.stacking.cases import TRUE, answer

ANGLES = np.array([TRUE, (60.0, 0.0)])


@pytest.mark.parametrize(("noise", "error"), [(0.1, 2e-4), (0.005, 1e-4), (0.001, 2e-5), (1e-5, 2e-5)])
def test_a_basis_for_one_sequence_is_good_for_all_constants(noise: float, error: float) -> None:
    whole = answer().conditional
    small = of_sequence(whole, ANGLES[0], noise)
    sets = training_sets(whole.model.full.operator.problem, 300, np.random.default_rng(1))
    sets[:, : whole.n_angles] = TRUE
    off = small.model.predict(sets).frequencies / whole.model.predict(sets).frequencies - 1.0
    assert off.min() > -1e-9, "projection makes no frequency lower"
    assert np.quantile(off, 0.97) < error
    assert off.max() < 3e-4, "in a corner of the box that no set came near"


def test_a_basis_for_one_sequence_is_less_than_half_of_that_for_all() -> None:
    whole = answer().conditional
    small = of_sequence(whole, ANGLES[0], 0.01)
    sizes = [max(block.size for block in c.model.fast.operator.blocks) for c in (whole, small)]
    assert sizes[1] < 0.5 * sizes[0]


@pytest.mark.slow
def test_moments_by_emcee_on_the_basis_of_a_sequence_are_those_on_the_whole_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    own, one = answer(), MixtureSettings(max_classes=1)
    small = sample_mixture(own, 0, settings=one).components[0]
    monkeypatch.setattr(stacking_mixture, "of_sequence", lambda conditional, angles, noise: conditional)
    whole = sample_mixture(own, 0, settings=one).components[0]
    # a fiftieth of the noise of a frequency is nothing beside the errors of sampling
    for a, b in ((small.chains, whole.chains), (small.importance, whole.importance)):
        moved = (a.mean - b.mean) / np.hypot(a.mean_error, b.mean_error)
        assert np.abs(moved).max() < 4.0
    assert abs(small.log_evidence - whole.log_evidence) < 4.0 * np.hypot(
        small.log_evidence_error, whole.log_evidence_error
    )


@cache
def library() -> np.ndarray:
    return scan_library(answer().conditional, 40, np.random.default_rng(0))


def test_a_library_is_within_the_prior() -> None:
    own = answer().conditional
    assert library().shape == (40, own.template.model.parameters.size)
    assert np.all(np.isfinite(own.template.log_prior(library())))


def test_starts_are_within_the_bounds_and_ordered_by_misfit() -> None:
    own = answer().conditional
    starts = scanned_starts(own, ANGLES, library(), 5)
    assert starts.shape == (2, 5, own.parameters.size)
    assert np.all((starts >= own.parameters.lower) & (starts <= own.parameters.upper))
    measured = own.template.measurement.frequencies
    for angles, row in zip(ANGLES, starts, strict=True):
        found = own.at(np.repeat(angles[None], len(row), axis=0)).predict(row)[:, : len(measured)]
        misfit = np.sqrt(np.mean(np.log(measured / found) ** 2, axis=1))
        assert np.all(np.diff(misfit) >= -1e-12)


def test_a_member_counts_with_the_factor_on_its_stiffnesses_that_suits_the_list() -> None:
    own = answer().conditional
    n = own.template.model.parameters.size
    truth = answer().components.fits.x[0, :n]
    angles = answer().top[:1]
    moduli = np.array([name[0] in "EG" for name in own.template.model.parameters.names])
    scaled = np.where(moduli, 0.9 * truth, truth)
    start = scanned_starts(own, angles, scaled[None], 1)[0, 0, :n]
    # all stiffnesses together set the level of all frequencies: the factor brings back the optimum,
    # whose own residuals have a mean of less than the noise of 1 %, 2 % of a stiffness
    np.testing.assert_allclose(start, truth, rtol=0.02)
