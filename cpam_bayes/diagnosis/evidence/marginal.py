"""Marginal likelihood of one hypothesis: its optima, and a proposal about them.

A size that the data determine is one more Gaussian coordinate. One that they leave open has a density that
is not Gaussian: skew, taper, warp and turned plies have zero slope at zero by symmetry, a one-sided size
piles up at zero, and a place may be anywhere. The proposal has components at nodes that fill the priors of
such sizes. The evidence by these Gaussians ranks hypotheses; those near the best are sampled (`sampled`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from cpam_bayes.diagnosis.comparison import PlateCase, effect_columns
from cpam_bayes.diagnosis.evidence.nodes import conditional_optima, size_points
from cpam_bayes.diagnosis.hypotheses import Hypothesis
from cpam_bayes.inference.importance import about
from cpam_bayes.inference.laplace import SEARCH, SIZE_RANGE, Optima, find_optima, maximised, spread_scores
from cpam_bayes.inference.log_density import CorrelatedDensity
from cpam_bayes.inference.student_mixture import Mixture, sobol_points
from cpam_bayes.mechanics.problem import Array
from cpam_bayes.parameters import Parameter
from cpam_bayes.running import single_blas_thread

# A size is determined if its score's standard deviation is below this at every optimum of this relative mass.
_DETERMINED_SD, _CARRIES = 0.15, 1e-3
# Nodes of one open size: scores of a grid, and sizes evenly spread over the prior, whose tails
# gross errors fill; scattered nodes of several sizes, log2, by the number of sizes.
_GRID, _EVEN_SIZES = np.linspace(-3.3, 3.3, 9), 5
_LOG2_SCATTERED = {2: 5, 3: 5, 4: 6}
_MOST_SCATTERED = 7
# Largest part of the nodes' mass for an optimum that leaves the sizes open.
_OF_OPEN_OPTIMUM = 0.2
# Nodes with a smaller part of the mass are left out.
_NEGLIGIBLE_FRACTION = 1e-4
# Draws of Laplace's approximation, log2.
LOG2_POINTS = 9
_HALF_LOG_2PI = 0.5 * np.log(2 * np.pi)


@dataclass(frozen=True, slots=True)
class Marginal:
    """The evidence of one hypothesis and the posterior of its parameters.

    sizes : columns of the effect's size and further coordinates
    log_evidence : log marginal likelihood
    error, effective_size, k_hat : of importance sampling, as in ``Weighted``; ``nan`` for Laplace's
    z, weight : (k, n) optima and nodes, and (k,) their fractions of the evidence, the largest first
    proposal : a stack of one mixture about them
    draws, log_weight : (d, n) parameters and (d,) their normalised log weights
    """

    comparison: CorrelatedDensity
    sizes: tuple[int, ...]
    log_evidence: float
    error: float
    z: Array
    weight: Array
    proposal: Mixture
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
        """Whether the evidence is by importance sampling."""
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
    comparison: CorrelatedDensity,
    sizes: tuple[int, ...],
    known: Array,
    *,
    smooth: tuple[int, ...] = (),
    log2_draws: int = SEARCH.log2_draws,
    least: float = -np.inf,
) -> Marginal:
    """Marginal likelihood by Laplace's method, approximate where the data leave sizes open.

    known : (s, n) scores from which optimisations start, beside draws of the prior
    smooth : sizes that are left to Laplace's method even where they are open
    log2_draws : log2 of the number of these draws, none if 0
    least : log evidence about the optima below which nothing is refined

    The draws are those of the Laplace approximation.
    """
    even = sizes[0] if sizes else None
    optima = find_optima(comparison, known, even=even, log2_draws=log2_draws, least=least)
    open_sizes = _not_determined(optima, tuple(s for s in sizes if s not in smooth))
    if float(logsumexp(optima.log_mass)) < least:
        open_sizes = ()
    z, log_mass = optima.z, optima.log_mass
    factor = optima.factor
    if open_sizes:
        at_nodes = _over_nodes(comparison, open_sizes, open_sizes[0] == sizes[0], optima)
        if len(open_sizes) == 1:
            # the nodes are close: an optimum that leaves the size open would count their mass again
            sd = np.sqrt(np.linalg.inv(optima.curvature)[:, open_sizes[0], open_sizes[0]])
            most = logsumexp(at_nodes[2]) + np.log(_OF_OPEN_OPTIMUM)
            log_mass = np.where(sd > _DETERMINED_SD, np.minimum(log_mass, most), log_mass)
        z, factor, log_mass = (
            np.concatenate(pair) for pair in zip((z, factor, log_mass), at_nodes, strict=True)
        )
    return _marginal(comparison, sizes, z, factor, log_mass)


def _not_determined(optima: Optima, sizes: tuple[int, ...]) -> tuple[int, ...]:
    """Sizes that are too open for a Gaussian.

    If the first one is, all of them are: a small mass may be anywhere, whatever its place at the optimum.
    """
    log_mass = optima.log_mass
    carry = log_mass > log_mass.max() + np.log(_CARRIES)
    variance = np.diagonal(np.linalg.inv(optima.curvature[carry]), axis1=1, axis2=2)
    undetermined = tuple(s for s in sizes if np.sqrt(variance[:, s].max()) > _DETERMINED_SD)
    return sizes if sizes and sizes[0] in undetermined else undetermined


def _over_nodes(
    comparison: CorrelatedDensity, columns: tuple[int, ...], has_size: bool, optima: Optima
) -> tuple[Array, Array, Array]:
    """Centres, covariance square roots and log masses of components that fill the priors of open sizes.

    has_size : whether the first of the columns is the size of an effect, the others its place
    """
    d = len(columns)
    if d == 1:
        even = size_points(comparison, columns[0], _EVEN_SIZES)
        score = np.unique(np.concatenate((_GRID, even[np.abs(even) > _GRID[-1] / 3])))
        score = score[np.insert(np.diff(score) > 0.1, 0, True)][:, None]
        width = _spacing(score[:, 0])[:, None]
        log_width = np.log(width[:, 0])
    else:
        log2 = _LOG2_SCATTERED.get(d, _MOST_SCATTERED)
        score = spread_scores(d, log2, 0 if has_size else None)
        width = np.full(d, 2.0 / (1 << log2) ** (1.0 / d))
        normal = score[:, 1:] if has_size else score
        log_width = 0.5 * np.sum(normal**2, axis=1) + normal.shape[1] * _HALF_LOG_2PI - np.log(len(score))
        if has_size:
            log_width += np.log(2 * SIZE_RANGE)
            width[0] *= 1.8
        width = np.broadcast_to(width, score.shape)
    nodes = conditional_optima(comparison, columns, score, optima)
    log_mass = nodes.log_density + log_width
    kept = np.flatnonzero(log_mass > log_mass.max() + np.log(_NEGLIGIBLE_FRACTION))
    return *nodes.components(comparison, kept, width), log_mass[kept]


def _marginal(
    comparison: CorrelatedDensity, sizes: tuple[int, ...], z: Array, factor: Array, log_mass: Array
) -> Marginal:
    """Marginal from components about optima and nodes, with their log masses (k,)."""
    kept, proposal = about(z, factor, log_mass)
    gaussians = replace(proposal, factor=factor[None, kept], degrees_of_freedom=np.inf)
    draws = comparison.scores.to_x(sobol_points(gaussians, LOG2_POINTS)[0])
    return Marginal(
        comparison=comparison,
        sizes=sizes,
        log_evidence=float(logsumexp(log_mass)),
        error=np.nan,
        z=z[kept],
        weight=proposal.share[0],
        proposal=proposal,
        draws=draws,
        log_weight=np.full(len(draws), -np.log(len(draws))),
    )


def _spacing(score: Array) -> Array:
    """Half the distance between the neighbours of every node, (k,)."""
    padded = np.concatenate((score[:1] - np.diff(score[:2]), score, score[-1:] + np.diff(score[-2:])))
    return np.asarray(0.5 * (padded[2:] - padded[:-2]))


# Grid nodes of one size, sizes evenly spread over its prior that join them, and scattered nodes, log2, of
# several sizes.
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


def size_nodes(comparison: CorrelatedDensity, sizes: tuple[int, ...]) -> tuple[Array, Array]:
    """Nodes (k, d) of an effect's sizes in normal scores, and their log prior weights (k,).

    An effect without a size has one node.
    """
    if not sizes:
        return np.zeros((1, 0)), np.zeros(1)
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
    comparison: CorrelatedDensity, effect: Sequence[Parameter], sizes: tuple[int, ...], about: Marginal
) -> ShiftTable:
    """Shifts by an effect at the optimum of another hypothesis; parameters it lacks are at prior medians.

    Nodes at which the plate buckles or the constraints (9) are violated are left out, if need be all.

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
    bare = comparison if sizes else replace(comparison, model=comparison.model.without_changes())
    f, _ = bare.predict(plain[None])
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
    shift : of the log frequencies, at the constants of the plain model; ``None`` where the pairing differs
    cases : the plates with the pairing of incomplete lists; empty where all lists are complete
    as_plain : the hypothesis with the plain model's most probable pairing; ``None`` where lists are complete
    """

    hypothesis: Hypothesis
    plates: tuple[int, ...]
    marginal: Marginal
    probability: float = 0.0
    log_bayes_factor: float = 0.0
    shift: ShiftTable | None = None
    cases: tuple[PlateCase, ...] = ()
    as_plain: CorrelatedDensity | None = None

    @property
    def columns(self) -> tuple[int, ...]:
        """Columns of the effect's parameters."""
        return effect_columns(self.marginal.comparison, self.hypothesis)

    @property
    def key(self) -> tuple[str, str, tuple[int, ...]]:
        """Key that all pairings of one hypothesis have in common."""
        return (self.hypothesis.cause, self.hypothesis.variant, self.plates)

    @property
    def log_weight(self) -> float:
        """Log of prior times evidence."""
        return float(np.log(self.hypothesis.prior) + self.marginal.log_evidence)


