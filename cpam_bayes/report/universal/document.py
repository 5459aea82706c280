"""The JSON document of `export --to uff`."""

from __future__ import annotations

from typing import Any

from cpam_bayes.forward_model.export import UniversalResult
from cpam_bayes.report.documents import plate_keys


def document(result: UniversalResult) -> dict[str, Any]:
    """The JSON document of `export --to uff`."""
    return {
        **plate_keys(result),
        "to": "uff",
        "path": str(result.path),
        "nodes": len(result.shapes.nodes),
        "measured_nodes": result.shapes.measured,
        "modes": [
            {"frequency_hz": mode.frequency, "kind": mode.kind, "label": mode.label}
            for mode in result.shapes.modes
        ],
    }
