"""The log evidence of every sequence as a smooth function of its ply sums, learned where the mass is."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.inference.ply_sums import PlySums
from cpam_bayes.inference.sequence_evidence import (
    Conditionals,
    SequenceFits,
    SequencePosterior,
    fit_sequences,
    importance_evidence,
    joined,
)
from cpam_bayes.inference.smooth_map import SmoothMap, fit_map
from cpam_bayes.parallel import run

Array = NDArray[Any]

# Sequences that a worker takes at a time.
_BATCH = 16
# Below the best by more than this, nats, a value counts as this far below.
_DEPTH = 45.0


@dataclass(frozen=True, slots=True)
class LearningSettings:
    """How the surface is learned.

    first : sequences drawn evenly. each_round : sequences that join a round. most : of all. error : root
    mean square error, nats, on fresh draws from the posterior that ends the learning. log2_points : of the
    importance sampling of each sequence.
    """

    first: int = 500
    each_round: int = 160
    most: int = 1800
    error: float = 0.05
    log2_points: int = 7


@dataclass(frozen=True, slots=True)
class Evaluated:
    """Sequences of grid indices (m, k) with their fits and conditional posteriors."""

    sequences: Array
    fits: SequenceFits
    conditionals: Conditionals

    @property
    def log_evidence(self) -> Array:
        """Log evidence by importance sampling, (m,)."""
        return self.conditionals.log_evidence

    def __getitem__(self, rows: Any) -> Evaluated:
        """Some of the sequences."""
        return Evaluated(self.sequences[rows], self.fits[rows], self.conditionals[rows])


@dataclass(frozen=True, slots=True)
class Surface:
    """A learned log evidence: the map, the top of its data, and its error on fresh posterior draws, nats."""

    smooth: SmoothMap
    top: float
    rms_error: float
    largest_error: float

    def values(self, features: Array) -> Array:
        """Log evidence at features (m, d), (m,)."""
        return _expanded(self.smooth.values(features)[:, 0], self.top)

    def expansion(self, features: Array) -> tuple[Array, Array]:
        """Log evidence (m,) and gradient (m, d) at features (m, d)."""
        y, slope = self.smooth.expansion(features)
        value = _expanded(y[:, 0], self.top)
        return value, slope[:, 0] * _expansion_slope(y[:, 0], self.top)[:, None]


def _compressed(log_evidence: Array, top: float) -> Array:
    """Values near the top as they are, those far below pressed together, smoothly."""
    return np.asarray(np.logaddexp(log_evidence, top - _DEPTH))


def _expanded(y: Array, top: float) -> Array:
    floor = top - _DEPTH
    above = np.maximum(y - floor, 1e-3)
    return np.asarray(floor + above + np.log1p(-np.exp(-above)))


def _expansion_slope(y: Array, top: float) -> Array:
    above = np.maximum(y - (top - _DEPTH), 1e-3)
    return np.asarray(1.0 / -np.expm1(-above))


def evaluate(
    own: SequencePosterior,
    grid_deg: Array,
    sequences: Array,
    starts: Array,
    log2_points: int,
    executor: Executor | None,
) -> Evaluated:
    """Log evidence of sequences (m, k) by importance sampling, climbed from starts (m, s, n) or (s, n)."""
    angles = grid_deg[sequences]
    starts = np.broadcast_to(starts, (len(sequences), *starts.shape[-2:]))
    items = [
        (angles[i : i + _BATCH], starts[i : i + _BATCH], log2_points)
        for i in range(0, len(sequences), _BATCH)
    ]
    pieces = run(_evaluate_batch, own, items, executor, batch_size=1)
    return Evaluated(sequences, joined([p[0] for p in pieces]), joined([p[1] for p in pieces]))


def _evaluate_batch(
    own: SequencePosterior, item: tuple[Array, Array, int]
) -> tuple[SequenceFits, Conditionals]:
    angles, starts, log2_points = item
    fits = fit_sequences(own, angles, starts)
    return fits, importance_evidence(own, angles, fits, log2_points)


def merged(a: Evaluated, b: Evaluated) -> Evaluated:
    """Both, one after the other."""
    return Evaluated(
        np.concatenate((a.sequences, b.sequences)),
        joined([a.fits, b.fits]),
        joined([a.conditionals, b.conditionals]),
    )


def learn(
    own: SequencePosterior,
    sums: PlySums,
    starts: Array,
    rng: np.random.Generator,
    settings: LearningSettings,
    mirrored: bool,
    executor: Executor | None,
    notify: Callable[[str], None],
) -> tuple[Surface, Evaluated]:
    """The surface, and the sequences that it was learned from.

    Evenly drawn sequences come first. Then, round after round, sequences are drawn from the posterior as
    the surface has it, a third each at temperatures 1, 2 and 4, and join. Those of temperature 1 tell its
    error before they do. mirrored : sequences and their mirror images have one evidence.
    """
    g, k = len(sums.grid_deg), sums.n_unknown
    sequences = np.unique(rng.integers(g, size=(settings.first, k)), axis=0)
    notify(f"log evidence of {len(sequences)} sequences drawn evenly")
    data = evaluate(own, sums.grid_deg, sequences, starts, settings.log2_points, executor)
    rms, worst = np.inf, np.inf
    while True:
        surface = _fit(sums, data, rng, rms, worst, mirrored)
        if rms <= settings.error or len(data.sequences) + settings.each_round > settings.most:
            return surface, data
        drawn, cold = _draws(surface, sums, data, settings.each_round, rng)
        drawn_starts = starts_near(sums, data, drawn, starts)
        fresh = evaluate(own, sums.grid_deg, drawn, drawn_starts, settings.log2_points, executor)
        miss = surface.values(sums.features(drawn[cold])) - fresh.log_evidence[cold]
        rms, worst = float(np.sqrt(np.mean(miss**2))), float(np.abs(miss).max())
        data = merged(data, fresh)
        notify(f"log evidence learned from {len(data.sequences)} sequences to {rms:.2f} nats")


def _fit(
    sums: PlySums, data: Evaluated, rng: np.random.Generator, rms: float, worst: float, mirrored: bool
) -> Surface:
    top = float(data.log_evidence.max())
    y = _compressed(data.log_evidence, top)
    return Surface(
        fit_map(sums.features(data.sequences), y[:, None], rng, sums.mirror if mirrored else None),
        top,
        rms,
        worst,
    )


def starts_near(sums: PlySums, data: Evaluated, sequences: Array, starts: Array) -> Array:
    """Starts (m, 2, n) of sequences (m, k): the first common one and the optimum of the nearest evaluated."""
    known, asked = sums.features(data.sequences), sums.features(sequences)
    nearest = np.array([int(np.argmin(np.sum((known - a) ** 2, axis=1))) for a in asked])
    first = np.broadcast_to(starts[0], (len(sequences), starts.shape[1]))
    return np.stack((first, data.fits.x[nearest]), axis=1)


def _draws(
    surface: Surface, sums: PlySums, data: Evaluated, n: int, rng: np.random.Generator, sweeps: int = 12
) -> tuple[Array, Array]:
    """Distinct sequences drawn by Gibbs' sampler, n or fewer, and which of them at temperature 1, bool.

    Each chain starts from a sequence that was evaluated, drawn by its evidence at its temperature.
    """
    temperature = np.repeat([1.0, 2.0, 4.0], -(-n // 3))[:n]
    g, k = len(sums.grid_deg), sums.n_unknown
    state = np.empty((n, k), dtype=np.int64)
    for i, t in enumerate(temperature):
        w = np.exp((data.log_evidence - data.log_evidence.max()) / max(t, 2.0))
        state[i] = data.sequences[rng.choice(len(w), p=w / w.sum())]
    both = np.concatenate((sums.first, sums.rest), axis=2)
    total = sums.features(state)
    for _ in range(sweeps):
        for j in range(k):
            without = total - both[j][state[:, j]]
            candidates = (without[:, None, :] + both[j][None, :, :]).reshape(n * g, -1)
            value = surface.values(candidates).reshape(n, g) / temperature[:, None]
            cumulative = np.cumsum(np.exp(value - value.max(axis=1, keepdims=True)), axis=1)
            pick = rng.uniform(size=n) * cumulative[:, -1]
            state[:, j] = np.minimum((cumulative < pick[:, None]).sum(axis=1), g - 1)
            total = without + both[j][state[:, j]]
    _, first = np.unique(state, axis=0, return_index=True)
    first = np.sort(first)
    return state[first], temperature[first] == 1.0
