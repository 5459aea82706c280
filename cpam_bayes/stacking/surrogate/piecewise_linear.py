"""The piecewise-linear surrogate: tangents of a smooth log evidence on cells of the lamination parameters."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.parallel import run

Array = NDArray[Any]

# (m, 4 + n_q) sums -> scores and rest (m, n_z + 1) with their gradients (m, n_z + 1, 4 + n_q).
Tangent = Callable[[Array], tuple[Array, Array]]

# Cells along an axis, from -1 to 1, before any is halved.
_FIRST = 12
# Cells that stay farther below the top than this, nats, are halved once only.
_REFINED_DEPTH_NATS = 6.0
# Cells that a worker takes at a time.
_BATCH = 8192
# Factors on the half-width and on the slack of a cell that may be halved: its tangent says less of it.
_COARSE_WIDTH, _COARSE_SLACK = 1.5, 3.0


@dataclass(frozen=True, slots=True)
class PiecewiseLinearSurrogate:
    """Log evidence on cells of the four sums v; cells where it is below a lower bound are left out.

    The scores z and the rest r of ``log_evidence`` are linear in the sums on each cell.

    width : of the finest cells.
    first : (4,) number along each axis of the first cell of a box about those that were kept; the outermost
    cells of the box are empty.
    leaf : (n_1, n_2, n_3, n_4) int32, row of ``tangent`` of each cell of the box, -1 where it was left out.
    tangent : (L, n_z + 1, 1 + 4 + n_q), scores, and last the rest, continued to sums of zero, and their
    gradients.
    lower_bound : log evidence that cells left out do not exceed.
    freedom : of ``log_evidence``.
    """

    width: float
    first: Array
    leaf: Array
    tangent: Array
    lower_bound: float
    freedom: float

    def lookup(self, v: Array) -> Array:
        """Rows of ``tangent`` of points (m, 4), -1 where the cell was left out, (m,)."""
        # what lies beyond the box counts as in its outermost cells
        cell = np.clip(np.floor((v + 1.0) / self.width).astype(np.int64) - self.first, 0, self._last)
        return np.asarray(self.leaf[tuple(cell.T)])

    @property
    def _last(self) -> Array:
        return np.array(self.leaf.shape) - 1

    def rows(self, v: Array, shift: Array) -> Array:
        """Rows of ``tangent`` of points v + shift, v (4, m) and shift (4,), in single precision, (m,)."""
        flat = np.zeros(v.shape[1], dtype=np.int64)
        scale = np.float32(1.0 / self.width)
        for i, n in enumerate(self.leaf.shape):
            # truncated, not floored: that differs before the box only, whose first cells are empty
            begin = np.float32(shift[i] + 1.0 - self.first[i] * self.width)
            cell = ((v[i] + begin) * scale).astype(np.int32)
            np.clip(cell, 0, n - 1, out=cell)
            flat *= n
            flat += cell
        return np.asarray(self.leaf.ravel()[flat])

    def values(self, rows: Array, sums: Array) -> Array:
        """Log evidence of points in the cells ``rows`` (m,), a one, v and q in each row of ``sums``."""
        y = np.matmul(np.take(self.tangent, rows, axis=0), sums[:, :, None])[:, :, 0]
        return log_evidence(y.astype(np.float64), self.freedom)


def log_evidence(y: Array, freedom: float) -> Array:
    """Log evidence of scores z and rest r (m, n_z + 1), (m,).

    r - |z|^2 / 2 where the noise is known; r - n_f / 2 log(1 + |z|^2 / n_f) where the noise of n_f
    frequencies is inferred.

    freedom : infinite where the noise is known, else n_f.
    """
    square = np.einsum("mi,mi->m", y[:, :-1], y[:, :-1])
    deviance = square if np.isinf(freedom) else freedom * np.log1p(square / freedom)
    return np.asarray(y[:, -1] - 0.5 * deviance)


def piecewise_linear_surrogate(
    tangent: Tangent,
    q_bound: Array,
    top: float,
    depth: float,
    halvings: int,
    slack: float,
    freedom: float,
    executor: Executor | None = None,
) -> PiecewiseLinearSurrogate:
    """Tangents of a surrogate wherever it may exceed the lower bound, ``depth`` below ``top``.

    A cell is left out where no set of plies can lie (the Toeplitz matrix of 1, v1 + i v2, v3 + i v4 is
    not positive) or where the most that the tangents allow over the cell and over the range of q, and
    ``slack``, stay below the lower bound. The others are halved ``halvings`` times, but once where the
    tangents keep them far below the top.

    tangent : of the surrogate.
    q_bound : (n_q,) largest magnitude of each further sum.
    top, depth, slack : nats.
    freedom : of ``log_evidence``.
    """
    axis = (np.arange(_FIRST) + 0.5) * 2.0 / _FIRST - 1.0
    centre, width = _mesh(axis), 2.0 / _FIRST
    leaves: list[_Leaves] = []
    for side in (1 << np.arange(halvings + 1))[::-1]:
        last = side == 1
        half = np.concatenate((np.full(4, 0.5 * width), q_bound)) * (1.0 if last else _COARSE_WIDTH)
        level = _Level(
            tangent,
            int(side),
            width,
            half,
            keep_from=top - depth - slack * (1.0 if last else _COARSE_SLACK),
            halve_from=np.inf if last else -np.inf if side == 1 << halvings else top - _REFINED_DEPTH_NATS,
            freedom=freedom,
        )
        batches = np.split(centre, range(_BATCH, len(centre), _BATCH))
        sorted_cells = run(_leaves_and_halved, level, batches, executor, batch_size=1, is_limited=True)
        leaves += [kept for kept, _ in sorted_cells]
        halved = np.concatenate([centres for _, centres in sorted_cells])
        centre = (halved[:, None, :] + width * _mesh(np.array([-0.25, 0.25]))).reshape(-1, 4)
        width *= 0.5
    first, leaf = _box(leaves, _FIRST << halvings)
    return PiecewiseLinearSurrogate(
        width=2.0 / (_FIRST << halvings),
        first=first,
        leaf=leaf,
        tangent=_taken(leaves),
        lower_bound=top - depth,
        freedom=freedom,
    )


@dataclass(frozen=True, slots=True)
class _Level:
    """Cells of one width, and the log evidence from which they are kept and halved.

    side : of a cell, in finest ones.
    half : (4 + n_q,) largest distance of the sums of a cell from its centre.
    keep_from : least upper bound of the log evidence of a cell that is kept.
    halve_from : least upper bound of one that is halved.
    freedom : of ``log_evidence``.
    """

    tangent: Tangent
    side: int
    width: float
    half: Array
    keep_from: float
    halve_from: float
    freedom: float


@dataclass(frozen=True, slots=True)
class _Leaves:
    """Cells that are kept as they are: ``corner`` (l, 4) and ``side`` count the finest cells."""

    side: int
    corner: Array
    tangent: Array


def _leaves_and_halved(level: _Level, centre: Array) -> tuple[_Leaves, Array]:
    """Cells about centres (c, 4) that are kept, in single precision, and centres of those to be halved."""
    centre = centre[_realisable(centre, level.width)]
    y, slope = level.tangent(np.column_stack((centre, np.zeros((len(centre), len(level.half) - 4)))))
    reach = np.abs(slope) @ level.half
    nearest = np.maximum(np.abs(y[:, :-1]) - reach[:, :-1], 0.0)
    upper = log_evidence(np.column_stack((nearest, y[:, -1] + reach[:, -1])), level.freedom)
    finer = (upper >= level.keep_from) & (upper >= level.halve_from)
    leaf = (upper >= level.keep_from) & ~finer
    corner = np.rint(level.side * ((centre[leaf] + 1.0) / level.width - 0.5)).astype(np.int64)
    at_zero = y[leaf] - np.einsum("lzj,lj->lz", slope[leaf, :, :4], centre[leaf])
    tangent = np.concatenate((at_zero[:, :, None], slope[leaf]), axis=2)
    return _Leaves(level.side, corner, tangent.astype(np.float32)), centre[finer]


def _box(leaves: list[_Leaves], n: int) -> tuple[Array, Array]:
    """The first cell of a box about all leaves and a rim, and the leaf of each of its cells, -1 for none.

    n : the finest cells along an axis.
    """
    first = np.min([each.corner.min(axis=0, initial=n) for each in leaves], axis=0) - 1
    end = np.max([each.corner.max(axis=0, initial=0) + each.side for each in leaves], axis=0)
    leaf = np.full(np.maximum(end - first + 1, 1), -1, dtype=np.int32)
    begin = 0
    for each in leaves:
        rows = np.arange(begin, begin + len(each.corner), dtype=np.int32)
        for offset in _mesh(np.arange(each.side)):
            leaf[tuple((each.corner + offset - first).T)] = rows
        begin += len(rows)
    return first, leaf


def _taken(leaves: list[_Leaves]) -> Array:
    """Tangents of all leaves, which are taken off the list: nothing is in memory twice."""
    n = sum(len(each.tangent) for each in leaves)
    tangent = np.empty((n, *leaves[0].tangent.shape[1:]), dtype=np.float32)
    while leaves:
        of_level = leaves.pop().tangent
        tangent[n - len(of_level) : n] = of_level
        n -= len(of_level)
    return tangent


def _mesh(axis: Array) -> Array:
    """All points with four coordinates from an axis (n,), (n^4, 4)."""
    return np.stack(np.meshgrid(axis, axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 4)


def _realisable(v: Array, width: float) -> Array:
    """Whether a cell about v may hold sums of unit vectors: its Toeplitz matrix is nearly positive."""
    a, b = v[:, 0] + 1j * v[:, 1], v[:, 2] + 1j * v[:, 3]
    unit = np.ones(len(v), dtype=complex)
    rows = ((unit, a, b), (a.conj(), unit, a), (b.conj(), a.conj(), unit))
    matrix = np.stack([np.stack(row, -1) for row in rows], -2)
    # an entry moves by sqrt(2) width / 2 at most, half a diagonal, and a row has two beside its unit
    return np.asarray(np.linalg.eigvalsh(matrix)[:, 0] >= -np.sqrt(2.0) * width)
