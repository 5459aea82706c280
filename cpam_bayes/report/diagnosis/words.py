"""What a diagnosis says, in sentences."""

from __future__ import annotations

from cpam_bayes.diagnosis.diagnose import Cause, Diagnosis
from cpam_bayes.diagnosis.hypotheses import NONE, OTHER
from cpam_bayes.diagnosis.paired_modes import left_aside
from cpam_bayes.formatting import fixed, listed, significant, with_spread
from cpam_bayes.report.diagnosis.rows import DetectableRow, detectable_rows, tested_causes

__all__ = [
    "claim_sentence",
    "detectable_sentences",
    "detectable_size",
    "probability_text",
    "repeatability_text",
    "sensitivity_sentence",
    "size_text",
]

# A standard deviation that is a smaller share of its mean is none: one node holds all the weight.
_UNSURE = 1e-3


def claim_sentence(d: Diagnosis) -> str:
    """The claim in one sentence or two."""
    p = probability_text(d.claim.probability)
    by_name = {cause.name: cause for cause in d.causes}
    match d.claim.kind:
        case "none":
            return f"No evidence of a model error: the plain model has probability {p}{_false(d)}."
        case "named":
            cause = by_name[d.claim.causes[0]]
            return f"Named: {cause.name}{_where(d, cause)}, probability {p}{_of_size(cause)}."
        case "class":
            return (
                f"The model lacks one of {listed(d.claim.causes, 'or')}, and these frequencies cannot "
                f"tell which: together they have probability {p}."
            )
        case "pair":
            return f"Two causes at once, {listed(d.claim.causes, 'and')}: probability {p}."
        case "other":
            return (
                "The model lacks something that no cause of the catalogue explains: probability "
                f"{p}. The residuals by mode show where. {_nearest(d)}"
            )
    none = probability_text(by_name[NONE].probability)
    other = probability_text(by_name[OTHER].probability)
    leaders = [f"{c.name} {probability_text(c.probability)}" for c in _most_probable(d)]
    return (
        f"Undecided: no hypothesis is probable enough to be claimed. The plain model has {none}, an error "
        f"outside the catalogue {other}, the most probable causes have {listed(leaders, 'and')}."
    )


def detectable_sentences(d: Diagnosis) -> tuple[str, ...]:
    """Where nothing is claimed: what was tested, and what these data would have shown."""
    if d.claim.kind != NONE:
        return ()
    causes = tested_causes(d)
    said = [f"Tested: {len(d.weighed.tested)} hypotheses about {listed(causes, 'and')}."]
    rows = detectable_rows(d)
    seen = [f"{row.cause} from {detectable_size(row)}" for row in rows if row.smallest is not None]
    unseen = [row.cause for row in rows if row.smallest is None and row.probability is not None]
    if seen:
        said.append(f"With 95 % probability these data would have shown {listed(seen, 'and')}.")
    if unseen:
        said.append(f"They need not show {listed(unseen, 'or')}, of whatever size.")
    return tuple(said)


def detectable_size(row: DetectableRow) -> str:
    """The smallest size that would have been claimed, with its unit."""
    if row.smallest is None:
        return "no size" if row.probability is not None else "has no size"
    return f"{significant(row.smallest, 2)} {row.unit or ''}".rstrip()


def _false(d: Diagnosis) -> str:
    """The frequencies that an incomplete list's pairing leaves out."""
    plates = []
    for case in d.cases:
        left = [f"{f:g} Hz" for f in left_aside(case)]
        if left:
            plates.append(listed(left, "and") + (f" of {case.name}" if len(d.cases) > 1 else ""))
    return f", with {listed(plates, 'and')} left out as no mode of the plate" if plates else ""


def size_text(cause: Cause) -> str:
    """Sizes of an effect, mean and sd with their unit."""
    sizes = []
    for parameter in cause.hypothesis.parameters:
        mean, sd, _ = cause.parameters[parameter.name]
        shown, factor = parameter.display
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


def repeatability_text(d: Diagnosis) -> str:
    """What the residuals are held against by the predictive p-value."""
    inferred = d.weighed.none.marginal.comparison.noise is not None
    return "the believed repeatability" if inferred else "the stated repeatability"


def sensitivity_sentence(d: Diagnosis) -> str:
    """What becomes of the claim with other scales of the priors."""
    inferred = d.weighed.none.marginal.comparison.noise is not None
    scales = "prior scales of causes and noise" if inferred else "prior scales of the causes"
    if d.sensitivity.claim_stands:
        return f"The claim is the same with the {scales} times 3 and divided by 3."
    changed = [
        f"{how} it is {claim.kind}{': ' + listed(claim.causes, 'and') if claim.causes else ''}"
        for how, claim in zip(("times 3", "divided by 3"), d.sensitivity.claims, strict=True)
    ]
    return f"The claim depends on the {scales}: {', '.join(changed)}."


def _nearest(d: Diagnosis) -> str:
    """What stands for an error outside the catalogue in the extended model."""
    nearest = max(d.causes, key=lambda c: c.probability)
    if nearest.name == OTHER:
        return (
            "The extended model adds a scatter of all modes to the noise, which widens the intervals and "
            "repairs no frequency."
        )
    title = "the plain model" if nearest.name == NONE else nearest.name
    return (
        f"Of all hypotheses {title} comes nearest, probability {probability_text(nearest.probability)}, "
        "and leaves a misfit that is no noise. The extended model averages over the hypotheses; its "
        "intervals do not cover what none of them contains."
    )


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
