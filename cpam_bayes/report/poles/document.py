"""The JSON document of `poles`."""

from __future__ import annotations

from typing import Any

from cpam_bayes import __version__
from cpam_bayes.modal_analysis.poles import PolesResult


def document(result: PolesResult) -> dict[str, Any]:
    """The JSON document of `poles`."""
    return {
        "command": result.command,
        "version": __version__,
        "files": list(result.files),
        "read": result.responses.origin,
        "responses": len(result.responses.frf),
        "line_hz": result.responses.step,
        "range_hz": [result.low, result.high],
        "order": result.order,
        "modes": [
            {"hz": m.frequency, "sd": m.sd, "damping": m.damping, "damping_sd": m.damping_sd}
            for m in result.modes
        ],
        "seed": result.seed,
        "warnings": list(result.warnings),
    }
