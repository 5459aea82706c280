"""Which two causes may act at once: ranked in closed form, and the leading ones fitted like single causes.

Where the log frequencies are linear in the scores of the constants and the shifts of two effects add, the
constants are integrated in closed form at every two nodes of the effects' sizes: about the plain model's
optimum, or about that of a cause that explains the lists alone. Where nothing does, gross errors lead these
optima astray: pairs are ranked about the prior medians too, and then about the constants of the best pair,
until no better one turns up. An error of a list may show only once a cause of the plate is there: the leading
causes of the plates are fitted together with every error of the lists, all of these at once.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from cpam_bayes.deadline import cut_short, is_time_up
from cpam_bayes.diagnosis.evidence.comparison import Comparison
from cpam_bayes.diagnosis.evidence.marginal import Marginal
from cpam_bayes.diagnosis.evidence.pairing_search import Cases
from cpam_bayes.diagnosis.evidence.repairing import repairings
from cpam_bayes.diagnosis.evidence.scan import (
    EXPLAINED,
    Scan,
    Trial,
    about,
    is_repairing,
    misfit_probability,
    with_misreading,
)
from cpam_bayes.diagnosis.evidence.sharing import shared_out
from cpam_bayes.diagnosis.evidence.shifts import shift_table
from cpam_bayes.diagnosis.evidence.tested import Tested, ranked
from cpam_bayes.diagnosis.fitting import PlateCase, comparison_of, effect_columns
from cpam_bayes.diagnosis.hypotheses import NONE, OTHER, PAIR, Hypothesis, go_together, pair_scale, paired
from cpam_bayes.mechanics.modes import RigidBodyError

Array = NDArray[Any]

# Pairs that are fitted of the ranking about a point, and about the best pair.
_FITTED, _FITTED_FURTHER = 6, 4
# Where the lists are explained, pairs that promise less than this, nats below the best hypothesis, are not.
_PROMISING = 6.0
# Leading causes that get a second one; causes of a plate that get every error of its list, the pairs with
# these that are fitted, and the optima that the search for them begins at.
_LEADERS, _WITH_LIST_ERRORS, _LIST_ERRORS_FITTED, _OPTIMA = 3, 5, 3, 2
# Scores of an inferred noise at which pairs are ranked.
_NOISE_SCORES = (-1.5, 0.0, 1.5)


@dataclass(frozen=True, slots=True)
class _Point:
    """Where the lists are linear: the first scores of the plain model, or of a leading cause.

    cases : the plates with the pairing there; none where all lists are complete
    leader : that cause, ``None`` for the plain model
    """

    marginal: Marginal
    cases: Cases
    leader: Tested | None = None

    @classmethod
    def of(cls, leader: Tested) -> _Point:
        """The optimum of a leading cause."""
        return cls(leader.marginal, leader.cases, leader)


@dataclass(frozen=True, slots=True)
class _Linear:
    """The lists about a point, in units of the noise with the parameters integrated.

    residual : (n_f,) whitened
    root : (n_f, n_f), root^T root the precision
    to_scores : (n_model, n_f), from whitened residuals to the most probable scores of the parameters
    log_constant : log density without residual
    """

    residual: Array
    root: Array
    to_scores: Array
    log_constant: float


@dataclass(frozen=True, slots=True)
class _Shifts:
    """What a cause does to the log frequencies of a point.

    scores, log_prior : (k, d) of its sizes, and (k,) log prior weights; d = 0 for the leader of the point
    shift : (k, n_f)
    """

    cause: Tested
    scores: Array
    log_prior: Array
    shift: Array


@dataclass(frozen=True, slots=True)
class _Candidate:
    """A pair that is not fitted yet.

    log_weight : log of prior times evidence in closed form
    plates : that have it
    cases : the plates with the pairing of the point; none where all lists are complete
    known, scores : the comparison of the point, and its most probable scores (n,)
    sizes : most probable scores (d,) of the sizes of each cause; none of the leader of the point
    """

    log_weight: float
    pair: Hypothesis
    plates: tuple[int, ...]
    cases: Cases
    known: Comparison
    scores: Array
    sizes: tuple[tuple[Hypothesis, Array], ...]

    @property
    def key(self) -> tuple[str, str, tuple[int, ...]]:
        """That of the pair once it is tested."""
        return (self.pair.cause, self.pair.variant, self.plates)


def add_pairs(scan: Scan, hypotheses: Sequence[tuple[Hypothesis, tuple[int, ...]]]) -> None:
    """Fit the pairs of causes that may explain the lists better than one cause does.

    hypotheses : all single ones, with the plates that each is about
    """
    search = _PairSearch(scan, _single_causes(scan), pair_scale([h for h, _ in hypotheses]))
    leaders = search.leaders()
    explaining = [t for t in leaders if misfit_probability(t.marginal) > EXPLAINED]
    of_pairing = [t for t in leaders if t.hypothesis.listed.changes_pairing]
    if scan.is_explained:
        search.fit([search.plain, *map(_Point.of, of_pairing)], _FITTED, _PROMISING)
        return
    if explaining:
        search.fit([_Point.of(t) for t in explaining], _FITTED, _PROMISING)
        return
    search.fit([search.plain, *search.medians, *map(_Point.of, of_pairing)], _FITTED)
    search.fit_list_errors([(h, plates) for h, plates in hypotheses if is_repairing(h)])
    before = None
    while (best := search.best()) is not None and best is not before:
        if is_time_up():
            scan.is_cut_short = True
            cut_short("pairs about the best pair were not tested")
            break
        before = best
        search.fit([search.about(best)], _FITTED_FURTHER)


def _single_causes(scan: Scan) -> tuple[Tested, ...]:
    """Every variant of every cause, with its most probable pairing, the most probable first."""
    best: dict[tuple[str, str, tuple[int, ...]], Tested] = {}
    for t in ranked(scan.tested):
        if t.hypothesis.cause not in (NONE, OTHER):
            best.setdefault(t.key, t)
    return tuple(best.values())


@dataclass(slots=True)
class _PairSearch:
    """Pairs of causes as they are ranked and fitted.

    causes : every variant of every cause, the most probable first
    scale : prior of a pair over the product of those of its causes
    fitted : keys of the pairs that were fitted
    """

    scan: Scan
    causes: tuple[Tested, ...]
    scale: float
    fitted: set[tuple[str, str, tuple[int, ...]]] = field(default_factory=set)

    @property
    def plain(self) -> _Point:
        """The plain model's optimum."""
        return _Point(self.scan.none, self.scan.tested[0].cases)

    @property
    def medians(self) -> list[_Point]:
        """The prior medians, where the plates have modes there."""
        none = self.scan.none
        medians = np.zeros_like(none.z[:1])
        inside, _, _ = none.comparison.predict_inside(none.comparison.scores.to_x(medians))
        return [_Point(replace(none, z=medians), self.plain.cases)] if len(inside) else []

    def about(self, pair: Tested) -> _Point:
        """The constants of a pair, without what it does."""
        scan, comparison = self.scan, self.scan.none.comparison
        if pair.cases:
            comparison = comparison_of(pair.cases, scan.tested[0].hypothesis, scatter=scan.scatter)
        constants = comparison.carried(pair.marginal.comparison, pair.marginal.z[:1])
        return _Point(replace(scan.none, comparison=comparison, z=constants), pair.cases)

    def leaders(self) -> list[Tested]:
        """The best variants of the leading causes."""
        leaders: dict[str, Tested] = {}
        for t in self.causes:
            leaders.setdefault(t.hypothesis.cause, t)
        return list(leaders.values())[:_LEADERS]

    def best(self) -> Tested | None:
        """The most probable pair that was fitted."""
        return next((t for t in ranked(self.scan.tested) if t.hypothesis.family == PAIR), None)

    def fit(self, points: Sequence[_Point], most: int, promising: float = np.inf) -> None:
        """Fit the leading pairs about each point.

        most : pairs of a point
        promising : nats below the best hypothesis within which a pair must be in closed form
        """
        scan, trials = self.scan, []
        least = scan.best - promising
        for candidate in (c for point in points for c in self._ranked(point)[:most]):
            if candidate.log_weight > least and candidate.key not in self.fitted:
                self.fitted.add(candidate.key)
                start = _start(scan, candidate)
                trials.append(Trial(candidate.pair, candidate.plates, start, candidate.cases))
        scan.test(trials)

    def fit_list_errors(self, errors: Sequence[tuple[Hypothesis, tuple[int, ...]]]) -> None:
        """Fit the leading causes of the plates together with the errors of their lists that suit them."""
        scan, leaders = self.scan, dict[str, Tested]()
        for t in self.causes:
            if t.hypothesis.effects:
                leaders.setdefault(t.hypothesis.cause, t)
        items = [
            (tuple(scan.cases), t, pairs, scan.scatter)
            for t in list(leaders.values())[:_WITH_LIST_ERRORS]
            if (pairs := self._with_errors(t, errors))
        ]
        if items and is_time_up():
            scan.is_cut_short = True
            cut_short("errors of the lists were not tested together with causes of the plates")
            return
        trials = []
        for item, promising in zip(
            items, shared_out(_promising, scan.cases, items, scan.executor), strict=True
        ):
            t = item[1]
            for number, start in promising:
                pair = item[2][number]
                self.fitted.add((pair.cause, pair.variant, t.plates))
                trials.append(Trial(pair, t.plates, start, t.cases))
        scan.test(trials)

    def _with_errors(
        self, t: Tested, errors: Sequence[tuple[Hypothesis, tuple[int, ...]]]
    ) -> tuple[Hypothesis, ...]:
        """The pairs of a cause with errors of its plates' lists that are not fitted yet."""
        pairs = (
            paired(t.hypothesis, error, self.scale)
            for error, plates in errors
            if plates == t.plates and go_together(t.hypothesis, error)
        )
        return tuple(pair for pair in pairs if (pair.cause, pair.variant, t.plates) not in self.fitted)

    def _ranked(self, point: _Point) -> list[_Candidate]:
        """Every two causes that may act at once, the best variants of each, the best pair first."""
        linear = _linear(point.marginal)
        alone = logsumexp([own.log_constant - 0.5 * own.residual @ own.residual for own in linear])
        best: dict[tuple[str, str, tuple[int, ...]], _Candidate] = {}
        for a, b in self._couples(point):
            pair = paired(a.cause.hypothesis, b.cause.hypothesis, self.scale)
            log_density, noise, i, j = _together(linear, a, b)
            own = linear[noise]
            rest = own.residual - own.root @ (a.shift[i] + b.shift[j])
            scores = point.marginal.z[0].copy()
            scores[: len(own.to_scores)] = own.to_scores @ rest
            gain = log_density - float(alone)
            candidate = _Candidate(
                log_weight=point.marginal.log_evidence + gain + float(np.log(pair.prior)),
                pair=pair,
                plates=a.cause.plates,
                cases=point.cases,
                known=point.marginal.comparison,
                scores=scores,
                sizes=((a.cause.hypothesis, a.scores[i]), (b.cause.hypothesis, b.scores[j])),
            )
            if candidate.key not in best or candidate.log_weight > best[candidate.key].log_weight:
                best[candidate.key] = candidate
        return sorted(best.values(), key=lambda c: -c.log_weight)

    def _couples(self, point: _Point) -> Iterator[tuple[_Shifts, _Shifts]]:
        """Two causes that can act at once, the leader of a point one of them."""
        shifts = [s for t in self.causes if (s := _shifts(self.scan, point, t)) is not None]
        couples: Iterator[tuple[_Shifts, _Shifts]] = combinations(shifts, 2)
        if point.leader is not None:
            n_f = len(point.marginal.comparison.listed.frequencies)
            leader = _Shifts(point.leader, np.zeros((1, 0)), np.zeros(1), np.zeros((1, n_f)))
            couples = ((leader, s) for s in shifts)
        for a, b in couples:
            if a.cause.plates == b.cause.plates and go_together(a.cause.hypothesis, b.cause.hypothesis):
                yield a, b


