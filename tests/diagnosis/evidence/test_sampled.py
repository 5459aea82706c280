"""Importance sampling on models that are projected once more: the same answer from fewer vectors."""

from dataclasses import replace

import numpy as np
import pytest

from cpam_bayes.diagnosis.cases import hypotheses_of, plate_case
from cpam_bayes.diagnosis.evidence.marginal import Marginal
from cpam_bayes.diagnosis.evidence.sampled import sampled_marginal
from cpam_bayes.diagnosis.evidence.scan import marginal_of
from cpam_bayes.forward_model.reduced import ReducedModel
from cpam_bayes.inference.student_mixture import sobol_points
from tests.diagnosed import aluminium_case, listed

TOLERANCE = 2e-5


def largest(model: object) -> int:
    assert isinstance(model, ReducedModel)
    return max(block.size for block in model.fast.operator.blocks)


@pytest.fixture(scope="module")
def tapered() -> Marginal:
    """A plate whose list is that of a tapered one, nearly, under the hypothesis that it is."""
    plate = aluminium_case().models.specimen
    # bounds alone: a model has the more to be good for
    exact = plate_case(replace(plate, material=replace(plate.material, known=False)))
    exact = replace(exact, models=replace(exact.models, tolerances={}))
    case = listed(exact, np.array([1.004, 0.998, 1.002, 0.997, 1.003, 1.001]))
    hypothesis = next(h for h, _ in hypotheses_of([case]) if h.cause == "taper_x")
    return sampled_marginal(marginal_of([case], hypothesis, (0,)))


def test_a_model_about_a_posterior_has_fewer_vectors_and_its_frequencies(tapered: Marginal) -> None:
    comparison = tapered.comparison
    draws = np.random.default_rng(0).permutation(tapered.resampled(512))
    training, other = np.split(draws, [128])
    near = comparison.model.about(training, TOLERANCE, 0.95, least_size=0)
    before, after = (model.parts[0].changes[0].model for model in (comparison.model, near))
    assert largest(after) < 0.8 * largest(before)
    found, expected = (model.predict(other, jacobian=True) for model in (near, comparison.model))
    # Ritz values of a smaller space are not lower; a few points in the tails of the proposal are further off
    error = found.frequencies / expected.frequencies - 1.0
    assert error.min() > -1e-9
    assert np.quantile(error, 0.95) < 1.5 * TOLERANCE
    assert found.jacobian is not None
    assert expected.jacobian is not None
    apart = np.abs(found.jacobian - expected.jacobian) / np.abs(expected.jacobian).max(axis=(0, 1))
    # derivatives only direct the proposal; over the posterior of an even effect they change sign
    assert np.quantile(apart, 0.99) < 1e-2


def test_evidence_and_moments_are_those_of_the_whole_models(tapered: Marginal) -> None:
    comparison = tapered.comparison
    training = comparison.scores.to_x(sobol_points(tapered.proposal, 6)[0])
    near = replace(comparison, model=comparison.model.about(training, TOLERANCE, 0.95, least_size=0))
    found, expected = (sampled_marginal(replace(tapered, comparison=c)) for c in (near, comparison))
    # an error of 2e-5 is a hundredth of the noise
    assert found.log_evidence == pytest.approx(expected.log_evidence, abs=0.02)
    for ours, theirs, sd in zip(
        *(m.moments()[0] for m in (found, expected)), expected.moments()[1], strict=True
    ):
        assert ours == pytest.approx(theirs, abs=0.02 * sd)
