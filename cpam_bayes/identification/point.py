"""Point identification: the best optimum of particle swarms over a converged plate, and its reliability."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, t

from cpam_bayes.answer import Constant, Notice, Reliance, Verdict, as_written
from cpam_bayes.forward_model.known_errors import ScaleError, absorbed, sizes_spread
from cpam_bayes.forward_model.labels import (
    ShapePairing,
    by_shape,
    list_order,
    same_label,
    shape_notices,
)
from cpam_bayes.forward_model.model import plate_problem
from cpam_bayes.forward_model.preconditions import (
    LARGE_ERROR,
    SUSPICIOUS_RATIO,
    count_notices,
    error_notices,
    misfit_over_noise,
    units_notices,
)
from cpam_bayes.forward_model.reduced import ReducedModel, basis_error
from cpam_bayes.forward_model.three_dimensions import sandwich_notices, theory_bias
from cpam_bayes.identification.density import Draws, lists_density, optima_about, sampled
from cpam_bayes.identification.search import Optimum, Residual, Search, required, search
from cpam_bayes.inference.assessment import cut_notices, limiting_constraints
from cpam_bayes.inference.completeness import TranscriptionError
from cpam_bayes.inference.ensemble import EnsembleResult
from cpam_bayes.inference.laplace import Optima
from cpam_bayes.inference.log_density import CorrelatedDensity
from cpam_bayes.inference.posterior import Posterior
from cpam_bayes.inference.swarm import SwarmResult, SwarmSettings
from cpam_bayes.mechanics.modes import Mode
from cpam_bayes.mechanics.problem import THEORY_ALONE
from cpam_bayes.parameters import ParameterSet, Uniform
from cpam_bayes.plate import Measurement, Specimen
from cpam_bayes.plate.laminate import flexural_constants
from cpam_bayes.running import single_blas_thread

BY_DATA: Final = 0.9
"""Posterior contraction from which the data determine a constant: its sd is a third of the prior's."""
BY_PRIOR: Final = 0.5
"""Posterior contraction below which the prior does: its sd is more than 0.7 of the prior's."""


def verdict_of(sd: float, prior_sd: float, *, explained: bool, at_bound: bool = False) -> Verdict:
    """What determines a constant, by its posterior contraction 1 - (sd / prior sd)^2.

    explained : whether stated noise explains the misfit, see `birge_ratio`. Otherwise the model is not
    of this plate, and what its frequencies determine is no constant of the plate either.

    A constant in contact with a bound is never determined by the data alone; one whose sd is not known
    counts as determined by the prior.
    """
    contraction = 1.0 - (sd / prior_sd) ** 2
    if not contraction >= BY_PRIOR:
        return Verdict.PRIOR
    if not explained:
        return Verdict.MISFIT
    return Verdict.DATA if contraction >= BY_DATA and not at_bound else Verdict.BOTH


Array = NDArray[Any]


LEAST_WIDENING: Final = 0.1
"""Least relative growth of a standard deviation that is reported."""

# 1 - 1/4: part of its precision that a prior of twice the width loses
_LESS_PRECISION = 0.75


def reliances(
    names: Sequence[str], covariance: Array, prior_sd: Array, sd: Array | None = None
) -> tuple[Reliance, ...]:
    """Constants whose interval would be wider by a tenth with a wider prior of another one.

    With a normal posterior of covariance S, doubling the standard deviation s_j of a normal prior of constant
    j lowers the precision of j by 3/4 / s_j^2, so that (Sherman and Morrison, Ann. Math. Stat. 21, 1950)

        S'_ii = S_ii + k S_ij^2 / (1 - k S_jj),  k = 3 / (4 s_j^2)

    Parameters
    ----------
    covariance : (n, n) of the posterior
    prior_sd : (n,)
    sd : (n,) standard deviations of the intervals, where they include more than the covariance does
    """
    variance = np.diag(covariance)
    shown = variance if sd is None else sd**2
    found = []
    for j, on in enumerate(names):
        left = _LESS_PRECISION / prior_sd[j] ** 2
        # a posterior piled up at both ends of its bounds has more variance than an even one
        added = left * covariance[:, j] ** 2 / (1.0 - min(left * variance[j], _LESS_PRECISION))
        for i, name in enumerate(names):
            widening = float(np.sqrt(1.0 + added[i] / shown[i]) - 1.0)
            if i != j and widening >= LEAST_WIDENING:
                found.append(Reliance(name, on, widening))
    return tuple(found)


