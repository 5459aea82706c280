"""The JSON documents."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from cpam_bayes import __version__
from cpam_bayes.identification.angle_search import AngleSearchResult
from cpam_bayes.identification.point import Identification
from cpam_bayes.plate import Specimen, to_user, user_name

__all__ = ["identification_document", "json_text", "laminate_unit", "plate_keys"]

_ENGINEERING_GPA = ("Ex", "Ey", "Gxy")


def json_text(document: Mapping[str, Any]) -> str:
    """One JSON document; what is not a finite number becomes null."""
    return json.dumps(_plain(document), indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def plate_keys(command: str, specimen: Specimen, seed: int) -> dict[str, Any]:
    """The keys that every document about one plate begins with."""
    return {
        "command": command,
        "version": __version__,
        "plate": specimen.name,
        "specimen": specimen.specimen,
        "source": specimen.source,
        "seed": seed,
    }


def identification_document(
    result: Identification,
    seed: int,
    backend: str,
    residual: str,
    warnings: tuple[str, ...],
    found: AngleSearchResult | None = None,
) -> dict[str, Any]:
    """The JSON document of `identify` by the swarm; found : the angles, where some were unknown."""
    measurement = result.specimen.measurement
    assert measurement is not None
    return {
        **plate_keys("identify", result.specimen, seed),
        "backend": backend,
        "residuals": residual,
        "status": result.swarm.status,
        "message": result.swarm.message,
        "constants": {
            user_name(c.name): {
                "value": to_user(c.name, c.value),
                "sd": to_user(c.name, c.sd),
                "lower": to_user(c.name, c.lower),
                "upper": to_user(c.name, c.upper),
                "bound": c.bound,
                "verdict": c.verdict,
                "reference": to_user(c.name, c.reference),
            }
            for c in result.constants
        },
        **({} if found is None else {"angles_deg": found.angles_deg.tolist()}),
        "frequencies": [
            {
                "measured_hz": float(measured),
                "predicted_hz": mode.frequency,
                "residual_percent": 100.0 * (mode.frequency / float(measured) - 1.0),
                "kind": mode.kind,
                "label": mode.label,
            }
            for measured, mode in zip(measurement.frequencies, result.predicted, strict=True)
        ],
        "rms_percent": 100.0 * result.rms,
        "noise_percent": 100.0 * result.noise,
        "noise_source": "residuals" if result.noise_is_inferred else "plate file",
        "relative_error_estimate": float(np.max(result.error)),
        "laminate": laminate_keys(result.laminate),
        "air_density_kg_m3": result.specimen.air_density,
        "forward_solves": result.swarm.evaluations + (0 if found is None else found.swarm.evaluations),
        "iterations": result.swarm.iterations,
        "seconds": result.seconds + (0.0 if found is None else found.seconds),
        "warnings": list(warnings),
        "notes": list(result.specimen.notes),
    }


def laminate_keys(laminate: Mapping[str, float]) -> dict[str, dict[str, float]]:
    """D11 to D26 in N m, Ex, Ey, Gxy in GPa by name, nuxy."""
    units = {name: laminate_unit(name) for name in laminate}
    return {key: {"value": laminate[name] * factor} for name, (key, factor) in units.items()}


def laminate_unit(name: str) -> tuple[str, float]:
    """Key of a laminate constant in documents, with its unit, and the factor from SI."""
    return (f"{name}_GPa", 1e-9) if name in _ENGINEERING_GPA else (name, 1.0)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
