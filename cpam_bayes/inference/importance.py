"""Importance sampling from Student-t mixtures about the optima, refined where most of the mass lies.

The mixture is over normal scores, so that nothing is truncated: a posterior that piles up on a bound becomes
a peak with a light tail. Approximations about optima and nodes may miss a narrow curved ridge: after each
round Gaussians are added at the heaviest points so far, by the density's own gradient and curvature there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp

from cpam_bayes.inference.laplace import Optima
from cpam_bayes.inference.scores import Expansion, NormalScores, best_of_distinct
from cpam_bayes.inference.student_mixture import (
    Mixture,
    Weighted,
    draw,
    log_mixture,
    log_sum_exp,
    shrunk_moments,
    sobol_points,
    weighted,
)
from cpam_bayes.mechanics.problem import Array

# Least mass of a component that proposes points; degrees of freedom and widening of the components.
_NEGLIGIBLE, _FREEDOM, _WIDER_ABOUT = 1e-4, 6.0, 1.15


def about(z: Array, factor: Array, log_mass: Array) -> tuple[Array, Mixture]:
    """Indices of the components that carry mass, the largest first, and the proposal about them.

    z : (k, n) centres of Gaussians
    factor : (k, n, n) square roots of their covariances
    log_mass : (k,)
    """
    kept = np.flatnonzero(log_mass > log_mass.max() + np.log(_NEGLIGIBLE))
    kept = kept[np.argsort(-log_mass[kept], kind="stable")]
    share = np.exp(log_mass[kept] - logsumexp(log_mass[kept]))
    return kept, Mixture(share[None], z[None, kept], _WIDER_ABOUT * factor[None, kept], _FREEDOM)


def about_optima(optima: Optima) -> Mixture:
    """Proposal about optima, a stack of one."""
    return about(optima.z, optima.factor, optima.log_mass)[1]


# Gaussians added after a round, chosen from so many times as many points; least distance between them, and
# largest distance of one from its point, in their own standard deviations.
_JOIN, _CANDIDATES, _APART, _FURTHEST = 8, 4, 1.0, 2.0
# Their share of the proposal, the power of the weights by which it is divided, and the factor on their
# standard deviations.
_SHARE, _FLAT, _WIDER = 0.5, 0.5, 1.15


class Rounds(NamedTuple):
    """Stopping rules, and settings of the refits of components between rounds, see ``shrunk_moments``.

    log2_points, most : log2 of the points of a round, and most rounds
    least : fewest rounds
    enough : least effective size
    steady : largest change of the log evidence in the last round
    good : effective fraction of the points of the first round above which the proposal is kept as it is, and
        a second round suffices
    """

    log2_points: int = 8
    most: int = 16
    least: int = 4
    enough: float = 400.0
    steady: float = 0.05
    good: float = 1.0
    least_share: float = 1e-3
    wider: float = 1.15
    prior_points: float = 4.0


def importance(
    log_density: Callable[[Array], Array],
    mixture: Mixture,
    rounds: Rounds = Rounds(),  # noqa: B008 an immutable default
    expand: Callable[[Array], Expansion] | None = None,
) -> tuple[Weighted, Mixture]:
    """Integrals of m densities by importance sampling from Student-t mixtures, and the blend of these.

    All densities share the points of one scrambled Sobol sequence, so that differences between the integrals
    are more accurate than each alone. After a round the components take mean and covariance from all points
    so far and, for a single density, Gaussians are added at the heaviest. All points are weighed against the
    blend of the mixtures of all rounds (Cornuet et al., 2012).

    log_density : (m, p, n) -> (m, p)
    mixture : a stack of m, the proposals of the first round
    expand : of a single density, (k, n) -> values, gradients and curvatures, positive definite where the
        value is finite; without it no Gaussians are added
    """
    m, n = mixture.centre.shape[0], mixture.centre.shape[2]
    size = 1 << rounds.log2_points
    log2_all = rounds.log2_points + (rounds.most - 1).bit_length()
    mixtures, proposed = list[Mixture](), list[Array]()  # and their log densities at all points
    points, target, before = np.empty((m, 0, n)), np.empty((m, 0)), np.full(m, np.inf)
    for i in range(rounds.most):
        more = sobol_points(mixture, log2_all, slice(i * size, (i + 1) * size))
        points = np.concatenate((points, more), axis=1)
        target = np.concatenate((target, log_density(more)), axis=1)
        proposed = [
            np.concatenate((known, log_mixture(earlier, more)), axis=1)
            for earlier, known in zip(mixtures, proposed, strict=True)
        ]
        mixtures.append(mixture)
        proposed.append(log_mixture(mixture, points))
        log_weight = target - log_sum_exp(np.stack(proposed), axis=0) + np.log(i + 1)
        if i + 1 < rounds.most and m > 1:  # all rounds are made of several densities
            mixture = _refitted(mixture, points, log_weight, rounds)
            continue
        found = weighted(points, log_weight)
        log_evidence, effective = found.log_evidence, found.effective_size
        if i + 1 == rounds.most or not np.all(np.isfinite(log_evidence)):
            break
        is_steady = np.abs(log_evidence - before) < rounds.steady
        if i + 1 >= rounds.least and np.all(is_steady & (effective >= rounds.enough)):
            break
        before = log_evidence
        if np.all(effective > rounds.good * size * (i + 1)):
            if i:
                break
            continue
        mixture = _refitted(mixture, points, log_weight, rounds)
        if expand is not None:
            mixture = _with_heaviest(mixture, expand, points[0], log_weight[0])
    return found, _blended(mixtures)


def _refitted(mixture: Mixture, points: Array, log_weight: Array, rounds: Rounds) -> Mixture:
    return shrunk_moments(
        mixture,
        points,
        log_weight,
        least=rounds.least_share,
        wider=rounds.wider,
        prior_points=rounds.prior_points,
    )


def _blended(mixtures: list[Mixture]) -> Mixture:
    """The mixture from which equally many points of each of several mixtures (stacks) were drawn."""
    return Mixture(
        np.concatenate([mixture.share for mixture in mixtures], axis=1) / len(mixtures),
        np.concatenate([mixture.centre for mixture in mixtures], axis=1),
        np.concatenate([mixture.factor for mixture in mixtures], axis=1),
        mixtures[0].degrees_of_freedom,
    )


def _with_heaviest(
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
    kept = best_of_distinct(z, log_weight[order], e.curvature, _APART, _JOIN)
    share = np.exp(_FLAT * (log_weight[order][kept] - log_weight[order[0]]))
    return Mixture(
        np.concatenate(((1.0 - _SHARE) * mixture.share[0], _SHARE * share / share.sum()))[None],
        np.concatenate((mixture.centre[0], centre[kept]))[None],
        np.concatenate((mixture.factor[0], _WIDER * factor[kept]))[None],
        mixture.degrees_of_freedom,
    )


@dataclass(frozen=True, slots=True)
class Proposal:
    """A density over the parameters that can be drawn from and evaluated.

    scores : normal scores of the parameters.
    mixture : over these.
    solves : forward solves of its fit, without those of the search for optima.
    """

    scores: NormalScores
    mixture: Mixture
    solves: int = 0

    def draw(self, size: int, rng: np.random.Generator | np.random.RandomState) -> Array:
        """Independent draws of the parameters (size, n); some may violate the constraints (9)."""
        return self.scores.to_x(draw(self.mixture, size, rng))

    def log_density(self, x: Array) -> Array:
        """Log density (m,) over the parameters x (m, n).

        log q(x) = log q(z) - log |dx / dz|.
        """
        z = self.scores.to_z(x)
        return log_mixture(self.mixture, z) - self.scores.log_prior(z) + self.scores.parameters.log_prior(x)
