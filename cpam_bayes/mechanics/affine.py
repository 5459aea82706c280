"""Discretised problems: K(p) = sum_q theta_q(p) K_q and M(p) = sum_q mu_q(p) M_q, dense or sparse.

Forms on the reference square are weighted by products of one function of xi and one of eta, which keep the
tensor structure of a Ritz space; the parities of the factors determine which symmetries of the plate remain.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
import scipy.linalg
from numpy.polynomial import polynomial
from numpy.typing import NDArray
from scipy.linalg import lapack, solve_triangular

from cpam_bayes.mechanics.problem import Problem, Values
from cpam_bayes.mechanics.ritz import RitzSpace, Space
from cpam_bayes.running import matrix_by_matrix

Array = NDArray[Any]
SpaceT = TypeVar("SpaceT", bound=Space, covariant=True)
BlockT = TypeVar("BlockT", bound="Block", covariant=True)


# Off-diagonal fraction of a mass matrix due to the quadrature of orthonormal functions.
_ROUNDING = 1e-13


@dataclass(frozen=True)
class AffineMatrix:
    """A symmetric matrix that is a sum of fixed matrices times coefficients, on one block.

    ``stack`` (n_active, n, n) holds the matrices, ``active`` (n_active,) the coefficients they
    belong to.
    """

    stack: Array
    active: Array

    @cached_property
    def is_diagonal(self) -> bool:
        """Whether every matrix of the sum is diagonal, up to the rounding of its integrals."""
        size = np.abs(self.stack).max(axis=0, initial=0.0)
        off = size - np.diag(np.diagonal(size))
        return bool(off.max(initial=0.0) <= _ROUNDING * size.max(initial=0.0))

    def assemble(self, coefficients: Array) -> Array:
        """The matrix at coefficients (..., n_terms), (..., n, n)."""
        n = self.stack.shape[-1]
        flat = coefficients[..., self.active] @ self.stack.reshape(len(self.active), n * n)
        return flat.reshape(*coefficients.shape[:-1], n, n)

    def restricted(self, keep: Array) -> AffineMatrix:
        """The sum on some of the trial functions, ``keep`` (n,) bool."""
        return AffineMatrix(self.stack[:, keep][:, :, keep], self.active)

    def project(self, basis: Array) -> AffineMatrix:
        """The sum on the span of ``basis`` (n, r), exactly symmetric."""
        stack = basis.T @ (self.stack @ basis)
        return AffineMatrix(0.5 * (stack + np.swapaxes(stack, 1, 2)), self.active)

    def diagonals(self, n_terms: int) -> Array:
        """Diagonal of the matrix of every term, (n_terms, n)."""
        out = np.zeros((n_terms, self.stack.shape[-1]))
        out[self.active] = np.diagonal(self.stack, axis1=1, axis2=2)
        return out

    def norms(self, n_terms: int) -> Array:
        """Norm of the matrix of every term, (n_terms,)."""
        out = np.zeros(n_terms)
        out[self.active] = [np.linalg.norm(matrix.ravel()) for matrix in self.stack]
        return out

    def combined(self, kept: Array, relation: Array) -> AffineMatrix:
        """The sum in fewer terms, its coefficients being those kept (n_kept,) times ``relation``."""
        return AffineMatrix(np.tensordot(relation[:, self.active], self.stack, 1), kept)


def relations(coefficients: Array, norms: Array) -> tuple[Array, Array]:
    """Independent terms of a sum, (n_kept,), and all coefficients as sums of theirs, (n_kept, n_terms).

    coefficients : at many parameter sets (m, n_terms), which show the linear relations between them. norms :
    of the matrices, (n_terms,): negligible terms are left out
    """
    size = np.abs(coefficients).max(axis=0)
    norm = norms * size
    (present,) = np.nonzero(norm > 1e-14 * norm.max(initial=0.0))
    if not len(present):  # rigid-body motions alone
        return present, np.zeros((0, len(norms)))
    c = coefficients[:, present]
    scale = norm[present] / norm.max() / size[present]
    scaled = c * scale
    _, r, pivots = scipy.linalg.qr(scaled, mode="economic", pivoting=True)
    rank = int(np.count_nonzero(np.abs(np.diagonal(r)) > 1e-11 * abs(r[0, 0])))
    kept = np.sort(pivots[:rank])
    found = np.linalg.lstsq(scaled[:, kept], scaled, rcond=None)[0]  # scaled = scaled[:, kept] @ found
    found[np.abs(found) < 1e-13 * np.abs(found).max(axis=0)] = 0.0
    relation = np.zeros((rank, len(norms)))
    relation[:, present] = scale[kept, None] * found / scale
    return present[kept], relation


# M-normalised eigenvectors (k, size) of some modes, from (k,) the coefficient set of each and (k,) the index
# of its eigenvalue.
ModeVectors = Callable[[Array, Array], Array]


class Block(Protocol):
    """The protocol that trial functions which couple only among themselves offer to an eigensolver.

    Coefficients are (m, n_stiffness) and (m, n_mass), as from ``AffineOperator.coefficients``.
    """

    @property
    def size(self) -> int:
        """Number of trial functions."""
        ...

    def eigenvalues(self, stiffness: Array, mass: Array, n: int) -> Array:
        """The n lowest eigenvalues of m coefficient sets, (m, n)."""
        ...

    def eigenpairs(self, stiffness: Array, mass: Array, n: int) -> tuple[Array, ModeVectors]:
        """The n lowest eigenvalues of m coefficient sets, (m, n), and a function for their vectors."""
        ...

    def energies(self, vectors: Array) -> tuple[Array, Array]:
        """phi^T K_q phi and phi^T M_q phi of vectors (k, size) for every term, (k, n_terms) each."""
        ...


class RitzBlock(Block, Protocol):
    """The protocol of a block of a dense space."""

    @property
    def index(self) -> Array:
        """Positions of the trial functions in the whole space, (n,)."""
        ...

    @property
    def n_terms(self) -> tuple[int, int]:
        """Numbers of coefficients of K and M."""
        ...

    def modes(self, stiffness: Array, mass: Array, n: int) -> tuple[Array, Array]:
        """The n lowest eigenvalues of m coefficient sets, (m, n), and their vectors, (m, n, size)."""
        ...

    def lowest(self, near: Array, n: int, kept: Sequence[Array]) -> list[Array]:
        """The n lowest eigenvalues of each term of K with that of M, on subsets of functions, (m, n) each."""
        ...

    def stiffness_at(self, stiffness: Array) -> Array:
        """K at one coefficient set (n_terms,), (n, n)."""
        ...

    def mass_at(self, mass: Array) -> Array:
        """M at one coefficient set (n_terms,), (n, n)."""
        ...

    def diagonals(self) -> tuple[Array, Array]:
        """Diagonals of K and M for every term, (n_terms, n) each."""
        ...

    def restricted(self, keep: Array, number: Array) -> RitzBlock:
        """The block on the trial functions marked in ``keep``, renumbered by ``number`` for another space."""
        ...

    def compressed(self, stiffness: Array, mass: Array) -> RitzBlock:
        """The block reduced to the independent directions of coefficients (m, n_terms)."""
        ...

    def project(self, basis: Array) -> DenseBlock:
        """The block on the span of ``basis`` (n, r)."""
        ...

    def dense(self) -> DenseBlock:
        """The block with all its matrices explicit."""
        ...


@dataclass(frozen=True, slots=True)
class DenseBlock:
    """A block of a dense space. index : (n,) positions of its trial functions in the whole space."""

    stiffness: AffineMatrix
    mass: AffineMatrix
    index: Array
    n_terms: tuple[int, int]

    @property
    def size(self) -> int:
        """Number of trial functions."""
        return len(self.index)

    def _whitened(self, stiffness: Array, mass: Array) -> tuple[Array, Array]:
        """K where M is the identity (lower half for a large block), and the map for ``_mapped``.

        That is M^-1/2 (m, n) where M is diagonal, else, with M = L L^T, L^-T (m, n, n), L of a large block.
        """
        k = self.stiffness.assemble(stiffness)
        if self.mass.is_diagonal:
            diagonal = np.diagonal(self.mass.stack, axis1=1, axis2=2)
            scale = 1.0 / np.sqrt(mass[..., self.mass.active] @ diagonal)
            k *= scale[..., :, None]
            k *= scale[..., None, :]
            return k, scale
        if self.size > _LARGE:  # less work than a product with the inverse
            factor = np.linalg.cholesky(self.mass.assemble(mass))
            for one, root in zip(k, factor, strict=True):
                lapack.dsygst(one.T, root.T, overwrite_a=1)
            return k, factor
        inverse = inverse_roots(self.mass.assemble(mass))
        back = np.swapaxes(inverse, -1, -2)
        return inverse @ k @ back, back

    def eigenvalues(self, stiffness: Array, mass: Array, n: int) -> Array:
        """The n lowest eigenvalues of m coefficient sets, (m, n)."""
        return _lowest(self._whitened(stiffness, mass)[0], n)

    def eigenpairs(self, stiffness: Array, mass: Array, n: int) -> tuple[Array, ModeVectors]:
        """The n lowest eigenvalues of m coefficient sets, (m, n), and a function for their vectors.

        Vectors of a small block take one inverse iteration each, those of a large one come with the values.
        """
        k, back = self._whitened(stiffness, mass)
        if self.size > _LARGE:
            pairs = [_lowest_pairs(matrix, n) for matrix in k]
            values = np.stack([pair[0] for pair in pairs])
            vectors = np.stack([pair[1].T for pair in pairs])
            return values, lambda sets, column: _mapped(back, sets, vectors[sets, column])
        values = _lowest(k, n)
        return values, lambda sets, column: _mapped(back, sets, _iterated(k, values, sets, column))

    def modes(self, stiffness: Array, mass: Array, n: int) -> tuple[Array, Array]:
        """The n lowest eigenvalues of m coefficient sets, (m, n), and their vectors, (m, n, size)."""
        k, back = self._whitened(stiffness, mass)
        pairs = [_lowest_pairs(matrix, n) for matrix in k]
        values, vectors = np.stack([lam for lam, _ in pairs]), np.stack([v.T for _, v in pairs])
        sets = np.repeat(np.arange(len(k)), n)
        return values, _mapped(back, sets, vectors.reshape(-1, self.size)).reshape(vectors.shape)

    def stiffness_at(self, stiffness: Array) -> Array:
        """K at one coefficient set (n_terms,), (n, n)."""
        return self.stiffness.assemble(stiffness)

    def mass_at(self, mass: Array) -> Array:
        """M at one coefficient set (n_terms,), (n, n)."""
        return self.mass.assemble(mass)

    def diagonals(self) -> tuple[Array, Array]:
        """Diagonals of K and M for every term, (n_terms, n) each."""
        return self.stiffness.diagonals(self.n_terms[0]), self.mass.diagonals(self.n_terms[1])

    def restricted(self, keep: Array, number: Array) -> DenseBlock:
        """The block on the trial functions marked in ``keep``, renumbered by ``number`` for another space."""
        k = keep[self.index]
        index = number[self.index[k]]
        return DenseBlock(self.stiffness.restricted(k), self.mass.restricted(k), index, self.n_terms)

    def compressed(self, stiffness: Array, mass: Array) -> DenseBlock:
        """The block reduced to the independent directions of coefficients (m, n_terms)."""
        k, m = (
            matrix.combined(*relations(c, matrix.norms(c.shape[1])))
            for matrix, c in ((self.stiffness, stiffness), (self.mass, mass))
        )
        return DenseBlock(k, m, self.index, self.n_terms)

    def project(self, basis: Array) -> DenseBlock:
        """The block on the span of ``basis`` (n, r)."""
        index = np.arange(basis.shape[1])
        return DenseBlock(self.stiffness.project(basis), self.mass.project(basis), index, self.n_terms)

    def dense(self) -> DenseBlock:
        """The block itself."""
        return self

    def lowest(self, near: Array, n: int, kept: Sequence[Array]) -> list[Array]:
        """The n lowest eigenvalues of each term of K with that of M, on subsets of functions, (m, n) each.

        near : (m,) rough eigenvalues of the first deformation mode
        kept : (size,) bool each
        """
        eye = np.eye(len(near))
        if self.size < _FEW_OF_MANY * n:
            blocks = [self if k.all() else self.subset(k) for k in kept]
            return [b.eigenvalues(eye, eye, min(n, b.size)) for b in blocks]
        stiffness, mass = self.stiffness.assemble(eye), self.mass.assemble(eye)
        each = [
            _lowest_by_krylov(k, m, _KRYLOV_SHIFT * first, n, kept)
            for k, m, first in zip(stiffness, mass, near, strict=True)
        ]
        return [np.stack(values) for values in zip(*each, strict=True)]

    def subset(self, keep: Array) -> DenseBlock:
        """The block on some of its functions, ``keep`` (n,) bool, renumbered."""
        matrices = self.stiffness.restricted(keep), self.mass.restricted(keep)
        return DenseBlock(*matrices, np.arange(np.count_nonzero(keep)), self.n_terms)

    def energies(self, vectors: Array) -> tuple[Array, Array]:
        """phi^T K_q phi and phi^T M_q phi of vectors (k, size) for every term, (k, n_terms) each."""
        terms = []
        for matrix, n_terms in zip((self.stiffness, self.mass), self.n_terms, strict=True):
            energy = np.zeros((len(vectors), n_terms))
            n = matrix.stack.shape[-1]
            images = (matrix.stack.reshape(-1, n) @ vectors.T).reshape(-1, n, len(vectors))
            energy[:, matrix.active] = np.sum(images * vectors.T, axis=1).T
            terms.append(energy)
        return terms[0], terms[1]


def inverse_roots(stack: Array) -> Array:
    """L^-1 (..., n, n) of definite matrices L L^T (..., n, n)."""
    roots = np.linalg.cholesky(stack)
    for root in roots.reshape(-1, *roots.shape[-2:]):
        lapack.dtrtri(root.T, overwrite_c=1)  # in its place, the lower half
    return np.asarray(roots)


def _lowest(stack: Array, n: int) -> Array:
    """The n lowest eigenvalues of symmetric matrices (m, size, size), (m, n)."""
    if stack.shape[-1] == 1:
        return np.asarray(stack[..., 0])
    return matrix_by_matrix(np.linalg.eigvalsh, stack)[..., :n]


def _lowest_by_krylov(k: Array, m: Array, shift: float, n: int, kept: Sequence[Array]) -> list[Array]:
    """The n lowest eigenvalues (n,) of K phi = lambda M phi on all functions and on those of each mask.

    With K + shift M = L L^T they are 1 / mu - shift, mu the largest eigenvalues of L^-1 M L^-T, by a block
    Krylov method (Golub and Underwood, in Mathematical Software III, 1977). Functions are left out by a
    projection: phi_c = 0 where y = L^T phi is orthogonal to the columns c of L^-1. A restriction starts from
    the modes of all functions.
    """
    factor = np.linalg.cholesky(k + shift * m)

    def image(y: Array) -> Array:
        phi = solve_triangular(factor, y, trans="T", lower=True, check_finite=False)
        return np.asarray(solve_triangular(factor, m @ phi, lower=True, check_finite=False))

    size = np.arange(len(k))
    # a fixed start without symmetry
    start = np.cos(np.outer(1.0 + size, 1.0 + np.sqrt(np.arange(n))))
    found = []
    for mask in kept:
        gone = np.flatnonzero(~mask)
        left = np.linalg.qr(solve_triangular(factor, np.eye(len(k))[:, gone], lower=True))[0]
        mu, vectors = _largest_by_krylov(image, start, left, n, shift)
        found.append(1.0 / mu - shift)
        start = vectors if mask.all() else start
    return found


def _largest_by_krylov(
    image: Callable[[Array], Array], start: Array, left: Array, n: int, shift: float
) -> tuple[Array, Array]:
    """The n largest eigenvalues (n,) of a symmetric image, and their vectors (size, n), without ``left``.

    start, left : (size, k) starting vectors, and orthonormal ones to which all vectors are orthogonal
    """

    def orthonormal(y: Array, basis: Array) -> Array:
        for _ in range(2):
            y = y - left @ (left.T @ y)
            y = y - basis @ (basis.T @ y)
        return np.asarray(np.linalg.qr(y)[0])

    basis = orthonormal(start, np.empty((len(start), 0)))
    last, images, before = basis, np.empty((len(start), 0)), np.full(n, np.nan)
    while True:
        images = np.column_stack((images, image(last)))
        product = basis.T @ images
        mu, vectors = np.linalg.eigh(0.5 * (product + product.T))
        mu, vectors = mu[::-1][:n], vectors[:, ::-1][:, :n]
        if len(mu) == n and np.all(np.abs(mu - before) <= _SAME_VALUE * mu * (shift * mu)):
            return mu, basis @ vectors
        before = mu if len(mu) == n else before
        if basis.shape[1] + last.shape[1] > len(start) - left.shape[1]:
            return mu, basis @ vectors
        last = orthonormal(images[:, -last.shape[1] :], basis)
        basis = np.column_stack((basis, last))


def _lowest_pairs(matrix: Array, n: int) -> tuple[Array, Array]:
    """The n lowest eigenvalues (n,) of a matrix given by its lower half, and their vectors (size, n).

    A few vectors are found by inverse iteration on the tridiagonal form, after all its eigenvalues.
    """
    size = len(matrix)
    if n <= _FEW * size:
        reduced, diagonal, beside, scale, _ = lapack.dsytrd(matrix, lower=1, lwork=_WORK * size)
        values = lapack.dsterf(diagonal, beside)[0][:n]
        one_part = np.ones(size, dtype=np.int32)
        vectors, failed = lapack.dstein(diagonal, beside, values, one_part, size * one_part)
        if not failed:
            turned = lapack.dormqr("L", "N", reduced[1:, :-1], scale, vectors[1:], _WORK * n)[0]
            return values, np.concatenate((vectors[:1], turned))
    values, vectors = np.linalg.eigh(matrix)
    return values[:n], vectors[:, :n]


def _mapped(back: Array, sets: Array, phi: Array) -> Array:
    """Vectors (k, n) of whitened problems in the block's own coordinates."""
    if back.ndim == 2:
        return np.asarray(back[sets] * phi)
    if back.shape[-1] <= _LARGE:
        return np.asarray((back[sets] @ phi[..., None])[..., 0])
    mapped = np.empty_like(phi)
    for i in np.unique(sets):
        mapped[sets == i] = solve_triangular(back[i], phi[sets == i].T, trans="T", lower=True).T
    return mapped


