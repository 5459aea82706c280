"""A sampled posterior as arviz InferenceData and as a picture."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from cpam_bayes import __version__
from cpam_bayes.inference.ensemble import problem_hash
from cpam_bayes.inference.sampled import SampledIdentification
from cpam_bayes.measurement import to_user, user_name
from cpam_bayes.posterior import NOISE

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["inference_data", "posterior_figures", "write_posterior"]

_BINS = 40


def inference_data(result: SampledIdentification, seed: int) -> Any:
    """The posterior as ``arviz.InferenceData``, thinned by the autocorrelation time.

    Chains are the walkers of all ensembles. Constants carry the names and units of the plate file.
    Groups: posterior, sample_stats (lp), log_likelihood and posterior_predictive over `mode`,
    log_prior, observed_data. A list that may lack modes has no log_likelihood by mode.
    """
    import warnings

    with warnings.catch_warnings():
        # arviz announces its next version, and takes many walkers with few thinned draws for a slip
        warnings.simplefilter("ignore", FutureWarning)
        warnings.simplefilter("ignore", UserWarning)
        return _inference_data(result, seed)


def _inference_data(result: SampledIdentification, seed: int) -> Any:
    import arviz

    own, posterior = result.result, result.posterior
    step = max(1, int(np.ceil(own.diagnostics.autocorrelation_time)))
    chain = own.chain[:, ::step]
    n_ensembles, n_draws, n_walkers, n = chain.shape
    draws = np.moveaxis(chain, 2, 1).reshape(n_ensembles * n_walkers, n_draws, n)
    flat = draws.reshape(-1, n)
    shape = draws.shape[:2]
    predicted = posterior.model.predict(flat[:, : posterior.model.parameters.size]).frequencies
    sigma = posterior.noise(flat, predicted)
    log_density = posterior.log_density(predicted, sigma)
    rows = np.flatnonzero(result.pairing.mode >= 0)
    columns = result.pairing.mode[rows]
    noise = np.random.default_rng([seed, 2]).standard_normal((len(flat), len(rows)))
    replicate = predicted[:, columns] + sigma[:, rows, columns] * noise
    # lists of arrays: arviz has no way to name dimensions of the predictive groups one by one
    data = arviz.from_dict(
        posterior={_name(c): draws[..., i] * _factor(c) for i, c in enumerate(posterior.parameters.names)},
        sample_stats={"lp": np.moveaxis(own.log_prob[:, ::step], 2, 1).reshape(shape)},
        log_likelihood=(
            {"frequencies_hz": np.einsum("kii->ki", log_density[:, :, : len(rows)]).reshape(*shape, -1)}
            if posterior.measurement.complete
            else None
        ),
        posterior_predictive={"frequencies_hz": replicate.reshape(*shape, -1)},
        observed_data={"frequencies_hz": posterior.measurement.frequencies[rows]},
        dims={"frequencies_hz": ["mode"]},
        coords={"mode": [f"{j + 1} {result.modes[j].label}" for j in columns]},
        attrs={
            "cpam_bayes_version": __version__,
            "plate": result.specimen.name,
            "source": result.specimen.source,
            "seed": seed,
            "problem_hash": problem_hash(posterior, flat[:1]),
            "thinned_by": step,
        },
    )
    log_prior = posterior.log_prior(flat).reshape(shape)
    data.add_groups({"log_prior": {"all_parameters": log_prior}})
    return data


def write_posterior(result: SampledIdentification, seed: int, directory: Path) -> None:
    """Write posterior.nc, which plain arviz opens with ``arviz.from_netcdf``."""
    inference_data(result, seed).to_netcdf(str(directory / "posterior.nc"))


def _name(parameter: str) -> str:
    return parameter if parameter == NOISE else user_name(parameter)


def _factor(parameter: str) -> float:
    return 1.0 if parameter == NOISE else to_user(parameter, 1.0)


def posterior_figures(result: SampledIdentification) -> dict[str, Figure]:
    """Pair plot of the constants: marginal densities beside their priors, and every pair's density."""
    constants = result.posterior.parameters.names
    draws = result.result.draws * np.array([_factor(c) for c in constants])
    n = len(constants)
    figure = Figure(figsize=(1.9 * n, 1.9 * n), layout="constrained")
    axes = figure.subplots(n, n, squeeze=False)
    for i in range(n):
        for j in range(n):
            here = axes[i, j]
            if j > i:
                here.set_axis_off()
                continue
            if i == j:
                _draw_marginal(here, result, i, draws[:, i])
            else:
                here.hist2d(draws[:, j], draws[:, i], bins=_BINS, cmap="Blues", rasterized=True)
            here.tick_params(labelsize=7)
            if i == n - 1:
                here.set_xlabel(_label(constants[j]), fontsize=8)
            else:
                here.set_xticklabels([])
            if j == 0 and i > 0:
                here.set_ylabel(_label(constants[i]), fontsize=8)
            elif j > 0:
                here.set_yticklabels([])
    figure.suptitle(f"{result.specimen.name}: posterior (blue), prior (grey), reference (red)", fontsize=10)
    return {"posterior": figure}


def _draw_marginal(axes: Any, result: SampledIdentification, i: int, draws: NDArray[Any]) -> None:
    c = result.constants[i]
    factor = _factor(c.name)
    axes.hist(draws, bins=_BINS, density=True, color="#4878a8")
    low, high = float(draws.min()), float(draws.max())  # as the pictures below have it
    grid = np.linspace(low, high, 200)
    prior = result.posterior.parameters[c.name].prior
    axes.plot(grid, np.exp(prior.log_density(grid / factor)) / factor, color="grey")
    if np.isfinite(c.reference):
        axes.axvline(c.reference * factor, color="#c0392b", linewidth=1.2)
    axes.set_xlim(grid[0], grid[-1])
    axes.set_yticks([])


def _label(parameter: str) -> str:
    name = _name(parameter)
    return name.replace("_GPa", ", GPa").replace("relative_std", "noise s")
