"""Point identification: the paper's particle swarm over a converged plate, and how far to trust it."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.forward_model.labels import LabelledModel, labelled_model, list_order, spare_modes
from cpam_bayes.forward_model.model import discretisation_error, plate_problem
from cpam_bayes.forward_model.preconditions import units_warning
from cpam_bayes.forward_model.reduced import ReducedModel
from cpam_bayes.forward_model.store import reduced_model
from cpam_bayes.identification.verdicts import Verdict, verdict_of
from cpam_bayes.inference.swarm.pso import SwarmResult, SwarmSettings, initial_swarm, minimise
from cpam_bayes.mechanics.shapes import Mode
from cpam_bayes.parameters import ParameterSet
from cpam_bayes.plate import Measurement, Specimen
from cpam_bayes.plate.elasticity import complete_constants
from cpam_bayes.plate.laminate import flexural_constants
from cpam_bayes.threads import single_blas_thread

Array = NDArray[Any]
Residual = Literal["absolute", "relative"]

# A constant this close to a bound, as a fraction of the search interval, sits on it.
_ON_BOUND = 1e-3
# Relative error of the plate model at the answer above which the model is converged anew there.
_ACCEPTED_ERROR = 5e-4
_MOST_MODELS = 3


@dataclass(frozen=True, slots=True)
class ConstantEstimate:
    """One identified constant, SI.

    sd : linearised standard deviation, ``nan`` where the noise is not known (no more frequencies
    than unknowns and no repeatability in the plate file). bound : "lower" or "upper" where the
    estimate sits on one. reference : the value of the plate file.
    """

    name: str
    value: float
    sd: float
    lower: float
    upper: float
    bound: Literal["lower", "upper"] | None
    verdict: Verdict
    reference: float


@dataclass(frozen=True, slots=True)
class PointEstimate:
    """Answer of the particle swarm for one specimen.

    predicted : one mode for each measured frequency. rms : root mean square of the relative
    residuals. noise : relative standard deviation used for the linearised ones, the file's or, where
    that is left out, the residuals' own. error : (n_modes,) estimated relative error of the solver
    at the answer. laminate : flexural stiffness and constants, SI. model : what the swarm ran on.
    """

    specimen: Specimen
    constants: tuple[ConstantEstimate, ...]
    predicted: tuple[Mode, ...]
    rms: float
    noise: float
    noise_is_inferred: bool
    error: Array
    laminate: Mapping[str, float]
    model: ReducedModel
    swarm: SwarmResult
    seconds: float
    warnings: tuple[str, ...]


def misfit(predicted: Array, measured: Array, residual: Residual) -> Array:
    """F of eq. (7), the sum of squared differences of frequencies, Hz^2; or of relative ones.

    predicted (m, n), measured (n,) -> (m,).
    """
    difference = predicted - measured
    if residual == "relative":
        difference = difference / measured
    return np.asarray(np.sum(difference**2, axis=-1))


@single_blas_thread
def estimate_constants(
    specimen: Specimen,
    seed: int,
    *,
    settings: SwarmSettings | None = None,
    residual: Residual = "absolute",
    progress: Callable[[int, float], None] | None = None,
    notify: Callable[[str], None] = lambda text: None,
) -> PointEstimate:
    """Elastic constants of a specimen by the particle swarm of the paper.

    Minimises ``misfit`` over the unknowns of the plate file within their bounds under the
    constraints of eq. (9). The swarm runs on the reduced model; what is reported of its best particle
    comes from the full one. ``notify`` is told what takes long before the swarm starts. Raises
    ``ValueError`` if the specimen has no measured frequencies or no unknowns, or if no particle is
    feasible.
    """
    start = time.perf_counter()
    searched = search(specimen, seed, settings=settings, residual=residual, progress=progress, notify=notify)
    return summarise(specimen, searched.model, searched.swarm, searched.error, residual, start)


@dataclass(frozen=True, slots=True)
class Search:
    """What a swarm found and the plate model that it ran on.

    error : (n_modes,) relative error of the solver at its best particle. centre : of the model, as of
    ``reduced_model``.
    """

    model: ReducedModel | LabelledModel
    swarm: SwarmResult
    error: Array
    centre: Array | None


@single_blas_thread
def search(
    specimen: Specimen,
    seed: int,
    *,
    spare: int = 0,
    settings: SwarmSettings | None = None,
    residual: Residual = "absolute",
    progress: Callable[[int, float], None] | None = None,
    notify: Callable[[str], None] = lambda text: None,
) -> Search:
    """The swarm of ``estimate_constants``, on a model of ``spare`` modes more than the list has.

    Frequencies with a label are compared with the mode that has it, the others in ascending order.
    Raises as ``estimate_constants`` does, and ``LabelError`` for labels that the model does not have.
    """
    measurement, unknowns = required(specimen)
    isotropic = specimen.material.isotropic
    settings = settings or SwarmSettings()
    known = tuple((k, v) for k, v in specimen.material.constants.items() if k not in unknowns)
    n_modes = measurement.size + max(spare, spare_modes(measurement))
    centre, solves = None, 0
    for attempt in range(1, _MOST_MODELS + 1):
        reduced = reduced_model(specimen, unknowns, n_modes, centre=centre, notify=notify)
        model = labelled_model(reduced, measurement, specimen)
        rng = np.random.default_rng(seed)
        swarm = minimise(
            _objective(model, measurement, residual),
            unknowns.lower,
            unknowns.upper,
            initial_swarm(replace(unknowns, fixed=known), isotropic, settings.particles, rng),
            settings,
            rng,
            feasible=model.full.admissible,
            progress=progress,
        )
        solves += swarm.evaluations
        error = discretisation_error(model.full, swarm.best)
        if error.max() <= _ACCEPTED_ERROR or attempt == _MOST_MODELS:
            break
        notify("the answer is far from the reference constants: converging the plate model there")
        centre = swarm.best
    return Search(model, replace(swarm, evaluations=solves), error, centre)


def _objective(
    model: ReducedModel | LabelledModel, measurement: Measurement, residual: Residual
) -> Callable[[Array], Array]:
    n = measurement.size
    return lambda x: misfit(model.predict(x).frequencies[:, :n], measurement.frequencies, residual)


def required(specimen: Specimen) -> tuple[Measurement, ParameterSet]:
    """Measured frequencies and unknowns of a specimen; ``ValueError`` if it lacks either."""
    if specimen.measurement is None:
        raise ValueError(f"{specimen.source}: [measurement] is missing, nothing to identify from")
    if not specimen.unknowns.size:
        raise ValueError(f"{specimen.source}: [unknowns] is missing, nothing to identify")
    return specimen.measurement, specimen.unknowns


def summarise(
    specimen: Specimen,
    model: ReducedModel | LabelledModel,
    swarm: SwarmResult,
    error: Array,
    residual: Residual,
    start: float,
) -> PointEstimate:
    """What an engineer needs to know about the swarm's best particle."""
    measurement, unknowns = required(specimen)
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
    sd = linearised_sd(prediction.jacobian[0, order], prior_sd, measurement, noise, residual)
    estimates = tuple(
        _estimate(specimen, name, float(value), float(its_sd))
        for name, value, its_sd in zip(unknowns.names, best, sd, strict=True)
    )
    state = plate_problem(specimen, unknowns).state(unknowns.mapping(best))
    return PointEstimate(
        specimen=specimen,
        constants=estimates,
        predicted=tuple(modes[j] for j in order),
        rms=rms,
        noise=noise,
        noise_is_inferred=inferred,
        error=error[order],
        laminate=flexural_constants(np.real(state.stiffness()), float(state.thickness)),
        model=model.reduced if isinstance(model, LabelledModel) else model,
        swarm=swarm,
        seconds=time.perf_counter() - start,
        warnings=_warnings(measurement, predicted, unknowns.size),
    )


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


