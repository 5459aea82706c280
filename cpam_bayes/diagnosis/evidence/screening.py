"""Screening of a hypothesis: its marginal likelihood with the model linear in all but the effect.

About a point near the optimum of the plain model the log frequencies are linear in the scores of the
constants, so that at every node of the effect's grid the constants are integrated in closed form. Between
nodes the effect is linear too. What has no model of its own is free, the plain model's tangent answers; an
effect of the plate costs one stack of solves, and another where it is promising.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from cpam_bayes.diagnosis.evidence.comparison import Comparison
from cpam_bayes.diagnosis.evidence.marginal import GRID, Marginal
from cpam_bayes.inference.noise import NOISE_PRIOR
from cpam_bayes.inference.posterior import ForwardModel

Array = NDArray[Any]

# Amplitudes of the noise, where it is inferred, and their prior weights.
AMPLITUDES = np.geomspace(5e-4, 0.15, 12)
_AMPLITUDE_WEIGHTS = np.exp(NOISE_PRIOR.log_density(AMPLITUDES)) * np.gradient(AMPLITUDES)
# Nodes within so many nats of the best are corrected by a second stack.
_DEPTH_NATS = 10.0
# Constants answer a shift by scores up to this.
_FARTHEST = 4.0


@dataclass(frozen=True, slots=True)
class Anchor:
    """A place from which hypotheses are screened.

    scores : of the plain model's parameters, by name.
    tangents : models of the plates about it.
    """

    scores: Mapping[str, float]
    tangents: Mapping[int, ForwardModel]

    def start(self, comparison: Comparison) -> Array:
        """Scores of a hypothesis there, zero for what the plain model lacks, (n,)."""
        return np.array([self.scores.get(name, 0.0) for name in comparison.parameters.names])

    def cheapened(self, comparison: Comparison) -> Comparison:
        """The comparison with tangents of all plates that need no model of their own."""
        parts = tuple(
            replace(part, bare=self.tangents[i]) if all(c.model is None for c in part.changes) else part
            for i, part in enumerate(comparison.model.parts)
        )
        return replace(comparison, model=replace(comparison.model, parts=parts))

    def plain(self, comparison: Comparison) -> Comparison:
        """The same lists, paired alike, with tangents of the bare plates."""
        parts = tuple(
            replace(part, bare=self.tangents[i], changes=(), misread=None)
            for i, part in enumerate(comparison.model.parts)
        )
        return replace(comparison, model=replace(comparison.model, parts=parts))


@dataclass(frozen=True, slots=True)
class Linear:
    """Lists against a model that is linear in the scores of the constants.

    residual : (n_f,) or (k, n_f) ln measured - ln predicted with the constants at score zero.
    slope : (n_f, n) d ln f / d z.
    sigmas : (s, n_f) noise of the log frequencies.
    log_weight : (s,) of each.
    """

    residual: Array
    slope: Array
    sigmas: Array
    log_weight: Array

    def answer(self, residual: Array, sigma: Array) -> Array:
        """Most probable scores of the constants for residuals (..., n_f)."""
        a = self.slope / sigma[:, None]
        inverse = np.linalg.solve(a.T @ a + np.eye(a.shape[1]), a.T)
        return np.clip((residual / sigma) @ inverse.T, -_FARTHEST, _FARTHEST)


def linear(comparison: Comparison, plain: Comparison, z: Array, free: Array, residual: Array) -> Linear:
    """The lists about scores z (n,) with free constants, whose slope is that of the plain model.

    residual : (..., n_f) ln measured - ln predicted at z.
    """
    slope = _slope(plain, z, free)
    weight = 1.0 / comparison.listed.frequencies
    if comparison.noise is None:
        sigmas = np.sqrt(comparison.variance(comparison.scores.to_x(z)[None])) * weight
        log_weight = np.zeros(1)
    else:
        base, scale = comparison.listed.variance * weight**2, comparison.listed.scale * weight
        sigmas = np.sqrt(base + (AMPLITUDES[:, None] * scale) ** 2)
        log_weight = np.log(_AMPLITUDE_WEIGHTS)
    return Linear(residual + z[free] @ slope.T, slope, sigmas, log_weight)


def free_of(comparison: Comparison, effect: tuple[int, ...]) -> Array:
    """Columns of the constants: neither the effect's nor the noise's."""
    held = [c for c in (*effect, comparison.noise, comparison.discrepancy) if c is not None]
    return np.delete(np.arange(comparison.parameters.size), held)


def screened_marginal(
    comparison: Comparison, quadrature: int | None, anchor: Anchor, *, corrected: bool = False
) -> tuple[Marginal, Array]:
    """Approximate marginal likelihood from an anchor, and the shifts (k, n_f) at the nodes there.

    Nothing is refined. The constants answer the effect's shift in a linear step; with ``corrected`` the model
    is solved again where that leads, which what has no model of its own always is. The draws are the
    nodes of the effect's grid, each with its most probable constants.
    """
    z = anchor.start(comparison)
    grid = np.zeros(1) if quadrature is None else GRID
    free = free_of(comparison, () if quadrature is None else (quadrature,))
    at = np.tile(z, (len(grid), 1))
    if quadrature is not None:
        at[:, quadrature] = grid
    cheap, plain = anchor.cheapened(comparison), anchor.plain(comparison)
    listed = np.log(comparison.listed.frequencies)
    predicted = log_f(cheap, at)
    shift = predicted - log_f(plain, z[None])
    lists = linear(comparison, plain, z, free, listed - predicted)
    nodes, of_noise = _nodes(lists, grid, quadrature)
    _answered(comparison, lists, at, free, of_noise)
    has_model = any(c.model is not None for part in comparison.model.parts for c in part.changes)
    if corrected or not has_model:
        near = np.flatnonzero(nodes > nodes.max() - _DEPTH_NATS)
        residual = lists.residual.copy()
        residual[near] = listed - log_f(cheap, at[near]) + at[np.ix_(near, free)] @ lists.slope.T
        lists = replace(lists, residual=residual)
        nodes, of_noise = _nodes(lists, grid, quadrature)
        _answered(comparison, lists, at, free, of_noise)
    total = float(logsumexp(nodes))
    n_rest = len(z) - (quadrature is not None)
    marginal = Marginal(
        comparison=comparison,
        quadrature=quadrature,
        log_evidence=total + log_of_frequencies(comparison),
        error=np.nan,
        z=at,
        curvature=np.broadcast_to(np.eye(n_rest), (len(at), n_rest, n_rest)),
        weight=np.exp(nodes - total),
        draws=comparison.scores.to_x(at),
        log_weight=nodes - total,
        is_refined=False,
    )
    return marginal, shift


def log_of_frequencies(comparison: Comparison) -> float:
    """What carries a density over log frequencies to one over the lists."""
    return comparison.listed.log_constant - float(np.log(comparison.listed.frequencies).sum())


def _answered(comparison: Comparison, lists: Linear, at: Array, free: Array, of_noise: Array) -> None:
    """Put the most probable constants and noise of every node into scores ``at`` (k, n)."""
    for s in np.unique(of_noise):
        rows = np.flatnonzero(of_noise == s)
        at[np.ix_(rows, free)] = lists.answer(lists.residual[rows], lists.sigmas[s])
    set_noise(comparison, at, of_noise)


def set_noise(comparison: Comparison, at: Array, of_noise: Array) -> None:
    """Put amplitudes of the noise, by their numbers (k,), into scores ``at`` (k, n), if it is inferred."""
    if comparison.noise is not None:
        x = comparison.scores.to_x(at)
        x[:, comparison.noise] = AMPLITUDES[of_noise]
        at[:, comparison.noise] = comparison.scores.to_z(x)[:, comparison.noise]


def _nodes(lists: Linear, grid: Array, quadrature: int | None) -> tuple[Array, Array]:
    """Log of each node's share of the integral, (k,), and the number of the most probable noise there."""
    columns = np.broadcast_to(lists.slope, (len(grid), *lists.slope.shape))
    log_width = np.zeros(len(grid))
    if quadrature is not None:
        step = np.gradient(grid)
        # within a cell the effect is linear, its score spread by half the step
        along = -np.gradient(lists.residual, grid, axis=0) * (0.5 * step)[:, None]
        columns = np.concatenate((columns, along[..., None]), axis=2)
        log_width = np.log(step) - 0.5 * grid**2 - 0.5 * np.log(2 * np.pi)
    each = np.stack(
        [
            _log_density(lists.residual, columns, sigma) + log_width + weight
            for sigma, weight in zip(lists.sigmas, lists.log_weight, strict=True)
        ]
    )
    return np.asarray(logsumexp(each, axis=0)), each.argmax(axis=0)


