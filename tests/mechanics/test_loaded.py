"""Plates with point masses, against a solve with all matrices at once and the plate without masses."""

from dataclasses import replace

import numpy as np
import pytest

from cpam_bayes.effects import add_air, add_known_mass
from cpam_bayes.forward_model.model import PlateModel, plate_problem, size_parameters, training_sets
from cpam_bayes.mechanics.affine import AffineOperator, DenseBlock, restricted
from cpam_bayes.mechanics.dense import discretise, discretise_at
from cpam_bayes.mechanics.loaded import LoadedBlock, symmetry_parts
from cpam_bayes.mechanics.modes import solve
from cpam_bayes.mechanics.problem import Problem
from cpam_bayes.mechanics.ritz import RitzSettings, ritz_space
from cpam_bayes.plate.reader import builtin
from tests.plates import with_plate
from tests.shared import once_a_run

N_MODES, N_SETS = 8, 4
MASSES = {  # (mass, x, y) relative to the plate: light near a corner, heavy, several, two on a centre line.
    "light": ((0.01, 0.95, 0.925),),
    "heavy": ((0.2, 0.3, 0.4),),
    "several": ((0.02, 0.2, 0.3), (0.05, 0.7, 0.6), (0.01, 0.72, 0.6)),
    "centred": ((0.03, 0.5, 0.3), (0.02, 0.5, 0.8)),
}


def problem_of(edges: str, masses: str, *, air: bool = False) -> Problem:
    plate = builtin("C1").plate
    one = with_plate("C1", edges=edges, sd={"thickness": 0.02 * plate.thickness})
    problem = plate_problem(one, one.unknowns.union(size_parameters(one)))
    for share, x, y in MASSES.get(masses, ()):
        whole = plate.density * plate.thickness * plate.area
        problem = add_known_mass(problem, share * whole, x * plate.length, y * plate.width)
    return add_air(problem, 1.2) if air else problem


def sets_of(problem: Problem) -> np.ndarray:
    return training_sets(problem, N_SETS, np.random.default_rng(0))


@once_a_run
def model_of(edges: str, masses: str, air: bool = False) -> PlateModel:
    problem = problem_of(edges, masses, air=air)
    held = "C" in edges
    space = ritz_space(problem.edges, problem.nominal, RitzSettings(9, 9, 1, held, int(held)))
    operator = discretise(problem, space, problem.parameters.mapping(sets_of(problem)))
    return PlateModel(operator, N_MODES, np.zeros(N_MODES))


def with_all_matrices(model: PlateModel) -> PlateModel:
    blocks = tuple(block.dense() for block in model.operator.blocks)
    return replace(model, operator=AffineOperator(model.operator.problem, model.operator.space, blocks))


def loaded_blocks_of(model: PlateModel) -> list[LoadedBlock]:
    return [block for block in model.operator.blocks if isinstance(block, LoadedBlock)]


@pytest.mark.parametrize("edges", ["FFFF", "CFFF", "SSSS", "CCCC"])
@pytest.mark.parametrize("masses", MASSES)
def test_frequencies_and_derivatives_are_those_of_all_matrices(edges: str, masses: str) -> None:
    model = model_of(edges, masses)
    assert loaded_blocks_of(model), "masses join symmetries here"
    x = sets_of(model.operator.problem)
    found, expected = (m.predict(x, jacobian=True) for m in (model, with_all_matrices(model)))
    np.testing.assert_allclose(found.frequencies, expected.frequencies, rtol=1e-6)
    scale = x[:, None] / expected.frequencies[..., None]
    np.testing.assert_allclose(found.jacobian * scale, expected.jacobian * scale, atol=5e-6)
    shift = expected.frequencies / model_of(edges, "none").predict(x).frequencies - 1.0
    assert shift.min() < -3e-5, "the masses are felt"


def test_masses_in_air_are_those_of_all_matrices() -> None:
    model = model_of("FFFF", "light", True)
    (block, *_) = loaded_blocks_of(model)
    assert len(block.parts) == 4, "air keeps the symmetries"
    x = sets_of(model.operator.problem)
    expected = with_all_matrices(model).predict(x).frequencies
    np.testing.assert_allclose(model.predict(x).frequencies, expected, rtol=1e-6)


def test_fewer_terms_and_functions_and_a_basis_leave_the_same_matrices() -> None:
    model = model_of("CFFF", "several")
    coefficients = model.coefficients(sets_of(model.operator.problem))
    block = loaded_blocks_of(model)[-1]
    rng = np.random.default_rng(1)
    basis = rng.normal(size=(block.size, 12))
    small, of_all = block.project(basis), block.dense().project(basis)
    fewer = block.compressed(*coefficients)
    assert len(fewer.project(basis).mass.active) < len(small.mass.active)
    for other in (small, fewer.project(basis), block.compressed(*coefficients).dense().project(basis)):
        for kind, c in zip(("stiffness", "mass"), coefficients, strict=True):
            found, expected = (getattr(one, kind).assemble(c) for one in (other, of_all))
            np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())
    for found, expected in zip(block.diagonals(), block.dense().diagonals(), strict=True):
        np.testing.assert_allclose(found, expected)
    keep = rng.uniform(size=sum(b.size for b in model.operator.blocks)) < 0.9
    joined = next(b for b in restricted(model.operator, keep).blocks if isinstance(b, LoadedBlock))
    of_less = restricted(with_all_matrices(model).operator, keep)
    whole = next(b for b in of_less.blocks if np.array_equal(b.index, joined.index))
    np.testing.assert_allclose(joined.mass_at(coefficients[1][0]), whole.mass_at(coefficients[1][0]))


def test_samples_alone_are_solved_as_all_matrices_are() -> None:
    problem = problem_of("FFFF", "several")
    x = problem.parameters.mapping(sets_of(problem))
    space = ritz_space(problem.edges, problem.nominal, RitzSettings(9, 9))
    eye = np.eye(N_SETS)
    found = solve(discretise_at(problem, space, x), eye, eye, N_MODES).frequencies
    expected = model_of("FFFF", "several").predict(sets_of(problem)).frequencies
    np.testing.assert_allclose(found, expected, rtol=1e-8)  # two LAPACK routines, 1e-9 on some CPUs


def test_a_mass_in_the_middle_and_many_masses_join_no_parts() -> None:
    one, plate = problem_of("FFFF", "none"), builtin("C1").plate
    x = one.parameters.mapping(sets_of(one))
    space = ritz_space(one.edges, one.nominal, RitzSettings(5, 5))
    blocks = discretise(add_known_mass(one, 0.01, plate.length / 2, plate.width / 2), space, x).blocks
    assert len(blocks) == len(discretise(one, space, x).blocks)
    assert all(isinstance(block, DenseBlock) for block in blocks)
    for place in np.random.default_rng(2).uniform(size=(12, 2)):
        one = add_known_mass(one, 1e-4, *(place * (plate.length, plate.width)))
    assert all(isinstance(block, DenseBlock) for block in discretise(one, space, x).blocks)


def test_parts_of_all_blocks_hold_each_function_once() -> None:
    parts = symmetry_parts(model_of("SSSS", "centred").operator)
    assert sorted(parts.index) == list(range(parts.size))
    assert parts.rows.shape == (parts.inertia.shape[1], parts.size)
