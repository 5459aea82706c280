"""Marginal likelihood of a hypothesis: Laplace's approximation where it holds, quadrature where it does not.

All optima over constants and sizes together are sought first. A size that the data determine is one
Gaussian more. One that they do not determine has a density that no Gaussian describes: skew, taper, warp and
turned plies have zero slope at zero by symmetry, what can only add piles up at zero, and a place is anywhere.
Such sizes are integrated over nodes, one size on a grid refined where the mass is, several on scattered
points; the constants and the noise are integrated at each node by Laplace's method in normal scores.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.special import logsumexp

from cpam_bayes.diagnosis.evidence.comparison import Comparison
from cpam_bayes.diagnosis.evidence.nodes import Nodes, conditional_optima, joined
from cpam_bayes.diagnosis.evidence.optima import (
    LOG2_DRAWS,
    SIZE_RANGE,
    Optima,
    find_optima,
    size_points,
    spread_scores,
)
from cpam_bayes.inference.student_mixture import Mixture, sobol_points
from cpam_bayes.threads import single_blas_thread

Array = NDArray[Any]

# A size is determined where its score's standard deviation is below this at every optimum that carries mass.
_DETERMINED_SD, _CARRIES = 0.15, 1e-3
# Scores of the first grid; intervals are halved where the log density changes by more than _STEEP_NATS and
# they may hold more than _WORTH of the whole, but never below _FINEST.
GRID = np.linspace(-SIZE_RANGE, SIZE_RANGE, 10)
_STEEP_NATS, _WORTH, _FINEST, _MOST_HALVINGS = 1.0, 5e-3, 0.01, 6
# Nodes this far below the best are not approached from their neighbours.
_DEPTH_NATS = 14.0
# Sizes evenly spread between the bounds of the prior that join the grid: gross errors fill its tails.
_EVEN_SIZES = 9
# Nodes about each optimum, in standard deviations of its size.
_ABOUT = np.array([-2.5, -1.0, 0.0, 1.0, 2.5])
# Scattered nodes, log2, by the number of sizes that are not determined.
_LOG2_SCATTERED = {2: 6, 3: 7, 4: 7}
_MOST_SCATTERED = 8
# An optimum further than this, standard deviations, from the line between its neighbours may be another one.
_BENT_SD = 1.0
# Points of the fine quadrature between the nodes.
_FINE = 1601
# Nodes with less mass propose nothing.
_NEGLIGIBLE_FRACTION = 1e-4
# Degrees of freedom and widening of the mixture that importance sampling proposes, log2 of its points.
_FREEDOM, WIDER, LOG2_POINTS = 6.0, 1.15, 9
_HALF_LOG_2PI = 0.5 * np.log(2 * np.pi)


@dataclass(frozen=True, slots=True)
class Marginal:
    """What one hypothesis says of the data, and what the data say of its parameters.

    sizes : columns of the effect's size and further coordinates
    log_evidence : log marginal likelihood
    error, effective_size, k_hat : of importance sampling, as in ``Weighted``; ``nan`` for Laplace's
    z, weight : (k, n) optima, of nodes where there are some, and (k,) their fractions of the evidence, the
        largest first
    proposal : a stack of one mixture about them
    is_scattered : whether several sizes are integrated over scattered nodes
    draws, log_weight : (d, n) parameters and (d,) their normalised log weights
    """

    comparison: Comparison
    sizes: tuple[int, ...]
    log_evidence: float
    error: float
    z: Array
    weight: Array
    proposal: Mixture
    is_scattered: bool
    draws: Array
    log_weight: Array
    effective_size: float = np.nan
    k_hat: float = np.nan

    @property
    def best(self) -> Array:
        """Most probable parameters of the node with most mass, (n,)."""
        return np.asarray(self.comparison.scores.to_x(self.z[0]))

    @property
    def is_sampled(self) -> bool:
        """Whether it is known by importance sampling."""
        return bool(np.isfinite(self.error))

    def moments(self) -> tuple[Array, Array]:
        """Posterior mean and standard deviation of the parameters, (n,) each."""
        w = np.exp(self.log_weight)
        mean = w @ self.draws
        return mean, np.sqrt(np.maximum(w @ (self.draws - mean) ** 2, 0.0))

    def resampled(self, size: int) -> Array:
        """Equally probable draws (size, n), by systematic resampling."""
        cumulative = np.cumsum(np.exp(self.log_weight))
        at = np.searchsorted(cumulative / cumulative[-1], (np.arange(size) + 0.5) / size)
        return np.asarray(self.draws[np.minimum(at, len(self.draws) - 1)])


@single_blas_thread
def laplace_marginal(
    comparison: Comparison,
    sizes: tuple[int, ...],
    known: Array,
    *,
    smooth: tuple[int, ...] = (),
    log2_draws: int = LOG2_DRAWS,
    least: float = -np.inf,
) -> Marginal:
    """The marginal likelihood over nodes of the sizes that the data leave open.

    known : (s, n) scores that optimisations begin from, beside draws of the prior
    smooth : those of the sizes that are left to Laplace's method even where they are open
    log2_draws : of these draws, none at all where it is 0
    least : log evidence about the optima below which nothing is refined

    The draws are those of the Laplace approximation.
    """
    optima = find_optima(comparison, sizes, known, log2_draws=log2_draws, least=least)
    open_sizes = _not_determined(optima, tuple(s for s in sizes if s not in smooth))
    if float(logsumexp(optima.log_mass)) < least:
        open_sizes = ()
    if not open_sizes:
        return _about_optima(comparison, sizes, optima)
    if len(open_sizes) == 1:
        return _by_quadrature(comparison, sizes, open_sizes[0], optima, known, few=not log2_draws)
    return _by_scattered(comparison, sizes, open_sizes, optima, known)


def _not_determined(optima: Optima, sizes: tuple[int, ...]) -> tuple[int, ...]:
    """Those of the sizes that are too open for a Gaussian.

    Where the first one is, all of them are: a small mass may be anywhere, whatever its place at the optimum.
    """
    log_mass = optima.log_mass
    carry = log_mass > log_mass.max() + np.log(_CARRIES)
    variance = np.diagonal(np.linalg.inv(optima.curvature[carry]), axis1=1, axis2=2)
    undetermined = tuple(s for s in sizes if np.sqrt(variance[:, s].max()) > _DETERMINED_SD)
    return sizes if sizes and sizes[0] in undetermined else undetermined


def _about_optima(comparison: Comparison, sizes: tuple[int, ...], optima: Optima) -> Marginal:
    """Laplace's approximation about every optimum."""
    log_mass = optima.log_mass
    log_evidence = float(logsumexp(log_mass))
    factor = np.linalg.cholesky(np.linalg.inv(optima.curvature))
    return _marginal(comparison, sizes, log_evidence, optima.z, factor, log_mass, is_scattered=False)


