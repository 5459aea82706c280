"""Evidences of stacks of sequences: starts, reduced bases, and the distribution of the work.

An optimisation starts from the constants of a library whose frequencies are closest to the measured ones, or
from optima of neighbouring sequences. Bases are small: one for the whole box, one about the posterior, one
for a single sequence.
"""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from cpam_bayes.forward_model.model import training_sets
from cpam_bayes.forward_model.reduced import focused
from cpam_bayes.parallel import run
from cpam_bayes.plate import split_name
from cpam_bayes.stacking.conditional import (
    ConditionalFits,
    ConditionalPosterior,
    Conditionals,
    fit_conditionals,
    importance_evidence,
    joined,
)

Array = NDArray[Any]

# Numbers in the matrices of sequences that are solved for together.
_TOGETHER = 2048
# Sequences per task of a worker: where everything is computed, and where only optima are located.
_BATCH, _LOCATED = 32, 512
# Optimisations that only locate an optimum end where a step promises less than this, nats.
_NEARLY = 3e-3
# Members of a library from which an optimisation starts.
_SCANNED = 2
# Neighbours among which the second start is sought.
_NEIGHBOURS = 8
# A first basis for the whole box: parameter sets from which it is made, and its relative error.
_BOX_SETS, _BOX_ERROR = 400, 5e-3
# The basis about the posterior: nats below the best within which a sequence belongs to it; sets; error.
NEAR, _NEAR_SETS, _NEAR_ERROR = 18.0, 800, 2e-3
# Share of the frequencies that must have these errors where the relative noise is at least so large: few sets
# at the rim of a wide posterior, with little weight, would take as many vectors as all others.
_MOST, _NOISY = 0.98, 8e-3
# Both errors are at most these shares of the noise, where it is known.
_BOX_SHARE, _NEAR_SHARE = 0.3, 0.05
# This share for the basis of the sieve; sequences per task of a worker, and number located first, without a
# floor: the best by the misfit of their first start.
_SIEVE_SHARE, _SIEVED, _PILOT = 2.5, 64, 32
# The basis for one sequence and all constants: sets, the least and the largest relative error, and between
# them the share of the noise.
_SEQUENCE_SETS, _SEQUENCE_ERRORS, _SEQUENCE_SHARE = 600, (2e-5, 2e-4), 0.02
# Quantile over the draws of the noise that counts where it is inferred.
_LEAST_NOISE = 0.01


def scan_library(conditional: ConditionalPosterior, size: int, rng: np.random.Generator) -> Array:
    """Constants (size or fewer, n_constants) drawn from their prior that satisfy the constraints (9)."""
    n = conditional.n_constants
    drawn = conditional.parameters.sample(rng, 8 * size)
    return np.asarray(drawn[np.isfinite(conditional.template.log_prior(drawn))][:size, :n])