def _iterated(k: Array, eigenvalues: Array, sets: Array, column: Array) -> Array:
    """Unit eigenvectors (k, n) of some modes of matrices (m, n, n) with known eigenvalues.

    One inverse iteration from a fixed vector; LAPACK's vectors where two eigenvalues are close.
    """
    lam, size = eigenvalues[sets, column], k.shape[-1]
    if size == 1:
        return np.ones((len(sets), 1))
    between = np.full((len(eigenvalues), eigenvalues.shape[1] + 1), np.inf)
    between[:, 1:-1] = np.diff(eigenvalues, axis=1)
    distance = np.minimum(between[sets, column], between[sets, column + 1])
    close = distance < _CLOSE * np.abs(lam)
    phi, i = np.empty((len(sets), size)), np.arange(size)
    apart = np.flatnonzero(~close)
    if len(apart):
        shifted = k[sets[apart]]
        shifted.reshape(len(apart), -1)[:, :: size + 1] -= (lam[apart] * (1.0 + _SHIFT))[:, None]
        try:
            phi[apart] = np.linalg.solve(shifted, np.cos(1.0 + i * i)[:, None])[..., 0]
        except np.linalg.LinAlgError:  # a shifted value that is an eigenvalue to its last digit
            close[:] = True
    for s in np.unique(sets[close]) if close.any() else ():
        rows = np.flatnonzero(close & (sets == s))
        every = scipy.linalg.eigh(k[s], subset_by_index=(0, int(column[rows].max())))[1]
        phi[rows] = every[:, column[rows]].T
    phi /= np.sqrt(np.sum(phi * phi, axis=1, keepdims=True))
    return phi