def _linear(marginal: Marginal) -> list[_Linear]:
    """At each of the scores of an inferred noise, or once."""
    comparison, z = marginal.comparison, marginal.z[:1]
    n_model = comparison.model.parameters.size
    scores = [z]
    if comparison.parameters.size > n_model:
        for s in _NOISE_SCORES:
            other = z.copy()
            other[:, n_model:] = s
            scores.append(other)
    linear = []
    x = comparison.scores.to_x(z)
    f, slope = comparison.predict(x, jacobian=True)
    assert slope is not None
    a = (slope[0] * comparison.scores.slope(x, z)[0] / f[0][:, None])[:, :n_model]
    residual = np.log(comparison.listed.frequencies / f[0]) + a @ z[0, :n_model]
    for at in scores:
        sigma = np.sqrt(comparison.variance(comparison.scores.to_x(at))[0]) / f[0]
        covariance = np.diag(sigma**2) + a @ a.T
        root = np.linalg.inv(np.linalg.cholesky(covariance))
        log_constant = float(np.log(np.diagonal(root)).sum())
        linear.append(_Linear(root @ residual, root, a.T @ root.T, log_constant))
    return linear


def _shifts(scan: Scan, point: _Point, t: Tested) -> _Shifts | None:
    """The shifts of a cause about a point.

    ``None`` where it has no size, where modes are paired otherwise, and where the plate buckles or breaks the
    constraints (9) with any size.
    """
    hypothesis, sizes = t.hypothesis, t.marginal.sizes
    if not sizes or hypothesis.listed.changes_pairing or (point.leader and not hypothesis.effects):
        return None
    if point.marginal is scan.none and t.shift is not None:
        return _Shifts(t, t.shift.scores, t.shift.log_prior, t.shift.shift)
    comparison = t.marginal.comparison
    if point.leader is not None or point.cases:
        listed = hypothesis.listed if point.leader is None else point.leader.hypothesis.listed
        of_plates = about(scan.cases, replace(hypothesis, listed=listed), t.plates)
        comparison = comparison_of(point.cases or scan.cases, of_plates, scatter=scan.scatter)
        sizes = effect_columns(comparison, hypothesis)
    try:
        table = shift_table(comparison, hypothesis.parameters, sizes, point.marginal)
    except RigidBodyError:
        return None
    return _Shifts(t, table.scores, table.log_prior, table.shift) if len(table.scores) else None


