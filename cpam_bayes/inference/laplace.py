"""Laplace's method over normal scores: the optima of a log density, and the mass about each.

The optimum of a simpler model is a good start for faint effects and a bad one for gross errors, which move
the constants far. Draws of the prior are therefore screened, and the best of them, with the known starts,
optimised in rounds, fewer and for more steps each time.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, Final

import numpy as np
from scipy.special import ndtri
from scipy.stats import qmc

from cpam_bayes.inference.log_density import LogDensity
from cpam_bayes.inference.optimise import maximise, polish, promised_gain
from cpam_bayes.inference.scores import Expansion, best_of_distinct
from cpam_bayes.mechanics.modes import RigidBodyError
from cpam_bayes.mechanics.problem import Array

# Distance, standard deviations, within which optima are the same.
_DISTINCT_SD = 1.0
# Scores of sizes are spread evenly up to this: gross errors are in the tails of their priors.
SIZE_RANGE = 3.6


@dataclass(frozen=True, slots=True)
class Optima:
    """Distinct optima of a log density over normal scores, the best one first.

    z : (k, n)
    value : (k,)
    gradient : (k, n)
    curvature : (k, n, n)
    """

    z: Array
    value: Array
    gradient: Array
    curvature: Array

    def only(self, kept: Any) -> Optima:
        """Some of the optima."""
        return Optima(self.z[kept], self.value[kept], self.gradient[kept], self.curvature[kept])

    @property
    def log_mass(self) -> Array:
        """Log (k,) of the integral about each by Laplace's approximation."""
        return self.value + log_volume(self.curvature)

    @property
    def factor(self) -> Array:
        """Square root (k, n, n) of the covariance about each."""
        return np.linalg.cholesky(np.linalg.inv(self.curvature))

    @property
    def promise(self) -> Array:
        """Gain (k,), nats, that one more step promises for each."""
        return promised_gain(self.gradient, self.curvature)


def log_volume(curvature: Array) -> Array:
    """Log integral (...) of Gaussians of height one with negative Hessians (..., n, n).

    n/2 log 2 pi - 1/2 log det H (Tierney and Kadane, 1986).
    """
    n = curvature.shape[-1]
    return np.asarray(0.5 * n * np.log(2 * np.pi) - 0.5 * np.linalg.slogdet(curvature)[1])


def maximised(
    density: LogDensity,
    z: Array,
    most_steps: int,
    promised: float,
    most: int | None = None,
    *,
    weight: Array | float = 0.0,
) -> Optima:
    """Distinct optima reached from scores (s, n), ``most`` at most.

    most_steps, promised : as in ``maximise``
    weight : (n,) fraction of the log prior that is left out, 0 to 1
    """
    bound, left_out = density.scores.upper, np.broadcast_to(weight, z.shape[1])

    def target(at: Array, rows: Array) -> Expansion:
        del rows
        e = density.expand(at)
        return e.without_prior(at, left_out) if left_out.any() else e

    maxima = maximise(target, z, -bound, bound, most_steps=most_steps, promised=promised)
    e = maxima.expansion
    kept = best_of_distinct(maxima.u, e.value, e.curvature, _DISTINCT_SD, most)
    return Optima(maxima.u[kept], e.value[kept], e.gradient[kept], e.curvature[kept])


@dataclass(frozen=True, slots=True)
class SearchSettings:
    """Settings of the search for all optima of a log density.

    log2_draws : log2 of the number of prior draws that are screened
    rounds : starts and steps of each round
    promised : promised gain, nats, below which the last round ends
    first_noise : score of an inferred noise at the start: large noise makes the first steps long
    overshoot : largest gain of an unfinished optimisation over what its next step promises
    depth_nats : optima are kept within so much of the best
    is_polished : whether every optimum is polled for better points around it, see ``polish``
    """

    log2_draws: int = 9
    rounds: tuple[tuple[int, int], ...] = ((40, 3), (12, 6), (6, 20))
    promised: float = 3e-2
    first_noise: float = 1.5
    overshoot: float = 10.0
    depth_nats: float = 25.0
    is_polished: bool = False


SEARCH: Final = SearchSettings()
POLISHED: Final = SearchSettings(7, ((12, 10), (6, 60)), promised=1e-9, is_polished=True)
"""Settings for a single density that is sampled, whose optima are fully converged."""


def find_optima(
    density: LogDensity,
    known: Array,
    *,
    even: int | None = None,
    log2_draws: int | None = None,
    least: float = -np.inf,
    settings: SearchSettings = SEARCH,
) -> Optima:
    """Distinct optima of a log density, reached from draws of its priors and from known starts.

    known : (s, n) scores of further starts
    even : column of a size whose draws are spread evenly
    log2_draws : instead of that of the settings, 0 for none
    least : log mass below which optima are not refined

    Raises ``RigidBodyError``, a ``ValueError``, where no start has a density.
    """
    z, first = known, len(known)
    log2 = settings.log2_draws if log2_draws is None else log2_draws
    if log2:
        draws = prior_draws(density, even, log2, settings.first_noise)
        order = np.argsort(density.far_off(draws), kind="stable")
        z = np.concatenate((known, draws[order[: settings.rounds[0][0]]]))
        for keep, steps in settings.rounds[:-1]:
            optima = maximised(density, z[: keep + first], steps, settings.promised)
            z, first = optima.z, 0
        promise = optima.value + settings.overshoot * optima.promise
        if len(z) and promise.max() < least - settings.depth_nats:
            return optima.only(slice(1))
    most, steps = settings.rounds[-1]
    if len(z):
        optima = maximised(density, z[: max(most, first)], steps, settings.promised)
    if not len(z) or not len(optima.value):
        raise RigidBodyError("at no start the plate has modes, or the constraints are satisfied")
    if settings.is_polished:
        optima = _polished(density, optima)
    return optima.only(optima.value > optima.value[0] - settings.depth_nats)


def _polished(density: LogDensity, optima: Optima) -> Optima:
    """Optima, each polished: crossing modes leave a kink, where steps shrink before the top is reached."""
    bound = density.scores.upper
    z, parts = [], []
    for i in range(len(optima.z)):
        at = Expansion(*(a[i : i + 1] for a in (optima.value, optima.gradient, optima.curvature)))
        target = lambda u, rows: density.expand(u)  # noqa: E731 as `maximise` asks for it
        u, expansion, _ = polish(density.log_density, target, optima.z[i], at, -bound, bound)
        z.append(u)
        parts.append((expansion.value, expansion.gradient, expansion.curvature))
    value, gradient, curvature = (np.concatenate(part) for part in zip(*parts, strict=True))
    kept = best_of_distinct(np.array(z), value, curvature, _DISTINCT_SD)
    return Optima(np.array(z)[kept], value[kept], gradient[kept], curvature[kept])


def prior_draws(density: LogDensity, even: int | None, log2_draws: int, noise: float) -> Array:
    """Scores (m, n) that fill the prior; those of the column ``even`` are spread evenly.

    noise : score of the parameters beside the model's, an inferred noise
    """
    z = spread_scores(density.parameters.size, log2_draws, even)
    z[:, density.n_model :] = noise
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
    """Points (2^log2_points, n) that fill the unit cube, reproducible."""
    points = qmc.Sobol(n, rng=np.random.default_rng(0)).random_base2(log2_points)
    return np.asarray(np.clip(points, 1e-6, 1.0 - 1e-6))
