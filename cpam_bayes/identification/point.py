"""Point identification: the best optimum of particle swarms over a converged plate, how far to trust it."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, t

from cpam_bayes.forward_model.labels import LabelledModel, by_shape, list_order
from cpam_bayes.forward_model.mode_shapes.assurance import ShapePairing
from cpam_bayes.forward_model.model import plate_problem
from cpam_bayes.forward_model.preconditions import units_warning
from cpam_bayes.forward_model.reduced import ReducedModel
from cpam_bayes.forward_model.slips import misfit_over_noise
from cpam_bayes.identification.reliance import Reliance, reliances
from cpam_bayes.identification.scale_errors import ScaleError, scale_errors, sizes_spread
from cpam_bayes.identification.search import Optimum, Residual, Search, required, search
from cpam_bayes.identification.verdicts import Verdict, verdict_of
from cpam_bayes.inference.swarm.pso import SwarmResult, SwarmSettings
from cpam_bayes.mechanics.shapes import Mode
from cpam_bayes.plate import Measurement, Specimen
from cpam_bayes.plate.laminate import flexural_constants
from cpam_bayes.threads import single_blas_thread

Array = NDArray[Any]

# A constant this close to a bound, as a fraction of the search interval, sits on it.
_ON_BOUND = 1e-3
# Probability of the noise that leaves the best optimum ahead of another one.
_WITHIN = 0.95
# Probability in each tail outside an interval of 95 %.
_TAIL = 0.025
# Relative noise that weighs the frequencies where none is known.
_EVEN_NOISE = 0.01
# Standard deviations beyond which a constant has another value at another optimum.
_APART = 3.0


@dataclass(frozen=True, slots=True)
class ConstantEstimate:
    """One identified constant, SI.

    sd : linearised standard deviation, with those of [plate.sd], ``nan`` where the noise is not known (no
    more frequencies than unknowns and no repeatability in the plate file). interval : of 95 %, within the
    bounds and over all optima that the noise leaves open, None where the sd does not hold. bound :
    "lower" or "upper" where the estimate sits on one. reference : the value of the plate file. elsewhere :
    its values, ascending, at other optima that the noise does not tell from the best one, where these are
    more than three sd away.
    """

    name: str
    value: float
    sd: float
    interval: tuple[float, float] | None
    lower: float
    upper: float
    bound: Literal["lower", "upper"] | None
    verdict: Verdict
    reference: float
    elsewhere: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class PointEstimate:
    """Answer of the particle swarm for one specimen.

    predicted : one mode for each measured frequency
    shapes : (n_modes, 3, n, n) of these, u, v and w on a regular grid
    rms : root mean square of the relative residuals
    noise : relative standard deviation used for the linearised ones, the file's or, where that is left out,
        the residuals' own
    misfit : over the stated noise, as of ``misfit_over_noise``; 1 where that explains it
    error : (n_modes,) estimated relative error of the solver at the answer
    laminate : flexural stiffness and constants, SI
    model, centre : what the swarm ran on, and its centre, as of ``reduced_model``
    swarm : the single one, or of several the first with the best optimum
    swarms : number that were run
    optima : the best one and those that the noise does not tell from it
    scale_errors : what errors of sizes, mass and frequency scale do to the constants
    reliances : intervals that rest on the bounds or the prior of another constant
    by_shape : what measured shapes say of the modes, None without them
    """

    specimen: Specimen
    constants: tuple[ConstantEstimate, ...]
    predicted: tuple[Mode, ...]
    shapes: Array
    rms: float
    noise: float
    noise_is_inferred: bool
    misfit: float
    error: Array
    laminate: Mapping[str, float]
    model: ReducedModel
    centre: Array | None
    swarm: SwarmResult
    swarms: int
    optima: tuple[Optimum, ...]
    scale_errors: tuple[ScaleError, ...]
    reliances: tuple[Reliance, ...]
    seconds: float
    warnings: tuple[str, ...]
    by_shape: ShapePairing | None = None


@single_blas_thread
def estimate_constants(
    specimen: Specimen,
    seed: int,
    *,
    swarms: int = 1,
    settings: SwarmSettings | None = None,
    residual: Residual = "absolute",
    progress: Callable[[int, float], None] | None = None,
    notify: Callable[[str], None] = lambda text: None,
) -> PointEstimate:
    """Elastic constants of a specimen by the particle swarm of the paper, or by several that are polished.

    Minimises ``misfit`` over the unknowns of the plate file within their bounds under the
    constraints of eq. (9), as ``search`` does. Swarms run on the reduced model; what is reported of the
    best optimum comes from the full one. ``notify`` is told what takes long before the swarm starts. Raises
    ``ValueError`` if the specimen has no measured frequencies or no unknowns, or if no particle is
    feasible.
    """
    start = time.perf_counter()
    searched = search(
        specimen,
        seed,
        swarms=swarms,
        settings=settings,
        residual=residual,
        progress=progress,
        notify=notify,
    )
    return summarise(specimen, searched, residual, start)


def summarise(
    specimen: Specimen,
    searched: Search,
    residual: Residual,
    start: float,
) -> PointEstimate:
    """What an engineer needs to know about the best optimum of a search."""
    measurement, unknowns = required(specimen)
    model, swarm, error = searched.model, searched.swarm, searched.error
    best = swarm.best
    prediction = model.full.predict(best, jacobian=True)
    order = list_order(model, best)[: measurement.size]
    modes = model.full.modes(best)
    predicted = prediction.frequencies[0, order]
    relative = predicted / measurement.frequencies - 1.0
    rms = float(np.sqrt(np.mean(relative**2)))
    noise, inferred = _noise(measurement, relative, unknowns.size)
    assert prediction.jacobian is not None
    prior_sd = np.array([unknowns[name].prior.sd for name in unknowns.names])
    # a misfit that the stated noise does not explain widens it, Birge's ratio
    excess = misfit_over_noise(measurement, relative, unknowns.size)
    covariance = linearised_covariance(
        prediction.jacobian[0, order], prior_sd, measurement, noise, residual, excess
    )
    optima = _within_noise(searched, measurement, noise, residual)
    at_optima = np.array([optimum.x for optimum in optima])
    level = noise if np.isfinite(noise) else _EVEN_NOISE
    scales = scale_errors(
        specimen,
        model.full,
        dict(zip(unknowns.names, best.tolist(), strict=True)),
        order,
        measurement.noise_sd(level) / measurement.frequencies,
        dict(zip(unknowns.names, prior_sd.tolist(), strict=True)),
    )
    explained = excess == 1.0
    freedom = measurement.size - unknowns.size if inferred or not explained else np.inf
    sd = _with_sizes(scales, unknowns.names, best, np.sqrt(np.diag(covariance)))
    estimates = tuple(
        _estimate(specimen, name, values, its_sd, freedom, explained)
        for name, values, its_sd in zip(unknowns.names, at_optima.T, sd.tolist(), strict=True)
    )
    state = plate_problem(specimen, unknowns).state(unknowns.mapping(best))
    return PointEstimate(
        specimen=specimen,
        constants=estimates,
        predicted=tuple(modes[j] for j in order),
        shapes=model.full.shapes(best)[order],
        rms=rms,
        noise=noise,
        noise_is_inferred=inferred,
        misfit=excess,
        error=error[order],
        laminate=flexural_constants(np.real(state.stiffness()), float(state.thickness)),
        model=model.reduced if isinstance(model, LabelledModel) else model,
        centre=searched.centre,
        swarm=swarm,
        swarms=searched.swarms,
        optima=optima,
        scale_errors=scales,
        reliances=reliances(unknowns.names, covariance, prior_sd, sd),
        seconds=time.perf_counter() - start,
        warnings=_warnings(specimen, predicted),
        by_shape=by_shape(model),
    )


def _within_noise(
    searched: Search, measurement: Measurement, noise: float, residual: Residual
) -> tuple[Optimum, ...]:
    """The optima whose misfit exceeds the best by what the noise may, 95 % of chi-squared.

    As many degrees of freedom as unknowns; the best one alone where the noise is not known.
    """
    first, *others = searched.optima
    if not np.isfinite(noise):
        return (first,)
    f, sd = measurement.frequencies, measurement.noise_sd(noise)
    variance = float(np.mean((sd / f if residual == "relative" else sd) ** 2))
    most = first.value + chi2.ppf(_WITHIN, len(first.x)) * variance
    return (first, *(o for o in others if o.value <= most))


def _noise(measurement: Measurement, relative: Array, n_unknowns: int) -> tuple[float, bool]:
    """Relative standard deviation of a measured frequency and whether it comes from the residuals."""
    if measurement.frequency_sd is not None:
        return float(np.mean(measurement.frequency_sd / measurement.frequencies)), False
    if measurement.relative_std is not None:
        return measurement.relative_std, False
    freedom = len(relative) - n_unknowns
    if freedom <= 0:  # nothing left over to tell the noise by
        return float("nan"), True
    return float(np.sqrt(np.sum(relative**2) / freedom)), True


def linearised_covariance(
    jacobian: Array,
    prior_sd: Array,
    measurement: Measurement,
    noise: float,
    residual: Residual,
    excess: float = 1.0,
) -> Array:
    """Covariance of the constants that minimise F, to first order in the noise, (n, n).

    The minimum of (f - J x)^T W (f - J x) / s^2 + x^T R x, with W the weights of F, s^2 the mean of
    the weighted variances and R the inverse variances of the search intervals, has the covariance
    A^-1 (J^T W S W J / s^4 + R) A^-1, A = J^T W J / s^2 + R, S = diag((noise f)^2 + resolution^2 / 12).
    A constant that the data leave open keeps the standard deviation of its interval.

    jacobian : (n_modes, n) Hz per unit; prior_sd : (n,). excess : what the noise is multiplied by.
    """
    if not np.isfinite(noise):
        return np.full((len(prior_sd), len(prior_sd)), np.nan)
    f = measurement.frequencies
    noise_sd = measurement.noise_sd(noise)
    variance = np.maximum(excess**2 * (noise_sd**2 + measurement.resolution**2 / 12), (1e-9 * f) ** 2)
    weight = 1.0 / f**2 if residual == "relative" else np.ones_like(f)
    scale = float(np.mean(weight * variance))
    j = jacobian * prior_sd
    inverse = np.linalg.inv(j.T @ (weight[:, None] * j) / scale + np.eye(len(prior_sd)))
    middle = j.T @ ((weight**2 * variance)[:, None] * j) / scale**2 + np.eye(len(prior_sd))
    return np.asarray(np.outer(prior_sd, prior_sd) * (inverse @ middle @ inverse))


def bound_of(value: float, lower: float, upper: float) -> Literal["lower", "upper"] | None:
    """The bound of its search interval that a constant sits on, if it does."""
    width = upper - lower
    if value - lower < _ON_BOUND * width:
        return "lower"
    return "upper" if upper - value < _ON_BOUND * width else None


def _with_sizes(scales: tuple[ScaleError, ...], names: tuple[str, ...], values: Array, sd: Array) -> Array:
    """Standard deviations of constants (n,) with what the sizes of the plate add to them."""
    if not scales:
        return sd
    return np.asarray(np.hypot(sd, np.abs(values) * [sizes_spread(scales, name) for name in names]))


def _estimate(
    specimen: Specimen, name: str, at_optima: Array, sd: float, freedom: float, explained: bool
) -> ConstantEstimate:
    """An estimate from its values (k,) at the optima that the noise leaves open, the best one first.

    freedom : of the noise, infinite where it is known. explained : whether the noise explains the misfit.
    """
    value, prior = float(at_optima[0]), specimen.unknowns[name].prior
    elsewhere = tuple(sorted(v for v in at_optima[1:].tolist() if abs(v - value) > _APART * sd))
    bound = bound_of(value, prior.lower, prior.upper)
    # as far apart as the optima are, the frequencies do not determine it
    spread = float(np.hypot(sd, np.std([value, *elsewhere])))
    verdict = verdict_of(spread, prior.sd, at_bound=bound is not None, explained=explained)
    reference = float(specimen.material.complete()[name])
    interval = None
    if bound is None and np.isfinite(sd):
        reach = float(t.ppf(1.0 - _TAIL, freedom)) * sd
        values = (value, *elsewhere)
        interval = (max(min(values) - reach, prior.lower), min(max(values) + reach, prior.upper))
    return ConstantEstimate(
        name=name,
        value=value,
        sd=sd,
        interval=interval,
        lower=prior.lower,
        upper=prior.upper,
        bound=bound,
        verdict=verdict,
        reference=reference,
        elsewhere=elsewhere,
    )


def _warnings(specimen: Specimen, predicted: Array) -> tuple[str, ...]:
    (measurement, unknowns), problems = required(specimen), []
    n_unknowns = unknowns.size
    if measurement.size <= n_unknowns:
        problems.append(
            f"{measurement.size} frequencies for {n_unknowns} unknowns: the bounds decide, "
            "the fit says nothing about its own error"
        )
    ratio, weighed = predicted / measurement.frequencies, specimen.plate.mass is not None
    problems += units_warning(ratio, " even for the best constants", weighed=weighed)
    return tuple(problems)
