"""A sampled posterior as arviz InferenceData."""

from __future__ import annotations

from importlib.metadata import version
from typing import TYPE_CHECKING, Any

import numpy as np

from cpam_bayes import __version__
from cpam_bayes.identification.sampled import SampledResult
from cpam_bayes.inference.diagnostics.assessment import log_likelihoods, thinned
from cpam_bayes.inference.diagnostics.identifiability import paired
from cpam_bayes.inference.ensemble import problem_hash
from cpam_bayes.plate import to_user, user_name
from cpam_bayes.report.plates.head import unit_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["inference_data"]

# arviz writes its own version, into every group.
_LIBRARIES = ("numpy", "scipy", "emcee")
_PRIOR_DRAWS = 1000


def inference_data(result: SampledResult) -> Any:
    """The posterior as ``arviz.InferenceData``, thinned by the autocorrelation time.

    Chains are the walkers of all ensembles. Constants carry the names and units of the plate file; the
    densities lp and log_prior are those over SI units. Groups: posterior; prior, draws of it;
    sample_stats (lp); log_likelihood, by frequency over `mode`, as one number for a list that may lack
    modes; log_prior, by parameter; posterior_predictive and observed_data over `mode`, of the
    frequencies that have one. Attributes: versions, plate, seed, hash of the problem, the likelihood.
    """
    import warnings

    with warnings.catch_warnings():
        # arviz announces its next version, and takes many walkers with few thinned draws for a slip
        warnings.simplefilter("ignore", FutureWarning)
        warnings.simplefilter("ignore", UserWarning)
        return _inference_data(result)


def _inference_data(result: SampledResult) -> Any:
    import arviz

    posterior, chains = result.posterior, thinned(result.result)
    names = posterior.parameters.names
    flat, shape = chains.flat, chains.draws.shape[:2]
    predicted = posterior.predict(flat)
    total, pointwise = log_likelihoods(posterior, flat, predicted, result.pairing)
    rows, columns = paired(result.pairing)
    rng = np.random.default_rng([result.seed, 2])
    noise = posterior.noise_model.sample(rng, (len(flat), len(rows)))
    replicate = predicted[:, columns] + posterior.noise(flat, predicted)[:, rows, columns] * noise
    by_frequency = {"frequencies_hz": ["mode"]}
    prior = posterior.parameters.sample(rng, _PRIOR_DRAWS)
    prior = prior[np.isfinite(posterior.log_prior(prior))]
    data = arviz.from_dict(
        posterior=_by_name(names, chains.draws),
        prior=_by_name(names, prior[None]),
        sample_stats={"lp": chains.log_prob},
        log_likelihood={"list": total.reshape(shape)}
        if pointwise is None
        else {"frequencies_hz": pointwise.reshape(*shape, -1)},
        posterior_predictive={"frequencies_hz": replicate.reshape(*shape, -1)},
        observed_data={"frequencies_hz": posterior.measurement.frequencies[rows]},
        dims=by_frequency,
        coords={"mode": [f"{j + 1} {result.modes[j].label}".strip() for j in columns]},
        attrs=_attributes(result, chains.step),
    )
    # from_dict drops this group without a word
    parameters = posterior.parameters.parameters
    log_prior = {
        user_name(p.name): p.prior.log_density(chains.draws[..., i]) for i, p in enumerate(parameters)
    }
    data.add_groups({"log_prior": log_prior})
    for group in (data.posterior, data.prior):
        for name in names:
            group[user_name(name)].attrs["unit"] = unit_of(name)
    for group in data.groups():
        data[group].attrs.pop("created_at", None)  # the same seed gives the same file
    return data


def _by_name(names: tuple[str, ...], draws: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """Draws (chains, draws, n) by their names in the plate file, in its units."""
    return {user_name(name): draws[..., i] * to_user(name, 1.0) for i, name in enumerate(names)}


def _attributes(result: SampledResult, step: int) -> dict[str, Any]:
    posterior, own = result.posterior, result.posterior.measurement
    centre = np.array([[p.prior.mean for p in posterior.parameters.parameters]])
    given = "frequency_sd_hz" if own.frequency_sd is not None else "relative_std"
    return {
        "cpam_bayes_version": __version__,
        **{f"{library}_version": version(library) for library in _LIBRARIES},
        "plate": result.specimen.name,
        "source": result.specimen.source,
        "seed": result.seed,
        "problem_hash": problem_hash(posterior, centre),
        "noise": f"{posterior.noise_name}, inferred" if posterior.noise_is_inferred else f"{given}, given",
        "noise_degrees_of_freedom": posterior.degrees_of_freedom,
        "resolution_hz": own.resolution,
        "list_is_complete": int(own.complete),
        "thinned_by": step,
        "r_hat": result.result.diagnostics.r_hat,
        "log_evidence": result.evidence.log_evidence,
    }
