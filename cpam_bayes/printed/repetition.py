"""Inversions of noisy lists beside a posterior: single tasks of a noise study, and the test of agreement.

In a linear model with Gaussian noise and distant bounds, inversions that weight the frequencies by their
noise scatter about the truth exactly as widely as the posterior. Each `Cause` of a difference violates one
of these conditions, and each has a number that shows whether it does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.signal import find_peaks
from scipy.stats import f as f_distribution
from scipy.stats import t as t_distribution

from cpam_bayes.forward_model.model import ForwardModel
from cpam_bayes.identification.point import linearised_covariance
from cpam_bayes.identification.search import misfit
from cpam_bayes.inference.assessment import cutting_constraints
from cpam_bayes.inference.ensemble import EnsembleSettings
from cpam_bayes.inference.laplace import maximised
from cpam_bayes.inference.posterior import Posterior, gauss_newton_covariance, plate_posterior
from cpam_bayes.inference.sampling import sample_posterior
from cpam_bayes.inference.swarm import SwarmResult, SwarmSettings, material_swarm, minimise
from cpam_bayes.parameters import ParameterSet
from cpam_bayes.plate import Constraint, Hybrid, Material, Measurement
from cpam_bayes.running import single_blas_thread

Array = NDArray[Any]
Cause = Literal[
    "missed", "bounds", "open", "optima", "skewed", "reordered", "weights", "misfit", "stopped", "unexplained"
]

# Groups of values are separate where the gap between them is this many times their width.
_GAP: Final = 3.0
Interpretation = Literal["relative", "rms"]
INTERPRETATIONS: Final[tuple[Interpretation, ...]] = get_args(Interpretation)
# Most draws for one frequency before a list is given up: at the largest level accepted more than half of all
# draws are positive.
_MAX_DRAWS = 1000
# A constant this close to a bound, as a fraction of the search interval, is on it; draws count as next to
# a bound from further away, since a density has no point on it.
_ON_BOUND, _NEXT_TO_BOUND = 1e-3, 1e-2
# Streams of random numbers of one group.
_NOISE, _SWARM = 0, 1
# Most swarms on one list before it is given up, and the tolerance within which two found the same.
_MAX_SWARMS, _LEFT_BY_SWARM = 5, 5e-4
# Most steps to the most probable constants, and the gain, nats, that ends them.
_STEPS, _PROMISED = 60, 1e-9
# The posterior's value in place of a group number.
POSTERIOR = 2**32 - 1


# Probability of a false alarm of either test of agreement.
_FALSE_ALARM: Final = 0.01
# Fraction of the inversions, or of the posterior's draws, at a bound, from which bounds count.
_AT_BOUND: Final = 0.1
# Posterior sd over prior sd from which the interval rather than the data determines the width.
_OPEN: Final = 0.5
# Skewness of a posterior beyond which its mean is not at its mode: a Gaussian's is 0, an exponential's 2.
_SKEWED: Final = 0.5
# Fraction of inversions that are worse than the constants found without noise.
_MISSED: Final = 0.1
# Fraction of the perturbed lists in which modes changed places.
_REORDERED: Final = 0.2
# Linearised sd of the minimum of eq. (7) over that of the posterior from which its weights matter.
_WEIGHTS: Final = 1.25
# Distance of the inversion without noise from the posterior's mode, in posterior sd, that is due to residuals
# of the list if their rms is above this many sd of the noise, else to a swarm that stopped early.
_OFFSET, _RESIDUAL = 0.3, 0.1


@dataclass(frozen=True, slots=True)
class Evidence:
    """The results of one constant at one level of noise.

    groups : number of inversions; repetition_mean, repetition_sd : over these (sd with groups - 1).
    posterior_mean, posterior_sd, effective : of the posterior and its effective number of draws.
    repetition_at_bound : fraction of inversions that ended on a bound.
    posterior_at_bound : fraction of draws next to one.
    clusters : of the inversions; peaks, skewness : of the posterior's density.
    contraction : posterior sd over prior sd.
    reordered : fraction of perturbed lists in which modes changed places.
    missed : fraction of inversions whose swarms did not find the minimum.
    weighting : linearised sd of the minimum of eq. (7) over that of the posterior.
    offset : the inversion of the list without noise less the posterior's mode, in posterior sd.
    residual : rms residual of that inversion over the noise's standard deviations.
    """

    groups: int
    repetition_mean: float
    repetition_sd: float
    posterior_mean: float
    posterior_sd: float
    effective: float
    repetition_at_bound: float
    posterior_at_bound: float
    clusters: int
    peaks: int
    skewness: float
    contraction: float
    reordered: float
    missed: float
    weighting: float
    offset: float
    residual: float


@dataclass(frozen=True, slots=True)
class Comparison:
    """Agreement of repetition and posterior.

    standard_error : of the mean over the groups, sd / sqrt(groups).
    shift : mean of the inversions less the posterior's, in combined standard errors.
    sd_ratio : their sd over the posterior's.
    causes : empty where both agree within chance, "unexplained" where no number indicates a cause.
    """

    standard_error: float
    shift: float
    sd_ratio: float
    means_agree: bool
    sds_agree: bool
    causes: tuple[Cause, ...]


def compare(evidence: Evidence) -> Comparison:
    """Test means and standard deviations against each other and list possible causes of a difference.

    Means: a t-test of the difference with groups - 1 degrees of freedom; standard deviations: an
    F-test of their squared ratio with groups - 1 and effective - 1; each with a false alarm in 1 %.
    A cause is listed where its number exceeds its threshold and it can act in that direction.
    """
    n = evidence.groups
    error = evidence.repetition_sd / np.sqrt(n)
    combined = float(np.hypot(error, evidence.posterior_sd / np.sqrt(max(evidence.effective, 1.0))))
    difference = evidence.repetition_mean - evidence.posterior_mean
    shift = difference / combined if combined > 0.0 else float(np.copysign(np.inf, difference))
    ratio = evidence.repetition_sd / evidence.posterior_sd if evidence.posterior_sd > 0.0 else np.inf
    half = _FALSE_ALARM / 2
    means = bool(abs(shift) <= t_distribution.ppf(1 - half, n - 1)) or difference == 0.0
    freedom = (n - 1, max(evidence.effective - 1.0, 1.0))
    low, high = (float(f_distribution.ppf(p, *freedom)) for p in (half, 1 - half))
    sds = bool(low <= ratio**2 <= high)
    causes = () if means and sds else _causes(evidence, float(ratio), sds)
    return Comparison(float(error), float(shift), float(ratio), means, sds, causes)


def _causes(evidence: Evidence, ratio: float, sds: bool) -> tuple[Cause, ...]:
    """Possible causes of a difference; sds : whether the standard deviations agree."""
    at_bound = max(evidence.repetition_at_bound, evidence.posterior_at_bound) >= _AT_BOUND
    signs: dict[Cause, bool] = {
        "missed": evidence.missed >= _MISSED,
        "bounds": at_bound,
        "open": evidence.contraction >= _OPEN,
        "optima": max(evidence.clusters, evidence.peaks) > 1,
        "skewed": abs(evidence.skewness) >= _SKEWED,
        "reordered": evidence.reordered >= _REORDERED,
        # weights other than the noise's can only widen the scatter
        "weights": not sds and ratio > 1.0 and evidence.weighting >= _WEIGHTS,
        "misfit": abs(evidence.offset) >= _OFFSET and evidence.residual >= _RESIDUAL,
        "stopped": abs(evidence.offset) >= _OFFSET and evidence.residual < _RESIDUAL,
    }
    return tuple(cause for cause, shown in signs.items() if shown) or ("unexplained",)


def clusters(values: Array) -> int:
    """Number of clusters, one or two, of a few values (n,).

    Two where the widest gap with at least two values on either side is more than three times the
    standard deviation within the sides, which is very rare for draws of one Gaussian.
    """
    x = np.sort(np.asarray(values, dtype=float))
    n = len(x)
    if n < 4:
        return 1
    gaps = np.diff(x)[1 : n - 2]
    cut = 2 + int(np.argmax(gaps))
    within = np.sqrt((cut * x[:cut].var() + (n - cut) * x[cut:].var()) / (n - 2))
    return 2 if gaps.max() > _GAP * within else 1


def density_peaks(draws: Array, bins: int = 60) -> int:
    """Number of separate peaks of the density of many draws (m,).

    A histogram between the 0.1 % and 99.9 % quantiles is smoothed with a Gaussian of two bins; two
    peaks of at least a tenth of the highest are separate where the density between them falls below half of
    the lower one.
    """
    low, high = np.quantile(draws, (0.001, 0.999))
    if not high > low:
        return 1
    width = 2.0
    kernel = np.exp(-0.5 * (np.arange(-8, 9) / width) ** 2)
    count, _ = np.histogram(draws, bins=bins, range=(low, high))
    # density at a bound would leak out over it: it is mirrored at both ends
    mirrored = np.concatenate((count[7::-1], count, count[:-9:-1])).astype(float)
    density = np.convolve(mirrored, kernel / kernel.sum(), mode="valid")
    # between zeros, the height of the highest peak counts in full
    _, properties = find_peaks(np.pad(density, 1), height=0.1 * density.max(), prominence=0.0)
    return int(np.count_nonzero(properties["prominences"] > 0.5 * properties["peak_heights"]))


def skewness(draws: Array) -> float:
    """Third standardised moment of draws (m,), 0 where they do not vary."""
    away = np.asarray(draws - np.mean(draws))
    sd = float(np.sqrt(np.mean(away**2)))
    return float(np.mean(away**3)) / sd**3 if sd > 0.0 else 0.0


@dataclass(frozen=True, slots=True)
class PerturbedList:
    """A perturbed list, in ascending order as a laboratory writes it down.

    frequencies : (n,) Hz.
    reordered : whether two modes changed places, so that the i-th frequency is no longer the i-th mode's.
    redrawn : frequencies that were drawn again because they were not positive.
    """

    frequencies: Array
    reordered: bool
    redrawn: int


def perturbation_sd(frequencies: Array, level: float, interpretation: Interpretation) -> Array:
    """Standard deviations of the noise added to frequencies (n,), Hz.

    Eq. (12) as printed, b = p_e / sqrt(n_s (sum omega_i)^2), has the unit of 1/frequency and cannot
    be right. Two interpretations have the unit of a frequency, p_e being the level as a fraction:

    * "relative": b_i = p_e f_i, each frequency with its own standard deviation, the usual meaning of 1 % of
      noise;
    * "rms": b = p_e sqrt(sum f_i^2 / n_s), one for all modes, the form of Liu and Han (Computational
      Inverse Techniques in Nondestructive Evaluation, 2003) that eq. (12) goes back to. The lowest
      modes then have a much larger relative noise than the highest.
    """
    if interpretation == "relative":
        return np.asarray(level * frequencies)
    return np.full(len(frequencies), level * np.sqrt(np.mean(np.square(frequencies))))


def perturbed_list(frequencies: Array, sd: Array, rng: np.random.Generator) -> PerturbedList:
    """A list (n,) with independent Gaussian noise of standard deviations sd (n,), Hz.

    The paper draws normal numbers by the Box-Muller transform, numpy by the ziggurat; both are normal.

    A frequency that would not be positive is drawn again. Raises ``ValueError`` where that does not
    end, for a frequency that is not positive itself.
    """
    perturbed = frequencies + sd * rng.standard_normal(len(frequencies))
    redrawn = 0
    for _ in range(_MAX_DRAWS):
        not_positive = ~(perturbed > 0.0)
        if not not_positive.any():
            return PerturbedList(np.sort(perturbed), bool(np.any(np.diff(perturbed) < 0.0)), redrawn)
        redrawn += int(not_positive.sum())
        perturbed[not_positive] = frequencies[not_positive] + sd[not_positive] * rng.standard_normal(
            int(not_positive.sum())
        )
    raise ValueError(f"noise on frequencies: received {frequencies.min():g} Hz, accepted: above zero")


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
    constraints: tuple[Constraint, ...] = ()


@dataclass(frozen=True, slots=True)
class InverseProblem:
    """The inverse problem of a list. unknowns : with the known constants held fixed."""

    model: ForwardModel
    unknowns: ParameterSet
    material: Material | Hybrid
    swarm: SwarmSettings


@dataclass(frozen=True, slots=True)
class Shared:
    """The common input of all tasks. reference : (n,) constants identified without noise."""

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
        """Seeds unique to this task; the level counts in millionths."""
        return [seed, round(1e6 * self.level), INTERPRETATIONS.index(self.reading), self.group]


@dataclass(frozen=True, slots=True)
class Inversion:
    """One noisy list and its inversion by the swarm.

    swarms : number that were needed.
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
    """Invert a noisy list or sample the posterior, as the task requires, independently of other tasks."""
    return _sample(shared, task) if task.group == POSTERIOR else _invert(shared, task)


