"""Every hypothesis weighed against the data: marginal likelihoods and probabilities."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.diagnosis.comparison import Comparison
from cpam_bayes.diagnosis.fitting import SCATTER, PlateCase, comparison_of, effect_columns
from cpam_bayes.diagnosis.hypotheses import NONE, OTHER, PAIR, Hypothesis, ListChange, pairs_of
from cpam_bayes.diagnosis.marginal import Marginal, laplace_marginal, sampled_marginal
from cpam_bayes.diagnosis.screening import screened_log_evidence
from cpam_bayes.diagnosis.tangent import tangents
from cpam_bayes.modes import RigidBodyError
from cpam_bayes.posterior import ForwardModel

Array = NDArray[Any]

# Starts of the climbs of "none" besides the prior means.
_STARTS = 6
# Hypotheses so many nats below the most probable one are not refined, and those within the second number
# are computed by importance sampling.
_HOPELESS, _LEADING = 12.0, 7.0
# Variants of a cause, but for its best one, that lie so far below at the first look are dropped.
_SCREENED = 10.0
# Pairs are made of so many leading causes and as many others.
_FIRST, _SECOND = 3, 10


@dataclass(frozen=True, slots=True)
class Tested:
    """One hypothesis with its marginal likelihood.

    plates : numbers of the plates that have it; all of them where they share it. probability : among all
    that were tested. log_bayes_factor : against none.
    """

    hypothesis: Hypothesis
    plates: tuple[int, ...]
    marginal: Marginal
    probability: float = 0.0
    log_bayes_factor: float = 0.0

    @property
    def columns(self) -> tuple[int, ...]:
        """Columns of the effect's parameters."""
        return effect_columns(self.marginal.comparison, self.hypothesis)


@dataclass(frozen=True, slots=True)
class Screened:
    """A hypothesis that the first look found hopeless, with its approximate log evidence."""

    hypothesis: Hypothesis
    plates: tuple[int, ...]
    log_evidence: float
    probability: float = 0.0
    log_bayes_factor: float = 0.0


