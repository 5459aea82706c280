"""The features of a stacking sequence that frequencies depend on: sums over plies, by ply and angle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.plate.layup import Layup

Array = NDArray[Any]

# Sums with a smaller standard deviation over all sequences, once v is known, do not count.
_NEGLIGIBLE_SD = 3e-3
# Sequences drawn evenly that this is found from.
_SAMPLE_SIZE = 4000
# Signs that motions of the plate give to cos 2t, sin 2t, cos 4t, sin 4t.
_SIGNS = {
    "mirror image": (1, -1, 1, -1),
    "quarter turn": (-1, -1, 1, 1),
    "diagonal mirror image": (-1, 1, 1, -1),
}


@dataclass(frozen=True, slots=True)
class PlySums:
    """Sums of angle functions over the unknown plies of a symmetric layup.

    v = sum_j w_j (cos 2t_j, sin 2t_j, cos 4t_j, sin 4t_j), w_j the fraction of unknown j in the bending
    stiffness of all unknown plies: the unknown part of the bending lamination parameters (Tsai and
    Hahn, 1980), between -1 and 1. q are the same sums with the weights of the transverse shear energy,
    (1 - 4 z^2 / h^2)^2, and of the membrane stiffness, less their linear regression on v.

    first : (k, n_grid, 4) contributions to v.
    rest : (k, n_grid, n_q) contributions to q.
    grid_deg : (n_grid,).
    function : (4 + n_q,) which of the four angle functions each sum is of.
    """

    first: Array
    rest: Array
    grid_deg: Array
    function: Array

    @property
    def n_unknown(self) -> int:
        """Number of unknown angles."""
        return len(self.first)

    @property
    def rest_bound(self) -> Array:
        """Bounds of the magnitude of q over all sequences, (n_q,)."""
        return np.asarray(np.abs(self.rest).max(axis=1).sum(axis=0))

    @property
    def both(self) -> Array:
        """Contributions to v and q, (k, n_grid, 4 + n_q)."""
        return np.concatenate((self.first, self.rest), axis=2)

    def signs(self, motion: str) -> Array:
        """Signs that the image under a motion of the plate, by its name, gives to the sums, (4 + n_q,)."""
        return np.array(_SIGNS[motion], dtype=float)[self.function]

    def features(self, sequences: Array) -> Array:
        """Sums (v, q) of sequences of grid indices (m, k), (m, 4 + n_q)."""
        both = self.both
        return np.asarray(sum(both[j][sequences[:, j]] for j in range(self.n_unknown)))


def all_sequences(n_grid: int, n_unknown: int) -> Array:
    """Every sequence of grid indices, (n_grid^n_unknown, n_unknown); the last angle changes fastest."""
    every = np.unravel_index(np.arange(n_grid**n_unknown), (n_grid,) * n_unknown)
    return np.stack(every, axis=1)


def all_choices(contributions: Array) -> Array:
    """Sums of contributions (k, n_grid, d) of some plies for all choices of their angles, (n_grid^k, d).

    The angle of the last ply changes fastest.
    """
    total = np.zeros((1, contributions.shape[2]))
    for ply in contributions:
        total = (total[:, None, :] + ply).reshape(-1, total.shape[1])
    return total


def ply_sums(layup: Layup, grid_deg: Array) -> PlySums:
    """The sums of a symmetric layup with unknown angles on a grid, (n_grid,) degrees.

    Raises ``ValueError`` for a layup that is not symmetric: there bending and stretching are coupled
    and more sums count.
    """
    if not layup.is_symmetric:
        raise ValueError(
            f"layup {layup.text}: {len(grid_deg)}^{layup.n_unknown} sequences need a symmetric layup; "
            "end it with _s, give more of its angles, or take a coarser angle_grid_deg"
        )
    z = np.linspace(-0.5, 0.5, layup.n_plies + 1)
    shear = z - 8 * z**3 / 3 + 16 * z**5 / 5  # integral of (1 - 4 z^2)^2
    weights = np.stack([np.diff(z**3), np.diff(shear), np.diff(z)])
    by_unknown = weights @ (layup.unknown_index[:, None] == np.arange(layup.n_unknown))
    by_unknown = by_unknown / by_unknown.sum(axis=1, keepdims=True)
    t = np.deg2rad(grid_deg)
    e = np.stack((np.cos(2 * t), np.sin(2 * t), np.cos(4 * t), np.sin(4 * t)), axis=-1)
    first = by_unknown[0][:, None, None] * e
    others = by_unknown[1:, :, None, None] * e
    rest = [_independent(first[..., i], others[..., i]) for i in range(4)]
    function = np.repeat(np.arange(4), [r.shape[2] for r in rest])
    return PlySums(first, np.concatenate(rest, axis=2), grid_deg, np.concatenate((np.arange(4), function)))


def _independent(first: Array, others: Array) -> Array:
    """Principal directions of further sums (n, k, n_grid) less their regression on the first (k, n_grid)."""
    k, n_grid = first.shape
    sequences = np.random.default_rng(0).integers(n_grid, size=(_SAMPLE_SIZE, k))
    ply = np.arange(k)
    v, q = first[ply, sequences].sum(axis=1), others[:, ply, sequences].sum(axis=2).T
    slope = v @ q / (v @ v)
    residual = (q - v[:, None] * slope) / np.sqrt(_SAMPLE_SIZE)
    _, sd, directions = np.linalg.svd(residual, full_matrices=False)
    kept = directions[sd > _NEGLIGIBLE_SD].T
    return np.asarray((np.moveaxis(others, 0, -1) - first[..., None] * slope) @ kept)
