"""The error that is printed beside a frequency: true, and not too pessimistic."""

from functools import cache

import numpy as np
import pytest

from cpam_bayes.forward_model import model as plate_model
from cpam_bayes.forward_model.model import PlateModel, converged_model, convergence_samples, plate_problem
from cpam_bayes.mechanics import convergence
from cpam_bayes.mechanics.convergence import THIN, Tolerance, converge, default_tolerance
from cpam_bayes.mechanics.dense import discretise_at
from cpam_bayes.mechanics.modes import solve
from cpam_bayes.mechanics.problem import Problem, Values
from cpam_bayes.mechanics.ritz import RitzSettings, ritz_space
from cpam_bayes.plate import read_plate, read_specimen
from tests.plate_file import SHEET, SHEET_SD, described
from tests.plates import ANGLE_PLY_16S, CARBON, CROSS_PLY_16S, GLASS, plate

# Smallest error that an estimate must resolve: frequencies are printed with five or six digits.
DIGITS = 1e-6
CASES: dict[str, tuple[Problem, int, float]] = {  # A plate, its number of modes and its promised error.
    "C1": (plate(0.26, 0.26, 0.0032, 1590.0, CARBON, CROSS_PLY_16S), 6, 2e-4),
    "D1": (plate(0.101, 0.053, 0.0035, 1550.0, CARBON | {"G23": 3.0e9}, (0.0,) * 20), 10, 5e-4),
    "A2": (plate(0.25, 0.28, 0.003, 2700.0, {"E1": 69e9, "nu12": 0.33}, (0.0,), "CFFF"), 6, 2e-4),
    "angle-ply": (plate(0.2, 0.16, 0.002, 1590.0, GLASS, ANGLE_PLY_16S), 6, 2e-4),
    "off-axis": (plate(0.3, 0.2, 0.003, 1590.0, CARBON, (20.0,)), 6, 2e-4),
    "clamped": (plate(0.3, 0.2, 0.003, 1590.0, CARBON, CROSS_PLY_16S, "CCCC"), 6, 2e-4),
}
C1, D1 = CASES["C1"][0], CASES["D1"][0]
CONVERGED_HZ = {  # Two bases of an independent program agree to 2e-6 (shear factor 5/6).
    "C1": [100.366, 298.584, 324.574, 360.347, 381.139, 600.611],
    "A2": [40.9165, 90.673, 240.069, 276.238, 340.704, 566.456],
    "D1": [1351.155, 3015.301, 3150.239, 4044.149, 4055.798, 6775.498, 8143.114, 8273.099,
           8849.348, 9154.067],
}  # fmt: skip
# [30/-45/90] from two bases with exponentials in u and v too: they agree to 1e-7
UNSYMMETRIC_HZ = [105.867349, 135.576120, 262.894270, 333.431377, 356.497744, 438.422519]


@cache
def converged(name: str) -> convergence.ConvergedOperator:
    problem, n_modes, _ = CASES[name]
    return converge(problem, {}, n_modes)


def frequencies(found: convergence.ConvergedOperator, n_modes: int) -> np.ndarray:
    operator = found.operator
    return np.asarray(solve(operator, *operator.coefficients({}), n_modes).frequencies[0])


def richer(problem: Problem, n_modes: int, samples: Values | None = None, degree: int = 18) -> np.ndarray:
    """Frequencies of a space far richer than any that is chosen, with three exponentials at each edge."""
    settings = RitzSettings(degree, degree, 3, True, 3 if "C" in problem.edges else 0)
    operator = discretise_at(problem, ritz_space(problem.edges, problem.nominal, settings), samples or {})
    eye = np.eye(len(operator.blocks[0].stiffness.active))
    return np.asarray(solve(operator, eye, eye, n_modes).frequencies)


@pytest.mark.parametrize("name", CASES)
def test_the_error_is_below_an_estimate_that_keeps_its_promise_and_never_below_zero(name: str) -> None:
    problem, n_modes, promised = CASES[name]
    true = frequencies(converged(name), n_modes) / richer(problem, n_modes)[0] - 1.0
    estimate = converged(name).error
    assert np.all(true > -1e-7)  # a Ritz space within a larger one; rounding is up to 1e-7 of a frequency
    assert np.all(true <= estimate + DIGITS)
    assert np.all(estimate <= np.maximum(20.0 * true, 2e-4)), "uselessly large"
    assert max(true.max(), estimate.max()) < promised


@pytest.mark.parametrize("name", CONVERGED_HZ)
def test_estimate_holds_against_an_independent_program(name: str) -> None:
    found = frequencies(converged(name), CASES[name][1])  # references of six digits: up to 5e-6
    assert np.all(np.abs(found / CONVERGED_HZ[name] - 1.0) <= converged(name).error + 5e-6)


def test_estimate_holds_for_a_thin_unsymmetric_plate() -> None:
    found = converge(plate(0.3, 0.2, 0.003, 1590.0, CARBON, (30.0, -45.0, 90.0)), {}, 6)
    assert np.all(frequencies(found, 6) / UNSYMMETRIC_HZ - 1.0 <= found.error + DIGITS)