# A constant this close to a bound, as a fraction of the search interval, sits on it.
_ON_BOUND = 1e-3
# Confidence level at which the noise excludes an optimum other than the best one.
_WITHIN = 0.95
# Probability in each tail outside an interval of 95 %.
_TAIL = 0.025
# Standard deviations beyond which a constant has another value at another optimum.
_APART = 3.0


@dataclass(frozen=True, slots=True)
class PointEstimate:
    """Result of the particle swarm for one specimen.

    constants : SI, in the order of the unknowns: with whitened residuals moments and quantiles of the
        posterior over all optima; else the sd is linearised and includes those of [plate.sd], and the
        interval covers all optima that the noise leaves open
    predicted : one mode for each measured frequency; with whitened residuals at the most probable errors of
        sizes and mass
    shapes : (n_modes, 3, n, n) of these, u, v and w on a regular grid
    rms : root mean square of the relative residuals
    noise : relative standard deviation for the linearised sd: the file's or, without it, the residuals'
    misfit : over the stated noise, as of ``misfit_over_noise``; 1 where that explains it
    error : (n_modes,) estimated relative error of the solver and of its reduced basis at the answer
    laminate : flexural stiffness and constants, SI
    model, centre : model of the swarm, and its centre, as of ``reduced_model``
    swarm : the single one, or of several the first with the best optimum
    swarms : number that were run
    optima : the best one and those that the noise leaves open
    scale_errors : effects of errors of sizes, mass and frequency scale on the constants
    reliances : intervals that rest on the bounds or the prior of another constant
    alone : the constants from the frequencies and bounds alone, where they have another prior
    draws : posterior draws behind the constants, with whitened residuals
    by_shape : pairing by measured shapes, None without them
    """

    specimen: Specimen
    constants: tuple[Constant, ...]
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
    alone: tuple[Constant, ...]
    seconds: float
    notices: tuple[Notice, ...]
    draws: Draws | None = None
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
    constraints of eq. (9), as ``search`` does. Swarms run on the reduced model; the reported values of the
    best optimum are by the full one. ``notify`` is called before long steps that precede the swarm. Raises
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
        bias=theory_bias(specimen) if residual == "whitened" else THEORY_ALONE,
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
    """Point estimate at the best optimum of a search."""
    measurement, unknowns = required(specimen)
    model, swarm = searched.model, searched.swarm
    posterior = _about_optima(specimen, searched) if residual == "whitened" else None
    best = swarm.best if posterior is None else posterior.optima[0].x
    error = searched.error + basis_error(model, best)[0]
    prediction = model.full.predict(best, jacobian=True)
    order = list_order(model, best)[: measurement.size]
    modes = model.full.modes(best)
    predicted = prediction.frequencies[0, order]
    if posterior is not None:
        predicted = predicted * posterior.by_sizes
    relative = predicted / measurement.frequencies - 1.0
    rms = float(np.sqrt(np.mean(relative**2)))
    noise, inferred = _noise(measurement, relative, unknowns.size)
    assert prediction.jacobian is not None
    prior_sd = unknowns.prior_sd
    if posterior is not None:
        excess, covariance, optima = posterior.excess, posterior.draws.covariance, posterior.optima
    else:
        # a misfit that the stated noise does not explain widens it by Birge's ratio
        excess = misfit_over_noise(measurement, relative, unknowns.size)
        jacobian = prediction.jacobian[0, order]
        covariance = linearised_covariance(jacobian, prior_sd, measurement, noise, residual, excess)
        optima = _within_noise(searched, measurement, noise, residual)
    at_optima = np.array([optimum.x for optimum in optima])
    scales = absorbed(
        specimen,
        model.full,
        dict(zip(unknowns.names, best.tolist(), strict=True)),
        order,
        dict(zip(unknowns.names, prior_sd.tolist(), strict=True)),
    ).errors(usual=residual == "whitened")
    # a prior far from the list may leave a misfit where the constants of the search leave none
    explained = excess == 1.0 == misfit_over_noise(measurement, relative, unknowns.size)
    freedom = measurement.size - unknowns.size if inferred or not explained else np.inf
    sd = np.sqrt(np.diag(covariance))
    if posterior is None:
        sd = _with_sizes(scales, unknowns.names, best, sd)
    relied_on = reliances(unknowns.names, covariance, prior_sd, sd)
    if posterior is not None:
        estimates = sampled_constants(specimen, posterior.draws, relied_on, explained=explained)
    else:
        estimates = tuple(
            _constant(
                specimen,
                name,
                values,
                its_sd,
                freedom,
                explained=explained,
                rests_on=tuple(r.on for r in relied_on if r.name == name),
            )
            for name, values, its_sd in zip(unknowns.names, at_optima.T, sd.tolist(), strict=True)
        )
    answer = np.array([c.value for c in estimates])
    state = plate_problem(specimen, unknowns).state(unknowns.mapping(answer))
    return PointEstimate(
        specimen=specimen,
        constants=estimates,
        predicted=tuple(replace(modes[j], frequency=float(f)) for j, f in zip(order, predicted, strict=True)),
        shapes=model.full.shapes(best)[order],
        rms=rms,
        noise=noise,
        noise_is_inferred=inferred,
        misfit=excess,
        error=error[order],
        laminate=flexural_constants(np.real(state.stiffness()), float(state.thickness)),
        model=ReducedModel(model.full, model.fast, model.tolerance),
        centre=searched.centre,
        swarm=swarm,
        swarms=searched.swarms,
        optima=optima,
        scale_errors=scales,
        reliances=relied_on,
        alone=() if posterior is None else posterior.alone,
        seconds=time.perf_counter() - start,
        notices=_notices(specimen, predicted),
        draws=None if posterior is None else posterior.draws,
        by_shape=by_shape(model),
    )


