"""From plates to a diagnosis: what the simulation gets wrong, the cause, the extended model, the gain."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp
from scipy.stats import chi2

from cpam_bayes.diagnosis.cases import hypotheses_of, plate_case
from cpam_bayes.diagnosis.claim import Claim, claim_of
from cpam_bayes.diagnosis.comparison import kept_of
from cpam_bayes.diagnosis.fitting import SCATTER, PlateCase
from cpam_bayes.diagnosis.hypotheses import NONE, OTHER, PAIR, Hypothesis
from cpam_bayes.diagnosis.marginal import Marginal, sampled_marginal
from cpam_bayes.diagnosis.signatures import Signature, alike, projector_of, signature_of
from cpam_bayes.diagnosis.weighing import Tested, Weighed, marginal_of, weigh
from cpam_bayes.measurement import Specimen
from cpam_bayes.threads import single_blas_thread

Array = NDArray[Any]

# Variants of the claimed causes that carry less than this share of the claim are not averaged over.
_LEAST_SHARE = 1e-3
# Draws that fits are summarised from.
_DRAWS = 1024


@dataclass(frozen=True, slots=True)
class Cause:
    """One cause as the data see it, its variants summed.

    plates : names of those that have it in its most probable variant, all where they share it.
    log_bayes_factor : against none, the variants averaged over their priors. parameters : name -> mean, sd
    and unit in that variant; of the magnitude where either sign is as probable. indistinguishable_from : by
    their signatures. max_shift : largest relative shift of a frequency at one standard deviation. absorbed :
    whether the constants hide it; visible : share of its signature that they do not imitate. bias : name ->
    relative change of a constant that imitates it.
    """

    name: str
    variant: str
    plates: tuple[str, ...]
    probability: float
    log_bayes_factor: float
    parameters: Mapping[str, tuple[float, float, str]]
    indistinguishable_from: tuple[str, ...]
    max_shift: float
    absorbed: bool
    visible: float
    bias: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Fit:
    """What a model makes of the lists.

    constants : name -> mean, sd, 2.5 % and 97.5 % quantile, SI. predicted, predicted_sd, sigma : of all
    frequencies, plate by plate. rms : relative. p_value : posterior predictive, of the sum of squared
    standardised residuals. draws : (d, n_constants) behind it, equally probable.
    """

    constants: Mapping[str, tuple[float, float, float, float]]
    measured: Array
    predicted: Array
    predicted_sd: Array
    sigma: Array
    rms: float
    p_value: float
    log_evidence: float
    draws: Array

    @property
    def standardised(self) -> Array:
        """Residuals over the standard deviations of noise and prediction together."""
        return np.asarray((self.measured - self.predicted) / np.hypot(self.sigma, self.predicted_sd))


@dataclass(frozen=True, slots=True)
class Gain:
    """What the claimed cause is worth.

    held_out : (n_f,) log predictive density of each frequency from all others, extended less plain.
    stable : share of the frequencies without which the claimed cause still is ahead of none and of the best
    outsider.
    """

    rms_before: float
    rms_after: float
    log_bayes_factor: float
    held_out: Array
    stable: float

    @property
    def held_out_difference(self) -> float:
        """Sum of the differences."""
        return float(self.held_out.sum())

    @property
    def held_out_se(self) -> float:
        """Standard error of the sum, from the scatter of the differences."""
        n = len(self.held_out)
        return float(np.sqrt(n) * self.held_out.std(ddof=1)) if n > 1 else float("nan")


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """The answer about one or several plates.

    causes : all, none and other among them, the most probable first. members : tested variants of the
    claimed causes with their shares, which the extended model is averaged over. extended, gain : ``None``
    where nothing is claimed. signatures : by cause, of its best variant.
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
    seconds: float