@pytest.mark.parametrize("kept", [1e-3, 1e-5])
def test_tolerance_is_kept_and_no_better_than_needed(kept: float) -> None:
    found = converge(C1, {}, 6, Tolerance(kept=kept, rich=kept / 4))
    error = frequencies(found, 6) / richer(C1, 6)[0] - 1.0
    assert np.max(error) < 1.75 * kept  # the rich space may lack a quarter in x, y and exponentials
    assert np.max(error) > kept / 50, "a far smaller space would have done"
    assert np.all(error <= found.error + DIGITS)
    usual = converged("C1").keep.sum()
    assert found.keep.sum() < usual if kept > THIN.kept else found.keep.sum() > usual


def test_space_that_may_not_grow_says_how_far_off_it_is() -> None:
    found = converge(D1, {}, 10, Tolerance(kept=1e-8, rich=1e-8, largest_degree=10))
    error = frequencies(found, 10) / richer(D1, 10)[0] - 1.0
    assert np.max(error) > 1e-7
    assert np.max(found.error) > 1e-7
    assert np.all(error <= found.error + DIGITS)


def test_thickness_decides_the_tolerance() -> None:
    assert default_tolerance(C1) is THIN
    assert default_tolerance(D1) is convergence.THICK
    assert THIN.kept + THIN.rich < 2e-4
    assert convergence.THICK.kept + convergence.THICK.rich < 5e-4


@cache
def c1() -> PlateModel:
    specimen = read_specimen("C1")
    return converged_model(specimen, specimen.unknowns, 6)


def test_a_model_keeps_its_estimate_about_the_reference_constants_and_its_allowance_far_from_them() -> None:
    specimen, model = read_specimen("C1"), c1()
    problem = plate_problem(specimen, specimen.unknowns)
    names = model.parameters.names

    def error(x: np.ndarray, degree: int = 15) -> np.ndarray:
        exact = richer(problem, 6, model.parameters.mapping(np.atleast_2d(x)), degree)
        return np.asarray(model.predict(x).frequencies / exact - 1.0)

    reference = np.array([specimen.material.constants[n] for n in names])
    assert np.all(error(reference, 18) <= model.error + DIGITS)
    near = reference * (1 + 0.3 * np.random.default_rng(4).uniform(-1, 1, (6, len(names))))
    found = error(near[model.admissible(near)])
    assert np.max(found) < 2e-4
    assert np.all(found < 1.5 * model.error + DIGITS)  # the largest over three neighbours, not all
    far = convergence_samples(specimen, problem)
    assert set(far.allowance) == {1.0, 20.0}
    assert np.all(error(far.x).max(axis=1) <= far.allowance * (THIN.kept + THIN.rich))
    assert np.all(model.admissible(far.x))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "n_modes"), [("C3", 6), ("D1", 10)])
def test_no_sample_is_left_behind_when_the_hardest_one_is_converged(name: str, n_modes: int) -> None:
    specimen = read_specimen(name)
    problem = plate_problem(specimen, specimen.unknowns)
    samples = convergence_samples(specimen, problem)
    values, tolerance = specimen.unknowns.mapping(samples.x), default_tolerance(problem)
    found = converge(problem, values, n_modes, tolerance, samples.allowance)
    exact = convergence.rich_frequencies(problem, values, n_modes, tolerance)
    own = solve(found.operator, *found.operator.coefficients(values), n_modes).frequencies
    error = (own / exact.frequencies - 1.0).max(axis=1)
    assert np.all(error <= 1.1 * samples.allowance * tolerance.kept)  # against a richer reference


def test_discretisation_error_far_from_the_centre_is_near_the_true_one_and_bounds_it() -> None:
    model = c1()
    high = np.array([name in ("E1", "nu12") for name in model.parameters.names])  # slow to converge
    x = np.where(high, model.parameters.upper, model.parameters.lower)
    estimate = plate_model.discretisation_error(model, x)
    exact = richer(model.operator.problem, 6, model.parameters.mapping(x[None]))
    error = (model.predict(x).frequencies / exact - 1.0)[0]
    np.testing.assert_allclose(estimate, error, rtol=0.1, atol=THIN.rich)
    assert np.all(error <= estimate + DIGITS)


def test_convergence_is_the_same_on_every_run() -> None:
    specimen = read_specimen("C1")
    again = converged_model(specimen, specimen.unknowns, 6)
    np.testing.assert_array_equal(again.error, c1().error)
    x = 0.5 * (c1().parameters.lower + c1().parameters.upper)
    np.testing.assert_array_equal(again.predict(x).frequencies, c1().predict(x).frequencies)


def test_rounding_of_a_very_thin_plate_is_no_slip_of_its_thickness() -> None:
    """A coarser space that cannot tell its rigid-body motions from bending is not used."""
    material = {**SHEET, "sd": SHEET_SD}
    unknowns = {"E1_GPa": [30, 200], "E2_GPa": [3, 20], "nu12": [0.1, 0.49], "G12_GPa": [1.5, 10]}
    unknowns["angle_grid_deg"] = 90
    one = read_plate(described((310.0, 228.0, 1.0), 1590.0, material, layup="[?_8]", unknowns=unknowns))
    parameters = plate_model.angle_parameters(one).union(plate_model.constant_parameters(one))
    assert converged_model(one, parameters, 10).error.max() < 2e-4
