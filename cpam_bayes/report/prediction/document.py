"""The JSON document of `predict`."""

from __future__ import annotations

from typing import Any

import numpy as np

from cpam_bayes.plate import to_user, user_name
from cpam_bayes.prediction.predict import PredictionResult
from cpam_bayes.report.documents import plate_keys
from cpam_bayes.report.forward.rows import measured_of_modes


def document(result: PredictionResult) -> dict[str, Any]:
    """The JSON document of `predict`."""
    stored = result.posterior
    measured = measured_of_modes(result.specimen, [m.mode for m in result.modes])
    return {
        **plate_keys(result),
        "posterior": {
            "source": stored.source,
            "plate": stored.plate,
            "specimen": stored.specimen,
            "draws": len(result.frequencies),
            "constants": {
                user_name(name): {
                    "mean": to_user(name, float(stored.draws[name].mean())),
                    "sd": to_user(name, float(stored.draws[name].std(ddof=1))),
                }
                for name in stored.constants
            },
        },
        "sizes_of_posterior": result.sizes_of_posterior,
        "frequencies": [
            {
                "mean_hz": m.mean,
                "sd_hz": m.sd,
                "q025": m.q025,
                "q975": m.q975,
                "measured_q025": m.measured_q025,
                "measured_q975": m.measured_q975,
                "kind": m.mode.kind,
                "label": m.mode.label,
                "measured_hz": None if there is None else there.hz,
                "paired_by": None if there is None else there.by,
            }
            for m, there in zip(result.modes, measured, strict=True)
        ],
        "relative_error_estimate": float(np.max(result.error)),
        "air_density_kg_m3": result.specimen.air_density,
        "seconds": result.seconds,
        "warnings": list(result.warnings),
        "notes": list(result.specimen.notes),
    }
