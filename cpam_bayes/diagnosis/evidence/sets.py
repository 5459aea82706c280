"""Sets of causes that act at once: ranked in closed form, the leading ones fitted like single causes.

Where the log frequencies are linear in the scores of the constants and the shifts of two effects add, the
constants are integrated in closed form at every two nodes of the effects' sizes: about the plain model's
optimum, or about that of a leading set, to which a cause is added. Where nothing explains the lists, gross
errors lead these optima astray: pairs are ranked about the prior medians too, and about the constants of the
best pair. An error of a list may show only once a cause of the plate is there: leading causes are then fitted
together with every error of the lists. The probability in closed form, the largest about any of these points,
of sets that show and were not fitted is unaccounted for; the search goes on while it is over a hundredth.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Final

import numpy as np
from scipy.special import expit, logsumexp

from cpam_bayes.diagnosis.comparison import PlateCase, comparison_of, effect_columns
from cpam_bayes.diagnosis.evidence.marginal import Marginal, Tested, best_by_cause, ranked, shift_table
from cpam_bayes.diagnosis.evidence.pairing_search import Cases, repairings
from cpam_bayes.diagnosis.evidence.sampled import shared_out
from cpam_bayes.diagnosis.evidence.scan import (
    EXPLAINED,
    Scan,
    Trial,
    about,
    is_repairing,
    misfit_probability,
    with_misreading,
)
from cpam_bayes.diagnosis.hypotheses import (
    NONE,
    OTHER,
    P_SETS,
    SET,
    Hypothesis,
    go_together,
    repeated,
    set_scales,
    together,
)
from cpam_bayes.inference.log_density import CorrelatedDensity
from cpam_bayes.mechanics.modes import RigidBodyError
from cpam_bayes.mechanics.problem import Array
from cpam_bayes.running import cut_short, is_time_up


@dataclass(frozen=True, slots=True)
class SetSettings:
    """Limits of the search for sets of causes.

    fitted, fitted_further : sets fitted from the ranking about a point, and about the best pair
    promising : nats below the best hypothesis; where the lists are explained, sets that promise less are not
        fitted
    starts : of a fit of two masses or flaws
    leaders : leading causes that get a second one
    with_list_errors : causes of a plate that are combined with every error of its list
    list_errors_fitted : number of pairs with these that are fitted
    optima : number at which the search for them starts
    noise_scores : of an inferred noise, at which sets are ranked
    shown : gain in log evidence, nats, of a set over the better one of its causes, from which a further cause
        shows; with less it acts with its prior probability, as by itself
    grown, near : number of best sets, within so many nats of the best, that get a further cause or lose one
    unaccounted : probability of the sets that were not fitted, at which the search ends
    rounds : of this at most
    """

    fitted: int = 6
    fitted_further: int = 4
    promising: float = 6.0
    starts: int = 4
    leaders: int = 3
    with_list_errors: int = 5
    list_errors_fitted: int = 3
    optima: int = 2
    noise_scores: tuple[float, ...] = (-1.5, 0.0, 1.5)
    shown: float = 1.0
    grown: int = 5
    near: float = 4.0
    unaccounted: float = 0.01
    rounds: int = 4


SETS: Final = SetSettings()

_Key = tuple[str, str, tuple[int, ...]]


@dataclass(frozen=True, slots=True)
class _Point:
    """Point of linearisation: the first scores of the plain model, or of a leading cause.

    cases : the plates with the pairing there; empty where all lists are complete
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
    """The lists linearised about a point, whitened by the noise with the parameters integrated out.

    residual : (n_f,) whitened
    root : (n_f, n_f), root^T root the precision
    to_scores : (n_model, n_f), from whitened residuals to the most probable scores of the parameters
    log_constant : log density at zero residual
    """

    residual: Array
    root: Array
    to_scores: Array
    log_constant: float


@dataclass(frozen=True, slots=True)
class _Shifts:
    """Shifts of the log frequencies of a point by a cause.

    scores, log_prior : (k, d) of its sizes, and (k,) log prior weights; d = 0 for the leader of the point
    shift : (k, n_f)
    """

    cause: Tested
    scores: Array
    log_prior: Array
    shift: Array