# Size beyond which inverse iterations do not pay: with ten modes it is 40, with five 70.
_LARGE = 60
# Functions per wanted eigenvalue from which a Krylov method costs less; the shift over the first eigenvalue,
# and the change of an eigenvalue over it at which the method ends.
_FEW_OF_MANY, _KRYLOV_SHIFT, _SAME_VALUE = 20, 0.5, 1e-8
# Fraction of the eigenpairs of a large block above which finding all, by divide and conquer, costs less, and
# the number of columns that LAPACK treats at a time.
_FEW, _WORK = 0.6, 32
# Relative distance of eigenvalues below which an inverse iteration does not separate their vectors.
_CLOSE = 1e-5
# Relative shift of an inverse iteration from the eigenvalue.
_SHIFT = 1e-11


@dataclass(frozen=True, slots=True)
class AffineOperator(Generic[SpaceT, BlockT]):
    """A problem on a space, split into blocks that do not couple."""

    problem: Problem
    space: SpaceT
    blocks: tuple[BlockT, ...]

    def coefficients(self, values: Values) -> tuple[Array, Array]:
        """Coefficients of K and of M at parameter values, (..., n_stiffness) and (..., n_mass)."""
        return self.problem.both_coefficients(values)


def restricted(operator: DenseOperator, keep: Array) -> DenseOperator:
    """The operator on the trial functions marked in ``keep`` (n_functions,) bool."""
    number = np.cumsum(keep) - 1
    blocks = [block.restricted(keep, number) for block in operator.blocks if keep[block.index].any()]
    return AffineOperator(operator.problem, operator.space.restricted(keep), tuple(blocks))


