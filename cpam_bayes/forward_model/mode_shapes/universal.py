"""Predicted modes as a universal file, written by pyuff: datasets 164, 15, 82 and 55."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.forward_model.model import NO_PARAMETERS, converged_model
from cpam_bayes.mechanics.shapes import Mode, describe_modes, shapes_at
from cpam_bayes.plate.mode_shapes.universal import pyuff
from cpam_bayes.plate.records import Specimen
from cpam_bayes.threads import single_blas_thread

__all__ = ["UniversalShapes", "predicted_shapes", "universal_text"]

Array = NDArray[Any]

# Nodes along the longer side, and at least along the shorter one.
_ALONG, _LEAST = 21, 9
# Dataset 164: mm, mN, and factors by which SI is multiplied.
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
    """Predicted modes at nodes.

    nodes : (n,) numbers
    points : (n, 2) m, from the corner x = y = 0
    lines : (n_lines) numbers of nodes that a line joins
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
    """Modes of a plate with its reference constants at the nodes of its measured shapes, or on a grid."""
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
    """The content of the file; raises ``UniversalFileError`` where pyuff is missing."""
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
            "id1": _ascii(f"{title}, predicted"),
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


def _ascii(text: str) -> str:
    return text.encode("ascii", "replace").decode()[:80]