def _log_density(r: Array, columns: Array, sigma: Array) -> Array:
    """Log density of residuals (k, n) under N(0, diag sigma^2 + C C^T), C (k, n, p), (k,)."""
    n = r.shape[1]
    c = columns / sigma[:, None]
    precision = np.eye(n) + c @ np.swapaxes(c, 1, 2)
    scaled = r / sigma
    solved = np.linalg.solve(precision, scaled[..., None])[..., 0]
    _, log_det = np.linalg.slogdet(precision)
    return np.asarray(
        -0.5 * np.sum(scaled * solved, axis=1)
        - 0.5 * log_det
        - np.log(sigma).sum()
        - 0.5 * n * np.log(2 * np.pi)
    )


def log_f(comparison: Comparison, z: Array) -> Array:
    """Log frequencies of the lists at scores (m, n), (m, n_f)."""
    f, _ = comparison.predict(comparison.scores.to_x(z))
    return np.log(f)


def _slope(comparison: Comparison, z: Array, free: Array) -> Array:
    """d ln f / d z of the constants, (n_f, n_free)."""
    x = comparison.scores.to_x(z)[None]
    f, slope = comparison.predict(x, jacobian=True)
    assert slope is not None
    by_score = slope[0] * comparison.scores.slope(x, z[None])[0] / f[0][:, None]
    return np.asarray(by_score[:, free])
