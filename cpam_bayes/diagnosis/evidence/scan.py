"""Hypotheses tested one by one: screening of each, exact numbers where they matter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.diagnosis.evidence.comparison import Comparison
from cpam_bayes.diagnosis.evidence.marginal import Marginal, laplace_marginal, sampled_marginal
from cpam_bayes.diagnosis.evidence.pair_screening import screened_pair
from cpam_bayes.diagnosis.evidence.screening import Anchor, Linear, free_of, linear, log_f, screened_marginal
from cpam_bayes.diagnosis.evidence.tangent import tangents
from cpam_bayes.diagnosis.fitting import SCATTER, PlateCase, comparison_of, effect_columns
from cpam_bayes.diagnosis.hypotheses import NONE, OTHER, PAIR, Hypothesis
from cpam_bayes.effects import ListChange
from cpam_bayes.inference.posterior import ForwardModel
from cpam_bayes.mechanics.modes import RigidBodyError

Array = NDArray[Any]

# Starts of the optimisations of "none" besides the prior means.
_STARTS = 6
# Hypotheses within so many nats of the most probable one are optimised, those nearer are sampled too; the
# others keep what screening says of them, corrected by a second one if it is within the last number.
_NEAR, _NEARER, _CORRECTED = 3.0, 2.0, 14.0
# What screening misses of the plain model is taken for that of all others if it is below this, nats.
_MOST_OFFSET = 1.0


@dataclass(frozen=True, slots=True)
class Tested:
    """One hypothesis with its marginal likelihood.

    plates : numbers of the plates that have it; all of them where they share it.
    probability : among all that were tested.
    log_bayes_factor : against none.
    shift : (k, n_f) of the log frequencies at the scores of the first grid, with the constants of the plain
    model; ``None`` where the list is paired otherwise.
    """

    hypothesis: Hypothesis
    plates: tuple[int, ...]
    marginal: Marginal
    probability: float = 0.0
    log_bayes_factor: float = 0.0
    shift: Array | None = None

    @property
    def columns(self) -> tuple[int, ...]:
        """Columns of the effect's parameters."""
        return effect_columns(self.marginal.comparison, self.hypothesis)

    @property
    def log_weight(self) -> float:
        """Log of prior times evidence."""
        return float(np.log(self.hypothesis.prior) + self.marginal.log_evidence)


def ranked(tested: Sequence[Tested]) -> list[Tested]:
    """Hypotheses, those with most prior times evidence first."""
    return sorted(tested, key=lambda t: t.log_weight, reverse=True)


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
    screened: Marginal | None = None,
) -> Marginal:
    """Marginal likelihood of one hypothesis about some plates.

    left_out : a frequency to leave out.
    stand_ins : models of the plates that the hypothesis is not about.
    screened : where optimisations begin.
    """
    comparison = comparison_of(cases, _about(cases, hypothesis, plates), scatter=scatter, stand_ins=stand_ins)
    if left_out is not None:
        comparison = replace(comparison, listed=comparison.listed.without(left_out), left_out=left_out)
    columns = effect_columns(comparison, hypothesis)
    quadrature = columns[0] if columns else None
    return laplace_marginal(
        comparison, quadrature, _starts(comparison, hypothesis, none), floor=floor, screened=screened
    )


