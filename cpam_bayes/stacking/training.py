"""Training of the surrogate in rounds: first where the evidence may be high, then where the mass is."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.parallel import run
from cpam_bayes.stacking.conditional import ConditionalPosterior
from cpam_bayes.stacking.evaluation import (
    NEAR,
    Evaluated,
    about,
    evaluate,
    merged,
    neighbours,
    roughly,
    with_optima,
)
from cpam_bayes.stacking.surrogate import Surrogate, fit_surrogate
from cpam_bayes.stacking.symmetry import PlySums, all_sequences

Array = NDArray[Any]

# log2 of the points of importance sampling of evenly drawn sequences, most of which carry no mass.
_FIRST_POINTS = 4
# Optima kept for each sequence.
_OPTIMA = 2
# Evenly drawn sequences among which high evidences are sought, number predicted at a time, and nats below the
# best within which an evidence counts as high.
_POOL, _POOL_ROWS, _HIGH_NATS = 12_000, 1000, 8.0
# Temperatures of Gibbs' sampler, and that of the sequences of which one angle is changed.
_TEMPERATURES, _CHANGED = (1.0, 2.0, 4.0), 3.0
# Sweeps of Gibbs' sampler, and the pieces in which its chains are run.
_SWEEPS, _CHAIN_PIECES = 3, 4
# Root mean square error, nats, below which the region of the posterior is known.
_REGION_KNOWN_RMS = 4.0


@dataclass(frozen=True, slots=True)
class TrainingSettings:
    """Settings of the training of the surrogate.

    initial : evenly drawn sequences.
    exploration_rounds : rounds that seek where the evidence may be high.
    each_round : sequences that join in a round.
    max_size : of the training set.
    rms : root mean square error, nats, on fresh draws from the posterior that ends the training where the
    sequences that count are few enough to be computed one by one.
    fine_rms : the same where they are not.
    log2_points : of the importance sampling of each sequence.
    easy_noise : relative noise above which evenly drawn sequences lead to the posterior.
    noise_factor : with less noise, training begins with the best sequences at so many times the noise.
    seeds, seeds_rms : number of these, and root mean square error, nats, of the surrogate that finds them.
    """

    initial: int = 300
    exploration_rounds: int = 6
    each_round: int = 180
    max_size: int = 2000
    rms: float = 0.2
    fine_rms: float = 0.1
    log2_points: int = 7
    easy_noise: float = 1.5e-3
    noise_factor: float = 3.0
    seeds: int = 600
    seeds_rms: float = 1.0


@dataclass(frozen=True, slots=True)
class TrainedSurrogate:
    """A surrogate, its training set, and the conditional posterior on a basis about the mass."""

    surrogate: Surrogate
    data: Evaluated
    focused: ConditionalPosterior


@dataclass(frozen=True, slots=True)
class TrainingProblem:
    """The function to be approximated: log evidence over the ply sums of the sequences.

    images : (n_images, d) changes of sign of the features that change no frequency.
    starts : (2, n) parameters from which every optimisation starts.
    library : (p, n_constants) constants from which optimisations may start.
    """

    conditional: ConditionalPosterior
    sums: PlySums
    images: Array
    starts: Array
    library: Array
    settings: TrainingSettings
    executor: Executor | None

    def evaluated(
        self, basis: ConditionalPosterior, sequences: Array, starts: Array, log2_points: int
    ) -> Evaluated:
        """Sequences (m, k) evaluated from starts and from the library, with their heaviest optima."""
        grid, executor = self.sums.grid_deg, self.executor
        data = evaluate(basis, grid, sequences, starts, log2_points, executor, self.library)
        return with_optima(data, _OPTIMA)

    def fitted(
        self, data: Evaluated, rng: np.random.Generator, rms: float, largest: float, before: Surrogate | None
    ) -> Surrogate:
        """Surrogate through evaluated sequences."""
        return fit_surrogate(self.conditional, self.sums, self.images, data, rng, rms, largest, before)


def train(
    problem: TrainingProblem,
    rng: np.random.Generator,
    notify: Callable[[str], None],
    seeds: Array | None = None,
) -> TrainedSurrogate:
    """Train the surrogate by rounds, on reduced bases made for the region of each.

    Evenly drawn sequences come first, then those whose evidence is not known to be far below the best, so
    that no region is overlooked. Then, round after round, sequences are drawn from the posterior by the
    surrogate, a quarter each at temperatures 1, 2 and 4, and join, with good ones in which one angle is
    changed. Those of temperature 1 measure its error before they join.

    seeds : (m, k) sequences that may be good, to be evaluated before the others.
    """
    sums, settings = problem.sums, problem.settings
    rough = roughly(problem.conditional, rng)
    g, k = len(sums.grid_deg), sums.n_unknown
    sequences = np.unique(rng.integers(g, size=(settings.initial, k)), axis=0)
    notify(f"log evidence of {len(sequences)} sequences drawn evenly")
    if seeds is not None:
        sequences = np.unique(np.concatenate((sequences, seeds)), axis=0)
    data = problem.evaluated(rough, sequences, problem.starts, _FIRST_POINTS)
    surrogate = None
    for _ in range(settings.exploration_rounds):
        surrogate = problem.fitted(data, rng, np.inf, np.inf, surrogate)
        drawn = _possibly_high(surrogate, sums, data, settings.each_round, rng)
        if not len(drawn):
            break
        starts = _starts(surrogate, problem, data, drawn)
        data = merged(data, problem.evaluated(rough, drawn, starts, _FIRST_POINTS))
        notify(f"{len(data.sequences)} sequences evaluated, where the evidence may be high")
    surrogate = problem.fitted(data, rng, np.inf, np.inf, surrogate)
    return train_further(TrainedSurrogate(surrogate, data, rough), problem, settings.rms, rng, notify)


def train_further(
    trained: TrainedSurrogate,
    problem: TrainingProblem,
    target_rms: float,
    rng: np.random.Generator,
    notify: Callable[[str], None],
) -> TrainedSurrogate:
    """A surrogate trained on draws from the posterior until its error on them, nats, is small enough."""
    sums, settings = problem.sums, problem.settings
    surrogate, data, focused = trained.surrogate, trained.data, trained.focused
    located = np.isfinite(surrogate.rms_error)
    rms, largest, before, idle = surrogate.rms_error, surrogate.largest_error, np.inf, 0
    while True:
        # one round may by chance have found nothing new
        enough = max(rms, before) <= target_rms or idle > 1 or len(data.sequences) >= settings.max_size
        drawn, cold = (data.sequences[:0], np.zeros(0, dtype=bool))
        if not enough:
            drawn, cold = _draws(surrogate, sums, data, settings.each_round, rng, problem.executor)
        if not len(drawn):  # or every sequence that counts is known
            if not located:
                focused, data = _focused(problem, data, rng)
                surrogate = problem.fitted(data, rng, rms, largest, None)
            return TrainedSurrogate(surrogate, data, focused)
        idle = 0 if cold.any() else idle + 1
        starts = _starts(surrogate, problem, data, drawn)
        fresh = problem.evaluated(focused, drawn, starts, settings.log2_points)
        error = surrogate.values(sums.features(drawn[cold])) - fresh.log_evidence[cold]
        before = rms
        if len(error):
            rms, largest = float(np.sqrt(np.mean(error**2))), float(np.abs(error).max())
        data = merged(data, fresh)
        like: Surrogate | None = surrogate
        if rms < _REGION_KNOWN_RMS:
            if located:
                focused = about(problem.conditional, sums.grid_deg, data, rng)
            else:  # evidences on the rough basis are not good enough next to the top, nor are length scales
                focused, data = _focused(problem, data, rng)
                like = None
            located = True
        surrogate = problem.fitted(data, rng, rms, largest, like)
        so_far = f", to {rms:.2f} nats" if np.isfinite(rms) else ""
        notify(f"surrogate trained on {len(data.sequences)} sequences{so_far}")


def retrain(
    trained: TrainedSurrogate, problem: TrainingProblem, fresh: Evaluated, rng: np.random.Generator
) -> TrainedSurrogate:
    """The surrogate with further sequences in its training set, and a basis made for them too."""
    data = merged(trained.data, fresh)
    before = trained.surrogate
    surrogate = problem.fitted(data, rng, before.rms_error, before.largest_error, before)
    return TrainedSurrogate(surrogate, data, about(problem.conditional, problem.sums.grid_deg, data, rng))


def _starts(surrogate: Surrogate, problem: TrainingProblem, data: Evaluated, sequences: Array) -> Array:
    """Two starts (m, 2, n) of sequences (m, k): the nearest optimum and the first of the common ones."""
    sums, lengths = problem.sums, surrogate.process.lengths
    around = neighbours(sums.features(data.sequences), data.fits.x, lengths, problem.images)
    near = around.nearest(sums.features(sequences))
    return np.stack((near, np.broadcast_to(problem.starts[0], near.shape)), axis=1)


def _possibly_high(
    surrogate: Surrogate, sums: PlySums, data: Evaluated, n: int, rng: np.random.Generator
) -> Array:
    """New sequences (up to n) whose evidence, by the surrogate and its error, is not far below the best."""
    g, k = len(sums.grid_deg), sums.n_unknown
    few = g**k <= _POOL
    pool = all_sequences(g, k) if few else np.unique(rng.integers(g, size=(_POOL, k)), axis=0)
    pool = pool[_new(pool, data)]
    pieces = np.array_split(pool, max(len(pool) // _POOL_ROWS, 1))
    upper = np.concatenate([surrogate.upper_bound(sums.features(p)) for p in pieces])
    high = np.flatnonzero(upper > surrogate.top - _HIGH_NATS)
    return np.asarray(pool[np.sort(rng.permutation(high)[:n])])


def _new(sequences: Array, data: Evaluated) -> NDArray[np.bool_]:
    """Mask (m,) of the sequences (m, k) that are not in the training set."""
    known = {tuple(s) for s in data.sequences}
    return np.array([tuple(s) not in known for s in sequences], dtype=bool)


def _focused(
    problem: TrainingProblem, data: Evaluated, rng: np.random.Generator
) -> tuple[ConditionalPosterior, Evaluated]:
    """Basis about the posterior, and the training set with the sequences near the top evaluated on it."""
    grid = problem.sums.grid_deg
    focused = about(problem.conditional, grid, data, rng)
    high = data.log_evidence > data.log_evidence.max() - NEAR
    starts = focused.axes.to_x(data.fits.optima[high])
    fresh = evaluate(
        focused, grid, data.sequences[high], starts, problem.settings.log2_points, problem.executor
    )
    data = merged(data[~high], fresh)
    return about(problem.conditional, grid, data, rng), data  # now that better draws are known


def _draws(
    surrogate: Surrogate,
    sums: PlySums,
    data: Evaluated,
    n: int,
    rng: np.random.Generator,
    executor: Executor | None,
) -> tuple[Array, Array]:
    """New sequences, n or fewer, and mask of those drawn by Gibbs' sampler at temperature 1.

    Each chain starts from an evaluated sequence, drawn by its evidence at its temperature. Some sequences are
    independent of the surrogate, which may be wrong about them: good ones with one angle changed.
    """
    temperature = np.repeat([*_TEMPERATURES, _CHANGED], -(-n // 4))[:n]
    g, k = len(sums.grid_deg), sums.n_unknown
    state = np.empty((n, k), dtype=np.int64)
    for t in np.unique(temperature):
        w = np.exp((data.log_evidence - data.log_evidence.max()) / max(t, 2.0))
        chains = np.flatnonzero(temperature == t)
        state[chains] = data.sequences[rng.choice(len(w), size=len(chains), p=w / w.sum())]
    changed = np.flatnonzero(temperature == _CHANGED)
    state[changed, rng.integers(k, size=len(changed))] = rng.integers(g, size=len(changed))
    moving = np.flatnonzero(temperature != _CHANGED)
    uniform = rng.uniform(size=(len(moving), _SWEEPS * k))
    items = [
        (state[moving[part]], temperature[moving[part]], uniform[part])
        for part in np.array_split(np.arange(len(moving)), _CHAIN_PIECES)
        if len(part)
    ]
    state[moving] = np.concatenate(
        run(_gibbs, (surrogate, sums), items, executor, batch_size=1, is_limited=True)
    )
    _, first = np.unique(state, axis=0, return_index=True)
    first = np.sort(first)
    new = first[_new(state[first], data)]
    return state[new], temperature[new] == 1.0


def _gibbs(shared: tuple[Surrogate, PlySums], item: tuple[Array, Array, Array]) -> Array:
    """Chains (m, k) after sweeps of Gibbs' sampler at temperatures (m,), by uniform numbers (m, steps)."""
    surrogate, sums = shared
    state, temperature, uniform = item
    m, k = state.shape
    g, both = len(sums.grid_deg), sums.both
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
