"""Every hypothesis weighed against the data: marginal likelihoods, probabilities, and pairs of causes.

Which two causes may act at once is ranked in closed form, and the leading ones are fitted like single causes.
Where the log frequencies are linear in the scores of the constants and the shifts of two effects add, the
constants are integrated in closed form at every two nodes of the effects' sizes: about the plain model's
optimum, or about that of a cause that explains the lists alone. Where nothing does, gross errors lead these
optima astray: pairs are ranked about the prior medians too, and then about the constants of the best pair,
until no better one turns up. An error of a list may show only once a cause of the plate is there: the leading
causes of the plates are fitted together with every error of the lists, all of these at once.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from cpam_bayes.diagnosis.comparison import SCATTER, PlateCase, comparison_of, effect_columns
from cpam_bayes.diagnosis.evidence.marginal import Marginal, Tested, prior_of, ranked, shift_table
from cpam_bayes.diagnosis.evidence.pairing_search import Cases, repairings
from cpam_bayes.diagnosis.evidence.sampled import sampled_near_the_best, shared_out
from cpam_bayes.diagnosis.evidence.scan import (
    EXPLAINED,
    Scan,
    Trial,
    about,
    is_repairing,
    marginal_of,
    misfit_probability,
    with_misreading,
)
from cpam_bayes.diagnosis.hypotheses import (
    NONE,
    OTHER,
    PAIR,
    Hypothesis,
    go_together,
    pair_scale,
    paired,
    prior_by_cause,
)
from cpam_bayes.inference.log_density import LogDensity
from cpam_bayes.mechanics.modes import RigidBodyError
from cpam_bayes.running import cut_short, is_time_up

__all__ = ["Tested", "Weighed", "marginal_of", "weigh"]

Array = NDArray[Any]


@dataclass(frozen=True, slots=True)
class PairSettings:
    """Limits that say which two causes at once are fitted, and which are hypotheses of their own.

    fitted, fitted_further : pairs of the ranking about a point, and about the best pair
    promising : nats below the best hypothesis; where the lists are explained, pairs that promise less are not
    leaders : leading causes that get a second one
    with_list_errors : causes of a plate that get every error of its list
    list_errors_fitted : the pairs with these that are fitted
    optima : that the search for them begins at
    noise_scores : of an inferred noise, at which pairs are ranked
    gain : log Bayes factor of a pair over the better one of its causes, from which it is a hypothesis
    """

    fitted: int = 6
    fitted_further: int = 4
    promising: float = 6.0
    leaders: int = 3
    with_list_errors: int = 5
    list_errors_fitted: int = 3
    optima: int = 2
    noise_scores: tuple[float, ...] = (-1.5, 0.0, 1.5)
    gain: float = 3.0


PAIRS: Final = PairSettings()


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
    known: LogDensity
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
        search.fit([search.plain, *map(_Point.of, of_pairing)], PAIRS.fitted, PAIRS.promising)
        return
    if explaining:
        search.fit([_Point.of(t) for t in explaining], PAIRS.fitted, PAIRS.promising)
        return
    search.fit([search.plain, *search.medians, *map(_Point.of, of_pairing)], PAIRS.fitted)
    search.fit_list_errors([(h, plates) for h, plates in hypotheses if is_repairing(h)])
    before = None
    while (best := search.best()) is not None and best is not before:
        if is_time_up():
            scan.is_cut_short = True
            cut_short("cut_pairs_of_the_best")
            break
        before = best
        search.fit([search.about(best)], PAIRS.fitted_further)


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
        return list(leaders.values())[: PAIRS.leaders]

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
            for t in list(leaders.values())[: PAIRS.with_list_errors]
            if (pairs := self._with_errors(t, errors))
        ]
        if items and is_time_up():
            scan.is_cut_short = True
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
        for s in PAIRS.noise_scores:
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
        fits = repairings(alone, comparisons, t.marginal.z[: PAIRS.optima], sizes)
        value = [fit.log_density + np.log(pair.prior) for fit, pair in zip(fits, pairs, strict=True)]
        best = np.argsort(value, kind="stable")[::-1][: PAIRS.list_errors_fitted]
        return [
            (int(i), with_misreading(comparisons[i], comparisons[i].carried(alone, fits[i].z))) for i in best
        ]
    return []


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
    pairs: bool = True,
    executor: Executor | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
    so_far: Callable[[Mapping[str, float]], None] = lambda shares: None,
) -> Weighed:
    """Marginal likelihoods of hypotheses, each about some of the plates, none first, and of pairs.

    Where none is not the most probable of all, the best pairs of causes are tested too.

    executor : where hypotheses are fitted, ``None`` for this process
    so_far : is told the shares of the causes among the hypotheses that are tested
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
    if pairs and ranked(scan.tested)[0].hypothesis.cause != NONE:
        if is_time_up():
            scan.is_cut_short = True
            cut_short("cut_pairs")
        else:
            add_pairs(scan, hypotheses)
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
    log_none = float(logsumexp([t.marginal.log_evidence for t in order if t.hypothesis.cause == NONE]))
    tested = [replace(t, log_bayes_factor=t.marginal.log_evidence - log_none) for t in _with_shares(order)]
    prior = prior_by_cause([h for h, _ in hypotheses])
    not_tested = tuple(dict.fromkeys(scan.not_tested))
    return Weighed(_credited(tested), not_tested, prior, scan.is_cut_short)


def _with_shares(order: Sequence[Tested]) -> list[Tested]:
    """Hypotheses, the best first, with the share of each in prior times evidence as its probability."""
    share = np.exp(np.array([t.log_weight for t in order]) - order[0].log_weight)
    share /= share.sum()
    return [replace(t, probability=float(p)) for t, p in zip(order, share, strict=True)]


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
            if evidence[t.key] - evidence[tested[best].key] < PAIRS.gain:
                kept[best] += kept.pop(i)
    order = sorted(kept, key=lambda i: -kept[i])
    return tuple(replace(tested[i], probability=kept[i]) for i in order)
