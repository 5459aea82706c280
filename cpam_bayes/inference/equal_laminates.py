"""Stacking sequences of different plies that make one laminate, for every set of elastic constants.

A layup enters the plate model through its lamination parameters and, where the transverse shear
stiffness is energy-consistent, through the running integrals of its plies. Sequences that agree in all
of them have the same 8 x 8 stiffness whatever the constants are, so no frequency tells them apart.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.elasticity import complete_constants
from cpam_bayes.inference.sequence_classes import canonical
from cpam_bayes.inference.symmetries import ANGLE_MOTIONS, plane_motions, plate_symmetries
from cpam_bayes.laminate import (
    CURVATURE,
    ENERGY_CONSISTENT,
    MEMBRANE,
    SHEAR,
    ShearModel,
    angle_functions,
    laminate_stiffness,
)
from cpam_bayes.layup import Layup
from cpam_bayes.measurement.records import Specimen, angle_grid

__all__ = ["equal_laminates", "lamination_parameters"]

Array = NDArray[Any]

# Stiffness is a rational function of the constants: two layups that agree at constants without any
# relation between them agree at all. Three sets leave nothing to luck.
_GENERIC: Final[Mapping[str, Array]] = {
    "E1": np.array([130.7e9, 41.3e9, 171.9e9]),
    "E2": np.array([9.13e9, 17.77e9, 33.1e9]),
    "nu12": np.array([0.271, 0.193, 0.347]),
    "G12": np.array([6.37e9, 12.91e9, 4.17e9]),
    "G13": np.array([5.89e9, 7.31e9, 9.73e9]),
    "G23": np.array([3.31e9, 5.03e9, 2.39e9]),
}
# Weights of the lamination parameters in the number that sequences are sorted by: no two alike.
_WEIGHTS: Final = np.sqrt(np.array([2.0, 3.0, 5.0, 7.0, 11.0, 13.0, 17.0, 19.0, 23.0, 29.0, 31.0, 37.0]))
# What the kinds of motions do to (cos 2t, cos 4t, sin 2t, sin 4t).
_SIGNS: Final = {
    "": (1.0, 1.0, 1.0, 1.0),
    "mirror image": (1.0, 1.0, -1.0, -1.0),
    "quarter turn": (-1.0, 1.0, -1.0, 1.0),
    "diagonal mirror image": (-1.0, 1.0, 1.0, -1.0),
}
# A stiffness that agrees to a tolerance has lamination parameters that agree to a multiple of it.
_GENEROUS: Final = 100.0


def lamination_parameters(layup: Layup, grid_deg: Array, sequences: Array) -> Array:
    """Lamination parameters of sequences, (m, n_unknown) grid indices -> (m, 3, 4).

    Rows: in-plane, coupling, flexural, the means over the thickness of (cos 2t, cos 4t, sin 2t, sin 4t)
    times 1, 4 z and 12 z^2, z in thicknesses from the midplane (Tsai and Hahn, Introduction to
    Composite Materials, 1980), so that each lies between -1 and 1.
    """
    z = np.arange(layup.n_plies + 1) / layup.n_plies - 0.5
    weights = np.stack([np.diff(z**k) * factor for k, factor in ((1, 1.0), (2, 2.0), (3, 4.0))])
    known = layup.unknown_index < 0
    constant = weights[:, known] @ angle_functions(layup.angles_deg[known])[:, 1:]
    found = np.broadcast_to(constant, (len(sequences), 3, 4)).copy()
    functions = angle_functions(grid_deg)[:, 1:]
    for k in range(layup.n_unknown):
        own = weights[:, layup.unknown_index == k].sum(axis=1)
        found += (own[:, None] * functions[:, None, :])[sequences[:, k]]
    return found


def equal_laminates(
    specimen: Specimen,
    sequences: Array,
    *,
    bending_only: bool = False,
    tolerance: float = 1e-10,
    shear: ShearModel = ENERGY_CONSISTENT,
) -> NDArray[np.int64]:
    """Group sequences (m, n_unknown) whose laminates are equal, or are after a motion of the plate.

    Two laminates are equal if every quadratic form of their stiffness differs by no more than
    ``tolerance`` times the form itself, for generic constants: by the minimum-maximum principle no
    frequency then differs by more than half of that. The classes of ``plate_symmetries`` are part
    of the groups.

    bending_only : leave the membrane stiffness aside; for symmetric layups whose measured modes all
    bend the plate. tolerance : up to 1e-6.

    Returns (m,), the row number of the first member of each group.

    Raises ``ValueError`` for a tolerance above 1e-6, where groups would run into each other, for
    ``bending_only`` with a layup that is not symmetric, and as ``canonical``.
    """
    layup, grid = specimen.plate.layup, angle_grid(specimen.angle_grid_deg)
    if not 0.0 < tolerance <= 1e-6:
        raise ValueError(f"tolerance of equal laminates: received {tolerance}, accepted: above 0, up to 1e-6")
    if bending_only and not layup.is_symmetric:
        raise ValueError(
            f"layup {layup.text}: not symmetric, so membrane and bending couple; leave bending_only out"
        )
    orbits = canonical(sequences, plate_symmetries(specimen))
    rows, first, label = np.unique(orbits.representative, axis=0, return_index=True, return_inverse=True)
    group = np.arange(len(rows))
    motions = plane_motions(specimen)
    parameters = lamination_parameters(layup, grid, rows)
    numbers = _numbers(parameters[:, 2:] if bending_only else parameters, motions)
    order = np.argsort(numbers, kind="stable")
    near = np.diff(numbers[order]) <= _GENEROUS * tolerance
    cluster = np.concatenate(([0], np.cumsum(~near)))
    doubtful = np.isin(cluster, cluster[1:][near])
    rest, cluster = order[doubtful], cluster[doubtful]
    while len(rest):
        # the first of each cluster leads; those equal to it join it, the others wait for the next round
        start = np.concatenate(([True], np.diff(cluster) > 0))
        leader = rest[start][np.cumsum(start) - 1]
        joins = start.copy()
        joins[~start] = _equal(
            layup,
            grid[rows[leader[~start]]],
            grid[rows[rest[~start]]],
            motions,
            bending_only,
            tolerance,
            shear,
        )
        group[rest[joins]] = leader[joins]
        rest, cluster = rest[~joins], cluster[~joins]
    row = np.full(len(rows), len(sequences))
    np.minimum.at(row, group, first)
    return np.asarray(row[group][label.reshape(-1)])


def _numbers(parameters: Array, motions: tuple[str, ...]) -> Array:
    """One number a sequence that equal laminates and their images share, (m, r, 4) -> (m,)."""
    r = parameters.shape[1]
    weights = _WEIGHTS[: 4 * r].reshape(r, 4)
    over = np.array([1.0, -1.0, 1.0])[:, None] if r == 3 else np.ones((1, 1))  # upside down
    images = [
        np.einsum("mij,ij->m", parameters, weights * np.array(_SIGNS[kind]) * turned)
        for kind in motions
        for turned in (np.ones_like(over), over)
    ]
    return np.asarray(np.min(images, axis=0))


def _equal(
    layup: Layup,
    first_deg: Array,
    second_deg: Array,
    motions: tuple[str, ...],
    bending_only: bool,
    tolerance: float,
    shear: ShearModel,
) -> NDArray[np.bool_]:
    """Whether laminates (m, n_unknown) are equal after one of the motions, (m,)."""
    if not len(first_deg):
        return np.empty(0, dtype=bool)
    used = np.r_[CURVATURE, SHEAR] if bending_only else np.r_[MEMBRANE, CURVATURE, SHEAR]
    constants = {name: value[:, None] for name, value in complete_constants(_GENERIC, False).items()}

    def stiffness(plies: Array) -> Array:  # (3, m, r, r)
        return np.asarray(laminate_stiffness(constants, plies, 1.0, shear)[..., used[:, None], used])

    back = np.linalg.inv(np.linalg.cholesky(stiffness(layup.angles(first_deg))))
    plies = layup.angles(second_deg)
    found = np.zeros(len(plies), dtype=bool)
    for kind in motions:
        for turned in (plies,) if layup.is_symmetric else (plies, plies[:, ::-1]):
            ratio = back @ stiffness(ANGLE_MOTIONS[kind](turned)) @ np.swapaxes(back, -1, -2)
            away = np.abs(np.linalg.eigvalsh(ratio) - 1.0).max(axis=-1)
            found |= np.all(away <= tolerance, axis=0)
    return found
