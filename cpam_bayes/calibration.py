"""Simulation-based calibration: a test of the posterior on data that follow its model.

Talts, Betancourt, Simpson, Vehtari and Gelman (2018): parameters are drawn from the prior, a list of
frequencies is simulated at them, its posterior is sampled as for any other list, and the true value
is ranked among nearly independent draws. Over many repetitions the ranks are uniform if prior,
likelihood and sampler are all right.

The simulated lists follow the posterior's own model: frequencies of the same forward model with
independent errors of variance (s f)^2 + resolution^2 / 12 + (e f)^2, rounding being Gaussian as in the
likelihood. A list is not sorted afterwards: a complete list is paired with the modes by position. One
difference remains: f is the mode's frequency here and the listed one in the likelihood, a relative shift
of the modes by 2 s^2, or by 2 s sqrt(n_modes) standard deviations of a common factor: 0.05 at the noise
of 1 % that the prior expects.

Counts of uniform ranks, in bins or cumulative, are binomial at each place and dependent between places.
Simultaneous bands and p-values are therefore taken from simulated uniform ranks, as by Säilynoja, Bürkner
and Vehtari (Statistics and Computing 32, 2022): the statistic is the smallest binomial tail probability
over all places.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import Executor
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom, chi2

from cpam_bayes.forward_model.build import reduced_model
from cpam_bayes.forward_model.model import ForwardModel
from cpam_bayes.inference.ensemble import EnsembleResult, EnsembleSettings
from cpam_bayes.inference.posterior import Posterior, plate_posterior
from cpam_bayes.inference.sampling import sample_posterior
from cpam_bayes.inference.swarm import SwarmSettings
from cpam_bayes.parallel import run
from cpam_bayes.plate import Measurement, read_specimen

Array = NDArray[Any]

# Draws that a true value is ranked among: its rank is one of a hundred.
N_DRAWS = 99
# Shorter than for an identification: a rank needs a hundred draws, not the tails.
SETTINGS = EnsembleSettings(walkers=40, round_steps=80, r_hat=1.05, effective=2.0 * N_DRAWS, most_steps=3000)


@dataclass(frozen=True, slots=True)
class Nature:
    """A data-generating model: a forward model and its relative solver errors (n_modes,)."""

    model: ForwardModel
    solver_error: Array


class Source(Protocol):
    """A factory that makes a nature in whichever process needs it; equal sources make equal natures."""

    def __call__(self) -> Nature:
        """The model and its error."""
        ...

    def __hash__(self) -> int:
        """Hash of the parts it is made from: each process makes a nature once."""
        ...


@dataclass(frozen=True, slots=True)
class PlateSource:
    """The reduced model of a plate.

    plate : name of a built-in specimen or path of a plate file.
    n_modes : frequencies in a list.
    """

    plate: str
    n_modes: int

    def __call__(self) -> Nature:
        """The reduced model over the specimen's unknowns, with the solver error of an identification."""
        specimen = read_specimen(self.plate)
        model = reduced_model(specimen, specimen.unknowns, self.n_modes)
        return Nature(model, np.hypot(model.full.error, model.tolerance))


@dataclass(frozen=True, slots=True, eq=False)
class NatureSource:
    """A ready-made nature, passed to other processes as it is."""

    nature: Nature

    def __call__(self) -> Nature:
        """The nature."""
        return self.nature


@dataclass(frozen=True, slots=True)
class Experiment:
    """The common settings of all repetitions.

    source : of the frequencies.
    resolution : Hz.
    relative_std : of the noise, ``None`` to draw it from its prior and infer it.
    seed : of all repetitions; each depends only on it and on its own number.
    n_listed : number of lowest modes in a list, ``None`` for all of the model.
    """

    source: Source
    resolution: float
    relative_std: float | None
    seed: int
    settings: EnsembleSettings = SETTINGS
    swarm: SwarmSettings = field(default_factory=SwarmSettings)
    n_listed: int | None = None


