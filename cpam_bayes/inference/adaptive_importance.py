"""Importance sampling of a density whose mass lies along a curve or beside its known optima.

Laplace's approximation about an optimum, and nodes scattered over a prior, may miss where most of a density
is: the place of a mass and its size go together along a narrow bent ridge. After each round the proposal gets
Gaussians at the heaviest points so far, from the density's own gradient and curvature there.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.inference.derivatives import Expansion
from cpam_bayes.inference.importance import Weighted, weighted
from cpam_bayes.inference.student_mixture import Mixture, log_blend, sobol_points

Array = NDArray[Any]

# Gaussians that join after a round, chosen from so many times as many points; they are so far apart at least,
# and away from their points at most, in their own standard deviations.
_JOIN, _CANDIDATES, _APART, _FURTHEST = 8, 4, 1.0, 2.0
# Their share of the proposal, the power of the weights by which they divide it, and their factor on standard
# deviations.
_SHARE, _FLAT, _WIDER = 0.5, 0.5, 1.15


class Rounds(NamedTuple):
    """How long to go on.

    log2_points, most : of each round, and how many rounds at most
    least : rounds before which it does not end
    enough : effective size that is enough
    steady : change of the log evidence by the last round that is small enough
    """

    log2_points: int = 8
    most: int = 16
    least: int = 4
    enough: float = 400.0
    steady: float = 0.05


def adaptive_importance(
    log_density: Callable[[Array], Array],
    expand: Callable[[Array], Expansion],
    mixture: Mixture,
    refit: Callable[[Mixture, Array, Array], Mixture],
    rounds: Rounds = Rounds(),  # noqa: B008 an immutable default
) -> Weighted:
    """The integral of one density by importance sampling from a growing Student-t mixture.

    All points are weighed against the blend of the mixtures of all rounds (Cornuet et al., 2012).

    log_density : (1, p, n) -> (1, p)
    expand : (m, n) -> values, gradients and curvatures, positive definite where the value is finite
    mixture : a stack of one, the proposal of the first round
    refit : mixture, points and their log weights -> the mixture that the Gaussians join
    """
    size, n = 1 << rounds.log2_points, mixture.centre.shape[2]
    log2_all = rounds.log2_points + (rounds.most - 1).bit_length()
    mixtures: list[Mixture] = []
    points, target, before = np.empty((1, 0, n)), np.empty((1, 0)), np.inf
    for i in range(rounds.most):
        mixtures.append(mixture)
        more = sobol_points(mixture, log2_all, slice(i * size, (i + 1) * size))
        points = np.concatenate((points, more), axis=1)
        target = np.concatenate((target, log_density(more)), axis=1)
        log_weight = target - log_blend(mixtures, [size] * (i + 1), points)
        found = weighted(points, log_weight)
        log_evidence = float(found.log_evidence[0])
        if not np.isfinite(log_evidence):
            break
        is_steady = abs(log_evidence - before) < rounds.steady and found.effective_size[0] >= rounds.enough
        if i + 1 >= rounds.least and is_steady:
            break
        before = log_evidence
        mixture = _joined(refit(mixture, points, log_weight), expand, points[0], log_weight[0])
    return found


def _joined(
    mixture: Mixture, expand: Callable[[Array], Expansion], points: Array, log_weight: Array
) -> Mixture:
    """The mixture (a stack of one) with Gaussians at the heaviest of points (p, n)."""
    order = np.argsort(-log_weight, kind="stable")[: _CANDIDATES * _JOIN]
    order = order[np.isfinite(log_weight[order])]
    z = points[order]
    e = expand(z)
    step = np.linalg.solve(e.curvature, e.gradient[:, :, None])[:, :, 0]
    length = np.sqrt(np.einsum("ki,kij,kj->k", step, e.curvature, step))
    centre = z + step * np.minimum(1.0, _FURTHEST / np.maximum(length, 1e-300))[:, None]
    factor = np.linalg.cholesky(np.linalg.inv(e.curvature))
    kept = _apart(z, e.curvature)
    share = np.exp(_FLAT * (log_weight[order][kept] - log_weight[order[0]]))
    return Mixture(
        np.concatenate(((1.0 - _SHARE) * mixture.share[0], _SHARE * share / share.sum()))[None],
        np.concatenate((mixture.centre[0], centre[kept]))[None],
        np.concatenate((mixture.factor[0], _WIDER * factor[kept]))[None],
        mixture.degrees_of_freedom,
    )


def _apart(z: Array, curvature: Array) -> list[int]:
    """The first of points (k, n) that lie apart from those before them."""
    kept: list[int] = []
    for i in range(len(z)):
        away = z[i] - z[kept]
        distance = np.einsum("ki,kij,kj->k", away, curvature[kept], away)
        if np.all(distance > _APART**2):
            kept.append(i)
        if len(kept) == _JOIN:
            break
    return kept
