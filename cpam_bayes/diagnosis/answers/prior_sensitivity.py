"""What the probabilities would be with other priors: the scales of causes and noise times 3, divided by 3."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from cpam_bayes.diagnosis.claim import Claim
from cpam_bayes.diagnosis.evidence.weighing import Tested, Weighed
from cpam_bayes.parameters import Mixture, Prior, ScaledStudentT, TruncatedLogNormal, TruncatedNormal

Array = NDArray[Any]

FACTORS: Final = (3.0, 1.0 / 3.0)
"""Of the scales of the causes' sizes and of an inferred repeatability."""


@dataclass(frozen=True, slots=True)
class PriorSensitivity:
    """The answer with other scales of the priors.

    probabilities : of every cause, its variants summed, for each of `FACTORS`
    claims : for each of them
    claim_stands : whether kind and causes of the claim are the same with all of them
    """

    probabilities: tuple[Mapping[str, float], ...]
    claims: tuple[Claim, ...]
    claim_stands: bool


def prior_sensitivity(
    weighed: Weighed, claim: Claim, claim_of: Callable[[Weighed], Claim]
) -> PriorSensitivity:
    """Probabilities and claims with every scale multiplied by each of `FACTORS`.

    claim_of : the claim from hypotheses with their probabilities and Bayes factors.
    """
    others = [reweighed(weighed, factor) for factor in FACTORS]
    claims = tuple(claim_of(other) for other in others)
    stands = all(c.kind == claim.kind and set(c.causes) == set(claim.causes) for c in claims)
    return PriorSensitivity(tuple(other.by_cause() for other in others), claims, stands)


def reweighed(weighed: Weighed, factor: float) -> Weighed:
    """All hypotheses with the probabilities and Bayes factors of other prior scales.

    Z' = Z E[p'(x) / p(x)], the mean over the posterior: importance sampling from the posterior of the first
    prior, as in power scaling (Kallioinen et al., Stat. Comput. 34, 2024).
    """
    log_ratio = np.array([_log_ratio(t, factor) for t in weighed.tested])
    ratio_of = {id(t): r for t, r in zip(weighed.tested, log_ratio, strict=True)}
    plain = weighed.plain
    of_none = float(logsumexp([ratio_of[id(t)] for t, _ in plain], b=[fraction for _, fraction in plain]))
    with np.errstate(divide="ignore"):
        log_weight = np.log([t.probability for t in weighed.tested]) + log_ratio
    probability = np.exp(log_weight - logsumexp(log_weight))
    tested = [
        replace(t, probability=float(p), log_bayes_factor=t.log_bayes_factor + float(r - of_none))
        for t, p, r in zip(weighed.tested, probability, log_ratio, strict=True)
    ]
    return replace(weighed, tested=tuple(sorted(tested, key=lambda t: -t.probability)))


def rescaled(prior: Prior, factor: float) -> Prior:
    """A prior with its scale multiplied, its bounds kept; one without a scale as it is.

    Of a size that may be a gross error the tolerance is rescaled.
    """
    if isinstance(prior, Mixture):
        return replace(prior, narrow=rescaled(prior.narrow, factor))
    if isinstance(prior, ScaledStudentT | TruncatedNormal):
        return replace(prior, scale=factor * prior.scale)
    if isinstance(prior, TruncatedLogNormal):
        return replace(prior, median=factor * prior.median)
    return prior


def _log_ratio(t: Tested, factor: float) -> float:
    """ln Z' / Z of one hypothesis."""
    comparison, draws = t.marginal.comparison, t.marginal.draws
    log_weight = np.array(t.marginal.log_weight)
    columns = [*t.columns, *(c for c in comparison.amplitudes if c >= 0)]
    for column in columns:
        prior = comparison.parameters.parameters[column].prior
        x = draws[:, column]
        log_weight += rescaled(prior, factor).log_density(x) - prior.log_density(x)
    return float(logsumexp(log_weight))
