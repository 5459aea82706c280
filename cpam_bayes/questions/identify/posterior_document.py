"""The JSON document of a sampled posterior: constants, frequencies, what determines them, and the chains."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from cpam_bayes.answer import Constant, FrequencyRow
from cpam_bayes.plate import to_user, user_name
from cpam_bayes.questions.identify.emcee import Marginal, SampledResult
from cpam_bayes.questions.identify.slips import slip_records
from cpam_bayes.render.plate import shape_keys
from cpam_bayes.render.report import Rows, laminate_unit, plate_keys


class LeftOut(NamedTuple):
    """Leave-one-out prediction of one frequency, from all the others.

    residual : predicted / measured - 1. sd : of prediction and noise together, relative. leverage : fraction
    of the frequency in its own prediction. standardised : residual in standard deviations.
    """

    residual: float
    sd: float
    leverage: float
    standardised: float


class ListedMode(NamedTuple):
    """A measured frequency, or a mode missing from the list, with its leave-one-out prediction."""

    row: FrequencyRow
    left_out: LeftOut | None


def sampled_document(result: SampledResult, modes: Rows) -> dict[str, Any]:
    """The JSON document of `identify --backend emcee`."""
    noise = result.noise
    return {
        **plate_keys(result.command, result.seed, result.specimen),
        "backend": "emcee",
        "status": result.result.status,
        "constants": _marginals(result, result.constants),
        "nuisance": _marginals(result, result.sizes),
        "noise": None if noise is None else {"name": user_name(noise[0]), **_quantiles(noise[1], 1.0)},
        "degrees_of_freedom": result.posterior.degrees_of_freedom,
        "frequencies": [
            {**keys, "left_out": _left_out_keys(m)}
            for m, keys in zip(modes.rows, modes.records(), strict=True)
            if m.row.measured is not None
        ],
        "missed_modes": [
            {"predicted_hz": m.predicted, "kind": m.kind, "label": m.label} for m in result.missed
        ],
        **shape_keys(result.by_shape, result.posterior.measurement),
        "posterior_predictive_p_value": result.p_value,
        "leave_one_out": _leave_one_out(result),
        "log_evidence": result.evidence.log_evidence,
        "evidence": _fields(
            result.evidence, "standard_error", "effective_size", "k_hat", "status", "exact_fraction"
        ),
        "identifiability": {"combinations": _combinations(result), "profiles": _profiles(result)},
        "power_scaling": {
            user_name(s.name): _fields(s, "prior", "noise_prior", "likelihood", "diagnosis")
            for s in result.assessment.power_scaling
        },
        "bounds_moved": _bounds_moved(result),
        "explained_by": slip_records(result.explained_by),
        "relative_error_estimate": float(np.max(result.error)),
        "laminate": {
            key: {"value": mean * factor, "sd": sd * factor}
            for name, (mean, sd) in result.laminate.items()
            for key, factor in (laminate_unit(name),)
        },
        "diagnostics": _diagnostics(result),
        "air_density_kg_m3": result.specimen.air_density,
        "forward_solves": result.forward_solves,
        "seconds": result.seconds,
        "warnings": list(result.warnings),
        "notes": list(result.specimen.notes),
    }


def _fields(record: Any, *names: str) -> dict[str, Any]:
    """Fields of a record that keep their names in the document."""
    return {name: getattr(record, name) for name in names}


def _quantiles(m: Marginal, factor: float) -> dict[str, float]:
    return {key: factor * float(getattr(m, key)) for key in ("mean", "sd", "q025", "median", "q975")}


def _marginals(result: SampledResult, constants: Mapping[str, Constant]) -> dict[str, Any]:
    return {user_name(name): _marginal(c, result.marginals[name]) for name, c in constants.items()}


def _marginal(c: Constant, m: Marginal) -> dict[str, Any]:
    prior = c.prior.describe(partial(to_user, c.name))
    return {
        **_quantiles(m, to_user(c.name, 1.0)),
        "prior": {"kind": prior.kind, "mean": prior.mean, "sd": prior.sd},
        "prior_contraction": m.contraction,
        "share_at_lower_bound": m.at_lower,
        "share_at_upper_bound": m.at_upper,
        "bound": c.bound,
        "lower": prior.lower,
        "upper": prior.upper,
        "verdict": c.verdict.value,
        "reference": to_user(c.name, c.reference),
    }


def _left_out_keys(m: ListedMode) -> dict[str, float] | None:
    if m.left_out is None:
        return None
    return {
        "residual_percent": 100.0 * m.left_out.residual,
        "sd_percent": 100.0 * m.left_out.sd,
        "leverage": m.left_out.leverage,
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
    return {
        user_name(p.name): {
            "values": [to_user(p.name, float(v)) for v in p.values],
            "drop": p.drop.tolist(),
            "best": to_user(p.name, p.best),
            "lower_95": to_user(p.name, p.lower),
            "upper_95": to_user(p.name, p.upper),
            **_fields(p, "lower_open", "upper_open", "parts"),
        }
        for p in result.assessment.profiles
    }


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
        **_fields(d, "r_hat", "ess_bulk", "autocorrelation_time", "converged", "steps", "burn_in"),
        "seconds_sampling": result.seconds_sampling,
    }