@dataclass(frozen=True, slots=True)
class _Candidate:
    """A set that is not fitted yet.

    log_weight : log of prior times evidence in closed form
    plates : numbers of the plates that have it
    cases : the plates with the pairing of the point; empty where all lists are complete
    known : the comparison of the point
    starts : at the most probable nodes, the scores (n,) of its parameters, and the scores (d,) of the sizes
        of each cause, empty for the leader of the point
    """

    log_weight: float
    hypothesis: Hypothesis
    plates: tuple[int, ...]
    cases: Cases
    known: CorrelatedDensity
    starts: tuple[tuple[Array, tuple[tuple[Hypothesis, Array], ...]], ...]

    @property
    def key(self) -> _Key:
        """Key of the set once it is tested."""
        return (self.hypothesis.cause, self.hypothesis.variant, self.plates)


def add_sets(scan: Scan, hypotheses: Sequence[tuple[Hypothesis, tuple[int, ...]]]) -> float:
    """Fit the sets of causes that may explain the lists better than one cause does.

    hypotheses : all single ones, with the plates that each is about

    Returns the probability of the sets that were not fitted.
    """
    search = _SetSearch(scan, _single_causes(scan), set_scales([h for h, _ in hypotheses]))
    leaders = search.leaders()
    explaining = [t for t in leaders if misfit_probability(t.marginal) > EXPLAINED]
    of_pairing = [t for t in leaders if t.hypothesis.listed.changes_pairing]
    if scan.is_explained:
        search.fit([search.plain, *map(_Point.of, of_pairing)], SETS.fitted, SETS.promising)
    elif explaining:
        # a cause with a place and an extent may by chance explain what two others explain better
        search.fit([search.plain, *search.medians, *map(_Point.of, explaining)], SETS.fitted, SETS.promising)
    else:
        points = {id(t): _Point.of(t) for t in (*leaders[:1], *of_pairing)}
        search.fit([search.plain, *search.medians, *points.values()], SETS.fitted)
        best = search.best()
        # a set may explain the lists and yet be less probable than a discrepancy
        if best is None or misfit_probability(best.marginal) < EXPLAINED or best.log_weight < scan.best:
            search.fit_list_errors([(h, plates) for h, plates in hypotheses if is_repairing(h)])
        before = None
        while (best := search.best()) is not None and best is not before:
            if search.must_end():
                cut_short("cut_sets")
                break
            before = best
            search.fit([search.about(best)], SETS.fitted_further)
    search.grow()
    return search.unaccounted


def _single_causes(scan: Scan) -> tuple[Tested, ...]:
    """Every variant of every cause, with its most probable pairing, the most probable first."""
    best: dict[_Key, Tested] = {}
    for t in ranked(scan.tested):
        if t.hypothesis.cause not in (NONE, OTHER):
            best.setdefault(t.key, t)
    return tuple(best.values())