@dataclass(frozen=True, slots=True)
class _Sampled:
    """The posterior about the optima of a search.

    excess : factor by which the stated noise is widened
    optima : of the density that the noise leaves open, the best one first
    by_sizes : (n_f,) factors on the frequencies there, by the most probable errors of sizes and mass
    alone : as of `PointEstimate`
    """

    excess: float
    draws: Draws
    optima: tuple[Optimum, ...]
    by_sizes: Array
    alone: tuple[Constant, ...]


def _about_optima(specimen: Specimen, searched: Search) -> _Sampled:
    """The posterior of a specimen about the optima of its misfit, and the optima of its density."""
    measurement, unknowns = required(specimen)
    model, at, n = searched.model, searched.optima[0].x, unknowns.size
    predicted = model.full.predict(at).frequencies[0, list_order(model, at)[: measurement.size]]
    noise, _ = _noise(measurement, predicted / measurement.frequencies - 1.0, n)
    starts = np.array([optimum.x for optimum in searched.optima])
    found: list[tuple[Draws, float]] = []
    listed: tuple[Optimum, ...] = ()
    by_sizes = np.ones(measurement.size)
    bounds = tuple(replace(p, prior=Uniform(p.prior.lower, p.prior.upper)) for p in unknowns.parameters)
    alone = replace(specimen, unknowns=ParameterSet(bounds, unknowns.fixed))
    for of in (specimen, alone) if any(not p.prior.is_range for p in unknowns.parameters) else (specimen,):
        density, widened = lists_density([(of, model)], at[None], 0.0)
        optima = optima_about(density, starts, noise)
        if widened[0] > 1.0:
            # sizes may explain what the constants of the search, with sizes as stated, do not
            there = density.scores.to_x(optima.z[0])[:n]
            density, widened = lists_density([(of, model)], there[None], 0.0)
            optima = optima_about(density, np.vstack((there, starts)), noise)
        found.append((sampled(density, optima, n), float(widened[0])))
        if not listed:
            listed = _optima(density, optima, searched.optima)
            by_sizes = np.exp(density.common_part(optima.z[:1])[0] / measurement.frequencies)
    explained = found[0][1] == 1.0
    each = [sampled_constants(alone, draws, (), explained=explained) for draws, _ in found[1:]]
    return _Sampled(found[0][1], found[0][0], listed, by_sizes, each[0] if each else ())


