"""Marginal likelihood of a hypothesis: quadrature over one effect's size, Laplace over what is left.

Skew, taper, warp and turned plies have zero slope at zero by symmetry: the posterior of their size may
have a peak on either side, or a flat top about zero, which no Gaussian describes. Its score is therefore
gone through on a grid, refined where the mass is; the constants and the noise are integrated at each node
by Laplace's method in normal scores, where nothing is cut at a bound.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from cpam_bayes.diagnosis.evidence.comparison import Comparison
from cpam_bayes.diagnosis.evidence.proposals import about_nodes
from cpam_bayes.inference.derivatives import Expansion
from cpam_bayes.inference.importance import staged_importance
from cpam_bayes.inference.optimise import maximise
from cpam_bayes.inference.standard_normal import MAX_SCORE
from cpam_bayes.inference.student_mixture import sobol_points
from cpam_bayes.threads import single_blas_thread

Array = NDArray[Any]

# Scores of the first grid; intervals are halved where the log density changes by more than _STEEP_NATS
# within _DEPTH_NATS of the best, but never below _FINEST.
GRID = np.linspace(-3.6, 3.6, 19)
_STEEP_NATS, _DEPTH_NATS, _FINEST, _MOST_HALVINGS = 1.0, 9.0, 0.01, 6
# Optimisations end where a step promises less than this, nats, or after so many steps.
_PROMISED, _MOST_STEPS = 3e-3, 12
# Local maxima of the first grid that are optimised from.
_MOST_PEAKS = 3
# Screened nodes below this fraction of the best one are not refined.
_NEGLIGIBLE_FRACTION = 1e-5
# Neighbouring optima further apart, standard deviations, may be those of two modes.
_MAX_DISTANCE_SD = 2.0
# Points of the fine quadrature between the nodes.
_FINE = 1601
# Importance sampling: degrees of freedom and widening of the proposal, log2 of its points.
_FREEDOM, _WIDER, _LOG2_POINTS = 6.0, 1.15, 9
_HALF_LOG_2PI = 0.5 * np.log(2 * np.pi)


@dataclass(frozen=True, slots=True)
class Marginal:
    """What one hypothesis says of the data, and what the data say of its parameters.

    log_evidence : log marginal likelihood.
    error, effective_size, k_hat : of importance sampling, as in ``Weighted``; ``nan`` for Laplace's.
    z : (k, n) optima at the nodes.
    curvature : (k, n - 1, n - 1), or (1, n, n) without quadrature.
    weight : (k,) fractions of the evidence.
    draws, log_weight : (d, n) parameters and (d,) their normalised log weights.
    is_refined : whether the optima are, or only screened.
    """

    comparison: Comparison
    quadrature: int | None
    log_evidence: float
    error: float
    z: Array
    curvature: Array
    weight: Array
    draws: Array
    log_weight: Array

    is_refined: bool = True
    effective_size: float = np.nan
    k_hat: float = np.nan

    @property
    def best(self) -> Array:
        """Most probable parameters of the node with most mass, (n,)."""
        return np.asarray(self.comparison.scores.to_x(self.z[int(np.argmax(self.weight))]))

    def moments(self) -> tuple[Array, Array]:
        """Posterior mean and standard deviation of the parameters, (n,) each."""
        w = np.exp(self.log_weight)
        mean = w @ self.draws
        return mean, np.sqrt(np.maximum(w @ (self.draws - mean) ** 2, 0.0))

    def resampled(self, size: int) -> Array:
        """Equally probable draws (size, n), by systematic resampling."""
        share = np.cumsum(np.exp(self.log_weight))
        at = np.searchsorted(share / share[-1], (np.arange(size) + 0.5) / size)
        return np.asarray(self.draws[np.minimum(at, len(self.draws) - 1)])


@single_blas_thread
def laplace_marginal(
    comparison: Comparison,
    quadrature: int | None,
    starts: Array,
    *,
    floor: float = -np.inf,
    screened: Marginal | None = None,
) -> Marginal:
    """The marginal likelihood by quadrature over the score of one parameter, or without.

    starts : (s, n) scores that optimisations begin from.
    floor : a log evidence below which the grid is not refined, as the hypothesis carries nothing.
    screened : the same over nodes of its own, which are optimised from where it stands, instead of the whole
    grid from the starts. The draws are those of the Laplace approximation.
    """
    if quadrature is None:
        return _at_one_node(comparison, starts if screened is None else screened.z[:1])
    if screened is None:
        rest = np.delete(starts, quadrature, axis=1)
        nodes = _optimised(comparison, quadrature, GRID, np.tile(rest, (len(GRID), 1, 1)))
    else:
        score, begin = _promising(screened, quadrature)
        nodes = _optimised(comparison, quadrature, score, begin)
    nodes = _from_neighbours(comparison, quadrature, nodes)
    nodes = _with_peaks(comparison, quadrature, nodes)
    if nodes.log_density.max() > floor:
        for _ in range(_MOST_HALVINGS):
            new, begin = _halved(nodes)
            if not len(new):
                break
            nodes = _merged(nodes, _optimised(comparison, quadrature, new, begin))
    log_z, weight = _integrated(nodes)
    z = np.insert(nodes.rest, quadrature, nodes.score, axis=1)
    return _with_draws(comparison, quadrature, log_z, z, nodes.curvature, weight)


def _with_draws(
    comparison: Comparison, quadrature: int | None, log_z: float, z: Array, curvature: Array, weight: Array
) -> Marginal:
    nothing = np.empty(0)
    marginal = Marginal(comparison, quadrature, log_z, np.nan, z, curvature, weight, nothing, nothing)
    approximation = about_nodes(z, curvature, weight, quadrature, 1.0, np.inf)
    draws = comparison.scores.to_x(sobol_points(approximation, _LOG2_POINTS)[0])
    return replace(marginal, draws=draws, log_weight=np.full(len(draws), -np.log(len(draws))))


def _at_one_node(comparison: Comparison, starts: Array) -> Marginal:
    maxima = maximise(
        lambda z, rows: comparison.expand(z),
        starts,
        *(np.full(starts.shape[1], v) for v in (-MAX_SCORE, MAX_SCORE)),
        most_steps=2 * _MOST_STEPS,
        promised=_PROMISED,
    )
    best = int(np.argmax(np.where(np.isfinite(maxima.expansion.value), maxima.expansion.value, -np.inf)))
    n = starts.shape[1]
    curvature = maxima.expansion.curvature[best]
    log_z = float(maxima.expansion.value[best] + n * _HALF_LOG_2PI - 0.5 * np.linalg.slogdet(curvature)[1])
    return _with_draws(comparison, None, log_z, maxima.u[best][None], curvature[None], np.ones(1))


@single_blas_thread
def sampled_marginal(marginal: Marginal) -> Marginal:
    """A marginal likelihood by importance sampling about its Laplace approximation."""
    proposal = about_nodes(
        marginal.z, marginal.curvature, marginal.weight, marginal.quadrature, _WIDER, _FREEDOM
    )
    comparison = marginal.comparison
    sample = staged_importance(lambda z: comparison.log_density(z[0])[None], proposal, _LOG2_POINTS)
    if not np.isfinite(sample.log_evidence[0]):
        return marginal
    with np.errstate(divide="ignore"):
        log_weight = np.log(sample.weight[0])
    return replace(
        marginal,
        log_evidence=float(sample.log_evidence[0]),
        error=float(sample.standard_error[0]),
        effective_size=float(sample.effective_size[0]),
        k_hat=float(sample.k_hat[0]),
        draws=comparison.scores.to_x(sample.points[0]),
        log_weight=log_weight,
    )


@dataclass(frozen=True, slots=True)
class _Nodes:
    """Conditional optima at scores (k,): value (k,), rest (k, n - 1), curvature (k, n - 1, n - 1)."""

    score: Array
    value: Array
    rest: Array
    curvature: Array

    @property
    def log_density(self) -> Array:
        """Log density of the score and the data, the rest integrated, (k,)."""
        n = self.rest.shape[1]
        return np.asarray(self.value + n * _HALF_LOG_2PI - 0.5 * np.linalg.slogdet(self.curvature)[1])


def _promising(screened: Marginal, quadrature: int) -> tuple[Array, Array]:
    """Scores (k,) of nodes that may carry mass, without gaps, and a start (k, 1, n - 1) at each."""
    order = np.argsort(screened.z[:, quadrature])
    z, weight = screened.z[order], screened.weight[order]
    kept = np.flatnonzero(weight > _NEGLIGIBLE_FRACTION * weight.max())
    z = z[max(kept[0] - 1, 0) : kept[-1] + 2]
    return z[:, quadrature], np.delete(z, quadrature, axis=1)[:, None]


def _optimised(comparison: Comparison, quadrature: int, score: Array, starts: Array) -> _Nodes:
    """The best optimum at every score (k,) from starts (k, s, n - 1)."""
    k, s, n = starts.shape
    of_node = np.repeat(score, s)
    rest_columns = np.delete(np.arange(n + 1), quadrature)

    def target(u: Array, rows: Array) -> Expansion:
        e = comparison.expand(np.insert(u, quadrature, of_node[rows], axis=1))
        block = np.ix_(np.arange(len(u)), rest_columns, rest_columns)
        return Expansion(e.value, e.gradient[:, rest_columns], e.curvature[block])

    bound = np.full(n, MAX_SCORE)
    maxima = maximise(
        target, starts.reshape(k * s, n), -bound, bound, most_steps=_MOST_STEPS, promised=_PROMISED
    )
    value = np.where(np.isfinite(maxima.expansion.value), maxima.expansion.value, -1e300).reshape(k, s)
    best = np.arange(k) * s + value.argmax(axis=1)
    return _Nodes(score, value.max(axis=1), maxima.u[best], maxima.expansion.curvature[best])


def _from_neighbours(comparison: Comparison, quadrature: int, nodes: _Nodes) -> _Nodes:
    """The nodes optimised again from the better of their neighbours' optima: crossing modes part them."""
    k = len(nodes.score)
    height = np.concatenate(([-np.inf], nodes.value, [-np.inf]))
    better_side = np.where(height[:-2] > height[2:], -1, 1)
    start = nodes.rest[np.clip(np.arange(k) + better_side, 0, k - 1)]
    away = start - nodes.rest
    far = np.einsum("ki,kij,kj->k", away, nodes.curvature, away) > _MAX_DISTANCE_SD**2
    rows = np.flatnonzero(far & (nodes.value > nodes.value.max() - 2 * _DEPTH_NATS))
    if not len(rows):
        return nodes
    again = _optimised(comparison, quadrature, nodes.score[rows], start[rows, None])
    better = again.value > nodes.value[rows] + 1e-3
    rows = rows[better]
    value, rest, curvature = nodes.value.copy(), nodes.rest.copy(), nodes.curvature.copy()
    value[rows], rest[rows], curvature[rows] = (
        again.value[better],
        again.rest[better],
        again.curvature[better],
    )
    return _Nodes(nodes.score, value, rest, curvature)