@dataclass(slots=True)
class _SetSearch:
    """State of the search for sets of causes.

    causes : every variant of every cause, the most probable first
    scales : by number of causes, prior of a set over the product of those of its causes
    fitted : keys of the sets that were fitted
    scored : log of prior times evidence in closed form, of sets that were ranked, the largest of all points
    """

    scan: Scan
    causes: tuple[Tested, ...]
    scales: Mapping[int, float]
    fitted: set[_Key] = field(default_factory=set)
    scored: dict[_Key, float] = field(default_factory=dict)

    @property
    def unaccounted(self) -> float:
        """Probability of the sets that were ranked and not fitted."""
        left = [w for key, w in self.scored.items() if key not in self.fitted]
        if not left:
            return 0.0
        odds = logsumexp(left) - logsumexp([t.log_weight for t in self.scan.tested])
        return float(expit(odds))

    def must_end(self) -> bool:
        """Whether time is up, recorded in the scan."""
        self.scan.is_cut_short |= is_time_up()
        return self.scan.is_cut_short

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

    def about(self, tested: Tested) -> _Point:
        """Point at the constants of a cause or a set, without its effects."""
        scan, comparison = self.scan, self.scan.none.comparison
        if tested.cases:
            plain = scan.tested[0]
            comparison = scan.density(plain.hypothesis, plain.plates, tested.cases)
        constants = comparison.carried(tested.marginal.comparison, tested.marginal.z[:1])
        return _Point(replace(scan.none, comparison=comparison, z=constants), tested.cases)

    def leaders(self) -> list[Tested]:
        """The best variants of the leading causes."""
        return list(best_by_cause(self.causes).values())[: SETS.leaders]

    def best(self) -> Tested | None:
        """The most probable set that was fitted."""
        return next((t for t in ranked(self.scan.tested) if t.hypothesis.family == SET), None)

    def grow(self) -> None:
        """Add a cause to the best sets, and remove one from them, until little is unaccounted for."""
        seen: set[_Key] = set()
        for _ in range(SETS.rounds):
            order = [t for t in ranked(self.scan.tested) if t.hypothesis.cause not in (NONE, OTHER)]
            if not self.scan.is_explained and order[0].key not in seen:
                self.fit([self.about(order[0])], SETS.fitted_further, SETS.promising)
            near = [t for t in order if t.log_weight > order[0].log_weight - SETS.near and t.key not in seen]
            new = list({t.key: t for t in reversed(near[: SETS.grown])}.values())[::-1]
            if not new:
                return
            if self.must_end():
                cut_short("cut_sets")
                return
            seen |= {t.key for t in new}
            self._take_one_away(new)
            larger = [t for t in new if len(t.hypothesis.instances) < max(P_SETS)]
            self.fit([_Point.of(t) for t in larger], SETS.fitted, SETS.promising)
            if self.unaccounted < SETS.unaccounted:
                return

    def _take_one_away(self, tested: Sequence[Tested]) -> None:
        """Fit sets without one of their causes."""
        trials = {}
        for t in tested:
            if len(t.hypothesis.parts) < 3:
                continue
            for rest in combinations(t.hypothesis.parts, len(t.hypothesis.parts) - 1):
                smaller = together(rest, self.scales)
                key = (smaller.cause, smaller.variant, t.plates)
                if key in self.fitted or not go_together(*rest):
                    continue
                self.fitted.add(key)
                density = self.scan.density(smaller, t.plates, t.cases)
                known = density.carried(t.marginal.comparison, t.marginal.z[:1])
                trials[key] = Trial(smaller, t.plates, known, t.cases)
        self.scan.test(list(trials.values()))

    def fit(self, points: Sequence[_Point], most: int, promising: float = np.inf) -> None:
        """Fit the leading sets about each point.

        most : sets of a point
        promising : nats below the best hypothesis within which a set must be in closed form
        """
        scan, trials = self.scan, []
        least = scan.best - promising
        for point in points:
            candidates = self._ranked(point)
            self.scored |= {c.key: max(c.log_weight, self.scored.get(c.key, -np.inf)) for c in candidates}
            for candidate in candidates[:most]:
                if candidate.log_weight > least and candidate.key not in self.fitted:
                    self.fitted.add(candidate.key)
                    start = _start(scan, candidate)
                    trials.append(Trial(candidate.hypothesis, candidate.plates, start, candidate.cases))
        scan.test(trials)

    def fit_list_errors(self, errors: Sequence[tuple[Hypothesis, tuple[int, ...]]]) -> None:
        """Fit the leading causes of the plates together with the errors of their lists that fit best.

        Neither of two misread frequencies may fit alone under the plain model: all pairs are tried with it.
        """
        scan, leaders = self.scan, best_by_cause(t for t in self.causes if t.hypothesis.effects)
        of_plates: dict[tuple[int, ...], list[Hypothesis]] = {}
        for error, plates in errors:
            of_plates.setdefault(plates, []).append(error)
        couples = [
            (t, [(t.hypothesis, error) for error in of_plates.get(t.plates, ())])
            for t in list(leaders.values())[: SETS.with_list_errors]
        ]
        for plates, each in of_plates.items():
            misread = combinations([error for error in each if error.may_repeat], 2)
            couples.append((replace(scan.tested[0], plates=plates), [(a, repeated(b)) for a, b in misread]))
        items = [
            (tuple(scan.cases), t, pairs, scan.scatter)
            for t, some in couples
            if (pairs := self._not_fitted(some, t.plates))
        ]
        if items and self.must_end():
            cut_short("cut_list_errors")
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

    def _not_fitted(
        self, couples: Iterable[tuple[Hypothesis, Hypothesis]], plates: tuple[int, ...]
    ) -> tuple[Hypothesis, ...]:
        """Pairs of causes that can act together on some plates and are not fitted yet."""
        pairs = (together(couple, self.scales) for couple in couples if go_together(*couple))
        return tuple(pair for pair in pairs if (pair.cause, pair.variant, plates) not in self.fitted)

    def _ranked(self, point: _Point) -> list[_Candidate]:
        """Sets that add one or two causes to the point, in their best variants, the best set first."""
        linear = _linear(point.marginal)
        known = point.marginal if point.leader is not None else self.scan.none
        # the plain model's evidence is that of its closed form about its own optimum, and not elsewhere
        at_optimum = linear if known is point.marginal else _linear(known)
        alone = logsumexp([own.log_constant - 0.5 * own.residual @ own.residual for own in at_optimum])
        best: dict[_Key, _Candidate] = {}
        for a, b in self._couples(point):
            log_density, best_nodes = _together(linear, a, b)
            log_evidence = known.log_evidence + log_density - float(alone)
            if log_evidence < max(s.cause.marginal.log_evidence for s in (a, b)) + SETS.shown:
                continue
            both = together((a.cause.hypothesis, b.cause.hypothesis), self.scales)
            starts = []
            for noise, i, j in best_nodes:
                own = linear[noise]
                rest = own.residual - own.root @ (a.shift[i] + b.shift[j])
                scores = point.marginal.z[0].copy()
                scores[: len(own.to_scores)] = own.to_scores @ rest
                sizes = ((a.cause.hypothesis, a.scores[i]), (b.cause.hypothesis, b.scores[j]))
                starts.append((scores, sizes))
            candidate = _Candidate(
                log_weight=log_evidence + float(np.log(both.prior)),
                hypothesis=both,
                plates=a.cause.plates,
                cases=point.cases,
                known=point.marginal.comparison,
                starts=tuple(starts),
            )
            if candidate.key not in best or candidate.log_weight > best[candidate.key].log_weight:
                best[candidate.key] = candidate
        return sorted(best.values(), key=lambda c: -c.log_weight)

    def _couples(self, point: _Point) -> Iterator[tuple[_Shifts, _Shifts]]:
        """Pairs of causes that can act together, one of them the leader of the point if it has one."""
        leader = point.leader
        singles, seconds = list[_Shifts](), list[_Shifts]()
        for t in self.causes:
            instances = [t]
            if t.hypothesis.may_repeat:
                instances.append(replace(t, hypothesis=repeated(t.hypothesis)))
            kept = [i for i in instances if leader is None or _act_together(leader, i)]
            shifts = _shifts(self.scan, point, t) if kept else None
            if shifts is not None:
                for i in kept:
                    (singles if i is t else seconds).append(replace(shifts, cause=i))
        every = singles + seconds
        if leader is not None:
            n_f = len(point.marginal.comparison.listed.frequencies)
            of_leader = _Shifts(leader, np.zeros((1, 0)), np.zeros(1), np.zeros((1, n_f)))
            yield from ((of_leader, s) for s in every)
            return
        yield from ((a, b) for a, b in combinations(every, 2) if _act_together(a.cause, b.cause))


