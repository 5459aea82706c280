"""Conditional optima of constants and noise at fixed sizes: nodes that fill the prior of an open size."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from cpam_bayes.inference.laplace import Optima
from cpam_bayes.inference.log_density import CorrelatedDensity
from cpam_bayes.inference.optimise import maximise
from cpam_bayes.inference.scores import Expansion
from cpam_bayes.mechanics.problem import Array


@dataclass(frozen=True, slots=True)
class NodeSettings:
    """Settings of the conditional optima, which are centres of a proposal.

    promised, steps : optimisations end where a step promises less, nats, or after so many steps
    steepest : largest slope of a node's optimum over the size, scores per score
    """

    promised: float = 3e-2
    steps: int = 5
    steepest: float = 3.0


_NODE: Final = NodeSettings()


def size_points(comparison: CorrelatedDensity, column: int, n: int) -> Array:
    """Scores (n,) of sizes that are evenly spread between the bounds of their prior."""
    lower, upper = comparison.parameters.lower[column], comparison.parameters.upper[column]
    prior = comparison.parameters.parameters[column].prior
    x = lower + (upper - lower) * (np.arange(n) + 0.5) / n
    return np.clip(np.asarray(prior.to_normal(x)), -prior.reach, prior.reach)


@dataclass(frozen=True, slots=True)
class Nodes:
    """Conditional optima at fixed sizes.

    columns : of the fixed sizes
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
        """Log density (k,) of the sizes and the data, the rest integrated out by Laplace's method."""
        n = self.rest.shape[1]
        return np.asarray(
            self.value + 0.5 * n * np.log(2 * np.pi) - 0.5 * np.linalg.slogdet(self.curvature)[1]
        )

    def components(self, comparison: CorrelatedDensity, kept: Array, width: Array) -> tuple[Array, Array]:
        """Centres (p, n) and covariance square roots (p, n, n) of a mixture about some nodes.

        Along the sizes a component is as wide as the spacing of its node; the optimum of the rest
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
    """Scores (..., n) assembled from fixed sizes (..., d) and the rest (..., n - d)."""
    n = len(columns) + rest.shape[-1]
    z = np.empty((*rest.shape[:-1], n))
    z[..., list(columns)] = scores
    z[..., np.delete(np.arange(n), columns)] = rest
    return z


def conditional_optima(
    comparison: CorrelatedDensity, columns: tuple[int, ...], scores: Array, optima: Optima
) -> Nodes:
    """Conditional optima at sizes (k, d), started from the joint optimum nearest in size."""
    rest = np.delete(np.arange(comparison.parameters.size), columns)

    def target(r: Array, rows: Array) -> Expansion:
        e = comparison.expand(inserted(columns, scores[rows], r))
        return Expansion(e.value, e.gradient[:, rest], e.curvature[:, rest][:, :, rest])

    bound = comparison.scores.upper[rest]
    start = _along_tangents(columns, rest, scores, optima)
    maxima = maximise(target, start, -bound, bound, most_steps=_NODE.steps, promised=_NODE.promised)
    e = maxima.expansion
    value = np.where(np.isfinite(e.value), e.value, -1e300)
    return Nodes(columns, scores, value, maxima.u, e.curvature)


def _along_tangents(columns: tuple[int, ...], rest: Array, scores: Array, optima: Optima) -> Array:
    """Starts (k, n - d) for the rest, extrapolated from the joint optimum nearest in size."""
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
