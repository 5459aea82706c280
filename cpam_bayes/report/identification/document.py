"""The JSON document of `identify` by the swarm."""

from __future__ import annotations

from typing import Any

import numpy as np

from cpam_bayes.identification.identify import PointResult
from cpam_bayes.identification.point import ConstantEstimate
from cpam_bayes.plate import to_user, user_name
from cpam_bayes.report.documents import laminate_keys, plate_keys
from cpam_bayes.report.modal_assurance.rows import shape_keys


def document(result: PointResult) -> dict[str, Any]:
    """The JSON document of `identify` by the swarm."""
    estimate, angles = result.estimate, result.angles
    return {
        **plate_keys(result),
        "backend": "pso",
        "residuals": result.residual,
        "status": result.status,
        "message": result.message,
        "constants": {
            user_name(c.name): {
                "value": to_user(c.name, c.value),
                "sd": to_user(c.name, c.sd),
                "lower": to_user(c.name, c.lower),
                "upper": to_user(c.name, c.upper),
                **dict(zip(("q025", "q975"), _interval(c), strict=True)),
                "bound": c.bound,
                "verdict": c.verdict,
                "reference": to_user(c.name, c.reference),
            }
            for c in estimate.constants
        },
        **({} if angles is None else {"angles_deg": angles.angles_deg.tolist()}),
        "frequencies": [
            {
                "measured_hz": row.measured,
                "predicted_hz": row.predicted,
                "residual_percent": 100.0 * row.residual,
                "kind": row.kind,
                "label": row.label,
            }
            for row in result.frequencies
        ],
        "optima": [
            {
                "constants": {user_name(name): to_user(name, v) for name, v in values.items()},
                "objective": optimum.value,
                "rms_percent": 100.0 * rms,
                "found_by": optimum.swarms,
            }
            for (optimum, values), rms in zip(result.optima, result.rms_of_optima(), strict=True)
        ],
        **shape_keys(estimate.by_shape, result.specimen.measurement),
        "rms_percent": 100.0 * estimate.rms,
        "noise_percent": 100.0 * estimate.noise,
        "noise_source": "residuals" if estimate.noise_is_inferred else "plate file",
        "relative_error_estimate": float(np.max(estimate.error)),
        "laminate": laminate_keys(estimate.laminate),
        "air_density_kg_m3": result.specimen.air_density,
        "forward_solves": estimate.swarm.evaluations + (0 if angles is None else angles.swarm.evaluations),
        "swarms": estimate.swarms,
        "iterations": estimate.swarm.iterations,
        "seconds": estimate.seconds + (0.0 if angles is None else angles.seconds),
        "warnings": list(result.warnings),
        "notes": list(result.specimen.notes),
    }


def _interval(constant: ConstantEstimate) -> tuple[float | None, float | None]:
    """The 95 % interval in the units of the plate file, as the screen shows it."""
    if constant.interval is None:
        return None, None
    low, high = (to_user(constant.name, v) for v in constant.interval)
    return low, high
