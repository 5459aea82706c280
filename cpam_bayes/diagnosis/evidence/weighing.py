"""Every hypothesis weighed against the data: marginal likelihoods and probabilities."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from cpam_bayes.diagnosis.evidence.pair_screening import ranked_pairs
from cpam_bayes.diagnosis.evidence.scan import Scan, Tested, marginal_of, ranked
from cpam_bayes.diagnosis.fitting import SCATTER, PlateCase
from cpam_bayes.diagnosis.hypotheses import (
    NONE,
    OTHER,
    PAIR,
    Hypothesis,
    go_together,
    pair_scale,
    paired,
)
from cpam_bayes.effects import ListChange

__all__ = ["Tested", "Weighed", "marginal_of", "weigh"]

Array = NDArray[Any]

# Pairs that are screened by themselves, of all that are ranked, and of these the most that are optimised.
_PAIRS, _PAIRS_REFINED = 16, 6
# Log Bayes factor of a pair over the better one of its causes, from which it is a hypothesis of its own.
PAIR_GAIN = 3.0
# Leading causes of the list that pair with as many other causes.
_LISTS, _SECOND = 2, 8


@dataclass(frozen=True, slots=True)
class Weighed:
    """All hypotheses, the most probable first, and what could not be tested."""

    tested: tuple[Tested, ...]
    not_tested: tuple[str, ...]

    @property
    def none(self) -> Tested:
        """The plain model."""
        return next(t for t in self.tested if t.hypothesis.cause == NONE)

    def by_cause(self) -> dict[str, float]:
        """Probability of every cause, its variants summed, the most probable first."""
        probability: dict[str, float] = defaultdict(float)
        for t in self.tested:
            probability[t.hypothesis.cause] += t.probability
        return dict(sorted(probability.items(), key=lambda item: -item[1]))

    def log_bayes_factor(self, causes: Collection[str]) -> float:
        """Of causes against none, all their variants averaged over their priors."""
        variants = [t for t in self.tested if t.hypothesis.cause in causes]
        prior = np.array([t.hypothesis.prior for t in variants])
        return float(logsumexp([t.log_bayes_factor for t in variants], b=prior / prior.sum()))

    def best_of(self, cause: str) -> Tested:
        """The most probable variant of a cause."""
        return next(t for t in self.tested if t.hypothesis.cause == cause)


def weigh(
    cases: Sequence[PlateCase],
    hypotheses: Sequence[tuple[Hypothesis, tuple[int, ...]]],
    *,
    scatter: float = SCATTER,
    pairs: bool = True,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Weighed:
    """Marginal likelihoods of hypotheses, each about some of the plates, none first, and of pairs.

    Where none is not the most probable of all, pairs of causes are ranked by screening and the best of
    them tested too.
    """
    scan = Scan(cases, scatter)
    scan.begin(*hypotheses[0])
    total = len(hypotheses)
    screened: list[Tested] = []
    for i, (hypothesis, plates) in enumerate(hypotheses[1:]):
        screened += scan.screen(hypothesis, plates)
        progress(i + 1, total)
    screened = scan.corrected(screened)
    scan.refine(screened)
    if pairs and ranked(scan.tested)[0].hypothesis.cause != NONE:
        scan.refine(_pairs(scan, screened, [h for h, _ in hypotheses]), _PAIRS_REFINED)
    progress(total, total)
    order = ranked(scan.tested)
    best = order[0].log_weight
    order = ranked([scan.sampled(t, best) for t in order])
    log_none = next(t for t in order if t.hypothesis.cause == NONE).marginal.log_evidence
    log_weight = np.array([t.log_weight for t in order])
    share = np.exp(log_weight - log_weight.max())
    share /= share.sum()
    tested = [
        replace(t, probability=float(p), log_bayes_factor=t.marginal.log_evidence - log_none)
        for t, p in zip(order, share, strict=True)
    ]
    return Weighed(_credited(tested), tuple(dict.fromkeys(scan.not_tested)))


def _credited(tested: Sequence[Tested]) -> tuple[Tested, ...]:
    """Without the pairs that show one cause only; what they weigh counts for that cause.

    Any cause may act unseen beside the one that a list shows. Such pairs are as good as that cause alone,
    and together they hold a share of its probability that no data take away from them. A pair is one
    hypothesis more where its evidence is e^3 times that of the better one of its causes.
    """
    kept = {i: t.probability for i, t in enumerate(tested)}
    for i, t in enumerate(tested):
        if t.hypothesis.family == PAIR:
            alone = [j for j, s in enumerate(tested) if s.hypothesis.cause in t.hypothesis.causes]
            best = max(alone, key=lambda j: tested[j].log_bayes_factor)
            if t.log_bayes_factor - tested[best].log_bayes_factor < PAIR_GAIN:
                kept[best] += kept.pop(i)
    order = sorted(kept, key=lambda i: -kept[i])
    return tuple(replace(tested[i], probability=kept[i]) for i in order)


def _pairs(scan: Scan, screened: Sequence[Tested], singles: Sequence[Hypothesis]) -> list[Tested]:
    """The best pairs of causes of the same plates, by screening."""
    scale = pair_scale(singles)
    lists, _ = scan.linear_none()
    pairs: list[Tested] = []
    usable = [t for t in screened if t.shift is not None]
    # the size of the first is gone through node by node: one that may have two signs comes first
    usable.sort(key=lambda t: not any(e.even for e in t.hypothesis.effects))
    for plates in dict.fromkeys(t.plates for t in usable):
        alike = [t for t in usable if t.plates == plates]
        prior = np.log([t.hypothesis.prior for t in alike])
        fit = np.array([[go_together(a.hypothesis, b.hypothesis) for b in alike] for a in alike], dtype=bool)
        log_prior = np.where(fit, prior[:, None] + prior, -np.inf)
        tables = [t.shift for t in alike if t.shift is not None]
        for i, j in ranked_pairs(lists, tables, log_prior, _PAIRS):
            pair = paired(alike[i].hypothesis, alike[j].hypothesis, scale)
            pairs.append(scan.screen_pair(pair, alike[i], alike[j], lists))
    return pairs + _with_list(scan, scale)


def _with_list(scan: Scan, scale: float) -> list[Tested]:
    """Leading causes that give frequencies to other modes, with the best variants of other causes."""
    best: dict[str, Tested] = {}
    for t in ranked(scan.tested):
        if t.hypothesis.cause not in (NONE, OTHER):
            best.setdefault(t.hypothesis.cause, t)
    order = list(best.values())
    leading = [t for t in order[:_LISTS] if t.hypothesis.listed != ListChange() and t.shift is None]
    pairs: list[Tested] = []
    for first in leading:
        with_it = [t for t in order if t.plates == first.plates]
        others = [t for t in with_it if go_together(first.hypothesis, t.hypothesis)]
        for second in others[:_SECOND]:
            pairs += scan.screen(paired(first.hypothesis, second.hypothesis, scale), first.plates)
    return scan.corrected(pairs)
