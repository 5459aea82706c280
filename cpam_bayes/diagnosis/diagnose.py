"""Diagnosis of plates: what the simulation gets wrong, the cause, the extended model and its gain."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np

from cpam_bayes.answer import Notice, Reliance, each_once
from cpam_bayes.diagnosis.answers.detectability import Detectable, detectable
from cpam_bayes.diagnosis.answers.optima import (
    OpenOptimum,
    PriorSensitivity,
    averaged_constants,
    averaged_draws,
    open_optima,
    prior_sensitivity,
)
from cpam_bayes.diagnosis.cases import differing_priors, hypotheses_of
from cpam_bayes.diagnosis.comparison import SCATTER, PlateCase
from cpam_bayes.diagnosis.evidence.marginal import Marginal, best_log_likelihood
from cpam_bayes.diagnosis.evidence.sampled import shared_out
from cpam_bayes.diagnosis.evidence.sets import SETS
from cpam_bayes.diagnosis.evidence.weighing import Tested, Weighed, weigh
from cpam_bayes.diagnosis.fit import (
    Fit,
    Gain,
    PredictiveChecks,
    fit_of,
    gain_of,
    leftover_of,
    misfit_beyond_noise,
    within_stated_noise,
)
from cpam_bayes.diagnosis.hypotheses import (
    CLAIM_RULES,
    NONE,
    OTHER,
    Claim,
    Hypothesis,
    beside,
    causes_in,
    claim_of,
    inclusion_of,
)
from cpam_bayes.diagnosis.models import solved_there
from cpam_bayes.diagnosis.places import laid_on
from cpam_bayes.diagnosis.signatures import (
    Menu,
    Projector,
    Signature,
    alike,
    compared_by_fits,
    menu_of,
    projector_of,
    signature_of,
    with_equal_fits,
)
from cpam_bayes.effects import PlateFacts
from cpam_bayes.forward_model.labels import shape_notices
from cpam_bayes.forward_model.local.model import LocalModel
from cpam_bayes.forward_model.preconditions import count_notices
from cpam_bayes.identification.point import reliances
from cpam_bayes.inference.assessment import cut_notices
from cpam_bayes.running import cut_short, is_time_up, single_blas_thread

# A cause whose visible fraction is below this is called hidden.
_HIDDEN = 0.3
# Variants of the claimed causes that carry less than this fraction of the claim are not averaged over.
_LEAST_FRACTION = 1e-3
# Claimed hypotheses, draws of each, and draws with a free place, at which full solves check the bases.
_CHECKED_MEMBERS, _CHECKED_DRAWS, _CHECKED_PLACES = 3, 8, 4


@dataclass(frozen=True, slots=True)
class Cause:
    """Result for one cause, summed over its variants.

    plates : names of the plates that have it in its most probable variant, all where it is common to them
    log_bayes_factor : against none, the variants averaged over their priors
    log_evidence_error, k_hat : of the most probable variant, ``nan`` where it was not sampled
    parameters : name -> mean, sd and SI unit in that variant; of the magnitude where the sign is open
    indistinguishable_from : causes that the frequencies cannot distinguish from it
    max_shift : largest relative shift of a frequency at one standard deviation
    absorbed : whether the constants absorb it
    visible : fraction of its signature that the constants do not imitate
    bias : name -> relative change of a constant that imitates it
    leftover : relative size of the unexplained discrepancy beside it, averaged over its variants
    hypothesis : the most probable variant, with its effects and how their parameters are shown
    """

    name: str
    variant: str
    plates: tuple[str, ...]
    probability: float
    log_bayes_factor: float
    log_evidence_error: float
    k_hat: float
    parameters: Mapping[str, tuple[float, float, str]]
    indistinguishable_from: tuple[str, ...]
    max_shift: float
    absorbed: bool
    visible: float
    bias: Mapping[str, float]
    leftover: float
    hypothesis: Hypothesis

    @property
    def is_set(self) -> bool:
        """Whether it is a set of several causes."""
        return len(causes_in(self.name)) > 1


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """Diagnosis of one or several plates.

    cases : the plates, incomplete lists with their most probable pairing under the plain model
    causes : all causes, none and other included, the most probable first
    members : tested variants of the claimed causes with their weights in the average
    extended, gain : ``None`` where nothing is claimed
    signatures : by cause, of its best variant
    averaged : the answer: constants averaged over all hypotheses, mean, sd, 2.5 % and 97.5 % quantile, SI
    sensitivity : of probabilities and claim to the scales of the priors
    detectable : smallest detectable size of each cause; empty if not asked for
    explained, plain_explained : whether stated noise explains the residuals of the answer's model (for
        constants averaged over all hypotheses, of the most probable one), and of the plain model
    reliances : intervals of the answer that rest on the bounds or the prior of another constant
    basis_error : largest relative frequency error of the reduced bases, from full solves at posterior draws
        of the claimed hypotheses or of the plain model; ``None`` where these have no such basis
    """

    cases: tuple[PlateCase, ...]
    weighed: Weighed
    causes: tuple[Cause, ...]
    claim: Claim
    members: tuple[tuple[Tested, float], ...]
    baseline: Fit
    extended: Fit | None
    gain: Gain | None
    signatures: Mapping[str, Signature]
    averaged: Mapping[str, tuple[float, float, float, float]]
    sensitivity: PriorSensitivity
    detectable: tuple[Detectable, ...]
    optima: tuple[OpenOptimum, ...]
    explained: bool
    plain_explained: bool
    reliances: tuple[Reliance, ...]
    basis_error: float | None
    seconds: float

    @property
    def something_wrong(self) -> float:
        """Probability that anything is wrong."""
        return 1.0 - next(c.probability for c in self.causes if c.name == NONE)

    @property
    def bayes_factor(self) -> float:
        """Bayes factor of any error against none: posterior odds over prior odds."""
        prior = self.weighed.none.hypothesis.prior
        none = next(c.probability for c in self.causes if c.name == NONE)
        return (1.0 - none) / none * prior / (1.0 - prior) if none > 0.0 else float("inf")

    @property
    def tested_causes(self) -> tuple[str, ...]:
        """Names of the single causes that were tested, the most probable first."""
        return tuple(c.name for c in self.causes if c.name not in (NONE, OTHER) and not c.is_set)

    @property
    def hidden_causes(self) -> tuple[Cause, ...]:
        """Single causes with little visible signature, the best hidden first."""
        hidden = [c for c in self.causes if c.visible < _HIDDEN and c.parameters and not c.is_set]
        return tuple(sorted(hidden, key=lambda cause: cause.visible))

    @property
    def inclusion(self) -> Mapping[str, float]:
        """Probability that each cause acts, alone or beside others, the most probable first."""
        return inclusion_of({c.name: c.probability for c in self.causes})

    @property
    def several(self) -> Cause:
        """The most probable set that contains all claimed causes."""
        return next(c for c in self.causes if set(self.claim.causes) <= set(causes_in(c.name)))

    @property
    def claimed(self) -> frozenset[str]:
        """Names in ``causes`` on which the claim rests, pairs with a claimed cause included."""
        if self.claim.kind in (NONE, OTHER):
            return frozenset({self.claim.kind})
        return frozenset(t.hypothesis.cause for t, _ in self.members)

    @property
    def leftover(self) -> tuple[float, float]:
        """Probability of an unexplained discrepancy beside the claim, and its relative size."""
        return leftover_of(self.members)

    @property
    def beside(self) -> Mapping[str, float]:
        """Causes that may act beside the claimed ones, with their inclusion probabilities."""
        return beside(self.claim, self.inclusion)


@single_blas_thread
def diagnose_cases(
    cases: Sequence[PlateCase],
    *,
    hypotheses: Sequence[tuple[Hypothesis, tuple[int, ...]]] | None = None,
    scatter: float = SCATTER,
    sets: bool = True,
    gain: bool = True,
    power: bool = True,
    executor: Executor | None = None,
    notify: Callable[[str], None] = lambda text: None,
    progress: Callable[[int, int], None] = lambda done, total: None,
    so_far: Callable[[Mapping[str, float]], None] = lambda shares: None,
) -> Diagnosis:
    """Diagnose one plate, or several of one material, from their frequency lists.

    hypotheses : each with the plates it concerns, none first; all that the plates may have if ``None``
    scatter : relative standard deviation of a constant from plate to plate
    gain : whether to leave out each frequency in turn
    power : whether to compute detection limits
    executor : where hypotheses are fitted, ``None`` for this process; the answer is the same
    so_far : called with the current shares of the causes while hypotheses are fitted
    """
    start = time.perf_counter()
    if hypotheses is None:
        hypotheses = hypotheses_of(cases)
    notify(f"weighing {len(hypotheses)} hypotheses")
    weighed = weigh(
        cases, hypotheses, scatter=scatter, sets=sets, executor=executor, progress=progress, so_far=so_far
    )
    best = {name: weighed.best_of(name) for name in weighed.by_cause()}
    projector = projector_of(weighed.none.marginal)
    signatures = {
        name: signature_of(t, weighed.none.marginal, projector)
        for name, t in best.items()
        if name not in (NONE, OTHER)
    }
    causes = _causes(cases, weighed, best, signatures, projector, executor)
    checks = PredictiveChecks()
    checks.compute(cases, list(best.values()), executor)
    claim = claim_from(weighed, checks.p_value, misfit_beyond_noise)
    members = _members(weighed, claim)
    cases = weighed.none.cases or cases
    whole = np.concatenate([case.measurement.frequencies for case in cases])
    baseline = fit_of(weighed.plain, whole, checks)
    extended = fit_of(members, whole, checks) if members else None
    leading = members[0][0] if members else weighed.tested[0]
    n_constants = len({name for case in cases for name in case.models.specimen.unknowns.names})
    gain_of_claim = None
    if is_time_up() and (gain or power):
        cut_short("cut_gain")
        gain = power = False
    if gain and extended is not None and members:
        notify("leaving one frequency out")
        gain_of_claim = gain_of(cases, weighed, claim, members, baseline, extended, scatter, executor)
    return Diagnosis(
        tuple(cases),
        weighed,
        causes,
        claim,
        members,
        baseline,
        extended,
        gain_of_claim,
        signatures,
        averaged_constants(weighed),
        prior_sensitivity(
            weighed, claim, lambda other: claim_from(other, checks.p_value, misfit_beyond_noise)
        ),
        detectable(weighed, cases, executor) if power else (),
        open_optima(members[0][0] if members else weighed.none, cases),
        claim.kind != OTHER and within_stated_noise(leading, n_constants),
        within_stated_noise(weighed.none, n_constants),
        _reliances(cases, weighed),
        basis_error_of([t for t, _ in members[:_CHECKED_MEMBERS]] or [weighed.none], cases),
        time.perf_counter() - start,
    )


def basis_error_of(tested: Sequence[Tested], cases: Sequence[PlateCase]) -> float | None:
    """Largest relative frequency error of the reduced bases, from full solves at posterior draws.

    An effect at a free place needs a new plate at each draw, so few are used. None where no basis is reduced.
    """
    found: list[float | None] = []
    for t in tested:
        model, x = t.marginal.comparison.model, t.marginal.resampled(_CHECKED_DRAWS)
        found.append(model.basis_error(x))
        few = x[:: _CHECKED_DRAWS // _CHECKED_PLACES][:_CHECKED_PLACES]
        for part, case in zip(model.parts, cases, strict=True):
            listed = part.modes[part.modes >= 0]
            for change, effect in zip(part.changes, t.hypothesis.effects, strict=False):
                if isinstance(change.model, LocalModel):
                    at = np.column_stack((part.plate_vector(few), few[:, list(change.columns)]))
                    solved = solved_there(case.models, effect, change.model, at)
                    error = np.abs(change.model.predict(at).frequencies / solved - 1.0)
                    found.append(float(error[:, listed].max(initial=0.0)))
    return max((error for error in found if error is not None), default=None)


def _reliances(cases: Sequence[PlateCase], weighed: Weighed) -> tuple[Reliance, ...]:
    """Reliances of the constants of the answer, which are averaged over all hypotheses."""
    names, draws, weight = averaged_draws(weighed)
    prior_sd = {
        name: case.models.parameters[name].prior.sd
        for case in cases
        for name in case.models.specimen.unknowns.names
    }
    kept = [i for i, name in enumerate(names) if name in prior_sd]
    if not kept:
        return ()
    covariance = np.atleast_2d(np.cov(draws[:, kept].T, aweights=weight, ddof=0))
    of = [names[i] for i in kept]
    return reliances(of, covariance, np.array([prior_sd[name] for name in of]))


def _causes(
    cases: Sequence[PlateCase],
    weighed: Weighed,
    best: Mapping[str, Tested],
    signatures: Mapping[str, Signature],
    projector: Projector,
    executor: Executor | None,
) -> tuple[Cause, ...]:
    names = [name for name in signatures if len(causes_in(name)) == 1]
    of_singles = [signatures[name] for name in names]
    menus: dict[str, list[Menu]] = {name: [] for name in names}
    for t in weighed.tested:
        menu = menu_of(t, weighed.none.marginal, projector)
        if menu is not None:
            menus[t.hypothesis.cause].append(menu)
    of_all = [menus[name] for name in names]
    by_signature = {name: [names[j] for j in alike(of_singles, i, of_all)] for i, name in enumerate(names)}
    probabilities = weighed.by_cause()
    # fits are compared where a cause may be claimed
    compared = names if probabilities[NONE] < CLAIM_RULES.plain else []
    fits = compared_by_fits({name: best[name] for name in compared}, probabilities, by_signature)
    marginals = [(t.marginal,) for t in fits.values()]
    peaks = shared_out(best_log_likelihood, cases, marginals, executor)
    like = with_equal_fits(by_signature, dict(zip(fits, peaks, strict=True)), probabilities)
    causes = []
    for name, probability in weighed.by_cause().items():
        t = best[name]
        signature = signatures.get(name)
        causes.append(
            Cause(
                name=name,
                variant=t.hypothesis.variant,
                plates=tuple(cases[i].name for i in t.plates),
                probability=probability,
                log_bayes_factor=weighed.log_bayes_factor((name,)),
                log_evidence_error=t.marginal.error,
                k_hat=t.marginal.k_hat,
                parameters=_parameters(t, [cases[i].models.facts for i in t.plates]),
                indistinguishable_from=like.get(name, ()),
                max_shift=signature.largest if signature else 0.0,
                absorbed=signature.is_absorbed if signature else False,
                visible=signature.visible_fraction if signature else 1.0,
                bias=_bias(weighed.none.marginal, signature) if signature else {},
                leftover=float(np.prod(leftover_of(weighed.variants_of(name)))),
                hypothesis=t.hypothesis,
            )
        )
    return tuple(causes)


def _parameters(t: Tested, facts: Sequence[PlateFacts]) -> dict[str, tuple[float, float, str]]:
    """Mean, standard deviation and unit of each parameter, a place at its image nearest to the optimum."""
    sizes = {}
    weights = np.exp(t.marginal.log_weight)
    columns = dict(zip((p.name for p in t.hypothesis.parameters), t.columns, strict=True))
    draws = laid_on(t.marginal.draws, t.marginal.best, t.hypothesis.effects, columns, facts)
    for parameter, column in zip(t.hypothesis.parameters, t.columns, strict=True):
        x = draws[:, column]
        above = float(weights @ (x > 0.0))
        if parameter.prior.lower < 0.0 and any(e.even for e in t.hypothesis.effects) and 0.1 < above < 0.9:
            x = np.abs(x)
        mean = float(weights @ x)
        sd = float(np.sqrt(weights @ (x - mean) ** 2))
        sizes[parameter.name] = (mean, sd, parameter.unit)
    return sizes


def _bias(none: Marginal, signature: Signature) -> dict[str, float]:
    """Relative change of each constant that imitates the cause, to first order."""
    x = none.best
    scores = none.comparison.scores
    dx = scores.by_score(np.eye(len(x))[None], x[None], scores.to_z(x[None]))[0] @ signature.bias
    names = none.comparison.model.parameters.names
    return {name: float(dx[i] / x[i]) for i, name in enumerate(names) if x[i] != 0.0}


def claim_from(
    weighed: Weighed, p_value: Callable[[Tested], float], misfit: Callable[[Tested], float]
) -> Claim:
    """The claim from weighed hypotheses.

    p_value : predictive p-value of a hypothesis
    misfit : its misfit beyond noise
    """
    most = CLAIM_RULES.halved * misfit(weighed.none)

    def explained(name: str) -> bool:
        best = weighed.best_of(name)
        if best.hypothesis.has_leftover and misfit(best) > most:
            return False
        return p_value(best) > CLAIM_RULES.explained

    probability = weighed.by_cause()
    evidence = {name: weighed.log_bayes_factor((name,)) for name in probability}
    return claim_of(
        probability,
        evidence,
        explained,
        is_cut_short=weighed.is_cut_short,
        unaccounted=weighed.unaccounted,
    )


def _members(weighed: Weighed, claim: Claim) -> tuple[tuple[Tested, float], ...]:
    """Tested variants of the claimed causes with their fractions; all hypotheses where other is claimed.

    Other is claimed where no hypothesis explains the lists, whichever comes nearest.
    """
    if claim.kind in ("none", "undecided"):
        return ()
    if claim.kind == "other":
        claimed = list(weighed.tested)
    elif claim.kind == "pair":
        claimed = [t for t in weighed.tested if set(claim.causes) <= set(t.hypothesis.causes)]
    else:
        names = set(claim.causes)
        claimed = [t for t in weighed.tested if names & {t.hypothesis.cause, *t.hypothesis.causes}]
    total = sum(t.probability for t in claimed)
    kept = [t for t in claimed if t.probability >= _LEAST_FRACTION * total]
    total = sum(t.probability for t in kept)
    return tuple((t, t.probability / total) for t in kept)


# Predictive p-value below which noise alone does not explain the residuals.
_P_LOW = 0.02
# Fraction of the leave-one-out folds in which the claimed cause must stay ahead.
_STABLE = 0.8
# Standard error of a log evidence, nats, above which importance sampling is warned of.
_ROUGH = 0.3


def diagnosis_notices(d: Diagnosis) -> tuple[Notice, ...]:
    """Every reason not to trust a diagnosis as it stands."""
    return tuple(_notices(d))


def _notices(d: Diagnosis) -> Iterator[Notice]:
    fit = d.baseline if d.extended is None else d.extended
    unknowns = {name for case in d.cases for name in case.models.specimen.unknowns.names}
    yield from count_notices(len(d.baseline.measured), len(unknowns & set(d.baseline.constants)))
    if d.claim.kind == NONE and d.baseline.predictive_p < _P_LOW:
        inferred = d.weighed.none.marginal.comparison.noise is not None
        yield Notice("unexplained_by_none", facts={"p": d.baseline.predictive_p, "inferred": inferred})
    if d.extended is not None and d.extended.predictive_p < _P_LOW:
        yield Notice("unexplained_by_claim", facts={"p": d.extended.predictive_p})
    draws = dict(zip(fit.constants, fit.draws.T, strict=True))
    yield from cut_notices(d.cases[0].models.specimen.material, draws)
    if d.gain is not None and d.gain.stable < _STABLE:
        yield Notice("single_frequencies", facts={"stable": d.gain.stable})
    if d.optima:
        yield _of_optima(d)
    yield from each_once(n for c in d.cases for n in shape_notices(c.by_shape, c.measurement, "best"))
    names = differing_priors(d.cases)
    if names:
        yield Notice("differing_priors", facts={"names": names, "taken": d.cases[0].name})
    rough = max((t.marginal.error for t in d.weighed.tested if np.isfinite(t.marginal.error)), default=0.0)
    if rough > _ROUGH:
        yield Notice("rough_evidences", facts={"error": float(rough)})
    if d.weighed.unaccounted > SETS.unaccounted:
        yield Notice("unweighed_sets", facts={"probability": d.weighed.unaccounted})


def _of_optima(d: Diagnosis) -> Notice:
    """Notice of several optima and of the measured mode shapes that would decide between the first two."""
    first, second = d.optima[:2]
    apart = {
        n: second.constants[n] / v - 1.0 for n, v in first.constants.items() if v and n in second.constants
    }
    name = max(apart, key=lambda n: abs(apart[n]))
    swapped = None
    for i, k, a, b in first.differences(second)[:1]:
        swapped = {"plate": d.cases[i].name if len(d.cases) > 1 else "", "frequency": k + 1, "modes": (a, b)}
    return Notice(
        "several_optima",
        facts={
            "count": len(d.optima),
            "fractions": tuple(o.fraction for o in d.optima[:2]),
            "constant": name,
            "apart": abs(apart[name]),
            "swapped": swapped,
        },
    )
