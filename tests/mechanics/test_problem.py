"""The plate as an eigenvalue problem: rigid-body counts, forms, weights, coefficients, dense blocks."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import scipy.linalg

from cpam_bayes.effects import add_known_mass
from cpam_bayes.mechanics import affine
from cpam_bayes.mechanics.affine import LINE, ONE, AffineMatrix, Bell, Polynomial, Product, power
from cpam_bayes.mechanics.dense import MATRICES, discretise
from cpam_bayes.mechanics.problem import AREA, PlateState, Problem, Region, bare_plate, rigid_body_count
from cpam_bayes.mechanics.ritz import RitzSettings, RitzSpace, broken_quadrature, ritz_space
from cpam_bayes.plate.edges import FIELDS
from tests.plates import CARBON, plate

GENERAL = (30.0, -60.0, 10.0)  # every entry of A, B, D and A_s is nonzero
PLY = CARBON | {"G13": 5.1e9, "G23": 3.0e9}
ALL_EDGES = ["".join(e) for e in product("FSC", repeat=4)]
T = np.linspace(0.0, 1.0, 11)


def thick(edges: str = "FFFF", layup: tuple[float, ...] = GENERAL) -> Problem:
    return plate(0.3, 0.2, 0.03, 1600.0, PLY, layup, edges)


def whole(
    operator: affine.DenseOperator, values: Mapping[str, np.ndarray] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    coefficients = [np.atleast_2d(c)[0] for c in operator.coefficients(values or {})]
    n = sum(block.size for block in operator.blocks)
    matrices = np.zeros((2, n, n))
    for block in operator.blocks:
        place = np.ix_(block.index, block.index)
        matrices[0][place] = block.stiffness.assemble(coefficients[0])
        matrices[1][place] = block.mass.assemble(coefficients[1])
    return matrices[0], matrices[1]


def strains(space: RitzSpace, state: PlateState) -> tuple[np.ndarray, np.ndarray]:
    """The eight generalised strains at quadrature points, (n_points, 8, n), and the points' areas."""
    rule = space.quadrature(AREA)
    sizes = [space.dimension(f) for f in FIELDS]
    starts = dict(zip(FIELDS, np.cumsum([0, *sizes[:-1]]), strict=True))
    b = np.zeros((len(rule.points), 8, sum(sizes)))
    rows = (
        *((0, "u", "x"), (1, "v", "y"), (2, "u", "y"), (2, "v", "x")),
        *((3, "phi_x", "x"), (4, "phi_y", "y"), (5, "phi_x", "y"), (5, "phi_y", "x")),
        *((6, "w", "y"), (6, "phi_y", ""), (7, "w", "x"), (7, "phi_x", "")),
    )
    for row, field, derivative in rows:
        size = {"": 1.0, "x": float(state.length), "y": float(state.width)}[derivative]
        values = space.evaluate(field, rule, derivative) / size
        b[:, row, starts[field] : starts[field] + values.shape[1]] += values
    return b, rule.weights * float(state.length) * float(state.width)


def by_quadrature(problem: Problem, space: RitzSpace) -> tuple[np.ndarray, np.ndarray]:
    """K = int B^T C B and M = int N^T R N, directly from the definitions of strain and inertia."""
    state = problem.nominal
    b, area = strains(space, state)
    k = np.einsum("p,pin,ij,pjm->nm", area, b, state.stiffness(), b, optimize=True)
    rule = space.quadrature(AREA)
    h, blocks = float(state.thickness), []
    for field in FIELDS:
        values = space.evaluate(field, rule, "")
        inertia = float(state.density) * h * (h * h / 12 if field in ("phi_x", "phi_y") else 1.0)
        blocks.append(inertia * values.T @ (area[:, None] * values))
    return k, scipy.linalg.block_diag(*blocks)


