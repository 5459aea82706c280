"""What a diagnosis says, in sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from cpam_bayes.diagnosis.claim import BESIDE, Claim
from cpam_bayes.diagnosis.diagnose import Cause, Diagnosis
from cpam_bayes.diagnosis.fit import Fit
from cpam_bayes.diagnosis.hypotheses import NONE, OTHER, causes_in
from cpam_bayes.diagnosis.paired_modes import left_aside
from cpam_bayes.formatting import fixed, listed, significant, with_spread
from cpam_bayes.parameters import Parameter
from cpam_bayes.report.diagnosis.rows import (
    DetectableRow,
    detectable_rows,
    noise_of,
    tested_causes,
    titles_of,
)
from cpam_bayes.report.sentences import noise_word

__all__ = [
    "claim_sentence",
    "detectable_size",
    "p_value_text",
    "probability_text",
    "seen_sentences",
    "sensitivity_sentence",
    "size_text",
    "with_title",
]

# A standard deviation that is a smaller share of its mean is none: one node holds all the weight.
_UNSURE = 1e-3
# Sizes of so many standard deviations of the catalogue are usual; causes that a sentence lists at most.
_USUAL_SD, _FEW = 3.0, 3
# Probability from which a cause is told where time was up before all were tested.
_TOLD = 1e-3


def claim_sentence(d: Diagnosis) -> str:
    """The claim in one sentence or two."""
    p = probability_text(d.claim.probability)
    by_name = {cause.name: cause for cause in d.causes}
    causes = [with_title(d, name) for name in d.claim.causes]
    match d.claim.kind:
        case "none":
            return (
                f"No evidence of a model error{_at_noise(d)}: the plate model as it stands has probability "
                f"{p}{_false(d)}.{_may_be_there(d)}"
            )
        case "named":
            cause = by_name[d.claim.causes[0]]
            size = _of_size(cause) if d.probability_beside < BESIDE * d.claim.probability else ""
            return (
                f"The plate model lacks {_at_least(d)}one thing: {causes[0]}{size}{_where(d, cause)}; "
                f"probability {p}.{_beside(d)}{_alike(d, cause)}"
            )
        case "class":
            return (
                f"The plate model lacks {_at_least(d)}one thing of {len(causes)}, and "
                f"these frequencies cannot tell which: {'; '.join(causes)}. "
                f"Together they have probability {p}.{_beside(d)}"
            )
        case "pair":
            pair = next(c for c in d.causes if set(causes_in(c.name)) == set(d.claim.causes))
            each = "; ".join(f"{with_title(d, name)}{_of_one(pair, name)}" for name in causes_in(pair.name))
            return f"The plate model lacks two things at once: {each}{_where(d, pair)}; probability {p}."
        case "other":
            return (
                "The plate model lacks something that no cause of the catalogue explains: probability "
                f"{p}. The residuals by mode show where. {_nearest(d)}"
            )
    none = probability_text(by_name[NONE].probability)
    other = probability_text(by_name[OTHER].probability)
    leaders = [f"{with_title(d, c.name)}, {probability_text(c.probability)}" for c in _most_probable(d)]
    if d.weighed.is_cut_short:
        leaders = [text for text, c in zip(leaders, _most_probable(d), strict=True) if c.probability >= _TOLD]
        begun = (
            "Undecided: time was up before every cause was tested, and nothing can be claimed. Among what "
            "was tested the plate model as it stands "
        )
    else:
        begun = (
            f"Undecided: nothing is probable enough to be claimed{_at_noise(d)}. "
            "The plate model as it stands "
        )
    return f"{begun}has probability {none}, an error that is not in the catalogue {other}" + (
        f"; the most probable causes are: {'; '.join(leaders)}." if leaders else "."
    )


def with_title(d: Diagnosis, name: str) -> str:
    """A cause in words with its key; a pair with both."""
    if name == NONE:
        return "the plate model as it stands"
    if name == OTHER:
        return "an error that is not in the catalogue"
    titles = titles_of(d)
    return " together with ".join(
        f"{titles[part]} ({part})" if part in titles else part for part in causes_in(name)
    )


def seen_sentences(d: Diagnosis) -> tuple[str, ...]:
    """Where nothing is claimed: what these frequencies would have shown, and what may be there unseen."""
    if d.claim.kind not in (NONE, "undecided"):
        return ()
    rows = detectable_rows(d)
    seen = [row for row in rows if row.in_sd is not None and row.in_sd <= _USUAL_SD]
    large = [row for row in rows if row.in_sd is not None and row.in_sd > _USUAL_SD]
    unseen = _unseen(d)
    said = []
    if seen:
        sizes = "; ".join(f"{row.title} from {detectable_size(row)}" for row in seen)
        said.append(f"These frequencies would have shown, with 95 % probability: {sizes}.")
    if large:
        some = "; ".join(f"{row.title} from {detectable_size(row)}" for row in large[:_FEW])
        more = f"; and {len(large) - _FEW} more" if len(large) > _FEW else ""
        said.append(f"These causes would have shown only at sizes far beyond the usual: {some}{more}.")
    if unseen:
        said.append(f"These causes need not show at any size: {'; '.join(unseen)}.")
    return tuple(said)


def _unseen(d: Diagnosis) -> list[str]:
    """Titles of the causes that need not show at any size."""
    rows = detectable_rows(d)
    return [row.title for row in rows if row.smallest is None and row.probability is not None]


def _may_be_there(d: Diagnosis) -> str:
    """What "no evidence" does not say."""
    sized = [row for row in detectable_rows(d) if row.probability is not None]
    unseen = sum(row.in_sd is None or row.in_sd > 1.0 for row in sized)
    if not unseen:
        return ""
    return (
        f" An error may be there all the same: at their usual sizes, {unseen} of {len(tested_causes(d))} "
        "causes would not have been seen."
    )


def _at_noise(d: Diagnosis) -> str:
    """The noise at which a claim is made."""
    noise = noise_of(d.weighed.plain)
    if noise is None:
        return " at the stated repeatability"
    return f" at a noise of {significant(100.0 * noise[0], 2)} %, {noise_word(noise[0])}"


def _at_least(d: Diagnosis) -> str:
    """Whether something may act beside what is claimed."""
    return "at least " if d.probability_beside >= BESIDE * d.claim.probability else ""


def _of_one(pair: Cause, name: str) -> str:
    """Size and place of one of two causes."""
    effects = [effect for effect in pair.hypothesis.records if effect.name == name]
    names = {p.name for effect in effects for p in effect.parameters}
    size = _sizes(pair, [p for p in pair.hypothesis.parameters if p.name in names])
    return f", {size}" if size else ""


def _beside(d: Diagnosis) -> str:
    """What may act beside what is claimed."""
    if d.probability_beside < BESIDE * d.claim.probability:
        return ""
    names = list(d.beside)
    said = [f"{with_title(d, name)}, {probability_text(d.beside[name])}" for name in names[:_FEW]]
    more = f"; and {len(names) - _FEW} more" if len(names) > _FEW else ""
    unknown = ", of which these frequencies cannot tell what it is" if len(names) > 1 else ""
    return (
        f" Something else acts beside it with probability {probability_text(d.probability_beside)}{unknown}: "
        f"{'; '.join(said)}{more}."
    )


def _alike(d: Diagnosis, cause: Cause) -> str:
    """The causes that frequencies cannot tell from the one that is named."""
    if not cause.indistinguishable_from:
        return ""
    others = [with_title(d, name) for name in cause.indistinguishable_from[:_FEW]]
    return (
        f" The frequencies alone cannot tell this cause from: {'; '.join(others)}. The usual sizes of errors "
        "favour the first."
    )


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
    """Sizes of an effect, mean and sd with their unit, and where it is or which way it goes."""
    return _sizes(cause, cause.hypothesis.parameters)


def _sizes(cause: Cause, parameters: Sequence[Parameter]) -> str:
    coordinates = {p.name for effect in cause.hypothesis.records for p in effect.coordinates}
    sizes, places = [], []
    for parameter in parameters:
        mean, sd, _ = cause.parameters[parameter.name]
        shown, factor = parameter.display
        if sd < _UNSURE * abs(mean):  # looked at in passing, at a few sizes
            text = f"about {significant(factor * mean, 2)} {shown}".rstrip()
        else:
            value, spread = with_spread(factor * mean, factor * sd)
            text = f"{value} +- {spread} {shown}".rstrip()
        if parameter.name in coordinates:
            places.append(f"{_axis(parameter.name)} {text}".strip())
        else:
            sizes.append(text)
    return f"{'; '.join(sizes)}{' at ' if sizes and places else ''}{', '.join(places)}"


_AXES = {"x": "x =", "y": "y =", "gyration": "radius of gyration"}


def _axis(name: str) -> str:
    """What stands before a coordinate: x or y of a place, a radius of gyration, nothing of a direction."""
    return _AXES.get(name.rsplit("_", 1)[-1], "")


def probability_text(p: float) -> str:
    """A probability with as many digits as it is worth."""
    if p < 0.0005:
        return "< 0.001"
    return "> 0.999" if p > 0.9995 else fixed(p, 3 if p < 0.1 or p > 0.9 else 2)


def p_value_text(d: Diagnosis, fit: Fit) -> str:
    """The p-value of a fit, and what it is the chance of."""
    inferred = d.weighed.none.marginal.comparison.noise is not None
    noise = "the repeatability believed before the measurement" if inferred else "the stated repeatability"
    return f"{probability_text(fit.predictive_p)}, the chance of residuals as large with {noise}"


def sensitivity_sentence(d: Diagnosis) -> str:
    """What becomes of the claim with other scales of the priors."""
    inferred = d.weighed.none.marginal.comparison.noise is not None
    what = "errors and noise" if inferred else "errors"
    begun = f"Believing beforehand in {what} three times as large, or a third as large,"
    if d.sensitivity.claim_stands:
        return f"{begun} leaves the claim as it is."
    each = zip(d.sensitivity.claims, d.sensitivity.probabilities, strict=True)
    larger, smaller = (_short(d, claim, probability) for claim, probability in each)
    return f"{begun} changes the claim: three times as large, {larger}; a third as large, {smaller}."


def _short(d: Diagnosis, claim: Claim, probability: Mapping[str, float]) -> str:
    """A claim in a few words; probability : of every cause, with its prior."""
    if not claim.causes:
        nothing = claim.kind == NONE
        return "no evidence of a model error" if nothing else "no known cause explains the frequencies"
    if claim.kind == "undecided":
        first = max((name for name in probability if name not in (NONE, OTHER)), key=lambda n: probability[n])
        none, other, of_first = (probability_text(probability.get(n, 0.0)) for n in (NONE, OTHER, first))
        return (
            f"undecided, with probability {none} for the plate model as it stands, {other} for an error that "
            f"is not in the catalogue and {of_first} for the most probable cause, {with_title(d, first)}"
        )
    return "; ".join(with_title(d, name) for name in claim.causes)


def _nearest(d: Diagnosis) -> str:
    """What stands for an error outside the catalogue in the extended model."""
    nearest = max(d.causes, key=lambda c: c.probability)
    if nearest.name == OTHER:
        return (
            "The extended model adds a scatter of all modes to the noise, which widens the intervals and "
            "repairs no frequency."
        )
    return (
        f"Of all hypotheses {with_title(d, nearest.name)} comes nearest, probability "
        f"{probability_text(nearest.probability)}, and leaves a misfit that is no noise. The extended model "
        "averages over the hypotheses; its intervals do not cover what none of them contains."
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
