"""Eigenpairs of dense blocks: small and large ones, and an inverse iteration with a singular matrix."""

import numpy as np
import pytest

from cpam_bayes.mechanics.affine import AffineMatrix, DenseBlock, _iterated


def test_a_shift_that_hits_an_eigenvalue_exactly_gives_its_vector_all_the_same() -> None:
    """The shift lies 1e-11 beside the eigenvalue that it is given, which has an error of its own."""
    given = 1.0 / (1.0 + 1e-11)
    assert given * (1.0 + 1e-11) == 1.0  # the matrix of the iteration is singular to the last digit
    stiffness, sets = np.diag([1.0, 2.0, 5.0])[None], np.zeros(2, dtype=int)
    found = _iterated(stiffness, np.array([[given, 2.0]]), sets, np.array([0, 1]))
    np.testing.assert_allclose(np.abs(found), np.eye(3)[:2], atol=1e-9)


@pytest.mark.parametrize("diagonal", [True, False])
@pytest.mark.parametrize(("size", "wanted"), [(30, 7), (130, 7), (130, 70)])
def test_pairs_solve_the_problem_whatever_the_size(size: int, wanted: int, diagonal: bool) -> None:
    """Large blocks are solved in another way than small ones, for many pairs in a third."""
    rng = np.random.default_rng(size)
    roots = rng.standard_normal((4, size, size))
    stiffness, mass = (np.einsum("qij,qkj->qik", half, half) / size for half in (roots[:2], roots[2:]))
    mass = np.eye(size) * [[[1.0]], [[0.5]]] if diagonal else mass + np.eye(size)
    both = np.array([0, 1])
    block = DenseBlock(AffineMatrix(stiffness, both), AffineMatrix(mass, both), np.arange(size), (2, 2))
    k, m = rng.uniform(0.5, 2.0, (2, 3, 2))
    values, vectors = block.eigenpairs(k, m, wanted)
    np.testing.assert_allclose(values, block.eigenvalues(k, m, wanted), rtol=1e-9)
    sets, column = np.array([2, 0, 0, 2]), np.array([wanted - 1, 0, 3, 1])
    for phi, i, j in zip(vectors(sets, column), sets, column, strict=True):
        own_k, own_m = np.tensordot(k[i], stiffness, 1), np.tensordot(m[i], mass, 1)
        assert phi @ own_m @ phi == pytest.approx(1.0, rel=1e-9)
        np.testing.assert_allclose(own_k @ phi, values[i, j] * own_m @ phi, atol=1e-9 * np.abs(own_k).max())
