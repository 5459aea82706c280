"""Marginal likelihood of a hypothesis: Laplace's approximation where it holds, quadrature where it does not.

All optima over constants and sizes together are sought first. A size that the data determine is one
Gaussian more. One that they do not determine has a density that no Gaussian describes: skew, taper, warp and
turned plies have zero slope at zero by symmetry, what can only add piles up at zero, and a place is anywhere.
Such sizes are integrated over nodes, one size on a grid refined where the mass is, several on scattered
points; the constants and the noise are integrated at each node by Laplace's method in normal scores.

A tested hypothesis keeps its marginal likelihood, its best fit, and its shifts of the frequencies at the
plain model's optimum.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.special import logsumexp

from cpam_bayes.diagnosis.comparison import Comparison, PlateCase, effect_columns
from cpam_bayes.diagnosis.evidence.optima import (
    SEARCH,
    SIZE_RANGE,
    Nodes,
    Optima,
    conditional_optima,
    find_optima,
    joined,
    size_points,
    spread_scores,
)
from cpam_bayes.diagnosis.hypotheses import Hypothesis
from cpam_bayes.inference.derivatives import MAX_SCORE, Expansion
from cpam_bayes.inference.laplace import maximise
from cpam_bayes.inference.student_mixture import Mixture, sobol_points
from cpam_bayes.parameters import Parameter
from cpam_bayes.running import single_blas_thread

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
    """The evidence of one hypothesis and the posterior of its parameters.

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
    log2_draws: int = SEARCH.log2_draws,
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
    """True where the optimum of a node is off the line between those of its neighbours, (k,) bool.

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


# Nodes of one size between the ends of the grid, sizes evenly spread over the prior that join them, and the
# scattered nodes, log2, of several sizes.
_SHIFT_NODES, _SHIFT_EVEN, _LOG2_SHIFTS = 19, 9, 7


@dataclass(frozen=True, slots=True)
class ShiftTable:
    """Shifts of the log frequencies of the lists at nodes of an effect's sizes.

    scores : (k, d) of the size and further coordinates
    log_prior : (k,) log prior weights of the nodes, normalised
    shift : (k, n_f)
    """

    scores: Array
    log_prior: Array
    shift: Array


def size_nodes(comparison: Comparison, sizes: tuple[int, ...]) -> tuple[Array, Array]:
    """Nodes (k, d) of an effect's sizes in normal scores and the logs (k,) of their prior weights."""
    if len(sizes) == 1:
        even = size_points(comparison, sizes[0], _SHIFT_EVEN)
        score = np.concatenate((np.linspace(-SIZE_RANGE, SIZE_RANGE, _SHIFT_NODES), even))
        score = np.unique(np.round(score, 6))
        log_weight = np.log(np.gradient(score)) - 0.5 * score**2
        return score[:, None], log_weight - logsumexp(log_weight)
    scores = spread_scores(len(sizes), _LOG2_SHIFTS, 0)
    log_weight = -0.5 * scores[:, 0] ** 2
    return scores, log_weight - logsumexp(log_weight)


def shift_table(
    comparison: Comparison, effect: Sequence[Parameter], sizes: tuple[int, ...], about: Marginal
) -> ShiftTable:
    """Shifts by an effect at the optimum of another hypothesis.

    What that hypothesis lacks is at its prior median.

    Nodes at which the plate buckles or the constraints (9) are broken are left out, if need be all.

    comparison : with the effect
    effect, sizes : the d parameters of the effect, and their columns
    about : the other hypothesis
    """
    medians = comparison.scores.to_x(np.zeros((1, comparison.parameters.size)))[0]
    x = comparison.carried(about.comparison, about.best, medians)
    x = np.clip(x, comparison.parameters.lower, comparison.parameters.upper)
    null = [0.0 if p.null is None else p.null for p in effect]
    scores, log_prior = size_nodes(comparison, sizes)
    z = np.repeat(comparison.scores.to_z(x[None]), len(scores), axis=0)
    z[:, list(sizes)] = scores
    at = comparison.scores.to_x(z)
    at[:, _others(len(x), sizes)] = x[_others(len(x), sizes)]
    plain = x.copy()
    plain[list(sizes)] = null
    f, _ = comparison.predict(plain[None])
    inside, shifted, _ = comparison.predict_inside(at)
    log_prior = log_prior[inside]
    if not len(inside):
        return ShiftTable(scores[:0], log_prior, shifted)
    return ShiftTable(scores[inside], log_prior - logsumexp(log_prior), np.log(shifted / f))


