"""A problem on a Ritz space: dense blocks, assembled sector by sector from one-dimensional integrals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from cpam_bayes.mechanics.affine import (
    AffineMatrix,
    AffineOperator,
    DenseBlock,
    DenseOperator,
    Product,
    Profile,
)
from cpam_bayes.mechanics.loaded import loaded_blocks
from cpam_bayes.mechanics.problem import Atom, Derivative, Form, MatrixKind, Problem, Region, Values
from cpam_bayes.mechanics.ritz import Family, Quadrature, RitzSpace, broken_quadrature, evaluate_sector

Array = NDArray[Any]
Piece = tuple[int, int, Array]
MATRICES: tuple[MatrixKind, MatrixKind] = ("stiffness", "mass")


class SpaceValues:
    """Trial functions of a space and integrals of their products, computed once for all forms."""

    def __init__(self, space: RitzSpace) -> None:
        self.space = space
        self._rules: dict[Region, Quadrature] = {}
        self._points: dict[Region, tuple[Array, Array]] = {}
        self._sectors: dict[tuple[int, Region, Derivative], Array] = {}
        # Keys hold identities, so arrays and families are kept as long as the values.
        self._values: dict[tuple[int, int, bool], tuple[Family, Array, Array]] = {}
        self._overlaps: dict[tuple[object, ...], tuple[Family, Family, Array]] = {}
        self._broken: dict[tuple[float, ...], tuple[Array, Array]] = {}

    def rule(self, region: Region) -> Quadrature:
        """Points and weights of a region."""
        if region not in self._rules:
            self._rules[region] = self.space.quadrature(region)
        return self._rules[region]

    def _coordinates(self, region: Region) -> tuple[Array, Array]:
        if region not in self._points:
            x, y = self.rule(region).points.T
            self._points[region] = (x, y)
        return self._points[region]

    def sectors(self, atom: Atom, region: Region) -> list[tuple[int, Array]]:
        """The non-empty sectors of a field, with the values of an atom at a region's points."""
        found = []
        for i, sector in enumerate(self.space.sectors):
            if sector.field != atom.field or not sector.size:
                continue
            key = (i, region, atom.derivative)
            if key not in self._sectors:
                x, y = self._coordinates(region)
                in_x = self.at(sector.x, x, atom.derivative == "x")
                in_y = self.at(sector.y, y, atom.derivative == "y")
                self._sectors[key] = sector.products(in_x, in_y)
            found.append((i, self._sectors[key]))
        return found

    def at(self, family: Family, t: Array, derivative: bool) -> Array:
        """Functions or first derivatives of a family at points (n,), (n, size)."""
        key = (id(family), id(t), derivative)
        if key not in self._values:
            self._values[key] = (family, t, family.evaluate(t, derivative))
        return self._values[key][2]

    def overlap(
        self, left: tuple[Family, bool], right: tuple[Family, bool], axis: str, profile: Profile | None
    ) -> Array:
        """Integrals of products of functions or derivatives of two families, (left.size, right.size).

        profile : weight along the axis
        """
        key = (id(left[0]), left[1], id(right[0]), right[1], axis, profile)
        if key not in self._overlaps:
            t, w = self._axis_rule(axis, () if profile is None else profile.breaks)
            if profile is not None:
                w = w * profile(t)
            weighted = w[:, None] * self.at(right[0], t, right[1])
            self._overlaps[key] = (left[0], right[0], self.at(left[0], t, left[1]).T @ weighted)
        return self._overlaps[key][2]

    def _axis_rule(self, axis: str, breaks: tuple[float, ...]) -> tuple[Array, Array]:
        if not breaks:
            return self.space.x_grid if axis == "x" else self.space.y_grid
        if breaks not in self._broken:
            self._broken[breaks] = broken_quadrature(breaks)
        return self._broken[breaks]


def _area_pieces(form: Form, values: SpaceValues) -> list[Piece]:
    """Sector-by-sector matrices of an area form, by products of one-dimensional integrals.

    The weight is one or a product of functions of xi and of eta.
    """
    pieces = []
    for i, left in enumerate(values.space.sectors):
        for j, right in enumerate(values.space.sectors):
            if left.field != form.left.field or right.field != form.right.field:
                continue
            in_x = _overlap(left.x, right.x, form, "x", values)
            in_y = _overlap(left.y, right.y, form, "y", values) if in_x is not None else None
            if in_x is not None and in_y is not None:
                p, q = left.pairs, right.pairs
                pieces.append((i, j, in_x[np.ix_(p[:, 0], q[:, 0])] * in_y[np.ix_(p[:, 1], q[:, 1])]))
    return pieces


def _overlap(left: Family, right: Family, form: Form, axis: str, values: SpaceValues) -> Array | None:
    """One-dimensional integrals of products of two families; ``None`` where they vanish by parity."""
    in_left, in_right = form.left.derivative == axis, form.right.derivative == axis
    parity = left.parity * right.parity * (-1) ** (in_left + in_right)
    profile = None
    if isinstance(form.weight, Product):
        profile = form.weight.x if axis == "x" else form.weight.y
        parity *= profile.parity
    if parity < 0:
        return None
    return values.overlap((left, in_left), (right, in_right), axis, profile)