def _act_together(a: Tested, b: Tested) -> bool:
    """Whether two tested causes can act together."""
    return a.plates == b.plates and go_together(a.hypothesis, b.hypothesis)


def _linear(marginal: Marginal) -> list[_Linear]:
    """Linearised lists at each of the scores of an inferred noise, or once."""
    comparison, z = marginal.comparison, marginal.z[:1]
    n_model = comparison.model.parameters.size
    scores = [z]
    if comparison.parameters.size > n_model:
        for s in SETS.noise_scores:
            other = z.copy()
            other[:, n_model:] = s
            scores.append(other)
    linear = []
    x = comparison.scores.to_x(z)
    f, slope = comparison.predict(x, jacobian=True)
    assert slope is not None
    a = (comparison.scores.by_score(slope, x, z)[0] / f[0][:, None])[:, :n_model]
    residual = np.log(comparison.listed.frequencies / f[0]) + a @ z[0, :n_model]
    squared = np.outer(comparison.listed.frequencies, comparison.listed.frequencies)
    for at in scores:
        covariance = comparison.covariance(comparison.scores.to_x(at))[0] / squared + a @ a.T
        root = np.linalg.inv(np.linalg.cholesky(covariance))
        log_constant = float(np.log(np.diagonal(root)).sum())
        linear.append(_Linear(root @ residual, root, a.T @ root.T, log_constant))
    return linear


