"""Named arrays in a sealed file."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.storage.sealed import read_sealed, set_aside, write_sealed

__all__ = ["ARRAYS", "read_arrays", "write_arrays"]

Array = NDArray[Any]

ARRAYS: Final = ".arrays"
"""Ending of such files."""


def write_arrays(path: Path, arrays: Mapping[str, Array]) -> None:
    """Store arrays under their names; raise ``OSError`` where that fails."""
    content = io.BytesIO()
    np.savez(content, **arrays)  # type: ignore[arg-type]
    write_sealed(path, content.getbuffer())


def read_arrays(path: Path) -> dict[str, Array] | None:
    """The arrays of a file; ``None`` if there is none or it is damaged. Nothing is unpickled.

    Raises ``OSError`` where a file that is there cannot be read.
    """
    content = read_sealed(path)
    if content is None:
        return None
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except Exception:  # noqa: BLE001 - zipfile and numpy raise many kinds for what another program sealed
        set_aside(path)
        return None
