"""Evidence of a posterior by importance sampling from Student-t densities about its optima."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.inference.chains.ensemble import EnsembleResult
from cpam_bayes.inference.importance import RELIABLE_K, weighted
from cpam_bayes.inference.posterior import Posterior
from cpam_bayes.inference.proposal import (
    NOWHERE,
    AdaptationSettings,
    adapt,
    draw_round,
    refine,
)
from cpam_bayes.inference.standard_normal import NormalScores
from cpam_bayes.inference.student_mixture import log_mixture
from cpam_bayes.threads import single_blas_thread

Array = NDArray[Any]

# Weight of one draw above which the proposal has missed something.
_OUTSTANDING_WEIGHT = 0.005


@dataclass(frozen=True, slots=True)
class EvidenceSettings:
    """How an evidence is sampled.

    draws : of the estimate.
    adaptation : of the proposal before.
    attempts : how often the estimate is made, each time from a proposal fitted to all draws before, until no
    weight stands out.
    """

    draws: int = 20_000
    adaptation: AdaptationSettings = field(default_factory=AdaptationSettings)
    attempts: int = 3


DEFAULT_SETTINGS = EvidenceSettings()


@dataclass(frozen=True, slots=True)
class Evidence:
    """The integral of likelihood times prior density, and the draws it was estimated from.

    standard_error : of log_evidence, from the spread of the weights.
    effective_size : (sum w)^2 / sum w^2.
    k_hat : Pareto shape of the largest weights.
    status : reliable where k_hat is below 0.7 and the effective size above 100; elsewhere neither value nor
    error are to be relied on.
    n_draws : of the estimate.
    solves : of the adaptation too.
    mean, sd : (n,) of the parameters.
    draws : (n_draws, n).
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

    Z = E_q[p / q], q a mixture of Student-t densities of 5 degrees of freedom over normal
    scores. It begins as the Laplace approximations about the optima, and with the draws of a chain where
    there are some; weighted draws refine it in rounds (population Monte Carlo: Cappe et al., 2008). The
    estimate is made of fresh draws, for which q is fixed: its expectation is Z. If one draw carries more
    than 0.5 % of the weight, or the tail of the weights is heavy, q has missed something that these
    draws have found, and the estimate is made again from a q fitted to them. Raises ``ValueError`` where
    nothing lies in the support of the prior.

    starts : (m, n) where optima are looked for, besides draws from the prior; may be empty.
    chain : (n_draws, n) draws of the posterior.
    """
    rng = np.random.default_rng([seed, 4])
    state = adapt(posterior, starts, rng, settings.adaptation, chain)
    scores, history = state.scores, state.history
    for attempt in range(settings.attempts):
        draw_round(state, settings.draws, rng)
        log_weight = history.targets[-1] - log_mixture(state.proposal, history.points[-1])
        evidence = _summarised(scores, history.points[-1], log_weight, sum(map(len, history.points)))
        missed = np.exp(evidence.log_weights.max()) > _OUTSTANDING_WEIGHT
        if (evidence.status == "reliable" and not missed) or attempt == settings.attempts - 1:
            break
        refine(state)
    return evidence


def _summarised(scores: NormalScores, z: Array, log_ratio: Array, solves: int) -> Evidence:
    if not np.isfinite(log_ratio).any():
        raise ValueError(NOWHERE)
    x = scores.to_x(z)
    sample = weighted(x[None], log_ratio[None])
    weight, k_hat, effective = sample.weight[0], float(sample.k_hat[0]), float(sample.effective_size[0])
    mean = weight @ x
    with np.errstate(divide="ignore"):
        log_weights = np.log(weight)
    return Evidence(
        log_evidence=float(sample.log_evidence[0]),
        standard_error=float(sample.standard_error[0]),
        effective_size=effective,
        k_hat=k_hat,
        status="reliable" if k_hat < RELIABLE_K and effective > 100.0 else "unreliable",
        n_draws=len(z),
        solves=solves,
        mean=mean,
        sd=np.sqrt(weight @ (x - mean) ** 2),
        draws=x,
        log_weights=log_weights,
    )
