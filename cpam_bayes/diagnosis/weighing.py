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
from cpam_bayes.modes import RigidBodyError

Array = NDArray[Any]

# Starts of the climbs of "none" besides the prior means.
_STARTS = 6
# Hypotheses so many nats below the most probable one are not refined, and those within the second number
# are computed by importance sampling.
_HOPELESS, _LEADING = 12.0, 7.0
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
    for i, (hypothesis, plates) in enumerate(hypotheses):
        _try(cases, hypothesis, plates, scatter, found, not_tested)
        progress(i + 1, len(hypotheses))
    ranked = _ranked(found)
    if pairs and ranked[0].hypothesis.cause != NONE:
        further = _pairs(ranked, [h for h, _ in hypotheses])
        for i, (hypothesis, plates) in enumerate(further):
            _try(cases, hypothesis, plates, scatter, found, not_tested)
            progress(len(hypotheses) + i + 1, len(hypotheses) + len(further))
        ranked = _ranked(found)
    best = _log_weight(ranked[0])
    ranked = [
        replace(t, marginal=sampled_marginal(t.marginal)) if _log_weight(t) > best - _LEADING else t
        for t in ranked
    ]
    ranked = _ranked(ranked)
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
) -> Marginal:
    """Marginal likelihood of one hypothesis about some plates; ``left_out`` : a frequency to leave out."""
    about = dict.fromkeys(plates, hypothesis) if len(plates) < len(cases) else hypothesis
    comparison = comparison_of(cases, about, scatter=scatter)
    if left_out is not None:
        comparison = replace(comparison, listed=comparison.listed.without(left_out), left_out=left_out)
    columns = effect_columns(comparison, hypothesis)
    quadrature = columns[0] if columns else None
    return laplace_marginal(comparison, quadrature, _starts(comparison, hypothesis, none), floor=floor)


def _try(
    cases: Sequence[PlateCase],
    hypothesis: Hypothesis,
    plates: tuple[int, ...],
    scatter: float,
    found: list[Tested],
    not_tested: list[str],
) -> None:
    none = next((t.marginal for t in found if t.hypothesis.cause == NONE), None)
    best = max((_log_weight(t) for t in found), default=-np.inf)
    floor = best - np.log(hypothesis.prior) - _HOPELESS
    try:
        marginal = marginal_of(cases, hypothesis, plates, scatter=scatter, none=none, floor=floor)
    except RigidBodyError:
        not_tested.append(
            f"{hypothesis.cause} {hypothesis.variant}".rstrip()
            + ": over its prior the plate cannot be told from a rigid body; left out"
        )
        return
    found.append(Tested(hypothesis, plates, marginal))


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


def _log_weight(t: Tested) -> float:
    return float(np.log(t.hypothesis.prior) + t.marginal.log_evidence)


def _ranked(found: Sequence[Tested]) -> list[Tested]:
    return sorted(found, key=_log_weight, reverse=True)


def prior_of(hypotheses: Mapping[str, float]) -> float:
    """Total prior probability."""
    return float(sum(hypotheses.values()))
