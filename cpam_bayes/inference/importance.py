"""Importance sampling: evidences of stacks of densities with standard error, effective size and k-hat."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.inference.student_mixture import Mixture, log_blend, sobol_points

Array = NDArray[Any]

# Importance weights with a heavier tail than this have no useful error (Vehtari et al., 2024).
RELIABLE_K = 0.7
# Fewest weights in the tail that a Pareto density is fitted to.
_FEWEST_IN_TAIL = 5


@dataclass(frozen=True, slots=True)
class Weighted:
    """Weighted points of m densities and the integrals of these.

    points : (m, p, n).
    weight : (m, p), each row adds up to one.
    log_evidence : (m,) log of the mean weight.
    standard_error : (m,) of it, that of independent points, an upper bound for a Sobol sequence.
    effective_size : (m,) (sum w)^2 / sum w^2.
    k_hat : (m,) Pareto shape of the largest weights.
    """

    points: Array
    weight: Array
    log_evidence: Array
    standard_error: Array
    effective_size: Array
    k_hat: Array


def weighted(points: Array, log_ratio: Array) -> Weighted:
    """Points (m, p, n) with the logs (m, p) of target density over the density they were drawn from.

    Where all of a row are -inf its log evidence is too, and the rest of it is not a number.
    """
    top = log_ratio.max(axis=1)
    top = np.where(np.isfinite(top), top, 0.0)
    ratio = np.exp(log_ratio - top[:, None])
    mean = ratio.mean(axis=1)
    p = log_ratio.shape[1]
    with np.errstate(divide="ignore", invalid="ignore"):
        return Weighted(
            points=points,
            weight=ratio / ratio.sum(axis=1, keepdims=True),
            log_evidence=top + np.log(mean),
            standard_error=ratio.std(axis=1) / mean / np.sqrt(p),
            effective_size=ratio.sum(axis=1) ** 2 / np.sum(ratio**2, axis=1),
            k_hat=np.array([pareto_shape(row) for row in log_ratio]),
        )


def staged_importance(
    log_density: Callable[[Array], Array],
    mixture: Mixture,
    log2_points: int,
    stages: tuple[float, ...] = (1.0,),
    refit: Callable[[Mixture, Array, Array], Mixture] | None = None,
) -> Weighted:
    """Integrals of m densities by importance sampling from a stack of Student-t mixtures.

    The points are those of one scrambled Sobol sequence for all densities, so that differences between
    these are known better than each alone. After each stage the mixtures are refitted to all points before;
    all of them are weighed against the blend of the mixtures (Cornuet et al., 2012).

    log_density : (m, p, n) -> (m, p).
    stages : fractions of the points.
    refit : mixture, points and their log weights -> the mixture of the next stage.
    """
    m, n = mixture.centre.shape[0], mixture.centre.shape[2]
    stops = np.cumsum([0, *(round(stage * (1 << log2_points)) for stage in stages)])
    mixtures, sizes = [mixture], [int(size) for size in np.diff(stops)]
    points, target = np.empty((m, 0, n)), np.empty((m, 0))
    for i in range(len(stages)):
        if i and refit is not None:
            log_weight = target - log_blend(mixtures, sizes[:i], points)
            mixtures.append(refit(mixtures[-1], points, log_weight))
        more = sobol_points(mixtures[i], log2_points, slice(stops[i], stops[i + 1]))
        points = np.concatenate((points, more), axis=1)
        target = np.concatenate((target, log_density(more)), axis=1)
    return weighted(points, target - log_blend(mixtures, sizes, points))


def effective_size(log_weight: Array) -> float:
    """(sum w)^2 / sum w^2 of weights (p,) that are given by their logarithms."""
    top = float(log_weight.max())
    if not np.isfinite(top):
        return 0.0
    w = np.exp(log_weight - top)
    return float(w.sum() ** 2 / np.sum(w**2))


def pareto_shape(log_weight: Array) -> float:
    """Shape k-hat of a generalised Pareto density fitted to the largest of weights (p,).

    The fifth or 3 sqrt(p) largest, whichever are fewer, by the posterior mean of Zhang and Stephens (2009)
    with the prior of Vehtari et al. (2024, Pareto smoothed importance sampling, eq. 10): 10 weights of
    shape 0.5. Infinite where fewer than five stand out.
    """
    finite = log_weight[np.isfinite(log_weight)]
    n = len(finite)
    n_tail = int(np.ceil(min(n / 5.0, 3.0 * np.sqrt(n))))
    if n_tail < _FEWEST_IN_TAIL:
        return np.inf
    ordered = np.sort(finite) - finite.max()
    cut = max(float(ordered[-n_tail - 1]), float(np.log(np.finfo(float).tiny)))
    tail = np.exp(ordered[ordered > cut]) - np.exp(cut)
    return _generalised_pareto_shape(tail) if len(tail) >= _FEWEST_IN_TAIL else np.inf


def _generalised_pareto_shape(tail: Array) -> float:
    """Of exceedances (m,) in ascending order."""
    m = len(tail)
    n_grid = 30 + int(np.sqrt(m))
    b = 1.0 - np.sqrt(n_grid / (np.arange(1, n_grid + 1) - 0.5))
    b = b / (3.0 * tail[int(m / 4 + 0.5) - 1]) + 1.0 / tail[-1]
    k = np.log1p(-b[:, None] * tail).mean(axis=1)
    log_likelihood = m * (np.log(-b / k) - k - 1.0)
    with np.errstate(over="ignore"):
        weight = 1.0 / np.exp(log_likelihood - log_likelihood[:, None]).sum(axis=1)
    kept = weight >= 10.0 * np.finfo(float).eps
    mean = np.sum(b[kept] * weight[kept]) / weight[kept].sum()
    shape = float(np.log1p(-mean * tail).mean())
    return (m * shape + 10.0 * 0.5) / (m + 10.0)
