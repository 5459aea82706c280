"""The noise study: its tasks against closed forms, and all of it on an aluminium plate."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from cpam_bayes.inference.ensemble import EnsembleSettings
from cpam_bayes.inference.swarm import SwarmResult, SwarmSettings, minimise
from cpam_bayes.parallel import open_executor
from cpam_bayes.plate import Material, Specimen, read_specimen
from cpam_bayes.printed import noise_study as study_module
from cpam_bayes.printed import repetition as noise_tasks
from cpam_bayes.printed.noise_study import Sensitivity, model_list, noise_study
from cpam_bayes.printed.repetition import INTERPRETATIONS, POSTERIOR, Interpretation, Shared, perturbation_sd
from tests.linear_model import MEAN_HZ, SLOPE_HZ, LinearModel, measurement

# the parameters are not its constants
FREE = Material("isotropic", {"E1": 70e9, "nu12": 0.3}, {}, None)
EXACT = MEAN_HZ + SLOPE_HZ @ np.array([0.4, -0.3])


@pytest.fixture
def shared() -> Shared:
    problem = noise_tasks.InverseProblem(LinearModel(), LinearModel().parameters, FREE, SwarmSettings())
    exact = replace(measurement(None), frequencies=EXACT)
    chains = EnsembleSettings(walkers=16, round_steps=500, effective=1000.0)
    return Shared(problem, exact, np.array([0.4, -0.3]), chains, seed=5)


def inversion(shared: Shared, level: float, reading: Interpretation, group: int) -> noise_tasks.Inversion:
    return noise_tasks.run_task(shared, noise_tasks.InversionTask(level, reading, group))


def posterior(shared: Shared, level: float, reading: Interpretation) -> noise_tasks.PosteriorSummary:
    return noise_tasks.run_task(shared, noise_tasks.InversionTask(level, reading, POSTERIOR))


@pytest.mark.parametrize("reading", INTERPRETATIONS)
def test_an_inversion_finds_the_least_squares_solution_of_its_noisy_list(shared: Shared, reading) -> None:
    for group in range(3):
        found = inversion(shared, 0.01, reading, group)
        exact = np.linalg.lstsq(SLOPE_HZ, found.frequencies - MEAN_HZ, rcond=None)[0]
        np.testing.assert_allclose(found.constants, exact, atol=4e-3)  # swarms agree to 1e-3 of a width 4
        assert found.converged
        assert not found.on_bound.any()


def test_an_inversion_that_noise_drives_out_of_the_box_ends_on_its_bound(shared: Shared) -> None:
    beyond = replace(shared, measurement=replace(shared.measurement, frequencies=EXACT + 60 * SLOPE_HZ[:, 0]))
    found = inversion(beyond, 1e-4, "relative", 0)
    np.testing.assert_array_equal(found.on_bound, [True, True])
    assert found.constants[0] == pytest.approx(2.0, abs=4e-3)


def elsewhere(times: int) -> Callable[..., SwarmResult]:
    """A swarm that first ends at (-1, 1) this many times, and then searches."""
    left, wrong = iter(range(times)), np.array([-1.0, 1.0])

    def search(objective, *args, **kwargs) -> SwarmResult:
        found, misses = minimise(objective, *args, **kwargs), next(left, None) is not None
        return replace(found, best=wrong, value=float(objective(wrong[None])[0])) if misses else found

    return search


def test_a_swarm_that_misses_the_minimum_by_more_than_it_leaves_is_started_anew(shared, monkeypatch) -> None:
    straight = inversion(shared, 0.01, "rms", 0)
    assert (straight.swarms, straight.missed) == (1, False)
    monkeypatch.setattr(noise_tasks, "minimise", elsewhere(2))
    found = inversion(shared, 0.01, "rms", 0)
    assert (found.swarms, found.missed) == (3, False)
    np.testing.assert_array_equal(found.frequencies, straight.frequencies)
    np.testing.assert_allclose(found.constants, straight.constants, atol=8e-3)
    assert found.solves > 2 * straight.solves
    monkeypatch.setattr(noise_tasks, "minimise", elsewhere(99))
    found = inversion(shared, 0.01, "rms", 0)
    assert (found.swarms, found.missed) == (5, True), "a minimum that no swarm finds"
    f = np.array([300.0, 400.0])  # norm 500 Hz, so sqrt(F) may differ by 0.25 Hz
    for value, other in ((0.06, 0.0), (100.0, 100.0), (1.0, 100.0)):
        assert noise_tasks.equally_good(value, other, f)
    assert not noise_tasks.equally_good(0.07, 0.0, f)
    assert not noise_tasks.equally_good(105.1, 100.0, f)


def test_the_reference_is_the_best_of_ten_swarms(shared: Shared, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[int] = []

    def value(shared: object, seed: int) -> float:
        seen.append(seed)
        return {1: 1e6, 4: 1e6, 6: 24.99}.get(len(seen), 25.0)

    monkeypatch.setattr(study_module, "swarm_value", value)
    assert study_module._best_start(shared.problem, EXACT, 5, None) == (seen[5], 8)
    assert (seen[0], len(set(seen))) == (5, 10)


def test_groups_levels_and_readings_have_noise_of_their_own(shared: Shared) -> None:
    scaled: list[np.ndarray] = []
    tasks = (0.01, "relative", 0), (0.01, "relative", 1), (0.01, "rms", 0), (0.02, "relative", 0)
    for level, reading, group in tasks:
        off = inversion(shared, level, reading, group).frequencies - EXACT
        scaled.append(off / perturbation_sd(EXACT, level, reading))
        assert all(np.all(np.abs(scaled[-1] - other) > 1e-3) for other in scaled[:-1])


@pytest.mark.parametrize("reading", INTERPRETATIONS)
def test_the_posterior_is_that_of_the_list_without_noise(shared: Shared, reading: Interpretation) -> None:
    found = posterior(shared, 0.01, reading)
    weighted = SLOPE_HZ / perturbation_sd(EXACT, 0.01, reading)[:, None]
    exact = np.sqrt(np.diag(np.linalg.inv(weighted.T @ weighted)))
    assert found.converged
    assert np.all(np.abs(found.mean - [0.4, -0.3]) < 0.13 * exact)  # four errors of 1000 effective draws
    np.testing.assert_allclose(found.sd, exact, rtol=0.09)
    np.testing.assert_allclose(found.best, [0.4, -0.3], atol=1e-3)
    assert np.all(np.abs(found.skewness) < 0.3)
    np.testing.assert_array_equal(found.peaks, [1, 1])
    assert found.next_to_bound.max() < 0.01


def test_spreads_to_first_order_are_those_of_both_estimators_and_of_inversions(shared: Shared) -> None:
    found, sd = posterior(shared, 0.001, "relative"), perturbation_sd(EXACT, 0.001, "relative")
    weighted = SLOPE_HZ / sd[:, None]
    likelihood = np.sqrt(np.diag(np.linalg.inv(weighted.T @ weighted)))
    inverse = np.linalg.inv(SLOPE_HZ.T @ SLOPE_HZ)
    least_squares = np.sqrt(np.diag(inverse @ SLOPE_HZ.T @ (sd[:, None] ** 2 * SLOPE_HZ) @ inverse))
    np.testing.assert_allclose(found.linearised_sd, likelihood, rtol=1e-3)  # the priors add less than 1e-3
    np.testing.assert_allclose(found.swarm_sd, least_squares, rtol=1e-3)
    assert np.all(least_squares > likelihood)
    inverted = np.array([inversion(shared, 0.005, "rms", group).constants for group in range(60)])
    expected = posterior(shared, 0.005, "rms").swarm_sd
    np.testing.assert_allclose(inverted.std(axis=0, ddof=1), expected, rtol=0.28)  # three errors of 60 runs
    assert np.all(np.abs(inverted.mean(axis=0) - [0.4, -0.3]) < 0.39 * expected)


# the whole study, not converged
CHAINS = EnsembleSettings(walkers=12, round_steps=60, most_steps=60)
SHORT = {"source": "model", "swarm_settings": SwarmSettings(particles=12, iterations=40), "chains": CHAINS}
# Progress reported by the study.
TOLD: list[tuple[int, int]] = []
TWO_LEVELS = {**SHORT, "levels": (0.01, 0.05), "groups": 3}


@pytest.fixture(scope="module")
def plate() -> Specimen:
    return model_list(read_specimen("A1"), 6)


@pytest.fixture(scope="module")
def study(plate: Specimen) -> Sensitivity:
    return noise_study(plate, 7, progress=lambda *done: TOLD.append(done), **TWO_LEVELS)


def test_the_model_s_own_list_gives_its_constants_back(plate: Specimen) -> None:
    asked = {"source": "model", "levels": (1e-6,), "readings": ("rms",), "groups": 2, "chains": CHAINS}
    found = noise_study(plate, 0, **asked)
    np.testing.assert_allclose(found.reference, [69e9, 0.33], rtol=2e-3)  # swarms agree to 1e-3 of 190 GPa
    np.testing.assert_allclose(found.cells[0].repetition.mean, [69e9, 0.33], rtol=2e-3)


def test_cells_come_level_by_level_and_progress_counts_all_tasks(study: Sensitivity) -> None:
    order = [(level, reading) for level in (0.01, 0.05) for reading in ("relative", "rms")]
    assert [(c.level, c.reading) for c in study.cells] == order
    for cell in study.cells:
        assert (cell.repetition.constants.shape, cell.repetition.lists.shape) == ((3, 2), (3, 6))
        assert len(cell.comparisons) == 2
        np.testing.assert_allclose(cell.repetition.sd, cell.repetition.constants.std(axis=0, ddof=1))
    assert [(i, 16) for i in range(1, 17)] == TOLD  # three inversions and a posterior per level and reading


def test_other_levels_and_more_groups_do_not_change_a_level(plate: Specimen, study: Sensitivity) -> None:
    (alone,) = noise_study(plate, 7, levels=(0.05,), readings=("rms",), groups=4, **SHORT).cells
    np.testing.assert_array_equal(alone.repetition.constants[:3], study.cells[3].repetition.constants)
    np.testing.assert_array_equal(alone.posterior.mean, study.cells[3].posterior.mean)


@pytest.mark.slow
def test_workers_do_not_change_a_bit(plate: Specimen, study: Sensitivity) -> None:
    with open_executor("processes", 2) as executor:
        shared_out = noise_study(plate, 7, executor=executor, **TWO_LEVELS)
    for one, other in zip(shared_out.cells, study.cells, strict=True):
        np.testing.assert_array_equal(one.repetition.constants, other.repetition.constants)
        np.testing.assert_array_equal(one.repetition.lists, other.repetition.lists)
        np.testing.assert_array_equal(one.posterior.mean, other.posterior.mean)
        np.testing.assert_array_equal(one.posterior.sd, other.posterior.sd)
        assert one.comparisons == other.comparisons
