"""All optima of a hypothesis over constants and sizes together, from many starts.

The plain model's optimum is a good start for faint effects and a bad one for gross errors: plies turned by
several degrees move the constants as far as the effect itself. Draws of the prior are therefore screened on
the reduced model, the best of them optimised in rounds, fewer and further each time, together with what is
known already (the plain model's optima, the reference).

The nodes of an effect's integral are optima of constants and noise at held values of its sizes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp, ndtri
from scipy.stats import qmc

from cpam_bayes.diagnosis.comparison import Comparison
from cpam_bayes.inference.derivatives import MAX_SCORE, Expansion, apart
from cpam_bayes.inference.laplace import maximise
from cpam_bayes.mechanics.modes import RigidBodyError

Array = NDArray[Any]

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
    distinct_sd : optima are the same within this distance, standard deviations
    depth_nats : optima are kept within so much of the best
    """

    log2_draws: int = 9
    rounds: tuple[tuple[int, int], ...] = ((40, 3), (12, 6), (6, 25))
    promised: float = 3e-3
    coarse: float = 0.02
    forgiven: float = 0.9
    first_noise: float = 1.5
    overshoot: float = 10.0
    distinct_sd: float = 1.0
    depth_nats: float = 25.0


@dataclass(frozen=True, slots=True)
class NodeSettings:
    """The optima of constants and noise at held sizes.

    promised : optimisations end where a step promises less, nats, or after most_steps; few_steps where they
        only come nearer
    from_optima : joint optima that each node is approached from
    distinct_sd : optima of one node are the same within this distance, standard deviations
    steepest : a node's optimum moves with the size by no more than this, scores per score
    """

    promised: float = 3e-3
    most_steps: int = 12
    few_steps: int = 6
    from_optima: int = 2
    distinct_sd: float = 1.0
    steepest: float = 3.0


SEARCH: Final = SearchSettings()
_NODE: Final = NodeSettings()


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
            optima, promise = maximised(comparison, z[: keep + first], steps)
            z, first = optima.z, 0
        if len(z) and (optima.value + SEARCH.overshoot * promise).max() < least - SEARCH.depth_nats:
            return Optima(optima.z[:1], optima.value[:1], optima.curvature[:1])
    most, steps = SEARCH.rounds[-1]
    optima, _ = maximised(comparison, z[: max(most, first)], steps)
    if not len(optima.value):
        raise RigidBodyError("at no start the plate has modes, or the constraints are satisfied")
    near = optima.value > optima.value[0] - SEARCH.depth_nats
    return Optima(optima.z[near], optima.value[near], optima.curvature[near])


def prior_draws(comparison: Comparison, sizes: tuple[int, ...], log2_draws: int) -> Array:
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
    r = r - SEARCH.forgiven * r.mean(axis=1, keepdims=True)
    return np.asarray(np.sum(np.log1p((r / SEARCH.coarse) ** 2), axis=1))


