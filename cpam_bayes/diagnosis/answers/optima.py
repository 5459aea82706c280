"""Constants averaged over hypotheses, open optima, and the sensitivity to the scales of the priors."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.special import logsumexp

from cpam_bayes.diagnosis.comparison import PlateCase
from cpam_bayes.diagnosis.evidence.weighing import Tested, Weighed
from cpam_bayes.diagnosis.hypotheses import Claim
from cpam_bayes.inference.laplace import maximised
from cpam_bayes.mechanics.problem import Array

# Least fraction of the posterior of a reported optimum; most nodes from which optima are sought, and the
# least fraction of such a node.
_LEAST_FRACTION, _MOST_STARTS, _START_FRACTION = 0.03, 12, 3e-3
# Steps of an optimisation at most, and the gain, nats, that ends it.
_MOST_STEPS, _PROMISED = 60, 1e-3
# Constants agree within so many standard deviations.
_SAME_SD = 2.0


@dataclass(frozen=True, slots=True)
class OpenOptimum:
    """One of several optima of the posterior.

    fraction : of the posterior about it
    constants : name -> value there, SI
    modes : mode label of every listed frequency, plate by plate
    """

    fraction: float
    constants: Mapping[str, float]
    modes: tuple[tuple[str, ...], ...]

    def differences(self, other: OpenOptimum) -> tuple[tuple[int, int, str, str], ...]:
        """Plate, number of the frequency from 0 and both labels, wherever the modes differ."""
        return tuple(
            (i, k, a, b)
            for i, (here, there) in enumerate(zip(self.modes, other.modes, strict=True))
            for k, (a, b) in enumerate(zip(here, there, strict=True))
            if a != b
        )


def open_optima(t: Tested, cases: Sequence[PlateCase]) -> tuple[OpenOptimum, ...]:
    """Optima of a hypothesis that carry probability, the most probable first; empty if there is only one.

    Every posterior draw counts for its nearest optimum, in standard deviations.
    """
    marginal, comparison = t.marginal, t.marginal.comparison
    starts = marginal.z[:_MOST_STARTS][marginal.weight[:_MOST_STARTS] > _START_FRACTION]
    if len(starts) < 2:
        return ()
    optima = maximised(comparison, starts, _MOST_STEPS, _PROMISED)
    z, curvature = optima.z, optima.curvature
    draws = comparison.scores.to_z(marginal.draws)
    away = draws[:, None] - z
    nearest = np.einsum("dki,kij,dkj->dk", away, curvature, away).argmin(axis=1)
    fraction = np.bincount(nearest, np.exp(marginal.log_weight), minlength=len(z))
    constants_at = [comparison.parameters.names.index(name) for name in _unknowns(t, cases)]
    carry, fraction = _apart(z[:, constants_at], curvature, constants_at, fraction)
    if len(carry) < 2:
        return ()
    sizes = {p.name for p in t.hypothesis.parameters}
    open_ones = []
    for best in carry:
        x = comparison.scores.to_x(z[best])
        names = comparison.model.parameters.names
        constants = {name: float(value) for name, value in zip(names, x, strict=False) if name not in sizes}
        modes = []
        for case, part in zip(t.cases or cases, comparison.model.parts, strict=True):
            every = case.models.bare.full.modes(part.plate_vector(x[None])[0])
            labels = [every[j].label if j < len(every) else "" for j in part.modes]
            for k in np.flatnonzero(case.modes < 0):  # false peaks of an incomplete list
                labels.insert(int(k), "")
            modes.append(tuple(labels))
        open_ones.append(OpenOptimum(float(fraction[best]), constants, tuple(modes)))
    return tuple(open_ones)


def _unknowns(t: Tested, cases: Sequence[PlateCase]) -> list[str]:
    """Names of the unknown constants that are parameters of the hypothesis."""
    names = dict.fromkeys(n for case in cases for n in case.models.specimen.unknowns.names)
    return [n for n in t.marginal.comparison.parameters.names if n in names]


def _apart(z: Array, curvature: Array, columns: list[int], fraction: Array) -> tuple[list[int], Array]:
    """Optima that carry probability and differ in a constant; others count for the one they agree with.

    A skew of either sign, or a mass at the mirrored place, leaves the constants where they are.
    """
    sd = np.sqrt(np.diagonal(np.linalg.inv(curvature), axis1=1, axis2=2)[:, columns])
    whole = np.zeros_like(fraction)
    carry: list[int] = []
    for k in np.argsort(-fraction, kind="stable"):
        same = [i for i in carry if np.all(np.abs(z[k] - z[i]) < _SAME_SD * np.maximum(sd[k], sd[i]))]
        at = same[0] if same else int(k)
        whole[at] += fraction[k]
        if not same:
            carry.append(int(k))
    return [k for k in carry if whole[k] > _LEAST_FRACTION], whole


FACTORS: Final = (3.0, 1.0 / 3.0)
"""Factors on the scales of the causes' sizes and of an inferred repeatability."""


