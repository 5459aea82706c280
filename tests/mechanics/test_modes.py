"""Eigenpairs: derivatives, energies, normalisation, rigid-body count, tracking, kinds and labels."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from cpam_bayes.forward_model import model as plate_model
from cpam_bayes.forward_model.model import PlateModel
from cpam_bayes.mechanics import modes
from cpam_bayes.mechanics.affine import _LARGE
from cpam_bayes.mechanics.dense import discretise
from cpam_bayes.mechanics.fem import discretise_sparse, fem_space
from cpam_bayes.mechanics.modes import Mode, RigidBodyError, Spectrum, solve
from cpam_bayes.mechanics.problem import PlateState, Problem, Values, bare_plate
from cpam_bayes.mechanics.ritz import RitzSettings, ritz_space
from cpam_bayes.parameters import Parameter, ParameterSet, Uniform
from cpam_bayes.plate import Specimen, builtin, read_plate
from cpam_bayes.plate.laminate import complete_constants
from tests.mechanics.test_closed_forms import navier_of
from tests.plate_file import described as file_of
from tests.plates import CARBON, plate

ISOTROPIC = {"E1": 70e9, "nu12": 0.3}
SLOW = "unsymmetric-oblique"


def custom(layup: str, edges: str, thickness_mm: float, g23: bool = False) -> Specimen:
    """A carbon plate of 300 by 200 mm; four constants unknown, five with G23."""
    material = {"E1_GPa": 121.2, "E2_GPa": 9.34, "nu12": 0.23, "G12_GPa": 6.25, "G23_GPa": 3.0}
    box = [10.0, 200.0], [5.0, 40.0], [0.15, 0.4], [5.0, 30.0], [2.0, 30.0]
    size, unknowns = (300.0, 200.0, thickness_mm), dict(list(zip(material, box, strict=True))[: 4 + g23])
    return read_plate(file_of(size, 1600.0, material, layup=layup, edges=edges, unknowns=unknowns))


def on_fixed_basis(specimen: Specimen, n_modes: int, elements: int = 0) -> PlateModel:
    """A model in all unknowns on a small basis or a few elements, since what is tested here holds on any."""
    parameters = specimen.unknowns.union(plate_model.angle_parameters(specimen))
    problem = plate_model.plate_problem(specimen, parameters)
    values = parameters.mapping(plate_model.training_sets(problem, 8, np.random.default_rng(0)))
    none = np.zeros(n_modes)
    if elements:
        space = fem_space(problem.edges, problem.nominal, elements, elements, grading=None)
        return PlateModel(discretise_sparse(problem, space, values), n_modes, none)
    basis = ritz_space(problem.edges, problem.nominal, RitzSettings(6, 6))
    return PlateModel(discretise(problem, basis, values), n_modes, none)


def converged(name: str, n_modes: int) -> PlateModel:
    return plate_model.converged_model(builtin(name), builtin(name).unknowns, n_modes)


MODELS: dict[str, Callable[[], PlateModel]] = {
    "C1": lambda: converged("C1", 6),
    "D1": lambda: converged("D1", 10),
    "D&G": lambda: converged("D&G", 6),
    "unsymmetric": lambda: on_fixed_basis(custom("[0/90]_T", "FFFF", 10.0), 8),
    "elements": lambda: on_fixed_basis(custom("[30/-75]_T", "CFFF", 6.0), 6, elements=4),
    "thick-clamped": lambda: on_fixed_basis(custom("[(0/90)_2]_s", "CCCC", 30.0, g23=True), 6),
    SLOW: lambda: on_fixed_basis(custom("[30/?/0]_T", "CFFF", 10.0), 6),
}
specimens = pytest.mark.parametrize("name", MODELS)


@cache
def model(name: str) -> PlateModel:
    return MODELS[name]()


def points(m: PlateModel, n: int = 3) -> np.ndarray:
    share = np.random.default_rng(11).uniform(0.1, 0.9, (40, m.parameters.size))
    x = m.parameters.lower + (m.parameters.upper - m.parameters.lower) * share
    return np.asarray(x[m.admissible(x)][:n])


def likeness(m: PlateModel, a: Spectrum, b: Spectrum, mass: np.ndarray) -> np.ndarray:
    """Absolute values of phi^T M psi between the modes of two spectra, (n_modes, n_modes)."""
    found = np.zeros((m.n_modes, m.n_modes))
    for i, j in np.ndindex(found.shape):
        (of_a, phi), (of_b, psi) = a.vector(0, i), b.vector(0, j)
        if of_a == of_b:
            found[i, j] = abs(phi @ (m.operator.blocks[of_a].mass.assemble(mass) @ psi))
    return found


@specimens
def test_modes_solve_the_eigenproblem_are_orthonormal_in_the_mass_and_sorted(name: str) -> None:
    m = model(name)
    x = points(m)
    spectrum, without = m.spectrum(x, vectors=True), m.spectrum(x)
    largest = max(b.size for b in m.operator.blocks)  # large blocks round otherwise: K's range is 1e10
    rounding = 0.0 if largest <= _LARGE and name != "elements" else 1e-8
    np.testing.assert_allclose(spectrum.eigenvalues, without.eigenvalues, rtol=rounding, atol=0.0)
    assert np.all(np.diff(without.eigenvalues, axis=1) >= 0)
    with pytest.raises(ValueError, match="vectors=True"):
        without.vector(0, 0)
    with pytest.raises(ValueError, match="vectors=True"):
        modes.energy_terms(m.operator, without)
    (stiffness, mass), bound = m.coefficients(x), np.empty((len(x), m.n_modes))
    for s, n in np.ndindex(bound.shape):
        b, phi = spectrum.vector(s, n)
        block = m.operator.blocks[b]
        found = block.stiffness.assemble(stiffness[s]), block.mass.assemble(mass[s])
        k, big_m = (np.asarray(matrix @ np.eye(block.size)) for matrix in found)
        lam = spectrum.eigenvalues[s, n]
        assert phi @ big_m @ phi == pytest.approx(1.0, abs=1e-12)
        # an inverse iteration leaves 1e-16 of the largest eigenvalue and its shift, 1e-11 of its own, over
        # the mode's share of the starting vector, at worst one in a hundred here
        root = np.sqrt(np.diagonal(big_m))
        residual = np.linalg.norm((k @ phi - lam * (big_m @ phi)) / root)
        bound[s, n] = 2e-13 * np.linalg.norm(k / np.outer(root, root), 2) + 2e-9 * lam
        assert residual < bound[s, n]
    alone = m.spectrum(x[:1], vectors=True)
    apart = np.abs(likeness(m, alone, alone, mass[0]) - np.eye(m.n_modes))
    gap = np.abs(np.subtract.outer(alone.eigenvalues[0], alone.eigenvalues[0]))
    overlap = np.add.outer(bound[0], bound[0]) / np.where(gap > 0.0, gap, np.inf)  # that such residuals allow
    assert np.all(apart < overlap + 1e-12)


@specimens
def test_a_stack_of_parameter_sets_equals_one_by_one(name: str) -> None:
    m = model(name)
    x = points(m)
    together = m.predict(x, jacobian=True)
    stiffness, mass = m.coefficients(x)
    if np.ptp(mass, axis=0).max() == 0.0:  # the mass is the same for all
        found = solve(m.operator, stiffness, mass[:1], m.n_modes).frequencies
        np.testing.assert_allclose(found, together.frequencies, rtol=1e-8)
    for i, own in enumerate(x):
        alone = m.predict(own, jacobian=True)
        # only the order of sums of coefficients differs
        np.testing.assert_allclose(together.frequencies[i], alone.frequencies[0], rtol=1e-8)
        slope = alone.jacobian[0] * own
        np.testing.assert_allclose(together.jacobian[i] * own, slope, atol=1e-6 * np.abs(slope).max())


@pytest.mark.parametrize(
    ("name", "edges", "rigid"), [("C1", "CFFF", 0), ("C1", "SFFF", 3), ("thick-clamped", "FFFF", 6)]
)
def test_too_many_and_too_few_rigid_body_motions_are_an_error(name: str, edges: str, rigid: int) -> None:
    m = model(name)
    pretended = replace(m.operator, problem=replace(m.operator.problem, edges=edges))
    with pytest.raises(RigidBodyError, match=f"leave {rigid} rigid-body motions"):
        solve(pretended, *m.coefficients(points(m, 1)), 6)
    with pytest.raises(RigidBodyError, match="leave 0 rigid-body motions"):  # one too many, rounded up
        modes.check_rigid(np.array([1e-6, 1e3, 1e6]), 0, supported=False)


@pytest.mark.parametrize("name", [*list(MODELS)[:-1], pytest.param(SLOW, marks=pytest.mark.slow)])
def test_derivatives_are_the_differences_of_modes_tracked_by_shape(name: str) -> None:
    m = model(name)
    x = points(m, 2)
    prediction = m.predict(x, jacobian=True)
    for s, own in enumerate(x):  # one set at a time: modes of equal shape are compared, whatever their rank
        at = m.spectrum(own, vectors=True)
        mass = m.coefficients(own[None])[1][0]
        for j, p in enumerate(own):
            slopes = []
            for step in (2e-3 * abs(p), 1e-3 * abs(p)):
                either = [m.spectrum(own + s * step * np.eye(len(own))[j], vectors=True) for s in (1.0, -1.0)]
                up, down = (one.frequencies[0, likeness(m, at, one, mass).argmax(axis=1)] for one in either)
                slopes.append((up - down) / (2 * step))
            found = prediction.jacobian[s, :, j]
            expected = (4 * slopes[1] - slopes[0]) / 3
            # error: about the change of the differences, /15 after extrapolation, and rounding of 3e-9 / 1e-3
            error = np.abs(slopes[1] - slopes[0]) * abs(p) / 3 + 1e-5 * prediction.frequencies[s]
            assert np.all(np.abs(found - expected) * abs(p) < error)


def test_derivatives_of_coinciding_modes_are_those_of_the_branches_they_split_into() -> None:
    # on a square isotropic plate (1,3) and (3,1) coincide with equal parity; E1 separates them
    nominal = plate(0.2, 0.2, 0.01, 1600.0, ISOTROPIC, (0.0,), "SSSS").nominal
    base = complete_constants(ISOTROPIC, "isotropic")
    names = ("E1", "E2", "G12")
    parameters = ParameterSet(tuple(Parameter(n, "Pa", Uniform(1e9, 200e9)) for n in names))

    def state(values: Values) -> PlateState:
        return replace(nominal, constants=base | {n: values[n] for n in names})

    problem = bare_plate(parameters, "SSSS", nominal, state)
    x = np.array([[float(base[n]) for n in names]])
    spread = x * np.array([[1.0, 1.0, 1.0], [1.1, 0.9, 1.1]])
    space = ritz_space("SSSS", nominal, RitzSettings(14, 14))
    m = PlateModel(discretise(problem, space, parameters.mapping(spread)), 8, np.zeros(8))
    spectrum = m.spectrum(x)
    pair = (4, 5)  # (1,1), (1,2), (2,1), (2,2), then (1,3) and (3,1)
    assert spectrum.eigenvalues[0, pair[1]] / spectrum.eigenvalues[0, pair[0]] - 1 < 1e-9
    assert spectrum.block[0, pair[0]] == spectrum.block[0, pair[1]]
    jacobian = m.predict(x, jacobian=True).jacobian

    def exact(name: str, value: float) -> np.ndarray:
        moved = replace(problem, nominal=replace(nominal, constants=base | {name: np.asarray(value)}))
        return navier_of(moved, 8)

    for j, name in enumerate(names):
        value = float(base[name])
        step = 1e-4 * value  # one-sided: sorted frequencies have a kink here
        slopes = [(exact(name, value + k * step) - exact(name, value)) / (k * step) for k in (1, 2)]
        expected = (2 * slopes[0] - slopes[1])[list(pair)]
        allowed = 1e-6 * exact(name, value)[4] / value  # differences 1e-8 of f, the basis 1e-7
        np.testing.assert_allclose(jacobian[0][list(pair), j], expected, rtol=0, atol=allowed)
    assert np.ptp(jacobian[0][list(pair), 0]) * x[0, 0] > 0.1 * spectrum.frequencies[0, 4]


def described(problem: Problem, n_modes: int, degree: int = 12) -> tuple[Mode, ...]:
    space = ritz_space(problem.edges, problem.nominal, RitzSettings(degree, degree))
    operator = discretise(problem, space, {})
    stiffness, mass = operator.coefficients({})
    return modes.describe_modes(operator, solve(operator, stiffness, mass, n_modes, vectors=True), mass)


def test_labels_of_a_simply_supported_rectangle_count_naviers_half_waves() -> None:
    waves = sorted(((m / 0.3) ** 2 + (n / 0.2) ** 2, m, n) for m in range(1, 7) for n in range(1, 7))
    found = described(plate(0.3, 0.2, 0.001, 2700.0, ISOTROPIC, (0.0,), "SSSS"), 9)
    assert [mode.label for mode in found] == [f"({m},{n})" for _, m, n in waves[:9]]
    assert {mode.kind for mode in found} == {"bending"}


def test_in_plane_modes_of_a_thick_supported_plate_and_coupled_ones_of_an_unsymmetric_one_are_named() -> None:
    constants = complete_constants(ISOTROPIC, "isotropic")  # v = sin(pi x / a) at c / 2a
    speed = float(np.sqrt(constants["G12"] / 2700.0))
    found = described(plate(0.3, 0.2, 0.06, 2700.0, ISOTROPIC, (0.0,), "SSSS"), 12)
    in_plane = {mode.label: mode for mode in found if mode.kind == "in-plane"}
    assert in_plane["v(1,0)"].frequency == pytest.approx(speed / 0.6, rel=1e-6)
    assert in_plane["u(0,1)"].frequency == pytest.approx(speed / 0.4, rel=1e-6)
    for mode in found:  # a symmetric layup does not mix the two
        assert mode.in_plane_fraction == pytest.approx(round(mode.in_plane_fraction), abs=1e-12)
        assert mode.kind == ("in-plane" if mode.in_plane_fraction > 0.5 else "bending")
    found = described(plate(0.1, 0.1, 0.04, 1600.0, CARBON, (0.0, 90.0), "FFFF"), 14)
    coupled = [mode for mode in found if mode.kind == "coupled"]
    assert coupled
    assert all(0.1 <= mode.in_plane_fraction <= 0.9 for mode in coupled)


LABELS: dict[str, tuple[Problem, list[str], set[str]]] = {  # labels of the first modes, and among the rest
    # Leissa's: twist, saddle, ring, a pair with one more nodal line each; the ring is w = f(x) + f(y)
    "free square": (
        plate(0.3, 0.3, 0.003, 2700.0, ISOTROPIC),
        ["(1,1)", "(2,0)+(0,2)", "(2,0)+(0,2)"],
        {"(1,2)", "(2,1)"},
    ),
    # fibres along x, which is much longer: bending with nodal lines across x, and twisting
    "beamlike": (plate(0.6, 0.1, 0.003, 1600.0, CARBON, (0.0,)), [], {"(1,1)", "(2,0)"}),
    # held at one end only: the clamped edge itself does not count
    "cantilever": (plate(0.3, 0.15, 0.002, 2700.0, ISOTROPIC, (0.0,), "CFFF"), ["(0,0)", "(0,1)"], set()),
    "turned": (plate(0.15, 0.3, 0.002, 2700.0, ISOTROPIC, (0.0,), "FCFF"), ["(0,0)", "(1,0)"], set()),
}


@pytest.mark.parametrize(("problem", "first", "among"), LABELS.values(), ids=LABELS)
def test_labels_count_nodal_lines(problem: Problem, first: list[str], among: set[str]) -> None:
    labels = [mode.label for mode in described(problem, 5)]
    assert labels[: len(first)] == first
    assert set(labels[len(first) :]) >= among
