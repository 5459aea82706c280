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
from cpam_bayes.diagnosis.screening import screened_marginal
from cpam_bayes.diagnosis.tangent import tangents
from cpam_bayes.modes import RigidBodyError
from cpam_bayes.posterior import ForwardModel

Array = NDArray[Any]

# Starts of the climbs of "none" besides the prior means.
_STARTS = 6
# Hypotheses within so many nats of the most probable one are climbed and sampled, the others keep what the
# first look says of them.
_NEAR = 4.5
# What a first look misses of the plain model is taken for that of all others up to so many nats.
_MOST_OFFSET = 3.0
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
        found: dict[str, float] = defaultdict(float)
        for t in self.tested:
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
    scan.begin(*hypotheses[0])
    total = len(hypotheses)
    looked = []
    for i, (hypothesis, plates) in enumerate(hypotheses[1:]):
        looked += scan.look(hypothesis, plates)
        progress(i + 1, total)
    scan.refine(looked)
    ranked = _ranked(found)
    if pairs and ranked[0].hypothesis.cause != NONE:
        further = _pairs(ranked, [h for h, _ in hypotheses])
        scan.refine([one for h, at in further for one in scan.look(h, at)])
        ranked = _ranked(found)
    progress(total, total)
    best = _log_weight(ranked[0])
    ranked = _ranked([scan.sampled(t) if scan.is_near(t, best) else t for t in ranked])
    log_none = next(t for t in ranked if t.hypothesis.cause == NONE).marginal.log_evidence
    log_weight = np.array([_log_weight(t) for t in ranked])
    share = np.exp(log_weight - log_weight.max())
    share /= share.sum()
    return Weighed(
        tuple(
            replace(t, probability=float(p), log_bayes_factor=t.marginal.log_evidence - log_none)
            for t, p in zip(ranked, share, strict=True)
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
    # what a first look misses of the plain model, taken to be the same for all
    offset: float = 0.0

    @property
    def none(self) -> Marginal:
        """The plain model."""
        return self.found[0].marginal

    def begin(self, hypothesis: Hypothesis, plates: tuple[int, ...]) -> None:
        """The plain model, which all others are looked at from."""
        marginal = marginal_of(self.cases, hypothesis, plates, scatter=self.scatter)
        self.found.append(Tested(hypothesis, plates, marginal))
        start = marginal.z[int(np.argmax(marginal.weight))]
        first_look = screened_marginal(marginal.comparison, None, start).log_evidence
        # a plain model that is far off is far off in its own way
        self.offset = float(np.clip(marginal.log_evidence - first_look, -_MOST_OFFSET, _MOST_OFFSET))
        if len(self.cases) > 1:
            self.stand_ins = tangents(self.cases, marginal)

    def look(self, hypothesis: Hypothesis, plates: tuple[int, ...]) -> list[Tested]:
        """A hypothesis at a first look; nothing where it cannot be tested, which is noted."""
        try:
            comparison = self._comparison(hypothesis, plates)
            # one scatters all frequencies, the other's constants may lie anywhere: nothing to be linear in
            if comparison.discrepancy is not None or hypothesis.other_material:
                return [Tested(hypothesis, plates, self._climbed(hypothesis, plates))]
            columns = effect_columns(comparison, hypothesis)
            quadrature = columns[0] if columns else None
            # the plain model may be bent too far for its optimum to be a good place to look from
            starts = _starts(comparison, hypothesis, self.none)
            looks = [screened_marginal(comparison, quadrature, z) for z in starts]
            found = max(looks, key=lambda look: look.log_evidence)
        except RigidBodyError:
            self.not_tested.append(
                f"{hypothesis.cause} {hypothesis.variant}".rstrip()
                + ": over its prior the plate cannot be told from a rigid body; left out"
            )
            return []
        return [Tested(hypothesis, plates, replace(found, log_evidence=found.log_evidence + self.offset))]

    def refine(self, looked: Sequence[Tested]) -> None:
        """Add hypotheses, those near the best one computed by Laplace's method."""
        # first looks may promise too much: the best one is among those that were climbed
        best = max(_log_weight(t) for t in (*self.found, *looked) if t.marginal.is_climbed)
        for t in _ranked(looked):
            near = self.is_near(t, best)
            if near and not t.marginal.is_climbed:
                t = replace(t, marginal=self._climbed(t.hypothesis, t.plates))
                best = max(best, _log_weight(t))
            self.found.append(t)

    def is_near(self, t: Tested, best: float) -> bool:
        """Whether a hypothesis deserves exact numbers: near the best, or the plain model."""
        return _log_weight(t) > best - _NEAR or t.hypothesis.cause == NONE

    def sampled(self, t: Tested) -> Tested:
        """A hypothesis by importance sampling."""
        climbed = t.marginal.is_climbed
        marginal = t.marginal if climbed else self._climbed(t.hypothesis, t.plates)
        t = replace(t, marginal=marginal)
        return replace(t, marginal=sampled_marginal(self.exact(t)))

    def _climbed(self, hypothesis: Hypothesis, plates: tuple[int, ...]) -> Marginal:
        return marginal_of(
            self.cases,
            hypothesis,
            plates,
            scatter=self.scatter,
            none=self.none,
            stand_ins=self.stand_ins,
        )

    def _comparison(self, hypothesis: Hypothesis, plates: tuple[int, ...]) -> Comparison:
        return comparison_of(
            self.cases,
            _about(self.cases, hypothesis, plates),
            scatter=self.scatter,
            stand_ins=self.stand_ins,
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
    if none is None or hypothesis.other_material:
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


def _log_weight(t: Tested) -> float:
    return float(np.log(t.hypothesis.prior) + t.marginal.log_evidence)


def _ranked(found: Sequence[Tested]) -> list[Tested]:
    return sorted(found, key=_log_weight, reverse=True)
