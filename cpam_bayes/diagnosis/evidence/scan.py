"""Hypotheses tested one by one, each fitted from many starts, none first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from cpam_bayes.diagnosis.evidence.comparison import Comparison
from cpam_bayes.diagnosis.evidence.marginal import Marginal, laplace_marginal, sampled_marginal
from cpam_bayes.diagnosis.evidence.optima import LOG2_DRAWS
from cpam_bayes.diagnosis.evidence.repairing import repairings
from cpam_bayes.diagnosis.evidence.shifts import ShiftTable, shift_table
from cpam_bayes.diagnosis.fitting import SCATTER, PlateCase, comparison_of, effect_columns
from cpam_bayes.diagnosis.hypotheses import NONE, Hypothesis
from cpam_bayes.effects import ListChange
from cpam_bayes.mechanics.modes import RigidBodyError

Array = NDArray[Any]

# The plain model explains a list whose misfit is no larger with more than this probability.
_EXPLAINED = 1e-3
# Hypotheses whose optima lie so many nats below the best are not integrated over open sizes.
_HOPELESS_NATS = 14.0
# Draws of the prior, log2, that the plain model is fitted from.
_LOG2_PLAIN = 11
# Optima of the plain model that others start from too.
_PLAIN_OPTIMA = 4
# Pairings within so many nats of the best are fitted by themselves, at most so many of a cause.
_NEAR_PAIRINGS, _MOST_PAIRINGS = 25.0, 12
# Hypotheses within so many nats of the most probable one are sampled; those over several sizes that the data
# leave open need it from further off. Within _IN_SIGHT fewer points, 2^_LOG2_FEW, correct Laplace's method.
_NEAR, _NEAR_SCATTERED, _IN_SIGHT, _LOG2_FEW = 4.0, 10.0, 10.0, 7


@dataclass(frozen=True, slots=True)
class Tested:
    """One hypothesis with its marginal likelihood.

    plates : numbers of the plates that have it; all of them where they share it
    probability : among all that were tested
    log_bayes_factor : against none
    shift : of the log frequencies, with the constants of the plain model; ``None`` where the list is paired
        otherwise
    """

    hypothesis: Hypothesis
    plates: tuple[int, ...]
    marginal: Marginal
    probability: float = 0.0
    log_bayes_factor: float = 0.0
    shift: ShiftTable | None = None

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
    left_out: int | None = None,
    known: Array | None = None,
    log2_draws: int = LOG2_DRAWS,
    least: float = -np.inf,
) -> Marginal:
    """Marginal likelihood of one hypothesis about some plates.

    none : the plain model, whose optima are starts
    left_out : a frequency to leave out
    known : (s, n) further starts
    log2_draws, least : as in ``laplace_marginal``
    """
    comparison = comparison_of(cases, about(cases, hypothesis, plates), scatter=scatter)
    if left_out is not None:
        comparison = replace(comparison, listed=comparison.listed.without(left_out), left_out=left_out)
    starts = plain_starts(comparison, none)
    if known is not None:
        starts = np.concatenate((known, starts))
    sizes = effect_columns(comparison, hypothesis)
    return laplace_marginal(comparison, sizes, starts, log2_draws=log2_draws, least=least)


def plain_starts(comparison: Comparison, none: Marginal | None) -> Array:
    """Scores (s, n) of the plain model's optima and of the prior medians, zero for what it lacks."""
    n = comparison.parameters.size
    if none is None:
        return np.zeros((1, n))
    names = none.comparison.parameters.names
    starts = []
    for z in none.z[:_PLAIN_OPTIMA]:
        at = dict(zip(names, z, strict=True))
        starts.append([at.get(name, 0.0) for name in comparison.parameters.names])
    return np.array([*starts, [0.0] * n])


