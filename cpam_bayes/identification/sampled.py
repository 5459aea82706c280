"""Identification by sampling: the swarm, the ensembles started from it, and what they say."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.forward_model.labels import LabelledModel, list_order
from cpam_bayes.forward_model.model import SIZES, discretisation_error
from cpam_bayes.forward_model.reduced import ReducedModel
from cpam_bayes.identification.starting import start_of
from cpam_bayes.inference.diagnostics.assessment import Assessment, assess
from cpam_bayes.inference.diagnostics.completeness import Doubt, doubt_of
from cpam_bayes.inference.diagnostics.predictive import predictive_p_value
from cpam_bayes.inference.ensemble import (
    DEFAULT_SETTINGS,
    Diagnostics,
    EnsembleResult,
    EnsembleSettings,
)
from cpam_bayes.inference.importance import Evidence, evidence_of
from cpam_bayes.inference.noise import Likelihood
from cpam_bayes.inference.pairing import Pairing
from cpam_bayes.inference.posterior import Posterior
from cpam_bayes.inference.sampling import sample_from
from cpam_bayes.inference.swarm.pso import SwarmSettings
from cpam_bayes.mechanics.shapes import Mode
from cpam_bayes.plate import Specimen
from cpam_bayes.plate.elasticity import complete_constants
from cpam_bayes.plate.laminate import flexural_constants
from cpam_bayes.threads import single_blas_thread

Array = NDArray[Any]
Verdict = Literal["determined by the data", "determined by data and prior", "determined by the prior"]

# Posterior contraction from which the data decide, and below which the prior does.
_BY_DATA, _BY_PRIOR = 0.9, 0.5
# Share of the search interval that counts as touching a bound.
_TOUCH = 0.01
# Share of draws next to a bound that an even density over the interval would not put there.
_AT_BOUND = 0.05
# Draws that predictions and laminate constants are averaged over.
_PREDICTIVE_DRAWS = 1000


@dataclass(frozen=True, slots=True)
class ConstantPosterior:
    """Marginal posterior of one parameter, SI.

    contraction : 1 - (sd / prior sd)^2. at_lower, at_upper : shares of the draws within 1 % of the
    search interval of a bound. bound : the one that the posterior is in contact with, which then has
    a say whatever the contraction. reference : of the plate file, ``nan`` for the noise.
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
    bound: Literal["lower", "upper"] | None
    verdict: Verdict
    reference: float