def scanned_starts(
    conditional: ConditionalPosterior, angles_deg: Array, library: Array, n: int
) -> tuple[Array, Array]:
    """The n members (m, n, n_parameters) of a library that fit the list best with each sequence (m, k).

    Second, the misfits (m, n) of their frequencies, root mean squares of logarithms.

    Multiplying all stiffnesses by a^2 multiplies all frequencies by a (but for the bias of the theory):
    each member is taken with the factor that fits the list best, as far as the bounds allow. Where modes
    cross there are many optima, and the nearest member is in the right one more often than a fixed start. An
    inferred noise starts at the misfit.

    library : (p, n_constants).
    """
    each = max(_TOGETHER // len(library), 1)
    parts = [
        _scanned(conditional, angles_deg[i : i + each], library, n) for i in range(0, len(angles_deg), each)
    ]
    starts, misfit = zip(*parts, strict=True)
    return np.concatenate(starts), np.concatenate(misfit)


def _scanned(
    conditional: ConditionalPosterior, angles_deg: Array, library: Array, n: int
) -> tuple[Array, Array]:
    m, p = len(angles_deg), len(library)
    parameters, n_constants = conditional.parameters, conditional.n_constants
    measured = conditional.template.measurement.frequencies
    at = conditional.at(np.repeat(angles_deg, p, axis=0))
    found = at.predict(np.tile(conditional.nominal(library), (m, 1)))[:, : len(measured)].reshape(m, p, -1)
    ratio = np.log(measured / found)
    moduli = np.array([split_name(name)[1][0] in "EG" for name in parameters.names[:n_constants]])
    # the factors that keep every stiffness within its bounds
    low = np.where(moduli, parameters.lower[:n_constants] / library, 0.0).max(axis=1)
    high = np.where(moduli, parameters.upper[:n_constants] / library, np.inf).min(axis=1)
    factor = np.clip(np.exp(2.0 * ratio.mean(axis=2)), low, high)
    misfit = np.sqrt(np.mean((ratio - 0.5 * np.log(factor)[..., None]) ** 2, axis=2))
    best = np.argsort(misfit, axis=1, kind="stable")[:, :n]
    scale, misfit = (np.take_along_axis(a, best, axis=1) for a in (factor, misfit))
    scale = scale[..., None]
    starts = conditional.nominal(np.where(moduli, scale * library[best], library[best]))
    if conditional.template.noise_is_inferred:
        prior = conditional.parameters.parameters[-1].prior
        amplitude = np.clip(misfit, 2.0 * prior.lower, 0.5 * prior.upper)
        starts = np.concatenate((starts, amplitude[..., None]), axis=2)
    return np.asarray(starts), misfit


@dataclass(frozen=True, slots=True)
class Evaluated:
    """Sequences of grid indices (m, k) with their fits and conditional posteriors."""

    sequences: Array
    fits: ConditionalFits
    conditionals: Conditionals

    @property
    def log_evidence(self) -> Array:
        """Log evidence (m,) by importance sampling."""
        return self.conditionals.log_evidence

    def __getitem__(self, rows: Any) -> Evaluated:
        """Some of the sequences."""
        return Evaluated(self.sequences[rows], self.fits[rows], self.conditionals[rows])


def evaluate(
    conditional: ConditionalPosterior,
    grid_deg: Array,
    sequences: Array,
    starts: Array,
    log2_points: int,
    executor: Executor | None,
    library: Array | None = None,
    *,
    scanned: int = _SCANNED,
) -> Evaluated:
    """Evaluate sequences (m, k) by importance sampling, optimised from starts (m, s, n) or (s, n).

    library : (p, n_constants) constants, of which the ``scanned`` best for each sequence are further starts.
    """
    angles = grid_deg[sequences]
    starts = np.broadcast_to(starts, (len(sequences), *starts.shape[-2:]))
    items = [
        (angles[i : i + _BATCH], starts[i : i + _BATCH], library, scanned, log2_points)
        for i in range(0, len(sequences), _BATCH)
    ]
    pieces = run(_evaluate_batch, conditional, items, executor, batch_size=1, is_limited=True)
    return Evaluated(sequences, joined([p[0] for p in pieces]), joined([p[1] for p in pieces]))


def _evaluate_batch(
    conditional: ConditionalPosterior, item: tuple[Array, Array, Array | None, int, int]
) -> tuple[ConditionalFits, Conditionals]:
    angles, starts, library, scanned, log2_points = item
    if library is not None:
        starts = np.concatenate((starts, scanned_starts(conditional, angles, library, scanned)[0]), axis=1)
    fits = fit_conditionals(conditional, angles, starts)
    return fits, importance_evidence(conditional, angles, fits, log2_points)


def merged(a: Evaluated, b: Evaluated) -> Evaluated:
    """Two groups of evaluated sequences, concatenated."""
    return Evaluated(
        np.concatenate((a.sequences, b.sequences)),
        joined([a.fits, b.fits]),
        joined([a.conditionals, b.conditionals]),
    )


def with_optima(data: Evaluated, n: int) -> Evaluated:
    """Evaluated sequences with only the n heaviest optima of each."""
    fits = data.fits
    best = np.argsort(-fits.weight, axis=1, kind="stable")[:, :n]
    row = np.arange(len(best))[:, None]
    kept = replace(
        fits,
        optima=fits.optima[row, best],
        weight=fits.weight[row, best],
        curvature=fits.curvature[row, best],
    )
    return replace(data, fits=kept)


@dataclass(frozen=True, slots=True)
class Located:
    """Laplace's log evidence of m sequences (m,) and the parameters at their best optima (m, n)."""

    log_evidence: Array
    x: Array


def locate(
    conditional: ConditionalPosterior,
    grid_deg: Array,
    sequences: Array,
    near: Array,
    least: Array,
    starts: Array,
    executor: Executor | None,
) -> Located:
    """Laplace's evidence of sequences (m, k), each optimised from one start next to its optimum.

    near : (m, n) parameters, the optima of neighbours. Sequences that end below the ``least`` log evidence
    (m,) are optimised again from the common ``starts`` (s, n).
    """
    angles = grid_deg[sequences]
    items = [
        (angles[i : i + _LOCATED], near[i : i + _LOCATED], least[i : i + _LOCATED], starts)
        for i in range(0, len(sequences), _LOCATED)
    ]
    if not items:
        return Located(np.empty(0), np.empty((0, near.shape[1])))
    pieces = run(_locate_batch, conditional, items, executor, batch_size=1, is_limited=True)
    return Located(np.concatenate([p.log_evidence for p in pieces]), np.concatenate([p.x for p in pieces]))


def _locate_batch(conditional: ConditionalPosterior, item: tuple[Array, Array, Array, Array]) -> Located:
    angles, near, least, starts = item
    fits = fit_conditionals(conditional, angles, near[:, None, :], _NEARLY)
    log_evidence, x = fits.log_evidence.copy(), fits.x.copy()
    low = np.flatnonzero(log_evidence < least)
    if len(low):
        again = fit_conditionals(conditional, angles[low], starts, _NEARLY)
        better = again.log_evidence > log_evidence[low]
        log_evidence[low[better]], x[low[better]] = again.log_evidence[better], again.x[better]
    return Located(log_evidence, x)


@dataclass(frozen=True, slots=True)
class Neighbours:
    """Evaluated sequences as a search tree over their features and all images of these.

    tree : over points in units of ``lengths`` (d,).
    owner : index of the sequence that each point belongs to.
    x : (m, n) optima of the sequences.
    """

    tree: cKDTree
    lengths: Array
    owner: Array
    x: Array

    def nearest(self, features: Array) -> Array:
        """Optima (m, n) of the nearest sequences."""
        return self.x[self.owner[self.tree.query(features / self.lengths)[1]]]

    def starts(self, features: Array, nearest: Array | None = None) -> Array:
        """Two starts (m, 2, n) of each: the nearest optimum, or a given one (m, n), and a different one."""
        n = min(_NEIGHBOURS, self.tree.n)
        around = self.tree.query(features / self.lengths, k=np.arange(1, n + 1))[1]
        some = self.x[self.owner[around]]
        first = some[:, 0] if nearest is None else nearest
        away = np.sum(((some - first[:, None, :]) / self.x.std(axis=0).clip(1e-300)) ** 2, axis=2)
        return np.stack((first, some[np.arange(len(some)), away.argmax(axis=1)]), axis=1)

    def mean(self, features: Array, values: Array) -> Array:
        """Mean over the nearest sequences of their values (m,), near ones counting more."""
        n = min(_NEIGHBOURS, self.tree.n)
        distance, around = self.tree.query(features / self.lengths, k=np.arange(1, n + 1))
        weight = 1.0 / (distance + 0.1 * np.mean(distance) + 1e-12)
        return np.asarray(np.sum(weight * values[self.owner[around]], axis=1) / weight.sum(axis=1))


def neighbours(features: Array, x: Array, lengths: Array, images: Array) -> Neighbours:
    """Tree of sequences with features (m, d) and images by changes of sign (n_images, d)."""
    points = (features[None] * images[:, None, :] / lengths).reshape(-1, features.shape[1])
    return Neighbours(cKDTree(points), lengths, np.tile(np.arange(len(features)), len(images)), x)


def in_sight(
    conditional: ConditionalPosterior,
    grid_deg: Array,
    sequences: Array,
    starts: Array,
    library: Array,
    rng: np.random.Generator,
    executor: Executor | None,
) -> tuple[Array, Array]:
    """Rows of the sequences (m, k) that may be within ``NEAR`` of the best, and their optima (r, n).

    Optimisations on a basis accurate to a few times the noise, from the common ``starts`` (s, n) and from the
    library, are given up as soon as they promise to end out of sight. Sequences given up are optimised once
    more from the optimum of the nearest sequence in sight.
    """
    error = min(_BOX_ERROR, _SIEVE_SHARE * _known_noise(conditional))
    box = training_sets(conditional.model.full.operator.problem, _BOX_SETS, rng)
    basis = replace(conditional, model=focused(conditional.model, box, error, _MOST))
    angles = grid_deg[sequences]
    parts = range(0, len(angles), _SIEVED)
    scans = run(_scan_batch, basis, [(angles[i : i + _SIEVED], library) for i in parts], executor)
    scanned, misfit = (np.concatenate(found) for found in zip(*scans, strict=True))
    starts = np.concatenate((np.broadcast_to(starts, (len(angles), *starts.shape)), scanned), axis=1)
    order = np.argsort(misfit[:, 0], kind="stable")
    found = Located(np.full(len(angles), -np.inf), starts[:, 0].copy())

    def locate_all(rows: Array, starts: Array, floor: float) -> None:
        pieces = [rows[i : i + _SIEVED] for i in range(0, len(rows), _SIEVED)]
        items = [(angles[piece], starts[piece], floor) for piece in pieces]
        fits = run(_sieve_batch, basis, items, executor, batch_size=1, is_limited=True)
        for piece, fit in zip(pieces, fits, strict=True):
            better = fit.log_evidence > found.log_evidence[piece]
            found.log_evidence[piece[better]], found.x[piece[better]] = (
                fit.log_evidence[better],
                fit.x[better],
            )

    locate_all(order[:_PILOT], starts, -np.inf)
    best = int(found.log_evidence.argmax())
    # misfit, in standard deviations, that the error of the basis may add
    more = np.sqrt(conditional.template.measurement.size) * error / basis.least_noise(found.x[best, None])
    floor = float(found.log_evidence[best] - 0.5 * (np.sqrt(2.0 * NEAR) + more) ** 2)
    locate_all(order[_PILOT:], starts, floor)
    high, low = np.flatnonzero(found.log_evidence >= floor), np.flatnonzero(found.log_evidence < floor)
    features = angle_functions(angles)
    n = features.shape[1]
    near = neighbours(features[high], found.x[high], np.ones(n), np.ones((1, n))).nearest(features)
    locate_all(low, near[:, None], floor)
    rows = np.flatnonzero(found.log_evidence >= floor)
    return rows, found.x[rows]


def _scan_batch(basis: ConditionalPosterior, item: tuple[Array, Array]) -> tuple[Array, Array]:
    return scanned_starts(basis, *item, _SCANNED)


def _sieve_batch(basis: ConditionalPosterior, item: tuple[Array, Array, float]) -> Located:
    angles, starts, floor = item
    fits = fit_conditionals(basis, angles, starts, _NEARLY, floor)
    return Located(fits.log_evidence, fits.x)


def angle_functions(angles_deg: Array) -> Array:
    """cos and sin (m, 4 k) of twice and four times every angle (m, k), close for similar sequences."""
    t = np.deg2rad(angles_deg)
    return np.concatenate([f(n * t) / n for n in (2, 4) for f in (np.cos, np.sin)], axis=1)


def roughly(conditional: ConditionalPosterior, rng: np.random.Generator) -> ConditionalPosterior:
    """The posterior on a small basis for the whole box, which shows where the mass is."""
    box = training_sets(conditional.model.full.operator.problem, _BOX_SETS, rng)
    noise = _known_noise(conditional)
    return replace(
        conditional, model=focused(conditional.model, box, min(_BOX_ERROR, _BOX_SHARE * noise), _share(noise))
    )


def _known_noise(conditional: ConditionalPosterior) -> float:
    """Least relative standard deviation of a frequency in the middle of the bounds, infinite if inferred."""
    if conditional.template.noise_is_inferred:
        return float("inf")
    middle = 0.5 * (conditional.parameters.lower + conditional.parameters.upper)
    return conditional.least_noise(middle[None])


def about(
    conditional: ConditionalPosterior, grid_deg: Array, data: Evaluated, rng: np.random.Generator
) -> ConditionalPosterior:
    """The posterior on a basis made for the sequences near the top and their constants."""
    some = np.flatnonzero(data.log_evidence > data.log_evidence.max() - NEAR)
    draws = data.conditionals.draws[some]
    angles = np.repeat(grid_deg[data.sequences[some]], draws.shape[1], axis=0)
    draws = draws.reshape(len(angles), -1)
    rows = rng.permutation(len(draws))[:_NEAR_SETS]
    angles, draws = angles[rows], draws[rows]
    noise = float(np.quantile(conditional.relative_noise(draws).min(axis=1), _LEAST_NOISE))
    x = np.column_stack((angles, draws[:, : conditional.n_constants]))
    return replace(
        conditional, model=focused(conditional.model, x, min(_NEAR_ERROR, _NEAR_SHARE * noise), _share(noise))
    )


def of_sequence(conditional: ConditionalPosterior, angles_deg: Array, noise: float) -> ConditionalPosterior:
    """The posterior on a basis for one sequence (k,) and all constants in their box.

    Constants alone change a mode far less than the angles do: a third of the vectors suffices.

    noise : least standard deviation of a frequency, relative.
    """
    sets = training_sets(conditional.model.full.operator.problem, _SEQUENCE_SETS, np.random.default_rng(0))
    sets[:, : conditional.n_angles] = angles_deg
    error = float(np.clip(_SEQUENCE_SHARE * noise, *_SEQUENCE_ERRORS))
    return replace(conditional, model=focused(conditional.model, sets, error))


def _share(noise: float) -> float:
    return _MOST if noise >= _NOISY else 1.0
