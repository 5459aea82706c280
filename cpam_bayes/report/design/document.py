"""The JSON document of `design`."""

from __future__ import annotations

from typing import Any

from cpam_bayes.plate import to_user, user_name
from cpam_bayes.report.documents import plate_keys
from cpam_bayes.specimen_design.design import Candidate, DesignResult


def document(result: DesignResult) -> dict[str, Any]:
    """The JSON document of `design`."""
    return {
        **plate_keys(result),
        "constants": [user_name(name) for name in result.asked],
        "prior_sd": _by_name(result, result.prior_sd),
        "relative_std": result.test.relative_std,
        "relative_std_is_usual": result.noise_is_usual,
        "relative_std_needed": result.needed_std,
        "resolution_hz": result.test.resolution,
        "candidates": [_candidate(result, candidate) for candidate in result.candidates],
        "failed": [
            {"layup": g.layup.text, "edges": g.edges, "ratio": g.ratio, "message": said}
            for g, said in result.failed
        ],
        "seconds": result.seconds,
        "warnings": list(result.warnings),
        "notes": list(result.specimen.notes),
    }


def _candidate(result: DesignResult, candidate: Candidate) -> dict[str, Any]:
    g = candidate.geometry
    verdicts = result.verdicts(candidate)
    return {
        "description": candidate.description,
        "information_nats": candidate.information,
        "sd": _by_name(result, candidate.expected.sd),
        "information_by_constant": {
            user_name(name): float(nats)
            for name, nats in zip(result.constants, candidate.expected.each, strict=True)
        },
        "verdict": {user_name(name): verdict for name, verdict in verdicts.items()},
        "length_mm": to_user("length", g.length),
        "width_mm": to_user("width", g.width),
        "thickness_mm": to_user("thickness", g.thickness),
        "layup": None if result.specimen.material.isotropic else g.layup.text,
        "edges": g.edges,
        "modes": candidate.n_modes,
        "is_present": candidate.is_present,
    }


def _by_name(result: DesignResult, values: Any) -> dict[str, float]:
    return {
        user_name(name): to_user(name, float(value))
        for name, value in zip(result.constants, values, strict=True)
    }
