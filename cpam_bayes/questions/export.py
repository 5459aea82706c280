"""The question `export`: a plate as a file for other programs.

An input deck for CalculiX and ABAQUS, or predicted modes as a universal file, written by pyuff: datasets 164,
15, 82 and 55.
"""

from __future__ import annotations

import os
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar, Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.command import MODES, PLATE, Command, option
from cpam_bayes.errors import checked
from cpam_bayes.formatting import file_stem
from cpam_bayes.forward_model.calculix.deck import Deck, Element, plate_deck
from cpam_bayes.forward_model.labels import measured_modes
from cpam_bayes.forward_model.model import NO_PARAMETERS, air_shifts, converged_model, reference_constants
from cpam_bayes.forward_model.preconditions import (
    require_choice,
    require_modes,
    require_seed,
    require_supported,
)
from cpam_bayes.mechanics.modes import Mode, describe_modes, shapes_at
from cpam_bayes.plate import PlateLike, Specimen, read_plate
from cpam_bayes.plate.instruments import pyuff
from cpam_bayes.render.plate import plate_section
from cpam_bayes.render.report import Column, Report, Rows, Section, Table, facts, plate_keys
from cpam_bayes.render.sentences import plate_argument
from cpam_bayes.result import PlateResult, present
from cpam_bayes.running import single_blas_thread
from cpam_bayes.storage import replaceable, write_whole

Array = NDArray[Any]

# Nodes along the longer side, and minimum along the shorter one.
_ALONG, _LEAST = 21, 9
# Dataset 164: mm, mN, and factors from SI.
_UNITS: Final = {
    "units_code": 5,
    "units_description": "mm (milli-newton)",
    "temp_mode": 2,
    "length": 1e3,
    "force": 1e3,
    "temp": 1.0,
    "temp_offset": 273.15,
}
# Dataset 55: structural model, normal mode, three translations, displacement, real.
_NORMAL_MODE: Final = {
    "model_type": 1,
    "analysis_type": 2,
    "data_ch": 2,
    "spec_data_type": 8,
    "data_type": 2,
    "n_data_per_node": 3,
    "load_case": 1,
    "modal_m": 1.0,
    "modal_damp_vis": 0.0,
    "modal_damp_his": 0.0,
}


@dataclass(frozen=True, slots=True, eq=False)
class UniversalShapes:
    """Predicted mode shapes at nodes.

    nodes : (n,) node numbers
    points : (n, 2) m, from the corner x = y = 0
    lines : node numbers of the trace lines
    shapes : (n_modes, 3, n) u, v, w, for a modal mass of 1 kg
    measured : whether the nodes are those of measured shapes
    """

    modes: tuple[Mode, ...]
    nodes: Array
    points: Array
    lines: tuple[Array, ...]
    shapes: Array
    measured: bool


@single_blas_thread
def predicted_shapes(specimen: Specimen, n_modes: int) -> UniversalShapes:
    """Modes of a plate at its reference constants, at the nodes of its measured shapes or else on a grid."""
    plate, measurement = specimen.plate, specimen.measurement
    sides = np.array([plate.length, plate.width])
    lines: tuple[Array, ...] = ()
    if measurement is not None and measurement.shapes is not None:
        nodes, points = measurement.shapes.nodes, measurement.shapes.points
    else:
        n_x, n_y = np.maximum(np.round(_ALONG * sides / sides.max()).astype(int), _LEAST)
        grid = np.arange(1, n_x * n_y + 1).reshape(n_x, n_y)
        nodes, lines = grid.ravel(), (*grid, *grid.T)
        x, y = (np.linspace(0.0, side, n) for side, n in zip(sides, (n_x, n_y), strict=True))
        points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    model = converged_model(specimen, NO_PARAMETERS, n_modes)
    none = np.empty((1, 0))
    spectrum = model.spectrum(none, vectors=True)
    _, mass = model.coefficients(none)
    return UniversalShapes(
        modes=describe_modes(model.operator, spectrum, mass),
        nodes=nodes,
        points=points,
        lines=lines,
        shapes=shapes_at(model.operator, spectrum, points / sides),
        measured=not lines,
    )


def universal_text(title: str, shapes: UniversalShapes) -> str:
    """Content of the universal file; raises ``UniversalFileError`` where pyuff is missing."""
    library = pyuff()
    with TemporaryDirectory() as directory:
        path = Path(directory) / "file.unv"
        library.UFF(str(path)).write_sets(_sets(title, shapes), "add")
        return path.read_text(encoding="utf-8")


