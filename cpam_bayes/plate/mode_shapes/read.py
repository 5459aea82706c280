"""The universal file that a plate file names under [measurement], found and read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.plate.mode_shapes.measured import MeasuredShapes, placed_shapes
from cpam_bayes.plate.mode_shapes.universal import UniversalFileError, universal_modes
from cpam_bayes.plate.problems import Problem
from cpam_bayes.plate.raw import Data, number, table
from cpam_bayes.plate.regular_file import read_named_file
from cpam_bayes.plate.schema import MAX_FREQUENCIES

__all__ = ["MAX_UNIVERSAL_BYTES", "ShapeModes", "read_shapes", "shapes_of"]

_KEY: Final = ("measurement", "shapes")
MAX_UNIVERSAL_BYTES: Final = 20_000_000
"""A file of 100 modes at 3000 nodes has as much; it is read in some seconds."""


@dataclass(frozen=True, slots=True, eq=False)
class ShapeModes:
    """The modes of a universal file, ascending.

    frequencies : (n,) Hz
    damping : (n,) ratios, nan where there is none; None where no mode has one
    origin : what was read, in words
    """

    frequencies: NDArray[np.float64]
    damping: NDArray[np.float64] | None
    shapes: MeasuredShapes
    origin: str

    def fields(self, name: str) -> dict[str, Any]:
        """What of a `Measurement` the file gives; name : of the file, as the plate file has it."""
        return {
            "frequencies": self.frequencies,
            "labels": ("",) * len(self.frequencies),
            "damping": self.damping,
            "shapes": self.shapes,
            "origin": f"{name}: {self.origin}",
        }


def shapes_of(data: Data, directory: Path | None) -> tuple[ShapeModes | None, list[Problem]]:
    """The modes of the universal file that a plate file names, and what is wrong with it.

    directory : where relative paths begin
    """
    name = table(data, "measurement").get("shapes")
    if not isinstance(name, str) or not name:
        return None, []
    content, problems = read_named_file(
        _KEY, name, directory, "a universal file of modes", MAX_UNIVERSAL_BYTES
    )
    plate = table(data, "plate")
    length, width = (number(plate, key) for key in ("length_mm", "width_mm"))
    if content is None or length is None or width is None or min(length, width) <= 0.0:
        return None, problems
    try:
        return read_shapes(content, 1e-3 * length, 1e-3 * width), []
    except UniversalFileError as error:
        return None, [Problem(_KEY, f"{Path(name).name}: {error}")]


def read_shapes(content: bytes, length: float, width: float) -> ShapeModes:
    """The modes of a universal file on a plate of length by width, m.

    Raises ``UniversalFileError`` where there are none, or where their nodes cannot be placed.
    """
    found = universal_modes(content)
    if len(found.modes) > MAX_FREQUENCIES:
        raise UniversalFileError(f"too many modes, received {len(found.modes)}, accepted: {MAX_FREQUENCIES}")
    shapes, where = placed_shapes(found, length, width)
    damping = np.array([mode.damping for mode in found.modes])
    kind = "complex" if np.iscomplexobj(shapes.values) else "real"
    return ShapeModes(
        frequencies=np.array([mode.frequency for mode in found.modes]),
        damping=None if np.all(np.isnan(damping)) else damping,
        shapes=shapes,
        origin=f"datasets {' '.join(map(str, found.datasets))}; {len(found.modes)} {kind} modes at {where}",
    )
