"""Every hypothesis weighed against the data: marginal likelihoods and probabilities."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from cpam_bayes.deadline import cut_short, is_time_up
from cpam_bayes.diagnosis.evidence.pairs import add_pairs
from cpam_bayes.diagnosis.evidence.sampled import sampled_near_the_best
from cpam_bayes.diagnosis.evidence.scan import Scan, Trial, is_repairing, marginal_of
from cpam_bayes.diagnosis.evidence.tested import Tested, prior_of, ranked
from cpam_bayes.diagnosis.fitting import SCATTER, PlateCase
from cpam_bayes.diagnosis.hypotheses import NONE, PAIR, Hypothesis, prior_by_cause

__all__ = ["Tested", "Weighed", "marginal_of", "weigh"]

Array = NDArray[Any]

# Log Bayes factor of a pair over the better one of its causes, from which it is a hypothesis of its own.
PAIR_GAIN = 3.0
# Rounds in which hypotheses that come near the best one are sampled.
_SAMPLING_ROUNDS = 3


@dataclass(frozen=True, slots=True)
class Weighed:
    """All hypotheses, the most probable first, and what could not be tested.

    prior : prior probability of every cause, of pairings that explain nothing too
    is_cut_short : whether time was up before all were tested, so that probabilities are of a part of them
    """

    tested: tuple[Tested, ...]
    not_tested: tuple[str, ...]
    prior: Mapping[str, float] = field(default_factory=dict)
    is_cut_short: bool = False

    @property
    def none(self) -> Tested:
        """The plain model, with its most probable pairing."""
        return next(t for t in self.tested if t.hypothesis.cause == NONE)

    @property
    def plain(self) -> tuple[tuple[Tested, float], ...]:
        """The plain model with all its pairings and their fractions."""
        variants = [t for t in self.tested if t.hypothesis.cause == NONE]
        total = sum(t.probability for t in variants)
        if not total > 0.0:
            return ((variants[0], 1.0),)
        return tuple((t, t.probability / total) for t in variants)

    def in_plain_pairing(self) -> Weighed:
        """Every hypothesis once, with the pairing of incomplete lists that the plain model has."""
        if not self.none.cases:
            return self
        first: dict[tuple[str, str, tuple[int, ...]], Tested] = {}
        for t in self.tested:
            if t.key not in first or (first[t.key].shift is None and t.shift is not None):
                first[t.key] = t
        tested = tuple(
            replace(t, marginal=replace(t.marginal, comparison=t.as_plain or t.marginal.comparison))
            for t in first.values()
        )
        return replace(self, tested=tested)

    def by_cause(self) -> dict[str, float]:
        """Probability of every cause, its variants summed, the most probable first."""
        probability: dict[str, float] = defaultdict(float)
        for t in self.tested:
            probability[t.hypothesis.cause] += t.probability
        return dict(sorted(probability.items(), key=lambda item: -item[1]))

    def log_bayes_factor(self, causes: Collection[str]) -> float:
        """Of causes against none, all variants averaged over their priors and pairings summed."""
        variants = [t for t in self.tested if t.hypothesis.cause in causes]
        prior = np.array([t.hypothesis.prior for t in variants])
        whole = sum(self.prior.get(cause, 0.0) for cause in {t.hypothesis.cause for t in variants})
        whole = max(whole, prior_of(variants))
        return float(logsumexp([t.log_bayes_factor for t in variants], b=prior / whole))

    def best_of(self, cause: str) -> Tested:
        """The most probable variant of a cause."""
        return next(t for t in self.tested if t.hypothesis.cause == cause)


def weigh(
    cases: Sequence[PlateCase],
    hypotheses: Sequence[tuple[Hypothesis, tuple[int, ...]]],
    *,
    scatter: float = SCATTER,
    pairs: bool = True,
    executor: Executor | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Weighed:
    """Marginal likelihoods of hypotheses, each about some of the plates, none first, and of pairs.

    Where none is not the most probable of all, the best pairs of causes are tested too.

    executor : where hypotheses are fitted, ``None`` for this process
    """
    scan = Scan(cases, scatter, executor)
    scan.begin(*hypotheses[0])
    total = len(hypotheses)
    on_list = [entry for entry in hypotheses[1:] if is_repairing(entry[0])]
    on_plate = [Trial(h, plates) for h, plates in hypotheses[1:] if not is_repairing(h)]
    scan.test_pairings(on_list)
    scan.test(on_plate, lambda done: progress(done, total))
    if pairs and ranked(scan.tested)[0].hypothesis.cause != NONE:
        if is_time_up():
            scan.is_cut_short = True
            cut_short("no two causes were tested together")
        else:
            add_pairs(scan, hypotheses)
    progress(total, total)
    order = ranked(scan.tested)
    for _ in range(_SAMPLING_ROUNDS):  # sampling may move the best one
        if is_time_up():
            cut_short("the evidence of the leading causes is approximate")
            break
        sampled = sampled_near_the_best(order, cases, executor)
        if sampled is None:
            break
        order = ranked(sampled)
    log_none = float(logsumexp([t.marginal.log_evidence for t in order if t.hypothesis.cause == NONE]))
    log_weight = np.array([t.log_weight for t in order])
    probability = np.exp(log_weight - log_weight.max())
    probability /= probability.sum()
    tested = [
        replace(t, probability=float(p), log_bayes_factor=t.marginal.log_evidence - log_none)
        for t, p in zip(order, probability, strict=True)
    ]
    prior = prior_by_cause([h for h, _ in hypotheses])
    not_tested = tuple(dict.fromkeys(scan.not_tested))
    return Weighed(_credited(tested), not_tested, prior, scan.is_cut_short)


def _credited(tested: Sequence[Tested]) -> tuple[Tested, ...]:
    """Without the pairs that show one cause only; what they weigh counts for that cause.

    Any cause may act unseen beside the one that a list shows. Such pairs are as good as that cause alone,
    and together they hold a share of its probability that no data take away from them. A pair is one
    hypothesis more where its evidence is e^3 times that of the better one of its causes.
    """
    kept = {i: t.probability for i, t in enumerate(tested)}
    evidence: dict[tuple[str, str, tuple[int, ...]], float] = {}
    for t in tested:
        evidence[t.key] = float(np.logaddexp(evidence.get(t.key, -np.inf), t.log_bayes_factor))
    for i, t in enumerate(tested):
        if t.hypothesis.family == PAIR:
            alone = [j for j, s in enumerate(tested) if s.hypothesis.cause in t.hypothesis.causes]
            best = max(alone, key=lambda j: evidence[tested[j].key])
            if evidence[t.key] - evidence[tested[best].key] < PAIR_GAIN:
                kept[best] += kept.pop(i)
    order = sorted(kept, key=lambda i: -kept[i])
    return tuple(replace(tested[i], probability=kept[i]) for i in order)