def _with_peaks(comparison: Comparison, quadrature: int, nodes: _Nodes) -> _Nodes:
    """The nodes, and where optimisations over all scores end that begin at their local maxima."""
    padded = np.concatenate(([-np.inf], nodes.value, [-np.inf]))
    peaks = np.flatnonzero((padded[1:-1] >= padded[:-2]) & (padded[1:-1] >= padded[2:]))
    peaks = peaks[np.argsort(-nodes.value[peaks], kind="stable")][:_MOST_PEAKS]
    start = np.insert(nodes.rest[peaks], quadrature, nodes.score[peaks], axis=1)
    bound = np.full(start.shape[1], MAX_SCORE)
    maxima = maximise(
        lambda z, rows: comparison.expand(z),
        start,
        -bound,
        bound,
        most_steps=2 * _MOST_STEPS,
        promised=_PROMISED,
    )
    score = maxima.u[:, quadrature]
    new = (np.abs(score[:, None] - nodes.score).min(axis=1) > _FINEST) & np.isfinite(maxima.expansion.value)
    new &= np.abs(score) < -GRID[0]
    if not new.any():
        return nodes
    score, first = np.unique(np.round(score[new], 6), return_index=True)
    begin = np.delete(maxima.u[new][first], quadrature, axis=1)
    return _merged(nodes, _optimised(comparison, quadrature, score, begin[:, None]))