@dataclass(slots=True)
class Scan:
    """Hypotheses as they are tested, none first.

    is_explained : whether the plain model explains the lists
    best : largest log of prior times evidence so far
    """

    cases: Sequence[PlateCase]
    scatter: float
    tested: list[Tested] = field(default_factory=list)
    not_tested: list[str] = field(default_factory=list)
    is_explained: bool = False
    best: float = -np.inf

    @property
    def none(self) -> Marginal:
        """The plain model."""
        return self.tested[0].marginal

    def begin(self, hypothesis: Hypothesis, plates: tuple[int, ...]) -> None:
        """The plain model, whose optima are starts of all others."""
        marginal = marginal_of(self.cases, hypothesis, plates, scatter=self.scatter, log2_draws=_LOG2_PLAIN)
        self.tested.append(Tested(hypothesis, plates, sampled_marginal(marginal)))
        self.best = self.tested[0].log_weight
        self.is_explained = misfit_probability(self.none) > _EXPLAINED

    def test(self, hypothesis: Hypothesis, plates: tuple[int, ...], known: Array | None = None) -> None:
        """Fit a hypothesis from many starts; where it cannot be tested that is noted.

        Where the plain model explains the lists, what is wrong is faint and lies next to it.
        """
        try:
            marginal = marginal_of(
                self.cases,
                hypothesis,
                plates,
                scatter=self.scatter,
                none=self.none,
                known=known,
                log2_draws=0 if self.is_explained or known is not None else LOG2_DRAWS,
                least=self.best - float(np.log(hypothesis.prior)) - _HOPELESS_NATS,
            )
            self.best = max(self.best, float(np.log(hypothesis.prior)) + marginal.log_evidence)
            self.tested.append(
                Tested(hypothesis, plates, marginal, shift=self.shift_of(hypothesis, marginal))
            )
        except RigidBodyError:
            self.not_tested.append(
                f"{hypothesis.cause} {hypothesis.variant}".rstrip()
                + ": over its prior the plate cannot be told from a rigid body; left out"
            )

    def test_pairings(self, variants: Sequence[tuple[Hypothesis, tuple[int, ...]]]) -> None:
        """Fit what is wrong with a list alone: all pairings at once, then the promising ones."""
        if not variants:
            return
        comparisons = [
            comparison_of(self.cases, about(self.cases, h, plates), scatter=self.scatter)
            for h, plates in variants
        ]
        fits = repairings(self.none.comparison, comparisons, self.none.z[:2])
        value = np.array([fit.log_density for fit in fits])
        order = np.argsort(-value, kind="stable")
        kept: dict[str, int] = {}
        for i in order:
            hypothesis, plates = variants[i]
            number = kept.get(hypothesis.cause, 0)
            if number and (value[i] < value[order[0]] - _NEAR_PAIRINGS or number == _MOST_PAIRINGS):
                continue
            kept[hypothesis.cause] = number + 1
            known = _with_misreading(comparisons[i], self.none.comparison, fits[i].z)
            sizes = effect_columns(comparisons[i], hypothesis)
            starts = np.concatenate((known, plain_starts(comparisons[i], self.none)[:1]))
            marginal = laplace_marginal(comparisons[i], sizes, starts, log2_draws=0)
            shift = self.shift_of(hypothesis, marginal)
            self.best = max(self.best, float(np.log(hypothesis.prior)) + marginal.log_evidence)
            self.tested.append(Tested(hypothesis, plates, marginal, shift=shift))

    def shift_of(self, hypothesis: Hypothesis, marginal: Marginal) -> ShiftTable | None:
        """The shifts of a hypothesis at the plain model's optimum, if it has a size and the same pairing."""
        listed = hypothesis.listed
        if not marginal.sizes or listed.missed or listed.spurious is not None or len(hypothesis.records) != 1:
            return None
        names = self.none.comparison.parameters.names
        at = dict(zip(names, self.none.best, strict=True))
        middle = marginal.comparison.scores.to_x(np.zeros((1, marginal.comparison.parameters.size)))[0]
        x = np.array(
            [at.get(n, m) for n, m in zip(marginal.comparison.parameters.names, middle, strict=True)]
        )
        null = np.array([0.0 if p.null is None else p.null for p in hypothesis.parameters], dtype=float)
        return shift_table(marginal.comparison, marginal.sizes, x, null)

    def sampled(self, t: Tested, best: float) -> Tested:
        """A hypothesis by importance sampling, if it is near enough to the best."""
        within = _NEAR_SCATTERED if t.marginal.is_scattered else _NEAR
        if t.marginal.is_sampled:
            return t
        if t.log_weight >= best - within or t.hypothesis.cause == NONE:
            return replace(t, marginal=sampled_marginal(t.marginal))
        if t.log_weight >= best - _IN_SIGHT:
            return replace(t, marginal=sampled_marginal(t.marginal, _LOG2_FEW))
        return t


def misfit_probability(marginal: Marginal) -> float:
    """Probability of a misfit as large at the optimum, by chi-squared with the degrees of freedom left.

    An inferred noise has the largest amplitude of its prior's central 95 %: more is misfit.
    """
    comparison = marginal.comparison
    z = marginal.z[:1].copy()
    n_model = comparison.model.parameters.size
    z[:, n_model:] = np.minimum(z[:, n_model:], 1.96)
    x = comparison.scores.to_x(z)
    f, slope = comparison.predict(x, jacobian=True)
    assert slope is not None
    sigma = np.sqrt(comparison.variance(x)[0])
    a = slope[0, :, :n_model] * comparison.scores.slope(x, z)[0, :n_model] / sigma[:, None]
    values = np.linalg.eigvalsh(a.T @ a)
    used = float(np.sum(values / (values + 1.0)))
    t = float(np.sum(((comparison.listed.frequencies - f[0]) / sigma) ** 2))
    return float(chi2.sf(t, max(len(sigma) - used, 1.0)))


def is_repairing(hypothesis: Hypothesis) -> bool:
    """Whether a hypothesis is about the frequency list alone."""
    return hypothesis.listed != ListChange() and not hypothesis.effects


def _with_misreading(comparison: Comparison, plain: Comparison, z: Array) -> Array:
    """Starts (s, n) of a pairing from scores (s, n_plain) of the plain parameters.

    A misread frequency is off by what the model lacks.
    """
    starts = np.zeros((len(z), comparison.parameters.size))
    columns = [comparison.parameters.names.index(name) for name in plain.parameters.names]
    starts[:, columns] = z
    at = 0
    for part in comparison.model.parts:
        if part.misread is not None:
            i, column = part.misread
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
    """A hypothesis for all plates, or for each of those that it is about."""
    return hypothesis if len(plates) == len(cases) else dict.fromkeys(plates, hypothesis)
