"""Fields, strains and loads of a reduced basis at arbitrary points and over patches, for stacks of plates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.polynomial import legendre

from cpam_bayes.mechanics.problem import STRAIN_ATOMS, Array, Atom
from cpam_bayes.mechanics.ritz import Family, RitzSpace, legendre_values
from cpam_bayes.plate.edges import Field


@dataclass(frozen=True, slots=True)
class FieldPart:
    """Contribution of one sector of trial functions to a field of the basis vectors of one block.

    block, columns : index of the block, and those of its vectors in the whole basis
    tensor : (x.size, y.size, n_columns)
    """

    field: Field
    x: Family
    y: Family
    block: int
    columns: slice
    tensor: Array


def field_parts(space: RitzSpace, indices: list[Array], bases: list[Array]) -> tuple[FieldPart, ...]:
    """Parts of bases (n_block, r), one per block, with the indices of its trial functions in the space."""
    parts = []
    first = 0
    for sector in space.sectors:
        start = 0
        for block, (index, basis) in enumerate(zip(indices, bases, strict=True)):
            columns = slice(start, start + basis.shape[1])
            start = columns.stop
            inside = np.flatnonzero((index >= first) & (index < first + sector.size))
            if not len(inside) or not basis.shape[1]:
                continue
            pairs = sector.pairs[index[inside] - first]
            tensor = np.zeros((sector.x.size, sector.y.size, basis.shape[1]))
            tensor[pairs[:, 0], pairs[:, 1]] = basis[inside]
            if np.abs(tensor).max() > 0.0:
                parts.append(FieldPart(sector.field, sector.x, sector.y, block, columns, tensor))
        first += sector.size
    return tuple(parts)


class PointValues:
    """Trial functions of one coordinate at points (...), each family evaluated once."""

    def __init__(self, t: Array) -> None:
        self.points = t
        self._legendre: tuple[Array, Array] | None = None
        self._values: dict[tuple[int, bool], tuple[Family, Array]] = {}

    def at(self, family: Family, derivative: bool) -> Array:
        """Functions or first derivatives, (..., size)."""
        key = (id(family), derivative)
        if key not in self._values:
            self._values[key] = (family, self._raw(family, derivative) @ family.transform)
        return self._values[key][1]

    def along(self, families: tuple[Family, ...], derivative: bool) -> Array:
        """Functions or derivatives of several families, one after the other, (..., size)."""
        return np.concatenate([self.at(family, derivative) for family in families], axis=-1)

    def _raw(self, family: Family, derivative: bool) -> Array:
        t = self.points
        highest = int(family.degrees.max(initial=0))
        if self._legendre is None or self._legendre[0].shape[-1] <= highest:
            self._legendre = legendre_values(t, highest + 2)
        columns = [self._legendre[int(derivative)][..., family.degrees]]
        for r in family.rates:
            near, far = np.exp(-r * t), np.exp(-r * (1 - t))
            if derivative:
                near, far = -r * near, r * far
            by_sign = {1: near + far, -1: near - far, 2: near, 3: far}
            columns += [by_sign[sign][..., None] for sign in family.signs]
        return np.concatenate(columns, axis=-1)


@dataclass(frozen=True, slots=True)
class FieldGrid:
    """All functions of x and of y of which some sectors of one field are made.

    x, y : families, one after the other
    cells : index of each sector or part, and slices of its functions in those of x and of y
    """

    field: Field
    x: tuple[Family, ...]
    y: tuple[Family, ...]
    cells: tuple[tuple[int, slice, slice], ...]

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of functions of x and of y."""
        return sum(f.size for f in self.x), sum(f.size for f in self.y)


def field_grid(field: Field, sectors: Sequence[FieldPart]) -> FieldGrid:
    """The functions of x and y in those sectors that are of one field."""
    of_field = [(number, s) for number, s in enumerate(sectors) if s.field == field]
    xs, ys = ({id(getattr(s, a)): getattr(s, a) for _, s in of_field} for a in ("x", "y"))
    in_x, in_y = _places(xs), _places(ys)
    cells = tuple((number, in_x[id(s.x)], in_y[id(s.y)]) for number, s in of_field)
    return FieldGrid(field, tuple(xs.values()), tuple(ys.values()), cells)


def _places(families: dict[int, Family]) -> dict[int, slice]:
    ends = np.cumsum([0, *(f.size for f in families.values())]).tolist()
    return {key: slice(a, b) for key, a, b in zip(families, ends[:-1], ends[1:], strict=True)}


def values_at_points(
    parts: tuple[FieldPart, ...], n_basis: int, atom: Atom, x: PointValues, y: PointValues, m: int
) -> Array:
    """A field or derivative of all basis vectors at m points, (m, n_basis)."""
    out = np.zeros((m, n_basis))
    for part in parts:
        if part.field == atom.field:
            a, b = x.at(part.x, atom.derivative == "x"), y.at(part.y, atom.derivative == "y")
            products = (a[:, :, None] * b[:, None, :]).reshape(m, -1)
            out[:, part.columns] += products @ part.tensor.reshape(products.shape[1], -1)
    return out