@dataclass(frozen=True, slots=True)
class Weighed:
    """All hypotheses, the most probable first; those dropped at the first look; what could not be tested."""

    tested: tuple[Tested, ...]
    screened: tuple[Screened, ...]
    not_tested: tuple[str, ...]

    @property
    def every(self) -> tuple[Tested | Screened, ...]:
        """All hypotheses that were tested or dropped."""
        return (*self.tested, *self.screened)

    @property
    def none(self) -> Tested:
        """The plain model."""
        return next(t for t in self.tested if t.hypothesis.cause == NONE)

    def by_cause(self) -> dict[str, float]:
        """Probability of every cause, its variants summed, the most probable first."""
        found: dict[str, float] = defaultdict(float)
        for t in self.every:
            found[t.hypothesis.cause] += t.probability
        return dict(sorted(found.items(), key=lambda item: -item[1]))

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

    Where none is less probable than all others together, pairs of the leading causes with the best of the
    others are tested too.
    """
    found: list[Tested] = []
    not_tested: list[str] = []
    scan = _Scan(cases, scatter, found, not_tested)
    scan.test(*hypotheses[0])
    screened = []
    for i, (hypothesis, plates) in enumerate(hypotheses[1:]):
        one = scan.screen(hypothesis, plates)
        if one is not None:
            screened.append(one)
        progress(i + 1, 2 * len(hypotheses))
    screened.sort(key=_log_weight, reverse=True)
    seen: set[str] = set()
    dropped = []
    for i, one in enumerate(screened):
        if one.hypothesis.cause in seen and scan.is_hopeless(one):
            dropped.append(one)
        else:
            scan.test(one.hypothesis, one.plates)
            seen.add(one.hypothesis.cause)
        progress(len(hypotheses) + i + 2, 2 * len(hypotheses))
    ranked = _ranked(found)
    if pairs and ranked[0].hypothesis.cause != NONE:
        further = _pairs(ranked, [h for h, _ in hypotheses])
        for i, (hypothesis, plates) in enumerate(further):
            scan.test(hypothesis, plates)
            progress(2 * len(hypotheses) + i + 1, 2 * len(hypotheses) + len(further))
        ranked = _ranked(found)
    best = _log_weight(ranked[0])
    ranked = [
        replace(t, marginal=sampled_marginal(scan.exact(t)))
        if _log_weight(t) > best - _LEADING or t.hypothesis.cause == NONE
        else t
        for t in ranked
    ]
    ranked = _ranked(ranked)
    log_none = next(t for t in ranked if t.hypothesis.cause == NONE).marginal.log_evidence
    every: list[Tested | Screened] = [*ranked, *dropped]
    log_weight = np.array([_log_weight(t) for t in every])
    share = np.exp(log_weight - log_weight.max())
    share /= share.sum()
    return Weighed(
        tuple(
            replace(t, probability=float(p), log_bayes_factor=t.marginal.log_evidence - log_none)
            for t, p in zip(ranked, share, strict=False)
        ),
        tuple(
            replace(t, probability=float(p), log_bayes_factor=t.log_evidence - log_none)
            for t, p in zip(dropped, share[len(ranked) :], strict=True)
        ),
        tuple(dict.fromkeys(not_tested)),
    )


def marginal_of(
    cases: Sequence[PlateCase],
    hypothesis: Hypothesis,
    plates: tuple[int, ...],
    *,
    scatter: float = SCATTER,
    none: Marginal | None = None,
    floor: float = -np.inf,
    left_out: int | None = None,
    stand_ins: Mapping[int, ForwardModel] | None = None,
) -> Marginal:
    """Marginal likelihood of one hypothesis about some plates.

    left_out : a frequency to leave out. stand_ins : models of the plates that the hypothesis is not about.
    """
    comparison = comparison_of(cases, _about(cases, hypothesis, plates), scatter=scatter, stand_ins=stand_ins)
    if left_out is not None:
        comparison = replace(comparison, listed=comparison.listed.without(left_out), left_out=left_out)
    columns = effect_columns(comparison, hypothesis)
    quadrature = columns[0] if columns else None
    return laplace_marginal(comparison, quadrature, _starts(comparison, hypothesis, none), floor=floor)


@dataclass(slots=True)
class _Scan:
    """Hypotheses as they are tested, none first."""

    cases: Sequence[PlateCase]
    scatter: float
    found: list[Tested]
    not_tested: list[str]
    stand_ins: Mapping[int, ForwardModel] | None = None

    @property
    def none(self) -> Marginal | None:
        """The plain model, once it is there."""
        return self.found[0].marginal if self.found else None

    @property
    def best(self) -> float:
        """Largest log of prior times evidence so far."""
        return max((_log_weight(t) for t in self.found), default=-np.inf)

    def is_hopeless(self, screened: Screened) -> bool:
        """Whether the first look leaves a hypothesis no chance."""
        return _log_weight(screened) < self.best - _SCREENED

    def screen(self, hypothesis: Hypothesis, plates: tuple[int, ...]) -> Screened | None:
        """A first look at a hypothesis; ``None`` where it cannot be tested, which is noted."""
        none = self.none
        assert none is not None
        try:
            comparison = comparison_of(
                self.cases,
                _about(self.cases, hypothesis, plates),
                scatter=self.scatter,
                stand_ins=self.stand_ins,
            )
            if comparison.discrepancy is not None:  # scatters all frequencies: nothing to be linear in
                return Screened(hypothesis, plates, np.inf)
            columns = effect_columns(comparison, hypothesis)
            start = _starts(comparison, hypothesis, none)[0]
            value = screened_log_evidence(comparison, columns[0] if columns else None, start)
        except RigidBodyError:
            self._note(hypothesis)
            return None
        return Screened(hypothesis, plates, value)

    def test(self, hypothesis: Hypothesis, plates: tuple[int, ...]) -> None:
        """Add a hypothesis, or say why it cannot be tested."""
        none = self.none
        floor = self.best - np.log(hypothesis.prior) - _HOPELESS
        try:
            marginal = marginal_of(
                self.cases,
                hypothesis,
                plates,
                scatter=self.scatter,
                none=none,
                floor=floor,
                stand_ins=self.stand_ins,
            )
        except RigidBodyError:
            self._note(hypothesis)
            return
        self.found.append(Tested(hypothesis, plates, marginal))
        if none is None and len(self.cases) > 1:
            self.stand_ins = tangents(self.cases, marginal)

    def _note(self, hypothesis: Hypothesis) -> None:
        self.not_tested.append(
            f"{hypothesis.cause} {hypothesis.variant}".rstrip()
            + ": over its prior the plate cannot be told from a rigid body; left out"
        )

    def exact(self, tested: Tested) -> Marginal:
        """The picture of a hypothesis over the models of all plates, without stand-ins."""
        if self.stand_ins is None or len(tested.plates) == len(self.cases):
            return tested.marginal
        about = _about(self.cases, tested.hypothesis, tested.plates)
        return replace(tested.marginal, comparison=comparison_of(self.cases, about, scatter=self.scatter))


def _about(
    cases: Sequence[PlateCase], hypothesis: Hypothesis, plates: tuple[int, ...]
) -> Hypothesis | dict[int, Hypothesis]:
    return hypothesis if len(plates) == len(cases) else dict.fromkeys(plates, hypothesis)


def _starts(comparison: Comparison, hypothesis: Hypothesis, none: Marginal | None) -> Array:
    """Scores that climbs begin from: the optimum of none, and prior means where it may be far."""
    n = comparison.parameters.size
    if none is None:
        rng = np.random.default_rng(0)
        return np.concatenate((np.zeros((1, n)), rng.standard_normal((_STARTS, n))))
    at = dict(zip(none.comparison.parameters.names, none.z[int(np.argmax(none.weight))], strict=True))
    start = np.array([at.get(name, 0.0) for name in comparison.parameters.names])
    far = hypothesis.is_gross or hypothesis.listed != ListChange() or hypothesis.family == PAIR
    return np.stack((start, np.zeros(n))) if far else start[None]


def _pairs(
    ranked: Sequence[Tested], singles: Sequence[Hypothesis]
) -> list[tuple[Hypothesis, tuple[int, ...]]]:
    """Pairs of the leading causes with the best variants of the others, on the leading one's plates."""
    best: dict[str, Tested] = {}
    for t in ranked:
        if t.hypothesis.cause not in (NONE, OTHER):
            best.setdefault(t.hypothesis.cause, t)
    order = list(best.values())
    found: dict[tuple[str, ...], tuple[Hypothesis, tuple[int, ...]]] = {}
    for i, first in enumerate(order[:_FIRST]):
        for second in order[i + 1 : i + 1 + _SECOND]:
            if second.plates != first.plates:
                continue
            for pair in pairs_of((first.hypothesis, second.hypothesis), singles):
                found.setdefault(tuple(sorted(pair.causes)), (pair, first.plates))
    return list(found.values())


def _log_weight(t: Tested | Screened) -> float:
    log_evidence = t.log_evidence if isinstance(t, Screened) else t.marginal.log_evidence
    return float(np.log(t.hypothesis.prior) + log_evidence)


def _ranked(found: Sequence[Tested]) -> list[Tested]:
    return sorted(found, key=_log_weight, reverse=True)
