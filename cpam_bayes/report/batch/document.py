"""The JSON document of `batch`."""

from __future__ import annotations

from typing import Any

from cpam_bayes import __version__
from cpam_bayes.batches.batch import BatchResult
from cpam_bayes.batches.plate_row import PlateRow, RowConstant
from cpam_bayes.plate import to_user, user_name


def document(result: BatchResult) -> dict[str, Any]:
    """The JSON document of `batch`."""
    return {
        "command": result.command,
        "version": __version__,
        "seed": result.seed,
        "plates": len(result.rows),
        "failed": len(result.failed),
        "models": result.models,
        "from_store": result.from_store,
        "limits": [limit.text for limit in result.limits],
        "rows": [_row(result, row) for row in result.rows],
        "control_chart": {user_name(name): _chart(result, name) for name in result.constants},
        "population": _population(result),
        "seconds": result.seconds,
        "warnings": list(result.warnings),
    }


def _row(result: BatchResult, row: PlateRow) -> dict[str, Any]:
    done = row.status == "done"
    found = row.diagnosis
    return {
        "file": row.file,
        "name": row.name,
        "status": row.status,
        "message": row.message,
        "constants": {user_name(c.name): _constant(c) for c in row.constants},
        "limits": {limit.text: result.probability(row, limit) for limit in result.limits} if done else {},
        "rms_percent": 100.0 * row.rms,
        "noise_percent": 100.0 * row.noise,
        "search": row.search or None,
        "diagnosis": None
        if found is None
        else {
            "claim": found.claim,
            "causes": list(found.causes),
            "probability": found.probability,
            "probability_none": found.probability_none,
            "probability_beside": found.probability_beside,
        },
    }


def _constant(c: RowConstant) -> dict[str, Any]:
    unit = to_user(c.name, 1.0)
    return {
        "value": unit * c.value,
        "sd": unit * c.sd,
        "q025": unit * c.low,
        "q975": unit * c.high,
        "verdict": c.verdict,
        "laplace": {"centre": unit * c.posterior.centre, "sd": unit * c.posterior.sd},
    }


def _population(result: BatchResult) -> dict[str, Any] | None:
    found = result.population
    if found is None:
        return None
    d = found.diagnostics
    return {
        "plates": found.plates,
        "status": found.status,
        "constants": {
            user_name(c.name): {
                "mean": _quantiles(c.mean, to_user(c.name, 1.0)),
                "scatter_percent": _quantiles(c.scatter, 100.0),
                "next_plate": _quantiles(c.next_plate, to_user(c.name, 1.0)),
            }
            for c in found.constants
        },
        "diagnostics": {
            "r_hat": d.r_hat,
            "ess_bulk": d.ess_bulk,
            "autocorrelation_time": d.autocorrelation_time,
            "converged": d.converged,
            "steps": d.steps,
        },
    }


def _quantiles(values: tuple[float, float, float, float], factor: float) -> dict[str, float]:
    return dict(zip(("mean", "sd", "q025", "q975"), (factor * v for v in values), strict=True))


def _chart(result: BatchResult, name: str) -> dict[str, Any] | None:
    chart = result.chart(name)
    if chart is None:
        return None
    low, high = chart.limits
    return {
        "median": to_user(name, chart.median),
        "sigma": to_user(name, chart.sigma),
        "lower": to_user(name, low),
        "upper": to_user(name, high),
        "outside": [row.name for row in result.outside(name)],
    }
