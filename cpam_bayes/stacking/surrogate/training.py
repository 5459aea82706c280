"""The log evidence of sequences learned in rounds: where it may be high first, then where the mass is."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.parallel import run
from cpam_bayes.stacking.conditional.bases import NEAR, about, roughly
from cpam_bayes.stacking.conditional.evaluation import Evaluated, evaluate, merged, neighbours, with_optima
from cpam_bayes.stacking.conditional.posterior import ConditionalPosterior
from cpam_bayes.stacking.features import PlySums
from cpam_bayes.stacking.surrogate.surrogate import Surrogate, fit_surrogate

Array = NDArray[Any]

# Evenly drawn sequences are sampled with so many points: most are hopeless.
_FIRST_POINTS = 4
# Optima that are kept of each sequence.
_OPTIMA = 2
# Sequences among which those are looked for whose evidence may be high, and how many at a time; how far
# below the best it may be, nats.
_POOL, _POOL_ROWS, _HOPE = 12_000, 1000, 8.0
# Temperature of the sequences of which one angle is changed.
_CHANGED = 3.0
# Sweeps of Gibbs' sampler, and the pieces that its chains are shared out in.
_SWEEPS, _CHAIN_PIECES = 3, 4
# Root mean square error, nats, from which on the region of the posterior is known.
_FOUND = 4.0


@dataclass(frozen=True, slots=True)
class TrainingSettings:
    """How the surrogate is learned.

    first : sequences drawn evenly. explorations : rounds that look where the evidence may be high.
    each_round : sequences that join a round. most : of all. error : root mean square error, nats, on fresh
    draws from the posterior that ends the learning where the sequences that count are few enough to be
    computed one by one; fine : where they are not. log2_points : of the importance sampling of each sequence.
    """

    first: int = 300
    explorations: int = 6
    each_round: int = 180
    most: int = 2000
    error: float = 0.2
    fine: float = 0.1
    log2_points: int = 7


@dataclass(frozen=True, slots=True)
class TrainedSurrogate:
    """A surrogate, the sequences that it was learned from, and the posterior on a basis about the mass."""

    surrogate: Surrogate
    data: Evaluated
    focused: ConditionalPosterior


@dataclass(frozen=True, slots=True)
class TrainingProblem:
    """What is learned: the posteriors of the constants, over the ply sums of the sequences.

    images : (n_images, d) changes of sign of the features that change no frequency. starts : (2, n) of
    every climb. library : (p, n_constants) constants that climbs may start from.
    """

    conditional: ConditionalPosterior
    sums: PlySums
    images: Array
    starts: Array
    library: Array
    settings: TrainingSettings
    executor: Executor | None


def train(
    problem: TrainingProblem,
    rng: np.random.Generator,
    notify: Callable[[str], None],
    seeds: Array | None = None,
) -> TrainedSurrogate:
    """The surrogate, by rounds, on reduced bases that are made for where the rounds go.

    Evenly drawn sequences come first, then such of which the surrogate does not know that they are far
    below the best, so that no region is overlooked. Then, round after round, sequences are drawn from the
    posterior as the surrogate has it, a quarter each at temperatures 1, 2 and 4, and join, with good ones of
    which one angle is changed. Those of temperature 1 tell its error before they do.

    seeds : (m, k) sequences that may be good, to be looked at before the others.
    """
    own, sums, settings = problem.conditional, problem.sums, problem.settings
    g, k = len(sums.grid_deg), sums.n_unknown
    rough = roughly(own, rng)
    sequences = np.unique(rng.integers(g, size=(settings.first, k)), axis=0)
    notify(f"log evidence of {len(sequences)} sequences drawn evenly")
    if seeds is not None:
        sequences = np.unique(np.concatenate((sequences, seeds)), axis=0)
    data = _evaluated(problem, rough, sequences, problem.starts, _FIRST_POINTS)
    surrogate = None
    for _ in range(settings.explorations):
        surrogate = _fitted(problem, data, rng, np.inf, np.inf, surrogate)
        drawn = _hopeful(surrogate, sums, data, settings.each_round, rng)
        if not len(drawn):
            break
        both = _starts(surrogate, problem, data, drawn)
        data = merged(data, _evaluated(problem, rough, drawn, both, _FIRST_POINTS))
        notify(f"{len(data.sequences)} sequences looked at, where the evidence may be high")
    surrogate = _fitted(problem, data, rng, np.inf, np.inf, surrogate)
    return train_further(TrainedSurrogate(surrogate, data, rough), problem, settings.error, rng, notify)


def train_further(
    trained: TrainedSurrogate,
    problem: TrainingProblem,
    error: float,
    rng: np.random.Generator,
    notify: Callable[[str], None],
) -> TrainedSurrogate:
    """A surrogate learned on from draws from the posterior until its error on them, nats, is small enough."""
    own, sums, settings, executor = problem.conditional, problem.sums, problem.settings, problem.executor
    surrogate, data, near = trained.surrogate, trained.data, trained.focused
    found = np.isfinite(surrogate.rms_error)
    rms, worst, before, idle = surrogate.rms_error, surrogate.largest_error, np.inf, 0
    while True:
        # one round may by chance have met nothing new
        enough = max(rms, before) <= error or idle > 1 or len(data.sequences) >= settings.most
        drawn, cold = (data.sequences[:0], np.zeros(0, dtype=bool))
        if not enough:
            drawn, cold = _draws(surrogate, sums, data, settings.each_round, rng, executor)
        if not len(drawn):  # or every sequence that counts is known
            if not found:
                near, data = _on_own_basis(problem, data, rng)
                surrogate = _fitted(problem, data, rng, rms, worst, None)
            return TrainedSurrogate(surrogate, data, near)
        idle = 0 if cold.any() else idle + 1
        both = _starts(surrogate, problem, data, drawn)
        fresh = _evaluated(problem, near, drawn, both, settings.log2_points)
        miss = surrogate.values(sums.features(drawn[cold])) - fresh.log_evidence[cold]
        before = rms
        if len(miss):
            rms, worst = float(np.sqrt(np.mean(miss**2))), float(np.abs(miss).max())
        data = merged(data, fresh)
        like: Surrogate | None = surrogate
        if rms < _FOUND:
            if found:
                near = about(own, sums.grid_deg, data, rng)
            else:  # what the rough basis gave is not good enough next to the top, nor are its length scales
                near, data = _on_own_basis(problem, data, rng)
                like = None
            found = True
        surrogate = _fitted(problem, data, rng, rms, worst, like)
        so_far = f", to {rms:.2f} nats" if np.isfinite(rms) else ""
        notify(f"log evidence learned from {len(data.sequences)} sequences{so_far}")


def retrain(
    trained: TrainedSurrogate, problem: TrainingProblem, fresh: Evaluated, rng: np.random.Generator
) -> TrainedSurrogate:
    """The surrogate learned from further sequences as well, and a basis that is made for them too."""
    data = merged(trained.data, fresh)
    old = trained.surrogate
    surrogate = _fitted(problem, data, rng, old.rms_error, old.largest_error, old)
    return TrainedSurrogate(surrogate, data, about(problem.conditional, problem.sums.grid_deg, data, rng))


def _evaluated(
    problem: TrainingProblem, own: ConditionalPosterior, sequences: Array, starts: Array, log2_points: int
) -> Evaluated:
    """Sequences (m, k) climbed from starts and from the library, with the optima that count most."""
    found = evaluate(
        own, problem.sums.grid_deg, sequences, starts, log2_points, problem.executor, problem.library
    )
    return with_optima(found, _OPTIMA)


def _fitted(
    problem: TrainingProblem,
    data: Evaluated,
    rng: np.random.Generator,
    rms: float,
    worst: float,
    before: Surrogate | None,
) -> Surrogate:
    return fit_surrogate(problem.conditional, problem.sums, problem.images, data, rng, rms, worst, before)


def _starts(surrogate: Surrogate, problem: TrainingProblem, data: Evaluated, sequences: Array) -> Array:
    """Two starts of sequences (m, k), the nearest optimum and the first of the common ones, (m, 2, n)."""
    sums = problem.sums
    around = neighbours(sums.features(data.sequences), data.fits.x, surrogate.smooth.lengths, problem.images)
    near = around.nearest(sums.features(sequences))
    return np.stack((near, np.broadcast_to(problem.starts[0], near.shape)), axis=1)


def _hopeful(surrogate: Surrogate, sums: PlySums, data: Evaluated, n: int, rng: np.random.Generator) -> Array:
    """New sequences (up to n) of which the surrogate does not know that they are far below the best."""
    g, k = len(sums.grid_deg), sums.n_unknown
    if g**k <= _POOL:
        pool = np.stack(np.unravel_index(np.arange(g**k), (g,) * k), axis=1)
    else:
        pool = np.unique(rng.integers(g, size=(_POOL, k)), axis=0)
    known = {tuple(s) for s in data.sequences}
    pool = pool[[tuple(s) not in known for s in pool]]
    pieces = np.array_split(pool, max(len(pool) // _POOL_ROWS, 1))
    value = np.concatenate([surrogate.optimistic(sums.features(p)) for p in pieces])
    hopeful = np.flatnonzero(value > surrogate.top - _HOPE)
    return np.asarray(pool[np.sort(rng.permutation(hopeful)[:n])])


def _on_own_basis(
    problem: TrainingProblem, data: Evaluated, rng: np.random.Generator
) -> tuple[ConditionalPosterior, Evaluated]:
    """The basis about the posterior, and sequences next to the top computed again on it."""
    own, sums = problem.conditional, problem.sums
    near = about(own, sums.grid_deg, data, rng)
    data = _again(near, sums, data, problem.settings, problem.executor)
    return about(own, sums.grid_deg, data, rng), data  # now that better draws are known


def _again(
    focused: ConditionalPosterior,
    sums: PlySums,
    data: Evaluated,
    settings: TrainingSettings,
    executor: Executor | None,
) -> Evaluated:
    """The data with those near the top evaluated anew."""
    some = data.log_evidence > data.log_evidence.max() - NEAR
    fresh = evaluate(
        focused,
        sums.grid_deg,
        data.sequences[some],
        focused.axes.to_x(data.fits.optima[some]),
        settings.log2_points,
        executor,
    )
    return merged(data[~some], fresh)


def _draws(
    surrogate: Surrogate,
    sums: PlySums,
    data: Evaluated,
    n: int,
    rng: np.random.Generator,
    executor: Executor | None,
) -> tuple[Array, Array]:
    """New sequences, n or fewer, and which of them were drawn by Gibbs' sampler at temperature 1, bool.

    Each chain starts from a sequence that was evaluated, drawn by its evidence at its temperature. Some
    sequences do not heed the surrogate, which may be wrong about them: good ones with one angle changed.
    """
    temperature = np.repeat([1.0, 2.0, 4.0, _CHANGED], -(-n // 4))[:n]
    g, k = len(sums.grid_deg), sums.n_unknown
    state = np.empty((n, k), dtype=np.int64)
    for t in np.unique(temperature):
        w = np.exp((data.log_evidence - data.log_evidence.max()) / max(t, 2.0))
        own = np.flatnonzero(temperature == t)
        state[own] = data.sequences[rng.choice(len(w), size=len(own), p=w / w.sum())]
    changed = np.flatnonzero(temperature == _CHANGED)
    state[changed, rng.integers(k, size=len(changed))] = rng.integers(g, size=len(changed))
    moving = np.flatnonzero(temperature != _CHANGED)
    uniform = rng.uniform(size=(len(moving), _SWEEPS * k))
    items = [
        (state[rows], temperature[rows], uniform[part])
        for part in np.array_split(np.arange(len(moving)), _CHAIN_PIECES)
        for rows in [moving[part]]
        if len(rows)
    ]
    state[moving] = np.concatenate(run(_gibbs, (surrogate, sums), items, executor, batch_size=1))
    _, first = np.unique(state, axis=0, return_index=True)
    known = {tuple(s) for s in data.sequences}
    new = np.array([i for i in np.sort(first) if tuple(state[i]) not in known], dtype=np.int64)
    return state[new], temperature[new] == 1.0


def _gibbs(shared: tuple[Surrogate, PlySums], item: tuple[Array, Array, Array]) -> Array:
    """Chains (m, k) after sweeps of Gibbs' sampler at temperatures (m,), by uniform numbers (m, steps)."""
    surrogate, sums = shared
    state, temperature, uniform = item
    m, k = state.shape
    g = len(sums.grid_deg)
    both = np.concatenate((sums.first, sums.rest), axis=2)
    total = sums.features(state)
    for step in range(uniform.shape[1]):
        j = step % k
        without = total - both[j][state[:, j]]
        candidates = (without[:, None, :] + both[j][None, :, :]).reshape(m * g, -1)
        value = surrogate.values(candidates).reshape(m, g) / temperature[:, None]
        cumulative = np.cumsum(np.exp(value - value.max(axis=1, keepdims=True)), axis=1)
        pick = uniform[:, step] * cumulative[:, -1]
        state[:, j] = np.minimum((cumulative < pick[:, None]).sum(axis=1), g - 1)
        total = without + both[j][state[:, j]]
    return state
