"""The JSON document of `identify --backend emcee`."""

from __future__ import annotations

from typing import Any

import numpy as np

from cpam_bayes.identification.frequency_rows import SampledFrequency
from cpam_bayes.identification.sampled import ConstantPosterior, SampledResult
from cpam_bayes.inference.noise import NOISE_NAMES
from cpam_bayes.plate import to_user, user_name
from cpam_bayes.priors import Prior, TruncatedNormal, Uniform
from cpam_bayes.report.documents import laminate_unit, plate_keys
from cpam_bayes.report.modal_assurance.rows import shape_keys


def document(result: SampledResult) -> dict[str, Any]:
    """The JSON document of `identify` by sampling."""
    noise = [c for c in result.constants if c.name in NOISE_NAMES]
    return {
        **plate_keys(result),
        "backend": "emcee",
        "status": result.result.status,
        "constants": {user_name(c.name): _marginal(result, c) for c in result.elastic_constants},
        "nuisance": {user_name(c.name): _marginal(result, c) for c in result.sizes},
        "noise": {"name": user_name(noise[0].name), **_quantiles(noise[0], 1.0)} if noise else None,
        "degrees_of_freedom": result.posterior.degrees_of_freedom,
        "frequencies": [
            _frequency(float(f), row)
            for f, row in zip(result.posterior.measurement.frequencies, result.frequencies, strict=True)
        ],
        "missed_modes": [
            {"predicted_hz": m.predicted, "kind": m.mode.kind, "label": m.mode.label} for m in result.missed
        ],
        **shape_keys(result.by_shape, result.posterior.measurement),
        "posterior_predictive_p_value": result.p_value,
        "leave_one_out": _leave_one_out(result),
        "log_evidence": result.evidence.log_evidence,
        "evidence": {
            "standard_error": result.evidence.standard_error,
            "effective_size": result.evidence.effective_size,
            "k_hat": result.evidence.k_hat,
            "status": result.evidence.status,
        },
        "identifiability": {"combinations": _combinations(result), "profiles": _profiles(result)},
        "power_scaling": {
            user_name(s.name): {
                "prior": s.prior,
                "noise_prior": s.noise_prior,
                "likelihood": s.likelihood,
                "diagnosis": s.diagnosis,
            }
            for s in result.assessment.power_scaling
        },
        "bounds_moved": _bounds_moved(result),
        "relative_error_estimate": float(np.max(result.error)),
        "laminate": {
            laminate_unit(name)[0]: {
                "value": mean * laminate_unit(name)[1],
                "sd": sd * laminate_unit(name)[1],
            }
            for name, (mean, sd) in result.laminate.items()
        },
        "diagnostics": _diagnostics(result),
        "air_density_kg_m3": result.specimen.air_density,
        "forward_solves": result.forward_solves,
        "seconds": result.seconds,
        "warnings": list(result.warnings),
        "notes": list(result.specimen.notes),
    }


def _quantiles(c: ConstantPosterior, factor: float) -> dict[str, float]:
    return {key: factor * float(getattr(c, key)) for key in ("mean", "sd", "q025", "median", "q975")}


def _marginal(result: SampledResult, c: ConstantPosterior) -> dict[str, Any]:
    prior = result.posterior.parameters[c.name].prior
    return {
        **_quantiles(c, to_user(c.name, 1.0)),
        "prior": {
            "kind": _kind(prior),
            "mean": to_user(c.name, prior.mean),
            "sd": to_user(c.name, prior.sd),
        },
        "prior_contraction": c.contraction,
        "share_at_lower_bound": c.at_lower,
        "share_at_upper_bound": c.at_upper,
        "bound": c.bound,
        "lower": to_user(c.name, c.lower),
        "upper": to_user(c.name, c.upper),
        "verdict": c.verdict,
        "reference": to_user(c.name, c.reference),
    }


def _kind(prior: Prior) -> str:
    if isinstance(prior, Uniform):
        return "uniform"
    return "truncated normal" if isinstance(prior, TruncatedNormal) else "truncated Student-t"


def _frequency(measured: float, row: SampledFrequency | None) -> dict[str, Any]:
    if row is None:
        keys = ("predicted_hz", "predicted_sd_hz", "residual_percent", "kind", "label", "left_out")
        return {"measured_hz": measured, **dict.fromkeys(keys)}
    return {
        "measured_hz": measured,
        "predicted_hz": row.predicted,
        "predicted_sd_hz": row.predicted_sd,
        "residual_percent": 100.0 * row.residual,
        "kind": row.mode.kind,
        "label": row.mode.label,
        "left_out": {
            "residual_percent": 100.0 * row.left_out.residual,
            "sd_percent": 100.0 * row.left_out.sd,
            "leverage": row.left_out.leverage,
        },
    }


def _leave_one_out(result: SampledResult) -> dict[str, Any]:
    importance = result.assessment.importance
    psis = None
    if importance is not None:
        psis = {
            "reliable": importance.reliable,
            "k_hat": importance.k_hat.tolist(),
            "log_score": importance.log_score if importance.reliable else None,
            "standard_error": importance.standard_error if importance.reliable else None,
        }
    left_out = result.assessment.left_out
    return {"log_score": left_out.log_score, "basis": left_out.basis, "psis": psis}


def _combinations(result: SampledResult) -> list[dict[str, Any]]:
    names = [user_name(name) for name in result.posterior.model.parameters.names]
    return [
        {
            "exponents": dict(zip(names, c.exponents.tolist(), strict=True)),
            "singular_value": c.singular_value,
            "sd_percent_by_data": 100.0 * c.noise_sd,
            "sd_percent_by_prior": 100.0 * c.prior_sd,
            "contraction": c.contraction,
        }
        for c in result.assessment.combinations
    ]


def _profiles(result: SampledResult) -> dict[str, Any]:
    profiles = {}
    for p in result.assessment.profiles:
        profiles[user_name(p.name)] = {
            "values": [to_user(p.name, float(v)) for v in p.values],
            "drop": p.drop.tolist(),
            "best": to_user(p.name, p.best),
            "lower_95": to_user(p.name, p.lower),
            "upper_95": to_user(p.name, p.upper),
            "lower_open": p.lower_open,
            "upper_open": p.upper_open,
            "parts": p.parts,
        }
    return profiles


def _bounds_moved(result: SampledResult) -> list[dict[str, Any]]:
    names = [user_name(name) for name in result.posterior.parameters.names]
    return [
        {
            "constant": user_name(m.name),
            "bound": m.bound,
            "share_cut": m.cut,
            "shift_in_sd": dict(zip(names, m.shift.tolist(), strict=True)),
        }
        for m in result.assessment.moved_bounds
    ]


def _diagnostics(result: SampledResult) -> dict[str, Any]:
    d = result.result.diagnostics
    return {
        "r_hat": d.r_hat,
        "ess_bulk": d.ess_bulk,
        "autocorrelation_time": d.autocorrelation_time,
        "converged": d.converged,
        "steps": d.steps,
        "burn_in": d.burn_in,
        "ess_per_second": result.ess_per_second,
        "ess_per_second_in_all": d.ess_bulk / result.seconds,
        "seconds_sampling": result.seconds_sampling,
    }
