"""What CalculiX writes about a frequency step into its results file (.dat)."""

from __future__ import annotations

import re
from typing import Final

import numpy as np
from numpy.typing import NDArray

# A rigid-body motion has eigenvalue zero but for rounding, which grows as plies get thinner: at
# most this fraction of the first deformation mode's.
_RIGID_TOLERANCE: Final = 1e-2
# Neighbouring deformation modes are never this far apart; a motion that a lost edge condition or
# an hourglass made free is far from all of them.
_WIDEST_GAP: Final = 1e-4
# A row of the table of eigenvalues: number, eigenvalue, three columns that follow from it.
_EIGENVALUE = re.compile(r"\s*(\d+)\s+(\S+)\s+\S+\s+\S+\s+\S+\s*")
_DISPLACEMENT = re.compile(r"\s*(\d+)\s+(\S+)\s+(\S+)\s+(\S+)\s*")


class CalculixError(ValueError):
    """CalculiX is not there, failed, or gave an answer that cannot be right."""


def read_eigenvalues(text: str) -> NDArray[np.float64]:
    """Eigenvalues in the results (.dat) of a frequency step, (n,) (rad/s)^2, as listed.

    Raises CalculixError for a row that holds no number.
    """
    eigenvalues: list[float] = []
    in_table = False
    for line in text.splitlines():
        title = line.replace(" ", "")
        if title.startswith("EIGENVALUEOUTPUT"):
            in_table = True
        elif title.startswith("PARTICIPATIONFACTORS"):
            break
        elif in_table and (row := _EIGENVALUE.fullmatch(line)) is not None:
            eigenvalues.append(_finite(row[1], row[2]))
    return np.array(eigenvalues, dtype=np.float64)


def read_displacements(text: str, nodes: NDArray[np.int64]) -> NDArray[np.float64]:
    """Displacements of some nodes in every mode, (n_modes, n_nodes, 3), of any scale.

    Raises CalculixError where a mode lacks one of the nodes.
    """
    modes: list[dict[int, list[float]]] = []
    in_block = False
    for line in text.splitlines():
        row = _DISPLACEMENT.fullmatch(line)
        if line.lstrip().startswith("displacements"):
            modes.append({})
            in_block = True
        elif in_block and row is not None:
            number = f"{len(modes)} at node {row[1]}"
            modes[-1][int(row[1])] = [_finite(number, row[k]) for k in (2, 3, 4)]
        elif line.strip():
            in_block = False
    try:
        displacements = [[mode[n] for n in nodes.tolist()] for mode in modes]
    except KeyError as error:
        raise CalculixError(f"CalculiX printed no displacement of node {error}") from error
    return np.array(displacements, dtype=np.float64).reshape(len(modes), nodes.size, 3)


def deformation_modes(eigenvalues: NDArray[np.float64], n_rigid: int) -> NDArray[np.int64]:
    """Places of the deformation modes in a list of eigenvalues, by ascending frequency.

    n_rigid : rigid-body motions that the edges leave.

    Raises CalculixError when the eigenvalues show another number of them.
    """
    ranked = np.argsort(np.abs(eigenvalues))
    rigid, elastic = eigenvalues[ranked[:n_rigid]], eigenvalues[ranked[n_rigid:]]
    right = (
        elastic.size > 0
        and bool(np.all(elastic > 0.0))
        and np.abs(rigid).max(initial=0.0) <= _RIGID_TOLERANCE * elastic[0]
        and bool(np.all(elastic[:-1] > _WIDEST_GAP * elastic[1:]))
    )
    if not right:
        shown = ", ".join(f"{v:.4g}" for v in eigenvalues[ranked[: n_rigid + 2]])
        raise CalculixError(
            f"CalculiX: the edges leave {n_rigid} rigid-body motions, the lowest eigenvalues are "
            f"{shown} (rad/s)^2"
        )
    return ranked[n_rigid:]


def _finite(mode: str, number: str) -> float:
    try:
        value = float(number)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise CalculixError(f"CalculiX gave no number for mode {mode}: {number}")
    return value