@dataclass(slots=True)
class Scan:
    """Hypotheses as they are tested, none first.

    anchors : the optimum of none, and the prior means.
    offset : what screening misses of the plain model, taken to be the same for all.
    """

    cases: Sequence[PlateCase]
    scatter: float
    tested: list[Tested] = field(default_factory=list)
    not_tested: list[str] = field(default_factory=list)
    anchors: tuple[Anchor, ...] = ()
    offset: float = 0.0

    @property
    def none(self) -> Marginal:
        """The plain model."""
        return self.tested[0].marginal

    @property
    def stand_ins(self) -> Mapping[int, ForwardModel] | None:
        """Models of the plates that a hypothesis is not about, where there are several."""
        return self.anchors[0].tangents if len(self.cases) > 1 and self.anchors else None

    def begin(self, hypothesis: Hypothesis, plates: tuple[int, ...]) -> None:
        """The plain model, which all others are screened from."""
        marginal = marginal_of(self.cases, hypothesis, plates, scatter=self.scatter)
        self.tested.append(Tested(hypothesis, plates, marginal))
        best = marginal.z[int(np.argmax(marginal.weight))]
        names = marginal.comparison.parameters.names
        self.anchors = tuple(
            Anchor(
                dict(zip(names, z, strict=True)),
                tangents(self.cases, marginal.comparison, marginal.comparison.scores.to_x(z)),
            )
            for z in (best, np.zeros_like(best))
        )
        approximate = screened_marginal(marginal.comparison, None, self.anchors[0])[0].log_evidence
        # a plain model that is far off is far off in its own way, of which nothing follows for the others
        missed = marginal.log_evidence - approximate
        self.offset = missed if abs(missed) < _MOST_OFFSET else 0.0

    def screen(self, hypothesis: Hypothesis, plates: tuple[int, ...]) -> list[Tested]:
        """Screening of a hypothesis; nothing where it cannot be tested, which is noted."""
        try:
            # one scatters all frequencies, the other's constants may lie anywhere: nothing to be linear in
            if hypothesis.cause == OTHER or hypothesis.other_material:
                return [Tested(hypothesis, plates, self._optimised(hypothesis, plates))]
            return [self._screened(hypothesis, plates, self._comparison(hypothesis, plates), False)]
        except RigidBodyError:
            self.not_tested.append(
                f"{hypothesis.cause} {hypothesis.variant}".rstrip()
                + ": over its prior the plate cannot be told from a rigid body; left out"
            )
            return []

    def _screened(
        self, hypothesis: Hypothesis, plates: tuple[int, ...], comparison: Comparison, corrected: bool
    ) -> Tested:
        columns = effect_columns(comparison, hypothesis)
        quadrature = columns[0] if columns else None
        # the plain model may be bent too far for its optimum to be a good place to expand about
        anchors = self.anchors if _is_far(hypothesis) else self.anchors[:1]
        screenings = [screened_marginal(comparison, quadrature, a, corrected=corrected) for a in anchors]
        best = max((m for m, _ in screenings), key=lambda m: m.log_evidence)
        shift = None if quadrature is None or _repairs(hypothesis) else screenings[0][1]
        marginal = replace(best, log_evidence=best.log_evidence + self.offset)
        return Tested(hypothesis, plates, marginal, shift=shift)

    def corrected(self, screened: Sequence[Tested]) -> list[Tested]:
        """Screened hypotheses, the promising ones corrected."""
        best = max((t.log_weight for t in (*self.tested, *screened)), default=0.0)
        return [
            self._screened(t.hypothesis, t.plates, t.marginal.comparison, True)
            if not t.marginal.is_refined and t.hypothesis.effects and t.log_weight > best - _CORRECTED
            else t
            for t in screened
        ]

    def linear_none(self) -> tuple[Linear, Array]:
        """The lists against the plain model, linear about its optimum, and its scores by column."""
        comparison, anchor = self.none.comparison, self.anchors[0]
        z = anchor.start(comparison)
        plain = anchor.plain(comparison)
        residual = np.log(comparison.listed.frequencies) - log_f(plain, z[None])[0]
        return linear(comparison, plain, z, free_of(comparison, ()), residual), z

    def screen_pair(self, pair: Hypothesis, a: Tested, b: Tested, lists: Linear) -> Tested:
        """A pair of causes that were screened alone."""
        assert a.shift is not None
        assert b.shift is not None
        comparison = self._comparison(pair, a.plates)
        columns = effect_columns(comparison, pair)
        start = self.anchors[0].start(comparison)
        marginal = screened_pair(lists, (a.shift, b.shift), comparison, (columns[0], columns[1]), start)
        return Tested(pair, a.plates, replace(marginal, log_evidence=marginal.log_evidence + self.offset))

    def refine(self, screened: Sequence[Tested], most: int | None = None) -> None:
        """Add hypotheses, those near the best one (``most`` of them) computed by Laplace's method."""
        # screening may promise too much, so the best one is among those that were optimised, or too little,
        # and then all of them about alike
        best = max(t.log_weight for t in (*self.tested, *screened) if t.marginal.is_refined)
        n_refined, lift = 0, 0.0
        for t in ranked(screened):
            few = most is None or n_refined < most
            if few and self.is_near(t, best - lift) and not t.marginal.is_refined:
                promised = t.log_weight
                t = replace(t, marginal=self._optimised(t.hypothesis, t.plates, t.marginal))
                lift = max(lift, t.log_weight - promised)
                best = max(best, t.log_weight)
                n_refined += 1
            self.tested.append(t)

    def is_near(self, t: Tested, best: float, within: float = _NEAR) -> bool:
        """Whether a hypothesis deserves exact numbers: near the best, or the plain model."""
        return t.log_weight > best - within or t.hypothesis.cause == NONE

    def sampled(self, t: Tested, best: float) -> Tested:
        """A hypothesis by importance sampling, if it is near enough and was optimised."""
        if not self.is_near(t, best, _NEARER) or not t.marginal.is_refined:
            return t
        return replace(t, marginal=sampled_marginal(self.exact(t)))

    def _optimised(
        self, hypothesis: Hypothesis, plates: tuple[int, ...], first: Marginal | None = None
    ) -> Marginal:
        return marginal_of(
            self.cases,
            hypothesis,
            plates,
            scatter=self.scatter,
            none=self.none,
            stand_ins=self.stand_ins,
            screened=first,
        )

    def _comparison(self, hypothesis: Hypothesis, plates: tuple[int, ...]) -> Comparison:
        return comparison_of(
            self.cases,
            _about(self.cases, hypothesis, plates),
            scatter=self.scatter,
            stand_ins=self.stand_ins,
        )

    def exact(self, tested: Tested) -> Marginal:
        """The marginal likelihood of a hypothesis over the models of all plates, without stand-ins."""
        if self.stand_ins is None or len(tested.plates) == len(self.cases):
            return tested.marginal
        about = _about(self.cases, tested.hypothesis, tested.plates)
        return replace(tested.marginal, comparison=comparison_of(self.cases, about, scatter=self.scatter))


