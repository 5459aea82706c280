"""A plate solved by the program CalculiX: a deck in, frequencies and modes from its results."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.forward_model.calculix.deck import Deck, Element, PlateMesh, plate_deck
from cpam_bayes.mechanics.modes import Mode, label_of_shape, mode_kind
from cpam_bayes.plate import Specimen
from cpam_bayes.plate.edges import Field
from cpam_bayes.storage import draft_directory

# A rigid-body motion has eigenvalue zero up to rounding, which grows as plies get thinner: at most this
# fraction of the first deformation mode's.
_RIGID_TOLERANCE: Final = 1e-2
# Least ratio of neighbouring deformation eigenvalues; a motion freed by a lost edge condition or an
# hourglass is further from all of them.
_WIDEST_GAP: Final = 1e-4
# A row of the table of eigenvalues: number, eigenvalue, three columns that follow from it.
_EIGENVALUE = re.compile(r"\s*(\d+)\s+(\S+)\s+\S+\s+\S+\s+\S+\s*")
_DISPLACEMENT = re.compile(r"\s*(\d+)\s+(\S+)\s+(\S+)\s+(\S+)\s*")


class CalculixError(ValueError):
    """A failure of CalculiX: it is missing, failed, or gave an answer that cannot be right."""


def read_eigenvalues(text: str) -> NDArray[np.float64]:
    """Eigenvalues in the results (.dat) of a frequency step, (n,) (rad/s)^2, as listed.

    Raises CalculixError for a row without a number.
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
    """Indices of the deformation modes in a list of eigenvalues, by ascending frequency.

    n_rigid : number of rigid-body motions that the edges leave free.

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


PROGRAM_VARIABLE: Final = "CPAM_BAYES_CCX"
_PROGRAM: Final = "ccx"
_JOB: Final = "plate"
_SHOWN_LINES: Final = 12


def run_deck(text: str, *, timeout: float | None = None) -> str:
    """The results (.dat) of CalculiX for the text of a deck, run in a temporary directory.

    The program is ``ccx``, or the one named by the environment variable CPAM_BAYES_CCX. It runs on one
    thread unless OMP_NUM_THREADS is set.

    timeout : s.

    Raises CalculixError when the program is missing, fails, runs out of time or solves nothing.
    """
    program = _program()
    with draft_directory() as folder:
        Path(folder, f"{_JOB}.inp").write_text(text, encoding="utf-8", newline="\n")
        output = _execute(program, folder, timeout)
        file = Path(folder, f"{_JOB}.dat")
        results = file.read_text(encoding="ascii", errors="replace") if file.exists() else ""
    if read_eigenvalues(results).size == 0:
        raise CalculixError(f"CalculiX wrote no eigenvalues; its last lines:\n{_last(output)}")
    return results


def _program() -> str:
    named = os.environ.get(PROGRAM_VARIABLE)
    program = shutil.which(named or _PROGRAM)
    if program is None and named:
        raise CalculixError(
            f"{PROGRAM_VARIABLE}: received {named!r}, accepted: the path of CalculiX's program ccx"
        )
    if program is None:
        raise CalculixError(
            "the program ccx (CalculiX) is not installed: Debian's package is calculix-ccx; "
            f"a program in another place is named by the environment variable {PROGRAM_VARIABLE}"
        )
    return program


def _execute(program: str, folder: Path, timeout: float | None) -> str:
    """Run the program in a folder and return its output."""
    environment = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", **os.environ}
    try:
        done = subprocess.run(
            [str(Path(program).absolute()), "-i", _JOB],
            cwd=folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            timeout=timeout,
            check=False,
            encoding="utf-8",
            errors="replace",
        )
    except subprocess.TimeoutExpired as error:
        raise CalculixError(f"CalculiX did not finish within {timeout:g} s") from error
    except OSError as error:
        raise CalculixError(f"CalculiX could not be started: {error}") from error
    if done.returncode != 0:
        how = f"status {done.returncode}" if done.returncode > 0 else f"signal {-done.returncode}"
        raise CalculixError(f"CalculiX ended with {how}; its last lines:\n{_last(done.stdout)}")
    return done.stdout


def _last(output: str) -> str:
    lines = [line.rstrip() for line in output.splitlines() if line.strip()]
    return "\n".join(lines[-_SHOWN_LINES:])


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

    Raises ValueError like `plate_deck`, and CalculixError like `run_deck` or when the number of modes is
    wrong.
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
    """A mode with kind and label as by the other solvers; the label of an in-plane mode names its field."""
    weight = np.ones(_GRID)
    weight[[0, -1]] = 0.5
    energy = np.einsum("fij,i,j->f", shape**2, weight, weight)
    fraction = float(energy[:2].sum() / energy.sum())
    candidates = (0, 1) if fraction > 0.5 else (2,)
    largest = max(candidates, key=lambda k: float(energy[k]))
    field = _FIELDS[largest]
    label = label_of_shape(shape[largest], edges, field)
    return Mode(frequency, mode_kind(fraction), label if field == "w" else field + label, fraction)