@pytest.mark.parametrize("edges", ALL_EDGES)
def test_rigid_body_count_is_the_null_space_of_the_stiffness(edges: str) -> None:
    problem = thick(edges)
    space = ritz_space(edges, problem.nominal, RitzSettings(4, 4, layers=0))
    k, m = whole(discretise(problem, space, {}))
    scale = 1.0 / np.sqrt(np.diagonal(m))
    lam = np.linalg.eigvalsh(k * scale[:, None] * scale)
    n = rigid_body_count(edges)
    assert np.all(np.abs(lam[:n]) < 1e-12 * lam[-1])  # rounding; the lowest deformation is 1e-5 of lam[-1]
    assert lam[n] > 1e-7 * lam[-1]


def test_wrong_edges_are_refused_with_what_is_accepted() -> None:
    for edges in ("FFF", "FFFFF", "FFFX", "", "ffff"):
        with pytest.raises(ValueError, match="expected four of F, S, C") as caught:
            bare_plate(thick().parameters, edges, thick().nominal, thick().state)
        assert repr(edges) in str(caught.value)


@pytest.mark.parametrize("edges", ["CFSF", "FSFC", "SCFS"])
def test_trial_functions_vanish_where_an_edge_holds_them_and_only_there(edges: str) -> None:
    held: dict[str, dict[str, set[str]]] = {  # S is Navier's: motion along the edge is fixed, across it free
        "F": {"x": set(), "y": set()},
        "S": {"x": {"v", "w", "phi_y"}, "y": {"u", "w", "phi_x"}},
        "C": {"x": set(FIELDS), "y": set(FIELDS)},
    }
    space = ritz_space(edges, thick(edges).nominal, RitzSettings(5, 5, 1, True, 1))
    for name, condition in zip(("x0", "y0", "x1", "y1"), edges, strict=True):
        rule = space.quadrature(Region("edge", name))
        assert np.all(rule.points[:, "xy".index(name[0])] == float(name[1]))
        for field in FIELDS:
            largest = np.abs(space.evaluate(field, rule, "")).max()
            assert (largest < 1e-10) == (field in held[condition][name[0]]), (name, field)


@pytest.mark.parametrize(
    ("edges", "terms"), [("FFFF", (5, 6)), ("CFSF", (5, 4, 2, True, 1)), ("SSSS", (5, 4, 1, True))]
)
def test_affine_sum_is_the_quadrature_of_both_energies(edges: str, terms: tuple[int, ...]) -> None:
    problem = thick(edges)
    space = ritz_space(edges, problem.nominal, RitzSettings(*terms))
    both = zip(whole(discretise(problem, space, {})), by_quadrature(problem, space), strict=True)
    for found, expected in both:
        # both integrate exactly; sums of a hundred points leave 1e-13 of the largest entry
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_coefficients_of_a_stack_of_states_are_those_of_each() -> None:
    problem = thick()
    thickness, density = np.array([0.001, 0.01, 0.05]), np.array([1000.0, 1500.0, 2000.0])

    def state(_: object) -> PlateState:
        return replace(problem.nominal, thickness=thickness, density=density)

    stack = add_known_mass(replace(problem, state=state), 0.01, 0.1, 0.1)
    for i, (h, rho) in enumerate(zip(thickness, density, strict=True)):
        one = add_known_mass(plate(0.3, 0.2, h, rho, PLY, GENERAL), 0.01, 0.1, 0.1)
        for kind in MATRICES:
            found = stack.coefficients({}, kind)
            assert found.shape == (3, len(one.forms(kind)))
            np.testing.assert_allclose(found[i], one.coefficients({}, kind), rtol=1e-13)


@pytest.mark.parametrize("profile", [ONE, LINE, power(4), Polynomial((1.0, 0.0, -2.0)), Bell(0.5, 0.1)])
def test_parity_is_that_of_the_values_about_the_middle(profile: Polynomial | Bell) -> None:
    np.testing.assert_allclose(profile(1.0 - T), profile.parity * profile(T), atol=1e-15)
    assert profile.parity in (1, -1)
    assert Polynomial((1.0, 1.0)).parity == Bell(0.4, 0.1).parity == 0