DenseOperator = AffineOperator[RitzSpace, RitzBlock]


class Profile(Protocol):
    """A function of one reference coordinate, with its parity about the middle: 1, -1, or 0 for none."""

    @property
    def parity(self) -> int:
        """1 even, -1 odd, 0 neither."""
        ...

    @property
    def breaks(self) -> tuple[float, ...]:
        """Points between which the function is smooth enough for quadrature, none if it varies slowly."""
        ...

    def __call__(self, t: Array) -> Array:
        """Values at points (n,) of [0, 1], (n,)."""
        ...


@dataclass(frozen=True, slots=True)
class Polynomial:
    """A polynomial in s = 2 t - 1, lowest power first."""

    coefficients: tuple[float, ...]

    @property
    def parity(self) -> int:
        """1 if only even powers occur, -1 if only odd ones, 0 otherwise."""
        powers = {k % 2 for k, c in enumerate(self.coefficients) if c != 0.0}
        return {frozenset({0}): 1, frozenset({1}): -1, frozenset(): 1}.get(frozenset(powers), 0)

    @property
    def breaks(self) -> tuple[float, ...]:
        """No points."""
        return ()

    def __call__(self, t: Array) -> Array:
        """Values at points (n,) of [0, 1], (n,)."""
        return np.asarray(polynomial.polyval(2.0 * t - 1.0, np.array(self.coefficients)))

    def derivative(self, order: int = 1) -> Polynomial:
        """The derivative with respect to s."""
        return Polynomial(tuple(polynomial.polyder(np.array(self.coefficients), order).tolist()))


