"""All optima of a hypothesis over constants and sizes together, and at held sizes.

The plain model's optimum is a good start for faint effects and a bad one for gross errors, which move the
constants far. Draws of the prior are therefore screened, and the best of them optimised in rounds, fewer and
further each time, together with what is known already.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from scipy.special import ndtri
from scipy.stats import qmc

from cpam_bayes.inference.derivatives import MAX_SCORE, Expansion
from cpam_bayes.inference.laplace import maximise
from cpam_bayes.inference.log_density import LogDensity
from cpam_bayes.inference.proposal import Optima, maximised
from cpam_bayes.mechanics.modes import RigidBodyError
from cpam_bayes.mechanics.problem import Array

# Scores of sizes are spread evenly this far: gross errors are in the tails of their priors.
SIZE_RANGE = 3.6


@dataclass(frozen=True, slots=True)
class SearchSettings:
    """The search for all optima over constants and sizes together.

    log2_draws : of the prior, that are screened
    rounds : starts of each round, and the steps that they are given
    promised : gain, nats, that ends the last round
    coarse : scale of the relative misfit beyond which a draw is as bad as any
    forgiven : part of the mean misfit that is; one modulus scales all frequencies
    first_noise : score of an inferred noise that optimisations begin with: large noise makes the first steps
        long
    overshoot : an optimisation under way may gain so many times what its next step promises
    depth_nats : optima are kept within so much of the best
    """

    log2_draws: int = 9
    rounds: tuple[tuple[int, int], ...] = ((40, 3), (12, 6), (6, 20))
    promised: float = 3e-2
    coarse: float = 0.02
    forgiven: float = 0.9
    first_noise: float = 1.5
    overshoot: float = 10.0
    depth_nats: float = 25.0


@dataclass(frozen=True, slots=True)
class NodeSettings:
    """The optima of constants and noise at held sizes, centres of a proposal.

    promised, steps : optimisations end where a step promises less, nats, or after so many steps
    steepest : a node's optimum moves with the size by no more than this, scores per score
    """

    promised: float = 3e-2
    steps: int = 5
    steepest: float = 3.0


SEARCH: Final = SearchSettings()
_NODE: Final = NodeSettings()


def find_optima(
    comparison: LogDensity,
    sizes: tuple[int, ...],
    known: Array,
    *,
    log2_draws: int = SEARCH.log2_draws,
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
        z = np.concatenate((known, draws[order[: SEARCH.rounds[0][0]]]))
        for keep, steps in SEARCH.rounds[:-1]:
            optima = maximised(comparison, z[: keep + first], steps, SEARCH.promised)
            z, first = optima.z, 0
        if len(z) and (optima.value + SEARCH.overshoot * optima.promise).max() < least - SEARCH.depth_nats:
            return optima.only(slice(1))
    most, steps = SEARCH.rounds[-1]
    optima = maximised(comparison, z[: max(most, first)], steps, SEARCH.promised)
    if not len(optima.value):
        raise RigidBodyError("at no start the plate has modes, or the constraints are satisfied")
    return optima.only(optima.value > optima.value[0] - SEARCH.depth_nats)


def prior_draws(comparison: LogDensity, sizes: tuple[int, ...], log2_draws: int) -> Array:
    """Scores (m, n) that fill the prior; those of the first size are spread evenly, noise starts large."""
    z = spread_scores(comparison.parameters.size, log2_draws, sizes[0] if sizes else None)
    z[:, comparison.model.parameters.size :] = SEARCH.first_noise
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


def size_points(comparison: LogDensity, column: int, n: int) -> Array:
    """Scores of n sizes that are evenly spread between the bounds of their prior, (n,)."""
    lower, upper = comparison.parameters.lower[column], comparison.parameters.upper[column]
    prior = comparison.parameters.parameters[column].prior
    x = lower + (upper - lower) * (np.arange(n) + 0.5) / n
    return np.clip(np.asarray(prior.to_normal(x)), -MAX_SCORE, MAX_SCORE)


def _misfit_at(comparison: LogDensity, z: Array) -> Array:
    """A misfit that ranks far-off scores (m, n), infinite where the constraints (9) are broken, (m,)."""
    x = comparison.scores.to_x(z)
    misfit = np.full(len(z), np.inf)
    inside, f, _ = comparison.predict_inside(x)
    if len(inside):
        misfit[inside] = coarse_misfit(np.log(comparison.listed.frequencies / f))
    return misfit


def coarse_misfit(r: Array) -> Array:
    """A misfit that ranks far-off residuals (m, n_f) of the log frequencies, (m,)."""
    r = r - SEARCH.forgiven * r.mean(axis=1, keepdims=True)
    return np.asarray(np.sum(np.log1p((r / SEARCH.coarse) ** 2), axis=1))


@dataclass(frozen=True, slots=True)
class Nodes:
    """Conditional optima at held sizes.

    columns : of the sizes that are held
    scores : (k, d)
    value : (k,)
    rest : (k, n - d)
    curvature : (k, n - d, n - d)
    """

    columns: tuple[int, ...]
    scores: Array
    value: Array
    rest: Array
    curvature: Array

    @property
    def log_density(self) -> Array:
        """Log density of the sizes and the data, the rest integrated by Laplace's method, (k,)."""
        n = self.rest.shape[1]
        return np.asarray(
            self.value + 0.5 * n * np.log(2 * np.pi) - 0.5 * np.linalg.slogdet(self.curvature)[1]
        )

    def components(self, comparison: LogDensity, kept: Array, width: Array) -> tuple[Array, Array]:
        """Centres (p, n) and square roots (p, n, n) of the covariances of a mixture about some nodes.

        Along the sizes a component is as wide as its node is far from the next ones; the optimum of the rest
        moves with the sizes as dr/ds = -C_rr^-1 C_rs.

        kept : (p,) numbers of the nodes
        width : (k, d)
        """
        z = inserted(self.columns, self.scores[kept], self.rest[kept])
        curvature = comparison.expand(z).curvature
        d, n = len(self.columns), z.shape[1]
        columns = np.array(self.columns)
        rest = np.delete(np.arange(n), columns)
        inverse = np.linalg.inv(self.curvature[kept])
        cross = curvature[:, rest][:, :, columns]
        slope = np.clip(-inverse @ cross, -_NODE.steepest, _NODE.steepest)
        factor = np.zeros((len(z), n, n))
        factor[:, rest[:, None], np.arange(n - d)] = np.linalg.cholesky(inverse)
        factor[:, columns, n - d + np.arange(d)] = width[kept]
        factor[:, rest[:, None], n - d + np.arange(d)] = slope * width[kept][:, None, :]
        return z, factor


