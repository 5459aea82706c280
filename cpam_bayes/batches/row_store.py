"""Finished plates on disk, so that a stopped batch goes on."""

from __future__ import annotations

import hashlib
import json
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from cpam_bayes import __version__
from cpam_bayes.batches.plate_row import PlateRow, row_of
from cpam_bayes.plate import Measurement, Specimen
from cpam_bayes.storage import read_sealed, set_aside, write_sealed

__all__ = ["read_row", "row_key", "write_row"]

# To be raised when the same inputs give other numbers.
_FORMAT: Final = 1


def row_key(specimen: Specimen, seed: int, diagnosis: bool) -> str:
    """Hash of all that a row depends on: the plate as it is computed, its list, the seed, the version."""
    measurement, plate = specimen.measurement, specimen.plate
    content: dict[str, Any] = {
        "format": _FORMAT,
        "version": __version__,
        "seed": seed,
        "diagnosis": diagnosis,
        "name": specimen.name,
        "plate": [repr(v) for v in (plate.length, plate.width, plate.thickness, plate.density, plate.mass)],
        "layup": [*(repr(float(a)) for a in plate.layup.angles_deg), *map(repr, plate.layup.kinds)],
        "edges": plate.edges,
        "sd": sorted(plate.sd.items()),
        "material": repr(specimen.material),
        "unknowns": repr(specimen.unknowns),
        "sensors": [repr(s) for s in specimen.sensors],
        "air": specimen.air_density,
        "measured": None
        if measurement is None
        else [
            measurement.frequencies.tolist(),
            measurement.resolution,
            measurement.relative_std,
            None if measurement.frequency_sd is None else measurement.frequency_sd.tolist(),
            list(measurement.labels),
            measurement.complete,
            _shapes(measurement),
        ],
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:32]


def _shapes(measurement: Measurement) -> str | None:
    """Hash of the measured shapes."""
    shapes = measurement.shapes
    if shapes is None:
        return None
    return hashlib.sha256(shapes.points.tobytes() + shapes.values.tobytes()).hexdigest()


def read_row(directory: Path | None, key: str) -> PlateRow | None:
    """What was stored of a plate; None where nothing was, or it is damaged: it is set aside."""
    if directory is None:
        return None
    path = _path(directory, key)
    try:
        content = read_sealed(path)
    except OSError:
        return None
    if content is None:
        return None
    try:
        return row_of(content)
    except (ValueError, KeyError, TypeError):
        set_aside(path)
        return None


def write_row(directory: Path | None, key: str, row: PlateRow) -> None:
    """Store a finished plate; a directory that cannot be written to ends the storing, not the work."""
    if directory is None:
        return
    with suppress(OSError):
        directory.mkdir(parents=True, exist_ok=True)
        write_sealed(_path(directory, key), row.stored())


def _path(directory: Path, key: str) -> Path:
    return directory / f"{key}.plate"
