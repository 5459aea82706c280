"""Stacking sequences that no frequency can tell apart, because the plate has symmetries.

A rigid motion that maps the plate onto itself, edges and known masses included, maps every laminate to
another one with the same frequencies. In the plane the motions of a rectangle or a square change the
ply angles in one of three ways,

    a mirror along x or y       theta -> -theta          any rectangle whose edges allow it
    a quarter turn              theta -> theta + 90      squares
    a mirror along a diagonal   theta -> 90 - theta      squares

and a half turn does not change them. Turning the plate upside down reverses the order of the plies:
the plate model does not know on which face a mass sits. All products of these are tried.

Sequences are rows of grid indices, (m, n_unknown) integers into ``angle_grid``. Plies of known angle
take part: [45/?]_s has no mirror image of its own form, [45/?/?/-45] has one, upside down. Where a
motion keeps the form of a layup for some sequences only, it merges those.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.plate.layup import Layup
from cpam_bayes.plate.records import Plate, Specimen, angle_grid

Array = NDArray[Any]
Point = tuple[float, float]

_EQUAL: Final = 1e-9

# Change of the ply angles by the motions of each kind, in degrees. Each is its own inverse, modulo 180.
ANGLE_MOTIONS: Final[dict[str, Callable[[Array], Array]]] = {
    "": lambda t: t,
    "mirror image": lambda t: -t,
    "quarter turn": lambda t: t + 90.0,
    "diagonal mirror image": lambda t: 90.0 - t,
}
_EXCHANGES: Final = ("quarter turn", "diagonal mirror image")
# Motions: which kind, where each edge (x0, y0, x1, y1) comes from, and where a point (x / length,
# y / width) goes.
_MOTIONS: Final[tuple[tuple[str, tuple[int, int, int, int], Callable[[float, float], Point]], ...]] = (
    ("", (0, 1, 2, 3), lambda x, y: (x, y)),
    ("mirror image", (2, 1, 0, 3), lambda x, y: (1.0 - x, y)),
    ("mirror image", (0, 3, 2, 1), lambda x, y: (x, 1.0 - y)),
    ("quarter turn", (3, 0, 1, 2), lambda x, y: (1.0 - y, x)),
    ("quarter turn", (1, 2, 3, 0), lambda x, y: (y, 1.0 - x)),
    ("diagonal mirror image", (1, 0, 3, 2), lambda x, y: (y, x)),
    ("diagonal mirror image", (3, 2, 1, 0), lambda x, y: (1.0 - y, 1.0 - x)),
)


@dataclass(frozen=True, slots=True, eq=False)
class Symmetry:
    """A map between stacking sequences of one layup with equal frequencies.

    The image of a sequence s has the grid index ``permutation[s[source[j]]]`` for unknown j, or
    ``constant[j]`` where ``source[j]`` is -1, a known ply then having come to its place. It is a
    sequence of the same layup if s[k] == i for every (k, i) of ``conditions`` and s[k] == s[l] for
    every (k, l) of ``ties``; without any, the map holds everywhere.

    permutation : (n_grid,) grid indices.
    source, constant : (n_unknown,).
    """

    name: str
    permutation: NDArray[np.int64]
    source: NDArray[np.int64]
    constant: NDArray[np.int64]
    conditions: tuple[tuple[int, int], ...]
    ties: tuple[tuple[int, int], ...]

    @property
    def everywhere(self) -> bool:
        """Whether every sequence has an image."""
        return not (self.conditions or self.ties)


def plane_motions(specimen: Specimen) -> tuple[str, ...]:
    """The kinds of motions in the plane that map the plate onto itself, "" (none) always among them.

    Kinds that exchange x and y need a square whose sizes are known equally well, and frequencies
    without labels: a label counts half-waves along x and along y. For a plate with a mesh from a file no
    motion is sought.
    """
    plate = specimen.plate
    labelled = specimen.measurement is not None and specimen.measurement.names_modes
    if plate.mesh is not None:
        return ("",)
    masses = [(s.x / plate.length, s.y / plate.width, s.mass) for s in specimen.sensors]
    kinds: list[str] = []
    for kind, edges, moved in _MOTIONS:
        if kind in _EXCHANGES and (labelled or not _is_square(plate)):
            continue
        if any(plate.edges[old] != new for old, new in zip(edges, plate.edges, strict=True)):
            continue
        if kind not in kinds and _same_masses(masses, [(*moved(x, y), mass) for x, y, mass in masses]):
            kinds.append(kind)
    return tuple(kinds)


def plate_symmetries(specimen: Specimen) -> tuple[Symmetry, ...]:
    """All maps between sequences of a specimen's layup that leave every frequency as it is.

    The identity is left out, so a plate without symmetries has none. Of maps that do the same, the
    first is kept.
    """
    layup = specimen.plate.layup
    grid = angle_grid(specimen.angle_grid_deg)
    identity = _compiled("", layup, grid, ANGLE_MOTIONS[""], upside_down=False)
    assert identity is not None
    distinct: dict[Any, Symmetry] = {_content(identity): identity}
    for upside_down in (False, True):
        for kind in plane_motions(specimen):
            name = " ".join(filter(None, (kind, "upside down" if upside_down else "")))
            symmetry = _compiled(name, layup, grid, ANGLE_MOTIONS[kind], upside_down)
            if symmetry is not None:
                distinct.setdefault(_content(symmetry), symmetry)
    return tuple(distinct.values())[1:]


def image(sequences: Array, symmetry: Symmetry) -> tuple[Array, NDArray[np.bool_]]:
    """Images of sequences (m, n_unknown) under a symmetry, and (m,) whether each has one.

    A row without an image is given back as it is.
    """
    sequences = grid_indices(sequences, symmetry)
    holds = has_image(sequences, symmetry)
    moved = symmetry.permutation[sequences[:, symmetry.source]]
    moved = np.where(symmetry.source >= 0, moved, symmetry.constant)
    return np.where(holds[:, None], moved, sequences).astype(sequences.dtype), holds


# Motions of the plate


def _is_square(plate: Plate) -> bool:
    equal = abs(plate.length - plate.width) <= _EQUAL * plate.length
    return equal and plate.sd.get("length") == plate.sd.get("width")


def _same_masses(before: list[tuple[float, float, float]], after: list[tuple[float, float, float]]) -> bool:
    """Whether masses (x, y, mass) are the same in some order."""
    rest = list(before)
    for point in after:
        tolerance = _EQUAL * np.array([1.0, 1.0, point[2]])
        match = next((p for p in rest if np.all(np.abs(np.subtract(p, point)) <= tolerance)), None)
        if match is None:
            return False
        rest.remove(match)
    return True


# From a motion to a map of sequences


def _compiled(
    name: str, layup: Layup, grid: Array, turned: Callable[[Array], Array], upside_down: bool
) -> Symmetry | None:
    """What a motion does to the unknown angles; None if no sequence keeps the layup's form."""
    permutation = np.array([_on_grid(float(turned(angle)), grid) for angle in grid])
    if np.any(permutation < 0):  # the grid is not mapped onto itself
        return None
    known, unknown = layup.angles_deg, layup.unknown_index
    origin = np.arange(layup.n_plies)[::-1] if upside_down else np.arange(layup.n_plies)
    takes: dict[int, tuple[int, int]] = {}  # unknown -> (unknown it comes from, or -1; grid index)
    conditions: set[tuple[int, int]] = set()
    ties: set[tuple[int, int]] = set()
    for ply, old in enumerate(origin):
        j, k = int(unknown[ply]), int(unknown[old])
        moved = float(turned(known[old])) if k < 0 else np.nan
        if j < 0 and k < 0:
            if not _same_direction(moved, float(known[ply])):
                return None
        elif j < 0:
            conditions.add((k, _on_grid(float(turned(known[ply])), grid)))
        else:
            origin_of_ply = (k, -1) if k >= 0 else (-1, _on_grid(moved, grid))
            first = takes.setdefault(j, origin_of_ply)
            if origin_of_ply == (-1, -1):  # a known angle off the grid cannot be a "?"
                return None
            if first[0] >= 0 and k >= 0 and first[0] != k:
                ties.add((min(first[0], k), max(first[0], k)))
            elif first[0] >= 0 > k:
                conditions.add((first[0], int(permutation[origin_of_ply[1]])))
            elif first[0] < 0 <= k:
                conditions.add((k, int(permutation[first[1]])))
            elif k < 0 and first != origin_of_ply:
                return None
    asked = [k for k, _ in conditions]
    if any(index < 0 for _, index in conditions) or len(asked) != len(set(asked)):
        return None
    order = range(layup.n_unknown)
    return Symmetry(
        name,
        permutation,
        np.array([takes[j][0] for j in order], dtype=np.int64),
        np.array([takes[j][1] for j in order], dtype=np.int64),
        tuple(sorted(conditions)),
        tuple(sorted(ties)),
    )


