"""One task of a noise study: a noisy list inverted by the swarm, or the posterior at that noise sampled."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.identification.point import linearised_covariance
from cpam_bayes.identification.search import misfit
from cpam_bayes.inference.chains.ensemble import EnsembleSettings
from cpam_bayes.inference.chains.sampling import sample_posterior
from cpam_bayes.inference.diagnostics.constraints import cutting_constraints
from cpam_bayes.inference.laplace import gauss_newton_covariance, optimise, prior_sd
from cpam_bayes.inference.posterior import ForwardModel, Posterior, plate_posterior
from cpam_bayes.inference.swarm.pso import SwarmResult, SwarmSettings, material_swarm, minimise
from cpam_bayes.parameters import ParameterSet
from cpam_bayes.plate import Hybrid, Material, Measurement
from cpam_bayes.repetition.agreement import density_peaks, skewness
from cpam_bayes.repetition.perturbation import (
    INTERPRETATIONS,
    Interpretation,
    perturbation_sd,
    perturbed_list,
)
from cpam_bayes.threads import single_blas_thread

Array = NDArray[Any]

# A constant this close to a bound, as a fraction of the search interval, sits on it; draws count
# as next to a bound from further away, since a density has no point on it.
_ON_BOUND, _NEXT_TO_BOUND = 1e-3, 1e-2
# Streams of random numbers of one group.
_NOISE, _SWARM = 0, 1
# Swarms on one list before it is given up, and what two that found the same leave between them.
_MAX_SWARMS, _LEFT_BY_SWARM = 5, 5e-4
# In place of the number of a group, for the posterior.
POSTERIOR = 2**32 - 1


@dataclass(frozen=True, slots=True)
class PosteriorSummary:
    """A posterior at a known noise, SI.

    mean, sd, q025, q975 (quantiles), skewness, contraction (sd over the prior's), next_to_bound (fraction of
    draws): (n,).

    peaks : (n,) of each marginal density.
    best : (n,) optimum next to the inversion without noise.
    linearised_sd, swarm_sd : (n,) to first order at that optimum, of the posterior and of the minimum of
    eq. (7).
    constraints : on the constants of the ply that cut the posterior.
    """

    mean: Array
    sd: Array
    q025: Array
    q975: Array
    skewness: Array
    contraction: Array
    next_to_bound: Array
    peaks: Array
    best: Array
    linearised_sd: Array
    swarm_sd: Array
    effective: float
    converged: bool
    constraints: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class InverseProblem:
    """What a list is inverted with. unknowns : with the known constants fixed in it."""

    model: ForwardModel
    unknowns: ParameterSet
    material: Material | Hybrid
    swarm: SwarmSettings


@dataclass(frozen=True, slots=True)
class Shared:
    """What every task needs. reference : (n,) constants found without noise."""

    problem: InverseProblem
    measurement: Measurement
    reference: Array
    chains: EnsembleSettings
    seed: int


@dataclass(frozen=True, slots=True)
class InversionTask:
    """One noisy list to invert, or, with the group ``POSTERIOR``, one posterior to sample."""

    level: float
    reading: Interpretation
    group: int

    def seeds(self, seed: int) -> list[int]:
        """Numbers that no other task has; the level counts in millionths."""
        return [seed, round(1e6 * self.level), INTERPRETATIONS.index(self.reading), self.group]


@dataclass(frozen=True, slots=True)
class Inversion:
    """One noisy list and what the swarm found from it.

    swarms : that were needed.
    missed : whether even the last of them ended worse than the reference.
    """

    constants: Array
    on_bound: Array
    frequencies: Array
    reordered: bool
    redrawn: int
    converged: bool
    swarms: int
    missed: bool
    solves: int


def run_task(shared: Shared, task: InversionTask) -> Inversion | PosteriorSummary:
    """Invert a noisy list or sample the posterior, as the task says; it depends on nothing else."""
    return _sample(shared, task) if task.group == POSTERIOR else _invert(shared, task)


@single_blas_thread
def swarm_value(shared: tuple[InverseProblem, Array], seed: int) -> float:
    """F of eq. (7) where the swarm of one seed ends, Hz^2: what ``identify`` finds with this seed."""
    problem, frequencies = shared
    return _minimum(problem, frequencies, np.random.default_rng(seed)).value


def equally_good(value: float, other: float, frequencies: Array) -> bool:
    """Whether a swarm that ended at F = value is no worse than F = other, within what a swarm leaves.

    The two may differ by 5e-4 of the root mean square frequency in the rms misfit.
    """
    allowed = _LEFT_BY_SWARM * float(np.linalg.norm(frequencies))
    return bool(np.sqrt(value) <= np.sqrt(other) + allowed)


def _minimum(problem: InverseProblem, frequencies: Array, rng: np.random.Generator) -> SwarmResult:
    """Minimise eq. (7) over the unknowns, as ``identify`` does."""
    unknowns, n = problem.unknowns, len(frequencies)
    return minimise(
        lambda x: misfit(problem.model.predict(x).frequencies[:, :n], frequencies, "absolute"),
        unknowns.lower,
        unknowns.upper,
        material_swarm(problem.material, unknowns, problem.swarm.particles, rng),
        problem.swarm,
        rng,
        feasible=problem.model.admissible,
    )


@single_blas_thread
def _invert(shared: Shared, task: InversionTask) -> Inversion:
    """Add the noise of one group to the list and invert it.

    A swarm that ends where F is larger than at the reference has missed the minimum; another one is
    started then, and the best of them counts.
    """
    problem, f = shared.problem, shared.measurement.frequencies
    seeds = task.seeds(shared.seed)
    sd = perturbation_sd(f, task.level, task.reading)
    noisy = perturbed_list(f, sd, np.random.default_rng([*seeds, _NOISE]))
    at_reference = problem.model.predict(shared.reference[None]).frequencies[:, : len(f)]
    limit = float(misfit(at_reference, noisy.frequencies, "absolute")[0])
    runs: list[SwarmResult] = []
    missed = True
    while missed and len(runs) < _MAX_SWARMS:
        rng = np.random.default_rng([*seeds, _SWARM, len(runs)])
        runs.append(_minimum(problem, noisy.frequencies, rng))
        missed = not equally_good(runs[-1].value, limit, f)
    best = min(runs, key=lambda swarm: swarm.value)
    lower, upper = problem.unknowns.lower, problem.unknowns.upper
    near = _ON_BOUND * (upper - lower)
    return Inversion(
        constants=best.best,
        on_bound=(best.best < lower + near) | (best.best > upper - near),
        frequencies=noisy.frequencies,
        reordered=noisy.reordered,
        redrawn=noisy.redrawn,
        converged=best.status == "converged",
        swarms=len(runs),
        missed=missed,
        solves=sum(swarm.evaluations for swarm in runs),
    )


@single_blas_thread
def _sample(shared: Shared, task: InversionTask) -> PosteriorSummary:
    """Sample the posterior of the list without added noise, the noise being known."""
    f = shared.measurement.frequencies
    sd = perturbation_sd(f, task.level, task.reading)
    # neither rounding nor the solver's error: the noisy lists have none but the noise added
    known = replace(shared.measurement, frequency_sd=sd, relative_std=None, resolution=0.0)
    posterior = plate_posterior(shared.problem.model, known, np.zeros(len(f)))
    seed = int(np.random.SeedSequence(task.seeds(shared.seed)).generate_state(1)[0])
    result = sample_posterior(posterior, seed, settings=shared.chains, swarm_settings=shared.problem.swarm)
    draws, parameters = result.draws, posterior.parameters
    best = optimise(posterior, shared.reference).optimum
    near = _NEXT_TO_BOUND * (parameters.upper - parameters.lower)
    next_to = (draws < parameters.lower + near) | (draws > parameters.upper - near)
    scale = prior_sd(posterior)
    q025, q975 = np.quantile(draws, (0.025, 0.975), axis=0)
    return PosteriorSummary(
        mean=draws.mean(axis=0),
        sd=draws.std(axis=0),
        q025=q025,
        q975=q975,
        skewness=np.array([skewness(column) for column in draws.T]),
        contraction=draws.std(axis=0) / scale,
        next_to_bound=next_to.mean(axis=0),
        peaks=np.array([density_peaks(column) for column in draws.T]),
        best=best,
        linearised_sd=np.sqrt(np.diag(gauss_newton_covariance(posterior, best))),
        swarm_sd=_swarm_sd(posterior, best, scale),
        effective=result.diagnostics.ess_bulk,
        converged=result.status == "converged",
        constraints=_cutting(shared.problem, draws),
    )


def _cutting(problem: InverseProblem, draws: Array) -> tuple[str, ...]:
    """Constraints on the constants of the ply that cut a posterior, draws (m, n)."""
    margins = problem.material.margins(problem.unknowns.mapping(draws))
    return cutting_constraints(margins, problem.material.constraints)


def _swarm_sd(posterior: Posterior, x: Array, scale: Array) -> Array:
    """Standard deviations of the minimum of eq. (7) to first order in the noise, (n,)."""
    measurement = posterior.measurement
    jacobian = posterior.model.predict(x[None], jacobian=True).jacobian
    assert jacobian is not None
    assert measurement.frequency_sd is not None
    noise = float(np.mean(measurement.frequency_sd / measurement.frequencies))
    covariance = linearised_covariance(jacobian[0], scale, measurement, noise, "absolute")
    return np.asarray(np.sqrt(np.diag(covariance)))