def maximised(
    comparison: Comparison, z: Array, most_steps: int, promised: float = SEARCH.promised
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
    return [int(order[i]) for i in apart(z[order], expansion.curvature[order], SEARCH.distinct_sd)]


_HALF_LOG_2PI = 0.5 * np.log(2 * np.pi)


@dataclass(frozen=True, slots=True)
class Nodes:
    """Conditional optima at held sizes, up to two a node, the better one first.

    columns : of the sizes that are held
    scores : (k, d)
    value : (k, c), -inf where there is no further optimum
    rest : (k, c, n - d)
    curvature : (k, c, n - d, n - d)
    """

    columns: tuple[int, ...]
    scores: Array
    value: Array
    rest: Array
    curvature: Array

    @property
    def log_mass(self) -> Array:
        """Log density of the sizes and the data about each optimum, the rest integrated, (k, c)."""
        n = self.rest.shape[2]
        return np.asarray(self.value + n * _HALF_LOG_2PI - 0.5 * np.linalg.slogdet(self.curvature)[1])

    @property
    def log_density(self) -> Array:
        """The same over all optima of each node, (k,)."""
        return np.asarray(logsumexp(self.log_mass, axis=1))

    def z(self) -> Array:
        """Scores of all optima, (k, c, n)."""
        return inserted(self.columns, np.repeat(self.scores[:, None], self.rest.shape[1], axis=1), self.rest)

    def merged(self, rows: Array, again: Nodes) -> Nodes:
        """The nodes with further optima (as many nodes as rows) of some of them."""
        value, rest, curvature = self.value.copy(), self.rest.copy(), self.curvature.copy()
        value[rows], rest[rows], curvature[rows] = _best_of(
            np.concatenate((self.value[rows], again.value), axis=1),
            np.concatenate((self.rest[rows], again.rest), axis=1),
            np.concatenate((self.curvature[rows], again.curvature), axis=1),
        )
        return replace(self, value=value, rest=rest, curvature=curvature)

    def components(
        self, comparison: Comparison, log_mass: Array, width: Array, negligible: float
    ) -> tuple[Array, Array, Array]:
        """Optima (p, n), square roots (p, n, n) of their covariances and log masses (p,) of a mixture.

        Along the sizes a component is as wide as its node is far from the next ones; the optimum of the rest
        moves with the sizes as dr/ds = -C_rr^-1 C_rs.

        log_mass : (k,) of the nodes
        width : (k, d)
        """
        # in this order: where the plate buckles both densities are so low that they swallow the mass
        each = log_mass[:, None] + (self.log_mass - self.log_density[:, None])
        which = np.nonzero(each > each.max() + np.log(negligible))
        z, log_each = self.z()[which], each[which]
        curvature = comparison.expand(z).curvature
        d, n = len(self.columns), z.shape[1]
        columns = np.array(self.columns)
        rest = np.delete(np.arange(n), columns)
        inverse = np.linalg.inv(self.curvature[which])
        cross = curvature[:, rest][:, :, columns]
        slope = np.clip(-inverse @ cross, -_NODE.steepest, _NODE.steepest)
        factor = np.zeros((len(z), n, n))
        factor[:, rest[:, None], np.arange(n - d)] = np.linalg.cholesky(inverse)
        spread = width[which[0]]
        factor[:, columns, n - d + np.arange(d)] = spread
        factor[:, rest[:, None], n - d + np.arange(d)] = slope * spread[:, None, :]
        return z, factor, log_each


def inserted(columns: tuple[int, ...], scores: Array, rest: Array) -> Array:
    """Scores (..., n) of held sizes (..., d) and the rest (..., n - d)."""
    n = len(columns) + rest.shape[-1]
    z = np.empty((*rest.shape[:-1], n))
    z[..., list(columns)] = scores
    z[..., np.delete(np.arange(n), columns)] = rest
    return z


def conditional_optima(
    comparison: Comparison,
    columns: tuple[int, ...],
    scores: Array,
    optima: Optima | None,
    known: Array,
    *,
    few: bool = False,
) -> Nodes:
    """The best optima of the rest at sizes (k, d).

    optima : joint ones; the nearest of them are approached from along their tangents
    known : further starts, (s, n) whole scores, or (k, s, n - d) for each node
    few : only from the nearest joint optimum, which is near enough for a few steps
    """
    k, n = len(scores), comparison.parameters.size
    rest = np.delete(np.arange(n), columns)
    starts = [] if known.ndim == 2 else [known]
    if known.ndim == 2:
        used = known[:0] if few and optima is not None else known
        starts.append(np.broadcast_to(used[:, rest], (k, len(used), len(rest))))
    if optima is not None:
        starts.append(_along_tangents(columns, rest, scores, optima, 1 if few else _NODE.from_optima))
    begin = np.concatenate(starts, axis=1)
    s = begin.shape[1]
    held = np.repeat(scores, s, axis=0)

    def target(r: Array, rows: Array) -> Expansion:
        e = comparison.expand(inserted(columns, held[rows], r))
        return Expansion(e.value, e.gradient[:, rest], e.curvature[:, rest][:, :, rest])

    bound = np.full(len(rest), MAX_SCORE)
    flat = begin.reshape(k * s, len(rest))
    maxima = maximise(
        target,
        flat,
        -bound,
        bound,
        most_steps=_NODE.few_steps if few else _NODE.most_steps,
        promised=_NODE.promised,
    )
    e = maxima.expansion
    value = np.where(np.isfinite(e.value), e.value, -1e300).reshape(k, s)
    value, r, curvature = _best_of(
        value, maxima.u.reshape(k, s, -1), e.curvature.reshape(k, s, len(rest), len(rest))
    )
    return Nodes(columns, scores, value, r, curvature)


def _along_tangents(columns: tuple[int, ...], rest: Array, scores: Array, optima: Optima, most: int) -> Array:
    """Starts (k, most, n - d) for the rest from the joint optima nearest in size."""
    at = optima.z[:, list(columns)]
    away = scores[:, None] - at  # (k, optima, d)
    far = np.sum(away**2, axis=2) - 2e-2 * (optima.value - optima.value.max())
    nearest = np.argsort(far, axis=1, kind="stable")[:, :most]
    c_rr = optima.curvature[:, rest][:, :, rest]
    slope = -np.linalg.solve(c_rr, optima.curvature[:, rest][:, :, list(columns)])
    step = np.take_along_axis(away, nearest[..., None], axis=1)
    moved = np.einsum("ksrd,ksd->ksr", np.clip(slope, -_NODE.steepest, _NODE.steepest)[nearest], step)
    return np.asarray(np.clip(optima.z[nearest][..., rest] + np.clip(moved, -2.0, 2.0), -6.0, 6.0))


def _best_of(value: Array, rest: Array, curvature: Array) -> tuple[Array, Array, Array]:
    """The best of candidates (k, s, ...) at each node, and the best that is another optimum."""
    k = len(value)
    rows = np.arange(k)
    first = value.argmax(axis=1)
    away = rest - rest[rows, first][:, None]
    distance = np.einsum("ksi,kij,ksj->ks", away, curvature[rows, first], away)
    others = np.where(distance > _NODE.distinct_sd**2, value, -np.inf)
    second = others.argmax(axis=1)
    which = np.stack((first, second), axis=1)
    kept = np.take_along_axis(value, which, axis=1)
    kept[:, 1] = others[rows, second]
    return (
        kept,
        np.take_along_axis(rest, which[..., None], axis=1),
        np.take_along_axis(curvature, which[..., None, None], axis=1),
    )


def joined(a: Nodes, b: Nodes) -> Nodes:
    """The nodes of both, by their first size."""
    scores = np.concatenate((a.scores, b.scores))
    order = np.argsort(scores[:, 0], kind="stable")
    return Nodes(
        a.columns,
        scores[order],
        *(
            np.concatenate((getattr(a, name), getattr(b, name)))[order]
            for name in ("value", "rest", "curvature")
        ),
    )
