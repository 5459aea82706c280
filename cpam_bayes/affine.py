"""Discretised problems: K(p) = sum_q theta_q(p) K_q and M(p) = sum_q mu_q(p) M_q, dense or sparse."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.problem import Form, Problem, Values
from cpam_bayes.spaces.protocol import Space
from cpam_bayes.spaces.ritz import Family, RitzSpace, evaluate_sector

Array = NDArray[Any]


@dataclass(frozen=True, slots=True)
class AffineMatrix:
    """A symmetric matrix that is a sum of fixed matrices times coefficients, on one block.

    ``stack`` (n_active, n, n) holds the matrices, ``active`` (n_active,) the coefficients they
    belong to.
    """

    stack: Array
    active: Array

    def assemble(self, coefficients: Array) -> Array:
        """The matrix at coefficients (..., n_terms), (..., n, n)."""
        n = self.stack.shape[-1]
        flat = coefficients[..., self.active] @ self.stack.reshape(len(self.active), n * n)
        return flat.reshape(*coefficients.shape[:-1], n, n)

    def quadratic(self, left: Array, right: Array) -> Array:
        """left^T K_q right of every active term, (n_active, left.shape[1], right.shape[1])."""
        return left.T @ (self.stack @ right)

    def restricted(self, keep: Array) -> AffineMatrix:
        """The same sum on some of the trial functions, ``keep`` (n,) bool."""
        return AffineMatrix(self.stack[:, keep][:, :, keep], self.active)

    def project(self, basis: Array) -> AffineMatrix:
        """The same sum on the span of ``basis`` (n, r)."""
        return AffineMatrix(basis.T @ (self.stack @ basis), self.active)


@dataclass(frozen=True, slots=True)
class Block:
    """Trial functions that couple only among themselves, by symmetry.

    index : (n,) positions of the block's trial functions in the whole space.
    """

    stiffness: AffineMatrix
    mass: AffineMatrix
    index: Array

    @property
    def size(self) -> int:
        """Number of trial functions."""
        return len(self.index)


@dataclass(frozen=True, slots=True)
class AffineOperator:
    """A problem on a dense space, split into blocks that do not couple."""

    problem: Problem
    space: RitzSpace
    blocks: tuple[Block, ...]

    def restricted(self, keep: Array) -> AffineOperator:
        """The operator on the trial functions marked in ``keep`` (n_functions,) bool."""
        number = np.cumsum(keep) - 1
        blocks = [
            Block(b.stiffness.restricted(k), b.mass.restricted(k), number[b.index[k]])
            for b, k in ((b, keep[b.index]) for b in self.blocks)
            if k.any()
        ]
        return AffineOperator(self.problem, self.space.restricted(keep), tuple(blocks))

    def coefficients(self, values: Values) -> tuple[Array, Array]:
        """Coefficients of K and of M at parameter values, (..., n_stiffness) and (..., n_mass)."""
        return (
            self.problem.coefficients(values, "stiffness"),
            self.problem.coefficients(values, "mass"),
        )


Piece = tuple[int, int, Array]
MatrixKind = Literal["stiffness", "mass"]
MATRICES: tuple[MatrixKind, MatrixKind] = ("stiffness", "mass")


def _area_pieces(form: Form, space: RitzSpace) -> list[Piece]:
    """Sector-by-sector matrices of an unweighted area form, by products of one-dimensional integrals."""
    (x, wx), (y, wy) = space.x_grid, space.y_grid
    pieces = []
    for i, left in enumerate(space.sectors):
        for j, right in enumerate(space.sectors):
            if left.field != form.left.field or right.field != form.right.field:
                continue
            in_x = _overlap(left.x, right.x, form, "x", x, wx)
            in_y = _overlap(left.y, right.y, form, "y", y, wy)
            if in_x is not None and in_y is not None:
                p, q = left.pairs, right.pairs
                pieces.append((i, j, in_x[np.ix_(p[:, 0], q[:, 0])] * in_y[np.ix_(p[:, 1], q[:, 1])]))
    return pieces


def _overlap(left: Family, right: Family, form: Form, axis: str, t: Array, w: Array) -> Array | None:
    """One-dimensional integrals of products of two families; ``None`` where they vanish by parity."""
    in_left, in_right = form.left.derivative == axis, form.right.derivative == axis
    if left.parity * right.parity * (-1) ** (in_left + in_right) < 0:
        return None
    return np.asarray(left.evaluate(t, in_left).T @ (w[:, None] * right.evaluate(t, in_right)))


def _general_pieces(form: Form, space: RitzSpace) -> list[Piece]:
    """Sector-by-sector matrices of any form, by quadrature over its region."""
    rule = space.quadrature(form.region)
    weights = rule.weights * (1.0 if form.weight is None else form.weight(rule.points))
    pieces = []
    for i, left in enumerate(space.sectors):
        if left.field != form.left.field:
            continue
        b_left = evaluate_sector(left, rule.points, form.left.derivative)
        for j, right in enumerate(space.sectors):
            if right.field != form.right.field:
                continue
            b_right = evaluate_sector(right, rule.points, form.right.derivative)
            matrix = b_left.T @ (weights[:, None] * b_right)
            scale = np.sqrt(len(weights)) * np.abs(weights).max() * np.abs(b_left).max() * np.abs(b_right).max()
            if np.abs(matrix).max(initial=0.0) > 1e-12 * scale:
                pieces.append((i, j, matrix))
    return pieces


def form_pieces(form: Form, space: RitzSpace) -> list[Piece]:
    """Non-zero sector-by-sector matrices of a form, both triangles: (row sector, column sector, matrix)."""
    plain = form.region.kind == "area" and form.weight is None
    pieces = _area_pieces(form, space) if plain else _general_pieces(form, space)
    if form.left != form.right:
        pieces = pieces + [(j, i, m.T) for i, j, m in pieces]
    return pieces


def active_terms(problem: Problem, samples: Values, matrix: MatrixKind) -> Array:
    """Which forms have a coefficient that is not zero at all samples, (n_forms,) bool."""
    c = np.abs(np.atleast_2d(problem.coefficients(samples, matrix)))
    c = c.reshape(-1, c.shape[-1])
    return np.asarray(c.max(axis=0) > 1e-12 * _comparable(problem.forms(matrix), c))


def _comparable(forms: Sequence[Form], coefficients: Array) -> Array:
    """Magnitude that a coefficient is compared with to be called zero: its largest diagonal relatives."""
    own = {f.left: c for f, c in zip(forms, coefficients.max(axis=0), strict=True) if f.left == f.right}
    return np.array([np.sqrt(own.get(f.left, 0.0) * own.get(f.right, 0.0)) for f in forms])


def discretise(problem: Problem, space: RitzSpace, samples: Values) -> AffineOperator:
    """The problem on a dense space, split by the symmetries that hold at all ``samples``.

    samples : parameter values, each (n_samples,), that cover what will be asked: forms whose
    coefficient is zero at all of them are left out, and sectors that no form couples are separated.
    """
    n_k, n_m = len(problem.forms("stiffness")), len(problem.forms("mass"))
    return _discretise(problem, space, samples, (np.eye(n_k), np.eye(n_m)))


def discretise_at(problem: Problem, space: RitzSpace, samples: Values) -> AffineOperator:
    """The problem at fixed parameter samples only, to be used with ``np.eye(n_samples)`` as coefficients.

    It needs the memory of n_samples matrices instead of one a form.
    """
    stiffness, mass = (np.atleast_2d(problem.coefficients(samples, kind)) for kind in MATRICES)
    n = max(len(stiffness), len(mass))
    combine = tuple(np.broadcast_to(c, (n, c.shape[-1])) for c in (stiffness, mass))
    return _discretise(problem, space, samples, combine)


def _discretise(
    problem: Problem, space: RitzSpace, samples: Values, combine: tuple[Array, Array]
) -> AffineOperator:
    """Blocks of sum_q combine[r, q] K_q for every row r of ``combine`` (n_rows, n_forms)."""
    pieces: list[dict[int, list[Piece]]] = []
    links = {(i, i) for i in range(len(space.sectors))}
    for kind in MATRICES:
        active = active_terms(problem, samples, kind)
        forms = problem.forms(kind)
        pieces.append({q: form_pieces(f, space) for q, f in enumerate(forms) if active[q]})
        links |= {(i, j) for parts in pieces[-1].values() for i, j, _ in parts}
    starts = np.cumsum([0, *(s.size for s in space.sectors)])
    blocks = []
    for members in _components(len(space.sectors), links):
        local = np.cumsum([0, *(space.sectors[i].size for i in members)])
        place = {i: slice(a, b) for i, a, b in zip(members, local[:-1], local[1:], strict=True)}
        matrices = [
            _stack(p, c, place, int(local[-1])) for p, c in zip(pieces, combine, strict=True)
        ]
        index = np.concatenate([np.arange(starts[i], starts[i + 1]) for i in members])
        blocks.append(Block(*matrices, index=index))
    return AffineOperator(problem, space, tuple(blocks))


def _stack(
    pieces: dict[int, list[Piece]], combine: Array, place: dict[int, slice], n: int
) -> AffineMatrix:
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
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    rows, columns = zip(*sorted(links), strict=True)
    graph = coo_matrix((np.ones(len(links)), (rows, columns)), shape=(n, n))
    count, label = connected_components(graph, directed=False)
    return [np.flatnonzero(label == c).tolist() for c in range(count)]
