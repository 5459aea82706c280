"""Stacking sequences that no frequency can distinguish because of the plate's symmetries; their ply sums.

A rigid motion that maps the plate onto itself, edges and known masses included, maps every laminate to
another one with the same frequencies. In the plane the motions of a rectangle or a square change the
ply angles in one of three ways,

    a mirror along x or y       theta -> -theta          any rectangle whose edges allow it
    a quarter turn              theta -> theta + 90      squares
    a mirror along a diagonal   theta -> 90 - theta      squares

and a half turn leaves them unchanged. Turning the plate upside down reverses the order of the plies:
the plate model does not know on which face a mass sits. All products of these are tried.

Sequences are rows of grid indices, (m, n_unknown) integers into ``angle_grid``, for stacks of millions of
them: read as numbers in the base of the grid's size they are in lexicographic order, and an image under a
symmetry is a sum of table entries. Plies of known angle take part: [45/?]_s has no mirror image of its own
form, [45/?/?/-45] has one, upside down. A motion that keeps the form of a layup for some sequences only
merges those.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.plate import Plate, Specimen, angle_grid
from cpam_bayes.plate.layup import Layup
from cpam_bayes.plate.motions import ANGLE_MOTIONS, EXCHANGES, MOTIONS

Array = NDArray[Any]

_EQUAL: Final = 1e-9

_ROWS: Final = 1 << 17  # rows handled together, so that their images stay in the processor's cache
# Sums with a smaller standard deviation over all sequences, given v, are neglected.
_NEGLIGIBLE_SD = 3e-3
# Evenly drawn sequences from which this is computed.
_SAMPLE_SIZE = 4000
# Signs that motions of the plate give to cos 2t, sin 2t, cos 4t, sin 4t.
_SIGNS = {
    "mirror image": (1, -1, 1, -1),
    "quarter turn": (-1, -1, 1, 1),
    "diagonal mirror image": (-1, 1, 1, -1),
}


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
    """Kinds of motions in the plane that map the plate onto itself, "" (none) always among them.

    Kinds that exchange x and y need a square whose sizes are known equally well, and frequencies
    without labels: a label counts half-waves along x and along y. A plate with a mesh from a file has only
    the kind "".
    """
    plate = specimen.plate
    labelled = specimen.measurement is not None and specimen.measurement.names_modes
    if plate.mesh is not None:
        return ("",)
    masses = [(s.x / plate.length, s.y / plate.width, s.mass) for s in specimen.sensors]
    kinds: list[str] = []
    for motion in MOTIONS:
        if motion.kind in EXCHANGES and (labelled or not _is_square(plate)):
            continue
        if motion.kind in kinds or not motion.keeps_edges(plate.edges):
            continue
        if _same_masses(masses, [(*motion.point(x, y), mass) for x, y, mass in masses]):
            kinds.append(motion.kind)
    return tuple(kinds)


def plate_symmetries(specimen: Specimen) -> tuple[Symmetry, ...]:
    """All maps between sequences of a specimen's layup that leave every frequency unchanged.

    The identity is left out, so a plate without symmetries has none. Of equal maps the first is kept.
    """
    layup = specimen.plate.layup
    grid = angle_grid(specimen.angle_grid_deg)
    identity = _compiled("", layup, grid, ANGLE_MOTIONS[""], upside_down=False)
    assert identity is not None
    distinct: dict[Any, Symmetry] = {_content(identity): identity}
    turned = (False, True) if layup.kinds == layup.kinds[::-1] else (False,)
    for upside_down in turned:
        for kind in plane_motions(specimen):
            name = " ".join(filter(None, (kind, "upside down" if upside_down else "")))
            symmetry = _compiled(name, layup, grid, ANGLE_MOTIONS[kind], upside_down)
            if symmetry is not None:
                distinct.setdefault(_content(symmetry), symmetry)
    return tuple(distinct.values())[1:]


def image(sequences: Array, symmetry: Symmetry) -> tuple[Array, NDArray[np.bool_]]:
    """Images of sequences (m, n_unknown) under a symmetry, and mask (m,) of those that have one.

    A row without an image is returned unchanged.
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
    """Whether two lists of masses (x, y, mass) are equal up to their order."""
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
    """Symmetry of the unknown angles by a motion; None if no sequence keeps the layup's form."""
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
    """Grid index of a direction, -1 if it is not on the grid."""
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
    """Mask (m,) of the sequences (m, n_unknown) that meet the conditions of a symmetry."""
    holds = np.ones(len(sequences), dtype=bool)
    for k, index in symmetry.conditions:
        holds &= sequences[:, k] == index
    for k, other in symmetry.ties:
        holds &= sequences[:, k] == sequences[:, other]
    return holds