def _optima(density: CorrelatedDensity, optima: Optima, searched: Sequence[Optimum]) -> tuple[Optimum, ...]:
    """Optima of a density that its best one does not exclude, 95 % of chi-squared; swarms as of the nearest.

    searched : optima of the misfit, from which the derivatives started
    """
    x, n = density.scores.to_x(optima.z), len(searched[0].x)
    misfits = density.misfit(x, density.predict(x)[0])
    began = np.array([optimum.x for optimum in searched])
    kept = 2.0 * (optima.value[0] - optima.value) <= chi2.ppf(_WITHIN, n)
    scale = np.std(began, axis=0) + np.abs(began[0])
    nearest = [int(np.argmin(np.sum(((began - at) / scale) ** 2, axis=1))) for at in x[:, :n]]
    return tuple(
        Optimum(x[i, :n], float(misfits[i]), searched[nearest[i]].swarms) for i in np.flatnonzero(kept)
    )


def _within_noise(
    searched: Search, measurement: Measurement, noise: float, residual: Residual
) -> tuple[Optimum, ...]:
    """Optima whose misfit exceeds the best by no more than the noise allows, 95 % of chi-squared.

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
    if measurement.relative_noise is not None:
        return measurement.relative_noise, False
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
    """Standard deviations of constants (n,), those by the errors of the plate's sizes included."""
    if not scales:
        return sd
    return np.asarray(np.hypot(sd, np.abs(values) * [sizes_spread(scales, name) for name in names]))


def _constant(
    specimen: Specimen,
    name: str,
    at_optima: Array,
    sd: float,
    freedom: float,
    *,
    explained: bool,
    rests_on: tuple[str, ...],
) -> Constant:
    """A constant from its values (k,) at the optima that the noise leaves open, the best one first.

    freedom : of the noise, infinite where it is known. explained : whether the noise explains the misfit.
    """
    value, prior = float(at_optima[0]), specimen.unknowns[name].prior
    elsewhere = tuple(sorted(v for v in at_optima[1:].tolist() if abs(v - value) > _APART * sd))
    bound = bound_of(value, prior.lower, prior.upper)
    # within the distance of the optima the frequencies do not determine it
    spread = float(np.hypot(sd, np.std([value, *elsewhere])))
    verdict = verdict_of(spread, prior.sd, at_bound=bound is not None, explained=explained)
    reference = float(specimen.material.complete()[name])
    interval = None
    if bound is None and np.isfinite(sd):
        reach = float(t.ppf(1.0 - _TAIL, freedom)) * sd
        values = (value, *elsewhere)
        interval = (max(min(values) - reach, prior.lower), min(max(values) + reach, prior.upper))
    return Constant(
        name=name,
        value=value,
        sd=sd,
        interval=interval,
        prior=prior,
        reference=reference,
        verdict=verdict,
        bound=bound,
        elsewhere=elsewhere,
        rests_on=rests_on,
    )


