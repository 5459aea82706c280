"""Hypotheses tested one by one, each fitted from many starts, none first."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from scipy.stats import chi2

from cpam_bayes.diagnosis.cases import is_incomplete
from cpam_bayes.diagnosis.comparison import (
    SCATTER,
    PlateCase,
    comparison_of,
    effect_columns,
    smooth_columns,
    with_form_error,
)
from cpam_bayes.diagnosis.evidence.marginal import (
    Marginal,
    ShiftTable,
    Tested,
    best_by_cause,
    laplace_marginal,
    ranked,
    shift_table,
)
from cpam_bayes.diagnosis.evidence.pairing_search import (
    Cases,
    PairedLists,
    in_order,
    key_of,
    pairing_at,
    plain_pairings,
    recounted,
    repairings,
)
from cpam_bayes.diagnosis.evidence.sampled import sampled_marginal, shared_out
from cpam_bayes.diagnosis.hypotheses import NONE, OTHER, Hypothesis, with_leftover
from cpam_bayes.effects import ListChange
from cpam_bayes.forward_model.composed import ComposedModel
from cpam_bayes.inference.laplace import SEARCH
from cpam_bayes.inference.log_density import CorrelatedDensity
from cpam_bayes.mechanics.modes import RigidBodyError
from cpam_bayes.mechanics.problem import Array
from cpam_bayes.running import cut_short, is_time_up, time_limit

# A hypothesis explains a list if a misfit as large has more than this probability.
EXPLAINED = 1e-3
# Hypotheses whose optima lie so many nats below the best are not integrated over open sizes.
_HOPELESS_NATS = 14.0
# Hypotheses of one round, which are fitted in parallel with the same knowledge of the others.
_ROUND = 8
# Draws of the prior, log2, from which the plain model is fitted.
_LOG2_PLAIN = 11
# Optima of the plain model that others start from too.
_PLAIN_OPTIMA = 4
# Leading causes, pairs included, that are also tested with a discrepancy.
_BESIDE = 10
# A hypothesis is not tested with a discrepancy where a larger misfit has more than this probability.
_NOTHING_LEFT = 0.05
# Optima from which a fit with form errors starts.
_FORM_STARTS = 4
# Score at which a one-sided size is nearly zero, and scores of an effect's size with which fits start at
# the plain model's optimum: far away constants and effect may compensate each other.
_FAINT, _MOVED = -3.0, (-2.0, -1.0, 1.0, 2.0)
# Pairings within so many nats of the best are fitted individually, at most so many of a cause.
_NEAR_PAIRINGS, _MOST_PAIRINGS = 25.0, 12
# For incomplete lists: turns of fitting a hypothesis and pairing at its optimum; nats below the best within
# which a hypothesis gets all pairings that the plain model suggests; optima of one pairing from which another
# starts; nats below the best of a hypothesis beyond which its pairings are dropped.
_TURNS, _NEAR_ALL_PAIRINGS, _OTHER_PAIRINGS_OPTIMA, _NEGLIGIBLE_PAIRING = 3, 10.0, 3, 12.0


def marginal_of(
    cases: Sequence[PlateCase],
    hypothesis: Hypothesis,
    plates: tuple[int, ...],
    *,
    scatter: float = SCATTER,
    none: Marginal | None = None,
    left_out: int | None = None,
    model: ComposedModel | None = None,
    known: Array | None = None,
    log2_draws: int = SEARCH.log2_draws,
    least: float = -np.inf,
) -> Marginal:
    """Marginal likelihood of one hypothesis about some plates.

    none : the plain model, whose optima are starts
    left_out : a frequency to leave out
    model : used instead of the hypothesis's own, as accurate where it is evaluated
    known : (s, n) further starts
    log2_draws, least : as in ``laplace_marginal``
    """
    comparison = comparison_of(cases, about(cases, hypothesis, plates), scatter=scatter)
    if model is not None:
        comparison = replace(comparison, model=model)
    if left_out is not None:
        comparison = replace(comparison, listed=comparison.listed.without(left_out), left_out=left_out)
    starts = plain_starts(comparison, none)
    if known is not None:
        starts = np.concatenate((known, starts))
    elif none is not None:
        starts = np.concatenate((starts, _moved(starts[0], effect_columns(comparison, hypothesis)[:1])))
    return fitted(comparison, hypothesis, starts, log2_draws=log2_draws, least=least)


def fitted(
    comparison: CorrelatedDensity,
    hypothesis: Hypothesis,
    starts: Array,
    *,
    log2_draws: int = 0,
    least: float = -np.inf,
) -> Marginal:
    """Marginal likelihood from starts (s, n), with the form errors of the effects at the optimum."""
    sizes, smooth = effect_columns(comparison, hypothesis), smooth_columns(comparison, hypothesis)
    marginal = laplace_marginal(comparison, sizes, starts, smooth=smooth, log2_draws=log2_draws, least=least)
    rough = with_form_error(comparison, hypothesis, marginal.best)
    if rough is comparison:
        return marginal
    return laplace_marginal(rough, sizes, marginal.z[:_FORM_STARTS], smooth=smooth, log2_draws=0, least=least)


def plain_starts(comparison: CorrelatedDensity, none: Marginal | None) -> Array:
    """Scores (s, n) of the plain model's optima and of the prior medians, zero for parameters it lacks.

    One-sided sizes are also started near zero: their medians may be gross errors.
    """
    medians = np.zeros((1, comparison.parameters.size))
    if none is None:
        return medians
    plain = comparison.carried(none.comparison, none.z[:_PLAIN_OPTIMA])
    starts = [plain, medians]
    known = none.comparison.parameters.names
    one_sided = [
        i
        for i, p in enumerate(comparison.parameters.parameters)
        if p.name not in known and p.null is not None and p.null <= p.prior.lower
    ]
    if one_sided:
        faint = plain[:1].copy()
        faint[:, one_sided] = _FAINT
        starts.append(faint)
    return np.concatenate(starts)


def _moved(start: Array, size: tuple[int, ...]) -> Array:
    """Copies (s, n) of a start (n,) with other sizes; none where the hypothesis has no size."""
    moved = np.repeat(start[None], len(_MOVED) if size else 0, axis=0)
    moved[:, list(size)] = np.array(_MOVED)[: len(moved), None]
    return moved


@dataclass(frozen=True, slots=True)
class Trial:
    """A hypothesis to be tested.

    known, cases : known starts, and their pairing
    """

    hypothesis: Hypothesis
    plates: tuple[int, ...]
    known: Array | None = None
    cases: Cases = ()


@dataclass(frozen=True, slots=True)
class Tried:
    """The outcome of a trial.

    tested : with every pairing that carries probability; empty where it could not be tested
    best : largest log of prior times evidence so far
    not_tested : the reason
    """

    tested: tuple[Tested, ...]
    best: float
    not_tested: tuple[str, ...] = ()


@dataclass(slots=True)
class Scan:
    """Hypotheses tested so far, none first.

    executor : where they are fitted, ``None`` for this process
    is_rough : whether the plain model too is left to Laplace's method
    is_explained : whether the plain model explains the lists
    best : largest log of prior times evidence so far
    is_cut_short : whether time was up before all were tested
    pairings, seeds : of incomplete lists, for the plain model, and those with which other hypotheses start
    """

    cases: Sequence[PlateCase]
    scatter: float
    executor: Executor | None = None
    is_rough: bool = False
    tested: list[Tested] = field(default_factory=list)
    not_tested: list[str] = field(default_factory=list)
    is_explained: bool = False
    best: float = -np.inf
    is_cut_short: bool = False
    pairings: tuple[PairedLists, ...] = ()
    seeds: tuple[PairedLists, ...] = ()

    @property
    def none(self) -> Marginal:
        """The plain model, with its most probable pairing."""
        return self.tested[0].marginal

    @property
    def plain_cases(self) -> Cases:
        """The plates with their most probable pairing under the plain model."""
        return self.tested[0].cases or tuple(self.cases)

    @property
    def is_incomplete(self) -> bool:
        """Whether a list is incomplete, so that pairings are summed over."""
        return any(is_incomplete(case) for case in self.cases)

    def begin(self, hypothesis: Hypothesis, plates: tuple[int, ...]) -> None:
        """Fit the plain model, whose optima are starts for all others."""
        self.pairings, self.seeds = plain_pairings(self.cases, self.scatter)
        for k, lists in enumerate(self.pairings):
            marginal = marginal_of(
                lists.cases,
                hypothesis,
                plates,
                scatter=self.scatter,
                known=lists.z,
                log2_draws=0 if k else _LOG2_PLAIN,
            )
            cases = lists.cases if self.is_incomplete else ()
            marginal = marginal if self.is_rough else sampled_marginal(marginal)
            self.tested.append(Tested(hypothesis, plates, marginal, cases=cases))
        self.tested = ranked(self.tested)
        self.best = self.tested[0].log_weight
        has_false_peaks = any((case.modes < 0).any() for case in self.plain_cases)
        self.is_explained = misfit_probability(self.none) > EXPLAINED and not has_false_peaks

    def test(self, trials: Sequence[Trial], progress: Callable[[int], None] = lambda done: None) -> None:
        """Fit hypotheses from many starts, round by round, and note those that cannot be tested.

        Only earlier rounds decide which are hopeless: the answer does not depend on which fit ends first.

        progress : called with the number of trials that are done
        """
        # the slowest form the last round and come first in it, so that all workers stay busy
        trials = sorted(trials, key=lambda trial: any(e.is_anywhere for e in trial.hypothesis.effects))
        for trial in trials:
            if not is_time_up():
                self._built(trial)
        n = len(trials)
        for start, stop in pairwise((0, *range(n % _ROUND or _ROUND, n + 1, _ROUND))):
            if is_time_up():
                self._end_early(trials[start:])
                break
            self._test_round(trials[start:stop][::-1], progress, start)

    def _test_round(
        self, trials: Sequence[Trial], progress: Callable[[int], None] = lambda done: None, before: int = 0
    ) -> None:
        scan = replace(self, tested=self.tested[:1], not_tested=[], executor=None)
        items = [(scan, trial) for trial in trials]

        def count(done: int) -> None:
            progress(before + done)

        for tried in shared_out(Scan.tried, self.cases, items, self.executor, common=scan, progress=count):
            self.tested += tried.tested
            self.not_tested += tried.not_tested
            self.best = max(self.best, tried.best)

    def _end_early(self, left: Sequence[Trial]) -> None:
        """Note hypotheses that are not tested because time is up; other is tested all the same."""
        skipped = [trial.hypothesis for trial in left if trial.hypothesis.cause != OTHER]
        if skipped:
            self.is_cut_short = True
            self.not_tested += [f"{h.cause} {h.variant}".rstrip() + ": time was up" for h in skipped]
            causes = tuple(dict.fromkeys(h.cause for h in skipped))
            cut_short("cut_hypotheses", count=len(skipped), causes=causes)
        with time_limit(None):
            self._test_round([trial for trial in left if trial.hypothesis.cause == OTHER])

    def _built(self, trial: Trial) -> None:
        """Build the models that a trial needs, so that workers share them."""
        for i in trial.plates:
            if trial.hypothesis.other_material:
                self.cases[i].of_other_material()
            for effect in trial.hypothesis.effects:
                if effect.change is not None:
                    with suppress(RigidBodyError):  # it is said where the hypothesis is tested
                        self.cases[i].with_effect(effect)

    def tried(self, trial: Trial) -> Tried:
        """Fit a hypothesis from many starts."""
        hypothesis, plates = trial.hypothesis, trial.plates
        first = (PairedLists(trial.cases),) if trial.cases else self.seeds
        try:
            fits = {lists.key: self._fitted(hypothesis, plates, lists, trial.known) for lists in first}
            if self.is_incomplete:
                self._add_pairings(hypothesis, plates, fits)
        except RigidBodyError:
            why = (
                f"{hypothesis.cause} {hypothesis.variant}".rstrip()
                + ": over its prior the plate cannot be told from a rigid body; left out"
            )
            return Tried((), self.best, (why,))
        best = max(fits.values(), key=lambda t: t.log_weight)
        near = [t for t in fits.values() if t.log_weight > best.log_weight - _NEGLIGIBLE_PAIRING]
        shift = self.shift_of(hypothesis, best)
        tested = tuple(replace(t, shift=shift if t is best else None) for t in near)
        return Tried(tested, max(self.best, best.log_weight))

    def _fitted(
        self,
        hypothesis: Hypothesis,
        plates: tuple[int, ...],
        lists: PairedLists,
        known: Array | None,
        *,
        few: bool = False,
    ) -> Tested:
        """Fit a hypothesis with one pairing of the lists; few : only from known starts."""
        none = self.none
        if lists.z is not None:
            none = replace(none, z=np.concatenate((lists.z, none.z[:1])))
        marginal = marginal_of(
            lists.cases,
            hypothesis,
            plates,
            scatter=self.scatter,
            none=none,
            known=known,
            log2_draws=0 if few or self.is_explained else SEARCH.log2_draws,
            least=self.best - float(np.log(hypothesis.prior)) - _HOPELESS_NATS,
        )
        cases = recounted(lists.cases, about(self.cases, hypothesis, plates), marginal.best, self.scatter)
        log_prior, counted = (sum(c.log_pairing for c in of) for of in (lists.cases, cases))
        if counted != log_prior:
            listed = marginal.comparison.listed
            listed = replace(listed, log_constant=listed.log_constant + counted - log_prior)
            marginal = replace(
                marginal,
                comparison=replace(marginal.comparison, listed=listed),
                log_evidence=marginal.log_evidence + counted - log_prior,
            )
        return self._as_tested(hypothesis, plates, marginal, cases)

    def _as_tested(
        self, hypothesis: Hypothesis, plates: tuple[int, ...], marginal: Marginal, cases: Cases
    ) -> Tested:
        """Tested hypothesis, with its own pairing and the plain model's where lists are incomplete."""
        if not self.is_incomplete:
            return Tested(hypothesis, plates, marginal)
        as_plain = self.density(hypothesis, plates, self.plain_cases)
        return Tested(hypothesis, plates, marginal, cases=cases, as_plain=as_plain)

    def _add_pairings(
        self, hypothesis: Hypothesis, plates: tuple[int, ...], fits: dict[bytes, Tested]
    ) -> None:
        """Add the most probable pairings at the optima of the hypothesis; near the top, all others."""
        of_plates = about(self.cases, hypothesis, plates)
        incomplete = [i for i, case in enumerate(self.cases) if is_incomplete(case)]
        for _ in range(_TURNS):
            order = ranked(list(fits.values()))
            proposed = [
                pairing_at(t.cases, of_plates, i, t.marginal.best, self.scatter)
                for t in order[:2]
                for i in incomplete
            ]
            # a list without any true mode leaves nothing to fit
            proposed = [cases for cases in proposed if all((case.modes >= 0).any() for case in cases)]
            new = {key_of(cases): cases for cases in proposed if key_of(cases) not in fits}
            for key, cases in new.items():
                z = order[0].marginal.z[:_OTHER_PAIRINGS_OPTIMA]
                fits[key] = self._fitted(hypothesis, plates, PairedLists(cases), z, few=True)
            if not new:
                break
        best = ranked(list(fits.values()))[0]
        if best.log_weight > self.best - _NEAR_ALL_PAIRINGS:
            for lists in self.pairings:
                if lists.key not in fits:
                    z = best.marginal.z[:_OTHER_PAIRINGS_OPTIMA]
                    fits[lists.key] = self._fitted(hypothesis, plates, lists, z, few=True)

    def test_pairings(self, variants: Sequence[tuple[Hypothesis, tuple[int, ...]]]) -> None:
        """Fit errors of the list alone: all pairings at once, then the promising ones."""
        if not variants:
            return
        paired = list({lists.key: lists.cases for lists in (*self.pairings, *self.seeds)}.values())
        entries = [(h, plates, cases) for h, plates in variants for cases in paired]
        comparisons = [self.density(*entry) for entry in entries]
        plain = self.none.comparison
        if self.is_incomplete:
            plain = self.density(self.tested[0].hypothesis, self.tested[0].plates, in_order(self.cases))
        fits = repairings(plain, comparisons, self.none.z[:2])
        value = np.array([fit.log_density for fit in fits])
        order = np.argsort(-value, kind="stable")
        kept: dict[str, int] = {}
        for i in order:
            hypothesis, plates, cases = entries[i]
            number = kept.get(hypothesis.cause, 0)
            if number and (value[i] < value[order[0]] - _NEAR_PAIRINGS or number == _MOST_PAIRINGS):
                continue
            kept[hypothesis.cause] = number + 1
            known = with_misreading(comparisons[i], comparisons[i].carried(plain, fits[i].z))
            starts = np.concatenate((known, plain_starts(comparisons[i], self.none)[:1]))
            marginal = fitted(comparisons[i], hypothesis, starts)
            t = self._as_tested(hypothesis, plates, marginal, cases)
            self.best = max(self.best, t.log_weight)
            self.tested.append(replace(t, shift=self.shift_of(hypothesis, t)))

    def test_leftovers(self) -> None:
        """Fit the best variants of leading causes that leave a misfit, together with a discrepancy."""
        if self.is_explained:
            return
        leading = best_by_cause(ranked(self.tested))
        leading.pop(NONE, None)
        other = leading.pop(OTHER, None)
        if other is None:
            return
        scan = replace(self, tested=self.tested[:1], not_tested=[], executor=None)
        items = [
            (scan, t, other.marginal)
            for t in list(leading.values())[:_BESIDE]
            if misfit_probability(t.marginal) < _NOTHING_LEFT
        ]
        beside = {
            t.key: found
            for (_, t, _), found in zip(
                items, shared_out(Scan.leftovers, self.cases, items, self.executor, common=scan), strict=True
            )
            if found
        }
        self.tested = [
            replace(t, hypothesis=with_leftover(t.hypothesis)[0]) if t.key in beside else t
            for t in self.tested
        ]
        for found in beside.values():
            self.tested += found
            self.best = max(self.best, *(t.log_weight for t in found))

    def leftovers(self, t: Tested, other: Marginal) -> list[Tested]:
        """A tested hypothesis with each form of discrepancy, except where the plate then has no modes.

        other : the plain model with a discrepancy, whose optima are further starts
        """
        found = []
        for hypothesis in with_leftover(t.hypothesis)[1]:
            comparison = self.density(hypothesis, t.plates, t.cases)
            at_cause = comparison.carried(t.marginal.comparison, t.marginal.z[:1])
            starts = np.concatenate((at_cause, plain_starts(comparison, other)))
            least = self.best - float(np.log(hypothesis.prior)) - _HOPELESS_NATS
            with suppress(RigidBodyError):
                marginal = fitted(comparison, hypothesis, starts, least=least)
                found.append(replace(t, hypothesis=hypothesis, marginal=marginal, shift=None))
        return found

    def density(
        self, hypothesis: Hypothesis, plates: tuple[int, ...], cases: Cases = ()
    ) -> CorrelatedDensity:
        """Log density of the lists under a hypothesis about some plates, paired as in ``cases`` if given."""
        of_plates = about(self.cases, hypothesis, plates)
        return comparison_of(cases or self.cases, of_plates, scatter=self.scatter)

    def shift_of(self, hypothesis: Hypothesis, t: Tested) -> ShiftTable | None:
        """Shifts by a hypothesis at the plain model's optimum, if it is about the plate or has a size.

        ``None`` where it changes the pairing of modes.
        """
        listed, comparison = hypothesis.listed, t.as_plain or t.marginal.comparison
        sizes = t.marginal.sizes
        is_known = bool(sizes or hypothesis.effects) and not listed.changes_pairing
        if not is_known or len(hypothesis.records) != 1:
            return None
        table = shift_table(comparison, hypothesis.parameters, sizes, self.none)
        return table if len(table.scores) else None