def _sets(title: str, shapes: UniversalShapes) -> Sequence[dict[str, Any]]:
    n = len(shapes.nodes)
    x, y = 1e3 * shapes.points.T
    zero = np.zeros(n, dtype=int)
    nodes = {"type": 15, "node_nums": shapes.nodes, "def_cs": zero, "disp_cs": zero, "color": zero}
    lines = [
        {"type": 82, "trace_num": i, "color": 0, "id": f"line {i}", "nodes": line}
        for i, line in enumerate(shapes.lines, 1)
    ]
    modes = [
        {
            "type": 55,
            "id1": f"{title}, predicted".encode("ascii", "replace").decode()[:80],
            "id2": f"{mode.kind} {mode.label}",
            "id3": f"mode {i}, {mode.frequency:.6g} Hz",
            "node_nums": shapes.nodes,
            "mode_n": i,
            "freq": mode.frequency,
            **_NORMAL_MODE,
            **{f"r{axis}": values for axis, values in enumerate(shape, 1)},
        }
        for i, (mode, shape) in enumerate(zip(shapes.modes, shapes.shapes, strict=True), 1)
    ]
    return [{"type": 164, **_UNITS}, {**nodes, "x": x, "y": y, "z": 0.0 * x}, *lines, *modes]


_NO_MESH: Final = "files are written for rectangular plates only; leave mesh out"
_NO_AIR: Final = "decks model a plate in vacuum; leave air_density_kg_m3 out"
Format = Literal["ccx", "uff"]
_ENDINGS: Final[dict[Format, str]] = {"ccx": ".inp", "uff": ".unv"}
_TYPE: Final[dict[Element, str]] = {"shell": "S8R", "brick": "C3D20R"}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class ExportResult(PlateResult):
    """An input deck and its file; n_modes : deformation modes requested by its step."""

    command: ClassVar[str] = "export"

    path: Path
    element: Element
    n_modes: int
    deck: Deck

    @property
    def n_elements(self) -> int:
        """Number of elements of the plate, without known masses."""
        layers, in_plane, _ = self.deck.mesh.elements.shape
        return int(layers * in_plane)

    @property
    def element_type(self) -> str:
        """ABAQUS name of the element type."""
        return _TYPE[self.element]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class UniversalResult(PlateResult):
    """Predicted modes in a universal file."""

    command: ClassVar[str] = "export"

    path: Path
    shapes: UniversalShapes


@checked
def export(
    plate: PlateLike,
    path: str | Path | None = None,
    *,
    to: Format = "ccx",
    element: Element | None = None,
    n_modes: int | None = None,
    force: bool = False,
    seed: int = 0,
) -> ExportResult | UniversalResult:
    """Write a plate at its reference constants to a file for other programs.

    Parameters
    ----------
    plate : a built-in name, a path, a table or a `Specimen`, see `read_plate`
    path : the file to write, by default named after the plate, with the ending ".inp" or ".unv"
    to : "ccx", an input deck for CalculiX and ABAQUS, or "uff", predicted modes as a universal file
        (datasets 15 and 55), at the nodes of measured shapes where there are some
    element : for a deck, "shell" (S8R, the default) or "brick" (C3D20R)
    n_modes : modes that the deck requests, or that are written; as many as were measured, or 10, if left
        out
    force : whether to overwrite an existing file

    Raises
    ------
    ValueError
        If the plate cannot be read or exported, or the file cannot be written.

    Examples
    --------
    >>> import cpam_bayes as cb
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as directory:
    ...     deck = cb.export("A1", f"{directory}/a1.inp")
    >>> deck.n_elements, deck.element_type
    (255, 'S8R')
    """
    require_seed(seed)
    require_modes(n_modes)
    require_choice("to", to, tuple(_ENDINGS))
    if element is not None:
        require_choice("element", element, tuple(_TYPE))
        if to != "ccx":
            raise ValueError(f"--element: received {element}, accepted: with --to ccx only")
    specimen = require_supported(read_plate(plate), _NO_MESH, _NO_AIR if to == "ccx" else None)
    target = _target(plate, path, specimen.name, _ENDINGS[to])
    _require_writable(target, force)
    n = n_modes or measured_modes(specimen)
    if to == "uff":
        shapes = predicted_shapes(specimen, n)
        _write(target, universal_text(specimen.name, shapes))
        return UniversalResult(
            seed=seed, specimen=specimen, air_shifts=air_shifts(specimen), path=target, shapes=shapes
        )
    deck = plate_deck(specimen, reference_constants(specimen), element or "shell", n)
    _write(target, deck.text)
    return ExportResult(
        seed=seed,
        specimen=specimen,
        air_shifts=air_shifts(specimen),
        path=target,
        element=element or "shell",
        n_modes=n,
        deck=deck,
    )


def _target(plate: PlateLike, path: str | Path | None, name: str, ending: str) -> Path:
    """The file to write; refuses the plate file itself."""
    given = plate if isinstance(plate, str | os.PathLike) else ""
    if path == "":
        raise ValueError("--out: received an empty name, accepted: the file to write")
    target = Path(path or f"{Path(given).stem or file_stem(name)}{ending}")
    if given and target.resolve() == Path(given).resolve():
        raise ValueError(f"--out {target}: the plate file itself; give another name")
    return target


