"""The JSON document of `diagnose`."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import Any

from cpam_bayes import __version__
from cpam_bayes.diagnosis.claim import Claim
from cpam_bayes.diagnosis.diagnose import Cause, Diagnosis
from cpam_bayes.diagnosis.evidence.tested import Tested, distinct_hypotheses, prior_of
from cpam_bayes.diagnosis.extension import Resampled
from cpam_bayes.diagnosis.fit import Fit
from cpam_bayes.diagnosis.hypotheses import NONE, OTHER
from cpam_bayes.diagnosis.next_test.next_measurement import Candidate
from cpam_bayes.diagnosis.paired_modes import FrequencyRow, PairedFit
from cpam_bayes.diagnosis.plates import DiagnosisResult
from cpam_bayes.effects.effect import tolerance_of
from cpam_bayes.parameters import LogUniform, Mixture, Parameter, Prior, ScaledStudentT, TruncatedNormal
from cpam_bayes.plate.units import to_user, user_name
from cpam_bayes.report.diagnosis.rows import (
    ConstantRow,
    DetectableRow,
    absorbed_biases,
    averaged_rows,
    constant_rows,
    detectable_rows,
    hidden_causes,
    noise_of,
    nuisance_of,
    plate_constants,
    sampled_rows,
    tested_causes,
)
from cpam_bayes.report.diagnosis.words import claim_sentence

# Keys of the answers with other scales of the priors.
_SCALES = ("scales_times_3", "scales_divided_by_3")


def document(result: DiagnosisResult) -> dict[str, Any]:
    """The JSON document of `diagnose`."""
    d, specimens = result.diagnosis, result.plates
    plates = [{"plate": s.name, "specimen": s.specimen, "source": s.source} for s in specimens]
    head = {"command": result.command, "version": __version__, "seed": result.seed}
    if len(plates) == 1:
        head |= plates[0]
    return {
        **head,
        "plates": plates,
        "claim": d.claim.kind,
        "causes": list(d.claim.causes),
        "probability": d.claim.probability,
        "sentence": claim_sentence(d),
        "claim_stands": d.sensitivity.claim_stands,
        "beside": dict(d.beside),
        "probability_beside": d.probability_beside,
        "claims_by_prior_scales": dict(zip(_SCALES, map(_claim, d.sensitivity.claims), strict=True)),
        "hypotheses": [_hypothesis(d, cause) for cause in d.causes],
        "baseline": _fit(d, d.baseline, d.weighed.plain, result.plain),
        "extended": _extended(result),
        "averaged": _constants(averaged_rows(d)),
        "optima": [
            {
                "probability": o.fraction,
                "constants": {
                    user_name(n): to_user(n, o.constants[n]) for n in d.averaged if n in o.constants
                },
                "modes": [list(labels) for labels in o.modes],
            }
            for o in d.optima
        ],
        "gain": _gain(d),
        "detectable": [_detectable(row) for row in detectable_rows(d)],
        "tested": {"hypotheses": len(d.weighed.tested), "causes": list(tested_causes(d))},
        "next_measurement": [_candidate(c) for c in result.candidates],
        "absorbed": [_absorbed(d, cause) for cause in hidden_causes(d)],
        "not_tested": list(d.weighed.not_tested),
        "priors": _priors(d),
        "material_scatter": result.scatter if len({s.specimen for s in specimens}) > 1 else None,
        "air_density_kg_m3": {s.name: s.air_density for s in specimens},
        "seconds": d.seconds,
        "warnings": list(result.warnings),
        "notes": [note for s in specimens for note in s.notes],
    }


def _claim(claim: Claim) -> dict[str, Any]:
    return {"claim": claim.kind, "causes": list(claim.causes), "probability": claim.probability}


def _hypothesis(d: Diagnosis, cause: Cause) -> dict[str, Any]:
    return {
        "cause": cause.name,
        "probability": cause.probability,
        "probability_range": {
            scales: probability[cause.name]
            for scales, probability in zip(_SCALES, d.sensitivity.probabilities, strict=True)
        },
        "log_bayes_factor": cause.log_bayes_factor,
        "log_evidence_error": cause.log_evidence_error,
        "k_hat": cause.k_hat,
        "parameters": {p.name: _size(p, cause) for p in cause.hypothesis.parameters},
        "indistinguishable_from": list(cause.indistinguishable_from),
        "max_shift_percent": 100.0 * cause.max_shift,
        "variant": cause.variant or None,
        "plates": list(cause.plates),
        "absorbed": cause.absorbed,
        "visible_share": cause.visible,
        "prior": prior_of([t for t in d.weighed.tested if t.hypothesis.cause == cause.name]),
    }


def _size(parameter: Parameter, cause: Cause) -> dict[str, Any]:
    mean, sd, _ = cause.parameters[parameter.name]
    shown, factor = parameter.display
    return {"mean": factor * mean, "sd": factor * sd, "unit": shown}


def _detectable(row: DetectableRow) -> dict[str, Any]:
    return {
        "cause": row.cause,
        "smallest": row.smallest,
        "unit": row.unit,
        "probability_of_claim": row.probability,
    }


def _candidate(c: Candidate) -> dict[str, Any]:
    return {
        "name": c.name,
        "description": c.description,
        "information_nats": c.information,
        "possible_nats": c.possible,
        "probability_decided": c.decided,
    }


def _extended(result: DiagnosisResult) -> dict[str, Any] | None:
    d, resampled = result.diagnosis, result.resampled
    if d.extended is None or result.extended is None:
        return None
    return {
        **_fit(d, d.extended, d.members, result.extended),
        "emcee": None if resampled is None else _emcee(d, resampled),
        "members": [
            {
                "cause": t.hypothesis.cause,
                "variant": t.hypothesis.variant or None,
                "plates": [d.cases[i].name for i in t.plates],
                "share": weight,
            }
            for t, weight in d.members
        ],
    }


def _emcee(d: Diagnosis, resampled: Resampled) -> dict[str, Any]:
    return {
        "constants": _constants(sampled_rows(d, resampled)),
        "diagnostics": {
            "r_hat": max(m.diagnostics.r_hat for m in resampled.members),
            "ess_bulk": min(m.diagnostics.ess_bulk for m in resampled.members),
            "autocorrelation_time": max(m.diagnostics.autocorrelation_time for m in resampled.members),
            "converged": resampled.converged,
        },
        "share_not_sampled": resampled.not_sampled,
        "forward_solves": resampled.solves,
    }


def _fit(
    d: Diagnosis, fit: Fit, members: Sequence[tuple[Tested, float]], paired: PairedFit
) -> dict[str, Any]:
    """One fit; the plates one by one too where there are several."""
    rows = paired.frequencies
    noise = noise_of(members)
    keys: dict[str, Any] = {
        "constants": _constants(constant_rows(d, fit)),
        "frequencies": [_frequency(row) for row in rows],
        "rms_percent": 100.0 * fit.rms,
        "log_evidence": fit.log_evidence,
        "log_evidence_error": fit.log_evidence_error,
        "k_hat": fit.k_hat,
        "posterior_predictive_p_value": fit.p_value,
        "predictive_p": fit.predictive_p,
        "noise_percent": None if noise is None else {"mean": 100.0 * noise[0], "sd": 100.0 * noise[1]},
        "nuisance": {name: {"mean": mean, "sd": sd} for name, (mean, sd) in nuisance_of(d, fit).items()},
        "missed_modes": [
            {
                "plate": m.plate,
                "predicted_hz": m.mode.frequency,
                "kind": m.mode.kind,
                "label": m.mode.label,
            }
            for m in paired.missed
        ],
    }
    if len(d.cases) > 1:
        keys["plates"] = [_plate(d, fit, i, rows) for i in range(len(d.cases))]
    return keys


def _plate(d: Diagnosis, fit: Fit, i: int, rows: Sequence[FrequencyRow]) -> dict[str, Any]:
    """One plate of several; the evidence is that of all lists, which share the constants."""
    name = d.cases[i].name
    plate_rows = [row for row in rows if row.plate == name]
    squares = [row.residual_percent**2 for row in plate_rows if row.residual_percent is not None]
    return {
        "plate": name,
        "constants": _constants(plate_constants(d, fit, i)),
        "frequencies": [_frequency(row) for row in plate_rows],
        "rms_percent": (sum(squares) / len(squares)) ** 0.5 if squares else 0.0,
        "log_evidence": fit.log_evidence,
        "log_evidence_of": "all plates together",
    }


def _constants(rows: Sequence[ConstantRow]) -> dict[str, Any]:
    return {
        row.name: {
            "mean": row.mean,
            "sd": row.sd,
            "q025": row.q025,
            "q975": row.q975,
            "prior_contraction": row.contraction,
            "reference": row.reference,
        }
        for row in rows
    }


def _frequency(row: FrequencyRow) -> dict[str, Any]:
    paired = row.predicted is not None
    return {
        "plate": row.plate,
        "measured_hz": row.measured,
        "predicted_hz": row.predicted,
        "predicted_sd_hz": row.predicted_sd if paired else None,
        "noise_sd_hz": row.sigma if paired else None,
        "residual_percent": row.residual_percent,
        "standardised": row.standardised if paired else None,
        "kind": None if row.mode is None else row.mode.kind,
        "label": None if row.mode is None else row.mode.label,
    }


def _gain(d: Diagnosis) -> dict[str, Any] | None:
    gain = d.gain
    if gain is None:
        return None
    return {
        "rms_percent_before": 100.0 * gain.rms_before,
        "rms_percent_after": 100.0 * gain.rms_after,
        "log_bayes_factor": gain.log_bayes_factor,
        "held_out_log_score_difference": gain.held_out_difference,
        "held_out_log_score_se": gain.held_out_se,
        "held_out_log_score_by_frequency": gain.held_out.tolist(),
        "held_out_hypotheses": gain.n_hypotheses,
        "stable_share": gain.stable,
    }


def _absorbed(d: Diagnosis, cause: Cause) -> dict[str, Any]:
    size, unit, per_unit = absorbed_biases(d, cause)
    return {
        "cause": cause.name,
        "visible_share": cause.visible,
        "absorbed": cause.absorbed,
        "unit": unit,
        "bias_percent_per_unit": per_unit,
        "bias_percent": {name: size * value for name, value in per_unit.items()},
        "at": size,
    }


def _priors(d: Diagnosis) -> dict[str, Any]:
    """Prior probabilities of families and causes, and the priors of the effects' sizes."""
    families: dict[str, dict[str, float]] = defaultdict(lambda: defaultdict(float))
    effects: dict[str, dict[str, Any]] = {}
    pairs = 0.0
    for h in distinct_hypotheses(d.weighed.tested):
        if h.family == "pair":
            pairs += h.prior
            continue
        if h.cause not in (NONE, OTHER):
            families[h.family][h.cause] += h.prior
        for p in h.parameters:
            wide = f"{h.cause} gross" if h.is_gross else h.cause
            effects.setdefault(wide, {})[p.name] = _effect_prior(p)
    return {
        "none": d.weighed.none.hypothesis.prior,
        "other": prior_of([t for t in d.weighed.tested if t.hypothesis.cause == OTHER]),
        "pairs_tested": pairs,
        "families": {name: dict(causes) for name, causes in families.items()},
        "effects": effects,
    }


def _effect_prior(p: Parameter) -> dict[str, Any]:
    """The prior of a size: of its tolerance, and of the gross error that it may be."""
    unit, factor = p.display
    gross = None
    if isinstance(p.prior, Mixture):
        gross = {"fraction": p.prior.fraction, **_density(p.prior.wide, factor)}
    return {
        "mean": factor * p.prior.mean,
        **_density(tolerance_of(p.prior), factor),
        "gross": gross,
        "lower": factor * p.prior.lower,
        "upper": factor * p.prior.upper,
        "unit": unit,
    }


def _density(prior: Prior, factor: float) -> dict[str, Any]:
    kinds: dict[type, str] = {
        ScaledStudentT: "Student-t",
        TruncatedNormal: "truncated normal",
        LogUniform: "log-uniform",
    }
    scale = prior.scale if isinstance(prior, ScaledStudentT) else prior.sd
    return {"kind": kinds.get(type(prior), "uniform"), "scale": factor * scale}