@single_blas_thread
def diagnose(
    specimens: Sequence[Specimen],
    *,
    scatter: float = SCATTER,
    notify: Callable[[str], None] = lambda text: None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Diagnosis:
    """Diagnose plates of one material, or one, from their lists.

    scatter : relative standard deviation of a constant from plate to plate. Raises ``ValueError`` for a
    specimen without a list or unknowns.
    """
    return diagnose_cases(
        [plate_case(s, notify) for s in specimens], scatter=scatter, notify=notify, progress=progress
    )


@single_blas_thread
def diagnose_cases(
    cases: Sequence[PlateCase],
    *,
    hypotheses: Sequence[tuple[Hypothesis, tuple[int, ...]]] | None = None,
    scatter: float = SCATTER,
    pairs: bool = True,
    gain: bool = True,
    notify: Callable[[str], None] = lambda text: None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Diagnosis:
    """The same from plates whose models are there; without ``gain`` no frequency is left out.

    hypotheses : with the plates that each is about, none first, by default all that the plates may have.
    """
    start = time.perf_counter()
    if hypotheses is None:
        hypotheses = hypotheses_of(cases)
    notify(f"weighing {len(hypotheses)} hypotheses")
    weighed = weigh(cases, hypotheses, scatter=scatter, pairs=pairs, progress=progress)
    best = {name: weighed.best_of(name) for name in weighed.by_cause()}
    projector = projector_of(weighed.none.marginal)
    signatures = {
        name: signature_of(t, weighed.none.marginal, projector)
        for name, t in best.items()
        if name not in (NONE, OTHER)
    }
    causes = _causes(cases, weighed, best, signatures)
    claim = _claim(weighed, causes)
    members = _members(weighed, claim)
    whole = weighed.none.marginal.comparison.listed.frequencies
    baseline = _fit([(weighed.none, 1.0)], whole)
    extended = _fit(members, whole) if members else None
    found_gain = None
    if gain and extended is not None and members:
        notify("leaving one frequency out")
        found_gain = _gain(cases, weighed, claim, members, baseline, extended, scatter)
    return Diagnosis(
        tuple(cases),
        weighed,
        causes,
        claim,
        members,
        baseline,
        extended,
        found_gain,
        signatures,
        time.perf_counter() - start,
    )


def _causes(
    cases: Sequence[PlateCase],
    weighed: Weighed,
    best: Mapping[str, Tested],
    signatures: Mapping[str, Signature],
) -> tuple[Cause, ...]:
    pairs = {t.hypothesis.cause for t in weighed.tested if t.hypothesis.family == PAIR}
    names = [name for name in signatures if name not in pairs]
    own = [signatures[name] for name in names]
    like = {name: tuple(names[j] for j in alike(own, i)) for i, name in enumerate(names)}
    found = []
    for name, probability in weighed.by_cause().items():
        t = best[name]
        variants = [v for v in weighed.tested if v.hypothesis.cause == name]
        priors = np.array([v.hypothesis.prior for v in variants])
        evidence = np.array([v.log_bayes_factor for v in variants])
        signature = signatures.get(name)
        found.append(
            Cause(
                name=name,
                variant=t.hypothesis.variant,
                plates=tuple(cases[i].name for i in t.plates),
                probability=probability,
                log_bayes_factor=float(logsumexp(evidence, b=priors / priors.sum())),
                parameters=_parameters(t),
                indistinguishable_from=like.get(name, ()),
                max_shift=signature.largest if signature else 0.0,
                absorbed=signature.is_absorbed if signature else False,
                visible=signature.share if signature else 1.0,
                bias=_bias(weighed.none.marginal, signature) if signature else {},
            )
        )
    return tuple(found)


def _parameters(t: Tested) -> dict[str, tuple[float, float, str]]:
    found = {}
    weights = np.exp(t.marginal.log_weight)
    for parameter, column in zip(t.hypothesis.parameters, t.columns, strict=True):
        x = t.marginal.draws[:, column]
        above = float(weights @ (x > 0.0))
        if parameter.prior.lower < 0.0 and any(e.even for e in t.hypothesis.effects) and 0.1 < above < 0.9:
            x = np.abs(x)
        mean = float(weights @ x)
        sd = float(np.sqrt(weights @ (x - mean) ** 2))
        found[parameter.name] = (mean, sd, parameter.unit)
    return found


def _bias(none: Marginal, signature: Signature) -> dict[str, float]:
    """Relative change of each constant that imitates the cause, to first order."""
    x = none.best
    dx = none.comparison.scores.slope(x[None], none.comparison.scores.to_z(x[None]))[0]
    names = none.comparison.model.parameters.names
    return {name: float(signature.bias[i] * dx[i] / x[i]) for i, name in enumerate(names) if x[i] != 0.0}


def _claim(weighed: Weighed, causes: Sequence[Cause]) -> Claim:
    pairs = {t.hypothesis.cause: t.hypothesis.causes for t in weighed.tested if t.hypothesis.family == PAIR}
    return claim_of(
        {c.name: c.probability for c in causes},
        {c.name: c.log_bayes_factor for c in causes},
        {c.name: frozenset(c.indistinguishable_from) for c in causes},
        pairs,
    )


def _members(weighed: Weighed, claim: Claim) -> tuple[tuple[Tested, float], ...]:
    """The tested variants of what is claimed, with their shares."""
    if claim.kind in ("none", "undecided"):
        return ()
    if claim.kind == "pair":
        own = [
            t for t in weighed.tested if t.hypothesis.family == PAIR and t.hypothesis.causes == claim.causes
        ]
    else:
        names = claim.causes or (OTHER,)
        own = [t for t in weighed.tested if t.hypothesis.cause in names]
    total = sum(t.probability for t in own)
    kept = [t for t in own if t.probability >= _LEAST_SHARE * total]
    total = sum(t.probability for t in kept)
    return tuple((t, t.probability / total) for t in kept)


def _fit(members: Sequence[tuple[Tested, float]], whole: Array) -> Fit:
    """The fit of a mixture of hypotheses with the same constants; whole : all listed frequencies."""
    first = members[0][0].marginal.comparison
    model_names = first.model.parameters.names
    shared = [n for n in model_names if all(n in t.marginal.comparison.parameters.names for t, _ in members)]
    own = [n for n in shared if n not in {p.name for t, _ in members for p in t.hypothesis.parameters}]
    draws, predicted, variance, residual = [], [], [], []
    for t, share in members:
        marginal, comparison = t.marginal, t.marginal.comparison
        x = marginal.resampled(max(round(share * _DRAWS), 2))
        f, _ = comparison.predict(x)
        v = comparison.variance(x)
        if f.shape[1] < len(whole):  # a false peak is predicted as measured
            kept = kept_of(whole, comparison.listed.frequencies)
            f_all, v_all = np.tile(whole, (len(x), 1)), np.full((len(x), len(whole)), np.median(v))
            f_all[:, kept], v_all[:, kept] = f, v
            f, v = f_all, v_all
        names = comparison.parameters.names
        draws.append(x[:, [names.index(n) for n in own]])
        predicted.append(f)
        variance.append(v)
        residual.append(np.sum((whole - f) ** 2 / v, axis=1))
    x, f, v = np.concatenate(draws), np.concatenate(predicted), np.concatenate(variance)
    chi = np.concatenate(residual)
    low, high = np.quantile(x, (0.025, 0.975), axis=0)
    mean = f.mean(axis=0)
    return Fit(
        constants={
            n: (float(x[:, i].mean()), float(x[:, i].std()), float(low[i]), float(high[i]))
            for i, n in enumerate(own)
        },
        measured=whole,
        predicted=mean,
        predicted_sd=f.std(axis=0),
        sigma=np.sqrt(v.mean(axis=0)),
        rms=float(np.sqrt(np.mean((mean / whole - 1.0) ** 2))),
        p_value=float(np.mean(chi2.sf(chi, len(whole)))),
        log_evidence=float(
            logsumexp(
                [t.marginal.log_evidence for t, _ in members],
                b=[t.hypothesis.prior / sum(m.hypothesis.prior for m, _ in members) for t, _ in members],
            )
        ),
        draws=x,
    )


def _gain(
    cases: Sequence[PlateCase],
    weighed: Weighed,
    claim: Claim,
    members: Sequence[tuple[Tested, float]],
    baseline: Fit,
    extended: Fit,
    scatter: float,
) -> Gain:
    leader = members[0][0]
    claimed = {t.hypothesis.cause for t, _ in members}
    outsider = next(
        (t for t in weighed.tested if t.hypothesis.cause not in (*claimed, NONE, *claim.causes)), None
    )
    n = len(baseline.measured)
    own = _left_out(cases, leader, n, weighed.none.marginal, scatter)
    none = _left_out(cases, weighed.none, n, None, scatter)
    held_out = (leader.marginal.log_evidence - own) - (weighed.none.marginal.log_evidence - none)
    ahead = own + np.log(leader.hypothesis.prior) > none + np.log(weighed.none.hypothesis.prior)
    if outsider is not None:
        other = _left_out(cases, outsider, n, weighed.none.marginal, scatter)
        ahead &= own + np.log(leader.hypothesis.prior) > other + np.log(outsider.hypothesis.prior)
    return Gain(
        baseline.rms,
        extended.rms,
        extended.log_evidence - baseline.log_evidence,
        held_out,
        float(np.mean(ahead)),
    )


def _left_out(cases: Sequence[PlateCase], t: Tested, n: int, none: Marginal | None, scatter: float) -> Array:
    """Log evidences of a hypothesis without each of the frequencies in turn, (n,).

    One that is about the list itself has the evidence of the whole list where the frequency that it
    explains is the one left out.
    """
    found = np.full(n, t.marginal.log_evidence)
    listed = t.hypothesis.listed
    before = sum(case.measurement.size for case in cases[: t.plates[0]])  # frequencies of other plates
    for i in range(n):
        if listed.misread is not None and i == before + listed.misread:
            continue
        at = i
        if listed.spurious is not None:
            if i == before + listed.spurious:
                continue
            at = i - (i > before + listed.spurious)
        marginal = marginal_of(cases, t.hypothesis, t.plates, scatter=scatter, none=none, left_out=at)
        found[i] = sampled_marginal(marginal).log_evidence
    return found
