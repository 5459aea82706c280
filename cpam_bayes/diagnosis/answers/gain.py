"""What a claimed cause is worth: residuals, evidence, predictions of frequencies left out."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from cpam_bayes.diagnosis.claim import Claim
from cpam_bayes.diagnosis.composed import ComposedModel
from cpam_bayes.diagnosis.evidence.comparison import Comparison
from cpam_bayes.diagnosis.evidence.marginal import Marginal
from cpam_bayes.diagnosis.evidence.sampled import about_draws, sampled_marginal
from cpam_bayes.diagnosis.evidence.scan import marginal_of
from cpam_bayes.diagnosis.evidence.sharing import shared_out
from cpam_bayes.diagnosis.evidence.tested import Tested
from cpam_bayes.diagnosis.evidence.weighing import Weighed
from cpam_bayes.diagnosis.fit import Fit
from cpam_bayes.diagnosis.fitting import PlateCase
from cpam_bayes.diagnosis.hypotheses import NONE, OTHER, Hypothesis
from cpam_bayes.effects.frequency_list import MISREADING
from cpam_bayes.inference.importance import RELIABLE_K, effective_size, pareto_shape

Array = NDArray[Any]

# Hypotheses among which the cause is selected again in every fold: those with this probability, the plain
# model, and so many at most.
_LEAST_PROBABILITY, _MOST = 0.01, 6
# Pairings of the plain model with at least this fraction of its evidence, and so many at most.
_LEAST_FRACTION, _MOST_PLAIN = 0.05, 3
# Error of a log evidence that the draws with all frequencies may have without one of them: this or so many
# times their own, up to a bound. How much heavier than theirs the tail of the weights may be, or than what is
# reliable.
_SMALL_ERROR, _OWN_ERRORS, _LARGEST_ERROR, _HEAVIER_TAIL = 0.1, 2.0, 0.3, 0.25
# Optima of the whole list that the fits of every fold start from.
_STARTS = 3


@dataclass(frozen=True, slots=True)
class Gain:
    """What the claimed cause is worth.

    log_bayes_factor : of the claimed causes, their variants averaged over their priors
    held_out : (n_f,) log predictive density of each frequency from all others, of the hypotheses near the
        top, whose probabilities are those without that frequency, less that of the plain model
    n_hypotheses : among which the cause is selected in every fold
    stable : fraction of the frequencies without which the claimed causes still are ahead of none and of the
        best outsider
    """

    rms_before: float
    rms_after: float
    log_bayes_factor: float
    held_out: Array
    n_hypotheses: int
    stable: float

    @property
    def held_out_difference(self) -> float:
        """Sum of the differences."""
        return float(self.held_out.sum())

    @property
    def held_out_se(self) -> float:
        """Standard error of the sum, from the scatter of the differences."""
        n = len(self.held_out)
        return float(np.sqrt(n) * self.held_out.std(ddof=1)) if n > 1 else float("nan")


def gain_of(
    cases: Sequence[PlateCase],
    weighed: Weighed,
    claim: Claim,
    members: Sequence[tuple[Tested, float]],
    baseline: Fit,
    extended: Fit,
    scatter: float,
    executor: Executor | None = None,
) -> Gain:
    """The gain of the claimed causes, ``members`` with their fractions, over the plain model.

    The held-out score of frequency i is ln p(f_i | f_-i) = ln Z(f) - ln Z(f_-i) with Z = sum_h p(h) Z_h over
    the hypotheses near the top: the cause is selected anew, by its probability, in every fold.
    """
    n = len(baseline.measured)
    extending = {t.hypothesis.cause for t, _ in members} - {NONE} or {OTHER}
    claimed = extending | set(claim.causes)
    none = weighed.none.marginal
    top = shared_out(_sampled, cases, _near_the_top(weighed, claimed), executor)
    whole = np.array([t.marginal.log_evidence for t in top])
    items = [(tuple(cases), t, n, None if t is top[0] else none, scatter) for t in top]
    folds = np.stack(shared_out(_folds_of, cases, items, executor))
    is_plain = np.array([t.hypothesis.cause == NONE for t in top])
    log_prior = np.log([t.hypothesis.prior for t in top])
    weight = folds + log_prior[:, None]
    mixture = logsumexp(whole + log_prior) - logsumexp(weight, axis=0)
    is_claimed = np.array([t.hypothesis.cause in claimed for t in top])
    outside = {t.key for t, inside in zip(top, is_claimed, strict=True) if not inside}
    best_outside = np.max([logsumexp(weight[[t.key == key for t in top]], axis=0) for key in outside], axis=0)
    ahead = logsumexp(weight[is_claimed], axis=0) > best_outside
    return Gain(
        baseline.rms,
        extended.rms,
        weighed.log_bayes_factor(extending),
        mixture - (logsumexp(whole[is_plain]) - logsumexp(folds[is_plain], axis=0)),
        len({t.key for t in top}),
        float(np.mean(ahead)),
    )


def left_out(cases: Sequence[PlateCase], t: Tested, n: int, none: Marginal | None, scatter: float) -> Array:
    """Log evidences of a hypothesis without each of the frequencies in turn, (n,).

    Without the frequency that it takes as misread, what is left of the list is free of that error, over
    whose size the density of the frequency integrates to one. A false peak has a density of its own, apart
    from the modes: without it the other frequencies keep theirs.
    """
    cases = t.cases or cases
    evidences = np.empty(n)
    listed = t.hypothesis.listed
    # the posterior without a frequency is about that with it
    about = about_draws(t.marginal)
    near, reweighted = about.model, _reweighted(t.marginal, about)
    paired = np.concatenate([case.modes >= 0 for case in cases])
    last = np.concatenate([np.full(c.measurement.size, c.measurement.frequencies[-1]) for c in cases])
    before = sum(case.measurement.size for case in cases[: t.plates[0]])  # frequencies of other plates
    for i in range(n):
        if not paired[i]:
            evidences[i] = t.marginal.log_evidence + np.log(last[i])
            continue
        at, hypothesis, known = int(paired[:i].sum()), t.hypothesis, t.marginal.z[:_STARTS]
        model: ComposedModel | None = near
        if listed.misread is not None and i == before + listed.misread:
            hypothesis, model = _without_misreading(hypothesis), None
            parts = t.marginal.comparison.model.parts
            column = next(part.misread[1] for part in parts if part.misread is not None)
            known = np.delete(known, column, axis=1)
        if listed.spurious is not None:
            if i == before + listed.spurious:
                evidences[i] = t.marginal.log_evidence - t.marginal.comparison.listed.log_constant
                continue
            at -= i > before + listed.spurious
        if hypothesis is t.hypothesis and np.isfinite(reweighted[at]):
            evidences[i] = reweighted[at]
            continue
        marginal = marginal_of(
            cases,
            hypothesis,
            t.plates,
            scatter=scatter,
            none=none,
            left_out=at,
            model=model,
            known=known,
            log2_draws=0,
        )
        evidences[i] = sampled_marginal(marginal).log_evidence
    return evidences


def _reweighted(marginal: Marginal, about: Comparison) -> Array:
    """Log evidences without each of the frequencies from the draws with all, (n_f,).

    ln Z_-i = ln Z + ln E[1 / p(f_i | f_-i, x)] over the posterior of x (Gelfand, Dey and Chang, Bayesian
    Statistics 4, 1992). Not a number where the weights' tail is too heavy (Vehtari, Gelman and Gabry, Stat.
    Comput. 27, 2017) or their error too large, unless those of the draws are hardly better: what a frequency
    says alone is for a sample of its own.
    """
    evidences = np.full(len(about.listed.frequencies), np.nan)
    if not marginal.is_sampled or not np.isfinite(marginal.k_hat):
        return evidences
    log_weight = marginal.log_weight[:, None] - about.log_conditional(marginal.draws)
    most_error = max(_SMALL_ERROR, min(_OWN_ERRORS * marginal.error, _LARGEST_ERROR))
    most_k = max(RELIABLE_K, marginal.k_hat + _HEAVIER_TAIL)
    for i in np.flatnonzero(~np.isnan(log_weight).any(axis=0)):
        own = log_weight[:, i]
        error = np.sqrt(1.0 / effective_size(own) - 1.0 / len(own))
        if pareto_shape(own) < most_k and error < most_error:
            evidences[i] = marginal.log_evidence + logsumexp(own)
    return evidences


def _folds_of(item: tuple[Sequence[PlateCase], Tested, int, Marginal | None, float]) -> Array:
    return left_out(*item)


def _near_the_top(weighed: Weighed, claimed: set[str]) -> list[Tested]:
    """None, and the most probable others: at least one that is claimed and one that is not."""
    plain = [t for t, fraction in weighed.plain if t is weighed.none or fraction >= _LEAST_FRACTION]
    others = [t for t in weighed.tested if t.hypothesis.cause != NONE]
    kept = [t for t in others if t.probability >= _LEAST_PROBABILITY][: _MOST - 1]
    for is_claimed in (True, False):
        if not any((t.hypothesis.cause in claimed) == is_claimed for t in kept):
            kept += [t for t in others if (t.hypothesis.cause in claimed) == is_claimed][:1]
    return [*plain[:_MOST_PLAIN], *kept]


def _sampled(t: Tested) -> Tested:
    """A hypothesis with the evidence of the whole list by the same means as without a frequency."""
    return t if t.marginal.is_sampled else replace(t, marginal=sampled_marginal(t.marginal))


def _without_misreading(hypothesis: Hypothesis) -> Hypothesis:
    return replace(
        hypothesis,
        listed=replace(hypothesis.listed, misread=None),
        parameters=tuple(p for p in hypothesis.parameters if p.name != MISREADING.name),
    )
