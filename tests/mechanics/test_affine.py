"""Dense blocks and the weights of forms: eigenpairs, values, parities, and the quadratures needed."""

from __future__ import annotations

import numpy as np
import pytest

from cpam_bayes.mechanics.affine import (
    LINE,
    ONE,
    AffineMatrix,
    Bell,
    DenseBlock,
    Polynomial,
    Product,
    _iterated,
    power,
)
from cpam_bayes.mechanics.ritz import broken_quadrature

T = np.linspace(0.0, 1.0, 11)


@pytest.mark.parametrize("profile", [ONE, LINE, power(4), Polynomial((1.0, 0.0, -2.0)), Bell(0.5, 0.1)])
def test_parity_is_that_of_the_values_about_the_middle(profile: Polynomial | Bell) -> None:
    np.testing.assert_allclose(profile(1.0 - T), profile.parity * profile(T), atol=1e-15)
    assert profile.parity in (1, -1)


@pytest.mark.parametrize("profile", [Polynomial((1.0, 1.0)), Bell(0.4, 0.1)])
def test_a_profile_without_symmetry_has_no_parity(profile: Polynomial | Bell) -> None:
    assert profile.parity == 0


def test_derivative_of_a_polynomial_is_with_respect_to_s() -> None:
    cubic = Polynomial((1.0, 2.0, 3.0, 4.0))
    s = 2 * T - 1
    np.testing.assert_allclose(cubic.derivative()(T), 2 + 6 * s + 12 * s**2, rtol=1e-14)
    np.testing.assert_allclose(cubic.derivative(2)(T), 6 + 24 * s, rtol=1e-13, atol=1e-14)


def test_a_product_multiplies_its_factors_and_equal_ones_are_one_key() -> None:
    points = np.stack((T, T**2), axis=-1)
    np.testing.assert_allclose(Product(LINE, power(2))(points), (2 * T - 1) * (2 * T**2 - 1) ** 2, atol=1e-15)
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
    # the trapezoidal rule that is compared with errs by 1e-9
    assert np.sum(w * bell(t) * t**8) == pytest.approx(expected, rel=1e-7, abs=1e-14)
    assert np.sum(w) == pytest.approx(1.0, rel=1e-14)


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
