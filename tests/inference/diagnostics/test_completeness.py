"""A complete list that is none: what it lacks or holds too much is named, a clean list is left in peace."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from cpam_bayes.forward_model.model import reference_vector
from cpam_bayes.forward_model.reduced import ReducedModel
from cpam_bayes.forward_model.store import reduced_model
from cpam_bayes.inference.diagnostics.completeness import (
    AlternativePairing,
    TranscriptionError,
    alternative_pairing,
    transcription_error,
)
from cpam_bayes.inference.laplace import find_optima
from cpam_bayes.inference.posterior import plate_posterior
from cpam_bayes.plate import Measurement, Specimen, read_specimen
from tests.linear_model import LinearModel

LINEAR = LinearModel().predict(np.array([[0.4, -0.3]])).frequencies[0]


def doubt_of_linear(listed: np.ndarray, labels: tuple[str, ...] | None = None) -> AlternativePairing | None:
    data = Measurement(listed, 0.0, 0.005, None, labels or ("",) * len(listed), complete=True)
    posterior = plate_posterior(LinearModel(), replace(data, labels=("",) * len(listed)), np.zeros(4))
    marked = np.array([bool(label) for label in data.labels])
    best = find_optima(posterior, np.zeros((1, 2)))[0]
    return alternative_pairing(replace(posterior, labelled=marked), best.x, np.zeros((1, 2)))


@pytest.mark.parametrize("missing", [0, 1, 2])
def test_a_mode_that_is_not_in_the_list_is_named(missing: int) -> None:
    found = doubt_of_linear(np.delete(LINEAR, missing))
    assert found is not None
    assert (found.missed, found.spurious) == (missing, None)
    assert found.log_odds > 100.0
    # three exact frequencies and two constants: the slip's optimum is the truth
    np.testing.assert_allclose(found.x, [0.4, -0.3], atol=1e-3)


@pytest.mark.parametrize("extra", [150.0, 250.0])
def test_a_frequency_that_is_no_mode_is_named(extra: float) -> None:
    listed = np.sort(np.append(LINEAR[:3], extra))
    found = doubt_of_linear(listed)
    assert found is not None
    assert found.missed is None
    assert listed[found.spurious] == extra


def test_a_complete_list_is_in_no_doubt() -> None:
    assert doubt_of_linear(LINEAR[:3]) is None
    assert doubt_of_linear(LINEAR) is None


def test_labelled_frequencies_are_not_in_question() -> None:
    listed = np.delete(LINEAR, 1)
    assert doubt_of_linear(listed, ("(1,1)", "(2,0)", "(0,2)")) is None


@dataclass(frozen=True)
class Case:
    """A plate, a model of one mode more than its list has, and frequencies of its reference constants."""

    specimen: Specimen
    model: ReducedModel
    frequencies: np.ndarray


def case(name: str) -> Case:
    specimen = read_specimen(name)
    assert specimen.measurement is not None
    model = reduced_model(specimen, specimen.unknowns, specimen.measurement.size + 1)
    return Case(specimen, model, model.predict(reference_vector(specimen, model.parameters)).frequencies[0])


@pytest.fixture(scope="module")
def aluminium() -> Case:
    return case("A1")


def examined(own: Case, frequencies: np.ndarray, relative_std: float | None) -> TranscriptionError | None:
    data = Measurement(
        np.sort(np.round(frequencies)), 1.0, relative_std, None, ("",) * len(frequencies), True
    )
    posterior = plate_posterior(own.model, data, np.full(own.model.n_modes, 1e-4))
    start = reference_vector(own.specimen, own.model.parameters)
    start = start if relative_std is not None else np.append(start, 0.01)
    best = find_optima(posterior, start[None])[0]
    return transcription_error(own.specimen, posterior, own.model, best.x)


def noisy(own: Case, rng: np.random.Generator) -> np.ndarray:
    return np.asarray(own.frequencies * (1.0 + 0.005 * rng.standard_normal(own.model.n_modes)))


@pytest.mark.parametrize("relative_std", [0.005, None])
@pytest.mark.parametrize("missing", [0, 2, 4])
def test_the_mode_that_a_plate_list_lacks_is_named_by_its_label(
    aluminium: Case, missing: int, relative_std: float | None
) -> None:
    f = noisy(aluminium, np.random.default_rng(missing))
    found = examined(aluminium, np.delete(f, missing), relative_std)
    assert found is not None
    assert found.missed is not None
    modes = aluminium.model.full.modes(np.array([69e9, 0.33]))
    assert found.missed.label == modes[missing].label
    # noise of 0.5 % in six frequencies leaves the missed one to about that
    assert found.missed.frequency == pytest.approx(modes[missing].frequency, rel=0.03)


@pytest.mark.parametrize("relative_std", [0.005, None])
def test_a_false_peak_in_a_plate_list_is_named(aluminium: Case, relative_std: float | None) -> None:
    f = noisy(aluminium, np.random.default_rng(0))
    found = examined(aluminium, np.append(f[:6], 400.0), relative_std)
    assert found is not None
    assert found.spurious == 400.0


def false_warnings(own: Case, n: int) -> int:
    rng = np.random.default_rng(1)
    n_listed = own.model.n_modes - 1
    lists = [noisy(own, rng)[:n_listed] for _ in range(n)]
    return sum(examined(own, f, (0.005, None)[i % 2]) is not None for i, f in enumerate(lists))


@pytest.mark.slow
def test_of_fifty_noisy_complete_lists_at_most_one_is_put_in_doubt(aluminium: Case) -> None:
    assert false_warnings(aluminium, 50) <= 1


@pytest.mark.slow
def test_four_constants_and_six_frequencies_are_enough_to_miss_a_mode() -> None:
    own = case("C1")
    assert false_warnings(own, 6) == 0
    f = noisy(own, np.random.default_rng(0))
    found = examined(own, np.delete(f, 1), 0.005)
    assert found is not None
    assert found.missed is not None
    assert found.missed.label == "(0,2)"