def ranked(tested: Sequence[Tested]) -> list[Tested]:
    """Hypotheses in descending order of prior times evidence."""
    return sorted(tested, key=lambda t: t.log_weight, reverse=True)


def best_by_cause(order: Iterable[Tested]) -> dict[str, Tested]:
    """The first hypothesis of every cause, in this order."""
    best: dict[str, Tested] = {}
    for t in order:
        best.setdefault(t.hypothesis.cause, t)
    return best


def distinct_hypotheses(tested: Sequence[Tested]) -> list[Hypothesis]:
    """Every hypothesis once, whatever the number of its pairings."""
    return list({t.key: t.hypothesis for t in tested}.values())


def prior_of(tested: Sequence[Tested]) -> float:
    """Sum of the priors, every hypothesis counted once."""
    return float(sum(h.prior for h in distinct_hypotheses(tested)))


# Fraction of the log priors that is kept, so that scores which the data leave open stay in place.
_KEPT = 1e-3
# Posterior draws among which starts are chosen, number of starts, and steps of the search.
_DRAWS, _STARTS, _STEPS = 24, 2, 12


@single_blas_thread
def best_log_likelihood(marginal: Marginal) -> float:
    """Largest log likelihood within the bounds of the priors, with the priors of noise and discrepancy.

    The priors of constants and sizes are left out, so that hypotheses are compared by the data alone.
    """
    comparison = marginal.comparison
    n, n_model = comparison.parameters.size, comparison.model.parameters.size
    weight = np.where(np.arange(n) < n_model, 1.0 - _KEPT, 0.0)

    start = np.concatenate((marginal.z[:1], comparison.scores.to_z(marginal.resampled(_DRAWS))))
    start = start[np.argsort(-comparison.log_likelihood(comparison.scores.to_x(start)), kind="stable")]
    best = maximised(comparison, start[:_STARTS], _STEPS, 5e-2, weight=weight).z[0]
    log_prior = -0.5 * float(np.sum(best[n_model:] ** 2))
    return float(comparison.log_likelihood(comparison.scores.to_x(best[None]))[0]) + log_prior