def inserted(columns: tuple[int, ...], scores: Array, rest: Array) -> Array:
    """Scores (..., n) of held sizes (..., d) and the rest (..., n - d)."""
    n = len(columns) + rest.shape[-1]
    z = np.empty((*rest.shape[:-1], n))
    z[..., list(columns)] = scores
    z[..., np.delete(np.arange(n), columns)] = rest
    return z


def conditional_optima(
    comparison: LogDensity, columns: tuple[int, ...], scores: Array, optima: Optima
) -> Nodes:
    """The optima of the rest at sizes (k, d), approached from the joint optimum nearest in size."""
    rest = np.delete(np.arange(comparison.parameters.size), columns)

    def target(r: Array, rows: Array) -> Expansion:
        e = comparison.expand(inserted(columns, scores[rows], r))
        return Expansion(e.value, e.gradient[:, rest], e.curvature[:, rest][:, :, rest])

    bound = np.full(len(rest), MAX_SCORE)
    start = _along_tangents(columns, rest, scores, optima)
    maxima = maximise(target, start, -bound, bound, most_steps=_NODE.steps, promised=_NODE.promised)
    e = maxima.expansion
    value = np.where(np.isfinite(e.value), e.value, -1e300)
    return Nodes(columns, scores, value, maxima.u, e.curvature)


def _along_tangents(columns: tuple[int, ...], rest: Array, scores: Array, optima: Optima) -> Array:
    """Starts (k, n - d) for the rest from the joint optimum nearest in size."""
    away = scores[:, None] - optima.z[:, list(columns)]  # (k, optima, d)
    far = np.sum(away**2, axis=2) - 2e-2 * (optima.value - optima.value.max())
    nearest = far.argmin(axis=1)
    c_rr = optima.curvature[:, rest][:, :, rest]
    slope = -np.linalg.solve(c_rr, optima.curvature[:, rest][:, :, list(columns)])
    moved = np.einsum(
        "krd,kd->kr",
        np.clip(slope, -_NODE.steepest, _NODE.steepest)[nearest],
        away[np.arange(len(scores)), nearest],
    )
    return np.asarray(np.clip(optima.z[nearest][:, rest] + np.clip(moved, -2.0, 2.0), -6.0, 6.0))
