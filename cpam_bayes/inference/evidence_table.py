"""A smooth log evidence as a table of quadratics on small cells, looked up by lamination parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

# (m, 4 + n_q) sums -> log evidence (m,) and gradient (m, 4 + n_q).
Surface = Callable[[Array], tuple[Array, Array]]

# Cells are halved so often; the first ones are 2 / _FIRST wide.
_FIRST = 12
# Step of the differences that second derivatives are taken by, in cell widths.
_STEP = 0.25
_PAIRS = [(i, j) for i in range(4) for j in range(i, 4)]


@dataclass(frozen=True, slots=True)
class EvidenceTable:
    """Log evidence on cells of the four sums v; cells where it is below a floor are left out.

    width : of a cell. leaf : (g^4,) int32, which row of ``quadratic`` a cell has, -1 where it was left
    out. centre : (L, 4). quadratic : (L, 1 + 4 + 10 + n_q): value at the centre, gradient in v, second
    derivatives (the half of those on the diagonal), gradient in q. floor : what left-out cells are below.
    """

    width: float
    side: int
    leaf: Array
    centre: Array
    quadratic: Array
    floor: float

    def lookup(self, v: Array) -> Array:
        """Rows of ``quadratic`` of points (m, 4), -1 where the cell was left out, (m,)."""
        cell = np.minimum(((v + 1.0) / self.width).astype(np.int64), self.side - 1)
        return np.asarray(self.leaf[_flat(cell, self.side)])

    def values(self, rows: Array, v: Array, q: Array) -> Array:
        """Log evidence of points in the cells ``rows`` (m,), v (m, 4), q (m, n_q)."""
        c = self.quadratic[rows]
        d = v - self.centre[rows]
        found = c[:, 0].astype(np.float64)
        for i in range(4):
            found += c[:, 1 + i] * d[:, i]
        for n, (i, j) in enumerate(_PAIRS):
            found += c[:, 5 + n] * d[:, i] * d[:, j]
        for i in range(q.shape[1]):
            found += c[:, 15 + i] * q[:, i]
        return found


def build_table(surface: Surface, q_reach: Array, floor: float, halvings: int, slack: float) -> EvidenceTable:
    """Quadratics of a surface wherever it may exceed ``floor``, on cells halved ``halvings`` times.

    A cell is left out where no set of plies can lie (the Toeplitz matrix of 1, v1 + i v2, v3 + i v4 is
    not positive) or where the value at its centre, the most that the gradient adds over the cell and over
    the reach of q, and ``slack`` together stay below the floor.

    q_reach : (n_q,) largest magnitude of each further sum.
    """
    axis = (np.arange(_FIRST) + 0.5) * 2.0 / _FIRST - 1.0
    centre = np.stack(np.meshgrid(axis, axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 4)
    width, n_q = 2.0 / _FIRST, len(q_reach)
    for level in range(halvings + 1):
        centre = centre[_realisable(centre, width)]
        value, slope = _at(surface, centre, n_q)
        reach = 0.5 * width * np.abs(slope[:, :4]).sum(axis=1) + np.abs(slope[:, 4:]) @ q_reach
        # a coarse cell is not straight: its own gain stands for the curvature's
        gain = reach * (1.0 if level == halvings else 2.0) + slack * (1.0 if level == halvings else 3.0)
        kept = value + gain >= floor
        centre, value, slope = centre[kept], value[kept], slope[kept]
        if level < halvings:
            corners = np.stack(np.meshgrid(*[[-0.25, 0.25]] * 4, indexing="ij"), axis=-1).reshape(-1, 4)
            centre = (centre[:, None, :] + width * corners).reshape(-1, 4)
            width *= 0.5
    side = _FIRST << halvings
    hessian = np.empty((len(centre), 10))
    step = _STEP * width
    up, down = [], []
    for i in range(4):
        shift = step * (np.arange(4) == i)
        up.append(_at(surface, centre + shift, n_q)[1][:, :4])
        down.append(_at(surface, centre - shift, n_q)[1][:, :4])
    second = (np.stack(up, axis=1) - np.stack(down, axis=1)) / (2 * step)
    for n, (i, j) in enumerate(_PAIRS):
        hessian[:, n] = 0.5 * second[:, i, i] if i == j else 0.5 * (second[:, i, j] + second[:, j, i])
    leaf = np.full(side**4, -1, dtype=np.int32)
    cell = np.minimum(((centre + 1.0) / width).astype(np.int64), side - 1)
    leaf[_flat(cell, side)] = np.arange(len(centre))
    quadratic = np.column_stack((value, slope[:, :4], hessian, slope[:, 4:])).astype(np.float32)
    return EvidenceTable(width, side, leaf, centre.astype(np.float32), quadratic, floor)


def _flat(cell: Array, side: int) -> Array:
    """Place of cells (m, 4) in a flat table."""
    return np.asarray(((cell[:, 0] * side + cell[:, 1]) * side + cell[:, 2]) * side + cell[:, 3])


def _at(surface: Surface, v: Array, n_q: int) -> tuple[Array, Array]:
    return surface(np.column_stack((v, np.zeros((len(v), n_q)))))


def _realisable(v: Array, width: float) -> Array:
    """Whether a cell about v may hold sums of unit vectors: its Toeplitz matrix is nearly positive."""
    a, b = v[:, 0] + 1j * v[:, 1], v[:, 2] + 1j * v[:, 3]
    one = np.ones(len(v))
    matrix = np.stack(
        (
            np.stack((one + 0j, a, b), -1),
            np.stack((a.conj(), one + 0j, a), -1),
            np.stack((b.conj(), a.conj(), one + 0j), -1),
        ),
        -2,
    )
    # an entry moves by sqrt(2) width / 2 at most, half a diagonal, and a row has two beside its one
    return np.asarray(np.linalg.eigvalsh(matrix)[:, 0] >= -np.sqrt(2.0) * width)
