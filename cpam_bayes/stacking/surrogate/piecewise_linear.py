"""A smooth log evidence as a table on small cells of the lamination parameters, each with its tangent."""

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

# Cells are halved so often; the first ones are 2 / _FIRST wide.
_FIRST = 12
# Cells that stay farther below the top than this, nats, are halved once only.
_REFINED = 6.0
# Cells that are judged together.
_TOGETHER = 8192
# How much farther a coarse cell reaches than its tangent says: it is not straight.
_COARSE_REACH, _COARSE_SLACK = 1.5, 3.0


@dataclass(frozen=True, slots=True)
class PiecewiseLinearSurrogate:
    """Log evidence on cells of the four sums v; cells where it is below a floor are left out.

    The scores z and the rest r of ``log_evidence`` are linear in the sums on each cell, so that no cell has
    more than its rest.

    width : of the finest cells. first : (4,) of the cells of a box about those that were kept, its number
    along each axis; the outermost cells of the box are empty. leaf : (n_1, n_2, n_3, n_4) int32, which row of
    ``tangent`` a cell of the box has, -1 where it was left out. centre : (L, 4). tangent : (L, n_z + 1,
    1 + 4 + n_q): scores, and last the rest, at the centre, and their gradients. floor : what left-out cells
    are below. freedom : of the log evidence.
    """

    width: float
    first: Array
    leaf: Array
    centre: Array
    tangent: Array
    floor: float
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
        """As ``lookup`` of points v + shift, v (4, m) and shift (4,), for very many of them."""
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

    def values(self, rows: Array, v: Array, q: Array) -> Array:
        """Log evidence of points in the cells ``rows`` (m,), v (m, 4), q (m, n_q)."""
        away = np.column_stack((np.ones(len(v), dtype=np.float32), v - self.centre[rows], q))
        y = np.einsum("mij,mj->mi", self.tangent[rows], away)
        return log_evidence(y.astype(np.float64), self.freedom)


def log_evidence(y: Array, freedom: float) -> Array:
    """Log evidence of scores z and rest r (m, n_z + 1), (m,).

    freedom : inf: r - |z|^2 / 2, the noise being known; n_f: r - n_f / 2 log(1 + |z|^2 / n_f), as it is where
    the noise of n_f frequencies is inferred.
    """
    size = np.sum(y[:, :-1] ** 2, axis=1)
    fall = size if np.isinf(freedom) else freedom * np.log1p(size / freedom)
    return np.asarray(y[:, -1] - 0.5 * fall)


def piecewise_linear_surrogate(
    surrogate: Tangent,
    q_reach: Array,
    top: float,
    depth: float,
    halvings: int,
    slack: float,
    freedom: float,
    executor: Executor | None = None,
) -> PiecewiseLinearSurrogate:
    """Tangents of a surrogate wherever it may exceed its floor, ``depth`` below ``top``.

    A cell is left out where no set of plies can lie (the Toeplitz matrix of 1, v1 + i v2, v3 + i v4 is
    not positive) or where the most that the tangents allow over the cell and over the reach of q, and
    ``slack``, stay below the floor. The others are halved ``halvings`` times, but once where the tangents
    keep them far below the top.

    q_reach : (n_q,) largest magnitude of each further sum. freedom : of the log evidence.
    """
    axis = (np.arange(_FIRST) + 0.5) * 2.0 / _FIRST - 1.0
    centre, width = _mesh(axis), 2.0 / _FIRST
    leaves: list[_Leaves] = []
    for side in (1 << np.arange(halvings + 1))[::-1]:
        last = side == 1
        half = np.concatenate((np.full(4, 0.5 * width), q_reach)) * (1.0 if last else _COARSE_REACH)
        level = _Level(
            surrogate,
            int(side),
            width,
            half,
            least=top - depth - slack * (1.0 if last else _COARSE_SLACK),
            halved_from=np.inf if last else -np.inf if side == 1 << halvings else top - _REFINED,
            freedom=freedom,
        )
        blocks = np.split(centre, range(_TOGETHER, len(centre), _TOGETHER))
        found = run(_judged, level, blocks, executor, batch_size=1)
        leaves += [kept for kept, _ in found]
        split = np.concatenate([finer for _, finer in found])
        centre = (split[:, None, :] + width * _mesh(np.array([-0.25, 0.25]))).reshape(-1, 4)
        width *= 0.5
    first, leaf = _box(leaves, _FIRST << halvings)
    return PiecewiseLinearSurrogate(
        width=2.0 / (_FIRST << halvings),
        first=first,
        leaf=leaf,
        centre=np.concatenate([each.centre for each in leaves]),
        tangent=np.concatenate([each.tangent for each in leaves]),
        floor=top - depth,
        freedom=freedom,
    )


@dataclass(frozen=True, slots=True)
class _Level:
    """Cells of one width, and what becomes of them.

    side : of a cell, in finest ones. half : (4 + n_q,) how far sums of a cell may be from its centre. least :
    log evidence that a cell which is kept may reach; halved_from : and one that is halved. freedom : of the
    log evidence.
    """

    surrogate: Tangent
    side: int
    width: float
    half: Array
    least: float
    halved_from: float
    freedom: float


@dataclass(frozen=True, slots=True)
class _Leaves:
    """Cells that are kept as they are: ``corner`` (l, 4) and ``side`` count the finest cells."""

    side: int
    corner: Array
    centre: Array
    tangent: Array


def _judged(level: _Level, centre: Array) -> tuple[_Leaves, Array]:
    """Of cells about centres (c, 4) those that are leaves, in single precision, and centres of the halved."""
    centre = centre[_realisable(centre, level.width)]
    y, slope = level.surrogate(np.column_stack((centre, np.zeros((len(centre), len(level.half) - 4)))))
    reach = np.abs(slope) @ level.half
    nearest = np.maximum(np.abs(y[:, :-1]) - reach[:, :-1], 0.0)
    most = log_evidence(np.column_stack((nearest, y[:, -1] + reach[:, -1])), level.freedom)
    finer = (most >= level.least) & (most >= level.halved_from)
    leaf = (most >= level.least) & ~finer
    corner = np.rint(level.side * ((centre[leaf] + 1.0) / level.width - 0.5)).astype(np.int64)
    tangent = np.concatenate((y[leaf, :, None], slope[leaf]), axis=2)
    kept = _Leaves(level.side, corner, centre[leaf].astype(np.float32), tangent.astype(np.float32))
    return kept, centre[finer]


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


def _mesh(axis: Array) -> Array:
    """All points with four coordinates from an axis (n,), (n^4, 4)."""
    return np.stack(np.meshgrid(axis, axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 4)


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
