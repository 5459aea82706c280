"""Affine operators of sparse spaces: every term's entries on one shared pattern."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array, csr_array, diags_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import LinearOperator, eigsh, splu

from cpam_bayes.mechanics.affine import AffineOperator, ModeVectors
from cpam_bayes.mechanics.dense import MATRICES, active_terms, projected_functions
from cpam_bayes.mechanics.problem import MEMBRANE_FIELDS, Form, MatrixKind, PlateState, Problem, Values
from cpam_bayes.mechanics.spaces.fem import FemSpace
from cpam_bayes.plate.edges import FIELDS, Field

Array = NDArray[Any]

# Eigenvalues beyond those asked for: Lanczos finds the second of an equal pair late.
_SPARE = 2


@dataclass(frozen=True)
class Pattern:
    """Positions of entries of square matrices (n, n), by columns.

    rows, columns : (n_entries,), columns ascending and rows ascending in each.
    starts : (n + 1,), where each column begins.
    """

    rows: Array
    columns: Array
    starts: Array

    @property
    def n(self) -> int:
        """Number of columns."""
        return len(self.starts) - 1

    def matrix(self, entries: Array) -> csc_array[Any]:
        """The matrix with these entries; it shares the pattern's arrays, which are read-only."""
        return csc_array((entries, self.rows, self.starts), shape=(self.n, self.n))


