"""A specimen solved by CalculiX: frequencies, and the modes with their kinds and labels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.forward_model.calculix.deck import Deck, Element, plate_deck
from cpam_bayes.forward_model.calculix.mesh import PlateMesh
from cpam_bayes.forward_model.calculix.results import (
    CalculixError,
    deformation_modes,
    read_displacements,
    read_eigenvalues,
)
from cpam_bayes.forward_model.calculix.run import run_deck
from cpam_bayes.mechanics.problem import Field
from cpam_bayes.mechanics.shapes import Mode, label_of_shape, mode_kind
from cpam_bayes.plate.records import Specimen

_FIELDS: tuple[Field, ...] = ("u", "v", "w")
_GRID = 41


@dataclass(frozen=True, slots=True, eq=False)
class CalculixModes:
    """Deformation modes of a specimen.

    frequencies : (n_modes,) Hz, ascending.
    modes : kinds and labels.
    shapes : (n_modes, 3, n, n) u, v, w of the midplane, of any scale, on a regular grid of the plate.
    """

    frequencies: NDArray[np.float64]
    modes: tuple[Mode, ...]
    shapes: NDArray[np.float64]


def solve_specimen(
    specimen: Specimen,
    constants: Mapping[str, float],
    n_modes: int,
    *,
    element: Element = "brick",
    in_plane: int | None = None,
    timeout: float | None = None,
) -> NDArray[np.float64]:
    """Natural frequencies of a specimen, (n_modes,) Hz; arguments and errors as `solve_modes`."""
    return solve_modes(
        specimen, constants, n_modes, element=element, in_plane=in_plane, timeout=timeout
    ).frequencies


def solve_modes(
    specimen: Specimen,
    constants: Mapping[str, float],
    n_modes: int,
    *,
    element: Element = "brick",
    in_plane: int | None = None,
    timeout: float | None = None,
) -> CalculixModes:
    """The lowest modes of a specimen by CalculiX, rigid-body motions left out.

    constants, in_plane : as for `plate_deck`.
    timeout : s.

    Raises ValueError as `plate_deck` does, and CalculixError as `run_deck` does or when the number of modes
    is wrong.
    """
    deck = plate_deck(specimen, constants, element, n_modes, in_plane=in_plane)
    results = run_deck(deck.text, timeout=timeout)
    eigenvalues = read_eigenvalues(results)
    places = deformation_modes(eigenvalues, deck.n_rigid)[:n_modes]
    if len(places) < n_modes:
        raise CalculixError(f"CalculiX: {n_modes} modes asked for, {len(places)} found")
    frequencies = np.sqrt(eigenvalues[places]) / (2 * np.pi)
    midplane = _midplane(deck, results)
    if len(midplane) != len(eigenvalues):
        raise CalculixError(f"CalculiX: {len(eigenvalues)} eigenvalues, shapes of {len(midplane)} modes")
    shapes = np.stack([_on_regular_grid(midplane[place], deck.mesh) for place in places])
    modes = tuple(
        _mode(float(f), shape, specimen.plate.edges) for f, shape in zip(frequencies, shapes, strict=True)
    )
    for array in (frequencies, shapes):
        array.flags.writeable = False
    return CalculixModes(frequencies, modes, shapes)


def _midplane(deck: Deck, results: str) -> NDArray[np.float64]:
    """Mean of the two surfaces, (n_modes, 3, nx, ny)."""
    surfaces = deck.mesh.surfaces
    displacements = read_displacements(results, surfaces.ravel())
    mean = displacements.reshape(len(displacements), *surfaces.shape, 3).mean(axis=1)
    return np.moveaxis(mean, -1, 1)


def _on_regular_grid(shape: NDArray[np.float64], mesh: PlateMesh) -> NDArray[np.float64]:
    """(3, nx, ny) on the mesh's vertices -> (3, n, n) by linear interpolation."""
    along_x, along_y = (_interpolation(axis) for axis in (mesh.x, mesh.y))
    return np.asarray(along_x @ shape @ along_y.T)


def _interpolation(axis: NDArray[np.float64]) -> NDArray[np.float64]:
    """Matrix (n, n_axis) of linear interpolation from an axis to n equal steps."""
    regular = np.linspace(axis[0], axis[-1], _GRID)
    return np.stack([np.interp(regular, axis, unit) for unit in np.eye(len(axis))], axis=1)


def _mode(frequency: float, shape: NDArray[np.float64], edges: str) -> Mode:
    """Kind and label as of the other solvers; the label of an in-plane mode names its field."""
    weight = np.ones(_GRID)
    weight[[0, -1]] = 0.5
    energy = np.einsum("fij,i,j->f", shape**2, weight, weight)
    fraction = float(energy[:2].sum() / energy.sum())
    candidates = (0, 1) if fraction > 0.5 else (2,)
    largest = max(candidates, key=lambda k: float(energy[k]))
    field = _FIELDS[largest]
    label = label_of_shape(shape[largest], edges, field)
    return Mode(frequency, mode_kind(fraction), label if field == "w" else field + label, fraction)