@dataclass(frozen=True, slots=True)
class _Local:
    """A weight concentrated about a centre."""

    centre: float
    width: float

    @property
    def parity(self) -> int:
        """1 about the middle, 0 elsewhere."""
        return 1 if self.centre == 0.5 else 0


@dataclass(frozen=True, slots=True)
class Bell(_Local):
    """exp(-((t - centre) / width)^2 / 2)."""

    @property
    def breaks(self) -> tuple[float, ...]:
        """Ends of panels, out to where it has vanished."""
        return tuple(self.centre + k * self.width for k in (-8, -4, -2, 0, 2, 4, 8))

    def __call__(self, t: Array) -> Array:
        """Values at points (n,) of [0, 1], (n,)."""
        return np.asarray(np.exp(-0.5 * ((t - self.centre) / self.width) ** 2))


@dataclass(frozen=True, slots=True)
class Box(_Local):
    """1 within a width of the centre, 0 elsewhere."""

    @property
    def breaks(self) -> tuple[float, ...]:
        """Its ends."""
        return self.centre - self.width, self.centre + self.width

    def __call__(self, t: Array) -> Array:
        """Values at points (n,) of [0, 1], (n,)."""
        return np.asarray(np.where(np.abs(t - self.centre) <= self.width, 1.0, 0.0))


@dataclass(frozen=True, slots=True)
class Twins:
    """A weight about a centre and its mirror image about the middle, added."""

    one: Bell | Box

    @property
    def parity(self) -> int:
        """1, even."""
        return 1

    @property
    def breaks(self) -> tuple[float, ...]:
        """The points of both."""
        return (*self.one.breaks, *(1.0 - t for t in self.one.breaks))

    def __call__(self, t: Array) -> Array:
        """Values at points (n,) of [0, 1], (n,)."""
        return self.one(t) + self.one(1.0 - t)


ONE = Polynomial((1.0,))
LINE = Polynomial((0.0, 1.0))


def power(k: int) -> Polynomial:
    """s to the power k."""
    return Polynomial((0.0,) * k + (1.0,))


@dataclass(frozen=True, slots=True)
class Product:
    """x(xi) times y(eta)."""

    x: Profile
    y: Profile

    def __call__(self, points: Array) -> Array:
        """Values at reference points (n, 2), (n,)."""
        return self.x(points[:, 0]) * self.y(points[:, 1])
