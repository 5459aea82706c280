"""The posterior over stacking sequences, against brute force, and against an evidence known otherwise."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from cpam_bayes.cache import reduced_model
from cpam_bayes.inference.evidence import importance_evidence as known_evidence
from cpam_bayes.inference.normal_scores import normal_scores
from cpam_bayes.inference.sequence_evidence import fit_sequences, importance_evidence, sequence_posterior
from cpam_bayes.inference.sequence_surface import LearningSettings
from cpam_bayes.inference.sequences import (
    DEFAULT_SETTINGS,
    SequenceAnswer,
    SequenceSettings,
    sequence_probabilities,
)
from cpam_bayes.layup import parse_layup
from cpam_bayes.measurement import Measurement, Specimen, builtin
from cpam_bayes.model import angle_parameters, reference_vector
from cpam_bayes.parameters import Parameter, ParameterSet, ScaledStudentT, TruncatedNormal, Uniform
from cpam_bayes.posterior import Posterior, plate_posterior

TRUE = (30.0, -60.0)
QUICK = SequenceSettings(draws=50, listed=72, log2_points=7)


def specimen_with(layup: str, frequencies: np.ndarray, relative_std: float | None, step: float) -> Specimen:
    own = builtin("C1")
    plate = replace(own.plate, layup=parse_layup(layup), width=0.19)
    measurement = Measurement(frequencies, 0.0, relative_std, None, ("",) * len(frequencies), True)
    return replace(own, plate=plate, measurement=measurement, angle_grid_deg=step)


def listed(layup: str, angles: tuple[float, ...], relative_std: float | None, step: float = 15.0) -> Specimen:
    """A plate with unknown angles and the noise-free list that some angles give."""
    own = specimen_with(layup, np.arange(1.0, 7.0), relative_std, step)
    parameters = angle_parameters(own).union(own.unknowns)
    model = reduced_model(own, parameters, 6)
    x = np.concatenate((angles, reference_vector(own, own.unknowns)))
    return specimen_with(layup, model.full.predict(x).frequencies[0], relative_std, step)


@pytest.fixture(scope="module")
def specimen() -> Specimen:
    return listed("[(?/?)_2]_s", TRUE, 0.01)


@pytest.fixture(scope="module")
def answer(specimen: Specimen) -> SequenceAnswer:
    return sequence_probabilities(specimen, 0, settings=QUICK)


def distribution(answer: SequenceAnswer) -> dict[tuple[float, ...], float]:
    """Probability of every sequence that is listed, images included: mirror images alone here."""
    found = {}
    for angles, p in zip(answer.top, answer.probability, strict=True):
        found[tuple(angles)] = float(p)
        found[tuple(np.where(angles == 90.0, 90.0, -angles) + 0.0)] = float(p)
    return found


def test_probabilities_and_marginals_add_up(answer: SequenceAnswer) -> None:
    assert answer.enumerated == 12**2
    assert answer.classes is not None
    assert answer.unaccounted == 0.0
    np.testing.assert_allclose(answer.marginals.sum(axis=1), 1.0, rtol=1e-12)
    assert np.all(np.diff(answer.probability) <= 0.0)
    assert float(np.sum(answer.probability * answer.multiplicity)) <= 1.0 + 1e-12


def test_the_true_sequence_is_in_the_credible_set_of_a_clean_list(answer: SequenceAnswer) -> None:
    p = distribution(answer)
    more = sum(q for q in p.values() if q > p[TRUE] * (1 + 1e-9))
    assert more < 0.95
    assert p[TRUE] == p[(-30.0, 60.0)]


def test_marginals_are_those_of_the_sequences(answer: SequenceAnswer) -> None:
    whole = distribution(answer)
    left = 1.0 - sum(whole.values())
    for j in range(2):
        for i, angle in enumerate(answer.grid_deg):
            own = sum(p for s, p in whole.items() if s[j] == angle)
            assert own - 1e-9 <= answer.marginals[j, i] <= own + left + 1e-9


def known_layup(specimen: Specimen, angles: tuple[float, ...]) -> Posterior:
    plate = replace(specimen.plate, layup=specimen.plate.layup.with_angles(np.array(angles)))
    own = replace(specimen, plate=plate)
    assert own.measurement is not None
    model = reduced_model(own, own.unknowns, 6)
    return plate_posterior(model, own.measurement, np.full(6, 1e-4))


@pytest.mark.slow
@pytest.mark.parametrize("relative_std", [0.01, None])
def test_the_evidence_of_a_sequence_is_that_of_the_known_layup(relative_std: float | None) -> None:
    specimen = listed("[(?/?)_2]_s", TRUE, relative_std)
    assert specimen.measurement is not None
    model = reduced_model(specimen, angle_parameters(specimen).union(specimen.unknowns), 6)
    own = sequence_posterior(model, 2, specimen.measurement, np.full(6, 1e-4))
    start = np.concatenate((reference_vector(specimen, specimen.unknowns), [0.01] * (relative_std is None)))
    angles = np.array([TRUE, (45.0, 0.0)])
    fits = fit_sequences(own, angles, start[None])
    found = importance_evidence(own, angles, fits, 12)
    for i, row in enumerate(angles):
        posterior = known_layup(specimen, tuple(row))
        exact = known_evidence(posterior, start[None], 0)
        # two estimates with their own errors, and two reduced models that differ by 1e-4 of a frequency
        tolerance = 4 * np.hypot(exact.standard_error, found.error[i]) + 0.02
        assert found.log_evidence[i] == pytest.approx(exact.log_evidence, abs=tolerance)


@pytest.mark.slow
def test_the_learned_evidence_gives_the_distribution_of_brute_force() -> None:
    # noise that is inferred, so that the evidence is as smooth as a grid of 15 degrees can show
    specimen = listed("[(?/?)_2]_s", TRUE, None)
    learning = LearningSettings(first=50, each_round=20, most=130, log2_points=6)
    settings = replace(QUICK, exhaustive=0, learning=learning, polished=0, listed=144)
    learned = sequence_probabilities(specimen, 0, settings=settings)
    exact = sequence_probabilities(specimen, 0, settings=QUICK)
    assert learned.check is not None
    assert exact.check is None
    p, q = distribution(exact), distribution(learned)
    distance = 0.5 * sum(abs(p.get(s, 0.0) - q.get(s, 0.0)) for s in set(p) | set(q))
    # the lists are computed on either side; what is learned is the probability of the rest
    assert distance <= 0.01 + 0.5 * learned.unaccounted
    np.testing.assert_allclose(learned.marginals, exact.marginals, atol=0.05)
    assert learned.unaccounted <= DEFAULT_SETTINGS.unaccounted


def test_the_answer_is_the_same_bit_for_bit_again(specimen: Specimen, answer: SequenceAnswer) -> None:
    again = sequence_probabilities(specimen, 0, settings=QUICK)
    np.testing.assert_array_equal(again.probability, answer.probability)
    np.testing.assert_array_equal(again.drawn.conditionals.draws, answer.drawn.conditionals.draws)


def test_a_known_layup_is_refused() -> None:
    with pytest.raises(ValueError, match="no unknown angle"):
        sequence_probabilities(builtin("C1"), 0)


def scores_of(*priors: Uniform | TruncatedNormal | ScaledStudentT) -> Posterior:
    parameters = ParameterSet(tuple(Parameter(f"p{i}", "", prior) for i, prior in enumerate(priors)))

    class Own:
        pass

    own = Own()
    own.parameters = parameters  # type: ignore[attr-defined]
    return own  # type: ignore[return-value]


def test_normal_scores_make_priors_standard_normal() -> None:
    priors = (Uniform(2.0, 5.0), TruncatedNormal(1.0, 0.5, 0.2, 1.4))
    posterior = scores_of(*priors)
    axes = normal_scores(posterior)
    z = np.array(list(product((-2.0, 0.0, 0.7, 2.5), repeat=2)))
    x = axes.to_x(z)
    np.testing.assert_allclose(axes.to_z(x), z, atol=1e-9)
    log_prior = posterior.parameters.log_prior(x) + np.log(axes.slope(x, z)).sum(axis=1)
    expected = -0.5 * np.sum(z**2, axis=1) - np.log(2 * np.pi)
    np.testing.assert_allclose(log_prior, expected, atol=1e-9)
    h = 1e-6
    np.testing.assert_allclose((axes.to_x(z + h) - axes.to_x(z - h)) / (2 * h), axes.slope(x, z), rtol=1e-6)
