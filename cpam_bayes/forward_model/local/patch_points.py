"""Strains and loads at the points of a patch, for stacks of plates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.forward_model.local.fields import FieldGrid, FieldPart, PointValues, field_grid
from cpam_bayes.forward_model.local.patch_rule import PatchRule
from cpam_bayes.mechanics.problem import STRAIN_ATOMS

Array = NDArray[Any]
Parts = Sequence[FieldPart]
Rules = tuple[PatchRule, PatchRule]

# Curvatures and transverse shears: what a softer patch multiplies, and the derivatives that they have.
BENT = tuple(range(3, 8))
ATOMS = tuple(dict.fromkeys(atom for q in BENT for atom, _ in STRAIN_ATOMS[q]))
# Of each derivative: the one strain that it belongs to, and the size that divides it.
STRAIN_OF = tuple(
    next((i, size) for i, q in enumerate(BENT) for atom, size in STRAIN_ATOMS[q] if atom == wanted)
    for wanted in ATOMS
)
_FIELDS = tuple(dict.fromkeys(atom.field for atom in ATOMS))


@dataclass(frozen=True, slots=True)
class _Side:
    """Functions of x of one field, or their derivatives, and what they are multiplied by.

    in_x : (m, n, nx) at the points
    in_y : of each product its number and the functions of y, (m, n, ny)
    """

    in_x: Array
    in_y: tuple[tuple[int, Array], ...]


class PatchPoints:
    """The points of patches, in rows of n in y by n in x."""

    def __init__(self, parts: Parts, rules: Rules, sizes: dict[str, Array] | None = None) -> None:
        """What fields have there.

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
        """Rows of vectors (m, n, k) of each block, which stand in these columns, (m, n_rows, n_points r)."""
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
                # one product a set: the other direction first
                in_x = (side.in_x @ flat).reshape(m, n, ny, r).transpose(0, 2, 1, 3).reshape(m, ny, n * r)
                for i, in_y in side.in_y:
                    out[:, i] += in_y @ in_x
        return out.reshape(m, self.n_rows, -1)

    def loads(self, stresses: Array, k: int) -> Array:
        """What stresses (m, n_rows, n_points k) do on the vectors of the common basis, (m, k, n)."""
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
    """Of vectors (m, n, k) of the common basis in the products of functions of a part, (m, nx, ny, k).

    Vectors may be shorter than the basis: the leading ones.
    """
    nx, ny, _ = part.tensor.shape
    n = vectors.shape[1]
    return (part.tensor[..., :n].reshape(-1, n) @ vectors).reshape(len(vectors), nx, ny, -1)
