"""The posterior of the constants over all stacking sequences: a mixture of conditional posteriors.

The most probable classes are sampled by emcee, each started from a swarm; the others keep the draws of their
importance sampling. Each class has the weight of its probability.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.deadline import TimeIsUpError, cut_short
from cpam_bayes.inference.chains.ensemble import (
    Diagnostics,
    EnsembleResult,
    EnsembleSettings,
    sample,
    start_positions,
)
from cpam_bayes.inference.chains.sampling import swarm_on_posterior
from cpam_bayes.inference.diagnostics.assessment import thinned
from cpam_bayes.inference.importance import Weighted, weighted
from cpam_bayes.inference.posterior import Posterior
from cpam_bayes.inference.proposal import AdaptationSettings, Proposal, adapted
from cpam_bayes.inference.swarm.pso import SwarmSettings
from cpam_bayes.parallel import counted, run
from cpam_bayes.stacking.conditional.bases import of_sequence
from cpam_bayes.stacking.conditional.posterior import ConditionalFits, ConditionalPosterior
from cpam_bayes.stacking.queries.given_layup import GivenLayup
from cpam_bayes.stacking.records import StackingPosterior
from cpam_bayes.stacking.symmetry.classes import members
from cpam_bayes.threads import single_blas_thread

Array = NDArray[Any]

# Optima with a smaller fraction of a conditional evidence are no starts.
_MIN_START_FRACTION = 1e-3


@dataclass(frozen=True, slots=True)
class MixtureSettings:
    """How the mixture is sampled.

    fraction : of the probability, whose classes are sampled by emcee.
    max_classes : sampled by emcee.
    ensembles, swarm, proposal : of each class.
    points : of the importance sampling that each is compared with.
    draws : of the whole mixture.
    """

    fraction: float = 0.99
    max_classes: int = 20
    ensembles: EnsembleSettings = field(
        default_factory=lambda: EnsembleSettings(
            walkers=32, round_steps=60, r_hat=1.02, effective=400.0, most_steps=3000, lengths=8.0, jumps=0.8
        )
    )
    swarm: SwarmSettings = field(default_factory=lambda: SwarmSettings(particles=16, iterations=20))
    proposal: AdaptationSettings = field(
        default_factory=lambda: AdaptationSettings(rounds=3, draws=700, components=4)
    )
    points: int = 2000
    draws: int = 4000


DEFAULT_SETTINGS = MixtureSettings()


@dataclass(frozen=True, slots=True)
class Moments:
    """Means and standard deviations of n parameters, and their standard errors, (n,) each."""

    mean: Array
    sd: Array
    mean_error: Array
    sd_error: Array


@dataclass(frozen=True, slots=True)
class SampledComponent:
    """The conditional posterior of one class of sequences, by emcee and by importance sampling.

    index : of the class in ``StackingPosterior.top``.
    draws : (d, n) of the chains, about one an autocorrelation time.
    chains, importance : moments by either.
    log_evidence, log_evidence_error : by importance sampling, nats.
    effective, k_hat : effective number of its draws, and shape of its largest weights.
    """

    index: int
    draws: Array
    diagnostics: Diagnostics
    chains: Moments
    importance: Moments
    log_evidence: float
    log_evidence_error: float
    effective: float
    k_hat: float

    @property
    def worst_z(self) -> float:
        """Largest difference of a mean or an sd between emcee and importance sampling, in standard errors."""
        a, b = self.chains, self.importance
        z_mean = (a.mean - b.mean) / np.hypot(a.mean_error, b.mean_error)
        z_sd = (a.sd - b.sd) / np.hypot(a.sd_error, b.sd_error)
        return float(np.max(np.abs(np.concatenate((z_mean, z_sd)))))


@dataclass(frozen=True, slots=True)
class StackingMixture:
    """Equally probable draws of stacking sequence and constants.

    components : the classes sampled by emcee.
    given : a sequence that was asked for, sampled too; its index is -1 where it is not listed.
    parameters : (m, n) SI.
    angles_deg : (m, k).
    origin : (m,) index of the draw's class in ``StackingPosterior.top``, -1 for one that is not listed.
    by_emcee : (m,) bool.
    emcee_fraction : probability of the classes sampled by emcee.
    listed_fraction : probability of the other classes that are listed.
    drawn_fraction : probability of all the rest, which sequences drawn from it represent.
    """

    components: tuple[SampledComponent, ...]
    given: SampledComponent | None
    parameters: Array
    angles_deg: Array
    origin: Array
    by_emcee: Array
    emcee_fraction: float
    listed_fraction: float
    drawn_fraction: float
    seconds: float

    @property
    def converged(self) -> bool:
        """Whether all chains are."""
        return all(c.diagnostics.converged for c in self.sampled)

    @property
    def sampled(self) -> tuple[SampledComponent, ...]:
        """All components sampled by emcee, the sequence asked for included."""
        if self.given is None or any(c.index == self.given.index for c in self.components):
            return self.components
        return (*self.components, self.given)


def n_sampled_classes(answer: StackingPosterior, settings: MixtureSettings = DEFAULT_SETTINGS) -> int:
    """Number of the most probable classes that emcee samples."""
    cumulative = np.cumsum(answer.probability * answer.multiplicity)
    return min(int(np.searchsorted(cumulative, settings.fraction)) + 1, settings.max_classes, len(cumulative))


@single_blas_thread
def sample_mixture(
    answer: StackingPosterior,
    seed: int,
    *,
    given: GivenLayup | None = None,
    settings: MixtureSettings = DEFAULT_SETTINGS,
    executor: Executor | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> StackingMixture:
    """Draws from the posterior of stacking sequence and constants together.

    p(x, s | f) = p(s | f) p(x | s, f).

    given : a sequence to be sampled whatever its probability.
    progress : is called with the classes that are sampled, and with all.

    The same seed gives the same draws whatever the executor.
    """
    start = time.perf_counter()
    n = n_sampled_classes(answer, settings)
    items = [
        (i, answer.top[i], answer.components.fits[i : i + 1], [seed, 6, i])  # numpy takes lists as seeds
        for i in range(n)
    ]
    extra = given is not None and (given.index is None or given.index >= n)
    if given is not None and extra:
        index = len(answer.top) if given.index is None else given.index
        items.append((index, given.angles_deg, given.fits, [seed, 6, index]))
    shared, count = (answer.conditional, settings), counted(progress, len(items))
    results: dict[int, SampledComponent] = {}

    def keep(index: int, component: SampledComponent) -> None:
        results[index] = component
        count(index, component)

    try:
        run(_sampled, shared, items, executor, batch_size=1, on_result=keep, is_limited=True)
    except TimeIsUpError:
        wanted, n = n, next(i for i in range(n + 1) if i not in results)
        if not n:
            keep(0, run(_sampled, shared, items[:1], executor)[0])
            n = 1
        cut_short(f"the constants of {n} of {wanted} sequences were sampled by emcee")
        given = None if extra or (given and (given.index or 0) >= n) else given
    components, given_component = tuple(results[i] for i in range(n)), None
    if given is not None:
        given_component = results[n] if extra else results[given.index or 0]
        if given.index is None:
            given_component = replace(given_component, index=-1)
    rng = np.random.default_rng([seed, 7])
    return _combined(answer, components, given_component, settings.draws, rng, start)


Item = tuple[int, Array, ConditionalFits, list[int]]


def _sampled(shared: tuple[ConditionalPosterior, MixtureSettings], item: Item) -> SampledComponent:
    """The conditional posterior of one class; item : its index, angles, fits and key of the seed."""
    conditional, settings = shared
    index, angles, fits, key = item
    posterior = of_sequence(conditional, angles, conditional.least_noise(fits.x)).at(angles[None])
    seed = int(np.random.SeedSequence(key).generate_state(1)[0])
    rng = np.random.default_rng([seed, 1])
    bests, _, _ = swarm_on_posterior(posterior, seed, settings.swarm)
    # the swarm searches everywhere; the optima of the evidence are not to be missed either
    optima = conditional.axes.to_x(fits.optima[0])
    starts = np.concatenate((optima[fits.weight[0] > _MIN_START_FRACTION][:, : bests.shape[1]], bests))
    n_walkers = settings.ensembles.ensembles * settings.ensembles.walkers
    # the optima first, then the particles from the best on: their misfits only order them
    walkers = start_positions(posterior, starts, np.arange(len(starts), dtype=float), n_walkers, rng)
    start = walkers.reshape(settings.ensembles.ensembles, settings.ensembles.walkers, -1)
    proposal = adapted(posterior, optima, seed, settings.proposal)
    chains = sample(posterior, start, seed, settings.ensembles, proposal=proposal)
    importance, sampled_moments = _importance(posterior, proposal, settings.points, rng)
    return SampledComponent(
        index=index,
        draws=thinned(chains).flat,
        diagnostics=chains.diagnostics,
        chains=_moments_of_chains(chains),
        importance=importance,
        log_evidence=float(sampled_moments.log_evidence[0]),
        log_evidence_error=float(sampled_moments.standard_error[0]),
        effective=float(sampled_moments.effective_size[0]),
        k_hat=float(sampled_moments.k_hat[0]),
    )


def _moments_of_chains(chains: EnsembleResult) -> Moments:
    draws, effective = chains.draws, chains.diagnostics.ess_bulk
    mean, sd = draws.mean(axis=0), draws.std(axis=0)
    kurtosis = np.mean(((draws - mean) / sd) ** 4, axis=0)
    return Moments(mean, sd, sd / np.sqrt(effective), sd * np.sqrt((kurtosis - 1.0) / (4.0 * effective)))


def _importance(
    posterior: Posterior, proposal: Proposal, points: int, rng: np.random.Generator
) -> tuple[Moments, Weighted]:
    """Moments by importance sampling from a proposal, and its weighted draws."""
    x = proposal.draw(points, rng)
    moments = weighted(x[None], (posterior.log_prob(x) - proposal.log_density(x))[None])
    normalised = moments.weight[0][:, None]
    mean = np.sum(normalised * x, axis=0)
    deviation = x - mean
    sd = np.sqrt(np.sum(normalised * deviation**2, axis=0))
    mean_error = np.sqrt(np.sum((normalised * deviation) ** 2, axis=0))
    sd_error = np.sqrt(np.sum((normalised * (deviation**2 - sd**2)) ** 2, axis=0)) / (2.0 * sd)
    return Moments(mean, sd, mean_error, sd_error), moments


def _combined(
    answer: StackingPosterior,
    components: tuple[SampledComponent, ...],
    given: SampledComponent | None,
    size: int,
    rng: np.random.Generator,
    start: float,
) -> StackingMixture:
    n, listed = len(components), len(answer.top)
    mass = answer.probability * answer.multiplicity
    rest = np.flatnonzero(answer.classes_of(answer.drawn.sequences) < 0)
    drawn_fraction = max(1.0 - float(mass.sum()), 0.0) if len(rest) else 0.0
    drawn = answer.draw_weight[rest]
    weight = np.concatenate((mass, drawn_fraction * drawn / max(float(drawn.sum()), 1e-300)))
    weight = weight / weight.sum()
    # systematic resampling: each component as often as its weight says, up to one
    at = (np.arange(size) + rng.uniform()) / size
    chosen = np.minimum(np.searchsorted(np.cumsum(weight), at), len(weight) - 1)
    parameters, sequences = [], []
    for i in np.unique(chosen):
        number = int(np.sum(chosen == i))
        if i < listed:
            draws = components[i].draws if i < n else answer.components.conditionals.draws[i]
            same_class = answer.class_members(i)
        else:
            draws = answer.drawn.conditionals.draws[rest[i - listed]]
            same_class = members(answer.drawn.sequences[rest[i - listed]], answer.symmetries)
        parameters.append(draws[_spread(len(draws), number, rng)])
        sequences.append(same_class[rng.integers(len(same_class), size=number)])
    # in no order, so that any part of the draws is a sample of the whole
    order = rng.permutation(size)
    return StackingMixture(
        components=components,
        given=given,
        parameters=np.concatenate(parameters)[order],
        angles_deg=answer.grid_deg[np.concatenate(sequences)[order]],
        origin=np.where(chosen < listed, chosen, -1)[order],
        by_emcee=(chosen < n)[order],
        emcee_fraction=float(weight[:n].sum()),
        listed_fraction=float(weight[n:listed].sum()),
        drawn_fraction=float(weight[listed:].sum()),
        seconds=time.perf_counter() - start,
    )


def _spread(pool: int, number: int, rng: np.random.Generator) -> Array:
    """Rows of a pool of draws, each used once before any is used again, (number,)."""
    rounds = [rng.permutation(pool) for _ in range(-(-number // pool))]
    return np.concatenate(rounds)[:number]