def _by_quadrature(
    comparison: Comparison,
    sizes: tuple[int, ...],
    column: int,
    optima: Optima,
    known: Array,
    *,
    few: bool,
) -> Marginal:
    """One size gone through node by node."""
    sd = np.sqrt(np.linalg.inv(optima.curvature)[:, column, column])
    about = (optima.z[:, column, None] + sd[:, None] * _ABOUT).ravel()
    even = size_points(comparison, column, _EVEN_SIZES)
    score = np.concatenate(
        (GRID, even[(np.abs(even) > GRID[-1] / 3) & (not few)], about[np.abs(about) < GRID[-1]])
    )
    score = np.unique(np.round(score, 4))
    score = score[np.insert(np.diff(score) > _FINEST, 0, True)]
    nodes = conditional_optima(comparison, (column,), score[:, None], optima, known, few=few)
    nodes = _from_neighbours(comparison, column, nodes)
    for _ in range(_MOST_HALVINGS):
        middle, begin = _halved(nodes)
        if not len(middle):
            break
        smooth = begin.shape[1] == 1
        further = conditional_optima(comparison, (column,), middle[:, None], None, begin, few=smooth)
        nodes = joined(nodes, further)
    log_evidence, log_mass = _integrated(nodes.scores[:, 0], nodes.log_density)
    width = _spacing(nodes.scores[:, 0])
    z, factor, each = nodes.components(comparison, log_mass, width[:, None], _NEGLIGIBLE_FRACTION)
    return _marginal(comparison, sizes, log_evidence, z, factor, each, is_scattered=False)


def _by_scattered(
    comparison: Comparison, sizes: tuple[int, ...], columns: tuple[int, ...], optima: Optima, known: Array
) -> Marginal:
    """Several sizes on points that fill their priors, and about the optima."""
    d = len(columns)
    log2 = _LOG2_SCATTERED.get(d, _MOST_SCATTERED)
    first = columns[0] == sizes[0]
    score = spread_scores(d, log2, 0 if first else None)
    width = np.full(d, 2.0 / (1 << log2) ** (1.0 / d))
    normal = score[:, 1:] if first else score
    log_q = -0.5 * np.sum(normal**2, axis=1) - normal.shape[1] * _HALF_LOG_2PI
    if first:
        log_q -= np.log(2 * SIZE_RANGE)
        width[0] *= 1.8
    nodes = conditional_optima(comparison, columns, score, optima, known, few=True)
    log_mass = nodes.log_density - log_q - np.log(len(score))
    spread = np.broadcast_to(width, score.shape)
    z, factor, each = nodes.components(comparison, log_mass, spread, _NEGLIGIBLE_FRACTION)
    of_optima = optima.log_mass
    log_evidence = max(float(logsumexp(log_mass)), float(logsumexp(of_optima)))
    z = np.concatenate((z, optima.z))
    factor = np.concatenate((factor, np.linalg.cholesky(np.linalg.inv(optima.curvature))))
    return _marginal(
        comparison, sizes, log_evidence, z, factor, np.concatenate((each, of_optima)), is_scattered=True
    )


