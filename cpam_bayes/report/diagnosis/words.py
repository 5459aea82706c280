"""What a diagnosis says, in sentences."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cpam_bayes.diagnosis.cases import differing_priors
from cpam_bayes.diagnosis.diagnose import Cause, Diagnosis
from cpam_bayes.diagnosis.extension import Resampled
from cpam_bayes.diagnosis.hypotheses import NONE, OTHER
from cpam_bayes.formatting import fixed, significant, with_spread
from cpam_bayes.report.diagnosis.rows import constant_rows, effect_unit, left_aside

__all__ = [
    "claim_sentence",
    "diagnosis_warnings",
    "listed",
    "probability_text",
    "size_text",
]

# A posterior predictive p-value this far out says that noise alone does not explain the residuals.
_P_LOW = 0.02
# Frequencies without which the claimed cause must stay ahead.
_STABLE = 0.8
# A standard deviation that is a smaller share of its mean is none: one node holds all the weight.
_UNSURE = 1e-3
# Importance sampling whose standard error of a log evidence is above this is warned of.
_ROUGH = 0.3


def claim_sentence(d: Diagnosis) -> str:
    """The claim in one sentence or two."""
    p = probability_text(d.claim.probability)
    by_name = {cause.name: cause for cause in d.causes}
    match d.claim.kind:
        case "none":
            return f"Nothing is wrong that these data show: the plain model has probability {p}{_false(d)}."
        case "named":
            cause = by_name[d.claim.causes[0]]
            return f"Named: {cause.name}{_where(d, cause)}, probability {p}{_of_size(cause)}."
        case "class":
            return (
                f"Something is wrong, and these data cannot tell which of {listed(d.claim.causes, 'or')}: "
                f"together they have probability {p}."
            )
        case "pair":
            return f"Two causes at once, {listed(d.claim.causes, 'and')}: probability {p}."
        case "other":
            return (
                "Something is wrong that no cause of the catalogue explains: probability "
                f"{p}. The residuals by mode show where. The extended model adds a scatter of all modes to "
                "the noise, which widens the intervals and repairs no frequency."
            )
    none = probability_text(by_name[NONE].probability)
    other = probability_text(by_name[OTHER].probability)
    leaders = [f"{c.name} {probability_text(c.probability)}" for c in _most_probable(d)]
    return (
        f"Undecided: nothing is probable enough to be claimed. The plain model has {none}, something that is "
        f"not in the catalogue {other}, the most probable causes have {listed(leaders, 'and')}."
    )


def diagnosis_warnings(
    d: Diagnosis, resampled: Resampled | None = None, *, emcee: bool = False
) -> tuple[str, ...]:
    """Everything that is a reason not to trust a diagnosis, or its constants by emcee, as they stand.

    emcee : whether it was asked for.
    """
    found = []
    if emcee and resampled is None:
        found.append("nothing is claimed, so there is no extended model for emcee to sample")
    n, unknowns = len(d.baseline.measured), len(constant_rows(d, d.baseline))
    if n <= unknowns:
        many = "frequency" if n == 1 else "frequencies"
        found.append(f"{n} {many} for {unknowns} unknowns: little is left to show what is wrong")
    if d.claim.kind == NONE and d.baseline.p_value < _P_LOW:
        found.append(
            f"posterior predictive p-value {d.baseline.p_value:.3f}: the residuals are larger than the "
            "noise explains, although no cause is more probable than none"
        )
    if d.extended is not None and d.extended.p_value < _P_LOW:
        found.append(
            f"posterior predictive p-value {d.extended.p_value:.3f} with the claimed cause: it does not "
            "explain all of the residuals"
        )
    if d.gain is not None and d.gain.stable < _STABLE:
        found.append(
            f"the claim holds without one frequency in {100 * d.gain.stable:.0f} % of the cases only: single "
            "frequencies decide it"
        )
    differing = differing_priors(d.cases)
    if differing:
        found.append(
            f"the files give {listed(differing, 'and')} different priors ([material], [material.sd] or "
            f"[unknowns]): those of {d.cases[0].name} were taken for all plates; give all files the same"
        )
    rough = max((t.marginal.error for t in d.weighed.tested if np.isfinite(t.marginal.error)), default=0.0)
    if rough > _ROUGH:
        found.append(
            f"log evidences are known to {significant(float(rough), 2)} only: probabilities are rough"
        )
    if resampled is not None and not resampled.converged:
        found.append(
            "the chains of the extended model used their budget before they converged: its constants by "
            "emcee are not reliable"
        )
    return tuple(found)


def _false(d: Diagnosis) -> str:
    """The frequencies that an incomplete list's pairing leaves out."""
    found = []
    for case in d.cases:
        left = [f"{f:g} Hz" for f in left_aside(case)]
        if left:
            found.append(listed(left, "and") + (f" of {case.name}" if len(d.cases) > 1 else ""))
    return f", with {listed(found, 'and')} left out as no mode of the plate" if found else ""


def size_text(cause: Cause) -> str:
    """Sizes of an effect, mean and sd with their unit."""
    sizes = []
    for name, (mean, sd, unit) in cause.parameters.items():
        shown, factor = effect_unit(name, unit)
        if sd < _UNSURE * abs(mean):  # looked at in passing, at a few sizes
            sizes.append(f"about {significant(factor * mean, 2)} {shown}".rstrip())
            continue
        value, spread = with_spread(factor * mean, factor * sd)
        sizes.append(f"{value} +- {spread} {shown}".rstrip())
    return "; ".join(sizes)


def probability_text(p: float) -> str:
    """A probability with as many digits as it is worth."""
    if p < 0.0005:
        return "< 0.001"
    return "> 0.999" if p > 0.9995 else fixed(p, 3 if p < 0.1 or p > 0.9 else 2)


def listed(names: Sequence[str], word: str) -> str:
    """Names with commas, and a word before the last."""
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} {word} {names[-1]}"


def _most_probable(d: Diagnosis) -> tuple[Cause, ...]:
    return tuple(c for c in d.causes if c.name not in (NONE, OTHER))[:3]


def _where(d: Diagnosis, cause: Cause) -> str:
    variant = f" ({cause.variant})" if cause.variant else ""
    if len(d.cases) == 1:
        return variant
    if len(cause.plates) == len(d.cases):
        return f"{variant}, common to all plates"
    return f"{variant}, of {listed(cause.plates, 'and')}"


def _of_size(cause: Cause) -> str:
    size = size_text(cause)
    return f", {size}" if size else ""