def _general_pieces(form: Form, values: SpaceValues) -> list[Piece]:
    """Sector-by-sector matrices of any form, by quadrature over its region."""
    rule = values.rule(form.region)
    if form.region.kind == "projection":
        return _projection_pieces(form, values, rule)
    weights = rule.weights * (1.0 if form.weight is None else form.weight(rule.points))
    pieces = []
    for i, b_left in values.sectors(form.left, form.region):
        for j, b_right in values.sectors(form.right, form.region):
            matrix = b_left.T @ (weights[:, None] * b_right)
            scale = (
                np.sqrt(len(weights)) * np.abs(weights).max() * np.abs(b_left).max() * np.abs(b_right).max()
            )
            if np.abs(matrix).max(initial=0.0) > 1e-12 * scale:
                pieces.append((i, j, matrix))
    return pieces


def _projection_pieces(form: Form, values: SpaceValues, rule: Quadrature) -> list[Piece]:
    """Sector-by-sector matrices of a "projection" form, a sum of products of integrals."""
    functions = projected_functions(form, rule)

    def moments(atom: Atom) -> list[tuple[int, Array]]:
        each = [(i, at.T @ functions) for i, at in values.sectors(atom, form.region)]
        size = max((np.abs(g).max() for _, g in each), default=0.0)
        # integrals that vanish by parity leave rounding
        return [(i, np.where(np.abs(g) > 1e-12 * size, g, 0.0)) for i, g in each]

    left = moments(form.left)
    right = left if form.right == form.left else moments(form.right)
    pairs = [(i, j, a @ b.T) for i, a in left for j, b in right]
    return [(i, j, matrix) for i, j, matrix in pairs if matrix.any()]


def projected_functions(form: Form, rule: Quadrature) -> Array:
    """Weighted values (n_points, r) of the functions on which a form projects."""
    values = np.ones((len(rule.points), 1)) if form.weight is None else form.weight(rule.points)
    return np.asarray(rule.weights[:, None] * values)


def form_pieces(form: Form, values: SpaceValues) -> list[Piece]:
    """Non-zero sector-by-sector matrices of a form, both triangles: (row sector, column sector, matrix)."""
    plain = form.region.kind == "area" and (form.weight is None or isinstance(form.weight, Product))
    pieces = _area_pieces(form, values) if plain else _general_pieces(form, values)
    if form.left != form.right:
        pieces = pieces + [(j, i, m.T) for i, j, m in pieces]
    return pieces


def active_terms(problem: Problem, samples: Values, matrix: MatrixKind) -> Array:
    """True for the forms whose coefficient is not zero at some sample, (n_forms,) bool."""
    c = np.abs(np.atleast_2d(problem.coefficients(samples, matrix)))
    c = c.reshape(-1, c.shape[-1])
    return np.asarray(c.max(axis=0) > 1e-12 * _comparable(problem.forms(matrix), c))


def _comparable(forms: Sequence[Form], coefficients: Array) -> Array:
    """Reference magnitude for calling a coefficient zero: that of its diagonal relatives.

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

    samples : parameter values, each (n_samples,), that cover the range of use: forms whose
    coefficient is zero at all of them are left out, and sectors that no form couples are separated.
    """
    n_k, n_m = len(problem.forms("stiffness")), len(problem.forms("mass"))
    return _discretise(problem, space, samples, (np.eye(n_k), np.eye(n_m)))


def discretise_at(problem: Problem, space: RitzSpace, samples: Values) -> DenseOperator:
    """The problem at fixed parameter samples only, to be used with ``np.eye(n_samples)`` as coefficients.

    It needs the memory of n_samples matrices instead of one per form.
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
    values = SpaceValues(space)
    links = {(i, i) for i in range(len(space.sectors))}
    masses: list[int] = []
    for kind in MATRICES:
        active = np.flatnonzero(active_terms(problem, samples, kind)).tolist()
        forms = problem.forms(kind)
        if kind == "mass":
            masses = [q for q in active if _is_point_mass(forms[q])]
        pieces.append({q: form_pieces(forms[q], values) for q in active if q not in masses})
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
    if not masses:
        return AffineOperator(problem, space, tuple(blocks))
    rows = np.stack([_row(problem.forms("mass")[q], space) for q in masses])
    return AffineOperator(problem, space, loaded_blocks(blocks, rows, combine[1][:, masses]))


def _is_point_mass(form: Form) -> bool:
    return form.region.kind == "point" and form.left == form.right and form.weight is None


def _row(form: Form, space: RitzSpace) -> Array:
    """Values of every trial function in a form at a point, (n_functions,)."""
    point = np.array([form.region.point])
    row = np.zeros(sum(s.size for s in space.sectors))
    start = 0
    for sector in space.sectors:
        if sector.field == form.left.field:
            row[start : start + sector.size] = evaluate_sector(sector, point, form.left.derivative)[0]
        start += sector.size
    return row


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