PatchForm = Literal["bell", "rectangle"]

# Range of a bell's integration, in its widths: 5e-4 of it lie beyond. Points of its measure there.
_REACH, _FINE = 3.5, 48


@dataclass(frozen=True, slots=True)
class PatchRule:
    """Points of m patches in one direction, clipped by the plate, all (m, n).

    points : reference coordinate
    weight : of the integral with the profile g
    per_centre, per_width : derivatives of the integral by centre and width of the patch, as weights
    """

    points: Array
    weight: Array
    per_centre: Array
    per_width: Array


def patch_rules(
    form: PatchForm, centre: Array, width: Array, n: Array, with_ends: bool
) -> tuple[PatchRule, PatchRule]:
    """The rules in x and y of patches with centres and widths (m, 2), of n (m,) points each.

    Where others have more, further points of zero weight follow.

    with_ends : with points at the ends, where a change of a rectangle changes the integrals
    """
    m = len(n)
    rule = _bell if form == "bell" else _rectangle
    # both directions at once
    both = rule(centre.T.ravel(), width.T.ravel(), np.concatenate((n, n)), with_ends)
    x, y = (
        PatchRule(*(getattr(both, f.name)[rows] for f in fields(PatchRule)))
        for rows in (slice(0, m), slice(m, None))
    )
    return x, y


def _bell(centre: Array, width: Array, n: Array, with_ends: bool) -> PatchRule:
    """Gauss's rule for the bell as a weight, which ends at the edges of the plate."""
    start, end = centre - _REACH * width, centre + _REACH * width
    low, high = np.maximum(start, 0.0), np.minimum(end, 1.0)
    nodes, weights = _nodes(_FINE)
    fine = low[:, None] + (high - low)[:, None] * nodes
    distance = (fine - centre[:, None]) / width[:, None]
    points, weight = _gauss(fine, (high - low)[:, None] * weights * np.exp(-0.5 * distance**2), n)
    distance = (points - centre[:, None]) / width[:, None]
    per_centre = weight * distance / width[:, None]
    return PatchRule(points, weight, per_centre, per_centre * distance)


def _rectangle(centre: Array, width: Array, n: Array, with_ends: bool) -> PatchRule:
    start, end = centre - width, centre + width
    low, high = np.maximum(start, 0.0), np.minimum(end, 1.0)
    first = 1 if with_ends else 0
    nodes, weights = np.full((len(n), n.max() + 2 * first), 0.5), np.zeros((len(n), n.max() + 2 * first))
    for count in np.unique(n).tolist():
        at = np.ix_(n == count, np.arange(first, first + count))
        nodes[at], weights[at] = _nodes(count)
    per_centre, per_width = np.zeros_like(nodes), np.zeros_like(nodes)
    if with_ends:
        for column, free, sign in ((0, start > 0.0, -1.0), (-1, end < 1.0, 1.0)):
            nodes[:, column] = max(sign, 0.0)
            per_centre[:, column] = sign * free
            per_width[:, column] = free
    points = low[:, None] + (high - low)[:, None] * nodes
    return PatchRule(points, (high - low)[:, None] * weights, per_centre, per_width)


def _gauss(points: Array, weights: Array, n: Array) -> tuple[Array, Array]:
    """Gauss's rules of n (m,) points for discrete measures with weights (m, k) at points (m, k).

    By the recurrence of their orthogonal polynomials (Stieltjes) and its tridiagonal matrix (Golub and
    Welsch, Math. Comp. 23, 1969), which decouples after n rows.
    """
    most = int(n.max())
    whole = weights.sum(axis=1)
    matrix = np.zeros((len(points), most, most))
    before, now = np.zeros_like(points), np.ones_like(points) / np.sqrt(whole)[:, None]
    beta = np.zeros(len(points))
    for k in range(most):
        matrix[:, k, k] = alpha = np.sum(points * weights * now**2, axis=1)
        if k + 1 == most:
            break
        after = (points - alpha[:, None]) * now - beta[:, None] * before
        beta = np.sqrt(np.sum(weights * after**2, axis=1))
        before, now = now, after / beta[:, None]
        matrix[:, k, k + 1] = matrix[:, k + 1, k] = np.where(k + 1 < n, beta, 0.0)
    at, vectors = np.linalg.eigh(matrix)
    return at, whole[:, None] * vectors[:, 0] ** 2


@lru_cache
def _nodes(n: int) -> tuple[Array, Array]:
    """Points and weights on [0, 1] of Gauss's rule."""
    t, weights = legendre.leggauss(n)
    return 0.5 * (t + 1.0), 0.5 * weights


Parts = Sequence[FieldPart]
Rules = tuple[PatchRule, PatchRule]

