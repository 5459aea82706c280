"""What of a stacking sequence the frequencies depend on: sums over its plies, tabulated by ply and angle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.plate.layup import Layup

Array = NDArray[Any]

# Sums that vary less than this over all sequences, once V is known, do not count.
_NEGLIGIBLE = 3e-3
_SAMPLE = 4000
# What motions of the plate do to cos 2t, sin 2t, cos 4t, sin 4t.
_SIGNS = {
    "mirror image": (1, -1, 1, -1),
    "quarter turn": (-1, -1, 1, 1),
    "diagonal mirror image": (-1, 1, 1, -1),
}


@dataclass(frozen=True, slots=True)
class PlySums:
    """Sums of angle functions over the unknown plies of a symmetric layup.

    v = sum_j w_j (cos 2t_j, sin 2t_j, cos 4t_j, sin 4t_j), w_j the share of unknown j in the bending
    stiffness of all unknown plies: the unknown part of the bending lamination parameters (Tsai and
    Hahn, 1980), between -1 and 1. q are the same sums with the weights of the transverse shear energy,
    (1 - 4 z^2 / h^2)^2, and of the membrane stiffness, less their linear regression on v.

    first : (k, n_grid, 4), contributions to v. rest : (k, n_grid, n_q), to q. grid_deg : (n_grid,).
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
    def rest_reach(self) -> Array:
        """Bounds of the magnitude of q over all sequences, (n_q,)."""
        return np.asarray(np.abs(self.rest).max(axis=1).sum(axis=0))

    def signs(self, motion: str) -> Array:
        """Signs that the image under a motion of the plate, by its name, gives to the sums, (4 + n_q,)."""
        return np.array(_SIGNS[motion], dtype=float)[self.function]

    def features(self, sequences: Array) -> Array:
        """Sums (v, q) of sequences of grid indices (m, k), (m, 4 + n_q)."""
        both = np.concatenate((self.first, self.rest), axis=2)
        return np.asarray(sum(both[j][sequences[:, j]] for j in range(self.n_unknown)))


def all_choices(contributions: Array) -> Array:
    """Sums of contributions (k, n_grid, d) of some plies for all choices of their angles, (n_grid^k, d).

    The angle of the last ply changes fastest.
    """
    total = np.zeros((1, contributions.shape[2]))
    for own in contributions:
        total = (total[:, None, :] + own).reshape(-1, total.shape[1])
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
    k = layup.n_unknown
    shear = z - 8 * z**3 / 3 + 16 * z**5 / 5  # integral of (1 - 4 z^2)^2
    weights = np.stack([np.diff(z**3), np.diff(shear), np.diff(z)])
    member = layup.unknown_index[:, None] == np.arange(k)
    by_unknown = weights @ member
    by_unknown = by_unknown / by_unknown.sum(axis=1, keepdims=True)
    t = np.deg2rad(grid_deg)
    e = np.stack((np.cos(2 * t), np.sin(2 * t), np.cos(4 * t), np.sin(4 * t)), axis=-1)
    first = by_unknown[0][:, None, None] * e
    others = by_unknown[1:, :, None, None] * e
    rest = [_independent(first[..., i], others[..., i]) for i in range(4)]
    function = np.repeat(np.arange(4), [r.shape[2] for r in rest])
    return PlySums(first, np.concatenate(rest, axis=2), grid_deg, np.concatenate((np.arange(4), function)))


def _independent(first: Array, others: Array) -> Array:
    """What of further sums (n, k, n_grid) is no multiple of the first (k, n_grid), principal directions."""
    k, n_grid = first.shape
    sequences = np.random.default_rng(0).integers(n_grid, size=(_SAMPLE, k))
    ply = np.arange(k)
    v, q = first[ply, sequences].sum(axis=1), others[:, ply, sequences].sum(axis=2).T
    relation = v @ q / (v @ v)
    _, spread, directions = np.linalg.svd((q - v[:, None] * relation) / np.sqrt(_SAMPLE), full_matrices=False)
    kept = directions[spread > _NEGLIGIBLE].T
    return np.asarray((np.moveaxis(others, 0, -1) - first[..., None] * relation) @ kept)