def _together(linear: Sequence[_Linear], a: _Shifts, b: _Shifts) -> tuple[float, int, int, int]:
    """Log density of the lists with two causes, and the noise and the nodes of both where it is largest."""
    each = []
    for own in linear:
        left, right = own.residual - a.shift @ own.root.T, b.shift @ own.root.T
        distance = np.sum(left**2, axis=1)[:, None] + np.sum(right**2, axis=1) - 2.0 * left @ right.T
        each.append(own.log_constant - 0.5 * distance + a.log_prior[:, None] + b.log_prior)
    log_density = np.stack(each)
    noise, i, j = np.unravel_index(int(np.argmax(log_density)), log_density.shape)
    return float(logsumexp(log_density)), int(noise), int(i), int(j)


def _start(scan: Scan, candidate: _Candidate) -> Array:
    """Starts (1, n) of a pair: the scores of its point, and the sizes."""
    of_pair = about(scan.cases, candidate.pair, candidate.plates)
    comparison = comparison_of(candidate.cases or scan.cases, of_pair, scatter=scan.scatter)
    start = comparison.carried(candidate.known, candidate.scores)
    for hypothesis, sizes in candidate.sizes:
        if len(sizes):
            start[list(effect_columns(comparison, hypothesis))] = sizes
    return np.asarray(start[None])


def _promising(
    item: tuple[tuple[PlateCase, ...], Tested, tuple[Hypothesis, ...], float],
) -> list[tuple[int, Array]]:
    """Numbers of the pairs with a cause that fit the lists best, and starts (s, n) of each."""
    all_cases, t, pairs, scatter = item
    cases = t.cases or all_cases
    comparisons = [comparison_of(cases, about(cases, pair, t.plates), scatter=scatter) for pair in pairs]
    alone = comparison_of(cases, about(cases, t.hypothesis, t.plates), scatter=scatter)
    sizes = effect_columns(alone, t.hypothesis)
    with suppress(RigidBodyError):
        fits = repairings(alone, comparisons, t.marginal.z[:_OPTIMA], sizes)
        value = [fit.log_density + np.log(pair.prior) for fit, pair in zip(fits, pairs, strict=True)]
        best = np.argsort(value, kind="stable")[::-1][:_LIST_ERRORS_FITTED]
        return [
            (int(i), with_misreading(comparisons[i], comparisons[i].carried(alone, fits[i].z))) for i in best
        ]
    return []