@dataclass(frozen=True, slots=True)
class PriorSensitivity:
    """Probabilities and claims with other scales of the priors.

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
    """Hypotheses with the probabilities and Bayes factors of other prior scales.

    Z' = Z E[p'(x) / p(x)], the mean over the posterior: importance sampling from the posterior of the
    original prior, as in power scaling (Kallioinen et al., Stat. Comput. 34, 2024).
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


def _log_ratio(t: Tested, factor: float) -> float:
    """ln Z' / Z of one hypothesis."""
    comparison, draws = t.marginal.comparison, t.marginal.draws
    log_weight = np.array(t.marginal.log_weight)
    columns = dict.fromkeys((*t.columns, *comparison.nuisance))
    for column in columns:
        prior = comparison.parameters.parameters[column].prior
        x = draws[:, column]
        log_weight += prior.rescaled(factor).log_density(x) - prior.log_density(x)
    return float(logsumexp(log_weight))


# Hypotheses with less probability are dropped.
_NEGLIGIBLE = 1e-6
_QUANTILES = np.array([0.025, 0.975])


def averaged_constants(weighed: Weighed) -> Mapping[str, tuple[float, float, float, float]]:
    """Plain-model parameters averaged over hypotheses: name -> mean, sd, 2.5 and 97.5 % quantile, SI.

    The density is sum_h P(h | data) p(x | h, data), Bayesian model averaging (Hoeting et al., Stat. Sci. 14,
    1999), from the weighted draws of every hypothesis.
    """
    names, draws, weight = averaged_draws(weighed)
    mean = weight @ draws
    sd = np.sqrt(weight @ (draws - mean) ** 2)
    quantiles = [weighted_quantiles(draws[:, i], weight, _QUANTILES) for i in range(len(names))]
    return {
        name: (float(mean[i]), float(sd[i]), float(quantiles[i][0]), float(quantiles[i][1]))
        for i, name in enumerate(names)
    }


def averaged_draws(weighed: Weighed) -> tuple[tuple[str, ...], Array, Array]:
    """Names, draws (d, n) and weights (d,) of the parameters of the plain model over all hypotheses."""
    names = weighed.none.marginal.comparison.model.parameters.names
    kept = [
        t
        for t in weighed.tested
        if t.probability >= _NEGLIGIBLE and set(names) <= set(t.marginal.comparison.parameters.names)
    ]
    columns = [[t.marginal.comparison.parameters.names.index(n) for n in names] for t in kept]
    draws = np.concatenate([t.marginal.draws[:, at] for t, at in zip(kept, columns, strict=True)])
    weight = np.concatenate([t.probability * np.exp(t.marginal.log_weight) for t in kept])
    return names, draws, weight / weight.sum()


def weighted_quantiles(x: Array, weight: Array, p: Array) -> Array:
    """Quantiles p of draws (d,) with weights (d,), linear between the draws."""
    order = np.argsort(x, kind="stable")
    cumulative = np.cumsum(weight[order]) - 0.5 * weight[order]
    return np.interp(p, cumulative / weight.sum(), x[order])
