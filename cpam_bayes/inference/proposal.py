"""Proposals that cover a density: Student-t mixtures about its optima, refined where most of the mass lies.

The mixture is one over normal scores, so that nothing is cut: a posterior that piles up on a bound becomes
a peak with a light tail. Approximations about optima and nodes may miss a narrow bent ridge: after each round
Gaussians join at the heaviest points so far, from the density's own gradient and curvature there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from scipy.special import logsumexp

from cpam_bayes.inference.derivatives import MAX_SCORE, Expansion, NormalScores, apart, coordinates, distinct
from cpam_bayes.inference.laplace import Approximation, approximate, find_optima, maximise, promised_gain
from cpam_bayes.inference.log_density import LogDensity
from cpam_bayes.inference.posterior import Posterior
from cpam_bayes.inference.student_mixture import (
    Mixture,
    Weighted,
    box_draws,
    draw,
    effective_size,
    fit,
    log_blend,
    log_mixture,
    shrunk_moments,
    single,
    sobol_points,
    split,
    weighted,
    widened,
)
from cpam_bayes.mechanics.problem import Array

# Said where importance sampling meets nothing but zeros.
NOWHERE = "no draw of the proposal lies in the support of the prior; check bounds and constraints"
_FREEDOM = 5.0
# Effective fraction of a round's draws from which adapting more is not worth it.
_GOOD_FRACTION = 0.6
# Fraction and width of the component that catches what the others leave out.
_SAFE_FRACTION, _SAFE_WIDTH = 0.1, 2.0
# Adapting ends too when, after so many rounds, that fraction no longer grows by such a factor.
_STALLED_AFTER, _LEAST_GAIN = 4, 1.05
# Rounds at least.
_FEWEST_ROUNDS = 2
# Draws of a chain that a mixture is fitted to, and of each approximation.
_CHAIN_DRAWS, _APPROXIMATION_DRAWS = 4000, 1000


@dataclass(frozen=True, slots=True)
class AdaptationSettings:
    """How a proposal is fitted.

    rounds, draws : adaptive steps at most, and draws of each.
    components : Student-t densities beyond those of separate optima.
    """

    rounds: int = 8
    draws: int = 2500
    components: int = 6


@dataclass(frozen=True, slots=True)
class Proposal:
    """A density over the parameters that is drawn from and evaluated at once.

    scores : normal scores of the parameters.
    mixture : over these.
    solves : forward solves that fitting it took, those of the search for optima apart.
    """

    scores: NormalScores
    mixture: Mixture
    solves: int = 0

    def draw(self, size: int, rng: np.random.Generator | np.random.RandomState) -> Array:
        """Independent parameters (size, n); some may break the constraints (9)."""
        return self.scores.to_x(draw(self.mixture, size, rng))

    def log_density(self, x: Array) -> Array:
        """Log density over the parameters x (m, n), (m,).

        log q(x) = log q(z) - log |dx / dz|.
        """
        z = self.scores.to_z(x)
        return log_mixture(self.mixture, z) - self.scores.log_prior(z) + self.scores.parameters.log_prior(x)


@dataclass(slots=True)
class Adaptation:
    """A proposal on its way, and all draws so far: proposals, points of each, and the log densities there."""

    posterior: Posterior
    scores: NormalScores
    proposal: Mixture
    components: int
    proposals: list[Mixture] = field(default_factory=list)
    points: list[Array] = field(default_factory=list)
    targets: list[Array] = field(default_factory=list)


def adapted(posterior: Posterior, starts: Array, seed: int, settings: AdaptationSettings) -> Proposal:
    """The proposal of a posterior whose optima lie near the starts (m, n), or are found from the prior."""
    state = adapt(posterior, starts, np.random.default_rng([seed, 5]), settings)
    return Proposal(state.scores, state.proposal, sum(map(len, state.points)))


def adapt(
    posterior: Posterior,
    starts: Array,
    rng: np.random.Generator,
    settings: AdaptationSettings,
    chain: Array | None = None,
) -> Adaptation:
    """Fit a proposal in rounds (population Monte Carlo: Cappe et al., 2008).

    It begins as the Laplace approximations about the optima, and with the draws of a chain (n_draws, n)
    where there are some. Raises ``ValueError`` where nothing lies in the support of the prior.
    """
    scores = NormalScores(posterior.parameters)
    optima = find_optima(posterior, starts.reshape(-1, posterior.parameters.size), rng)
    approximations = [approximate(posterior, optimum, degrees_of_freedom=_FREEDOM) for optimum in optima]
    proposal = _from_approximations(posterior, scores, approximations, rng)
    if chain is not None:
        proposal = _joined(proposal, _from_chain(scores, chain, settings.components, rng))
    components = len(optima) + settings.components - 1
    state = Adaptation(posterior, scores, proposal, components)
    fractions: list[float] = []
    while len(fractions) < settings.rounds:
        fractions.append(draw_round(state, settings.draws, rng))
        refine(state)
        if len(fractions) >= _FEWEST_ROUNDS and fractions[-1] >= _GOOD_FRACTION:
            break
        if len(fractions) >= _STALLED_AFTER and fractions[-1] < _LEAST_GAIN * max(fractions[:-1]):
            break
    return state


def _from_approximations(
    posterior: Posterior,
    scores: NormalScores,
    approximations: Sequence[Approximation],
    rng: np.random.Generator,
) -> Mixture:
    """One component about each optimum: mean and covariance of draws of the cut approximation."""
    axes = coordinates(posterior)
    even = np.full(_APPROXIMATION_DRAWS, 1.0 / _APPROXIMATION_DRAWS)
    components = []
    for a in approximations:
        nu = a.degrees_of_freedom
        u, _ = box_draws(a.centre, a.scale, axes.lower, axes.upper, nu, _APPROXIMATION_DRAWS, rng)
        components.append(single(scores.to_z(axes.to_x(u)), even, _FREEDOM))
    height = np.array([a.log_evidence for a in approximations])
    share = np.maximum(np.exp(height - height.max()), 0.02)
    return Mixture(
        share / share.sum(),
        np.concatenate([c.centre for c in components]),
        np.concatenate([c.factor for c in components]),
        _FREEDOM,
    )


def _from_chain(scores: NormalScores, chain: Array, components: int, rng: np.random.Generator) -> Mixture:
    few = chain[rng.choice(len(chain), size=min(_CHAIN_DRAWS, len(chain)), replace=False)]
    z = scores.to_z(few)
    even = np.full(len(z), 1.0 / len(z))
    return fit(split(single(z, even, _FREEDOM), z, even, components), z, even, 20)


def _joined(one: Mixture, other: Mixture) -> Mixture:
    """Both mixtures, half and half."""
    parts = zip((one.share, one.centre, one.factor), (other.share, other.centre, other.factor), strict=True)
    share, centre, factor = (np.concatenate(p) for p in parts)
    return Mixture(0.5 * share, centre, factor, one.degrees_of_freedom)


def draw_round(state: Adaptation, size: int, rng: np.random.Generator) -> float:
    """Draws of a proposal, added to those before, and their effective fraction."""
    z = draw(state.proposal, size, rng)
    x, posterior = state.scores.to_x(z), state.posterior
    # -inf where the constraints (9) are broken
    target = posterior.log_prob(x) - posterior.parameters.log_prior(x) + state.scores.log_prior(z)
    state.proposals.append(state.proposal)
    state.points.append(z)
    state.targets.append(target)
    return effective_size(target - log_mixture(state.proposal, z)) / size


def refine(state: Adaptation) -> None:
    """The next proposal: a mixture fitted to all draws so far, and a wide component besides.

    Every draw is weighed against the blend of all proposals (Cornuet et al., 2012), so that a bad first
    round does not lead the next one astray.
    """
    points = np.concatenate(state.points)
    sizes = [len(v) for v in state.points]
    log_weight = np.concatenate(state.targets) - log_blend(state.proposals, sizes, points)
    weights = _tempered(log_weight, 20.0 * points.shape[1])
    main = state.proposals[-1]
    if len(state.proposals) > 1:  # less the wide component, which is added anew
        share = main.share[:-1]
        main = Mixture(share / share.sum(), main.centre[:-1], main.factor[:-1], main.degrees_of_freedom)
    fitted = fit(split(main, points, weights, state.components), points, weights)
    state.proposal = widened(fitted, _SAFE_FRACTION, _SAFE_WIDTH, points, weights)


def _tempered(log_weight: Array, least: float) -> Array:
    """Normalised weights, flattened to the power at which their effective size is the least wanted."""
    finite = np.isfinite(log_weight)
    if not finite.any():
        raise ValueError(NOWHERE)
    power = 1.0
    while (
        effective_size(np.where(finite, power * log_weight, -np.inf)) < min(least, finite.sum())
        and power > 1e-3
    ):
        power *= 0.7
    w = np.exp(np.where(finite, power * (log_weight - log_weight[finite].max()), -np.inf))
    return np.asarray(w / w.sum())


# Optima are the same within this distance, standard deviations.
_DISTINCT_SD = 1.0
# Components with less of the mass propose nothing; degrees of freedom and widening of the others.
_NEGLIGIBLE, _FREEDOM_ABOUT, _WIDER_ABOUT = 1e-4, 6.0, 1.15


@dataclass(frozen=True, slots=True)
class Optima:
    """Distinct optima of a log density over normal scores, the best one first.

    z : (k, n)
    value : (k,)
    gradient : (k, n)
    curvature : (k, n, n)
    """

    z: Array
    value: Array
    gradient: Array
    curvature: Array

    def only(self, kept: Any) -> Optima:
        """Some of them."""
        return Optima(self.z[kept], self.value[kept], self.gradient[kept], self.curvature[kept])

    @property
    def log_mass(self) -> Array:
        """Log of the integral about each by Laplace's approximation, (k,)."""
        n = self.z.shape[1]
        log_det = np.linalg.slogdet(self.curvature)[1]
        return np.asarray(self.value + 0.5 * n * np.log(2 * np.pi) - 0.5 * log_det)

    @property
    def factor(self) -> Array:
        """Square root of the covariance about each, (k, n, n)."""
        return np.linalg.cholesky(np.linalg.inv(self.curvature))

    @property
    def promise(self) -> Array:
        """Gain, nats, that one more step promises each, (k,)."""
        return promised_gain(self.gradient, self.curvature)


