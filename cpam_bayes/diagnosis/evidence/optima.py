"""All optima of a hypothesis over constants and sizes together, from many starts.

The plain model's optimum is a good start for faint effects and a bad one for gross errors: plies turned by
several degrees move the constants as far as the effect itself. Draws of the prior are therefore screened on
the reduced model, the best of them optimised in rounds, fewer and further each time, together with what is
known already (the plain model's optima, the reference).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri
from scipy.stats import qmc

from cpam_bayes.diagnosis.evidence.comparison import Comparison
from cpam_bayes.inference.derivatives import Expansion
from cpam_bayes.inference.optimise import maximise
from cpam_bayes.inference.standard_normal import MAX_SCORE
from cpam_bayes.mechanics.modes import RigidBodyError

Array = NDArray[Any]

# Draws that are screened; starts of each round and the steps that they are given; gain that ends the last.
LOG2_DRAWS = 9
_ROUNDS = ((40, 3), (12, 6), (6, 25))
_PROMISED = 3e-3
# Scores of sizes are spread evenly this far: gross errors are in the tails of their priors.
SIZE_RANGE = 3.6
# Scale of the relative misfit beyond which a draw is as bad as any, and how much of the mean misfit is
# forgiven: one modulus scales all frequencies.
_COARSE, _FORGIVEN = 0.02, 0.9
# Score of an inferred noise that optimisations begin with: large noise makes the first steps long.
_FIRST_NOISE = 1.5
# An optimisation under way may gain so many times what its next step promises.
_OVERSHOOT = 10.0
# Optima are the same within this distance, standard deviations, and kept within so many nats of the best.
_DISTINCT_SD, _DEPTH_NATS = 1.0, 25.0


@dataclass(frozen=True, slots=True)
class Optima:
    """Distinct optima of a log density over normal scores, the best one first.

    z : (k, n)
    value : (k,)
    curvature : (k, n, n)
    """

    z: Array
    value: Array
    curvature: Array

    @property
    def log_mass(self) -> Array:
        """Log of the integral about each by Laplace's approximation, (k,)."""
        n = self.z.shape[1]
        log_det = np.linalg.slogdet(self.curvature)[1]
        return np.asarray(self.value + 0.5 * n * np.log(2 * np.pi) - 0.5 * log_det)


def find_optima(
    comparison: Comparison,
    sizes: tuple[int, ...],
    known: Array,
    *,
    log2_draws: int = LOG2_DRAWS,
    least: float = -np.inf,
) -> Optima:
    """The distinct optima of a comparison's log density that draws of its priors and known starts lead to.

    sizes : columns of the effect's size and further coordinates
    known : (s, n) scores that join the draws
    least : log mass below which nothing is worth more steps than it takes to see that

    Raises ``RigidBodyError`` where no start has a density.
    """
    z, first = known, len(known)
    if log2_draws:
        draws = prior_draws(comparison, sizes, log2_draws)
        order = np.argsort(_misfit_at(comparison, draws), kind="stable")
        z = np.concatenate((known, draws[order[: _ROUNDS[0][0]]]))
        for keep, steps in _ROUNDS[:-1]:
            optima, promise = maximised(comparison, z[: keep + first], steps)
            z, first = optima.z, 0
        if len(z) and (optima.value + _OVERSHOOT * promise).max() < least - _DEPTH_NATS:
            return Optima(optima.z[:1], optima.value[:1], optima.curvature[:1])
    most, steps = _ROUNDS[-1]
    optima, _ = maximised(comparison, z[: max(most, first)], steps)
    if not len(optima.value):
        raise RigidBodyError("at no start the plate has modes, or the constraints are satisfied")
    near = optima.value > optima.value[0] - _DEPTH_NATS
    return Optima(optima.z[near], optima.value[near], optima.curvature[near])


def prior_draws(comparison: Comparison, sizes: tuple[int, ...], log2_draws: int) -> Array:
    """Scores (m, n) that fill the prior; those of the first size are spread evenly, noise starts large."""
    z = spread_scores(comparison.parameters.size, log2_draws, sizes[0] if sizes else None)
    z[:, comparison.model.parameters.size :] = _FIRST_NOISE
    return z


def spread_scores(n: int, log2_points: int, even: int | None) -> Array:
    """Scores (2^log2_points, n) that fill a normal prior; those of the column ``even`` are spread evenly."""
    uniform = _unit_points(n, log2_points)
    z = np.asarray(ndtri(uniform))
    if even is not None:
        z[:, even] = SIZE_RANGE * (2.0 * uniform[:, even] - 1.0)
    return z


@cache
def _unit_points(n: int, log2_points: int) -> Array:
    """Points (2^log2_points, n) that fill the unit cube, the same each time."""
    points = qmc.Sobol(n, rng=np.random.default_rng(0)).random_base2(log2_points)
    return np.asarray(np.clip(points, 1e-6, 1.0 - 1e-6))


def size_points(comparison: Comparison, column: int, n: int) -> Array:
    """Scores of n sizes that are evenly spread between the bounds of their prior, (n,)."""
    lower, upper = comparison.parameters.lower[column], comparison.parameters.upper[column]
    prior = comparison.parameters.parameters[column].prior
    x = lower + (upper - lower) * (np.arange(n) + 0.5) / n
    return np.clip(np.asarray(prior.to_normal(x)), -MAX_SCORE, MAX_SCORE)


def _misfit_at(comparison: Comparison, z: Array) -> Array:
    """A misfit that ranks far-off scores (m, n), infinite where the constraints (9) are broken, (m,)."""
    x = comparison.scores.to_x(z)
    misfit = np.full(len(z), np.inf)
    inside, f, _ = comparison.predict_inside(x)
    if len(inside):
        misfit[inside] = coarse_misfit(np.log(comparison.listed.frequencies / f))
    return misfit


def coarse_misfit(r: Array) -> Array:
    """A misfit that ranks far-off residuals (m, n_f) of the log frequencies, (m,)."""
    r = r - _FORGIVEN * r.mean(axis=1, keepdims=True)
    return np.asarray(np.sum(np.log1p((r / _COARSE) ** 2), axis=1))


def maximised(
    comparison: Comparison, z: Array, most_steps: int, promised: float = _PROMISED
) -> tuple[Optima, Array]:
    """Distinct ends of optimisations from scores (s, n), and the gain that one more step promises each.

    most_steps, promised : as in ``maximise``
    """
    bound = np.full(z.shape[1], MAX_SCORE)
    maxima = maximise(
        lambda at, rows: comparison.expand(at), z, -bound, bound, most_steps=most_steps, promised=promised
    )
    kept = _distinct(maxima.u, maxima.expansion)
    g, c = maxima.expansion.gradient[kept], maxima.expansion.curvature[kept]
    promise = 0.5 * np.einsum("ki,ki->k", g, np.linalg.solve(c, g[..., None])[..., 0])
    return Optima(maxima.u[kept], maxima.expansion.value[kept], c), promise


def _distinct(z: Array, expansion: Expansion) -> list[int]:
    """Where optimisations ended, the best first, without those that ended at the same place."""
    value = np.where(np.isfinite(expansion.value), expansion.value, -np.inf)
    order = np.argsort(-value, kind="stable")
    order = order[value[order] > -np.inf]
    kept: list[int] = []
    for i in order:
        away = z[kept] - z[i]
        distance = np.einsum("ki,kij,kj->k", away, expansion.curvature[kept], away)
        if not len(kept) or distance.min() > _DISTINCT_SD**2:
            kept.append(int(i))
    return kept