# Curvatures and transverse shears, whose stiffness a softer patch reduces, and the derivatives in them.
BENT = tuple(range(3, 8))
ATOMS = tuple(dict.fromkeys(atom for q in BENT for atom, _ in STRAIN_ATOMS[q]))
# For each derivative, the one strain to which it belongs, and the size that divides it.
STRAIN_OF = tuple(
    next((i, size) for i, q in enumerate(BENT) for atom, size in STRAIN_ATOMS[q] if atom == wanted)
    for wanted in ATOMS
)
_FIELDS = tuple(dict.fromkeys(atom.field for atom in ATOMS))


@dataclass(frozen=True, slots=True)
class _Side:
    """Functions of x of one field, or their derivatives, and the functions of y that they multiply.

    in_x : (m, n, nx) at the points
    in_y : index of each product and its functions of y, (m, n, ny)
    """

    in_x: Array
    in_y: tuple[tuple[int, Array], ...]


class PatchPoints:
    """The points of patches, in rows of n in y by n in x."""

    def __init__(self, parts: Parts, rules: Rules, sizes: dict[str, Array] | None = None) -> None:
        """Fields at the points of some rules.

        sizes : lengths (m,) that divide derivatives. With them the rows are strains times the roots of the
            points' weights; without them they are derivatives.
        """
        self.parts = parts
        self.shape = rules[0].points.shape
        self.n_rows = len(ATOMS) if sizes is None else len(BENT)
        x, y = (PointValues(rule.points) for rule in rules)
        roots = [np.sqrt(rule.weight)[..., None] for rule in rules]
        self._fields: list[tuple[FieldGrid, list[_Side]]] = []
        for field in _FIELDS:
            grid = field_grid(field, parts)
            sides = []
            for along in (False, True):
                in_y = []
                for number, atom in enumerate(ATOMS):
                    if atom.field != field or (atom.derivative == "x") != along:
                        continue
                    values = y.along(grid.y, atom.derivative == "y")
                    if sizes is not None:
                        number, size = STRAIN_OF[number]
                        values = values * (roots[1] / sizes[size][:, None, None])
                    in_y.append((number, values))
                if in_y:
                    in_x = x.along(grid.x, along)
                    sides.append(_Side(in_x if sizes is None else roots[0] * in_x, tuple(in_y)))
            self._fields.append((grid, sides))

    def rows(self, vectors: list[Array], columns: list[slice]) -> Array:
        """Rows of vectors (m, n, k) of each block, placed in these columns, (m, n_rows, n_points r)."""
        m, n = self.shape
        r = max(c.stop for c in columns)
        out = np.zeros((m, self.n_rows, n, n * r))
        for grid, sides in self._fields:
            nx, ny = grid.shape
            coefficients = np.zeros((m, nx, ny, r))
            for number, along, across in grid.cells:
                b = self.parts[number].block
                coefficients[:, along, across, columns[b]] += _coefficients(self.parts[number], vectors[b])
            flat = coefficients.reshape(m, nx, ny * r)
            for side in sides:
                # one product per set: the other direction first
                in_x = (side.in_x @ flat).reshape(m, n, ny, r).transpose(0, 2, 1, 3).reshape(m, ny, n * r)
                for i, in_y in side.in_y:
                    out[:, i] += in_y @ in_x
        return out.reshape(m, self.n_rows, -1)

    def loads(self, stresses: Array, k: int) -> Array:
        """Work of stresses (m, n_rows, n_points k) on the vectors of the common basis, (m, k, n)."""
        m, n = self.shape
        stresses = stresses.reshape(m, self.n_rows, n, n * k)
        out = np.zeros((m, max(part.columns.stop for part in self.parts), k))
        for grid, sides in self._fields:
            nx, ny = grid.shape
            on_functions = np.zeros((m, nx, ny * k))
            for side in sides:
                of_y = sum(np.swapaxes(in_y, 1, 2) @ stresses[:, i] for i, in_y in side.in_y)
                of_y = np.asarray(of_y).reshape(m, ny, n, k).transpose(0, 2, 1, 3).reshape(m, n, ny * k)
                on_functions += np.swapaxes(side.in_x, 1, 2) @ of_y
            cells = on_functions.reshape(m, nx, ny, k)
            for number, along, across in grid.cells:
                part = self.parts[number]
                flat = cells[:, along, across].reshape(m, -1, k)
                out[:, part.columns] += part.tensor.reshape(flat.shape[1], -1).T @ flat
        return np.swapaxes(out, 1, 2)


def _coefficients(part: FieldPart, vectors: Array) -> Array:
    """Coefficients of vectors (m, n, k) of the basis in a part's products of functions, (m, nx, ny, k).

    Vectors may be on the leading part of the basis only.
    """
    nx, ny, _ = part.tensor.shape
    n = vectors.shape[1]
    return (part.tensor[..., :n].reshape(-1, n) @ vectors).reshape(len(vectors), nx, ny, -1)
