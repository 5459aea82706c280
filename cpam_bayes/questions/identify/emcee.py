"""The function `sample`: posterior of the constants by emcee, started from the particle swarm."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, get_args

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.answer import Constant, FrequencyRow, Notice, Reliance, Verdict
from cpam_bayes.errors import checked
from cpam_bayes.forward_model.known_errors import FREQUENCY_SCALE, ScaleError, absorbed
from cpam_bayes.forward_model.labels import ShapePairing, by_shape, list_order
from cpam_bayes.forward_model.model import SIZES, air_shifts, discretisation_error, with_references
from cpam_bayes.forward_model.preconditions import (
    count_slips,
    exchange_notices,
    explained_failures,
    high_noise_notices,
    misfit_over_noise,
    misfit_slips,
    noise_slips,
    reference_contradictions,
    reference_slips,
    require_choice,
    require_seed,
    require_supported,
    stated_slips,
)
from cpam_bayes.forward_model.reduced import ReducedModel, basis_error
from cpam_bayes.identification.point import reliances, sampled_notices, verdict_of
from cpam_bayes.identification.search import NO_MESH, required, start_of
from cpam_bayes.inference.assessment import (
    Assessment,
    assess,
    log_likelihoods,
    paired,
    predictive_p_value,
    thinned,
)
from cpam_bayes.inference.completeness import transcription_error
from cpam_bayes.inference.ensemble import DEFAULT_SETTINGS, Diagnostics, EnsembleResult, EnsembleSettings
from cpam_bayes.inference.pairing import Pairing
from cpam_bayes.inference.posterior import NOISE_NAMES, Likelihood, Posterior
from cpam_bayes.inference.sampling import (
    Evidence,
    arviz_data,
    basis_notices,
    by_user_name,
    described,
    evidence_of,
    hashed,
    reweighted,
    sample_from,
)
from cpam_bayes.inference.swarm import SwarmSettings
from cpam_bayes.mechanics.modes import Mode
from cpam_bayes.plate import Measurement, PlateLike, Specimen, read_plate, user_name
from cpam_bayes.plate.laminate import flexural_constants
from cpam_bayes.priors import Prior
from cpam_bayes.questions.identify.slips import (
    Slip,
    bound_slips,
    corrected_texts,
    pushed,
    slips_where_unreachable,
    with_slips,
    without_own_prior,
)
from cpam_bayes.result import PlateResult, within_time
from cpam_bayes.running import SILENT, Watch, single_blas_thread

Array = NDArray[Any]

# Fraction of the search interval next to a bound in which a draw counts as touching it.
_TOUCH = 0.01
# Probability, by its height, of a candidate peak that is reported if no mode takes it.
_STANDING = 0.9
# Draws over which predictions and laminate constants are averaged.
_PREDICTIVE_DRAWS = 1000
# Draws among these at which the basis is checked by full solves.
_CHECKED_DRAWS = 8


@dataclass(frozen=True, slots=True)
class Marginal:
    """Marginal posterior of one parameter (constant, size or noise), SI.

    contraction : 1 - (sd / prior sd)^2
    at_lower, at_upper : shares of the draws within 1 % of the search interval of a bound
    """

    mean: float
    sd: float
    q025: float
    median: float
    q975: float
    contraction: float
    at_lower: float
    at_upper: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class SampledResult(PlateResult):
    """The posterior of one specimen's constants.

    Attributes
    ----------
    posterior : the sampled density; ``posterior.log_prob`` takes parameter vectors
    constants : name -> elastic constant in SI, its value the mean; `to_dict` and `to_dataframe` have the
        units of the plate file
    sizes : name -> inexact size or mass of the plate, or frequency scale, likewise
    marginals : name -> marginal posterior of every parameter, the noise among them
    predicted, predicted_sd : (n_modes,) posterior mean and sd of the model's frequencies, Hz
    modes : modes of the model at the most probable draw
    shapes : of these modes, (n_modes, 3, n, n), u, v and w on a regular grid
    pairing : of the measured frequencies with these modes
    pairing_probability : (n,) probability of each candidate peak in the pairing; None for a list
    p_value : posterior predictive p-value of the sum of squared standardised residuals
    explained : whether the noise as stated explains the misfit
    laminate : name -> (mean, sd)
    error : relative error of the solver at the most probable draw, and of its basis at a few draws, in the
        modes that have a frequency
    scale_errors : effect of errors of sizes, mass and frequency scale on the constants
    reliances : intervals that depend on the bounds or the prior of another constant
    evidence : by importance sampling
    assessment : what determines the posterior and how it fits
    result : chains and diagnostics of the ensembles
    seconds_sampling : of the ensembles alone
    by_shape : pairing by measured shapes at the reference constants, None without shapes
    explained_by : slips of the plate file that explain its misfit, the most probable first
    """

    command: ClassVar[str] = "identify"

    posterior: Posterior
    constants: Mapping[str, Constant]
    sizes: Mapping[str, Constant]
    marginals: Mapping[str, Marginal]
    predicted: Array
    predicted_sd: Array
    modes: tuple[Mode, ...]
    shapes: Array
    pairing: Pairing
    pairing_probability: Array | None
    p_value: float
    explained: bool
    laminate: Mapping[str, tuple[float, float]]
    error: Array
    scale_errors: tuple[ScaleError, ...]
    reliances: tuple[Reliance, ...]
    evidence: Evidence
    assessment: Assessment
    result: EnsembleResult
    forward_solves: int
    seconds_sampling: float
    seconds: float
    by_shape: ShapePairing | None = None
    explained_by: tuple[Slip, ...] = ()

    @property
    def has_draws(self) -> bool:
        """True: a sampled posterior has draws."""
        return True

    def to_arviz(self) -> Any:
        """The draws with their log densities for arviz, as in ``posterior.nc``."""
        return inference_data(self)

    @property
    def status(self) -> str:
        """Either "converged", or "budget" where the chains used all their steps."""
        return self.result.status

    @property
    def noise(self) -> tuple[str, Marginal] | None:
        """Name and marginal posterior of the noise; None where the plate file states it."""
        return next(((n, m) for n, m in self.marginals.items() if n in NOISE_NAMES), None)

    @property
    def frequencies(self) -> tuple[FrequencyRow, ...]:
        """One row for each measured frequency, Hz; without a prediction where it belongs to no mode."""
        rows = []
        measured, of_pair = self.posterior.measurement.frequencies, self.pairing_probability
        for i, (f, j) in enumerate(zip(measured, self.pairing.mode, strict=True)):
            probability = None if of_pair is None else float(of_pair[i])
            if j < 0:
                rows.append(FrequencyRow(float(f), None, probability=probability))
                continue
            mode, mean, sd = self.modes[j], float(self.predicted[j]), float(self.predicted_sd[j])
            rows.append(
                FrequencyRow(float(f), mean, mode.kind, mode.label, int(j) + 1, sd, probability=probability)
            )
        return tuple(rows)

    def texts(self) -> Mapping[str, str]:
        """The corrected plate file, without the slip that explains the misfit, where it can be written."""
        return corrected_texts(self.specimen, self.explained_by)

    @property
    def missed(self) -> tuple[FrequencyRow, ...]:
        """Modes within the range of the measured frequencies that the list lacks."""
        modes = ((int(j), self.modes[j]) for j in self.pairing.missed)
        return tuple(
            FrequencyRow(None, float(self.predicted[j]), mode.kind, mode.label, j + 1) for j, mode in modes
        )

    @property
    def ess_per_second(self) -> float:
        """Bulk effective sample size of the worst parameter per second of sampling."""
        return self.result.diagnostics.ess_bulk / self.seconds_sampling


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

    On the command line ``identify --backend emcee``; the point estimate by the swarm alone is `identify`.

    Parameters
    ----------
    plate : a built-in name, a path, a table or a `Specimen`, see `read_plate`
    likelihood : "relative" noise, proportional to a frequency, or "absolute", one standard deviation in Hz
        for all modes, which is inferred: eq. (7)
    degrees_of_freedom : of Student-t noise; infinite for Gaussian noise
    settings : of the ensembles
    store : directory of finished rounds, from which the same call resumes
    watch : progress display; none if left out

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
    >>> result.status, list(result.constants)
    ('converged', ['E1', 'nu12'])
    >>> e1 = result.constants["E1"]
    >>> e1.interval[0] < 67.8e9 < e1.interval[1], e1.verdict.value
    (True, 'determined by the data')
    """
    require_seed(seed)
    require_choice("likelihood", likelihood, get_args(Likelihood))
    if store is not None and (not str(store) or (Path(store).exists() and not Path(store).is_dir())):
        raise ValueError(f"store: received {str(store)!r}, accepted: a directory")
    specimen = require_supported(read_plate(plate), NO_MESH)
    required(specimen)
    known = slips_where_unreachable(specimen)
    specimen = with_references(specimen)
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
            known,
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
    known: tuple[Slip, ...],
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
    result, fast = sample_from(
        posterior, begun.bests, begun.values, seed, settings=settings, store=store, progress=progress
    )
    sampling = time.perf_counter() - sampling
    notify("assessing the posterior")
    evidence = evidence_of(fast, result)
    evidence = reweighted(evidence, posterior, fast, result, seed)
    solves = begun.solves + result.solves + evidence.solves
    clock = start, sampling
    return _summarise(specimen, posterior, model, result, evidence, solves, clock, seed, notify, known)


