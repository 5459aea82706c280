"""Eigenvectors of dense blocks where an inverse iteration meets a singular matrix."""

import numpy as np

from cpam_bayes.affine import AffineMatrix, DenseBlock


def test_a_shift_that_hits_an_eigenvalue_exactly_gives_its_vector_all_the_same() -> None:
    """The shift lies 1e-11 beside the eigenvalue that it is given, which has an error of its own."""
    stiffness = np.diag([1.0, 2.0, 5.0])
    block = DenseBlock(
        AffineMatrix(stiffness[None], np.array([0])),
        AffineMatrix(np.eye(3)[None], np.array([0])),
        np.arange(3),
        (1, 1),
    )
    given = 1.0 / (1.0 + 1e-11)
    assert given * (1.0 + 1e-11) == 1.0  # the matrix of the iteration is singular to the last digit
    one, sets = np.ones((1, 1)), np.zeros(2, dtype=int)
    found = block.eigenvectors(one, one, sets, np.array([0, 1]), np.array([[given, 2.0]]))
    np.testing.assert_allclose(np.abs(found), np.eye(3)[:2], atol=1e-9)
