"""Evidences and probabilities of all hypotheses, sets of causes included."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import logsumexp

from cpam_bayes.diagnosis.comparison import SCATTER, PlateCase
from cpam_bayes.diagnosis.evidence.marginal import Tested, prior_of, ranked
from cpam_bayes.diagnosis.evidence.sampled import sampled_near_the_best
from cpam_bayes.diagnosis.evidence.scan import Scan, Trial, is_repairing, marginal_of
from cpam_bayes.diagnosis.evidence.sets import add_sets
from cpam_bayes.diagnosis.hypotheses import NONE, Hypothesis, prior_by_cause
from cpam_bayes.running import cut_short, is_time_up

__all__ = ["Tested", "Weighed", "marginal_of", "weigh"]

# Rounds in which hypotheses that come near the best one are sampled.
_SAMPLING_ROUNDS = 3


@dataclass(frozen=True, slots=True)
class Weighed:
    """All hypotheses, the most probable first, and what could not be tested.

    prior : prior probability of every cause, pairings that explain nothing included
    is_cut_short : whether time was up before all were tested, so that probabilities cover a part of them
    unaccounted : probability of sets of causes that were not fitted
    """

    tested: tuple[Tested, ...]
    not_tested: tuple[str, ...]
    prior: Mapping[str, float] = field(default_factory=dict)
    is_cut_short: bool = False
    unaccounted: float = 0.0

    @property
    def none(self) -> Tested:
        """The plain model, with its most probable pairing."""
        return next(t for t in self.tested if t.hypothesis.cause == NONE)

    @property
    def plain(self) -> tuple[tuple[Tested, float], ...]:
        """The plain model with all its pairings and their fractions."""
        return self.variants_of(NONE)

    def variants_of(self, cause: str) -> tuple[tuple[Tested, float], ...]:
        """The variants of a cause and their fractions of its probability."""
        variants = [t for t in self.tested if t.hypothesis.cause == cause]
        total = sum(t.probability for t in variants)
        if not total > 0.0:
            return ((variants[0], 1.0),)
        return tuple((t, t.probability / total) for t in variants)

    def in_plain_pairing(self) -> Weighed:
        """Every hypothesis once, with the plain model's pairing of incomplete lists."""
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
        """Log Bayes factor of causes against none, variants averaged over their priors, pairings summed."""
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
    sets: bool = True,
    executor: Executor | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
    so_far: Callable[[Mapping[str, float]], None] = lambda shares: None,
) -> Weighed:
    """Weigh hypotheses, each about some of the plates, none first, and sets of them.

    Where none is not the most probable of all, the best sets of causes are tested too.

    executor : where hypotheses are fitted, ``None`` for this process
    so_far : called with the shares of the causes among the hypotheses tested so far
    """
    scan = Scan(cases, scatter, executor)

    def tell(done: int) -> None:
        progress(done, total)
        so_far(Weighed(tuple(_with_shares(ranked(scan.tested))), ()).by_cause())

    scan.begin(*hypotheses[0])
    total = len(hypotheses)
    on_list = [entry for entry in hypotheses[1:] if is_repairing(entry[0])]
    on_plate = [Trial(h, plates) for h, plates in hypotheses[1:] if not is_repairing(h)]
    scan.test_pairings(on_list)
    scan.test(on_plate, tell)
    tell(len(on_plate))
    unaccounted = 0.0
    if sets and ranked(scan.tested)[0].hypothesis.cause != NONE:
        if is_time_up():
            scan.is_cut_short = True
            cut_short("cut_sets")
        else:
            unaccounted = add_sets(scan, hypotheses)
    if is_time_up():
        scan.is_cut_short = True
        cut_short("cut_leftovers")
    else:
        scan.test_leftovers()
    progress(total, total)
    order = ranked(scan.tested)
    for _ in range(_SAMPLING_ROUNDS):  # sampling may move the best one
        if is_time_up():
            cut_short("cut_evidences")
            break
        sampled = sampled_near_the_best(order, cases, executor)
        if sampled is None:
            break
        order = ranked(sampled)
    prior = prior_by_cause([h for h, _ in hypotheses])
    not_tested = tuple(dict.fromkeys(scan.not_tested))
    return Weighed(with_factors(order), not_tested, prior, scan.is_cut_short, unaccounted)


def with_factors(order: Sequence[Tested]) -> tuple[Tested, ...]:
    """Hypotheses, the best first, with their probabilities and log Bayes factors against none."""
    log_none = float(logsumexp([t.marginal.log_evidence for t in order if t.hypothesis.cause == NONE]))
    return tuple(replace(t, log_bayes_factor=t.marginal.log_evidence - log_none) for t in _with_shares(order))


def _with_shares(order: Sequence[Tested]) -> list[Tested]:
    """Hypotheses, the best first, with the share of each in prior times evidence as its probability."""
    share = np.exp(np.array([t.log_weight for t in order]) - order[0].log_weight)
    share /= share.sum()
    return [replace(t, probability=float(p)) for t, p in zip(order, share, strict=True)]