def test_polynomials_have_derivatives_by_s_and_products_of_which_equal_ones_are_one_key() -> None:
    cubic, s = Polynomial((1.0, 2.0, 3.0, 4.0)), 2 * T - 1
    np.testing.assert_allclose(cubic.derivative()(T), 2 + 6 * s + 12 * s**2, rtol=1e-14)
    np.testing.assert_allclose(cubic.derivative(2)(T), 6 + 24 * s, rtol=1e-13, atol=1e-14)
    points = np.stack((T, T**2), axis=-1)
    np.testing.assert_allclose(Product(LINE, power(2))(points), s * (2 * T**2 - 1) ** 2, atol=1e-15)
    assert len({Product(LINE, ONE), Product(power(1), Polynomial((1.0,)))}) == 1


@pytest.mark.parametrize("width", [0.2, 0.02, 0.002])
@pytest.mark.parametrize("centre", [0.5, 0.1, 0.0])
def test_quadrature_over_the_breaks_of_a_bell_integrates_it_times_a_polynomial(
    centre: float, width: float
) -> None:
    bell = Bell(centre, width)
    t, w = broken_quadrature(bell.breaks)
    fine = np.linspace(max(0.0, centre - 9 * width), min(1.0, centre + 9 * width), 400001)
    expected = np.trapezoid(bell(fine) * fine**8, fine)
    assert np.sum(w * bell(t) * t**8) == pytest.approx(expected, rel=1e-7, abs=1e-14)  # trapezoidal: 1e-9
    assert np.sum(w) == pytest.approx(1.0, rel=1e-14)


def test_a_shift_that_hits_an_eigenvalue_exactly_gives_its_vector_all_the_same() -> None:
    """The shift is 1e-11 off the given eigenvalue, which has an error of its own."""
    given = 1.0 / (1.0 + 1e-11)
    assert given * (1.0 + 1e-11) == 1.0  # the iteration matrix is exactly singular
    stiffness, sets = np.diag([1.0, 2.0, 5.0])[None], np.zeros(2, dtype=int)
    found = affine._iterated(stiffness, np.array([[given, 2.0]]), sets, np.array([0, 1]))
    np.testing.assert_allclose(np.abs(found), np.eye(3)[:2], atol=1e-9)


@pytest.mark.parametrize("diagonal", [True, False])
@pytest.mark.parametrize(("size", "wanted"), [(30, 7), (130, 7), (130, 70)])
def test_pairs_solve_the_problem_whatever_the_size(size: int, wanted: int, diagonal: bool) -> None:
    """Large blocks are solved in another way than small ones, and many pairs in a third."""
    rng = np.random.default_rng(size)
    roots = rng.standard_normal((4, size, size))
    stiffness, mass = (np.einsum("qij,qkj->qik", half, half) / size for half in (roots[:2], roots[2:]))
    mass = np.eye(size) * [[[1.0]], [[0.5]]] if diagonal else mass + np.eye(size)
    both = np.array([0, 1])
    matrices = AffineMatrix(stiffness, both), AffineMatrix(mass, both)
    block = affine.DenseBlock(*matrices, np.arange(size), (2, 2))
    k, m = rng.uniform(0.5, 2.0, (2, 3, 2))
    values, vectors = block.eigenpairs(k, m, wanted)
    np.testing.assert_allclose(values, block.eigenvalues(k, m, wanted), rtol=1e-9)
    sets, column = np.array([2, 0, 0, 2]), np.array([wanted - 1, 0, 3, 1])
    for phi, i, j in zip(vectors(sets, column), sets, column, strict=True):
        own_k, own_m = np.tensordot(k[i], stiffness, 1), np.tensordot(m[i], mass, 1)
        assert phi @ own_m @ phi == pytest.approx(1.0, rel=1e-9)
        np.testing.assert_allclose(own_k @ phi, values[i, j] * own_m @ phi, atol=1e-9 * np.abs(own_k).max())
