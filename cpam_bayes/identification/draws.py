"""The draws of a sampled posterior, for arviz."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.identification.sampled import SampledResult
from cpam_bayes.inference.chains.arviz_data import arviz_data, by_user_name
from cpam_bayes.inference.diagnostics.assessment import log_likelihoods, thinned
from cpam_bayes.inference.diagnostics.identifiability import paired
from cpam_bayes.plate import to_user, user_name

__all__ = ["inference_data"]

Array = NDArray[Any]

_PRIOR_DRAWS = 1000


def inference_data(result: SampledResult) -> Any:
    """The posterior as ``arviz.InferenceData``, thinned by the autocorrelation time.

    Chains are the ensembles, whose walkers are no chains of their own. Constants carry the names and units of
    the plate file; the densities lp and log_prior are those over SI units. Groups: posterior; prior, draws of
    it; sample_stats (lp); log_likelihood, by frequency over `mode`, as one number for a list that may lack
    modes; log_prior, by parameter; posterior_predictive, prior_predictive and observed_data over `mode`, of
    the frequencies that have one; constant_data, the plate's sizes and density. Attributes: command,
    versions, plate, specimen, layup, edges, seed, hash of the problem, the likelihood; of the material its
    symmetry and the constants that did not vary (JSON, as in the plate file); the repeatability where it was
    given.
    """
    posterior, chains = result.posterior, thinned(result.result)
    names = posterior.parameters.names
    flat, shape = chains.flat, chains.draws.shape[:2]
    predicted = posterior.predict(flat)
    total, pointwise = log_likelihoods(posterior, flat, predicted, result.pairing)
    rows, columns = paired(result.pairing)
    rng = np.random.default_rng([result.seed, 2])

    def replicated(x: Array, f: Array) -> Array:
        noise = posterior.noise_model.sample(rng, (len(x), len(rows)))
        return np.asarray(f[:, columns] + posterior.noise(x, f)[:, rows, columns] * noise)

    replicate = replicated(flat, predicted)
    prior = posterior.parameters.sample(rng, _PRIOR_DRAWS)
    prior = prior[np.isfinite(posterior.log_prior(prior))]
    before = replicated(prior, posterior.predict(prior))
    measurement, plate = posterior.measurement, result.specimen.plate
    given = "frequency_sd_hz" if measurement.frequency_sd is not None else "relative_std"
    return arviz_data(
        result.command,
        result.specimen,
        result.seed,
        posterior,
        {
            "noise": f"{posterior.noise_name}, inferred"
            if posterior.noise_is_inferred
            else f"{given}, given",
            "noise_degrees_of_freedom": posterior.degrees_of_freedom,
            "resolution_hz": measurement.resolution,
            "specimen": result.specimen.specimen,
            "symmetry": result.specimen.material.symmetry,
            "held_constants": _held(result),
            **_repeatability(result),
            "layup": plate.layup.text,
            "edges": plate.edges,
            "list_is_complete": int(measurement.complete),
            "thinned_by": chains.step,
            "r_hat": result.result.diagnostics.r_hat,
            "log_evidence": result.evidence.log_evidence,
        },
        {
            user_name(p.name): p.prior.log_density(chains.draws[..., i])
            for i, p in enumerate(posterior.parameters.parameters)
        },
        posterior=by_user_name(names, chains.draws),
        prior=by_user_name(names, prior[None]),
        sample_stats={"lp": chains.log_prob},
        log_likelihood={"list": total.reshape(shape)}
        if pointwise is None
        else {"frequencies_hz": pointwise.reshape(*shape, -1)},
        posterior_predictive={"frequencies_hz": replicate.reshape(*shape, -1)},
        prior_predictive={"frequencies_hz": before[None]},
        constant_data={
            "length_mm": to_user("length", plate.length),
            "width_mm": to_user("width", plate.width),
            "thickness_mm": to_user("thickness", plate.thickness),
            "density_kg_m3": plate.density,
        },
        observed_data={"frequencies_hz": measurement.frequencies[rows]},
        dims={"frequencies_hz": ["mode"]},
        coords={"mode": [f"{j + 1} {result.modes[j].label}".strip() for j in columns]},
    )


def _held(result: SampledResult) -> str:
    """The constants of [material] that did not vary, by their names in the plate file."""
    constants, unknowns = result.specimen.material.constants, result.specimen.unknowns
    held = {user_name(n): to_user(n, v) for n, v in constants.items() if n not in unknowns}
    return json.dumps(held, sort_keys=True)


def _repeatability(result: SampledResult) -> dict[str, float]:
    """The relative standard deviation of a measured frequency where it was given."""
    measurement = result.posterior.measurement
    if measurement.frequency_sd is not None:
        return {"repeatability": float(np.mean(measurement.frequency_sd / measurement.frequencies))}
    return {} if measurement.relative_std is None else {"repeatability": measurement.relative_std}
