"""The posterior of the constants of a plate, sampled by emcee from the swarm on: the question `sample`."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.arguments import checked
from cpam_bayes.forward_model.air_shift import air_shifts
from cpam_bayes.forward_model.labels import LabelledModel, by_shape, list_order
from cpam_bayes.forward_model.model import SIZES, discretisation_error
from cpam_bayes.forward_model.preconditions import (
    exchange_warnings,
    explained_failures,
    require_choice,
    require_seed,
    require_supported,
)
from cpam_bayes.forward_model.reachable import require_reachable
from cpam_bayes.forward_model.reduced import ReducedModel
from cpam_bayes.forward_model.slips import (
    common_factor_slips,
    count_slips,
    misfit_over_noise,
    misfit_slips,
    noise_slips,
    reference_slips,
    stated_noise_slips,
)
from cpam_bayes.identification.identify import NO_MESH
from cpam_bayes.identification.reliance import Reliance, reliances
from cpam_bayes.identification.sampled_result import ConstantPosterior, SampledResult
from cpam_bayes.identification.scale_errors import ScaleError, scale_errors
from cpam_bayes.identification.search import required
from cpam_bayes.identification.starting import start_of
from cpam_bayes.identification.verdicts import MISFIT, verdict_of
from cpam_bayes.identification.warnings import sampled_warnings
from cpam_bayes.inference.chains.ensemble import (
    DEFAULT_SETTINGS,
    Diagnostics,
    EnsembleResult,
    EnsembleSettings,
)
from cpam_bayes.inference.chains.sampling import sample_from
from cpam_bayes.inference.diagnostics.assessment import assess
from cpam_bayes.inference.diagnostics.completeness import transcription_error
from cpam_bayes.inference.diagnostics.predictive import predictive_p_value
from cpam_bayes.inference.evidence import Evidence, evidence_of
from cpam_bayes.inference.noise import Likelihood
from cpam_bayes.inference.pairing import Pairing
from cpam_bayes.inference.posterior import Posterior
from cpam_bayes.inference.swarm.pso import SwarmSettings
from cpam_bayes.plate import PlateLike, Specimen, read_plate
from cpam_bayes.plate.laminate import flexural_constants
from cpam_bayes.result import SILENT, Watch, within_time
from cpam_bayes.threads import single_blas_thread

Array = NDArray[Any]

__all__ = ["ConstantPosterior", "SampledResult", "sample"]

# Fraction of the search interval that counts as touching a bound.
_TOUCH = 0.01
# Fraction of draws next to a bound that an even density over the interval would not put there.
_AT_BOUND = 0.05
# Relative noise that weighs the frequencies where none is stated; its level hardly matters.
_EVEN_NOISE = 0.01
# Draws that predictions and laminate constants are averaged over.
_PREDICTIVE_DRAWS = 1000


@checked
@within_time
def sample(
    plate: PlateLike,
    *,
    seed: int = 0,
    likelihood: Likelihood = "relative",
    degrees_of_freedom: float = np.inf,
    settings: EnsembleSettings = DEFAULT_SETTINGS,
    swarm_settings: SwarmSettings | None = None,
    store: str | Path | None = None,
    watch: Watch = SILENT,
) -> SampledResult:
    """The posterior of the constants of a plate by emcee, started from the particle swarm.

    Parameters
    ----------
    plate : what `read_plate` takes, or what it returns
    likelihood : "relative" noise, in proportion to a frequency, or "absolute", one standard deviation in Hz
        for all modes, which is inferred: eq. (7)
    degrees_of_freedom : of Student-t noise; infinite for Gaussian noise
    settings : of the ensembles
    store : a directory that keeps finished rounds; the same call goes on from there
    watch : is shown the progress

    Raises
    ------
    ValueError
        If the plate cannot be read, has no measured frequencies or no unknowns, or if no particle of the
        initial swarm is feasible.
    StoreError
        If the store cannot be used.

    Examples
    --------
    >>> import cpam_bayes as cb
    >>> result = cb.sample("A1", seed=0)
    >>> result.status, [constant.name for constant in result.elastic_constants]
    ('converged', ['E1', 'nu12'])
    >>> e1 = result.elastic_constants[0]
    >>> e1.q025 < 67.8e9 < e1.q975, e1.verdict
    (True, 'determined by the data')
    """
    require_seed(seed)
    require_choice("likelihood", likelihood, get_args(Likelihood))
    if store is not None and (not str(store) or (Path(store).exists() and not Path(store).is_dir())):
        raise ValueError(f"store: received {str(store)!r}, accepted: a directory")
    specimen = require_supported(read_plate(plate), NO_MESH)
    required(specimen)
    require_reachable(specimen)
    latest: list[Diagnostics] = []

    def described(r_hat: float) -> str:
        return f"R-hat {r_hat:.4f}, {latest[-1].ess_bulk:.0f} effective samples"

    with (
        explained_failures(specimen),
        watch.stage(f"identify {specimen.name}", settings.most_steps, described) as shown,
    ):

        def progress(diagnostics: Diagnostics) -> None:
            latest.append(diagnostics)
            shown.tick(diagnostics.steps, diagnostics.r_hat)

        return _sampled(
            specimen,
            seed,
            likelihood=likelihood,
            degrees_of_freedom=degrees_of_freedom,
            settings=settings,
            swarm_settings=swarm_settings,
            store=None if store is None else Path(store),
            notify=shown.notify,
            progress=progress,
        )


@single_blas_thread
def _sampled(
    specimen: Specimen,
    seed: int,
    *,
    likelihood: Likelihood,
    degrees_of_freedom: float,
    settings: EnsembleSettings,
    swarm_settings: SwarmSettings | None,
    store: Path | None,
    notify: Callable[[str], None],
    progress: Callable[[Diagnostics], None],
) -> SampledResult:
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
    return _summarise(specimen, posterior, model, result, evidence, solves, (start, sampling), seed)


def _summarise(
    specimen: Specimen,
    posterior: Posterior,
    model: ReducedModel | LabelledModel,
    result: EnsembleResult,
    evidence: Evidence,
    solves: int,
    clock: tuple[float, float],
    seed: int,
) -> SampledResult:
    rng = np.random.default_rng([seed, 3])
    draws = result.draws
    n = model.parameters.size
    best = draws[int(np.argmax(result.log_prob))]
    few = draws[rng.choice(len(draws), size=min(_PREDICTIVE_DRAWS, len(draws)), replace=False)]
    frequencies = posterior.predict(few)
    pairing = posterior.most_probable_pairing(best)
    modes, order = model.full.modes(best[:n]), list_order(model, best[:n])
    paired = order[pairing.mode[pairing.mode >= 0]]
    start, sampling = clock
    summary = SampledResult(
        seed=seed,
        specimen=specimen,
        air_shifts=air_shifts(specimen),
        reached_goal=result.status == "converged" and result.not_stored is None,
        posterior=posterior,
        constants=tuple(_marginal(specimen, posterior, i, draws[:, i]) for i in range(draws.shape[1])),
        predicted=frequencies.mean(axis=0),
        predicted_sd=frequencies.std(axis=0),
        modes=tuple(modes[j] for j in order),
        shapes=model.full.shapes(best[:n])[order],
        pairing=pairing,
        p_value=predictive_p_value(posterior, few, frequencies, pairing, rng),
        laminate=_laminate(model, few[:, :n]),
        error=discretisation_error(model.full, best[:n])[paired],
        scale_errors=_scale_errors(specimen, posterior, model, best, pairing, order),
        reliances=_reliances(posterior, draws, specimen.unknowns.names),
        doubt=transcription_error(specimen, posterior, model, best),
        evidence=evidence,
        assessment=assess(posterior, result, pairing, specimen.unknowns.names),
        result=result,
        forward_solves=solves,
        seconds_sampling=sampling,
        seconds=time.perf_counter() - start,
        by_shape=by_shape(model),
    )
    summary = replace(summary, constants=_judged(summary))
    slips = _slips(summary)
    warnings = (*slips, *sampled_warnings(summary), *exchange_warnings(specimen))
    return replace(summary, slips=slips, warnings=warnings)


def _judged(result: SampledResult) -> tuple[ConstantPosterior, ...]:
    """The constants, none of them determined where noise as stated does not explain the misfit."""
    n = len(result.elastic_constants)
    inferred = result.posterior.noise_is_inferred
    if inferred or misfit_over_noise(result.posterior.measurement, _residuals(result), n) == 1.0:
        return result.constants
    of_the_plate = {c.name for c in result.elastic_constants}
    return tuple(
        replace(c, verdict=verdict_of(c.sd, result.posterior.parameters[c.name].prior.sd, explained=False))
        if c.name in of_the_plate
        else c
        for c in result.constants
    )


def _residuals(result: SampledResult) -> Array:
    """(n,) predicted / measured - 1, nan where a frequency belongs to no mode."""
    return np.array([np.nan if row is None else row.residual for row in result.frequencies])


def _slips(result: SampledResult) -> tuple[str, ...]:
    """What most likely ruins the posterior."""
    measurement = result.posterior.measurement
    every = _residuals(result)
    residuals = every[np.isfinite(every)]
    misfit = float(np.sqrt(np.mean(residuals**2))) if residuals.size else 0.0
    relative = next((c.mean for c in result.constants if c.name == "relative_std"), misfit)
    n = len(result.elastic_constants)
    excess = misfit_slips(max(relative, misfit))
    if not excess and not result.posterior.noise_is_inferred:
        excess = noise_slips(measurement, every, n)
    determined = {
        c.name: (c.mean, c.sd)
        for c in result.elastic_constants
        if c.verdict in ("determined by the data", MISFIT)
    }
    return (
        *stated_noise_slips(measurement),
        *count_slips(measurement.size, n),
        *excess,
        *common_factor_slips(result.specimen, determined),
        *reference_slips(result.specimen),
    )


def _scale_errors(
    specimen: Specimen,
    posterior: Posterior,
    model: ReducedModel | LabelledModel,
    best: Array,
    pairing: Pairing,
    order: Array,
) -> tuple[ScaleError, ...]:
    """Of the sizes, the mass and the frequency scale, at the most probable draw."""
    measurement, unknowns = required(specimen)
    values = model.parameters.mapping(best[: model.parameters.size])
    known = pairing.mode >= 0
    relative = _EVEN_NOISE if measurement.relative_std is None else measurement.relative_std
    sd = measurement.noise_sd(relative)
    return scale_errors(
        specimen,
        model.full,
        {name: float(values[name]) for name in unknowns.names},
        order[pairing.mode[known]],
        (sd / measurement.frequencies)[known],
        {name: unknowns[name].prior.sd for name in unknowns.names},
    )


def _reliances(posterior: Posterior, draws: Array, names: tuple[str, ...]) -> tuple[Reliance, ...]:
    """Of the elastic constants; draws : (m, n) of all parameters."""
    kept = [posterior.parameters.names.index(name) for name in names]
    prior_sd = np.array([posterior.parameters[name].prior.sd for name in names])
    return reliances(names, np.atleast_2d(np.cov(draws[:, kept].T)), prior_sd)


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
    # `_judged` asks whether the noise explains the misfit once the frequencies have their modes
    verdict = verdict_of(sd, prior.sd, at_bound=bound is not None, explained=True)
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
    if name in SIZES:
        return float(getattr(specimen.plate, name))
    return float(specimen.material.complete().get(name, np.nan))


def _laminate(model: ReducedModel | LabelledModel, x: Array) -> dict[str, tuple[float, float]]:
    """Mean and sd of the flexural stiffness and constants over draws (m, n)."""
    state = model.full.operator.problem.state(model.parameters.mapping(x))
    stiffness = np.broadcast_to(state.stiffness(), (len(x), 8, 8))
    thickness = np.broadcast_to(state.thickness, len(x))
    laminates = [flexural_constants(k, float(h)) for k, h in zip(stiffness, thickness, strict=True)]
    columns = {name: np.array([f[name] for f in laminates]) for name in laminates[0]}
    return {name: (float(v.mean()), float(v.std())) for name, v in columns.items()}