def _others(n: int, sizes: tuple[int, ...]) -> Array:
    return np.delete(np.arange(n), sizes)


@dataclass(frozen=True, slots=True)
class Tested:
    """One hypothesis with its marginal likelihood; of an incomplete list, with one of its pairings.

    plates : numbers of the plates that have it; all of them where they share it
    probability : among all that were tested
    log_bayes_factor : against none
    shift : of the log frequencies, with the constants of the plain model; ``None`` where the list is paired
        otherwise
    cases : the plates with the pairing of incomplete lists; none where all lists are complete
    as_plain : the hypothesis with the plain model's most probable pairing; ``None`` where lists are complete
    """

    hypothesis: Hypothesis
    plates: tuple[int, ...]
    marginal: Marginal
    probability: float = 0.0
    log_bayes_factor: float = 0.0
    shift: ShiftTable | None = None
    cases: tuple[PlateCase, ...] = ()
    as_plain: Comparison | None = None

    @property
    def columns(self) -> tuple[int, ...]:
        """Columns of the effect's parameters."""
        return effect_columns(self.marginal.comparison, self.hypothesis)

    @property
    def key(self) -> tuple[str, str, tuple[int, ...]]:
        """The same for all pairings of one hypothesis."""
        return (self.hypothesis.cause, self.hypothesis.variant, self.plates)

    @property
    def log_weight(self) -> float:
        """Log of prior times evidence."""
        return float(np.log(self.hypothesis.prior) + self.marginal.log_evidence)


def ranked(tested: Sequence[Tested]) -> list[Tested]:
    """Hypotheses, those with most prior times evidence first."""
    return sorted(tested, key=lambda t: t.log_weight, reverse=True)


def distinct_hypotheses(tested: Sequence[Tested]) -> list[Hypothesis]:
    """Every hypothesis once, whatever the number of its pairings."""
    return list({t.key: t.hypothesis for t in tested}.values())


def prior_of(tested: Sequence[Tested]) -> float:
    """Sum of the priors, every hypothesis counted once."""
    return float(sum(h.prior for h in distinct_hypotheses(tested)))


# Fraction of the priors' weight that is kept: scores that nothing determines stay where they are.
_KEPT = 1e-3
# Optima and draws of the posterior that the search begins from.
_OPTIMA, _DRAWS = 4, 4


@single_blas_thread
def best_log_likelihood(marginal: Marginal) -> float:
    """The largest log likelihood within the bounds of the priors, noise and discrepancy at their priors.

    What a prior says of constants and sizes is left out, so that hypotheses are compared by what the data
    can tell of them.
    """
    comparison = marginal.comparison
    n, n_model = comparison.parameters.size, comparison.model.parameters.size
    weight = np.where(np.arange(n) < n_model, 1.0 - _KEPT, 0.0)

    def target(z: Array, rows: Array) -> Expansion:
        del rows
        e = comparison.expand(z)
        return Expansion(
            e.value + 0.5 * np.sum(weight * z**2, axis=1),
            e.gradient + weight * z,
            e.curvature - np.diag(weight),
        )

    draws = comparison.scores.to_z(marginal.resampled(_DRAWS))
    start = np.concatenate((marginal.z[:_OPTIMA], draws))
    bound = np.full(n, MAX_SCORE)
    maxima = maximise(target, start, -bound, bound, most_steps=30, promised=1e-2)
    best = maxima.u[
        int(np.argmax(np.where(np.isfinite(maxima.expansion.value), maxima.expansion.value, -np.inf)))
    ]
    log_prior = -0.5 * float(np.sum(best[n_model:] ** 2))
    return float(comparison.log_likelihood(comparison.scores.to_x(best[None]))[0]) + log_prior
