"""The JSON document of `sequence`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.inference.posterior import NOISE
from cpam_bayes.plate import to_user, user_name
from cpam_bayes.report.documents import plate_keys
from cpam_bayes.stacking.mixture import StackingMixture
from cpam_bayes.stacking.queries.best_fit import BestFit
from cpam_bayes.stacking.queries.given_layup import GivenLayup
from cpam_bayes.stacking.records import StackingPosterior
from cpam_bayes.stacking.sequence import StackingResult


def document(result: StackingResult) -> dict[str, Any]:
    """The JSON document of `sequence`."""
    answer, mixture, given = result.answer, result.mixture, result.given
    check, fit, information = answer.check, result.fit, result.information
    return {
        **plate_keys(result),
        "enumerated": answer.enumerated,
        "classes": answer.classes,
        "symmetries": [s.name for s in answer.symmetries],
        "angle_grid_deg": answer.grid_deg.tolist(),
        "log_evidence": answer.log_evidence_total,
        "sequences": [_sequence(answer, mixture, i) for i in range(min(result.top, len(answer.top)))],
        "credible_95_count": answer.credible_count,
        "effective_count": answer.effective_count,
        "unaccounted_probability": answer.unaccounted,
        "angle_marginals": answer.marginals.tolist(),
        "angle_entropy_bits": np.abs(information.entropy_bits).tolist(),
        "angle_entropy_most_bits": information.most_bits,
        "outer_plies_better_determined": information.outer_better,
        "constants": _constants(answer, mixture),
        "mixture": {
            "draws": len(mixture.parameters),
            "sampled_by_emcee": len(mixture.components),
            "probability_by_emcee": mixture.emcee_fraction,
            "probability_by_importance_sampling": mixture.listed_fraction,
            "probability_by_drawn_sequences": mixture.drawn_fraction,
            "converged": mixture.converged,
            "worst_difference_in_standard_errors": max((c.worst_z for c in mixture.sampled), default=None),
            "seconds": mixture.seconds,
        },
        "frequencies": _frequencies(answer, fit),
        "missed_modes": [{"predicted_hz": float(f)} for f in fit.missed],
        "p_value": fit.p_value,
        "noise_percent": 100.0 * fit.noise,
        "noise_inferred": answer.conditional.template.noise_is_inferred,
        "printed_sequence": None if given is None else _given(answer, mixture, given),
        "learned": None
        if check is None
        else {
            "from_sequences": check.training_size,
            "rms_error_nats": check.rms,
            "largest_error_nats": check.largest,
            "overlooked_nats": check.overlooked,
            "correction_nats": check.correction,
            "effective_share": check.effective,
        },
        "seconds": answer.seconds,
        "warnings": list(result.warnings),
        "notes": list(result.specimen.notes),
    }


def _sequence(result: StackingPosterior, mixture: StackingMixture, i: int) -> dict[str, Any]:
    if i < len(mixture.components):
        mean, sd, by = mixture.components[i].chains.mean, mixture.components[i].chains.sd, "emcee"
    else:
        conditionals = result.components.conditionals
        mean, sd, by = conditionals.mean[i], conditionals.sd[i], "importance sampling"
    return {
        "angles_deg": result.top[i].tolist(),
        "probability": float(result.probability[i]),
        "equivalent": int(result.multiplicity[i]),
        "same_bending_deg": result.grid_deg[result.same_bending[i]].tolist(),
        "log_evidence": float(result.log_evidence[i]),
        "log_evidence_error": float(result.log_evidence_error[i]),
        "k_hat": float(result.components.conditionals.k_hat[i]),
        "constants": _by_name(result, mean),
        "constants_sd": _by_name(result, sd),
        "sampled_by": by,
    }


def _by_name(result: StackingPosterior, values: NDArray[Any]) -> dict[str, float]:
    return {
        user_name(name): to_user(name, float(v))
        for name, v in zip(result.conditional.parameters.names, values, strict=True)
        if name != NOISE
    }


def _given(result: StackingPosterior, mixture: StackingMixture, given: GivenLayup) -> dict[str, Any]:
    component = mixture.given
    return {
        "angles_deg": given.angles_deg.tolist(),
        "probability": given.probability,
        "rank": given.rank,
        "log_evidence": given.log_evidence,
        "log_evidence_error": given.log_evidence_error,
        "k_hat": given.k_hat,
        "constants": None if component is None else _by_name(result, component.chains.mean),
        "constants_sd": None if component is None else _by_name(result, component.chains.sd),
    }


def _constants(result: StackingPosterior, mixture: StackingMixture) -> dict[str, dict[str, float]]:
    """Mean, sd and quantiles of the constants over the mixture's draws."""
    constants = {}
    for i, name in enumerate(result.conditional.parameters.names):
        if name == NOISE:
            continue
        x = mixture.parameters[:, i] * to_user(name, 1.0)
        q025, q975 = np.quantile(x, (0.025, 0.975))
        constants[user_name(name)] = {
            "mean": float(x.mean()),
            "sd": float(x.std()),
            "q025": float(q025),
            "q975": float(q975),
        }
    return constants


def _frequencies(result: StackingPosterior, fit: BestFit) -> list[dict[str, float | None]]:
    measured = result.conditional.template.measurement.frequencies
    return [
        {
            "measured_hz": float(f),
            "predicted_hz": None if np.isnan(p) else float(p),
            "residual_percent": None if np.isnan(p) else 100.0 * float(r),
        }
        for f, p, r in zip(measured, fit.predicted, fit.residual, strict=True)
    ]