# Fraction of a search interval that counts as touching a bound, and fraction of the posterior there, above
# that of a uniform one, from which a constant is at the bound.
_TOUCH, _AT_BOUND = 0.01, 0.05


def sampled_constants(
    specimen: Specimen, draws: Draws, relied_on: tuple[Reliance, ...], *, explained: bool
) -> tuple[Constant, ...]:
    """The constants by their posterior; explained : whether the noise explains the misfit."""
    reference, found = specimen.material.complete(), []
    each = zip(specimen.unknowns.names, draws.mean.tolist(), np.diag(draws.covariance), strict=True)
    for i, (name, mean, variance) in enumerate(each):
        unknown = specimen.unknowns[name]
        prior = unknown.prior
        touch = _TOUCH * (prior.upper - prior.lower)
        below, above = draws.beyond(i, prior.lower + touch, prior.upper - touch)
        bound: Literal["lower", "upper"] | None = None
        if max(below, above) > _AT_BOUND:
            bound = "lower" if below > above else "upper"
        low, high = draws.quantiles(i, (_TAIL, 1.0 - _TAIL)).tolist()
        sd = float(np.sqrt(variance))
        found.append(
            Constant(
                name=name,
                value=mean,
                sd=sd,
                interval=(low, high),
                prior=prior,
                reference=float(reference[name]),
                verdict=verdict_of(sd, prior.sd, explained=explained, at_bound=bound is not None),
                bound=bound,
                rests_on=tuple(r.on for r in relied_on if r.name == name),
                has_former_plate=unknown.coupled is not None,
            )
        )
    return tuple(found)


def _notices(specimen: Specimen, predicted: Array) -> tuple[Notice, ...]:
    measurement, unknowns = required(specimen)
    ratio = predicted / measurement.frequencies
    return (*count_notices(measurement.size, unknowns.size), *units_notices(ratio, specimen.plate))


# The solver's error matters where it is more than this fraction of the noise.
_FRACTION_OF_NOISE = 0.2
# A search model is good to some 5e-5 of a frequency; beyond this it lacks something.
_SEARCH_ERROR = 3e-4
# A relative residual beyond this is no scatter of a measurement any more.
_POOR_FIT = 0.05
# Posterior predictive p-value below which noise alone does not explain the residuals.
_P_LOW = 0.02


def point_notices(result: PointEstimate, residual: Residual) -> tuple[Notice, ...]:
    """Every reason not to trust the numbers of a swarm as they stand.

    residual : kind of residual that the swarm minimised.
    """
    limit = _FRACTION_OF_NOISE * result.noise if math.isfinite(result.noise) else LARGE_ERROR
    found = {c.name: c.value for c in result.constants}
    return (
        *result.notices,
        *_other_misfit(result, residual),
        *_poor_fit(result),
        *([Notice("swarms_disagree")] if result.swarm.status == "budget" else []),
        *error_notices(result.error, limit),
        *_on_constraints(result),
        *_other_labels(result),
        *_of_shapes(result),
        *_unused(result.specimen, residual),
        *sandwich_notices(result.specimen, result.predicted, found),
    )


def _other_misfit(result: PointEstimate, residual: Residual) -> Iterator[Notice]:
    """Notice if the misfit at the swarm's best differs from that of the full plate model there."""
    measurement = result.specimen.measurement
    assert measurement is not None
    predicted = np.array([mode.frequency for mode in result.predicted])
    if residual == "whitened":  # a part in 1e4 of a frequency, over the noise, is for the density to say
        return
    difference = predicted - measurement.frequencies
    scale = float(np.max(measurement.frequencies))
    if residual == "relative":
        difference, scale = difference / measurement.frequencies, 1.0
    reduced = math.sqrt(result.swarm.value / measurement.size)
    full = float(np.sqrt(np.mean(difference**2)))
    if abs(full - reduced) > _SEARCH_ERROR * scale:
        yield Notice(
            "search_model", facts={"reduced": reduced, "full": full, "relative": residual == "relative"}
        )


