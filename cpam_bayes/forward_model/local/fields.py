"""Fields of the reduced basis of a plate at any points: separable trial functions, contracted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.mechanics.problem import Atom, Field
from cpam_bayes.mechanics.spaces.ritz import Family, RitzSpace, legendre_values

Array = NDArray[Any]


@dataclass(frozen=True, slots=True)
class FieldPart:
    """What one sector of trial functions contributes to a field of the basis vectors of one block.

    sector : its number in the space
    block, columns : number of the block, and of its vectors in the whole basis
    tensor : (x.size, y.size, n_columns)
    """

    field: Field
    x: Family
    y: Family
    sector: int
    block: int
    columns: slice
    tensor: Array


def field_parts(space: RitzSpace, indices: list[Array], bases: list[Array]) -> tuple[FieldPart, ...]:
    """The parts of bases (n_block, r), one a block whose trial functions have these indices in the space."""
    parts = []
    first = 0
    for number, sector in enumerate(space.sectors):
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
                parts.append(FieldPart(sector.field, sector.x, sector.y, number, block, columns, tensor))
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
        """Those of several families, one after the other, (..., size)."""
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
    """All functions of x and of y that some sectors of one field are made of.

    x, y : families, one after the other
    cells : number of each sector or part, and its functions among those of x and of y
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
    """The functions of one field of some sectors."""
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
