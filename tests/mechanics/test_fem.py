"""Finite elements: exact where they must be, in agreement with Ritz, and solved without missing a mode."""

from dataclasses import replace
from itertools import chain, combinations_with_replacement, product
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
from scipy.sparse.linalg import splu

from cpam_bayes.effects import add_known_mass
from cpam_bayes.mechanics.dense import MATRICES, discretise
from cpam_bayes.mechanics.fem import FemSpace, SparseBlock, discretise_sparse, fem_space, fem_space_from_mesh
from cpam_bayes.mechanics.modes import RigidBodyError, Spectrum, solve
from cpam_bayes.mechanics.problem import AREA, Atom, Form, PlateState, Problem, Region, Term, Values
from cpam_bayes.mechanics.ritz import Quadrature, RitzSettings, ritz_space
from cpam_bayes.plate.edges import EDGES, FIELDS
from cpam_bayes.plate.laminate import FIVE_SIXTHS, ShearModel
from tests.mechanics.test_closed_forms import navier_of
from tests.meshes import Quads, distorted, grid, rectangle
from tests.plates import ANGLE_PLY_16S, CARBON, CROSS_PLY_16S, GLASS, plate

ALUMINIUM = {"E1": 70e9, "nu12": 0.3}
AGREEMENT = 5e-4  # between finite elements and Ritz
FREE = {
    "C1": plate(0.26, 0.26, 0.0032, 1590.0, CARBON, CROSS_PLY_16S),
    "thick": plate(0.101, 0.053, 0.0035, 1550.0, CARBON, (0.0,)),
    "unsymmetric": plate(0.2, 0.15, 0.003, 1600.0, CARBON, (45.0, -45.0)),
    "very-thin": plate(0.3, 0.2, 0.0003, 1600.0, CARBON, (30.0, 0.0)),
}
# NAFEMS, Selected Benchmarks for Natural Frequency Analysis (R0015), FV15, FV22: clamped rhombi, 10 m sides
# at 45 degrees. Printed: early truncated series of Kirchhoff's and Mindlin's theory; converged: 0.5, 1 % off.
RHOMBIC = {
    "FV15": (0.05, [7.938, 12.835, 17.941, 19.133, 24.009, 27.922], 0.015),
    "FV22": (1.0, [133.95, 201.41, 265.81, 283.68, 334.45], 0.012),
}


def even(problem: Problem, n: int) -> FemSpace:
    return fem_space(problem.edges, problem.nominal, n, n, grading=None)


def spectrum(problem: Problem, space: FemSpace, n_modes: int) -> Spectrum:
    operator = discretise_sparse(problem, space, {})
    return solve(operator, *operator.coefficients({}), n_modes)


def fem_frequencies(problem: Problem, n_modes: int, *counts: int) -> np.ndarray:
    return spectrum(problem, fem_space(problem.edges, problem.nominal, *counts), n_modes).frequencies[0]


def ritz_frequencies(problem: Problem, n_modes: int, degree: int = 12) -> np.ndarray:
    space = ritz_space(problem.edges, problem.nominal, RitzSettings(degree, degree, 2, True))
    operator = discretise(problem, space, {})
    return solve(operator, *operator.coefficients({}), n_modes).frequencies[0]


def from_mesh(problem: Problem, quads: Quads, folder: Path) -> FemSpace:
    return fem_space_from_mesh(quads.write(folder / "plate.msh"), problem.edges, problem.nominal)


def test_frequency_error_falls_with_the_fourth_power_of_the_element_size() -> None:
    problem = plate(0.3, 0.2, 0.02, 1600.0, CARBON, (0.0, 90.0), "SSSS")
    exact = navier_of(problem, 6)
    error = [spectrum(problem, even(problem, n), 6).frequencies[0] / exact - 1.0 for n in (6, 12, 24)]
    coarse, fine = np.log2(error[0] / error[1]), np.log2(error[1] / error[2])
    assert np.all(coarse > 3.7), coarse
    np.testing.assert_allclose(fine, 4.0, atol=0.15)
    assert np.max(error[2]) < 1e-4


@pytest.mark.parametrize("thickness", [0.1, 0.01, 0.001])
def test_default_mesh_stays_accurate_as_the_plate_gets_thin(thickness: float) -> None:
    # the remaining locking falls with a high power of the element size: 3e-5 at h / a = 1/1000
    problem = plate(1.0, 1.0, thickness, 1000.0, ALUMINIUM, (0.0,), "SSSS")
    np.testing.assert_allclose(fem_frequencies(problem, 6), navier_of(problem, 6), rtol=1e-4)


