"""The JSON document of `forward`."""

from __future__ import annotations

from typing import Any

import numpy as np

from cpam_bayes.forward_model.solve import ForwardResult
from cpam_bayes.plate import to_user, user_name
from cpam_bayes.report.documents import plate_keys
from cpam_bayes.report.forward.rows import constants_with_origin, measured_of_modes
from cpam_bayes.report.modal_assurance.rows import shape_keys


def document(result: ForwardResult) -> dict[str, Any]:
    """The JSON document of `forward`."""
    return {
        **plate_keys(result),
        "solver": result.solver,
        "modes": [
            {
                "frequency_hz": mode.frequency,
                "kind": mode.kind,
                "label": mode.label,
                "in_plane_share": mode.in_plane_fraction,
                "relative_error_estimate": float(error),
                "measured_hz": None if measured is None else measured.hz,
                "paired_by": None if measured is None else measured.by,
            }
            for mode, error, measured in zip(
                result.modes,
                result.error,
                measured_of_modes(result.specimen, result.modes, result.by_shape),
                strict=True,
            )
        ],
        **shape_keys(result.by_shape, result.specimen.measurement),
        "relative_error_estimate": float(np.max(result.error)),
        "no_error_estimate": result.no_estimate or None,
        "constants": {
            user_name(name): {"value": to_user(name, value), "source": source}
            for name, value, source in constants_with_origin(result.specimen)
        },
        "air_density_kg_m3": result.specimen.air_density,
        "seconds": result.seconds,
        "warnings": list(result.warnings),
        "notes": list(result.specimen.notes),
    }
