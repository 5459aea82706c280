"""Fit of a model, or a mixture of models, to the lists: predictive checks, summary and gain."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from scipy.special import logsumexp
from scipy.stats import chi2

from cpam_bayes.diagnosis.comparison import PlateCase
from cpam_bayes.diagnosis.evidence.marginal import Marginal, Tested, prior_of
from cpam_bayes.diagnosis.evidence.sampled import about_draws, sampled_marginal, shared_out
from cpam_bayes.diagnosis.evidence.scan import marginal_of
from cpam_bayes.diagnosis.evidence.weighing import Weighed
from cpam_bayes.diagnosis.hypotheses import NONE, OTHER, Claim, Hypothesis
from cpam_bayes.effects.effect import MISREADINGS
from cpam_bayes.forward_model.composed import ComposedModel
from cpam_bayes.forward_model.preconditions import birge_ratio
from cpam_bayes.inference.log_density import CorrelatedDensity, kept_of
from cpam_bayes.inference.student_mixture import RELIABLE_K, effective_size, pareto_shape
from cpam_bayes.mechanics.problem import Array
from cpam_bayes.parameters import Parameter

# Normal scores over which the prior of an inferred repeatability is averaged, its tail down to 1e-6.
_SCORES = np.linspace(-5.0, 5.0, 41)
# Most quadrature nodes from which the parameters are refitted, and the least mass of such a node.
_MOST_STARTS, _NODE_FRACTION = 8, 1e-3


def explains(tested: Tested) -> float:
    """Predictive p-value of a hypothesis: probability of a larger misfit by noise alone.

    With T = r^T S^-1 r of the residuals at the most probable parameters, S the covariance of noise and
    discrepancy,

        p = integral of P(chi2_nu >= T(a)) p(a) da,  nu = n - tr H,

    over the repeatability a: the stated value, or the prior of an inferred one, not its posterior, which any
    misfit widens until it is explained (Gelman et al., Bayesian Data Analysis, 3rd ed., 6.3).
    H = A (A^T A + I)^-1 A^T projects onto what the parameters can fit within their priors, A the derivatives
    by their normal scores in units of the noise. The parameters are refitted for every a.
    """
    comparison = tested.marginal.comparison
    z = _starts(tested)
    if comparison.noise is None:
        amplitudes, weight = np.empty(0), np.ones(1)
    else:
        amplitudes = comparison.parameters.parameters[comparison.noise].prior.from_normal(_SCORES)
        weight = np.exp(-0.5 * _SCORES**2)
    misfit, effective = _refitted(comparison, z, amplitudes)
    p = np.asarray(chi2.sf(misfit, len(comparison.listed.frequencies) - effective))
    return float(weight @ p.max(axis=0) / weight.sum())


def misfit_beyond_noise(tested: Tested) -> float:
    """Relative root-mean-square misfit of a hypothesis beyond noise.

    An inferred noise counts with its prior median; a discrepancy is no noise.
    """
    comparison = tested.marginal.comparison
    z = tested.marginal.z[:1].copy()
    predicted, _ = comparison.predict(comparison.scores.to_x(z))
    z[:, comparison.model.parameters.size :] = 0.0
    noise = replace(comparison, discrepancy=None).variance(comparison.scores.to_x(z))
    f = comparison.listed.frequencies
    left = np.mean(((f - predicted) / f) ** 2) - np.mean(noise / f**2)
    return float(np.sqrt(max(left, 0.0)))


def leftover_of(members: Sequence[tuple[Tested, float]]) -> tuple[float, float]:
    """Weight of the hypotheses with an unexplained discrepancy, and its mean relative size."""
    fraction = size = 0.0
    for t, weight in members:
        if (column := t.marginal.comparison.discrepancy) is not None:
            fraction += weight
            size += weight * float(t.marginal.moments()[0][column])
    return fraction, size / fraction if fraction > 0.0 else 0.0


def within_stated_noise(tested: Tested, n_constants: int) -> bool:
    """Whether stated noise explains the residuals of a hypothesis, by `birge_ratio`.

    Only frequencies with stated noise count; a discrepancy is no noise.
    """
    marginal = tested.marginal
    listed = marginal.comparison.listed
    predicted, _ = marginal.comparison.predict(marginal.best[None])
    stated = listed.scale == 0.0
    covariance = np.diag(listed.variance) + (0.0 if listed.common is None else listed.common)
    root = np.linalg.cholesky(covariance[np.ix_(stated, stated)])
    white = np.linalg.solve(root, marginal.comparison.residuals(predicted)[0, stated])
    return birge_ratio(np.asarray(white, dtype=np.float64), n_constants) == 1.0


@dataclass(frozen=True, slots=True)
class PredictiveChecks:
    """Predictive p-values of hypotheses, each computed once.

    A hypothesis that is reweighed with other priors keeps its marginal likelihood, and so its p-value.
    """

    _known: dict[int, tuple[Marginal, float]] = field(default_factory=dict)

    def compute(
        self, cases: Sequence[PlateCase], tested: Sequence[Tested], executor: Executor | None
    ) -> None:
        """Compute the p-values of hypotheses in parallel on an executor."""
        for t, p in zip(tested, shared_out(explains, cases, [(t,) for t in tested], executor), strict=True):
            self._known[id(t.marginal)] = (t.marginal, p)

    def p_value(self, tested: Tested) -> float:
        """Predictive p-value of a hypothesis, as of `explains`."""
        key = id(tested.marginal)
        if key not in self._known:
            # kept with its p-value, so that no other marginal likelihood can get the same id
            self._known[key] = (tested.marginal, explains(tested))
        return self._known[key][1]


def _starts(tested: Tested) -> Array:
    """Scores (s, n) of the nodes that carry mass, the best first."""
    marginal = tested.marginal
    order = np.argsort(-marginal.weight, kind="stable")[:_MOST_STARTS]
    return marginal.z[[i for k, i in enumerate(order) if not k or marginal.weight[i] > _NODE_FRACTION]]


def _refitted(comparison: CorrelatedDensity, z: Array, amplitudes: Array) -> tuple[Array, Array]:
    """T and tr H, (s, a) each, for starts (s, n) at amplitudes (a,) of the noise.

    One Gauss-Newton step from each start; the better of start and step counts.
    """
    f = comparison.listed.frequencies
    a = max(len(amplitudes), 1)
    free = np.delete(np.arange(z.shape[1]), comparison.nuisance)
    x = comparison.scores.to_x(z)
    predicted, jacobian = comparison.predict(x, jacobian=True)
    assert jacobian is not None
    slopes = comparison.residual_slopes(predicted, jacobian)
    slope = comparison.scores.by_score(slopes, x, z)[:, :, free]
    at = np.repeat(x[:, None], a, axis=1)
    if comparison.noise is not None:
        at[:, :, [c for c in comparison.amplitudes if c >= 0]] = amplitudes[:, None]
    covariance = comparison.covariance(at.reshape(len(z) * a, -1))
    back = np.linalg.inv(np.linalg.cholesky(covariance)).reshape(len(z), a, len(f), len(f))
    scaled = back @ slope[:, None]
    residual = np.einsum("samn,sn->sam", back, comparison.residuals(predicted))
    fisher = np.swapaxes(scaled, 2, 3) @ scaled
    gradient = np.einsum("sami,sam->sai", scaled, residual) - z[:, None, free]
    inverse = np.linalg.inv(fisher + np.eye(len(free)))
    moved = np.repeat(z[:, None], a, axis=1)
    moved[:, :, free] += np.einsum("saij,saj->sai", inverse, gradient)
    # a step may lead where the plate buckles
    inside, new, _ = comparison.predict_inside(comparison.scores.to_x(moved.reshape(len(z) * a, -1)))
    again = np.full((len(z) * a, len(f)), np.inf)
    left = comparison.residuals(new)
    again[inside] = np.einsum("mij,mj->mi", back.reshape(-1, *back.shape[2:])[inside], left)
    before, after = np.sum(residual**2, axis=2), np.sum(again**2, axis=1).reshape(len(z), a)
    after = np.where(np.isfinite(after), after, np.inf)
    return np.minimum(before, after), np.einsum("saij,saji->sa", inverse, fisher)


# Draws from which a fit is summarised.
_DRAWS = 1024


@dataclass(frozen=True, slots=True)
class Fit:
    """The fit of one model to the lists.

    constants : name -> mean, sd, 2.5 % and 97.5 % quantile, SI.
    predicted, predicted_sd, sigma : of all frequencies, plate by plate, the first with the most probable
        common errors by sizes, mass, frequency scale and theory.
    rms : of the relative residuals. rms_as_stated : the same with sizes, mass and scale exactly as stated.
    p_value : posterior predictive, of the sum of squared standardised residuals.
    predictive_p : p-value against the stated repeatability, or the prior of an inferred one.
    log_evidence : prior-weighted over the members.
    log_evidence_error, k_hat : largest of the members that were sampled, ``nan`` where none was.
    draws : (d, n_constants), equally probable.
    parameters : name -> parameter.
    """

    constants: Mapping[str, tuple[float, float, float, float]]
    measured: Array
    predicted: Array
    predicted_sd: Array
    sigma: Array
    rms: float
    rms_as_stated: float
    p_value: float
    predictive_p: float
    log_evidence: float
    log_evidence_error: float
    k_hat: float
    draws: Array
    parameters: Mapping[str, Parameter]

    @property
    def standardised(self) -> Array:
        """Residuals over the standard deviations of noise and prediction together."""
        return np.asarray((self.measured - self.predicted) / np.hypot(self.sigma, self.predicted_sd))


def fit_of(members: Sequence[tuple[Tested, float]], whole: Array, checks: PredictiveChecks) -> Fit:
    """Fit of a mixture of hypotheses with the same constants; whole : all listed frequencies."""
    first = members[0][0].marginal.comparison
    sampled = [t for t, _ in members if np.isfinite(t.marginal.error)]
    model_names = first.model.parameters.names
    shared = [n for n in model_names if all(n in t.marginal.comparison.parameters.names for t, _ in members)]
    # with several plates the size of a cause is named after its plate too
    of_causes = {p.own for t, _ in members for p in t.hypothesis.parameters}
    kept_names = [n for n in shared if first.model.parameters[n].own not in of_causes]
    draws, as_stated, predicted, variance, tail = [], [], [], [], []
    for t, fraction in members:
        marginal, comparison = t.marginal, t.marginal.comparison
        x = marginal.resampled(max(round(fraction * _DRAWS), 2))
        f, _ = comparison.predict(x)
        v = comparison.variance(x)
        freedom = f.shape[1]
        tail.append(chi2.sf(comparison.misfit(x, f), freedom))
        factor = np.exp(comparison.common_part(comparison.scores.to_z(x)) / comparison.listed.frequencies)
        if freedom < len(whole):  # a false peak is predicted as measured
            kept = kept_of(whole, comparison.listed.frequencies)
            f_all, v_all = np.tile(whole, (len(x), 1)), np.full((len(x), len(whole)), np.median(v))
            one = np.ones_like(f_all)
            f_all[:, kept], v_all[:, kept], one[:, kept] = f, v, factor
            f, v, factor = f_all, v_all, one
        names = comparison.parameters.names
        draws.append(x[:, [names.index(n) for n in kept_names]])
        as_stated.append(f)
        predicted.append(f * factor)
        variance.append(v)
    x, f, v = np.concatenate(draws), np.concatenate(predicted), np.concatenate(variance)
    whole_prior = prior_of([t for t, _ in members])
    low, high = np.quantile(x, (0.025, 0.975), axis=0)
    mean = f.mean(axis=0)
    return Fit(
        constants={
            n: (float(x[:, i].mean()), float(x[:, i].std()), float(low[i]), float(high[i]))
            for i, n in enumerate(kept_names)
        },
        measured=whole,
        predicted=mean,
        predicted_sd=f.std(axis=0),
        sigma=np.sqrt(v.mean(axis=0)),
        rms=_rms(mean / whole - 1.0),
        rms_as_stated=_rms(np.concatenate(as_stated).mean(axis=0) / whole - 1.0),
        p_value=float(np.mean(np.concatenate(tail))),
        predictive_p=sum(fraction * checks.p_value(t) for t, fraction in members),
        log_evidence=float(
            logsumexp(
                [t.marginal.log_evidence for t, _ in members],
                b=[t.hypothesis.prior / whole_prior for t, _ in members],
            )
        ),
        log_evidence_error=max((t.marginal.error for t in sampled), default=np.nan),
        k_hat=max((t.marginal.k_hat for t in sampled), default=np.nan),
        draws=x,
        parameters={name: first.parameters[name] for name in kept_names},
    )


def _rms(relative: Array) -> float:
    return float(np.sqrt(np.mean(relative**2)))


def inferred_noise(members: Sequence[tuple[Tested, float]]) -> tuple[float, float] | None:
    """Mean and sd of the inferred relative noise over hypotheses and lists; None where noise is stated."""
    mean = square = 0.0
    for t, weight in members:
        columns = [c for c in t.marginal.comparison.amplitudes if c >= 0]
        if not columns:
            return None
        level, sd = (v[columns] for v in t.marginal.moments())
        mean += weight * float(np.mean(level))
        square += weight * float(np.mean(level**2 + sd**2))
    return mean, float(np.sqrt(max(square - mean**2, 0.0)))


@dataclass(frozen=True, slots=True)
class FoldSettings:
    """Settings of the leave-one-out folds.

    least_probability, most : least probability, and number with the plain model, of the hypotheses among
        which the cause is selected again
    least_fraction, most_plain : least fraction of the plain model's evidence, and number, of its pairings
    small_error, own_errors, largest_error : accepted error of a log evidence reweighted from the draws with
        all frequencies: the first, or so many times their own error up to the last
    heavier_tail : accepted excess of the weights' Pareto shape over that of the draws, if not reliable anyway
    starts : optima of the whole list from which the fits of every fold start
    """

    least_probability: float = 0.01
    most: int = 6
    least_fraction: float = 0.05
    most_plain: int = 3
    small_error: float = 0.1
    own_errors: float = 2.0
    largest_error: float = 0.3
    heavier_tail: float = 0.25
    starts: int = 3


_FOLDS: Final = FoldSettings()


@dataclass(frozen=True, slots=True)
class Gain:
    """Gain of the claimed cause over the plain model.

    log_bayes_factor : of the claimed causes, their variants averaged over their priors
    held_out : (n_f,) log predictive density of each frequency given all others, averaged over the leading
        hypotheses with their probabilities without that frequency, minus that of the plain model
    n_hypotheses : number of hypotheses among which every fold selects
    stable : fraction of the folds in which the claimed causes stay ahead of none and of the best outsider
    """

    rms_before: float
    rms_after: float
    log_bayes_factor: float
    held_out: Array
    n_hypotheses: int
    stable: float

    @property
    def held_out_difference(self) -> float:
        """Sum of ``held_out``."""
        return float(self.held_out.sum())

    @property
    def held_out_se(self) -> float:
        """Standard error of the sum, from the scatter of the differences."""
        n = len(self.held_out)
        return float(np.sqrt(n) * self.held_out.std(ddof=1)) if n > 1 else float("nan")


def gain_of(
    cases: Sequence[PlateCase],
    weighed: Weighed,
    claim: Claim,
    members: Sequence[tuple[Tested, float]],
    baseline: Fit,
    extended: Fit,
    scatter: float,
    executor: Executor | None = None,
) -> Gain:
    """Gain of the claimed causes, ``members`` with their fractions, over the plain model.

    The held-out score of frequency i is ln p(f_i | f_-i) = ln Z(f) - ln Z(f_-i) with Z = sum_h p(h) Z_h over
    the leading hypotheses: every fold selects the cause anew, by its probability.
    """
    n = len(baseline.measured)
    extending = {t.hypothesis.cause for t, _ in members} - {NONE} or {OTHER}
    claimed = extending | set(claim.causes)
    none = weighed.none.marginal
    top = shared_out(_sampled, cases, [(t,) for t in _near_the_top(weighed, claimed)], executor)
    whole = np.array([t.marginal.log_evidence for t in top])
    items = [(tuple(cases), t, n, None if t is top[0] else none, scatter) for t in top]
    folds = np.stack(shared_out(left_out, cases, items, executor))
    is_plain = np.array([t.hypothesis.cause == NONE for t in top])
    log_prior = np.log([t.hypothesis.prior for t in top])
    weight = folds + log_prior[:, None]
    mixture = logsumexp(whole + log_prior) - logsumexp(weight, axis=0)
    is_claimed = np.array([t.hypothesis.cause in claimed for t in top])
    outside = {t.key for t, inside in zip(top, is_claimed, strict=True) if not inside}
    best_outside = np.max([logsumexp(weight[[t.key == key for t in top]], axis=0) for key in outside], axis=0)
    ahead = logsumexp(weight[is_claimed], axis=0) > best_outside
    return Gain(
        baseline.rms_as_stated,
        extended.rms_as_stated,
        weighed.log_bayes_factor(extending),
        mixture - (logsumexp(whole[is_plain]) - logsumexp(folds[is_plain], axis=0)),
        len({t.key for t in top}),
        float(np.mean(ahead)),
    )


def left_out(cases: Sequence[PlateCase], t: Tested, n: int, none: Marginal | None, scatter: float) -> Array:
    """Log evidences (n,) of a hypothesis with each frequency left out in turn.

    Without a frequency that it takes for misread the rest of the list is free of that error, over whose size
    the density of the frequency integrates to one. The density of a false peak is independent of the modes:
    without it the other frequencies keep theirs.
    """
    cases = t.cases or cases
    evidences = np.empty(n)
    listed = t.hypothesis.listed
    # the posterior without a frequency is close to that with it
    about = about_draws(t.marginal)
    near, reweighted = about.model, _reweighted(t.marginal, about)
    paired = np.concatenate([case.modes >= 0 for case in cases])
    last = np.concatenate([np.full(c.measurement.size, c.measurement.frequencies[-1]) for c in cases])
    before = sum(case.measurement.size for case in cases[: t.plates[0]])  # frequencies of other plates
    for i in range(n):
        if not paired[i]:
            evidences[i] = t.marginal.log_evidence + np.log(last[i])
            continue
        at, hypothesis, known = int(paired[:i].sum()), t.hypothesis, t.marginal.z[: _FOLDS.starts]
        model: ComposedModel | None = near
        if i - before in listed.misread:
            hypothesis, model = _without_misreading(hypothesis, i - before), None
            parts, own = t.marginal.comparison.model.parts, at - int(paired[:before].sum())
            column = next(column for part in parts for j, column in part.misread if j == own)
            known = np.delete(known, column, axis=1)
        if listed.spurious is not None:
            if i == before + listed.spurious:
                evidences[i] = t.marginal.log_evidence - t.marginal.comparison.listed.log_constant
                continue
            at -= i > before + listed.spurious
        if hypothesis is t.hypothesis and np.isfinite(reweighted[at]):
            evidences[i] = reweighted[at]
            continue
        marginal = marginal_of(
            cases,
            hypothesis,
            t.plates,
            scatter=scatter,
            none=none,
            left_out=at,
            model=model,
            known=known,
            log2_draws=0,
        )
        evidences[i] = sampled_marginal(marginal).log_evidence
    return evidences


def _reweighted(marginal: Marginal, about: CorrelatedDensity) -> Array:
    """Leave-one-out log evidences (n_f,), reweighted from the draws with all frequencies.

    ln Z_-i = ln Z + ln E[1 / p(f_i | f_-i, x)] over the posterior of x (Gelfand, Dey and Chang, Bayesian
    Statistics 4, 1992). Not a number where the weights' tail is too heavy (Vehtari, Gelman and Gabry, Stat.
    Comput. 27, 2017) or their error too large, unless those of the draws are hardly better.
    """
    evidences = np.full(len(about.listed.frequencies), np.nan)
    if not marginal.is_sampled or not np.isfinite(marginal.k_hat):
        return evidences
    log_weight = marginal.log_weight[:, None] - about.log_conditional(marginal.draws)
    most_error = max(_FOLDS.small_error, min(_FOLDS.own_errors * marginal.error, _FOLDS.largest_error))
    most_k = max(RELIABLE_K, marginal.k_hat + _FOLDS.heavier_tail)
    for i in np.flatnonzero(~np.isnan(log_weight).any(axis=0)):
        own = log_weight[:, i]
        error = np.sqrt(1.0 / effective_size(own) - 1.0 / len(own))
        if pareto_shape(own) < most_k and error < most_error:
            evidences[i] = marginal.log_evidence + logsumexp(own)
    return evidences


def _near_the_top(weighed: Weighed, claimed: set[str]) -> list[Tested]:
    """The plain model and the most probable others, at least one claimed and one not claimed."""
    plain = [t for t, fraction in weighed.plain if t is weighed.none or fraction >= _FOLDS.least_fraction]
    others = [t for t in weighed.tested if t.hypothesis.cause != NONE]
    kept = [t for t in others if t.probability >= _FOLDS.least_probability][: _FOLDS.most - 1]
    for is_claimed in (True, False):
        if not any((t.hypothesis.cause in claimed) == is_claimed for t in kept):
            kept += [t for t in others if (t.hypothesis.cause in claimed) == is_claimed][:1]
    return [*plain[: _FOLDS.most_plain], *kept]


def _sampled(t: Tested) -> Tested:
    """A hypothesis with its evidence of the whole list sampled, as in the folds."""
    return t if t.marginal.is_sampled else replace(t, marginal=sampled_marginal(t.marginal))


def _without_misreading(hypothesis: Hypothesis, number: int) -> Hypothesis:
    """The hypothesis with one misread frequency less; the parameter of a second one is dropped first."""
    listed = hypothesis.listed
    gone = MISREADINGS[len(listed.misread) - 1].name
    return replace(
        hypothesis,
        listed=replace(listed, misread=tuple(i for i in listed.misread if i != number)),
        parameters=tuple(p for p in hypothesis.parameters if p.name != gone),
    )