def grid_indices(sequences: Array, symmetry: Symmetry) -> Array:
    """Sequences as an array, checked against the symmetry's grid and layup; ``ValueError`` otherwise."""
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


@dataclass(frozen=True, slots=True, eq=False)
class Orbits:
    """The class of every sequence of a stack.

    representative : (m, n_unknown) first member of the class in lexicographic order of grid indices, with the
    dtype of the sequences.
    size : (m,) sequences of the whole grid in the class.
    """

    representative: Array
    size: NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Classes:
    """The distinct classes of a stack of sequences, in lexicographic order.

    representative : (k, n_unknown) first members.
    label : (m,) the class of each row.
    present : (k,) rows in each class.
    size : (k,) sequences of the whole grid in each class.
    """

    representative: Array
    label: NDArray[np.int64]
    present: NDArray[np.int64]
    size: NDArray[np.int64]


def canonical(sequences: Array, symmetries: Sequence[Symmetry]) -> Orbits:
    """Representatives and sizes of the classes of sequences, whichever members are present.

    sequences : (m, n_unknown) grid indices of any integer type.

    Raises ``ValueError`` for indices outside the grid, or a grid too large to be numbered by 64 bits.
    """
    sequences = np.asarray(sequences)
    if not symmetries:
        return Orbits(sequences.copy(), np.ones(len(sequences), dtype=np.int64))
    first = np.empty(len(sequences), dtype=np.int64)
    size = np.empty(len(sequences), dtype=np.int64)
    for rows, codes in _image_codes(sequences, symmetries):
        first[rows] = codes.min(axis=0)
        size[rows] = 1
        for row in range(1, len(codes)):
            size[rows] += np.all(codes[:row] != codes[row], axis=0)
    return Orbits(_decoded(first, sequences, symmetries), size)


def classes(sequences: Array, symmetries: Sequence[Symmetry]) -> Classes:
    """Classes of sequences (m, n_unknown) that no frequency distinguishes.

    Raises as ``canonical``.
    """
    orbits = canonical(sequences, symmetries)
    _, first, label, present = np.unique(
        _lexicographic(orbits.representative), return_index=True, return_inverse=True, return_counts=True
    )
    return Classes(orbits.representative[first], label.reshape(-1), present, orbits.size[first])


def members(sequence: Array, symmetries: Sequence[Symmetry]) -> Array:
    """All sequences (size, n_unknown) of the class of a sequence (n_unknown,), in lexicographic order."""
    row = np.asarray(sequence)[None, :]
    images = [row]
    for symmetry in symmetries:
        moved, holds = image(row, symmetry)
        if holds[0]:
            images.append(moved)
    return np.unique(np.concatenate(images), axis=0)


def _image_codes(
    sequences: Array, symmetries: Sequence[Symmetry]
) -> Iterator[tuple[slice, NDArray[np.int64]]]:
    """Numbers (1 + n_symmetries, rows) of sequences and of their images, some rows at a time.

    A number is read in the base of the grid's size, so that numbers are in lexicographic order. A
    missing image counts as the sequence itself.
    """
    sequences = grid_indices(sequences, symmetries[0])
    place = _places(symmetries[0].permutation.size, sequences.shape[1])
    index = np.arange(symmetries[0].permutation.size)
    plain = [index * p for p in place]
    tables = [
        [s.permutation * p if k >= 0 else None for k, p in zip(s.source, place, strict=True)]
        for s in symmetries
    ]
    for start in range(0, len(sequences), _ROWS):
        rows = slice(start, min(start + _ROWS, len(sequences)))
        columns = [np.ascontiguousarray(column) for column in sequences[rows].T]
        codes = np.zeros((1 + len(symmetries), rows.stop - rows.start), dtype=np.int64)
        for table, column in zip(plain, columns, strict=True):
            codes[0] += table[column]
        for row, (symmetry, lookup) in enumerate(zip(symmetries, tables, strict=True), 1):
            for j, table in enumerate(lookup):
                codes[row] += (
                    symmetry.constant[j] * place[j] if table is None else table[columns[symmetry.source[j]]]
                )
            if not symmetry.everywhere:
                holds = has_image(sequences[rows], symmetry)
                codes[row] = np.where(holds, codes[row], codes[0])
        yield rows, codes