@dataclass(frozen=True, slots=True)
class SampledIdentification:
    """The posterior of one specimen's constants.

    predicted : (n_modes,) posterior mean and sd of the model's frequencies, Hz. modes : the model's
    modes at the most probable draw. pairing : of the list with them. p_value : posterior predictive
    p-value of the sum of squared standardised residuals. laminate : name -> (mean, sd). error :
    relative error of the solver at the most probable draw in the modes that have a frequency. doubt : a
    pairing of a complete list that is far more probable than one to one. evidence : by importance
    sampling. assessment : what determines the posterior and how it fits. seconds_sampling : of the
    ensembles, without the plate model, the swarm and what follows.
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
    doubt: Doubt | None
    evidence: Evidence
    assessment: Assessment
    result: EnsembleResult
    forward_solves: int
    seconds_sampling: float
    seconds: float

    @property
    def ess_per_second(self) -> float:
        """Effective samples of the worst parameter for each second of sampling."""
        return self.result.diagnostics.ess_bulk / self.seconds_sampling


@single_blas_thread
def identify_by_sampling(
    specimen: Specimen,
    seed: int,
    *,
    likelihood: Likelihood = "relative",
    degrees_of_freedom: float = np.inf,
    settings: EnsembleSettings = DEFAULT_SETTINGS,
    swarm_settings: SwarmSettings | None = None,
    store: Path | None = None,
    notify: Callable[[str], None] = lambda text: None,
    progress: Callable[[Diagnostics], None] = lambda diagnostics: None,
) -> SampledIdentification:
    """The posterior of a specimen's constants by emcee, started from the particle swarm.

    likelihood, degrees_of_freedom : of the noise, as of ``noise_model``. Raises ``ValueError`` if the
    specimen has no measured frequencies or no unknowns, or if no particle is feasible; ``StoreError``
    if the store cannot be used.
    """
    start = time.perf_counter()
    begun = start_of(
        specimen,
        seed,
        likelihood=likelihood,
        degrees_of_freedom=degrees_of_freedom,
        swarm_settings=swarm_settings,
        notify=notify,
    )
    posterior, model = begun.posterior, begun.model
    notify("starting the ensembles from the swarm")
    sampling = time.perf_counter()
    result = sample_from(
        posterior, begun.bests, begun.values, seed, settings=settings, store=store, progress=progress
    )
    sampling = time.perf_counter() - sampling
    notify("assessing the posterior")
    evidence = evidence_of(posterior, result, seed)
    solves = begun.solves + result.solves + evidence.solves
    rng = np.random.default_rng([seed, 3])
    return _summarise(specimen, posterior, model, result, evidence, solves, (start, sampling), rng)


def _summarise(
    specimen: Specimen,
    posterior: Posterior,
    model: ReducedModel | LabelledModel,
    result: EnsembleResult,
    evidence: Evidence,
    solves: int,
    clock: tuple[float, float],
    rng: np.random.Generator,
) -> SampledIdentification:
    draws = result.draws
    n = model.parameters.size
    best = draws[int(np.argmax(result.log_prob))]
    few = draws[rng.choice(len(draws), size=min(_PREDICTIVE_DRAWS, len(draws)), replace=False)]
    frequencies = posterior.predict(few)
    pairing = posterior.most_probable_pairing(best)
    modes, order = model.full.modes(best[:n]), list_order(model, best[:n])
    paired = order[pairing.mode[pairing.mode >= 0]]
    start, sampling = clock
    return SampledIdentification(
        specimen=specimen,
        posterior=posterior,
        constants=tuple(_marginal(specimen, posterior, i, draws[:, i]) for i in range(draws.shape[1])),
        predicted=frequencies.mean(axis=0),
        predicted_sd=frequencies.std(axis=0),
        modes=tuple(modes[j] for j in order),
        pairing=pairing,
        p_value=predictive_p_value(posterior, few, frequencies, pairing, rng),
        laminate=_laminate(model, few[:, :n]),
        error=discretisation_error(model.full, best[:n])[paired],
        doubt=doubt_of(specimen, posterior, model, best),
        evidence=evidence,
        assessment=assess(posterior, result, pairing, specimen.unknowns.names),
        result=result,
        forward_solves=solves,
        seconds_sampling=sampling,
        seconds=time.perf_counter() - start,
    )


def _marginal(specimen: Specimen, posterior: Posterior, i: int, draws: Array) -> ConstantPosterior:
    parameter = posterior.parameters.parameters[i]
    prior = parameter.prior
    sd = float(draws.std())
    contraction = 1.0 - (sd / prior.sd) ** 2
    touch = _TOUCH * (prior.upper - prior.lower)
    at_lower, at_upper = (
        float(np.mean(draws < prior.lower + touch)),
        float(np.mean(draws > prior.upper - touch)),
    )
    bound: Literal["lower", "upper"] | None = None
    if max(at_lower, at_upper) > _AT_BOUND:
        bound = "lower" if at_lower > at_upper else "upper"
    verdict: Verdict = "determined by data and prior"
    if contraction < _BY_PRIOR:
        verdict = "determined by the prior"
    elif contraction >= _BY_DATA and bound is None:
        verdict = "determined by the data"
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
        bound=bound,
        verdict=verdict,
        reference=_reference(specimen, parameter.name),
    )


def _reference(specimen: Specimen, name: str) -> float:
    material = specimen.material
    if name in SIZES:
        return float(getattr(specimen.plate, name))
    return float(complete_constants(material.constants, material.isotropic).get(name, np.nan))


def _laminate(model: ReducedModel | LabelledModel, x: Array) -> dict[str, tuple[float, float]]:
    """Mean and sd of the flexural stiffness and constants over draws (m, n)."""
    state = model.full.operator.problem.state(model.parameters.mapping(x))
    stiffness = np.broadcast_to(state.stiffness(), (len(x), 8, 8))
    thickness = np.broadcast_to(state.thickness, len(x))
    found = [flexural_constants(k, float(h)) for k, h in zip(stiffness, thickness, strict=True)]
    columns = {name: np.array([f[name] for f in found]) for name in found[0]}
    return {name: (float(v.mean()), float(v.std())) for name, v in columns.items()}