@dataclass(frozen=True, slots=True)
class Repetition:
    """One repetition: the truth and where it lies in its posterior.

    truth : parameters, SI, the noise last where it is inferred.
    ranks : of the true values among ``N_DRAWS`` nearly independent draws.
    below : fractions of all kept draws below the true values.
    ordered : whether the noise left the list in ascending order.
    """

    number: int
    truth: tuple[float, ...]
    ranks: tuple[int, ...]
    below: tuple[float, ...]
    ordered: bool
    converged: bool
    r_hat: float
    autocorrelation_time: float
    effective: float
    steps: int


def calibrate(
    experiment: Experiment,
    repetitions: int,
    *,
    known: Iterable[Repetition] = (),
    executor: Executor | None = None,
    batch_size: int | None = None,
    on_result: Callable[[Repetition], None] = lambda repetition: None,
) -> tuple[Repetition, ...]:
    """Repetitions 0 to n - 1 of an experiment, in order, bit for bit the same on any executor.

    known : repetitions of the same experiment that are not computed again.
    on_result : called with every repetition that was computed, as it ends.
    """
    nature_of(experiment.source)  # an error of the plate file is raised here
    done = {r.number: r for r in known}

    def take(repetition: Repetition) -> None:
        done[repetition.number] = repetition
        on_result(repetition)

    missing = [i for i in range(repetitions) if i not in done]
    if missing:
        run(
            repeat,
            experiment,
            missing,
            executor,
            batch_size=batch_size,
            on_result=lambda index, found: take(found),
        )
    return tuple(done[i] for i in range(repetitions))


def repeat(experiment: Experiment, number: int) -> Repetition:
    """One repetition: draw, simulate, sample, rank."""
    nature = nature_of(experiment.source)
    rng = np.random.default_rng([experiment.seed, number])
    truth, measurement = simulate(experiment, nature, rng)
    posterior = plate_posterior(nature.model, measurement, nature.solver_error)
    sampler_seed = int(rng.integers(2**31))
    result = sample_posterior(
        posterior, sampler_seed, settings=experiment.settings, swarm_settings=experiment.swarm
    )
    chain = second_half(result)
    few = spread_draws(chain, N_DRAWS, rng)
    diagnostics = result.diagnostics
    return Repetition(
        number=number,
        truth=tuple(float(x) for x in truth),
        ranks=tuple(int(r) for r in np.sum(few < truth, axis=0)),
        below=tuple(float(b) for b in np.mean(chain.reshape(-1, len(truth)) < truth, axis=0)),
        ordered=bool(np.all(np.diff(measurement.frequencies) >= 0)),
        converged=diagnostics.converged,
        r_hat=diagnostics.r_hat,
        autocorrelation_time=diagnostics.autocorrelation_time,
        effective=diagnostics.ess_bulk,
        steps=diagnostics.steps,
    )


def simulate(experiment: Experiment, nature: Nature, rng: np.random.Generator) -> tuple[Array, Measurement]:
    """Parameters (n,) drawn from the prior, and a simulated list of frequencies at them."""
    truth = prior_draw(prior_of(experiment, nature), rng)
    model = nature.model
    f = model.predict(truth[None, : model.parameters.size]).frequencies[0]
    s = truth[-1] if experiment.relative_std is None else experiment.relative_std
    variance = (s * f) ** 2 + experiment.resolution**2 / 12 + (nature.solver_error * f) ** 2
    listed = f + np.sqrt(variance) * rng.standard_normal(len(f))
    return truth, _measurement(experiment, listed[: experiment.n_listed])


def prior_draw(posterior: Posterior, rng: np.random.Generator) -> Array:
    """One draw from the prior within the constraints (9), by rejection, (n,)."""
    while True:
        x = posterior.parameters.sample(rng, 16)
        inside = np.isfinite(posterior.log_prior(x))
        if inside.any():
            return np.asarray(x[int(np.argmax(inside))])


