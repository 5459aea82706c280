"""Identification by sampling: the swarm, the ensembles started from it, and what they say."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.cache import reduced_model
from cpam_bayes.elasticity import complete_constants
from cpam_bayes.inference.ensemble import (
    DEFAULT_SETTINGS,
    Diagnostics,
    EnsembleResult,
    EnsembleSettings,
)
from cpam_bayes.inference.identify import identify, required
from cpam_bayes.inference.pso import SwarmSettings
from cpam_bayes.inference.sampling import sample_from, swarm_on_posterior
from cpam_bayes.laminate import flexural_constants
from cpam_bayes.measurement import Specimen
from cpam_bayes.model import discretisation_error
from cpam_bayes.pairing import Pairing, most_probable_pairing
from cpam_bayes.posterior import Posterior, plate_posterior
from cpam_bayes.reduced import DEFAULT_SETTINGS as REDUCTION
from cpam_bayes.reduced import ReducedModel
from cpam_bayes.shapes import Mode
from cpam_bayes.threads import single_blas_thread

Array = NDArray[Any]
Verdict = Literal[
    "determined by the data", "determined by data and prior", "determined by the prior", "at a bound"
]

# Posterior contraction from which the data decide, and below which the prior does.
_BY_DATA, _BY_PRIOR = 0.9, 0.5
# Share of the search interval that counts as touching a bound.
_TOUCH = 0.01
# Share of draws next to a bound that an even density over the interval would not put there.
_AT_BOUND = 0.05
# Modes looked at beyond the list where it may lack some.
_SPARE_MODES = 4
# Draws that predictions and laminate constants are averaged over.
_PREDICTIVE_DRAWS = 1000


@dataclass(frozen=True, slots=True)
class ConstantPosterior:
    """Marginal posterior of one parameter, SI.

    contraction : 1 - (sd / prior sd)^2. at_lower, at_upper : shares of the draws within 1 % of the
    search interval of a bound. reference : of the plate file, ``nan`` for the noise.
    """

    name: str
    mean: float
    sd: float
    q025: float
    median: float
    q975: float
    lower: float
    upper: float
    contraction: float
    at_lower: float
    at_upper: float
    verdict: Verdict
    reference: float


@dataclass(frozen=True, slots=True)
class SampledIdentification:
    """The posterior of one specimen's constants.

    predicted : (n_modes,) posterior mean and sd of the model's frequencies, Hz. modes : the model's
    modes at the most probable draw. pairing : of the list with them. p_value : posterior predictive
    p-value of the sum of squared standardised residuals. laminate : name -> (mean, sd). error :
    (n_modes,) relative error of the solver at the most probable draw.
    """

    specimen: Specimen
    posterior: Posterior
    constants: tuple[ConstantPosterior, ...]
    predicted: Array
    predicted_sd: Array
    modes: tuple[Mode, ...]
    pairing: Pairing
    p_value: float
    laminate: Mapping[str, tuple[float, float]]
    error: Array
    result: EnsembleResult
    forward_solves: int
    seconds: float


@single_blas_thread
def identify_by_sampling(
    specimen: Specimen,
    seed: int,
    *,
    settings: EnsembleSettings = DEFAULT_SETTINGS,
    swarm_settings: SwarmSettings | None = None,
    store: Path | None = None,
    notify: Callable[[str], None] = lambda text: None,
    progress: Callable[[Diagnostics], None] = lambda diagnostics: None,
) -> SampledIdentification:
    """The posterior of a specimen's constants by emcee, started from the particle swarm.

    Raises ``ValueError`` if the specimen has no measured frequencies or no unknowns, or if no
    particle is feasible; ``StoreError`` if the store cannot be used.
    """
    start = time.perf_counter()
    measurement, unknowns = required(specimen)
    if measurement.complete:
        point = identify(specimen, seed, settings=swarm_settings, notify=notify)
        model, swarm, error = point.model, point.swarm, point.error
        bests, values, solves = swarm.personal_bests, swarm.personal_values, swarm.evaluations
        posterior = plate_posterior(model, measurement, _solver_error(error))
    else:
        model = reduced_model(specimen, unknowns, measurement.size + _SPARE_MODES, notify=notify)
        posterior = plate_posterior(model, measurement, _solver_error(model.full.error))
        bests, values, solves = swarm_on_posterior(posterior, seed, swarm_settings or SwarmSettings())
    notify("starting the ensembles from the swarm")
    result = sample_from(posterior, bests, values, seed, settings=settings, store=store, progress=progress)
    solves += result.diagnostics.steps * settings.ensembles * settings.walkers
    rng = np.random.default_rng([seed, 3])
    return _summarise(specimen, posterior, model, result, solves, start, rng)


def _solver_error(error: Array) -> Array:
    return np.asarray(np.hypot(error, REDUCTION.tolerance))


def _summarise(
    specimen: Specimen,
    posterior: Posterior,
    model: ReducedModel,
    result: EnsembleResult,
    solves: int,
    start: float,
    rng: np.random.Generator,
) -> SampledIdentification:
    draws = result.draws
    n = model.parameters.size
    best = draws[int(np.argmax(result.log_prob))]
    few = draws[rng.choice(len(draws), size=min(_PREDICTIVE_DRAWS, len(draws)), replace=False)]
    frequencies = model.predict(few[:, :n]).frequencies
    pairing = _pairing(posterior, best)
    return SampledIdentification(
        specimen=specimen,
        posterior=posterior,
        constants=tuple(_marginal(specimen, posterior, i, draws[:, i]) for i in range(draws.shape[1])),
        predicted=frequencies.mean(axis=0),
        predicted_sd=frequencies.std(axis=0),
        modes=model.full.modes(best[:n]),
        pairing=pairing,
        p_value=_predictive_p_value(posterior, few, frequencies, pairing, rng),
        laminate=_laminate(model, few[:, :n]),
        error=discretisation_error(model.full, best[:n]),
        result=result,
        forward_solves=solves,
        seconds=time.perf_counter() - start,
    )


def _pairing(posterior: Posterior, x: Array) -> Pairing:
    own = posterior.measurement
    if own.complete:
        return Pairing(np.arange(own.size), np.empty(0, dtype=int), 0.0)
    predicted = posterior.model.predict(x[None, : posterior.model.parameters.size]).frequencies
    density = posterior.log_density(predicted, posterior.noise(x[None], predicted))[0]
    in_range = posterior.in_range(predicted)[0]
    return most_probable_pairing(density, in_range, posterior.span, posterior.pairing)


def _marginal(specimen: Specimen, posterior: Posterior, i: int, draws: Array) -> ConstantPosterior:
    parameter = posterior.parameters.parameters[i]
    prior = parameter.prior
    sd = float(draws.std())
    contraction = 1.0 - (sd / prior.sd) ** 2
    verdict: Verdict = "determined by data and prior"
    if contraction >= _BY_DATA:
        verdict = "determined by the data"
    elif contraction < _BY_PRIOR:
        verdict = "determined by the prior"
    touch = _TOUCH * (prior.upper - prior.lower)
    at_lower, at_upper = (
        float(np.mean(draws < prior.lower + touch)),
        float(np.mean(draws > prior.upper - touch)),
    )
    if max(at_lower, at_upper) > _AT_BOUND:
        verdict = "at a bound"
    q025, median, q975 = (float(q) for q in np.quantile(draws, (0.025, 0.5, 0.975)))
    return ConstantPosterior(
        name=parameter.name,
        mean=float(draws.mean()),
        sd=sd,
        q025=q025,
        median=median,
        q975=q975,
        lower=prior.lower,
        upper=prior.upper,
        contraction=contraction,
        at_lower=at_lower,
        at_upper=at_upper,
        verdict=verdict,
        reference=_reference(specimen, parameter.name),
    )


def _reference(specimen: Specimen, name: str) -> float:
    material = specimen.material
    return float(complete_constants(material.constants, material.isotropic).get(name, np.nan))


def _predictive_p_value(
    posterior: Posterior, draws: Array, frequencies: Array, pairing: Pairing, rng: np.random.Generator
) -> float:
    """Probability of a replicate list with larger standardised residuals than the measured one.

    The discrepancy is the sum of squared standardised residuals at each draw (Gelman, Meng and Stern,
    1996), of the frequencies that have a mode.
    """
    paired = pairing.mode >= 0
    rows, columns = np.flatnonzero(paired), pairing.mode[paired]
    sigma = posterior.noise(draws, frequencies)[:, rows, columns]
    predicted = frequencies[:, columns]
    measured = posterior.measurement.frequencies[rows]
    observed = np.sum(((measured - predicted) / sigma) ** 2, axis=1)
    nu = posterior.degrees_of_freedom
    noise = rng.standard_normal(sigma.shape) if np.isinf(nu) else rng.standard_t(nu, size=sigma.shape)
    return float(np.mean(np.sum(noise**2, axis=1) >= observed))


def _laminate(model: ReducedModel, x: Array) -> dict[str, tuple[float, float]]:
    """Mean and sd of the flexural stiffness and constants over draws (m, n)."""
    state = model.full.operator.problem.state(model.parameters.mapping(x))
    thickness = float(state.thickness)
    found = [flexural_constants(k, thickness) for k in np.broadcast_to(state.stiffness(), (len(x), 8, 8))]
    columns = {name: np.array([f[name] for f in found]) for name in found[0]}
    return {name: (float(v.mean()), float(v.std())) for name, v in columns.items()}