def _summarise(
    specimen: Specimen,
    posterior: Posterior,
    model: ReducedModel,
    result: EnsembleResult,
    evidence: Evidence,
    solves: int,
    clock: tuple[float, float],
    seed: int,
    notify: Callable[[str], None],
    known: tuple[Slip, ...],
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
    predicted, measurement, names = frequencies.mean(axis=0), posterior.measurement, specimen.unknowns.names
    left = _residuals(measurement, predicted, pairing)
    inferred = posterior.noise_is_inferred
    explained = inferred or misfit_over_noise(measurement, left, len(names)) == 1.0
    judged = partial(_constant, specimen, posterior, converged=result.status == "converged")
    marginals = {
        p.name: _marginal(p.prior, x) for p, x in zip(posterior.parameters.parameters, draws.T, strict=True)
    }
    relied_on = _reliances(posterior, draws, names)
    by_basis = basis_error(model, few[:_CHECKED_DRAWS, :n]).max(axis=0)
    constants = {
        name: replace(
            pushed(judged(name, marginals[name], explained=explained)),
            rests_on=tuple(r.on for r in relied_on if r.name == name),
        )
        for name in names
    }
    doubt = transcription_error(specimen, posterior, model, best)
    p_value = predictive_p_value(posterior, few, frequencies, pairing, rng)
    shown_modes, shapes = tuple(modes[j] for j in order), by_shape(model)
    noise = marginals.get("relative_std")
    misfit, excess = _excess(measurement, left, len(constants), noise, inferred=inferred)
    excess, explained_by = with_slips(excess, specimen, misfit, notify, known)
    slips = _slips(specimen, measurement, constants, excess, is_named=bool(explained_by))
    return SampledResult(
        seed=seed,
        specimen=specimen,
        air_shifts=air_shifts(specimen),
        reached_goal=result.status == "converged" and result.not_stored is None,
        posterior=posterior,
        constants=constants,
        sizes={
            name: judged(name, m, explained=True)
            for name, m in marginals.items()
            if name in SIZES or name == FREQUENCY_SCALE
        },
        marginals=marginals,
        predicted=predicted,
        predicted_sd=frequencies.std(axis=0),
        modes=shown_modes,
        shapes=model.full.shapes(best[:n])[order],
        pairing=pairing,
        pairing_probability=None
        if measurement.mode_probability is None
        else posterior.pairing_probability(few, pairing),
        p_value=p_value,
        explained=explained,
        laminate=_laminate(model, few[:, :n]),
        error=(discretisation_error(model.full, best[:n]) + by_basis)[paired],
        scale_errors=_scale_errors(specimen, posterior, model, best, pairing, order),
        reliances=relied_on,
        evidence=evidence,
        assessment=assess(posterior, result, pairing, specimen.unknowns.names),
        result=result,
        forward_solves=solves,
        seconds_sampling=sampling,
        seconds=time.perf_counter() - start,
        by_shape=shapes,
        explained_by=explained_by,
        notices=(
            *slips,
            *(() if slips or noise is None else high_noise_notices(noise.mean)),
            *sampled_notices(specimen, posterior, result, constants, shown_modes, p_value, doubt, shapes),
            *basis_notices(evidence),
            *left_out_peaks(measurement, pairing),
            *exchange_notices(specimen),
        ),
    )


def left_out_peaks(measurement: Measurement, pairing: Pairing) -> tuple[Notice, ...]:
    """Notice of candidate peaks that stand out like modes but have no mode in the model."""
    if measurement.mode_probability is None:
        return ()
    left = (pairing.mode < 0) & (measurement.mode_probability > _STANDING)
    peaks = tuple(measurement.frequencies[left].tolist())
    return (Notice("left_out_peaks", facts={"peaks": peaks}),) if peaks else ()


def _residuals(measurement: Measurement, predicted: Array, pairing: Pairing) -> Array:
    """Residuals predicted / measured - 1 (n,), nan where a frequency belongs to no mode."""
    of_mode = np.where(pairing.mode < 0, np.nan, predicted[pairing.mode])
    return np.asarray(of_mode / measurement.frequencies - 1.0)


def _excess(
    measurement: Measurement, residuals: Array, n_fitted: int, noise: Marginal | None, *, inferred: bool
) -> tuple[float, tuple[Notice, ...]]:
    """The relative rms misfit, and notices where it exceeds the noise.

    residuals : (n,) at the mean, nan where a frequency belongs to no mode. noise : relative, if inferred.
    """
    known = residuals[np.isfinite(residuals)]
    misfit = float(np.sqrt(np.mean(known**2))) if known.size else 0.0
    excess = misfit_slips(max(misfit if noise is None else noise.mean, misfit))
    if not excess and not inferred:
        excess = noise_slips(measurement, residuals, n_fitted)
    return misfit, excess


def _slips(
    specimen: Specimen,
    measurement: Measurement,
    constants: Mapping[str, Constant],
    excess: tuple[Notice, ...],
    *,
    is_named: bool,
) -> tuple[Notice, ...]:
    """Notices of likely slips; excess : notices of the misfit, is_named : whether a slip is already named."""
    determined = {
        c.name: (c.value, c.sd)
        for c in constants.values()
        if c.verdict in (Verdict.DATA, Verdict.BOTH, Verdict.MISFIT)
    }
    alone = map(without_own_prior, constants.values())
    return (
        *stated_slips(specimen),
        *count_slips(measurement.size, len(constants)),
        *bound_slips(constants.values()),
        *excess,
        *(() if is_named else reference_contradictions(specimen, determined, alone)),
        *reference_slips(specimen),
    )


def _scale_errors(
    specimen: Specimen,
    posterior: Posterior,
    model: ReducedModel,
    best: Array,
    pairing: Pairing,
    order: Array,
) -> tuple[ScaleError, ...]:
    """Errors of the constants by sizes, mass and frequency scale, at the most probable draw."""
    _, unknowns = required(specimen)
    values = model.parameters.mapping(best[: model.parameters.size])
    known = pairing.mode >= 0
    return absorbed(
        specimen,
        model.full,
        {name: float(values[name]) for name in unknowns.names},
        order[pairing.mode[known]],
        {name: unknowns[name].prior.sd for name in unknowns.names},
        np.flatnonzero(known),
    ).errors(usual=posterior.noise_name != "absolute_sd")


def _reliances(posterior: Posterior, draws: Array, names: tuple[str, ...]) -> tuple[Reliance, ...]:
    """Reliances among the elastic constants; draws : (m, n) of all parameters."""
    kept = [posterior.parameters.names.index(name) for name in names]
    prior_sd = np.array([posterior.parameters[name].prior.sd for name in names])
    return reliances(names, np.atleast_2d(np.cov(draws[:, kept].T)), prior_sd)


def _marginal(prior: Prior, draws: Array) -> Marginal:
    sd = float(draws.std())
    touch = _TOUCH * (prior.upper - prior.lower)
    at_lower, at_upper = (
        float(np.mean(draws < prior.lower + touch)),
        float(np.mean(draws > prior.upper - touch)),
    )
    q025, median, q975 = (float(q) for q in np.quantile(draws, (0.025, 0.5, 0.975)))
    return Marginal(
        mean=float(draws.mean()),
        sd=sd,
        q025=q025,
        median=median,
        q975=q975,
        contraction=1.0 - (sd / prior.sd) ** 2,
        at_lower=at_lower,
        at_upper=at_upper,
    )


def _constant(
    specimen: Specimen,
    posterior: Posterior,
    name: str,
    marginal: Marginal,
    *,
    explained: bool,
    converged: bool,
) -> Constant:
    """A constant or size; explained : whether noise explains the misfit; converged : the chains."""
    parameter = posterior.parameters[name]
    return Constant(
        name=name,
        value=marginal.mean,
        sd=marginal.sd,
        interval=(marginal.q025, marginal.q975),
        prior=parameter.prior,
        reference=_reference(specimen, name),
        verdict=verdict_of(marginal.sd, parameter.prior.sd, explained=explained)
        if converged
        else Verdict.UNCONVERGED,
        has_former_plate=parameter.coupled is not None,
    )


def _reference(specimen: Specimen, name: str) -> float:
    if name in SIZES:
        return float(getattr(specimen.plate, name))
    if name == FREQUENCY_SCALE:
        return 1.0
    return float(specimen.material.complete().get(name, np.nan))


def _laminate(model: ReducedModel, x: Array) -> dict[str, tuple[float, float]]:
    """Name -> mean and sd of a flexural stiffness or constant over draws x (m, n)."""
    state = model.full.operator.problem.state(model.parameters.mapping(x))
    stiffness = np.broadcast_to(state.stiffness(), (len(x), 8, 8))
    thickness = np.broadcast_to(state.thickness, len(x))
    laminates = [flexural_constants(k, float(h)) for k, h in zip(stiffness, thickness, strict=True)]
    columns = {name: np.array([f[name] for f in laminates]) for name in laminates[0]}
    return {name: (float(v.mean()), float(v.std())) for name, v in columns.items()}


_PRIOR_DRAWS = 1000


def inference_data(result: SampledResult) -> Any:
    """The posterior for arviz, an ``xarray.DataTree``, thinned by the autocorrelation time.

    The chains are the ensembles; their walkers are not independent chains. Constants carry the names and
    units of the plate file; the densities lp and log_prior are over SI units, on the whole basis. Groups:
    posterior; prior, draws of it; sample_stats (lp); log_likelihood, by frequency over `mode`, or one number
    for a list that may lack modes; log_prior, by parameter; posterior_predictive, prior_predictive and
    observed_data over `mode`, for the frequencies that have one; constant_data, the plate's sizes and
    density. Attributes: command, versions, plate, specimen, layup, edges, seed, hash of the problem, the
    likelihood; the symmetry of the material and its fixed constants (JSON, as in the plate file); the
    repeatability where it was given.
    """
    posterior, chains = result.posterior, thinned(result.result)
    names = posterior.parameters.names
    flat, shape = chains.flat, chains.draws.shape[:2]
    predicted = posterior.predict(flat)
    total, pointwise = log_likelihoods(posterior, flat, predicted, result.pairing)
    rows, columns = paired(result.pairing)
    rng = np.random.default_rng([result.seed, 2])
    of_plate, sizes = described(result.specimen, None)

    def replicated(x: Array, f: Array) -> Array:
        noise = posterior.noise_model.sample(rng, (len(x), len(rows)))
        return np.asarray(f[:, columns] + posterior.noise(x, f)[:, rows, columns] * noise)

    replicate = replicated(flat, predicted)
    prior = posterior.parameters.sample(rng, _PRIOR_DRAWS)
    prior = prior[np.isfinite(posterior.log_prior(prior))]
    before = replicated(prior, posterior.predict(prior))
    measurement = posterior.measurement
    given = "frequency_sd_hz" if measurement.frequency_sd is not None else "relative_std"
    return arviz_data(
        result.command,
        result.specimen,
        result.seed,
        names,
        {
            **hashed(posterior),
            **of_plate,
            "noise": f"{posterior.noise_name}, inferred"
            if posterior.noise_is_inferred
            else f"{given}, given",
            "noise_degrees_of_freedom": posterior.degrees_of_freedom,
            "resolution_hz": measurement.resolution,
            "list_is_complete": int(measurement.complete),
            "thinned_by": chains.step,
            "r_hat": result.result.diagnostics.r_hat,
            "log_evidence": result.evidence.log_evidence,
        },
        {
            "posterior": by_user_name(names, chains.draws),
            "prior": by_user_name(names, prior[None]),
            "sample_stats": {"lp": (total + posterior.log_prior(flat)).reshape(shape)},
            "log_likelihood": {"list": total.reshape(shape)}
            if pointwise is None
            else {"frequencies_hz": pointwise.reshape(*shape, -1)},
            "log_prior": {
                user_name(p.name): p.prior.log_density(chains.draws[..., i])
                for i, p in enumerate(posterior.parameters.parameters)
            },
            "posterior_predictive": {"frequencies_hz": replicate.reshape(*shape, -1)},
            "prior_predictive": {"frequencies_hz": before[None]},
            "constant_data": sizes,
            "observed_data": {"frequencies_hz": measurement.frequencies[rows]},
        },
        dims={"frequencies_hz": ["mode"]},
        coords={"mode": [f"{j + 1} {result.modes[j].label}".strip() for j in columns]},
    )