def second_half(result: EnsembleResult) -> Array:
    """Draws after the first half of all steps, burn-in included, (ensembles, steps, walkers, n)."""
    return result.chain[:, max(result.diagnostics.steps // 2 - result.diagnostics.burn_in, 0) :]


def spread_draws(chain: Array, n_draws: int, rng: np.random.Generator) -> Array:
    """Draws spread evenly over the steps, from different walkers while there are any left, (n_draws, n).

    chain : (ensembles, steps, walkers, n).
    """
    ensembles, steps, walkers, _ = chain.shape
    at = ((np.arange(n_draws) + 0.5) * steps / n_draws).astype(int)
    who = np.resize(rng.permutation(ensembles * walkers), n_draws)
    return np.asarray(chain[who // walkers, at, who % walkers])


def parameter_names(experiment: Experiment) -> tuple[str, ...]:
    """Names in the order of truths and ranks."""
    return prior_of(experiment, nature_of(experiment.source)).parameters.names


@lru_cache(maxsize=4)
def nature_of(source: Source) -> Nature:
    """The nature made by a source, cached per process."""
    return source()


def prior_of(experiment: Experiment, nature: Nature) -> Posterior:
    """A posterior with the priors of an experiment and a dummy list."""
    listed = np.ones(len(nature.solver_error))[: experiment.n_listed]
    return plate_posterior(nature.model, _measurement(experiment, listed), nature.solver_error)


def _measurement(experiment: Experiment, listed: Array) -> Measurement:
    labels = ("",) * len(listed)
    return Measurement(listed, experiment.resolution, experiment.relative_std, None, labels, complete=True)


# Statistics of ranks

LEVELS = (0.5, 0.8, 0.95)
_SIMULATIONS = 4000


@dataclass(frozen=True, slots=True)
class Band:
    """A simultaneous band of counts of uniform ranks at a given probability, (k,) each."""

    lower: Array
    upper: Array


@dataclass(frozen=True, slots=True)
class Coverage:
    """The fraction of central intervals of probability ``level`` that contain the truth.

    standard_error : binomial, sqrt(level (1 - level) / n).
    """

    level: float
    share: float
    standard_error: float


@dataclass(frozen=True, slots=True)
class Uniformity:
    """Uniformity of the ranks of one parameter.

    counts : (n_bins,) of the rank histogram.
    cumulative : (n_ranks,) number of ranks up to each one.
    chi_square_p, ecdf_p : p-values of the histogram and of the largest departure of the empirical
    distribution from its band.
    corrected_p : the smaller of the two after Holm's correction for all p-values of the same table of
    ranks.
    """

    counts: Array
    cumulative: Array
    chi_square_p: float
    ecdf_p: float
    corrected_p: float


@dataclass(frozen=True, slots=True)
class RankStatistics:
    """Uniformity of every parameter's ranks, with the bands that they share.

    histogram_band : of the counts in bins.
    ecdf_band : of the cumulative counts.
    """

    parameters: tuple[Uniformity, ...]
    histogram_band: Band
    ecdf_band: Band


def rank_statistics(
    ranks: Array,
    n_ranks: int,
    rng: np.random.Generator,
    *,
    n_bins: int = 20,
    probability: float = 0.95,
    simulations: int = _SIMULATIONS,
) -> RankStatistics:
    """Bands of uniform ranks and p-values against uniformity.

    ranks : (n, n_parameters) integers from 0 to n_ranks - 1.
    rng : of the simulated uniform ranks.

    Raises ``ValueError`` for ranks out of range or bins that do not divide them evenly.
    """
    ranks = np.asarray(ranks)
    if ranks.size == 0 or ranks.min() < 0 or ranks.max() >= n_ranks:
        raise ValueError(
            f"ranks: received {ranks.shape} of them, accepted: one or more in 0 to {n_ranks - 1}"
        )
    if n_ranks % n_bins:
        raise ValueError(f"bins: received {n_bins}, accepted: a divisor of {n_ranks}")
    n = len(ranks)
    counts = np.stack([np.bincount(column, minlength=n_ranks) for column in ranks.T])
    simulated = rng.multinomial(n, np.full(n_ranks, 1.0 / n_ranks), size=simulations)
    # the count up to the last rank is always n
    places = np.arange(1, n_ranks) / n_ranks
    cumulative = _Counts(n, places)
    binned = _Counts(n, np.full(n_bins, 1.0 / n_bins))
    simulated_ecdf = cumulative.least_tail(_up_to(simulated))
    simulated_histogram = binned.least_tail(_in_bins(simulated, n_bins))
    observed = cumulative.least_tail(_up_to(counts))
    ecdf_p = (1 + np.sum(simulated_ecdf[None, :] <= observed[:, None], axis=1)) / (simulations + 1)
    histogram = _in_bins(counts, n_bins)
    chi_square = np.sum((histogram - n / n_bins) ** 2, axis=1) / (n / n_bins)
    chi_square_p = chi2.sf(chi_square, n_bins - 1)
    corrected = holm(np.concatenate((chi_square_p, ecdf_p))).reshape(2, -1).min(axis=0)
    return RankStatistics(
        tuple(
            Uniformity(histogram[i], counts[i].cumsum(), float(c), float(e), float(p))
            for i, (c, e, p) in enumerate(zip(chi_square_p, ecdf_p, corrected, strict=True))
        ),
        histogram_band=binned.band(simulated_histogram, probability),
        ecdf_band=cumulative.band(simulated_ecdf, probability),
    )


def holm(p_values: Array) -> Array:
    """p-values (n,) corrected for their number by Holm's step-down method (1979), (n,)."""
    order = np.argsort(p_values, kind="stable")
    n = len(order)
    corrected = np.empty(n)
    corrected[order] = np.minimum(
        1.0, np.maximum.accumulate(np.asarray(p_values)[order] * np.arange(n, 0, -1))
    )
    return corrected


def coverage(below: Array, levels: tuple[float, ...] = LEVELS) -> tuple[Coverage, ...]:
    """Coverage of central intervals of one parameter.

    below : (n,) the fraction of each posterior below the truth; a central interval of probability p
    holds the truth if that fraction is within p / 2 of one half.
    """
    distance = np.abs(np.asarray(below) - 0.5)
    return tuple(
        Coverage(p, float(np.mean(distance <= 0.5 * p)), float(np.sqrt(p * (1 - p) / len(distance))))
        for p in levels
    )


def _up_to(counts: Array) -> Array:
    return np.asarray(np.cumsum(counts, axis=-1)[..., :-1])


def _in_bins(counts: Array, n_bins: int) -> Array:
    return np.asarray(counts.reshape(len(counts), n_bins, -1).sum(axis=-1))


class _Counts:
    """Tabulated tail probabilities of binomial counts of n at k places."""

    def __init__(self, n: int, probability: Array) -> None:
        at = np.arange(n + 1)[:, None]
        self.up_to = np.asarray(binom.cdf(at, n, probability))
        self.from_on = np.asarray(binom.sf(at - 1, n, probability))
        self.places = np.arange(len(probability))

    def least_tail(self, counts: Array) -> Array:
        """Smallest tail probability (m,) over the places of counts (m, k)."""
        both = np.minimum(self.up_to[counts, self.places], self.from_on[counts, self.places])
        return np.asarray(both.min(axis=1))

    def band(self, simulated: Array, probability: float) -> Band:
        """The band that a fraction ``probability`` of the simulated rows never leaves."""
        least = np.sort(simulated)[int((1.0 - probability) * len(simulated))]
        allowed = (self.up_to >= least) & (self.from_on >= least)
        return Band(allowed.argmax(axis=0), len(allowed) - 1 - allowed[::-1].argmax(axis=0))
