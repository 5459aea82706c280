"""Evidence of a posterior by importance sampling from Student-t densities about its optima.

Bounded parameters are carried to the whole line by a logistic map, so that nothing is cut: a posterior that
piles up on a bound becomes a peak with an exponential tail, which a Student-t covers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.inference.box import box_draws
from cpam_bayes.inference.ensemble import EnsembleResult
from cpam_bayes.inference.expansion import coordinates, log_density
from cpam_bayes.inference.laplace import Approximation, approximate, find_optima
from cpam_bayes.inference.mixture import (
    Mixture,
    draw,
    fit,
    log_mixture,
    log_sum_exp,
    single,
    split,
    widened,
)
from cpam_bayes.inference.whole_line import WholeLine, whole_line
from cpam_bayes.posterior import Posterior
from cpam_bayes.threads import single_blas_thread

Array = NDArray[Any]

# Importance weights with a heavier tail than this have no useful error (Vehtari et al., 2024).
RELIABLE_K = 0.7
_FREEDOM = 5.0
# Effective share of a round's draws from which adapting more is not worth it.
_GOOD_SHARE = 0.6
# Share and width of the component that catches what the others leave out.
_SAFE_SHARE, _SAFE_WIDTH = 0.1, 2.0
# Adapting ends too when, after so many rounds, the share no longer grows by such a factor.
_LEVEL, _GAIN = 4, 1.05
# Rounds at least, and weight of one draw above which the proposal has missed something.
_FEWEST_ROUNDS, _MOST_WEIGHT = 2, 0.005
# Draws of a chain that a mixture is fitted to, and of each approximation.
_MOST_CHAIN, _PICTURE_DRAWS = 4000, 1000


@dataclass(frozen=True, slots=True)
class EvidenceSettings:
    """How an evidence is sampled.

    draws : of the estimate. rounds, round_draws : adaptive steps before, at most, and draws of each.
    components : Student-t densities in the proposal beyond those of separate optima. attempts : how often
    the estimate is made, each time from a proposal fitted to all draws before, until no weight stands out.
    """

    draws: int = 20_000
    rounds: int = 8
    round_draws: int = 2500
    components: int = 6
    attempts: int = 3


DEFAULT_SETTINGS = EvidenceSettings()


@dataclass(frozen=True, slots=True)
class Evidence:
    """The integral of likelihood times prior density, and the draws it was estimated from.

    standard_error : of log_evidence, from the spread of the weights. effective_size : (sum w)^2 / sum w^2.
    k_hat : Pareto shape of the largest weights. status : reliable where k_hat is below 0.7 and the
    effective size above 100; elsewhere neither value nor error are to be relied on. n_draws : of the
    estimate; solves : of the adaptation too. mean, sd : (n,) of the parameters. draws : (n_draws, n);
    log_weights : (n_draws,), their normalised weights.

    The prior is the product of the parameters' densities, zero where the constraints (9) are broken; it
    is not normalised again for these.
    """

    log_evidence: float
    standard_error: float
    effective_size: float
    k_hat: float
    status: Literal["reliable", "unreliable"]
    n_draws: int
    solves: int
    mean: Array
    sd: Array
    draws: Array
    log_weights: Array


def evidence_of(
    posterior: Posterior,
    result: EnsembleResult,
    seed: int,
    *,
    settings: EvidenceSettings = DEFAULT_SETTINGS,
) -> Evidence:
    """The evidence of a posterior whose chains are there.

    The proposal is fitted to draws of the chains and to the optima next to their best draw and to draws
    from the prior, so that an optimum that the chains have missed counts.
    """
    best = result.draws[int(np.argmax(result.log_prob))]
    return importance_evidence(posterior, best[None], seed, chain=result.draws, settings=settings)


@single_blas_thread
def importance_evidence(
    posterior: Posterior,
    starts: Array,
    seed: int,
    *,
    chain: Array | None = None,
    settings: EvidenceSettings = DEFAULT_SETTINGS,
) -> Evidence:
    """The evidence of a posterior by adaptive importance sampling.

    Z = E_q[p / q], q a mixture of Student-t densities of 5 degrees of freedom in coordinates without
    bounds. It begins as the Laplace approximations about the optima, and with the draws of a chain where
    there are some; weighted draws refine it in rounds (population Monte Carlo: Cappe et al., 2008). The
    estimate is made of fresh draws, for which q is fixed: its expectation is Z. If one draw carries more
    than 0.5 % of the weight, or the tail of the weights is heavy, q has missed something that these
    draws have found, and the estimate is made again from a q fitted to them. Raises ``ValueError`` where
    nothing lies in the support of the prior.

    starts : (m, n) where optima are looked for, besides draws from the prior; may be empty. chain :
    (n_draws, n) draws of the posterior.
    """
    rng = np.random.default_rng([seed, 4])
    line = whole_line(coordinates(posterior))
    optima = find_optima(posterior, starts.reshape(-1, posterior.parameters.size), rng)
    pictures = [approximate(posterior, optimum, degrees_of_freedom=_FREEDOM) for optimum in optima]
    proposal = _from_pictures(line, pictures, rng)
    if chain is not None:
        proposal = _joined(proposal, _from_chain(line, chain, settings.components, rng))
    components = len(optima) + settings.components - 1
    history = _History([], [], [])
    shares: list[float] = []
    while len(shares) < settings.rounds:
        shares.append(_round(posterior, line, history, proposal, settings.round_draws, rng))
        proposal = _refined(history, components)
        if len(shares) >= _FEWEST_ROUNDS and shares[-1] >= _GOOD_SHARE:
            break
        if len(shares) >= _LEVEL and shares[-1] < _GAIN * max(shares[:-1]):
            break
    for attempt in range(settings.attempts):
        _round(posterior, line, history, proposal, settings.draws, rng)
        log_weight = history.targets[-1] - log_mixture(proposal, history.points[-1])
        found = _summarised(line, history.points[-1], log_weight, sum(map(len, history.points)))
        missed = np.exp(found.log_weights.max()) > _MOST_WEIGHT
        if (found.status == "reliable" and not missed) or attempt == settings.attempts - 1:
            break
        proposal = _refined(history, components)
    return found


# The proposal


def _log_target(posterior: Posterior, line: WholeLine, v: Array) -> Array:
    """Log density over v but for the evidence, (m, n) -> (m,)."""
    return log_density(posterior, line.axes, line.to_u(v)) + line.log_jacobian(v)


def _from_pictures(line: WholeLine, pictures: Sequence[Approximation], rng: np.random.Generator) -> Mixture:
    """One component about each optimum: mean and covariance of draws of the cut approximation."""
    found = []
    for picture in pictures:
        u, _ = box_draws(
            picture.centre,
            picture.scale,
            line.axes.lower,
            line.axes.upper,
            picture.degrees_of_freedom,
            _PICTURE_DRAWS,
            rng,
        )
        even = np.full(_PICTURE_DRAWS, 1.0 / _PICTURE_DRAWS)
        found.append(single(line.to_v(u), even, _FREEDOM))
    height = np.array([picture.log_evidence for picture in pictures])
    share = np.maximum(np.exp(height - height.max()), 0.02)
    return Mixture(
        share / share.sum(),
        np.concatenate([f.centre for f in found]),
        np.concatenate([f.factor for f in found]),
        _FREEDOM,
    )


def _from_chain(line: WholeLine, chain: Array, components: int, rng: np.random.Generator) -> Mixture:
    few = chain[rng.choice(len(chain), size=min(_MOST_CHAIN, len(chain)), replace=False)]
    v = line.to_v(line.axes.to_u(few))
    even = np.full(len(v), 1.0 / len(v))
    return fit(split(single(v, even, _FREEDOM), v, even, components), v, even, 20)


def _joined(one: Mixture, other: Mixture) -> Mixture:
    """Both mixtures, half and half."""
    parts = zip((one.share, one.centre, one.factor), (other.share, other.centre, other.factor), strict=True)
    share, centre, factor = (np.concatenate(p) for p in parts)
    return Mixture(0.5 * share, centre, factor, one.degrees_of_freedom)


@dataclass(frozen=True, slots=True)
class _History:
    """All draws so far: the proposals, the points of each and the log densities there."""

    proposals: list[Mixture]
    points: list[Array]
    targets: list[Array]


def _round(
    posterior: Posterior,
    line: WholeLine,
    history: _History,
    proposal: Mixture,
    size: int,
    rng: np.random.Generator,
) -> float:
    """Draws of a proposal, added to the history, and their effective share."""
    v = draw(proposal, size, rng)
    history.proposals.append(proposal)
    history.points.append(v)
    history.targets.append(_log_target(posterior, line, v))
    return _effective(history.targets[-1] - log_mixture(proposal, v)) / size


def _refined(history: _History, components: int) -> Mixture:
    """The next proposal: a mixture fitted to all draws so far, and a wide component besides.

    Every draw is weighed against the blend of all proposals (Cornuet et al., 2012), so that a bad first
    round does not lead the next one astray.
    """
    points = np.concatenate(history.points)
    sizes = np.log([len(v) for v in history.points])
    blend = np.stack([log_mixture(p, points) for p in history.proposals], axis=1) + sizes
    log_weight = np.concatenate(history.targets) - log_sum_exp(blend, axis=1)
    weights = _tempered(log_weight, 20.0 * points.shape[1])
    main = history.proposals[-1]
    if len(history.proposals) > 1:  # less the wide component, which is added anew
        share = main.share[:-1]
        main = Mixture(share / share.sum(), main.centre[:-1], main.factor[:-1], main.degrees_of_freedom)
    fitted = fit(split(main, points, weights, components), points, weights)
    return widened(fitted, _SAFE_SHARE, _SAFE_WIDTH, points, weights)


def _effective(log_weight: Array) -> float:
    top = float(log_weight.max())
    if not np.isfinite(top):
        return 0.0
    w = np.exp(log_weight - top)
    return float(w.sum() ** 2 / np.sum(w**2))


def _tempered(log_weight: Array, least: float) -> Array:
    """Normalised weights, flattened to the power at which their effective size is the least wanted."""
    finite = np.isfinite(log_weight)
    if not finite.any():
        raise ValueError(
            "no draw of the proposal lies in the support of the prior; check bounds and constraints"
        )
    power = 1.0
    while (
        _effective(np.where(finite, power * log_weight, -np.inf)) < min(least, finite.sum()) and power > 1e-3
    ):
        power *= 0.7
    w = np.exp(np.where(finite, power * (log_weight - log_weight[finite].max()), -np.inf))
    return np.asarray(w / w.sum())


# The answer


def _summarised(line: WholeLine, v: Array, log_weight: Array, solves: int) -> Evidence:
    if not np.isfinite(log_weight).any():
        raise ValueError(
            "no draw of the proposal lies in the support of the prior; check bounds and constraints"
        )
    n = len(v)
    total = float(log_sum_exp(log_weight[None], axis=1)[0])
    log_evidence = total - np.log(n)
    ratio = np.exp(log_weight - log_evidence)
    effective = _effective(log_weight)
    k_hat = pareto_shape(log_weight)
    x = line.axes.to_x(line.to_u(v))
    weights = ratio / n
    mean = weights @ x
    return Evidence(
        log_evidence=float(log_evidence),
        standard_error=float(ratio.std(ddof=1) / np.sqrt(n)),
        effective_size=effective,
        k_hat=k_hat,
        status="reliable" if k_hat < RELIABLE_K and effective > 100.0 else "unreliable",
        n_draws=n,
        solves=solves,
        mean=mean,
        sd=np.sqrt(weights @ (x - mean) ** 2),
        draws=x,
        log_weights=log_weight - total,
    )


def pareto_shape(log_weight: Array) -> float:
    """Shape k-hat of a generalised Pareto density fitted to the largest weights (Vehtari et al., 2024)."""
    import arviz

    _, k_hat = arviz.psislw(log_weight[np.isfinite(log_weight)])  # type: ignore[no-untyped-call]
    return float(k_hat)
