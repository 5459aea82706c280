"""Constants and angles of a specimen: least squares in stacks, and the swarm against enumeration."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import least_squares, lsq_linear

from cpam_bayes.forward_model.build import reduced_model
from cpam_bayes.forward_model.model import reference_vector
from cpam_bayes.forward_model.reduced import ReductionSettings
from cpam_bayes.identification import angle_search
from cpam_bayes.identification.angle_search import best_constants, fit_constants, search_angles, search_starts
from cpam_bayes.inference.swarm import SwarmSettings
from cpam_bayes.plate import angle_grid, builtin
from cpam_bayes.plate.layup import parse_layup
from cpam_bayes.stacking.symmetry import canonical, plate_symmetries

RNG = np.random.default_rng(5)
SLOPES = RNG.normal(size=(7, 6, 3))  # one linear model per sequence
MEASURED = RNG.normal(size=6)
LOWER, UPPER = np.array([-0.3, -0.2, 0.0]), np.array([0.4, 0.5, 0.6])
STARTS = np.array([[0.0, 0.0, 0.1], [0.3, 0.4, 0.5]])
NUMBERS = np.arange(7.0)[:, None]


def everywhere(x):
    return np.ones(len(x), dtype=bool)


def linear(constants, numbers):
    slope = SLOPES[numbers[:, 0].astype(int)]
    return np.einsum("mij,mj->mi", slope, constants), slope


def curved(constants, numbers):
    f, slope = linear(constants, numbers)
    return f + 0.1 * f**2, slope * (1.0 + 0.2 * f)[..., None]


@pytest.mark.parametrize("weighted", [False, True])
def test_linear_problems_have_the_bounded_least_squares_solution(weighted):
    weight = np.linspace(0.5, 3.0, 6) if weighted else None
    root = np.ones(6) if weight is None else np.sqrt(weight)
    found = fit_constants(linear, everywhere, NUMBERS, STARTS, MEASURED, LOWER, UPPER, weight=weight)
    assert found.settled.all()
    on_bound = (found.constants == LOWER) | (found.constants == UPPER)
    assert on_bound.any(), "some of the optima lie on a bound"
    for i, slope in enumerate(SLOPES):
        exact = lsq_linear(root[:, None] * slope, root * MEASURED, bounds=(LOWER, UPPER), tol=1e-14)
        assert_allclose(found.values[i], 2.0 * exact.cost, rtol=1e-8)  # converged to 1e-9 of F
        assert_allclose(found.constants[i], exact.x, atol=1e-4)


def test_curved_problems_reach_what_scipy_reaches_alone_and_in_a_stack():
    found = fit_constants(curved, everywhere, NUMBERS, STARTS, MEASURED, LOWER, UPPER)
    for i, number in enumerate(NUMBERS[:, None]):

        def residual(x, number=number):
            return curved(x[None], number)[0][0] - MEASURED

        ends = [least_squares(residual, x, bounds=(LOWER, UPPER), xtol=1e-12).cost for x in STARTS]
        assert found.values[i] <= 2.0 * min(ends) * (1.0 + 1e-7)
        alone = fit_constants(curved, everywhere, number, STARTS, MEASURED, LOWER, UPPER)
        assert_allclose(alone.constants[0], found.constants[i], rtol=1e-9, atol=1e-12)


def test_steps_stay_where_the_constraints_hold_and_a_start_outside_is_refused():
    def below(x):
        return x[:, 0] + x[:, 1] < 0.35

    asked = []

    def watched(constants, numbers):
        asked.append(constants)
        return linear(constants, numbers)

    found = fit_constants(watched, below, NUMBERS, STARTS[:1], MEASURED, LOWER, UPPER)
    assert all(below(x).all() for x in asked)
    assert all(np.all((x >= LOWER) & (x <= UPPER)) for x in asked)
    assert found.evaluations == sum(len(x) for x in asked)
    for outside in ([0.0, 0.0, 0.7], [0.35, 0.3, 0.1]):
        with pytest.raises(ValueError, match="starts of the constants"):
            fit_constants(linear, below, NUMBERS, np.array([outside]), MEASURED, LOWER, UPPER)


GRID = angle_grid(45.0)  # -45 0 45 90
EVERY = np.array(list(product(range(4), repeat=2)))
TRUTH = np.array([1, 3])  # 0, 90
# F, Hz^2, of equivalent laminates instead of 0: below 1e-3 of 600 Hz in each of six modes
COARSE = 6 * 0.6**2


@pytest.fixture(scope="module")
def specimen():
    found = builtin("C1", sequence=True)
    return replace(found, plate=replace(found.plate, layup=parse_layup("[(?/?)_8]_s")), angle_grid_deg=45.0)


@pytest.fixture(scope="module")
def fit(specimen):
    """C1 with two unknown angles, and the frequencies of its own layup and reference constants."""
    settings = ReductionSettings(training=24, checks=24, rounds=1)
    model = reduced_model(specimen, angle_search.search_parameters(specimen), 6, settings=settings)
    constants = reference_vector(specimen, specimen.unknowns)
    measured = model.predict(np.concatenate((constants, GRID[TRUTH]))).frequencies[0]
    return angle_search.AngleSearchProblem(specimen, model, measured, GRID)


@pytest.fixture(scope="module")
def enumerated(fit):
    return best_constants(fit, EVERY, search_starts(fit, 8)).values


@pytest.mark.slow
def test_enumeration_finds_the_plates_own_sequence_and_its_images(specimen, enumerated):
    own = np.flatnonzero(np.all(EVERY == TRUTH, axis=1))[0]
    assert enumerated[own] < 1e-6
    orbits = canonical(EVERY, plate_symmetries(specimen)).representative
    same = np.all(orbits == orbits[own], axis=1)
    assert same.sum() == 2, "0/90 and 90/0 on a square"
    assert np.all(enumerated[same] < COARSE)
    assert np.all(enumerated[~same] > 10 * COARSE)


@pytest.mark.slow
def test_swarms_reach_the_minimum_that_enumeration_finds(fit, enumerated):
    results = angle_search.run_swarms(fit, range(4), SwarmSettings(particles=30, iterations=80))
    assert len([r for r in results if r.value < COARSE]) >= 2, "of four seeds on sixteen sequences"
    for result in results:
        # none is below the fit to its own sequence, apart from kinks, where fits end 3e-5 of F too high
        assert result.value >= enumerated[result.sequence @ [4, 1]] * (1.0 - 1e-3)
        # alone and in a stack every f is equal to 5e-10: dF = 2 |f - measured| 5e-10 f
        own = fit.values(result.best[None], result.sequence[None])[0]
        rounding = 1e-9 * np.sqrt(result.value) * np.linalg.norm(fit.measured)
        assert own == pytest.approx(result.value, rel=0.0, abs=rounding + 1e-7)
        assert fit.admissible(result.best[None])[0]


def test_swarms_of_several_seeds_are_the_swarms_of_each(fit):
    settings = SwarmSettings(particles=6, iterations=4)
    for seed, result in zip((3, 1), angle_search.run_swarms(fit, (3, 1), settings), strict=True):
        alone = angle_search.run_swarm(fit, seed, settings)
        assert_array_equal(result.history, alone.history)
        assert_array_equal(result.sequence, alone.sequence)


def test_relative_residuals_weigh_modes_by_their_frequency(fit):
    relative = replace(fit, residual="relative")
    rows, constants = np.array([[0, 2]]), search_starts(fit, 1)
    f = fit.model.predict(np.hstack((constants, GRID[rows]))).frequencies[0]
    assert relative.values(constants, rows)[0] == pytest.approx(np.sum((f / fit.measured - 1.0) ** 2))
    found = best_constants(relative, rows, constants)
    assert relative.values(found.constants, rows)[0] == pytest.approx(found.values[0])
    assert found.values[0] <= relative.values(constants, rows)[0]


def test_starts_meet_the_constraints_and_fitted_constants_are_the_true_ones(fit, specimen):
    starts, truth = search_starts(fit, 5), reference_vector(specimen, specimen.unknowns)
    assert fit.admissible(starts).tolist() == [True] * 5
    assert_array_equal(starts[0], truth)
    assert_array_equal(starts, search_starts(fit, 5))
    # F is converged to 1e-9 of itself
    assert_allclose(best_constants(fit, TRUTH[None], starts[:3]).constants[0], truth, rtol=1e-4)


@pytest.mark.slow
def test_a_built_in_case_is_searched_from_end_to_end():
    specimen, told = builtin("G1", sequence=True), []
    settings = SwarmSettings(particles=10, iterations=5)
    found = search_angles(specimen, 2, settings=settings, notify=told.append)
    again = search_angles(specimen, 2, settings=settings)
    assert told
    assert (found.value, found.swarm.status) == (again.value, "budget")
    assert_array_equal(found.angles_deg, again.angles_deg)
    assert np.all(np.isin(found.angles_deg, angle_grid(5.0)))
    assert tuple(found.constants) == specimen.unknowns.names
    measured = specimen.measurement.frequencies
    # the swarm's F is of the reduced model, the frequencies of the full one: at most 1e-3 apart
    assert np.sum((found.predicted - measured) ** 2) == pytest.approx(found.value, rel=0.02)
    assert found.rms == pytest.approx(np.sqrt(np.mean((found.predicted / measured - 1.0) ** 2)))
    assert np.all(found.error < 0.01)


def test_a_known_layup_is_refused():
    with pytest.raises(ValueError, match=r'known layup \[\(0/90\)_8\]_s, accepted: one with "\?" plies'):
        search_angles(builtin("C1"), 0)


@pytest.mark.slow
def test_fuzzy_swarms_find_the_least_f_twice_where_single_ones_miss(fit, specimen, enumerated, monkeypatch):
    """Swarms too small to find the plate's own angles every time, judged by enumeration."""
    exact = replace(specimen, measurement=replace(specimen.measurement, frequencies=fit.measured))
    monkeypatch.setattr(angle_search, "reduced_model", lambda *args, **kwargs: fit.model)
    settings, least = SwarmSettings(particles=6, iterations=12), enumerated.min()
    singles = [search_angles(exact, seed, settings=settings) for seed in range(6)]
    assert any(single.value > 10 * COARSE for single in singles), "some single swarm ends elsewhere"
    rounding = 6 * (1e-7 * fit.measured.max()) ** 2
    for seed in range(3):
        several = search_angles(exact, seed, swarms=12, settings=settings)
        assert several.values == tuple(sorted(several.values))
        assert several.value == several.values[0]
        again = sum(value <= 1.001 * several.value + rounding for value in several.values)
        assert (several.swarm.status == "converged") == (again >= 2)
        assert several.value <= least + COARSE
        assert several.swarm.evaluations > singles[seed].swarm.evaluations