def _on_grid(angle_deg: float, grid: Array) -> int:
    """Grid index of a direction, -1 where there is none."""
    near = np.flatnonzero(np.abs((grid - angle_deg + 90.0) % 180.0 - 90.0) <= _EQUAL)
    return int(near[0]) if near.size else -1


def _same_direction(first_deg: float, second_deg: float) -> bool:
    return abs((first_deg - second_deg + 90.0) % 180.0 - 90.0) <= _EQUAL


def _content(symmetry: Symmetry) -> Any:
    used = symmetry.permutation.tobytes() if np.any(symmetry.source >= 0) else b""
    arrays = (symmetry.source.tobytes(), symmetry.constant.tobytes())
    return (used, *arrays, symmetry.conditions, symmetry.ties)


# Sequences


def has_image(sequences: Array, symmetry: Symmetry) -> NDArray[np.bool_]:
    """Whether sequences (m, n_unknown) meet the conditions of a symmetry, (m,)."""
    holds = np.ones(len(sequences), dtype=bool)
    for k, index in symmetry.conditions:
        holds &= sequences[:, k] == index
    for k, other in symmetry.ties:
        holds &= sequences[:, k] == sequences[:, other]
    return holds


def grid_indices(sequences: Array, symmetry: Symmetry) -> Array:
    """Sequences that fit the symmetry's grid and layup; ``ValueError`` otherwise."""
    indices = np.asarray(sequences)
    n_grid, n_unknown = symmetry.permutation.size, symmetry.source.size
    if indices.ndim != 2 or indices.shape[1] != n_unknown or not np.issubdtype(indices.dtype, np.integer):
        raise ValueError(
            f"sequences: received shape {indices.shape} of {indices.dtype}, "
            f"accepted: (m, {n_unknown}) integers"
        )
    if indices.size and not (indices.min() >= 0 and indices.max() < n_grid):
        raise ValueError(
            f"sequences: received grid indices {indices.min()} to {indices.max()}, "
            f"accepted: 0 to {n_grid - 1}"
        )
    return indices