def linearised_sd(
    jacobian: Array, prior_sd: Array, measurement: Measurement, noise: float, residual: Residual
) -> Array:
    """Standard deviations of the constants that minimise F, to first order in the noise, (n,).

    The minimum of (f - J x)^T W (f - J x) / s^2 + x^T R x, with W the weights of F, s^2 the mean of
    the weighted variances and R the inverse variances of the search intervals, has the covariance
    A^-1 (J^T W S W J / s^4 + R) A^-1, A = J^T W J / s^2 + R, S = diag((noise f)^2 + resolution^2 / 12).
    A constant that the data leave open keeps the standard deviation of its interval.

    jacobian : (n_modes, n) Hz per unit; prior_sd : (n,).
    """
    if not np.isfinite(noise):
        return np.full(len(prior_sd), np.nan)
    f = measurement.frequencies
    noise_sd = noise * f if measurement.frequency_sd is None else measurement.frequency_sd
    variance = np.maximum(noise_sd**2 + measurement.resolution**2 / 12, (1e-9 * f) ** 2)
    weight = 1.0 / f**2 if residual == "relative" else np.ones_like(f)
    scale = float(np.mean(weight * variance))
    j = jacobian * prior_sd
    inverse = np.linalg.inv(j.T @ (weight[:, None] * j) / scale + np.eye(len(prior_sd)))
    middle = j.T @ ((weight**2 * variance)[:, None] * j) / scale**2 + np.eye(len(prior_sd))
    return np.asarray(np.sqrt(np.diag(inverse @ middle @ inverse)) * prior_sd)


def bound_of(value: float, lower: float, upper: float) -> Literal["lower", "upper"] | None:
    """The bound of its search interval that a constant sits on, if it does."""
    width = upper - lower
    if value - lower < _ON_BOUND * width:
        return "lower"
    return "upper" if upper - value < _ON_BOUND * width else None


def _estimate(specimen: Specimen, name: str, value: float, sd: float) -> ConstantEstimate:
    prior = specimen.unknowns[name].prior
    bound = bound_of(value, prior.lower, prior.upper)
    verdict = verdict_of(sd, prior.sd, at_bound=bound is not None)
    complete = complete_constants(specimen.material.constants, specimen.material.isotropic)
    return ConstantEstimate(name, value, sd, prior.lower, prior.upper, bound, verdict, float(complete[name]))


def _warnings(measurement: Measurement, predicted: Array, n_unknowns: int) -> tuple[str, ...]:
    problems = []
    if measurement.size <= n_unknowns:
        problems.append(
            f"{measurement.size} frequencies for {n_unknowns} unknowns: the bounds decide, "
            "the fit says nothing about its own error"
        )
    problems += units_warning(
        predicted / measurement.frequencies,
        "check the units of the sizes, the density and the frequencies",
        " even for the best constants",
    )
    return tuple(problems)
