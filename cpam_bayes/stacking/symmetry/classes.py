"""Classes of stacking sequences under the symmetries of a plate, for stacks of millions of them.

Sequences are rows of grid indices. Read as numbers in the base of the grid's size they are in
lexicographic order, and an image under a symmetry is a sum of table entries.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.stacking.symmetry.symmetries import Symmetry, grid_indices, has_image, image

Array = NDArray[Any]

_ROWS: Final = 1 << 17  # rows handled together, so that their images stay in the processor's cache


@dataclass(frozen=True, slots=True, eq=False)
class Orbits:
    """The class of every sequence of a stack.

    representative : (m, n_unknown) first member of the class in lexicographic order of grid indices; of the
    dtype of the sequences.
    size : (m,) sequences of the whole grid in the class.
    """

    representative: Array
    size: NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Classes:
    """The different classes of a stack of sequences, in lexicographic order.

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
    """Representatives and sizes of the classes that sequences belong to, whichever members are there.

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
    """The classes of sequences (m, n_unknown) that no frequency tells apart.

    Raises as ``canonical``.
    """
    orbits = canonical(sequences, symmetries)
    _, first, label, present = np.unique(
        _lexicographic(orbits.representative), return_index=True, return_inverse=True, return_counts=True
    )
    return Classes(orbits.representative[first], label.reshape(-1), present, orbits.size[first])


def members(sequence: Array, symmetries: Sequence[Symmetry]) -> Array:
    """All sequences of the class of a sequence (n_unknown,), in lexicographic order, (size, n_unknown)."""
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
    """Numbers of sequences and of their images, (1 + n_symmetries, rows), some rows at a time.

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
    """Ranks of rows in lexicographic order, equal for equal rows, (m,)."""
    top = int(sequences.max(initial=0)) + 1
    return np.asarray(sequences.astype(np.int64) @ _places(top, sequences.shape[1]))
