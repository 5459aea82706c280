"""Sparse affine operators against their dense twins, and the eigensolver on hard cases."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from scipy.sparse.linalg import splu

from cpam_bayes.effects import add_known_mass
from cpam_bayes.mechanics.dense import MATRICES, discretise
from cpam_bayes.mechanics.fem import FemSpace, SparseBlock, SparseOperator, discretise_sparse, fem_space
from cpam_bayes.mechanics.modes import describe_modes, solve
from cpam_bayes.mechanics.problem import PlateState, Problem, Values
from cpam_bayes.mechanics.ritz import RitzSettings, ritz_space
from cpam_bayes.plate.edges import FIELDS
from tests.plates import CARBON, CROSS_PLY_16S, GLASS, plate

ALUMINIUM = {"E1": 70e9, "nu12": 0.3}


def small(problem: Problem, n: int = 3) -> FemSpace:
    return fem_space(problem.edges, problem.nominal, n, n, grading=None)


def dense_matrix(problem: Problem, space: FemSpace, values: Values, kind: str) -> np.ndarray:
    """The matrix of all forms by B_left^T W B_right, with nothing left out."""
    starts = np.cumsum([0, *(space.dimension(f) for f in FIELDS)])
    place = {f: slice(a, b) for f, a, b in zip(FIELDS, starts[:-1], starts[1:], strict=True)}
    matrix = np.zeros((starts[-1], starts[-1]))
    coefficients = problem.coefficients(values, kind)
    for form, c in zip(problem.forms(kind), coefficients, strict=True):
        rule = space.quadrature(form.region, kind)
        left = space.evaluate(form.left.field, rule, form.left.derivative).toarray()
        right = space.evaluate(form.right.field, rule, form.right.derivative).toarray()
        own = np.zeros_like(matrix)
        own[place[form.left.field], place[form.right.field]] = left.T @ (rule.weights[:, None] * right)
        matrix += c * (own if form.left == form.right else own + own.T)
    return matrix


@pytest.mark.parametrize("layup", [(0.0, 90.0, 90.0, 0.0), (30.0, -75.0)], ids=["sym", "unsym"])
def test_blocks_assemble_what_dense_matrices_give(layup: tuple[float, ...]) -> None:
    problem = add_known_mass(plate(0.2, 0.15, 0.006, 1600.0, CARBON, layup, "CSFF"), 0.01, 0.1, 0.1)
    space = small(problem)
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
    n = 40  # nodes of 3 x 3 elements of 8 nodes
    for which, expected in (([0, 0], [2 * n, 3 * n]), ([0, 1], [5 * n])):
        found = discretise_sparse(choosing, small(problem), {"which": np.array(which)})
        assert [b.size for b in found.blocks] == expected


def spectrum_of(operator: SparseOperator, values: Values, n_modes: int) -> np.ndarray:
    return solve(operator, *operator.coefficients(values), n_modes).eigenvalues


def test_a_block_as_small_as_what_is_asked_of_it_is_solved() -> None:
    problem = plate(0.2, 0.15, 0.006, 1600.0, CARBON, (0.0,), "CCCC")
    space = small(problem, 2)
    operator = discretise_sparse(problem, space, {})
    assert [b.size for b in operator.blocks] == [10, 15]
    k, m = operator.coefficients({})
    dense = [scipy.linalg.eigh(
        b.stiffness.assemble(k).toarray(), b.mass.assemble(m).toarray(), eigvals_only=True
    ) for b in operator.blocks]  # fmt: skip
    expected = np.sort(np.concatenate(dense))
    np.testing.assert_allclose(spectrum_of(operator, {}, 20)[0], expected[:20], rtol=1e-9)
    np.testing.assert_allclose(spectrum_of(operator, {}, 25)[0], expected, rtol=1e-9)
    with pytest.raises(ValueError, match="26 modes asked for, the space has 25"):
        spectrum_of(operator, {}, 26)


def count_below(block: SparseBlock, stiffness: np.ndarray, mass: np.ndarray, value: float) -> int:
    """Eigenvalues below a value, as many as K - value M has negative pivots (Sylvester)."""
    matrix = block.stiffness.assemble(stiffness) - value * block.mass.assemble(mass)
    factor = splu(
        matrix.tocsc(),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    assert np.array_equal(factor.perm_r, factor.perm_c)
    return int(np.sum(factor.U.diagonal() < 0))


@pytest.mark.parametrize("edges", ["FFFF", "SSSS", "CCCC"])
@pytest.mark.parametrize("thickness", [0.002, 0.05])
def test_no_mode_of_a_square_plate_is_missed(edges: str, thickness: float) -> None:
    # isotropic squares have equal pairs, of which Lanczos may find one; (1,7), (7,1) and (5,5) of
    # the simply supported one are three
    problem = plate(0.2, 0.2, thickness, 1000.0, ALUMINIUM, (0.0,), edges)
    operator = discretise_sparse(problem, small(problem, 10), {})
    k, m = operator.coefficients({})
    for block in operator.blocks:
        lam = block.eigenvalues(k[None], m[None], 60)[0]
        gaps = np.flatnonzero(lam[1:] > lam[:-1] * (1 + 1e-4))
        gaps = gaps[lam[gaps] > 1e-3 * lam[10]]
        for i in gaps[::6]:
            middle = (lam[i] + lam[i + 1]) / 2
            assert count_below(block, k, m, middle) == i + 1
        for n in (4, 5, 8, 13, 21):
            fewer = block.eigenvalues(k[None], m[None], n)[0]
            np.testing.assert_allclose(fewer, lam[:n], rtol=1e-8, atol=1e-9 * lam[10])


def test_solving_twice_gives_the_same_bits_and_leaves_the_operator_alone() -> None:
    problem = plate(0.2, 0.2, 0.004, 1600.0, ALUMINIUM)
    operator = discretise_sparse(problem, small(problem, 6), {})
    first = spectrum_of(operator, {}, 6)
    np.testing.assert_array_equal(spectrum_of(operator, {}, 6), first)
    pattern = operator.blocks[0].stiffness.pattern
    assert pattern is operator.blocks[0].mass.pattern
    assert not any(array.flags.writeable for array in (pattern.rows, pattern.columns, pattern.starts))


@pytest.mark.parametrize("scale", [0.1, 1.0, 10.0])
def test_the_shift_serves_stiffnesses_far_from_the_nominal_one(scale: float) -> None:
    # frequencies of a plate whose stiffness is scaled as a whole are scaled by the root
    problem = plate(0.26, 0.26, 0.0032, 1590.0, CARBON, CROSS_PLY_16S)
    operator = discretise_sparse(problem, small(problem, 8), {})
    k, m = operator.coefficients({})
    found = solve(operator, scale**2 * k, m, 6).frequencies
    np.testing.assert_allclose(found, scale * solve(operator, k, m, 6).frequencies, rtol=1e-8)


def test_modes_have_the_kinds_and_labels_that_they_have_with_ritz() -> None:
    problem = plate(0.12, 0.06, 0.0035, 1590.0, GLASS, CROSS_PLY_16S, "CFFF")
    ritz = discretise(problem, ritz_space("CFFF", problem.nominal, RitzSettings(12, 12)), {})
    fem = discretise_sparse(problem, fem_space("CFFF", problem.nominal, 16, 12), {})
    k, m = fem.coefficients({})
    first, second = (
        describe_modes(operator, solve(operator, k, m, 8, vectors=True), m) for operator in (ritz, fem)
    )
    assert [(a.kind, a.label) for a in first] == [(b.kind, b.label) for b in second]
    assert {a.kind for a in second} == {"bending", "in-plane"}