def _halved(nodes: _Nodes) -> tuple[Array, Array]:
    """Midpoints of intervals that are too coarse, and starts for them from both ends."""
    g = nodes.log_density
    height = np.maximum(g[1:], g[:-1])
    steep = np.abs(np.diff(g)) > _STEEP_NATS
    which = np.flatnonzero(steep & (height > g.max() - _DEPTH_NATS) & (np.diff(nodes.score) > _FINEST))
    middle = 0.5 * (nodes.score[which] + nodes.score[which + 1])
    return middle, np.stack((nodes.rest[which], nodes.rest[which + 1]), axis=1)


def _merged(a: _Nodes, b: _Nodes) -> _Nodes:
    score = np.concatenate((a.score, b.score))
    order = np.argsort(score)
    return _Nodes(
        score[order],
        *(
            np.concatenate((getattr(a, name), getattr(b, name)))[order]
            for name in ("value", "rest", "curvature")
        ),
    )


def _integrated(nodes: _Nodes) -> tuple[float, Array]:
    """Log of the integral over the score, and the share of each node's surroundings, (k,)."""
    g = nodes.log_density
    top = float(g.max())
    fine = np.unique(np.concatenate((np.linspace(nodes.score[0], nodes.score[-1], _FINE), nodes.score)))
    density = np.exp(np.maximum(PchipInterpolator(nodes.score, g)(fine) - top, -700.0))
    panel = 0.5 * (density[1:] + density[:-1]) * np.diff(fine)
    # beyond the whole grid the prior is left, and the likelihood of its ends; a shorter one lost nothing
    end = np.abs(nodes.score[[0, -1]])
    tail = np.where(end >= GRID[-1] - _FINEST, np.exp(g[[0, -1]] - top) / np.maximum(end, 1.0), 0.0)
    owner = np.abs(0.5 * (fine[1:] + fine[:-1])[:, None] - nodes.score).argmin(axis=1)
    share = np.asarray(np.bincount(owner, panel, minlength=len(g)), dtype=float)
    share[0] += tail[0]
    share[-1] += tail[1]
    total = share.sum()
    return top + float(np.log(total)), share / total
