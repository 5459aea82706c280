"""The noise study: its tasks against closed forms, and the whole of it on an aluminium plate."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cpam_bayes.inference.ensemble import EnsembleSettings
from cpam_bayes.inference.swarm import SwarmResult, SwarmSettings, minimise
from cpam_bayes.parallel import open_executor
from cpam_bayes.plate import Material, Specimen, read_specimen
from cpam_bayes.printed import noise_study as study_module
from cpam_bayes.printed import repetition as noise_tasks
from cpam_bayes.printed.noise_study import Sensitivity, model_list, noise_study
from cpam_bayes.printed.repetition import (
    INTERPRETATIONS,
    POSTERIOR,
    Interpretation,
    InverseProblem,
    Inversion,
    InversionTask,
    PosteriorSummary,
    Shared,
    perturbation_sd,
    run_task,
)
from tests.linear_model import MEAN_HZ, SLOPE_HZ, LinearModel, measurement

ENSEMBLE_SETTINGS = EnsembleSettings(walkers=16, round_steps=500, effective=1000.0)
# The model's parameters are no constants of it.
FREE = Material("isotropic", {"E1": 70e9, "nu12": 0.3}, {}, None)
EXACT = MEAN_HZ + SLOPE_HZ @ np.array([0.4, -0.3])


@pytest.fixture
def shared() -> Shared:
    """A linear model and the list that it gives at (0.4, -0.3)."""
    return Shared(
        problem=InverseProblem(LinearModel(), LinearModel().parameters, FREE, SwarmSettings()),
        measurement=replace(measurement(None), frequencies=EXACT),
        reference=np.array([0.4, -0.3]),
        chains=ENSEMBLE_SETTINGS,
        seed=5,
    )


def inversion(shared: Shared, level: float, reading: Interpretation, group: int) -> Inversion:
    found = run_task(shared, InversionTask(level, reading, group))
    assert isinstance(found, Inversion)
    return found


def posterior(shared: Shared, level: float, reading: Interpretation) -> PosteriorSummary:
    found = run_task(shared, InversionTask(level, reading, POSTERIOR))
    assert isinstance(found, PosteriorSummary)
    return found


@pytest.mark.parametrize("reading", INTERPRETATIONS)
def test_an_inversion_finds_the_least_squares_solution_of_its_noisy_list(
    shared: Shared, reading: Interpretation
) -> None:
    for group in range(3):
        found = inversion(shared, 0.01, reading, group)
        exact = np.linalg.lstsq(SLOPE_HZ, found.frequencies - MEAN_HZ, rcond=None)[0]
        # the swarm stops when nine in ten particles agree to 1e-3 of the width of 4
        np.testing.assert_allclose(found.constants, exact, atol=4e-3)
        assert found.converged
        assert not found.on_bound.any()


def test_an_inversion_that_noise_drives_out_of_the_box_ends_on_its_bound(shared: Shared) -> None:
    beyond = replace(shared, measurement=replace(shared.measurement, frequencies=EXACT + 60 * SLOPE_HZ[:, 0]))
    found = inversion(beyond, 1e-4, "relative", 0)
    np.testing.assert_array_equal(found.on_bound, [True, True])
    assert found.constants[0] == pytest.approx(2.0, abs=4e-3)


def elsewhere(times: int) -> Callable[..., SwarmResult]:
    """A swarm that ends at (-1, 1) so many times, and then searches."""
    left = [times]

    def search(objective: Any, *args: Any, **kwargs: Any) -> SwarmResult:
        found = minimise(objective, *args, **kwargs)
        if left[0] == 0:
            return found
        left[0] -= 1
        wrong = np.array([-1.0, 1.0])
        return replace(found, best=wrong, value=float(objective(wrong[None])[0]))

    return search


def test_a_swarm_that_misses_the_minimum_is_started_anew(
    shared: Shared, monkeypatch: pytest.MonkeyPatch
) -> None:
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


def test_values_that_a_swarm_cannot_tell_apart_are_as_good_as_each_other() -> None:
    f = np.array([300.0, 400.0])  # 500 Hz long, so sqrt(F) may differ by 0.25 Hz
    assert noise_tasks.equally_good(0.06, 0.0, f)
    assert not noise_tasks.equally_good(0.07, 0.0, f)
    assert noise_tasks.equally_good(100.0, 100.0, f)
    assert noise_tasks.equally_good(1.0, 100.0, f)
    assert not noise_tasks.equally_good(105.1, 100.0, f)


def test_the_reference_is_the_best_of_ten_swarms(shared: Shared, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[int] = []

    def value(shared: object, seed: int) -> float:
        seen.append(seed)
        return {1: 1e6, 4: 1e6, 6: 24.99}.get(len(seen), 25.0)

    monkeypatch.setattr(study_module, "swarm_value", value)
    assert study_module._best_start(shared.problem, EXACT, 5, None) == (seen[5], 8)
    assert seen[0] == 5
    assert len(set(seen)) == 10


def test_groups_levels_and_readings_have_noise_of_their_own(shared: Shared) -> None:
    tasks = [(0.01, "relative", 0), (0.01, "relative", 1), (0.01, "rms", 0), (0.02, "relative", 0)]
    lists = [inversion(shared, *task) for task in tasks]  # type: ignore[arg-type]
    scaled = [
        (one.frequencies - EXACT) / perturbation_sd(EXACT, level, reading)  # type: ignore[arg-type]
        for one, (level, reading, _) in zip(lists, tasks, strict=True)
    ]
    for i, one in enumerate(scaled):
        for other in scaled[:i]:
            assert np.all(np.abs(one - other) > 1e-3)


@pytest.mark.parametrize("reading", INTERPRETATIONS)
def test_the_posterior_is_that_of_the_list_without_noise(shared: Shared, reading: Interpretation) -> None:
    found = posterior(shared, 0.01, reading)
    weighted = SLOPE_HZ / perturbation_sd(EXACT, 0.01, reading)[:, None]
    exact = np.sqrt(np.diag(np.linalg.inv(weighted.T @ weighted)))
    assert found.converged
    # 1000 effective draws: a mean to 0.032 sd, an sd to 2.2 %; four of these
    assert np.all(np.abs(found.mean - [0.4, -0.3]) < 0.13 * exact)
    np.testing.assert_allclose(found.sd, exact, rtol=0.09)
    np.testing.assert_allclose(found.best, [0.4, -0.3], atol=1e-3)
    assert np.all(np.abs(found.skewness) < 0.3)
    np.testing.assert_array_equal(found.peaks, [1, 1])
    assert found.next_to_bound.max() < 0.01


def test_spreads_to_first_order_are_those_of_both_estimators(shared: Shared) -> None:
    found = posterior(shared, 0.001, "relative")
    sd = perturbation_sd(EXACT, 0.001, "relative")
    weighted = SLOPE_HZ / sd[:, None]
    likelihood = np.sqrt(np.diag(np.linalg.inv(weighted.T @ weighted)))
    inverse = np.linalg.inv(SLOPE_HZ.T @ SLOPE_HZ)
    middle = SLOPE_HZ.T @ (sd[:, None] ** 2 * SLOPE_HZ)
    least_squares = np.sqrt(np.diag(inverse @ middle @ inverse))
    # the priors' width of 1.15 adds less than 1e-3 of these variances
    np.testing.assert_allclose(found.linearised_sd, likelihood, rtol=1e-3)
    np.testing.assert_allclose(found.swarm_sd, least_squares, rtol=1e-3)
    assert np.all(least_squares > likelihood)


def test_inversions_scatter_as_wide_as_first_order_says(shared: Shared) -> None:
    found = np.array([inversion(shared, 0.005, "rms", group).constants for group in range(60)])
    expected = posterior(shared, 0.005, "rms").swarm_sd
    # an sd of 60 is known to 9 %, a mean to 0.13 sd; three of these
    np.testing.assert_allclose(found.std(axis=0, ddof=1), expected, rtol=0.28)
    assert np.all(np.abs(found.mean(axis=0) - [0.4, -0.3]) < 0.39 * expected)


# The whole study, short of convergence
SHORT = {
    "groups": 3,
    "swarm_settings": SwarmSettings(particles=12, iterations=40),
    "chains": EnsembleSettings(walkers=12, round_steps=60, most_steps=60),
}


@pytest.fixture(scope="module")
def plate() -> Specimen:
    return model_list(read_specimen("A1"), 6)


@pytest.fixture(scope="module")
def told() -> list[tuple[int, int]]:
    """What the study tells of its progress."""
    return []


@pytest.fixture(scope="module")
def study(plate: Specimen, told: list[tuple[int, int]]) -> Sensitivity:
    levels, progress = (0.01, 0.05), lambda *done: told.append(done)
    return noise_study(plate, 7, source="model", levels=levels, progress=progress, **SHORT)  # type: ignore[arg-type]


def test_the_model_s_own_list_gives_its_constants_back(plate: Specimen) -> None:
    found = noise_study(
        plate, 0, source="model", levels=(1e-6,), readings=("rms",), groups=2, chains=SHORT["chains"]
    )  # type: ignore[arg-type]
    # nine in ten particles agree to 1e-3 of the intervals (190 GPa, 0.25), the best is much closer
    np.testing.assert_allclose(found.reference, [69e9, 0.33], rtol=2e-3)
    np.testing.assert_allclose(found.cells[0].repetition.mean, [69e9, 0.33], rtol=2e-3)


def test_cells_come_level_by_level_and_reading_by_reading_and_progress_counts_all_tasks(
    study: Sensitivity, told: list[tuple[int, int]]
) -> None:
    order = [(level, reading) for level in (0.01, 0.05) for reading in ("relative", "rms")]
    assert [(c.level, c.reading) for c in study.cells] == order
    for cell in study.cells:
        assert cell.repetition.constants.shape == (3, 2)
        assert cell.repetition.lists.shape == (3, 6)
        assert len(cell.comparisons) == 2
        np.testing.assert_allclose(cell.repetition.sd, cell.repetition.constants.std(axis=0, ddof=1))
    # three inversions and a posterior at either level in either reading
    assert told == [(i, 16) for i in range(1, 17)]


def test_other_levels_and_more_groups_do_not_change_a_level(plate: Specimen, study: Sensitivity) -> None:
    alone = noise_study(plate, 7, source="model", levels=(0.05,), readings=("rms",), **{**SHORT, "groups": 4})  # type: ignore[arg-type]
    np.testing.assert_array_equal(
        alone.cells[0].repetition.constants[:3], study.cells[3].repetition.constants
    )
    np.testing.assert_array_equal(alone.cells[0].posterior.mean, study.cells[3].posterior.mean)


@pytest.mark.slow
def test_workers_do_not_change_a_bit(plate: Specimen, study: Sensitivity) -> None:
    with open_executor("processes", 2) as executor:
        shared_out = noise_study(plate, 7, source="model", levels=(0.01, 0.05), executor=executor, **SHORT)  # type: ignore[arg-type]
    for one, other in zip(shared_out.cells, study.cells, strict=True):
        np.testing.assert_array_equal(one.repetition.constants, other.repetition.constants)
        np.testing.assert_array_equal(one.repetition.lists, other.repetition.lists)
        np.testing.assert_array_equal(one.posterior.mean, other.posterior.mean)
        np.testing.assert_array_equal(one.posterior.sd, other.posterior.sd)
        assert one.comparisons == other.comparisons