def _poor_fit(result: PointEstimate) -> Iterator[Notice]:
    measurement = result.specimen.measurement
    assert measurement is not None
    predicted = np.array([mode.frequency for mode in result.predicted])
    relative = predicted / measurement.frequencies - 1.0
    worst = int(np.argmax(np.abs(relative)))
    # Beyond this ratio the units are suspected, of which there is a separate notice.
    off_by_units = abs(np.log1p(relative[worst])) > np.log(SUSPICIOUS_RATIO)
    if not off_by_units and abs(relative[worst]) > _POOR_FIT:
        yield Notice("poor_fit", facts={"mode": worst + 1, "residual": float(relative[worst])})


def _on_constraints(result: PointEstimate) -> Iterator[Notice]:
    specimen = result.specimen
    best = result.swarm.best
    for constraint in limiting_constraints(specimen.material, specimen.unknowns, best):
        yield Notice("optimum_on_constraint", facts={"constraint": constraint})


def _other_labels(result: PointEstimate) -> Iterator[Notice]:
    measurement = result.specimen.measurement
    assert measurement is not None
    for i, (given, mode) in enumerate(zip(measurement.labels, result.predicted, strict=True), 1):
        if given and same_label(given) != same_label(mode.label):
            yield Notice("other_label", facts={"frequency": i, "given": given, "found": mode.label})


def _of_shapes(result: PointEstimate) -> tuple[Notice, ...]:
    measurement, pairing = result.specimen.measurement, result.by_shape
    assert measurement is not None
    several = pairing is not None and len(pairing.assignments) > 1
    return shape_notices(pairing, measurement, "best" if several else None)


def _unused(specimen: Specimen, residual: Residual) -> Iterator[Notice]:
    """Notices of entries of the plate file that the swarm does not use."""
    unknowns = specimen.unknowns
    names = tuple(name for name in unknowns.names if not unknowns[name].prior.is_range)
    if names and residual != "whitened":
        yield Notice("prior_not_fitted", facts={"names": names})


def sampled_notices(
    specimen: Specimen,
    posterior: Posterior,
    chains: EnsembleResult,
    constants: Mapping[str, Constant],
    modes: Sequence[Mode],
    p_value: float,
    doubt: TranscriptionError | None,
    pairing: ShapePairing | None,
) -> tuple[Notice, ...]:
    """Every reason not to trust the numbers of a sampled posterior as they stand.

    modes : of the model at the most probable draw. p_value : posterior predictive. pairing : by shape.
    """
    measurement = posterior.measurement
    notices = [*count_notices(measurement.size, len(constants))]
    if chains.status == "budget":
        d = chains.diagnostics
        facts = {"steps": d.steps, "r_hat": d.r_hat, "ess_bulk": d.ess_bulk}
        notices.append(Notice("chains_not_converged", facts=facts))
    if chains.not_stored is not None:
        notices += as_written([chains.not_stored])
    if doubt is not None:
        notices.append(transcription_notice(doubt))
    draws = dict(zip(posterior.parameters.names, chains.draws.T, strict=True))
    notices += cut_notices(specimen.material, draws)
    if p_value < _P_LOW:
        notices.append(Notice("unexplained_residuals", facts={"p": p_value}))
    notices += shape_notices(pairing, measurement, "all" if posterior.alternatives else None)
    found = {name: c.value for name, c in constants.items()}
    return (*notices, *sandwich_notices(specimen, modes, found))


def transcription_notice(doubt: TranscriptionError) -> Notice:
    """Notice of a complete list that appears to have a transcription error."""
    facts = {
        "missed": None if doubt.missed is None else (doubt.missed.label, doubt.missed.frequency),
        "spurious": doubt.spurious,
        "log_odds": doubt.log_odds,
    }
    return Notice("doubtful_list", facts=facts)