def _places(n_grid: int, n_unknown: int) -> NDArray[np.int64]:
    if n_unknown * np.log2(max(n_grid, 2)) >= 63:
        raise ValueError(
            f"sequences of {n_unknown} unknown angles on a grid of {n_grid}: received more than 2^63, "
            "accepted: fewer; use a coarser grid"
        )
    return np.asarray(n_grid ** np.arange(n_unknown - 1, -1, -1, dtype=np.int64))


def _decoded(codes: NDArray[np.int64], like: Array, symmetries: Sequence[Symmetry]) -> Array:
    n_grid = symmetries[0].permutation.size
    sequences = np.empty(like.shape, dtype=like.dtype)
    for j in range(like.shape[1] - 1, -1, -1):
        codes, sequences[:, j] = np.divmod(codes, n_grid)
    return sequences


def _lexicographic(sequences: Array) -> NDArray[np.int64]:
    """Numbers (m,) that order rows lexicographically, equal for equal rows."""
    top = int(sequences.max(initial=0)) + 1
    return np.asarray(sequences.astype(np.int64) @ _places(top, sequences.shape[1]))


@dataclass(frozen=True, slots=True)
class PlySums:
    """Sums of angle functions over the unknown plies of a symmetric layup.

    v = sum_j w_j (cos 2t_j, sin 2t_j, cos 4t_j, sin 4t_j), w_j the fraction of unknown j in the bending
    stiffness of all unknown plies: the unknown part of the bending lamination parameters (Tsai and
    Hahn, 1980), between -1 and 1. q are the same sums with the weights of the transverse shear energy,
    (1 - 4 z^2 / h^2)^2, and of the membrane stiffness, minus their linear regression on v.

    first : (k, n_grid, 4) contributions to v.
    rest : (k, n_grid, n_q) contributions to q.
    grid_deg : (n_grid,).
    function : (4 + n_q,) index of the angle function, of four, of each sum.
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
        """Bounds (n_q,) of the magnitude of q over all sequences."""
        return np.asarray(np.abs(self.rest).max(axis=1).sum(axis=0))

    @property
    def both(self) -> Array:
        """Contributions (k, n_grid, 4 + n_q) to v and q."""
        return np.concatenate((self.first, self.rest), axis=2)

    def signs(self, motion: str) -> Array:
        """Signs (4 + n_q,) that a motion of the plate, by its name, gives to the sums."""
        return np.array(_SIGNS[motion], dtype=float)[self.function]

    def features(self, sequences: Array) -> Array:
        """Sums (v, q), (m, 4 + n_q), of sequences of grid indices (m, k)."""
        both = self.both
        return np.asarray(sum(both[j][sequences[:, j]] for j in range(self.n_unknown)))


def all_sequences(n_grid: int, n_unknown: int) -> Array:
    """All sequences of grid indices (n_grid^n_unknown, n_unknown); the last angle changes fastest."""
    every = np.unravel_index(np.arange(n_grid**n_unknown), (n_grid,) * n_unknown)
    return np.stack(every, axis=1)


def all_choices(contributions: Array) -> Array:
    """Sums (n_grid^k, d) of contributions (k, n_grid, d) of some plies for all choices of their angles.

    The angle of the last ply changes fastest.
    """
    total = np.zeros((1, contributions.shape[2]))
    for ply in contributions:
        total = (total[:, None, :] + ply).reshape(-1, total.shape[1])
    return total


def ply_sums(layup: Layup, grid_deg: Array) -> PlySums:
    """Sums of a symmetric layup of equal plies with unknown angles on a grid, (n_grid,) degrees.

    Raises ``ValueError`` for a layup that is not symmetric, where bending and stretching are coupled, or
    of several kinds of plies: these would need more sums.
    """
    if layup.kinds or not layup.is_symmetric:
        raise ValueError(
            f"received {layup.text}; {len(grid_deg)}^{layup.n_unknown} sequences need a symmetric layup of "
            "equal plies; end it with _s, give more of its angles, or take a coarser angle_grid_deg"
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
    """Principal directions of further sums (n, k, n_grid) minus their regression on the first (k, n_grid)."""
    k, n_grid = first.shape
    sequences = np.random.default_rng(0).integers(n_grid, size=(_SAMPLE_SIZE, k))
    ply = np.arange(k)
    v, q = first[ply, sequences].sum(axis=1), others[:, ply, sequences].sum(axis=2).T
    slope = v @ q / (v @ v)
    residual = (q - v[:, None] * slope) / np.sqrt(_SAMPLE_SIZE)
    _, sd, directions = np.linalg.svd(residual, full_matrices=False)
    kept = directions[sd > _NEGLIGIBLE_SD].T
    return np.asarray((np.moveaxis(others, 0, -1) - first[..., None] * slope) @ kept)