def _marginal(
    comparison: Comparison,
    sizes: tuple[int, ...],
    log_evidence: float,
    z: Array,
    factor: Array,
    log_mass: Array,
    *,
    is_scattered: bool,
) -> Marginal:
    kept = np.flatnonzero(log_mass > log_mass.max() + np.log(_NEGLIGIBLE_FRACTION))
    kept = kept[np.argsort(-log_mass[kept], kind="stable")]
    weight = np.exp(log_mass[kept] - logsumexp(log_mass[kept]))
    proposal = Mixture(weight[None], z[None, kept], factor[None, kept], np.inf)
    draws = comparison.scores.to_x(sobol_points(proposal, LOG2_POINTS)[0])
    return Marginal(
        comparison=comparison,
        sizes=sizes,
        log_evidence=log_evidence,
        error=np.nan,
        z=z[kept],
        weight=weight,
        proposal=replace(proposal, factor=WIDER * proposal.factor, degrees_of_freedom=_FREEDOM),
        is_scattered=is_scattered,
        draws=draws,
        log_weight=np.full(len(draws), -np.log(len(draws))),
    )


def _from_neighbours(comparison: Comparison, column: int, nodes: Nodes) -> Nodes:
    """The nodes optimised again from their neighbours' optima: crossing modes part them."""
    k = len(nodes.scores)
    near = nodes.log_density > nodes.log_density.max() - _DEPTH_NATS
    first = nodes.rest[:, 0]
    sides = np.clip(np.arange(k)[:, None] + np.array([-1, 1]), 0, k - 1)
    near = np.flatnonzero(near & _bent(nodes))
    if not len(near):
        return nodes
    begin = first[sides[near]]
    again = conditional_optima(comparison, (column,), nodes.scores[near], None, begin)
    return nodes.merged(near, again)


def _bent(nodes: Nodes) -> Array:
    """Whether the optimum of a node is off the line between those of its neighbours, (k,) bool.

    Optima that move with the size on one branch are on it, those of two branches are not.
    """
    score, first = nodes.scores[:, 0], nodes.rest[:, 0]
    bent = np.zeros(len(score), dtype=bool)
    part = ((score[1:-1] - score[:-2]) / (score[2:] - score[:-2]))[:, None]
    away = first[1:-1] - (1.0 - part) * first[:-2] - part * first[2:]
    distance = np.einsum("ki,kij,kj->k", away, nodes.curvature[1:-1, 0], away)
    bent[1:-1] = distance > _BENT_SD**2
    return bent


def _halved(nodes: Nodes) -> tuple[Array, Array]:
    """Midpoints of intervals that are too coarse, and starts for them, (k, s, n - 1).

    These are between the optima of both ends, and where these may be two, at the ends too.
    """
    score, g = nodes.scores[:, 0], nodes.log_density
    density = np.exp(g - g.max())
    width = np.diff(score)
    whole = 0.5 * float(np.sum((density[1:] + density[:-1]) * width))
    most = np.maximum(density[1:], density[:-1]) * width
    steep = np.abs(np.diff(g)) > _STEEP_NATS
    which = np.flatnonzero(steep & (most > _WORTH * whole) & (width > _FINEST))
    left, right = nodes.rest[which, 0], nodes.rest[which + 1, 0]
    starts = [0.5 * (left + right)]
    bent = _bent(nodes)
    if np.any(bent[which] | bent[which + 1]):
        starts += [left, right]
    return 0.5 * (score[which] + score[which + 1]), np.stack(starts, axis=1)


def _integrated(score: Array, g: Array) -> tuple[float, Array]:
    """Log of the integral of exp(g) over the score, and the log mass of each node's surroundings, (k,)."""
    top = float(g.max())
    fine = np.unique(np.concatenate((np.linspace(score[0], score[-1], _FINE), score)))
    density = np.exp(np.maximum(PchipInterpolator(score, np.maximum(g - top, -800.0))(fine), -700.0))
    panel = 0.5 * (density[1:] + density[:-1]) * np.diff(fine)
    # beyond the grid the prior is left, and the likelihood of its ends
    end = np.abs(score[[0, -1]])
    tail = np.exp(g[[0, -1]] - top) / np.maximum(end, 1.0)
    owner = np.abs(0.5 * (fine[1:] + fine[:-1])[:, None] - score).argmin(axis=1)
    mass = np.asarray(np.bincount(owner, panel, minlength=len(g)), dtype=float)
    mass[0] += tail[0]
    mass[-1] += tail[1]
    with np.errstate(divide="ignore"):
        return top + float(np.log(mass.sum())), top + np.log(mass)


def _spacing(score: Array) -> Array:
    """Half the distance between the neighbours of every node, (k,)."""
    padded = np.concatenate((score[:1] - np.diff(score[:2]), score, score[-1:] + np.diff(score[-2:])))
    return np.asarray(0.5 * (padded[2:] - padded[:-2]))
