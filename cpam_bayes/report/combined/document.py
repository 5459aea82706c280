"""The JSON document of `report`: those of its parts."""

from __future__ import annotations

from typing import Any

from cpam_bayes.combined import FullReport
from cpam_bayes.report.documents import plate_keys


def document(result: FullReport) -> dict[str, Any]:
    """The JSON document of `report`."""
    return {
        **plate_keys(result),
        "quick": result.quick,
        "status": result.status,
        "identification": result.identification.to_dict(),
        "stacking": None if result.stacking is None else result.stacking.to_dict(),
        "diagnosis": result.diagnosis.to_dict(),
        "seconds": result.seconds,
        "warnings": list(result.warnings),
        "notes": list(result.specimen.notes),
    }