def maximised(
    density: LogDensity, z: Array, most_steps: int, promised: float, most: int | None = None
) -> Optima:
    """Distinct ends of optimisations from scores (s, n), ``most`` at the most.

    most_steps, promised : as in ``maximise``
    """
    bound = np.full(z.shape[1], MAX_SCORE)
    maxima = maximise(
        lambda at, rows: density.expand(at), z, -bound, bound, most_steps=most_steps, promised=promised
    )
    kept = distinct(maxima.u, maxima.expansion, _DISTINCT_SD, most)
    e = maxima.expansion
    return Optima(maxima.u[kept], e.value[kept], e.gradient[kept], e.curvature[kept])


def about(z: Array, factor: Array, log_mass: Array) -> tuple[Array, Mixture]:
    """Numbers of the components that carry mass, the largest first, and the proposal about them.

    z : (k, n) centres of Gaussians
    factor : (k, n, n) square roots of their covariances
    log_mass : (k,)
    """
    kept = np.flatnonzero(log_mass > log_mass.max() + np.log(_NEGLIGIBLE))
    kept = kept[np.argsort(-log_mass[kept], kind="stable")]
    share = np.exp(log_mass[kept] - logsumexp(log_mass[kept]))
    return kept, Mixture(share[None], z[None, kept], _WIDER_ABOUT * factor[None, kept], _FREEDOM_ABOUT)


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
    good : effective fraction of the points of the first round with which the proposal is left as it is, and
        twice its points are enough
    """

    log2_points: int = 8
    most: int = 16
    least: int = 4
    enough: float = 400.0
    steady: float = 0.05
    good: float = 1.0


def refitted_moments(mixture: Mixture, points: Array, log_weight: Array) -> Mixture:
    """The mixture with the moments of its components taken from weighted points, shrunk to what they were."""
    return shrunk_moments(mixture, points, log_weight, least=1e-3, wider=_WIDER, prior_points=4.0)


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
        if found.effective_size[0] > rounds.good * size * (i + 1):
            if i:
                break
            continue
        mixture = _with_heaviest(refit(mixture, points, log_weight), expand, points[0], log_weight[0])
    return found


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
    kept = apart(z, e.curvature, _APART, _JOIN)
    share = np.exp(_FLAT * (log_weight[order][kept] - log_weight[order[0]]))
    return Mixture(
        np.concatenate(((1.0 - _SHARE) * mixture.share[0], _SHARE * share / share.sum()))[None],
        np.concatenate((mixture.centre[0], centre[kept]))[None],
        np.concatenate((mixture.factor[0], _WIDER * factor[kept]))[None],
        mixture.degrees_of_freedom,
    )