def _repairs(hypothesis: Hypothesis) -> bool:
    """Whether a hypothesis gives frequencies to other modes."""
    return bool(hypothesis.listed.missed) or hypothesis.listed.spurious is not None


def _is_far(hypothesis: Hypothesis) -> bool:
    """Whether the constants may lie far from those of none."""
    return hypothesis.is_gross or hypothesis.listed != ListChange() or hypothesis.family == PAIR


def _about(
    cases: Sequence[PlateCase], hypothesis: Hypothesis, plates: tuple[int, ...]
) -> Hypothesis | dict[int, Hypothesis]:
    return hypothesis if len(plates) == len(cases) else dict.fromkeys(plates, hypothesis)


def _starts(comparison: Comparison, hypothesis: Hypothesis, none: Marginal | None) -> Array:
    """Scores that optimisations begin from: the optimum of none, and prior means where it may be far."""
    n = comparison.parameters.size
    if none is None or hypothesis.other_material:
        rng = np.random.default_rng(0)
        return np.concatenate((np.zeros((1, n)), rng.standard_normal((_STARTS, n))))
    at = dict(zip(none.comparison.parameters.names, none.z[int(np.argmax(none.weight))], strict=True))
    start = np.array([at.get(name, 0.0) for name in comparison.parameters.names])
    return np.stack((start, np.zeros(n))) if _is_far(hypothesis) else start[None]
