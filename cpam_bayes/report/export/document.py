"""The JSON document of `export`."""

from __future__ import annotations

from typing import Any

from cpam_bayes.forward_model.export import ExportResult
from cpam_bayes.report.documents import plate_keys


def document(result: ExportResult) -> dict[str, Any]:
    """The JSON document of `export`."""
    return {
        **plate_keys(result),
        "to": "ccx",
        "path": str(result.path),
        "element": result.element,
        "element_type": result.element_type,
        "nodes": len(result.deck.mesh.nodes),
        "elements": result.n_elements,
        "masses": len(result.specimen.sensors),
        "modes": result.n_modes,
        "rigid_body_motions": result.deck.n_rigid,
    }
