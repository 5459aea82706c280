"""Discretised problems: K(p) = sum_q theta_q(p) K_q and M(p) = sum_q mu_q(p) M_q, dense or sparse.

Forms on the reference square are weighted by products of one function of xi and one of eta, which keep the
tensor structure of a Ritz space; the parities of the factors say which symmetries of the plate they leave. On
a Ritz space blocks are dense, assembled sector by sector from one-dimensional integrals.
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
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from cpam_bayes.mechanics.problem import Atom, Form, MatrixKind, Problem, Values
from cpam_bayes.mechanics.ritz import Family, Quadrature, RitzSpace, Space, broken_quadrature, evaluate_sector
from cpam_bayes.running import matrix_by_matrix

Array = NDArray[Any]
SpaceT = TypeVar("SpaceT", bound=Space, covariant=True)
BlockT = TypeVar("BlockT", bound="Block", covariant=True)


# Off-diagonal fraction of a mass matrix that is left by the quadrature of orthonormal functions.
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
        """Whether every matrix of the sum is diagonal, but for the rounding of its integrals."""
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
        """The sum on the span of ``basis`` (n, r)."""
        return AffineMatrix(basis.T @ (self.stack @ basis), self.active)


# M-normalised eigenvectors (k, size) of some modes: (k,) the coefficient set of each, (k,) which of its
# eigenvalues it has.
ModeVectors = Callable[[Array, Array], Array]


class Block(Protocol):
    """Trial functions that couple only among themselves: what an eigensolver needs of them.

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
        """The n lowest eigenvalues of m coefficient sets, (m, n), and what gives their vectors."""
        ...

    def energies(self, vectors: Array) -> tuple[Array, Array]:
        """phi^T K_q phi and phi^T M_q phi of vectors (k, size) for every term, (k, n_terms) each."""
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
        """K where M is the identity, of a large block its lower half, and what ``_mapped`` needs.

        That is M^-1/2 (m, n) where M is diagonal, else, with M = L L^T, L^-T (m, n, n), L of a large block.
        """
        k = self.stiffness.assemble(stiffness)
        if self.mass.is_diagonal:
            diagonal = np.diagonal(self.mass.stack, axis1=1, axis2=2)
            scale = 1.0 / np.sqrt(mass[..., self.mass.active] @ diagonal)
            k *= scale[..., :, None]
            k *= scale[..., None, :]
            return k, scale
        factor = np.linalg.cholesky(self.mass.assemble(mass))
        if self.size > _LARGE:  # a quarter of the work of a product with the inverse
            for one, root in zip(k, factor, strict=True):
                one[...] = lapack.dsygst(one, root, lower=1)[0]
            return k, factor
        back = np.swapaxes(np.linalg.inv(factor), -1, -2)
        return np.swapaxes(back, -1, -2) @ k @ back, back

    def eigenvalues(self, stiffness: Array, mass: Array, n: int) -> Array:
        """The n lowest eigenvalues of m coefficient sets, (m, n)."""
        return _lowest(self._whitened(stiffness, mass)[0], n)

    def eigenpairs(self, stiffness: Array, mass: Array, n: int) -> tuple[Array, ModeVectors]:
        """The n lowest eigenvalues of m coefficient sets, (m, n), and what gives their vectors.

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


def _lowest(stack: Array, n: int) -> Array:
    """The n lowest eigenvalues of symmetric matrices (m, size, size), (m, n)."""
    if stack.shape[-1] == 1:
        return np.asarray(stack[..., 0])
    return matrix_by_matrix(np.linalg.eigvalsh, stack)[..., :n]


def _lowest_pairs(matrix: Array, n: int) -> tuple[Array, Array]:
    """The n lowest eigenvalues (n,) of a matrix given by its lower half, and their vectors (size, n)."""
    if n <= _FEW * len(matrix):
        values, vectors = scipy.linalg.eigh(matrix, subset_by_index=(0, n - 1))
        return values, vectors
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
# Fraction of the eigenpairs of a large block above which all of them, by divide and conquer, cost less.
_FEW = 1 / 6
# Relative distance of eigenvalues under which an inverse iteration does not tell their vectors apart.
_CLOSE = 1e-5
# Relative distance from an eigenvalue at which the inverse iteration is taken.
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
    blocks = [
        DenseBlock(b.stiffness.restricted(k), b.mass.restricted(k), number[b.index[k]], b.n_terms)
        for b, k in ((b, keep[b.index]) for b in operator.blocks)
        if k.any()
    ]
    return AffineOperator(operator.problem, operator.space.restricted(keep), tuple(blocks))


DenseOperator = AffineOperator[RitzSpace, DenseBlock]


class Profile(Protocol):
    """A function of one reference coordinate, with its parity about the middle: 1, -1, or 0 for none."""

    @property
    def parity(self) -> int:
        """1 even, -1 odd, 0 neither."""
        ...

    @property
    def breaks(self) -> tuple[float, ...]:
        """Points between which a quadrature is smooth enough, none for what varies slowly."""
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
        """None."""
        return ()

    def __call__(self, t: Array) -> Array:
        """Values at points (n,) of [0, 1], (n,)."""
        return np.asarray(polynomial.polyval(2.0 * t - 1.0, np.array(self.coefficients)))

    def derivative(self, order: int = 1) -> Polynomial:
        """The derivative with respect to s."""
        return Polynomial(tuple(polynomial.polyder(np.array(self.coefficients), order).tolist()))


@dataclass(frozen=True, slots=True)
class _Local:
    """A weight about a centre."""

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
        """Panels of two widths, out to where it has vanished."""
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


Piece = tuple[int, int, Array]
MATRICES: tuple[MatrixKind, MatrixKind] = ("stiffness", "mass")


class FamilyValues:
    """One-dimensional families and integrals of their products, computed once for all forms of a problem."""

    def __init__(self) -> None:
        # The key holds identities, so the arrays and families are kept as long as the values are.
        self._values: dict[tuple[int, int, bool], tuple[Family, Array, Array]] = {}
        self._overlaps: dict[tuple[object, ...], tuple[Family, Family, Array]] = {}

    def at(self, family: Family, t: Array, derivative: bool) -> Array:
        """Functions or first derivatives of a family at points (n,), (n, size)."""
        key = (id(family), id(t), derivative)
        if key not in self._values:
            self._values[key] = (family, t, family.evaluate(t, derivative))
        return self._values[key][2]

    def overlap(
        self,
        left: tuple[Family, bool],
        right: tuple[Family, bool],
        axis: str,
        weight: object,
        t: Array,
        w: Array,
    ) -> Array:
        """Integrals of products of functions or derivatives of two families, (left.size, right.size).

        weight : what the points t and weights w (n,) on an axis follow from
        """
        key = (id(left[0]), left[1], id(right[0]), right[1], axis, weight)
        if key not in self._overlaps:
            weighted = w[:, None] * self.at(right[0], t, right[1])
            self._overlaps[key] = (left[0], right[0], self.at(left[0], t, left[1]).T @ weighted)
        return self._overlaps[key][2]


def _area_pieces(form: Form, space: RitzSpace, values: FamilyValues) -> list[Piece]:
    """Sector-by-sector matrices of an area form, by products of one-dimensional integrals.

    Its weight is one or a product of functions of xi and of eta.
    """
    (x, wx), (y, wy) = space.x_grid, space.y_grid
    if isinstance(form.weight, Product):
        x, wx = broken_quadrature(form.weight.x.breaks) if form.weight.x.breaks else (x, wx)
        y, wy = broken_quadrature(form.weight.y.breaks) if form.weight.y.breaks else (y, wy)
    pieces = []
    for i, left in enumerate(space.sectors):
        for j, right in enumerate(space.sectors):
            if left.field != form.left.field or right.field != form.right.field:
                continue
            in_x = _overlap(left.x, right.x, form, "x", x, wx, values)
            in_y = _overlap(left.y, right.y, form, "y", y, wy, values) if in_x is not None else None
            if in_x is not None and in_y is not None:
                p, q = left.pairs, right.pairs
                pieces.append((i, j, in_x[np.ix_(p[:, 0], q[:, 0])] * in_y[np.ix_(p[:, 1], q[:, 1])]))
    return pieces


def _overlap(
    left: Family, right: Family, form: Form, axis: str, t: Array, w: Array, values: FamilyValues
) -> Array | None:
    """One-dimensional integrals of products of two families; ``None`` where they vanish by parity."""
    in_left, in_right = form.left.derivative == axis, form.right.derivative == axis
    parity = left.parity * right.parity * (-1) ** (in_left + in_right)
    profile = None
    if isinstance(form.weight, Product):
        profile = form.weight.x if axis == "x" else form.weight.y
        parity *= profile.parity
        w = w * profile(t)
    if parity < 0:
        return None
    return values.overlap((left, in_left), (right, in_right), axis, profile, t, w)


def _general_pieces(form: Form, space: RitzSpace) -> list[Piece]:
    """Sector-by-sector matrices of any form, by quadrature over its region."""
    rule = space.quadrature(form.region)
    if form.region.kind == "projection":
        return _projection_pieces(form, space, rule)
    weights = rule.weights * (1.0 if form.weight is None else form.weight(rule.points))
    pieces = []
    for i, left in enumerate(space.sectors):
        if left.field != form.left.field or not left.size:
            continue
        b_left = evaluate_sector(left, rule.points, form.left.derivative)
        for j, right in enumerate(space.sectors):
            if right.field != form.right.field or not right.size:
                continue
            b_right = evaluate_sector(right, rule.points, form.right.derivative)
            matrix = b_left.T @ (weights[:, None] * b_right)
            scale = (
                np.sqrt(len(weights)) * np.abs(weights).max() * np.abs(b_left).max() * np.abs(b_right).max()
            )
            if np.abs(matrix).max(initial=0.0) > 1e-12 * scale:
                pieces.append((i, j, matrix))
    return pieces


def _projection_pieces(form: Form, space: RitzSpace, rule: Quadrature) -> list[Piece]:
    """Sector-by-sector matrices of a form that is a sum of products of integrals."""
    functions = projected_functions(form, rule)

    def moments(atom: Atom) -> list[tuple[int, Array]]:
        sectors = [(i, s) for i, s in enumerate(space.sectors) if s.field == atom.field and s.size]
        values = [(i, evaluate_sector(s, rule.points, atom.derivative).T @ functions) for i, s in sectors]
        size = max((np.abs(g).max() for _, g in values), default=0.0)
        # what is left of integrals that vanish by parity
        return [(i, np.where(np.abs(g) > 1e-12 * size, g, 0.0)) for i, g in values]

    left = moments(form.left)
    right = left if form.right == form.left else moments(form.right)
    pairs = [(i, j, a @ b.T) for i, a in left for j, b in right]
    return [(i, j, matrix) for i, j, matrix in pairs if matrix.any()]


def projected_functions(form: Form, rule: Quadrature) -> Array:
    """Weighted values (n_points, r) of the functions on which a form projects."""
    values = np.ones((len(rule.points), 1)) if form.weight is None else form.weight(rule.points)
    return np.asarray(rule.weights[:, None] * values)


def form_pieces(form: Form, space: RitzSpace, values: FamilyValues | None = None) -> list[Piece]:
    """Non-zero sector-by-sector matrices of a form, both triangles: (row sector, column sector, matrix).

    values : of the space's families, where several forms are integrated
    """
    plain = form.region.kind == "area" and (form.weight is None or isinstance(form.weight, Product))
    pieces = _area_pieces(form, space, values or FamilyValues()) if plain else _general_pieces(form, space)
    if form.left != form.right:
        pieces = pieces + [(j, i, m.T) for i, j, m in pieces]
    return pieces


def active_terms(problem: Problem, samples: Values, matrix: MatrixKind) -> Array:
    """True for the forms whose coefficient is not zero at all samples, (n_forms,) bool."""
    c = np.abs(np.atleast_2d(problem.coefficients(samples, matrix)))
    c = c.reshape(-1, c.shape[-1])
    return np.asarray(c.max(axis=0) > 1e-12 * _comparable(problem.forms(matrix), c))


def _comparable(forms: Sequence[Form], coefficients: Array) -> Array:
    """Magnitude that a coefficient is compared with to be called zero: its largest diagonal relatives.

    Relatives are forms over the same region with the same weight.
    """
    largest: dict[tuple[Any, ...], float] = {}
    for f, c in zip(forms, coefficients.max(axis=0), strict=True):
        if f.left == f.right:
            key = (f.left, f.region, f.weight)
            largest[key] = max(largest.get(key, 0.0), float(c))
    sizes = [[largest.get((atom, f.region, f.weight), 0.0) for atom in (f.left, f.right)] for f in forms]
    return np.array([np.sqrt(a * b) for a, b in sizes])


def discretise(problem: Problem, space: RitzSpace, samples: Values) -> DenseOperator:
    """The problem on a dense space, split by the symmetries that hold at all ``samples``.

    samples : parameter values, each (n_samples,), that cover what will be asked: forms whose
    coefficient is zero at all of them are left out, and sectors that no form couples are separated.
    """
    n_k, n_m = len(problem.forms("stiffness")), len(problem.forms("mass"))
    return _discretise(problem, space, samples, (np.eye(n_k), np.eye(n_m)))


def discretise_at(problem: Problem, space: RitzSpace, samples: Values) -> DenseOperator:
    """The problem at fixed parameter samples only, to be used with ``np.eye(n_samples)`` as coefficients.

    It needs the memory of n_samples matrices instead of one a form.
    """
    stiffness, mass = (np.atleast_2d(problem.coefficients(samples, kind)) for kind in MATRICES)
    n = max(len(stiffness), len(mass))
    stiffness = np.broadcast_to(stiffness, (n, stiffness.shape[-1]))
    mass = np.broadcast_to(mass, (n, mass.shape[-1]))
    return _discretise(problem, space, samples, (stiffness, mass))


def _discretise(
    problem: Problem, space: RitzSpace, samples: Values, combine: tuple[Array, Array]
) -> DenseOperator:
    """Blocks of sum_q combine[r, q] K_q for every row r of ``combine`` (n_rows, n_forms)."""
    pieces: list[dict[int, list[Piece]]] = []
    values = FamilyValues()
    links = {(i, i) for i in range(len(space.sectors))}
    for kind in MATRICES:
        active = active_terms(problem, samples, kind)
        forms = problem.forms(kind)
        pieces.append({q: form_pieces(f, space, values) for q, f in enumerate(forms) if active[q]})
        links |= {(i, j) for parts in pieces[-1].values() for i, j, _ in parts}
    n_terms = (combine[0].shape[0], combine[1].shape[0])
    starts = np.cumsum([0, *(s.size for s in space.sectors)])
    blocks = []
    for members in _components(len(space.sectors), links):
        if not any(space.sectors[i].size for i in members):
            continue
        local = np.cumsum([0, *(space.sectors[i].size for i in members)])
        place = {i: slice(a, b) for i, a, b in zip(members, local[:-1], local[1:], strict=True)}
        matrices = [_stack(p, c, place, int(local[-1])) for p, c in zip(pieces, combine, strict=True)]
        index = np.concatenate([np.arange(starts[i], starts[i + 1]) for i in members])
        blocks.append(DenseBlock(matrices[0], matrices[1], index, n_terms))
    return AffineOperator(problem, space, tuple(blocks))


def _stack(pieces: dict[int, list[Piece]], combine: Array, place: dict[int, slice], n: int) -> AffineMatrix:
    inside = {q: [p for p in parts if p[0] in place] for q, parts in pieces.items()}
    present = [q for q, parts in inside.items() if parts]
    active = np.flatnonzero(np.any(combine[:, present] != 0.0, axis=1))
    stack = np.zeros((len(active), n, n))
    for q in present:
        for i, j, matrix in inside[q]:
            for row, r in enumerate(active):
                if combine[r, q] != 0.0:
                    stack[row, place[i], place[j]] += combine[r, q] * matrix
    return AffineMatrix(stack, active)


def _components(n: int, links: set[tuple[int, int]]) -> list[list[int]]:
    """Connected components of a graph on n nodes, each sorted, in the order of their first node."""
    rows, columns = np.array(sorted(links)).T
    graph = coo_matrix((np.ones(len(links)), (rows, columns)), shape=(n, n))
    count, label = connected_components(graph, directed=False)
    return [np.flatnonzero(label == c).tolist() for c in range(count)]