def _shifts(scan: Scan, point: _Point, t: Tested) -> _Shifts | None:
    """Shifts by a cause that can act beside the leader of a point.

    ``None`` where it has none, where the pairing differs, and where no size is admissible.
    """
    hypothesis, sizes = t.hypothesis, t.marginal.sizes
    if not hypothesis.effects and not sizes:
        return None
    if hypothesis.listed.changes_pairing:
        return None
    if point.marginal is scan.none and t.shift is not None:
        return _Shifts(t, t.shift.scores, t.shift.log_prior, t.shift.shift)
    comparison = t.marginal.comparison
    if point.leader is not None or point.cases:
        listed = hypothesis.listed
        if point.leader is not None and point.leader.hypothesis.listed.changes_pairing:
            listed = point.leader.hypothesis.listed
        comparison = scan.density(replace(hypothesis, listed=listed), t.plates, point.cases)
        sizes = effect_columns(comparison, hypothesis)
    try:
        table = shift_table(comparison, hypothesis.parameters, sizes, point.marginal)
    except RigidBodyError:
        return None
    return _Shifts(t, table.scores, table.log_prior, table.shift) if len(table.scores) else None


def _together(linear: Sequence[_Linear], a: _Shifts, b: _Shifts) -> tuple[float, list[tuple[int, int, int]]]:
    """Log density of the lists with two causes, and indices of noise and nodes where it is largest."""
    each = []
    for own in linear:
        left, right = own.residual - a.shift @ own.root.T, b.shift @ own.root.T
        distance = np.sum(left**2, axis=1)[:, None] + np.sum(right**2, axis=1) - 2.0 * left @ right.T
        each.append(own.log_constant - 0.5 * distance + a.log_prior[:, None] + b.log_prior)
    log_density = np.stack(each)
    # a few nodes hardly hit the places of two masses or flaws: several of them are starts
    most = SETS.starts if any(e.repeats for e in b.cause.hypothesis.effects) else 1
    flat = np.argsort(-log_density, axis=None, kind="stable")[:most]
    return float(logsumexp(log_density)), [
        (int(noise), int(i), int(j))
        for noise, i, j in zip(*np.unravel_index(flat, log_density.shape), strict=True)
    ]


def _start(scan: Scan, candidate: _Candidate) -> Array:
    """Starts (s, n) of a pair: the scores of its point, and the sizes."""
    comparison = scan.density(candidate.hypothesis, candidate.plates, candidate.cases)
    starts = []
    for scores, of_causes in candidate.starts:
        start = comparison.carried(candidate.known, scores)
        for hypothesis, sizes in of_causes:
            if len(sizes):
                start[list(effect_columns(comparison, hypothesis))] = sizes
        starts.append(start)
    return np.stack(starts)


def _promising(
    cases: tuple[PlateCase, ...], t: Tested, pairs: tuple[Hypothesis, ...], scatter: float
) -> list[tuple[int, Array]]:
    """Indices of the pairs with a cause that fit the lists best, and starts (s, n) for each."""
    cases = t.cases or cases
    comparisons = [comparison_of(cases, about(cases, pair, t.plates), scatter=scatter) for pair in pairs]
    alone = comparison_of(cases, about(cases, t.hypothesis, t.plates), scatter=scatter)
    sizes = effect_columns(alone, t.hypothesis)
    with suppress(RigidBodyError):
        fits = repairings(alone, comparisons, t.marginal.z[: SETS.optima], sizes)
        value = [fit.log_density + np.log(pair.prior) for fit, pair in zip(fits, pairs, strict=True)]
        best = np.argsort(value, kind="stable")[::-1][: SETS.list_errors_fitted]
        return [
            (int(i), with_misreading(comparisons[i], comparisons[i].carried(alone, fits[i].z))) for i in best
        ]
    return []