@single_blas_thread
def swarm_value(shared: tuple[InverseProblem, Array], seed: int) -> float:
    """F of eq. (7) where the swarm of one seed ends, Hz^2, as in ``identify`` with this seed."""
    problem, frequencies = shared
    return _minimum(problem, frequencies, np.random.default_rng(seed)).value


def equally_good(value: float, other: float, frequencies: Array) -> bool:
    """Whether a swarm that ended at F = value is no worse than F = other, within a swarm's accuracy.

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
    then started, and the best of them counts.
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
    # neither rounding nor the solver's error: the noisy lists have only the added noise
    known = replace(shared.measurement, frequency_sd=sd, relative_std=None, resolution=0.0)
    posterior = plate_posterior(shared.problem.model, known, np.zeros(len(f)))
    seed = int(np.random.SeedSequence(task.seeds(shared.seed)).generate_state(1)[0])
    result = sample_posterior(posterior, seed, settings=shared.chains, swarm_settings=shared.problem.swarm)
    draws, parameters = result.draws, posterior.parameters
    # the most probable constants: with uniform priors those of the swarm's least misfit
    start = posterior.scores.to_z(shared.reference[None])
    best = posterior.scores.to_x(maximised(posterior, start, _STEPS, _PROMISED, weight=1.0).z[0])
    near = _NEXT_TO_BOUND * (parameters.upper - parameters.lower)
    next_to = (draws < parameters.lower + near) | (draws > parameters.upper - near)
    scale = parameters.prior_sd
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


def _cutting(problem: InverseProblem, draws: Array) -> tuple[Constraint, ...]:
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
