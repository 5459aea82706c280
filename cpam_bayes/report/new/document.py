"""The JSON document of `new`."""

from __future__ import annotations

from typing import Any

from cpam_bayes import __version__
from cpam_bayes.forward_model.new_plate import NewPlateResult


def document(result: NewPlateResult) -> dict[str, Any]:
    """The JSON document of `new`."""
    return {
        "command": "new",
        "version": __version__,
        "path": str(result.path),
        "missing": list(result.missing),
    }