def misfit_probability(marginal: Marginal) -> float:
    """p-value of the misfit at the optimum, by chi-squared with the remaining degrees of freedom.

    An inferred noise is at most at the upper end of its prior's central 95 %: more is misfit.
    """
    comparison = marginal.comparison
    z = marginal.z[:1].copy()
    n_model = comparison.model.parameters.size
    z[:, n_model:] = np.minimum(z[:, n_model:], 1.96)
    x = comparison.scores.to_x(z)
    f, slope = comparison.predict(x, jacobian=True)
    assert slope is not None
    root = np.linalg.inv(np.linalg.cholesky(comparison.covariance(x)[0]))
    a = root @ comparison.scores.by_score(comparison.residual_slopes(f, slope), x, z)[0, :, :n_model]
    values = np.linalg.eigvalsh(a.T @ a)
    used = float(np.sum(values / (values + 1.0)))
    t = float(np.sum((root @ comparison.residuals(f)[0]) ** 2))
    return float(chi2.sf(t, max(len(root) - used, 1.0)))


def is_repairing(hypothesis: Hypothesis) -> bool:
    """Whether a hypothesis is about the frequency list alone."""
    return hypothesis.listed != ListChange() and not hypothesis.effects


def with_misreading(comparison: CorrelatedDensity, starts: Array) -> Array:
    """Starts (s, n) of a pairing, with the misreadings set to the residuals of their frequencies."""
    starts, at = starts.copy(), 0
    for part in comparison.model.parts:
        for i, column in part.misread:
            x = comparison.scores.to_x(starts)
            x[:, column] = 0.0
            f, _ = comparison.predict(x)
            x[:, column] = np.clip(
                comparison.listed.frequencies[at + i] / f[:, at + i] - 1.0,
                comparison.parameters.lower[column],
                comparison.parameters.upper[column],
            )
            starts[:, column] = comparison.scores.to_z(x)[:, column]
        at += len(part.modes)
    return starts


def about(
    cases: Sequence[PlateCase], hypothesis: Hypothesis, plates: tuple[int, ...]
) -> Hypothesis | dict[int, Hypothesis]:
    """A hypothesis for all plates, or for each of those it concerns."""
    return hypothesis if len(plates) == len(cases) else dict.fromkeys(plates, hypothesis)