def _pattern(keys: Array, n: int) -> Pattern:
    """The pattern of the keys row + n * column, ascending."""
    rows, columns = (keys % n).astype(np.int32), (keys // n).astype(np.int32)
    starts = np.searchsorted(columns, np.arange(n + 1)).astype(np.int32)
    for array in (rows, columns, starts):
        array.flags.writeable = False
    return Pattern(rows, columns, starts)


@dataclass(frozen=True)
class SparseAffineMatrix:
    """A symmetric matrix that is a sum of fixed matrices times coefficients, on one pattern.

    data : (n_active, n_entries) entries of the matrices, sparse since a form couples two fields only.
    active : (n_active,) the coefficients that they belong to.
    """

    pattern: Pattern
    data: csr_array[Any]
    active: Array

    def entries(self, coefficients: Array) -> Array:
        """Entries of the matrix at coefficients (n_terms,), (n_entries,)."""
        return np.asarray(coefficients[self.active] @ self.data)

    def assemble(self, coefficients: Array) -> csc_array[Any]:
        """The matrix at coefficients (n_terms,)."""
        return self.pattern.matrix(self.entries(coefficients))

    def energies(self, vector: Array) -> Array:
        """phi^T K_q phi of a vector (n,) for every active matrix, (n_active,)."""
        return np.asarray(self.data @ (vector[self.pattern.rows] * vector[self.pattern.columns]))


@dataclass(frozen=True)
class SparseBlock:
    """A block of a sparse space.

    index : (n,) positions of its trial functions in the whole space.
    shift : (rad/s)^2, negative, the point next to which eigenvalues are sought; it makes the stiffness of a
    free plate regular.
    """

    stiffness: SparseAffineMatrix
    mass: SparseAffineMatrix
    index: Array
    shift: float
    n_terms: tuple[int, int]

    @property
    def size(self) -> int:
        """Number of trial functions."""
        return len(self.index)

    def eigenvalues(self, stiffness: Array, mass: Array, n: int) -> Array:
        """The n lowest eigenvalues of m coefficient sets, (m, n).

        Lanczos iteration on (K - shift M)^-1 M, from a start vector that is always the same.
        """
        return np.stack([lam for lam, _ in self._each_lowest(stiffness, mass, n)])

    def eigenpairs(self, stiffness: Array, mass: Array, n: int) -> tuple[Array, ModeVectors]:
        """The n lowest eigenvalues of m coefficient sets, (m, n), and what gives their vectors.

        The iteration of ``eigenvalues``, which finds both.
        """
        values, vectors = zip(*self._each_lowest(stiffness, mass, n), strict=True)
        stacked = np.stack(vectors)
        return np.stack(values), lambda sets, column: stacked[sets, :, column]

    def _each_lowest(self, stiffness: Array, mass: Array, n: int) -> Iterator[tuple[Array, Array]]:
        """The n lowest eigenvalues (n,) and vectors (size, n) of each coefficient set."""
        for i in range(max(len(stiffness), len(mass))):
            yield self._lowest(stiffness, mass, i, n)

    def _lowest(self, stiffness: Array, mass: Array, i: int, n: int) -> tuple[Array, Array]:
        """The n lowest eigenvalues (n,) and vectors (size, n) of coefficient set i."""
        pattern = self.stiffness.pattern
        # where all sets share them, coefficients are given once
        k = self.stiffness.entries(stiffness[min(i, len(stiffness) - 1)])
        m = self.mass.entries(mass[min(i, len(mass) - 1)])
        if n + _SPARE >= self.size:
            return scipy.linalg.eigh(
                pattern.matrix(k).toarray(), pattern.matrix(m).toarray(), subset_by_index=(0, n - 1)
            )
        # positive definite, so that no pivoting is needed and the ordering may be symmetric
        factor = splu(
            pattern.matrix(k - self.shift * m),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        inertia = pattern.matrix(m).copy()
        inertia.eliminate_zeros()
        lam, phi = eigsh(
            pattern.matrix(k),
            k=n + _SPARE,
            M=inertia,
            sigma=self.shift,
            OPinv=LinearOperator((self.size, self.size), matvec=factor.solve, dtype=float),
            v0=np.random.default_rng(0).standard_normal(self.size),
        )
        order = np.argsort(lam)[:n]
        return lam[order], phi[:, order]

    def energies(self, vectors: Array) -> tuple[Array, Array]:
        """phi^T K_q phi and phi^T M_q phi of vectors (k, size) for each term, (k, n_terms) both."""
        terms = []
        for matrix, n_terms in zip((self.stiffness, self.mass), self.n_terms, strict=True):
            energy = np.zeros((len(vectors), n_terms))
            for row, vector in zip(energy, vectors, strict=True):
                row[matrix.active] = matrix.energies(vector)
            terms.append(energy)
        return terms[0], terms[1]


SparseOperator = AffineOperator[FemSpace, SparseBlock]


def discretise_sparse(problem: Problem, space: FemSpace, samples: Values) -> SparseOperator:
    """The problem on a sparse space, split into the fields that couple at any of the ``samples``.

    samples : parameter values, each (n_samples,), that cover what will be asked: forms whose
    coefficient is zero at all of them are left out. A symmetric laminate gives a membrane and a
    bending block.
    """
    active = {kind: np.flatnonzero(active_terms(problem, samples, kind)).tolist() for kind in MATRICES}
    forms = {kind: problem.forms(kind) for kind in MATRICES}
    n_terms = (len(forms["stiffness"]), len(forms["mass"]))
    used = [forms[kind][q] for kind in MATRICES for q in active[kind]]
    starts = dict(zip(FIELDS, np.cumsum([0, *(space.dimension(f) for f in FIELDS)]), strict=False))
    blocks = []
    for fields in _coupled_fields(used):
        index = np.concatenate([starts[f] + np.arange(space.dimension(f)) for f in fields])
        if not len(index):
            continue
        local = dict(zip(fields, np.cumsum([0, *map(space.dimension, fields)]), strict=False))
        entries = {
            kind: [
                (q, *_form_entries(forms[kind][q], space, kind, local, len(index)))
                for q in active[kind]
                if forms[kind][q].left.field in fields
            ]
            for kind in MATRICES
        }
        keys = _sorted_unique([k for kind in MATRICES for _, k, _ in entries[kind]])
        pattern = _pattern(keys, len(index))
        stiffness, mass = (_on_pattern(pattern, keys, entries[kind]) for kind in MATRICES)
        shift = -_reference_eigenvalue(problem.nominal, fields)
        blocks.append(SparseBlock(stiffness, mass, index, shift, n_terms))
    return AffineOperator(problem, space, tuple(blocks))


def _coupled_fields(forms: list[Form]) -> list[tuple[Field, ...]]:
    """Fields in groups that no form couples."""
    pairs = np.array([(FIELDS.index(f.left.field), FIELDS.index(f.right.field)) for f in forms]).T
    n = len(FIELDS)
    graph = coo_array((np.ones(pairs.shape[1]), tuple(pairs)), shape=(n, n))
    count, label = connected_components(graph, directed=False)
    return [tuple(f for f, x in zip(FIELDS, label, strict=True) if x == c) for c in range(count)]


def _form_entries(
    form: Form, space: FemSpace, kind: MatrixKind, starts: dict[Field, int], n: int
) -> tuple[Array, Array]:
    """Keys and values of a form's entries in a block of n functions, both triangles."""
    rule = space.quadrature(form.region, kind)
    left = space.evaluate(form.left.field, rule, form.left.derivative)
    right = space.evaluate(form.right.field, rule, form.right.derivative)
    if form.region.kind == "projection":  # every function with every other: dense
        functions = projected_functions(form, rule)
        matrix = coo_array((left.T @ functions) @ (right.T @ functions).T)
    else:
        weights = rule.weights * (1.0 if form.weight is None else form.weight(rule.points))
        weighting: csr_array[Any] = diags_array(weights, format="csr")
        matrix = coo_array(left.T @ weighting @ right)
    rows = matrix.row.astype(np.int64) + starts[form.left.field]
    columns = matrix.col.astype(np.int64) + starts[form.right.field]
    if form.left == form.right:
        return rows + n * columns, matrix.data
    keys = np.concatenate((rows + n * columns, columns + n * rows))
    return keys, np.concatenate((matrix.data, matrix.data))


def _sorted_unique(parts: list[Array]) -> Array:
    """Sorted unique integers, millions of them: by hashing, as ``np.unique`` does, it is ten times slower."""
    keys = np.sort(np.concatenate(parts))
    return keys[np.concatenate(([True], keys[1:] > keys[:-1]))]


def _on_pattern(pattern: Pattern, keys: Array, entries: list[tuple[int, Array, Array]]) -> SparseAffineMatrix:
    active = np.array([q for q, _, _ in entries], dtype=int)
    rows = np.concatenate([np.full(len(k), i) for i, (_, k, _) in enumerate(entries)])
    places = np.searchsorted(keys, np.concatenate([k for _, k, _ in entries]))
    values = np.concatenate([v for _, _, v in entries])
    data = coo_array((values, (rows, places)), shape=(len(active), len(keys)))
    return SparseAffineMatrix(pattern, data.tocsr(), active)


def _reference_eigenvalue(nominal: PlateState, fields: tuple[Field, ...]) -> float:
    """An eigenvalue of the order of the lowest, (rad/s)^2: ten times that of a strip's rigidity."""
    k, h = np.real(nominal.stiffness()), float(np.real(nominal.thickness))
    length, width = float(np.real(nominal.length)), float(np.real(nominal.width))
    if set(fields) <= set(MEMBRANE_FIELDS):
        rigidity = min(k[0, 0] / length**2, k[1, 1] / width**2)
    else:
        rigidity = min(k[3, 3] / length**4, k[4, 4] / width**4)
    return float(10.0 * rigidity / (h * float(np.real(nominal.density))))
