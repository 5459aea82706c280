"""Which second cause may act beside a leading one: ranked in closed form at the leader's optimum.

About the optimum of a leading hypothesis the log frequencies are linear in the scores of its parameters, so
that constants and the leader's size are integrated in closed form at every node of a second effect's sizes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from cpam_bayes.diagnosis.evidence.comparison import Comparison, kept_of
from cpam_bayes.diagnosis.evidence.marginal import Marginal
from cpam_bayes.diagnosis.evidence.scan import Scan, Trial, about
from cpam_bayes.diagnosis.evidence.shifts import shift_table
from cpam_bayes.diagnosis.evidence.tested import Tested, ranked
from cpam_bayes.diagnosis.fitting import comparison_of, effect_columns
from cpam_bayes.diagnosis.hypotheses import NONE, OTHER, PAIR, Hypothesis, go_together, pair_scale, paired
from cpam_bayes.mechanics.modes import RigidBodyError

Array = NDArray[Any]

# Leading hypotheses that get a second cause, and pairs that are fitted.
_LEADERS, _FITTED = 3, 6
# Pairs that promise less than this, nats below the best hypothesis, are not fitted.
_PROMISING = 6.0
# Scores of an inferred noise at which second causes are ranked.
_NOISE_SCORES = (-1.5, 0.0, 1.5)


@dataclass(frozen=True, slots=True)
class _Linear:
    """A leader's lists about its optimum, in units of the noise with the parameters integrated.

    residual : (n_f,) whitened
    root : (n_f, n_f), root^T root the precision
    log_constant : log density without residual
    """

    residual: Array
    root: Array
    log_constant: float


def add_pairs(scan: Scan, singles: Sequence[Hypothesis]) -> None:
    """Fit the pairs of causes that may explain the lists better than one cause does."""
    scale = pair_scale(singles)
    order = ranked(scan.tested)
    best = order[0].log_weight
    single = [t for t in order if t.hypothesis.cause not in (NONE, OTHER) and t.hypothesis.family != PAIR]
    leaders = _leaders(single)
    seconds = _second_causes(single)
    promising: dict[tuple[str, ...], tuple[float, Hypothesis, Tested, Array]] = {}
    for leader in leaders:
        for second in seconds:
            if second.plates != leader.plates or not go_together(leader.hypothesis, second.hypothesis):
                continue
            pair = paired(leader.hypothesis, second.hypothesis, scale)
            try:
                gain, scores = _gain_of_second(scan, leader, second)
            except RigidBodyError:  # at the leader's constants the second one's plate buckles
                continue
            value = leader.marginal.log_evidence + gain + float(np.log(pair.prior))
            key = (*sorted(pair.cause.split(" + ")), leader.hypothesis.variant, second.hypothesis.variant)
            if key not in promising or value > promising[key][0]:
                promising[key] = (value, pair, leader, scores)
    chosen = sorted(promising.values(), key=lambda entry: -entry[0])[:_FITTED]
    fitted: set[frozenset[str]] = set()
    trials = []
    for value, pair, leader, scores in chosen:
        causes = frozenset((*pair.causes, pair.variant))
        if value < best - _PROMISING or causes in fitted:
            continue
        fitted.add(causes)
        known = np.concatenate((leader.marginal.z[0], scores))
        start = _in_order(scan, pair, leader, known)
        trials.append(Trial(pair, leader.plates, start, leader.cases))
    scan.test(trials)


def _leaders(single: Sequence[Tested]) -> list[Tested]:
    """The best variants of the leading causes."""
    leaders: dict[str, Tested] = {}
    for t in single:
        leaders.setdefault(t.hypothesis.cause, t)
    return list(leaders.values())[:_LEADERS]


def _second_causes(single: Sequence[Tested]) -> list[Tested]:
    """One variant of every cause on the plate or its frequencies, and every misreading."""
    best: dict[tuple[str, str], Tested] = {}
    for t in single:
        if t.hypothesis.effects:
            best.setdefault((t.hypothesis.cause, t.hypothesis.variant), t)
    return list(best.values())


def _gain_of_second(scan: Scan, leader: Tested, second: Tested) -> tuple[float, Array]:
    """Log evidence that a second cause adds at the leader's optimum, and its most probable scores (d,)."""
    marginal = leader.marginal
    comparison = second.marginal.comparison
    if leader.cases:
        of_second = about(scan.cases, second.hypothesis, leader.plates)
        comparison = comparison_of(leader.cases, of_second, scatter=scan.scatter)
    table = shift_table(comparison, second.hypothesis.parameters, second.marginal.sizes, marginal)
    shift = _as_listed(table.shift, leader, comparison)
    each = []
    for linear in _linear(marginal):
        whitened = linear.residual - shift @ linear.root.T
        log_p = linear.log_constant - 0.5 * np.sum(whitened**2, axis=1)
        each.append((log_p, linear.log_constant - 0.5 * float(linear.residual @ linear.residual)))
    with_it = logsumexp([log_p for log_p, _ in each], axis=0) + table.log_prior
    alone = logsumexp([plain for _, plain in each])
    return float(logsumexp(with_it) - alone), table.scores[int(np.argmax(with_it))]


def _as_listed(shift: Array, leader: Tested, second: Comparison) -> Array:
    """Shifts (k, n_f) of the second cause's list, for the frequencies that the leader's list keeps."""
    listed = leader.marginal.comparison.listed.frequencies
    if shift.shape[1] == len(listed):
        return shift
    kept = kept_of(second.listed.frequencies, listed)
    return shift[:, kept]


def _linear(marginal: Marginal) -> list[_Linear]:
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
        linear.append(_Linear(root @ residual, root, log_constant))
    return linear


def _in_order(scan: Scan, pair: Hypothesis, leader: Tested, known: Array) -> Array:
    """Starts (1, n) of a pair from the leader's scores, then those of the second cause."""
    comparison = comparison_of(scan.cases, about(scan.cases, pair, leader.plates), scatter=scan.scatter)
    of_leader = leader.marginal.comparison
    n = of_leader.parameters.size
    start = comparison.carried(of_leader, known[:n])
    columns = effect_columns(comparison, pair)
    start[list(columns[len(leader.hypothesis.parameters) :])] = known[n:]
    return start[None]