def curved(folder: Path, problem: Problem, nodes: int) -> FemSpace:
    """A distorted mesh of a 200 x 150 rectangle; with 8 or 9 nodes its inner sides are curved."""
    quads = distorted(rectangle(200.0, 150.0, 4, 3, order=1 if nodes == 4 else 2), 0.02)
    return from_mesh(problem, replace(quads, cells=quads.cells[:, :nodes]), folder)


def strains(c: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    (_, ux, uy), (_, vx, vy), (_, wx, wy), px, py = c
    phi_x, phi_y = px[0] + px[1] * x + px[2] * y, py[0] + py[1] * x + py[2] * y
    constant = [ux, vy, uy + vx, px[1], py[2], px[2] + py[1]]
    return np.stack([np.full(len(x), s) for s in constant] + [wy + phi_y, wx + phi_x])


@pytest.mark.parametrize("nodes", [4, 8, 9])
def test_patch_of_linear_fields_has_its_exact_energy_and_mass(tmp_path: Path, nodes: int) -> None:
    shear = FIVE_SIXTHS if nodes == 4 else ShearModel(1e-10)  # curved cells: no shear, too high a degree
    problem = plate(0.2, 0.15, 0.01, 1600.0, CARBON, (30.0, -75.0, 10.0), shear=shear)
    space = curved(tmp_path, problem, nodes)
    (block,) = discretise_sparse(problem, space, {}).blocks
    k = block.stiffness.assemble(problem.coefficients({}, "stiffness"))
    g, w = np.polynomial.legendre.leggauss(3)
    x, y = (a.ravel() for a in np.meshgrid(0.1 * (1 + g), 0.075 * (1 + g)))
    weight = (np.outer(w, w) * 0.1 * 0.075).ravel()
    at = space.basis.doflocs * np.array(space.size)[:, None]
    for c in np.random.default_rng(1).standard_normal((5, 5, 3)):  # fields c0 + c1 x + c2 y, in metres
        e, v = strains(c, x, y), np.concatenate([a + b * at[0] + d * at[1] for a, b, d in c])[block.index]
        exact = np.einsum("in,ij,jn,n->", e, problem.nominal.stiffness(), e, weight)
        assert v @ (k @ v) == pytest.approx(exact, rel=1e-11)
    m = block.mass.assemble(problem.coefficients({}, "mass"))
    mass = 1600.0 * 0.01 * 0.2 * 0.15
    for i, expected in enumerate([mass] * 3 + [mass * 0.01**2 / 12] * 2):
        own = (block.index // space.basis.N == i) * 1.0
        assert own @ (m @ own) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("name", FREE)
@pytest.mark.parametrize("n", [2, 3, 4, 8])
def test_free_plate_has_six_rigid_motions_and_no_hourglass(name: str, n: int) -> None:
    problem = FREE[name]
    found = spectrum(problem, even(problem, n), 3)
    assert np.abs(found.rigid).max() < 1e-8 * found.eigenvalues[0, 0]
    assert found.frequencies[0, 0] > 0.999 * fem_frequencies(problem, 1, 10, 10)[0]  # no soft mechanism
    with pytest.raises(RigidBodyError, match="leave 6 rigid-body motions"):  # a single element has one
        spectrum(problem, even(problem, 1), 3)


AGREEING = {  # A plate, and its number of modes.
    "C1": (FREE["C1"], 6),
    "A2": (plate(0.25, 0.28, 0.003, 2700.0, {"E1": 69e9, "nu12": 0.33}, (0.0,), "CFFF"), 6),
    "D1": (plate(0.101, 0.053, 0.0035, 1550.0, CARBON | {"G23": 3.0e9}, (0.0,)), 10),
    "D4": (plate(0.12, 0.06, 0.0035, 1590.0, GLASS, ANGLE_PLY_16S, "CFFF"), 10),
    "off-axis": (plate(0.2815, 0.2455, 0.002, 1540.0, CARBON, (30.0,)), 6),
    "clamped": (plate(0.2, 0.15, 0.003, 1600.0, CARBON, CROSS_PLY_16S, "CCCC"), 10),
    "thick": (plate(0.1, 0.08, 0.01, 1600.0, CARBON, (20.0, 70.0, 70.0, 20.0)), 10),
}
for _name, _layup in (("cross", (0.0, 90.0)), ("angle", (45.0, -45.0))):
    for _edges in ("FFFF", "CFFF", "SSSS", "CSFC"):
        AGREEING[f"{_name}-{_edges}"] = plate(0.2, 0.15, 0.004, 1600.0, CARBON, _layup, _edges), 10
# Every pair of opposite edges along x with two of those along y; reflected plates are left out.
_PAIRS = list(combinations_with_replacement("FSC", 2))
for _i, _j in product(range(6), (1, 4)):
    _edges = "".join(chain(*zip(_PAIRS[_i], _PAIRS[(_i + _j) % 6], strict=True)))
    AGREEING[_edges] = plate(0.2, 0.15, 0.006, 1600.0, GLASS, (0.0, 90.0, 90.0, 0.0), _edges), 6


@pytest.mark.parametrize("name", AGREEING)
def test_finite_elements_agree_with_ritz(name: str) -> None:
    problem, n = AGREEING[name]
    degree = 18 if name in ("D4", "A2", "clamped", "angle-CFFF") else 12 if name == problem.edges else 14
    found = fem_frequencies(problem, n, *((22, 16) if name == problem.edges else ()))
    np.testing.assert_allclose(found, ritz_frequencies(problem, n, degree), rtol=AGREEMENT)


def shifts(problem: Problem, bare: Problem, n_modes: int) -> list[np.ndarray]:
    return [of(problem, n_modes) / of(bare, n_modes) - 1.0 for of in (fem_frequencies, ritz_frequencies)]


def test_a_point_mass_has_the_effect_that_it_has_with_ritz() -> None:
    bare = plate(0.2, 0.15, 0.004, 1600.0, GLASS, (0.0, 90.0, 90.0, 0.0))
    shift, expected = shifts(add_known_mass(bare, 0.004, 0.19, 0.14), bare, 5)
    assert shift.min() < -0.01
    np.testing.assert_allclose(shift, expected, atol=5e-5)  # rotary inertia excites a layer at the point


@pytest.mark.parametrize("edge", EDGES)
def test_springs_along_an_edge_have_the_effect_that_they_have_with_ritz(edge: str) -> None:
    bare = plate(0.2, 0.15, 0.004, 1600.0, GLASS, (0.0, 90.0, 90.0, 0.0), "CFFF")
    form = Form(Atom("w"), Atom("w"), Region("edge", edge=edge), lambda points: 1.0 + points.sum(axis=1))
    spring = Term("spring", "stiffness", (form,), lambda state, values: np.array([3e4]))
    shift, expected = shifts(bare.with_terms(spring), bare, 4)
    assert shift.max() > 0.01 or edge == "x0"
    np.testing.assert_allclose(shift, expected, rtol=2e-3, atol=2e-4)


def test_functions_are_found_at_any_point_and_are_zero_off_the_plate(tmp_path: Path) -> None:
    space = curved(tmp_path, plate(0.2, 0.15, 0.01, 1600.0, CARBON), 9)
    inside = np.random.default_rng(3).random((50, 2))
    points = np.concatenate((inside, [[0.0, 0.0], [1.0, 1.0], [1.2, 0.5], [-0.1, 0.5]]))
    x, y = space.basis.doflocs
    rule = Quadrature(Region("point"), points, np.ones(len(points)))
    on, area = np.arange(len(points)) < 52, space.quadrature(AREA)
    searched = Quadrature(AREA, area.points, area.weights)
    for derivative, expected in (("", 1 + 2 * points[:, 0] - points[:, 1]), ("x", 2.0), ("y", -1.0)):
        found = space.evaluate("v", rule, derivative) @ (1 + 2 * x - y)
        np.testing.assert_allclose(found, np.where(on, expected, 0.0), atol=1e-11)
        # the area's rule knows its cells, the other searches for them
        known, sought = (space.evaluate("w", rule, derivative) for rule in (area, searched))
        assert abs(known - sought).max() < 1e-9


def test_wrong_requests_are_refused(tmp_path: Path) -> None:
    problem = plate(0.2, 0.15, 0.01, 1600.0, CARBON)
    with pytest.raises(ValueError, match=r"received \[0, 4\], accepted: 1 or more"):
        fem_space("FFFF", problem.nominal, 0, 4)
    space = from_mesh(problem, rectangle(200.0, 150.0, 2, 2).without("x1"), tmp_path)
    with pytest.raises(ValueError, match=r"'x1' is not on the mesh, which has \['x0', 'y0', 'y1'\]"):
        space.quadrature(Region("edge", edge="x1"))
    with pytest.raises(ValueError, match=r"\(0.22, 0.03\) m is not on the plate's mesh"):
        space.quadrature(Region("point", point=(1.1, 0.2)))


def test_a_rectangle_from_a_file_is_the_built_one(tmp_path: Path) -> None:
    problem = plate(0.2, 0.15, 0.004, 1600.0, CARBON, (45.0, -45.0), "CSFF")
    built = fem_space("CSFF", problem.nominal, 5, 4, grading=None)
    read = from_mesh(problem, rectangle(200.0, 150.0, 5, 4), tmp_path)
    for field in FIELDS:
        assert read.dimension(field) == built.dimension(field)
    of_read, of_built = (spectrum(problem, space, 6).frequencies for space in (read, built))
    np.testing.assert_allclose(of_read, of_built, rtol=1e-10)


@pytest.mark.parametrize("name", RHOMBIC)
def test_clamped_rhombic_plate_matches_nafems(tmp_path: Path, name: str) -> None:
    thickness, target, tolerance = RHOMBIC[name]
    problem = plate(10.0, 10.0, thickness, 8000.0, {"E1": 200e9, "nu12": 0.3}, (0.0,), "CCCC")
    side, c = 10e3, np.sqrt(0.5)
    found = []
    for n in (12, 24):
        s = np.linspace(0, 1, n + 1)
        rhombus = grid(s, s, lambda a, b: (side * (a + c * b), side * c * b))
        found.append(spectrum(problem, from_mesh(problem, rhombus, tmp_path), len(target)).frequencies[0])
    np.testing.assert_allclose(found[1], target, rtol=tolerance)
    assert np.all(found[1] < found[0] * (1 + 1e-6)), "refinement lowers frequencies"


def test_an_oblique_edge_has_its_own_length_and_no_simple_support(tmp_path: Path) -> None:
    s = np.linspace(0, 1, 4)
    quads = grid(s, s, lambda a, b: ((200.0 - 40.0 * b) * a, 150.0 * b))
    space = from_mesh(plate(0.2, 0.15, 0.004, 1600.0, CARBON, (0.0,), "SFCF"), quads, tmp_path)
    for edge, size, length in (("x1", 0.15, np.hypot(0.04, 0.15)), ("y1", 0.2, 0.16)):
        weights = space.quadrature(Region("edge", edge=edge)).weights
        assert weights.sum() * size == pytest.approx(length, rel=1e-12)
    oblique = plate(0.2, 0.15, 0.004, 1600.0, CARBON, (0.0,), "CFSF")
    with pytest.raises(ValueError, match=r"'x1' is simply supported but not one straight line of"):
        from_mesh(oblique, quads, tmp_path)


def dense_matrix(problem: Problem, space: FemSpace, values: Values, kind: str) -> np.ndarray:
    starts = np.cumsum([0, *(space.dimension(f) for f in FIELDS)])
    place = {f: slice(a, b) for f, a, b in zip(FIELDS, starts[:-1], starts[1:], strict=True)}
    matrix = np.zeros((starts[-1], starts[-1]))
    coefficients = problem.coefficients(values, kind)
    for form, c in zip(problem.forms(kind), coefficients, strict=True):
        rule = space.quadrature(form.region, kind)
        atoms = form.left, form.right
        left, right = (space.evaluate(a.field, rule, a.derivative).toarray() for a in atoms)
        own = np.zeros_like(matrix)
        own[place[form.left.field], place[form.right.field]] = left.T @ (rule.weights[:, None] * right)
        matrix += c * (own if form.left == form.right else own + own.T)
    return matrix


@pytest.mark.parametrize("layup", [(0.0, 90.0, 90.0, 0.0), (30.0, -75.0)], ids=["sym", "unsym"])
def test_blocks_assemble_what_dense_matrices_give(layup: tuple[float, ...]) -> None:
    problem = add_known_mass(plate(0.2, 0.15, 0.006, 1600.0, CARBON, layup, "CSFF"), 0.01, 0.1, 0.1)
    space = even(problem, 3)
    operator = discretise_sparse(problem, space, {})
    covered = np.concatenate([b.index for b in operator.blocks])
    assert sorted(covered) == list(range(sum(space.dimension(f) for f in FIELDS)))
    for kind in MATRICES:
        dense = dense_matrix(problem, space, {}, kind)
        scale = np.abs(dense).max()
        for block in operator.blocks:
            matrix = getattr(block, kind).assemble(problem.coefficients({}, kind)).toarray()
            np.testing.assert_allclose(matrix, dense[np.ix_(block.index, block.index)], atol=1e-13 * scale)
            dense[np.ix_(block.index, block.index)] = 0.0
        assert np.abs(dense).max() <= 1e-13 * scale, "blocks do not couple"


def test_symmetric_laminates_split_and_forms_that_only_some_samples_need_are_kept() -> None:
    problem = plate(0.2, 0.15, 0.006, 1600.0, CARBON)
    angles = np.array([[0.0, 0.0], [0.0, 90.0]])  # symmetric, and not

    def state(values: Values) -> PlateState:
        layup = angles[np.asarray(values["which"], dtype=int)]
        return replace(problem.nominal, layup=layup, symmetric=False)

    choosing = replace(problem, state=state)
    n = 40  # 3 x 3 elements of 8 nodes
    for which, expected in (([0, 0], [2 * n, 3 * n]), ([0, 1], [5 * n])):
        found = discretise_sparse(choosing, even(problem, 3), {"which": np.array(which)})
        assert [b.size for b in found.blocks] == expected


def test_a_block_as_small_as_what_is_asked_of_it_is_solved() -> None:
    problem = plate(0.2, 0.15, 0.006, 1600.0, CARBON, (0.0,), "CCCC")
    operator = discretise_sparse(problem, even(problem, 2), {})
    assert [b.size for b in operator.blocks] == [10, 15]
    k, m = operator.coefficients({})
    pairs = [(b.stiffness.assemble(k).toarray(), b.mass.assemble(m).toarray()) for b in operator.blocks]
    expected = np.sort(np.concatenate([scipy.linalg.eigh(*pair, eigvals_only=True) for pair in pairs]))
    for n in (20, 25):
        np.testing.assert_allclose(solve(operator, k, m, n).eigenvalues[0], expected[:n], rtol=1e-9)
    with pytest.raises(ValueError, match="26 modes asked for, the space has 25"):
        solve(operator, k, m, 26)


def count_below(block: SparseBlock, stiffness: np.ndarray, mass: np.ndarray, value: float) -> int:
    """Number of eigenvalues below a value, that of negative pivots of K - value M (Sylvester)."""
    matrix = block.stiffness.assemble(stiffness) - value * block.mass.assemble(mass)
    symmetric = {"diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
    factor = splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", **symmetric)
    assert np.array_equal(factor.perm_r, factor.perm_c)
    return int(np.sum(factor.U.diagonal() < 0))


@pytest.mark.parametrize("edges", ["FFFF", "SSSS", "CCCC"])
@pytest.mark.parametrize("thickness", [0.002, 0.05])
def test_no_mode_of_a_square_plate_is_missed(edges: str, thickness: float) -> None:
    # isotropic squares have equal pairs, of which Lanczos may find one, and the triple (1,7), (7,1), (5,5)
    problem = plate(0.2, 0.2, thickness, 1000.0, ALUMINIUM, (0.0,), edges)
    operator = discretise_sparse(problem, even(problem, 10), {})
    k, m = operator.coefficients({})
    for block in operator.blocks:
        lam = block.eigenvalues(k[None], m[None], 60)[0]
        gaps = np.flatnonzero(lam[1:] > lam[:-1] * (1 + 1e-4))
        gaps = gaps[lam[gaps] > 1e-3 * lam[10]]
        for i in gaps[::6]:
            assert count_below(block, k, m, (lam[i] + lam[i + 1]) / 2) == i + 1
        for n in (4, 5, 8, 13, 21):
            fewer = block.eigenvalues(k[None], m[None], n)[0]
            np.testing.assert_allclose(fewer, lam[:n], rtol=1e-8, atol=1e-9 * lam[10])


def test_solving_twice_gives_the_same_bits_and_leaves_the_operator_alone() -> None:
    problem = plate(0.2, 0.2, 0.004, 1600.0, ALUMINIUM)
    operator = discretise_sparse(problem, even(problem, 6), {})
    first, again = (solve(operator, *operator.coefficients({}), 6).eigenvalues for _ in range(2))
    np.testing.assert_array_equal(again, first)
    pattern = operator.blocks[0].stiffness.pattern
    assert pattern is operator.blocks[0].mass.pattern
    assert not any(array.flags.writeable for array in (pattern.rows, pattern.columns, pattern.starts))


@pytest.mark.parametrize("scale", [0.1, 1.0, 10.0])
def test_the_shift_serves_stiffnesses_far_from_the_nominal_one(scale: float) -> None:
    operator = discretise_sparse(FREE["C1"], even(FREE["C1"], 8), {})  # f scales with the root of K
    k, m = operator.coefficients({})
    found = solve(operator, scale**2 * k, m, 6).frequencies
    np.testing.assert_allclose(found, scale * solve(operator, k, m, 6).frequencies, rtol=1e-8)