def _require_writable(path: Path, force: bool) -> None:
    """Raise ``ValueError`` where a file cannot be written, or exists and ``force`` is not given."""
    shown = f"--out {path}"
    try:
        if path.is_dir():
            raise ValueError(f"{shown}: a directory, accepted: the file to write")
        if not replaceable(path):
            raise ValueError(f"{shown}: a link, pipe or device, accepted: a regular file or a new name")
        if os.path.lexists(path) and not force:
            raise ValueError(f"{shown}: exists; give another name, or --force to overwrite it")
        if not path.parent.is_dir():
            raise ValueError(f"{shown}: {path.parent} is not a directory")
    except OSError as error:
        raise ValueError(f"{shown}: cannot be written to: {error.strerror}") from None


def _write(path: Path, text: str) -> None:
    """Write a file; raise ``ValueError`` where that fails."""
    try:
        write_whole(path, text.encode())
    except OSError as error:
        raise ValueError(f"--out {path}: cannot be written to: {error.strerror}") from None


_CONSTANTS: Final = "The constants are those of [material], not identified ones."


def _report(
    result: ExportResult | UniversalResult,
    headline: str,
    written: Table,
    next_step: str,
    document: dict[str, Any],
    rows: tuple[Rows, ...] = (),
) -> Report:
    return Report(
        summary=result.screen(
            headline=headline,
            lines=(_CONSTANTS,),
            next_step=next_step,
        ),
        sections=(
            plate_section(result.specimen, result.air_shifts),
            Section("The file", (written,), folded=False),
        ),
        document={**plate_keys(result.command, result.seed, result.specimen), **document},
        rows=rows,
    )


@present.register
def _present_deck(result: ExportResult) -> Report:
    n_rigid, n_nodes = result.deck.n_rigid, len(result.deck.mesh.nodes)
    rigid = f" after {n_rigid} rigid-body motions" if n_rigid else ""
    written = (
        ("file", str(result.path)),
        ("format", "ABAQUS input, read by ABAQUS and CalculiX; N, m, kg, s"),
        ("elements", f"{result.n_elements} of {result.element_type}, {result.element}s"),
        ("nodes", str(n_nodes)),
        ("step", f"{result.n_modes + n_rigid} modes: {result.n_modes} and {n_rigid} rigid-body motions"),
    )
    return _report(
        result,
        f"{result.path}: {result.n_elements} {result.element} elements ({result.element_type}), {n_nodes} "
        f"nodes. CalculiX or ABAQUS computes {result.n_modes} natural frequencies from it{rigid}.",
        facts("Written", written),
        f"ccx {shlex.quote(str(result.path.with_suffix('')))}, and compare with  cpam-bayes forward "
        f"{plate_argument(result.specimen)}",
        {
            "to": "ccx",
            "path": str(result.path),
            "element": result.element,
            "element_type": result.element_type,
            "nodes": n_nodes,
            "elements": result.n_elements,
            "masses": len(result.specimen.sensors),
            "modes": result.n_modes,
            "rigid_body_motions": n_rigid,
        },
    )


_MODES: Final = (
    Column(None, "frequency_hz", lambda mode: mode.frequency),
    Column(None, "kind", lambda mode: mode.kind),
    Column(None, "label", lambda mode: mode.label),
)


@present.register
def _present_universal(result: UniversalResult) -> Report:
    shapes = result.shapes
    where = "nodes of the measured shapes" if shapes.measured else "nodes of a grid"
    modes = Rows("modes", _MODES, shapes.modes)
    written = (
        ("file", str(result.path)),
        ("format", "universal file: datasets 164 (mm), 15, 55" + (" and 82" if shapes.lines else "")),
        ("nodes", f"{len(shapes.nodes)}, {'of the measured shapes' if shapes.measured else 'on a grid'}"),
        ("modes", f"{len(shapes.modes)}, for a modal mass of 1 kg"),
    )
    return _report(
        result,
        f"{result.path}: {len(shapes.modes)} predicted modes, {shapes.modes[0].frequency:.4g} to "
        f"{shapes.modes[-1].frequency:.4g} Hz, at {len(shapes.nodes)} {where}.",
        facts("Written", written),
        "import the file into the modal software beside the measured modes; the same modes here:  "
        f"cpam-bayes forward {plate_argument(result.specimen)}",
        {
            "to": "uff",
            "path": str(result.path),
            "nodes": len(shapes.nodes),
            "measured_nodes": shapes.measured,
            "modes": modes.records(),
        },
        (modes,),
    )


COMMAND: Final = Command(
    export,
    (
        PLATE,
        option(
            "--to",
            choices=get_args(Format),
            required=True,
            help="ccx: an input file for CalculiX and ABAQUS; uff: the predicted modes as a universal file, "
            "datasets 15 and 55",
        ),
        option(
            "--element",
            choices=tuple(_TYPE),
            help="ccx: shell, 8 nodes (S8R), or brick, 20 nodes, in layers of plies (C3D20R) "
            "(default: shell)",
        ),
        MODES,
        option(
            "--out",
            "path",
            dest="file",
            metavar="FILE",
            help="the file to write, not a directory (default: PLATE.inp or PLATE.unv, here)",
        ),
        option("--force", action="store_true", help="overwrite an existing file"),
    ),
    out=None,
    watched=False,
)
