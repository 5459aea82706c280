"""A plate with loads at points, on its modes and its static responses to them, by symmetry block.

A mass at a point is M + u m u^T. It couples all symmetries of a plate, but the plate without it keeps them:
its few lowest modes in each block and its responses to a unit load for each u represent the plate with the
mass as well (component mode synthesis with residual flexibility: Craig and Bampton, AIAA J. 6, 1968; MacNeal,
Comput. Struct. 1, 1971).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.linalg import lapack
from scipy.sparse.csgraph import connected_components

from cpam_bayes.mechanics.affine import (
    AffineMatrix,
    DenseBlock,
    DenseOperator,
    ModeVectors,
    RitzBlock,
    inverse_roots,
    relations,
)

Array = NDArray[Any]

# Regularisation of responses that the modes already contain, relative to their flexibility; rounding leaves
# 1e-9 of one.
_NUGGET = 1e-8


@dataclass(frozen=True, slots=True)
class PlateModes:
    """A plate at m parameter sets, and its modes in leading vectors of its basis, block by block.

    energy, mass : K + shift M and M, (m, n, n)
    vectors : (m, n_leading, n_modes) of unit energy
    masses : (m, n_modes)
    """

    energy: list[Array]
    mass: list[Array]
    vectors: list[Array]
    masses: list[Array]


@dataclass(frozen=True, slots=True)
class RitzBasis:
    """A plate on the Ritz bases of m parameter sets: its modes, then its responses to loads.

    energy, mass : K + shift M and M, (m, r, r)
    modes : of each block in its leading vectors, (m, n_leading, n_modes) of unit energy
    responses : of each block to the loads, (m, n, n_loads)
    """

    energy: Array
    mass: Array
    modes: list[Array]
    responses: list[Array]

    @property
    def n_modes(self) -> int:
        """Number of modes of all blocks."""
        return sum(v.shape[2] for v in self.modes)


def columns_of(modes: list[Array]) -> list[slice]:
    """Slices of the modes of each block (m, n, k) in all of them."""
    ends = np.cumsum([0, *(v.shape[2] for v in modes)]).tolist()
    return [slice(a, b) for a, b in pairwise(ends)]


def ritz_basis(plate: PlateModes, loads: Array) -> RitzBasis:
    """A plate on its modes and its responses to loads (m, n_loads, n)."""
    (m, n_loads, _), r = loads.shape, sum(mu.shape[1] for mu in plate.masses)
    energy, mass = (np.zeros((m, r + n_loads, r + n_loads)) for _ in range(2))
    responses = []
    start, column = 0, 0
    for a, b, v, mu in zip(plate.energy, plate.mass, plate.vectors, plate.masses, strict=True):
        n, k = v.shape[1:]
        load = np.swapaxes(loads[:, :, start : start + a.shape[1]], 1, 2)
        g = _answers(a, load)
        responses.append(g)
        lead, at = slice(column, column + k), np.arange(column, column + k)
        start, column = start + a.shape[1], lead.stop
        pushed, across = b @ g, np.swapaxes(v, 1, 2)
        energy[:, at, at], mass[:, at, at] = 1.0, mu
        # (K + shift M) g is the load itself
        energy[:, lead, r:], mass[:, lead, r:] = across @ load[:, :n], across @ pushed[:, :n]
        energy[:, r:, r:] += np.swapaxes(g, 1, 2) @ load
        mass[:, r:, r:] += np.swapaxes(g, 1, 2) @ pushed
    for matrix in (energy, mass):
        matrix[:, r:, :r] = np.swapaxes(matrix[:, :r, r:], 1, 2)
    i = np.arange(r, r + n_loads)
    diagonal = energy[:, i, i]
    # where an edge holds the field, the load has no effect
    energy[:, i, i] += np.where(diagonal > 0.0, _NUGGET * diagonal, 1.0)
    return RitzBasis(energy, mass, plate.vectors, responses)


def _answers(energy: Array, loads: Array) -> Array:
    """Static responses (m, n, k) of plates with energies (m, n, n) to loads (m, n, k)."""
    answers = np.empty_like(loads)
    for answer, one, load in zip(answers, energy, loads, strict=True):
        _, answer[...], failed = lapack.dposv(one, load, lower=1)
        if failed:  # a plate that buckles
            answer[...] = np.linalg.solve(one, load)
    return answers


def at_points(rows: Array, basis: RitzBasis) -> Array:
    """Values (m, k, r) of the Ritz basis from those of the basis common to all sets, (m, k, n) or (k, n)."""
    leading, answers, start = [], np.zeros(1), 0
    for v, g in zip(basis.modes, basis.responses, strict=True):
        leading.append(rows[..., start : start + v.shape[1]] @ v)
        answers = answers + rows[..., start : start + g.shape[1]] @ g
        start += g.shape[1]
    return np.concatenate([*leading, answers], axis=-1)


def in_common_basis(z: Array, basis: RitzBasis) -> Array:
    """Vectors (m, k, r) of the Ritz basis in the basis common to all sets, (m, k, n)."""
    r = basis.n_modes
    blocks = []
    for v, g, columns in zip(basis.modes, basis.responses, columns_of(basis.modes), strict=True):
        phi = z[:, :, r:] @ np.swapaxes(g, 1, 2)
        phi[:, :, : v.shape[1]] += z[:, :, columns] @ np.swapaxes(v, 1, 2)
        blocks.append(phi)
    return np.concatenate(blocks, axis=-1)


def lowest_modes(
    energy: Array, mass: Array, shift: Array | float, modes: slice, *, vectors: bool
) -> tuple[Array, Array | None]:
    """Eigenvalues (m, k) of modes by number and, if asked, their M-normalised vectors (m, k, r).

    energy, mass : K + shift M and M, (m, r, r); shift : (m, 1), or one for all
    """
    inverse = inverse_roots(energy)
    back = np.swapaxes(inverse, 1, 2)
    whitened = inverse @ mass @ back
    wanted = slice(-1 - modes.start, -1 - modes.stop, -1)
    if not vectors:
        return 1.0 / np.linalg.eigvalsh(whitened)[:, wanted] - shift, None
    mu, every = np.linalg.eigh(whitened)
    mu = mu[:, wanted]
    # phi^T M phi = mu for phi^T (K + shift M) phi = 1
    return 1.0 / mu - shift, np.swapaxes(back @ every[:, :, wanted] / np.sqrt(mu)[:, None], 1, 2)


# Modes of all parts together in which a loaded block is solved, beyond those requested.
_FURTHER = 24
# Shift of the energy over the highest eigenvalue requested, or over that of at least this many modes: it
# makes a free plate stiff; if as low as the first modes, responses to loads would be lost in rounding.
_SHIFT, _FEWEST = 0.1, 12
# Fraction of its modes from which a part is taken with all of them, so that no response remains.
_MOST = 0.4
# Entries of a stack of matrices that are solved at a time.
_STACK = 2**22


@dataclass(frozen=True, slots=True)
class LoadedBlock:
    """Blocks of a dense space that are coupled only by masses at points.

    parts : without these masses
    rows : (r, n) fields of each trial function at the points, part by part
    inertia : (n_terms, r) mass in each row for a coefficient of one
    """

    parts: tuple[DenseBlock, ...]
    rows: Array
    inertia: Array

    @property
    def size(self) -> int:
        """Number of trial functions."""
        return sum(part.size for part in self.parts)

    @property
    def index(self) -> Array:
        """Positions of the trial functions in the whole space, (n,)."""
        return np.concatenate([part.index for part in self.parts])

    @property
    def n_terms(self) -> tuple[int, int]:
        """Numbers of coefficients of K and M."""
        return self.parts[0].n_terms

    def split(self, values: Array) -> list[Array]:
        """Values (..., n) of all trial functions, part by part."""
        return np.split(values, np.cumsum([part.size for part in self.parts])[:-1], axis=-1)

    def eigenvalues(self, stiffness: Array, mass: Array, n: int) -> Array:
        """The n lowest eigenvalues of m coefficient sets, (m, n)."""
        return self.modes(stiffness, mass, n, vectors=False)[0]

    def eigenpairs(self, stiffness: Array, mass: Array, n: int) -> tuple[Array, ModeVectors]:
        """The n lowest eigenvalues of m coefficient sets, (m, n), and a function for their vectors."""
        values, vectors = self.modes(stiffness, mass, n)
        return values, lambda sets, column: vectors[sets, column]

    def modes(self, stiffness: Array, mass: Array, n: int, *, vectors: bool = True) -> tuple[Array, Array]:
        """The n lowest eigenvalues of m coefficient sets, (m, n), and their vectors, (m, n, size).

        vectors : whether they are wanted; else empty
        """
        step = int(max(1, _STACK // sum(part.size**2 for part in self.parts)))
        batches = [
            self._modes(stiffness[i : i + step], mass[i : i + step], n, vectors)
            for i in range(0, len(mass), step)
        ]
        values, phi = (np.concatenate(of) for of in zip(*batches, strict=True))
        return values, phi

    def _modes(self, stiffness: Array, mass: Array, n: int, vectors: bool) -> tuple[Array, Array]:
        pairs = [part.modes(stiffness, mass, min(n + _FURTHER, part.size)) for part in self.parts]
        pooled = np.sort(np.concatenate([lam for lam, _ in pairs], axis=1), axis=1)
        shift = _SHIFT * np.abs(pooled[:, min(max(n, _FEWEST), pooled.shape[1]) - 1, None])
        highest = pooled[:, min(n + _FURTHER, pooled.shape[1]) - 1, None]
        plate, loads = PlateModes([], [], [], []), []
        for part, row, (lam, phi) in zip(self.parts, self.split(self.rows), pairs, strict=True):
            k = int(np.sum(lam <= highest, axis=1).max())
            if k > _MOST * part.size:
                k, row = part.size, 0.0 * row
                lam, phi = part.modes(stiffness, mass, k)
            inertia = part.mass.assemble(mass)
            mu = 1.0 / (lam[:, :k] + shift)
            energy = part.stiffness.assemble(stiffness) + shift[..., None] * inertia
            v = np.swapaxes(phi[:, :k] * np.sqrt(mu)[..., None], 1, 2)
            for of, one in zip(
                (plate.energy, plate.mass, plate.vectors, plate.masses), (energy, inertia, v, mu), strict=True
            ):
                of.append(one)
            # unit loads, then the inertia of the part of their responses outside the modes
            load = np.broadcast_to(row.T, (len(mass), *row.T.shape))
            beside = np.linalg.solve(energy, load) - v @ (np.swapaxes(v, 1, 2) @ load)
            loads.append(np.concatenate((load, inertia @ beside), axis=2))
        basis = ritz_basis(plate, np.swapaxes(np.concatenate(loads, axis=1), 1, 2))
        there = at_points(self.rows, basis)
        added = np.swapaxes(there, 1, 2) @ ((mass @ self.inertia)[..., None] * there)
        energy = basis.energy + shift[..., None] * added
        lam, z = lowest_modes(energy, basis.mass + added, shift, slice(0, n), vectors=vectors)
        return lam, np.empty(0) if z is None else in_common_basis(z, basis)

    def energies(self, vectors: Array) -> tuple[Array, Array]:
        """phi^T K_q phi and phi^T M_q phi of vectors (k, size) for every term, (k, n_terms) each."""
        of_parts = [part.energies(v) for part, v in zip(self.parts, self.split(vectors), strict=True)]
        k, m = (np.sum(terms, axis=0) for terms in zip(*of_parts, strict=True))
        return k, m + (vectors @ self.rows.T) ** 2 @ self.inertia.T

    def lowest(self, near: Array, n: int, kept: Sequence[Array]) -> list[Array]:
        """The n lowest eigenvalues of each term of K with that of M, on subsets of functions, (m, n) each.

        near : (m,), only its length is used; kept : (size,) bool each
        """
        eye = np.eye(len(near))
        blocks = [self if k.all() else self.subset(k) for k in kept]
        return [block.eigenvalues(eye, eye, n) for block in blocks]

    def subset(self, keep: Array) -> LoadedBlock:
        """The block on some of its functions, ``keep`` (n,) bool, renumbered."""
        of_parts = zip(self.parts, self.split(keep), strict=True)
        parts = tuple(part.subset(k) for part, k in of_parts if k.any())
        return LoadedBlock(parts, self.rows[:, keep], self.inertia)

    def stiffness_at(self, stiffness: Array) -> Array:
        """K at one coefficient set (n_terms,), (n, n)."""
        return np.asarray(scipy.linalg.block_diag(*[part.stiffness_at(stiffness) for part in self.parts]))

    def mass_at(self, mass: Array) -> Array:
        """M at one coefficient set (n_terms,), (n, n)."""
        of_parts = scipy.linalg.block_diag(*[part.mass_at(mass) for part in self.parts])
        return np.asarray(of_parts + (self.rows.T * (mass @ self.inertia)) @ self.rows)

    def diagonals(self) -> tuple[Array, Array]:
        """Diagonals of K and M for every term, (n_terms, n) each."""
        of_parts = [part.diagonals() for part in self.parts]
        k, m = (np.concatenate(terms, axis=1) for terms in zip(*of_parts, strict=True))
        return k, m + self.inertia @ self.rows**2

    def restricted(self, keep: Array, number: Array) -> LoadedBlock:
        """The block on the trial functions marked in ``keep``, renumbered by ``number`` for another space."""
        parts = tuple(part.restricted(keep, number) for part in self.parts if keep[part.index].any())
        return LoadedBlock(parts, self.rows[:, keep[self.index]], self.inertia)

    def compressed(self, stiffness: Array, mass: Array) -> LoadedBlock:
        """The block reduced to the independent directions of coefficients (m, n_terms)."""
        norms = sum(part.mass.norms(mass.shape[1]) for part in self.parts)
        kept, relation = relations(mass, norms + self.inertia @ np.sum(self.rows**2, axis=1))
        parts = tuple(
            replace(part.compressed(stiffness, mass), mass=part.mass.combined(kept, relation))
            for part in self.parts
        )
        inertia = np.zeros_like(self.inertia)
        inertia[kept] = relation @ self.inertia
        return LoadedBlock(parts, self.rows, inertia)

    def project(self, basis: Array) -> DenseBlock:
        """The block on the span of ``basis`` (n, r)."""
        pieces = list(zip(self.parts, self.split(basis.T), strict=True))
        k = _sum([part.stiffness.project(v.T) for part, v in pieces])
        m = _sum([part.mass.project(v.T) for part, v in pieces])
        return self._with_masses(k, m, self.rows @ basis, np.arange(basis.shape[1]))

    def dense(self) -> DenseBlock:
        """The block with all its matrices explicit."""
        k, m = (
            _sum([AffineMatrix(self._placed(i, a.stack), a.active) for i, a in enumerate(matrices)])
            for matrices in ([p.stiffness for p in self.parts], [p.mass for p in self.parts])
        )
        return self._with_masses(k, m, self.rows, self.index)

    def _placed(self, i: int, stack: Array) -> Array:
        whole = np.zeros((len(stack), self.size, self.size))
        first = sum(part.size for part in self.parts[:i])
        at = slice(first, first + stack.shape[-1])
        whole[:, at, at] = stack
        return whole

    def _with_masses(self, k: AffineMatrix, m: AffineMatrix, rows: Array, index: Array) -> DenseBlock:
        active = np.flatnonzero(self.inertia.any(axis=1))
        stack = np.swapaxes(rows[None] * self.inertia[active][..., None], 1, 2) @ rows
        return DenseBlock(k, _sum([m, AffineMatrix(stack, active)]), index, self.n_terms)


def _sum(matrices: Sequence[AffineMatrix]) -> AffineMatrix:
    active = np.unique(np.concatenate([m.active for m in matrices]))
    stack = np.zeros((len(active), *matrices[0].stack.shape[1:]))
    for matrix in matrices:
        stack[np.searchsorted(active, matrix.active)] += matrix.stack
    return AffineMatrix(stack, active)


# Number of trial functions up to which the matrices of a loaded block cost less than its modes.
_SMALL = 60
# Relative size of a row up to which its field vanishes at the point by symmetry.
_ROUNDING = 1e-12


def loaded_blocks(parts: Sequence[DenseBlock], rows: Array, inertia: Array) -> tuple[RitzBlock, ...]:
    """Blocks of a plate with masses at points, from those without them.

    rows : (r, n) fields of each trial function of the space at the points; inertia : as in
    ``LoadedBlock``. A single part, and a small block, have the masses in their matrices.
    """
    of_parts = [rows[:, part.index] for part in parts]
    sizes = np.stack([np.abs(row).max(axis=1, initial=0.0) for row in of_parts], axis=1)
    moved = sizes > _ROUNDING * sizes.max(axis=1, keepdims=True)
    _, label = connected_components(moved.T.astype(int) @ moved, directed=False)
    blocks: list[RitzBlock] = []
    for number in dict.fromkeys(label):
        (members,) = np.nonzero(label == number)
        (there,) = np.nonzero(moved[:, members].any(axis=1))
        one = LoadedBlock(
            tuple(parts[i] for i in members.tolist()),
            np.concatenate(
                [np.where(moved[there, i, None], of_parts[i][there], 0.0) for i in members], axis=1
            ),
            inertia[:, there],
        )
        if not len(there):
            blocks += one.parts
        elif len(members) == 1 or one.size <= max(_SMALL, 4 * len(there)):
            blocks.append(one.dense())
        else:
            blocks.append(one)
    return tuple(blocks)


def symmetry_parts(operator: DenseOperator) -> LoadedBlock:
    """All parts of an operator as one block, with the masses that couple some of them."""
    parts: list[DenseBlock] = []
    rows, inertia = [], []
    for block in operator.blocks:
        loaded = block if isinstance(block, LoadedBlock) else unloaded((block.dense(),))
        parts += loaded.parts
        rows.append(loaded.rows)
        inertia.append(loaded.inertia)
    return LoadedBlock(tuple(parts), scipy.linalg.block_diag(*rows), np.concatenate(inertia, axis=1))


def unloaded(parts: tuple[DenseBlock, ...]) -> LoadedBlock:
    """Blocks as the parts of one, without masses that couple them."""
    return LoadedBlock(parts, np.zeros((0, sum(p.size for p in parts))), np.zeros((parts[0].n_terms[1], 0)))
