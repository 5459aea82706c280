"""Small bases: what is computed on them is what the whole model says."""

import numpy as np
import pytest

from cpam_bayes.forward_model.model import training_sets
from cpam_bayes.stacking import mixture as stacking_mixture
from cpam_bayes.stacking.conditional.bases import of_sequence
from cpam_bayes.stacking.mixture import MixtureSettings, sample_mixture
from tests.stacking.cases import answer

ANGLES = np.array([30.0, -60.0])


@pytest.mark.parametrize(("noise", "error"), [(0.1, 2e-4), (0.005, 1e-4), (0.001, 2e-5), (1e-5, 2e-5)])
def test_a_basis_for_one_sequence_is_good_for_all_constants(noise: float, error: float) -> None:
    whole = answer().conditional
    small = of_sequence(whole, ANGLES, noise)
    sets = training_sets(whole.model.full.operator.problem, 300, np.random.default_rng(1))
    sets[:, : whole.n_angles] = ANGLES
    off = small.model.predict(sets).frequencies / whole.model.predict(sets).frequencies - 1.0
    assert off.min() > -1e-9, "projection makes no frequency lower"
    assert np.quantile(off, 0.97) < error
    assert off.max() < 3e-4, "in a corner of the box that no set came near"


def test_a_basis_for_one_sequence_is_less_than_half_of_that_for_all() -> None:
    whole = answer().conditional
    small = of_sequence(whole, ANGLES, 0.01)
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
