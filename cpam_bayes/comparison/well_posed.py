"""Hadamard's three conditions of a well-posed problem, made concrete for one plate and its frequencies."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from cpam_bayes.identification.identify import PointResult
from cpam_bayes.plate import user_name

__all__ = ["well_posed"]

# Singular values of the sensitivities below this fraction of the largest are zero.
_RANK: Final = 1e-6


def well_posed(point: PointResult) -> dict[str, Any]:
    """Existence, uniqueness and stability of the solution at the best optimum, as plain data.

    Existence: the misfit that is left, sqrt(sum r^2 / (n_f - n)), r the relative residuals. Uniqueness: the
    rank and the condition number of S = d ln f / d ln x, (n_f, n), and the optima that the misfit does not
    tell apart. Stability: sd of ln x for an independent relative noise of frequencies, over that noise:
    the roots of the diagonal of (S^T S)^-1, bounds left out; None where the rank is not full.
    """
    estimate = point.estimate
    measurement = estimate.specimen.measurement
    assert measurement is not None
    x = np.array([c.value for c in estimate.constants])
    prediction = estimate.model.full.predict(x[None], jacobian=True)
    assert prediction.jacobian is not None
    slope = (prediction.jacobian[0] / prediction.frequencies[0, :, None] * x)[: measurement.size]
    singular = np.linalg.svd(slope, compute_uv=False)
    rank = int(np.sum(singular > _RANK * singular[0]))
    amplified = np.full(len(x), np.nan)
    if rank == len(x):
        amplified = np.sqrt(np.diag(np.linalg.inv(slope.T @ slope)))
    freedom = measurement.size - len(x)
    left = math.sqrt(measurement.size / freedom) * estimate.rms if freedom > 0 else math.nan
    names = [user_name(c.name) for c in estimate.constants]
    return {
        "frequencies": measurement.size,
        "unknowns": len(x),
        "left_percent": 100.0 * left if math.isfinite(left) else None,
        "rank": rank,
        "condition": float(singular[0] / singular[-1]) if rank == len(x) else None,
        "optima": len(estimate.optima),
        "percent_per_percent": {
            name: float(a) if math.isfinite(a) else None for name, a in zip(names, amplified, strict=True)
        },
    }
