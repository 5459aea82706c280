"""The first screen of a diagnosis: claim, constants that allow for it, fit, next step."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

import numpy as np

from cpam_bayes.answer import Notice, Verdict
from cpam_bayes.diagnosis.diagnose import Cause, Diagnosis
from cpam_bayes.diagnosis.evidence.sets import SETS
from cpam_bayes.diagnosis.extension import left_aside
from cpam_bayes.diagnosis.fit import inferred_noise
from cpam_bayes.diagnosis.hypotheses import CLAIM_RULES, NONE, OTHER, Claim, causes_in
from cpam_bayes.diagnosis.next_test import Candidate
from cpam_bayes.diagnosis.places import images_of
from cpam_bayes.effects import Effect
from cpam_bayes.formatting import listed, significant
from cpam_bayes.forward_model.known_errors import ScaleError, absorbed, number_of
from cpam_bayes.forward_model.three_dimensions import sandwich_notices
from cpam_bayes.plate import Specimen
from cpam_bayes.questions.diagnose.document import (
    FEW,
    DiagnosisResult,
    answer_constants,
    detectable_rows,
    detectable_size,
    place_of,
    places_of,
    probability_text,
    size_text,
    some_of,
    title_of,
)
from cpam_bayes.render.report import (
    Summary,
)
from cpam_bayes.render.sentences import (
    attached_step,
    bounds_step,
    constants_table,
    contradicts_itself,
    fit_sentence,
    gauge_step,
    intervals_sentence,
    mismatch_step,
    stated_noise,
)

# Probability of deciding from which a further test is recommended.
_DECIDES: Final = 0.3
# Probability from which a cause is to be checked where nothing is claimed, and how many are.
_LIKELY, _CHECKED = 0.1, 2
# Bayes factor below which a list is no evidence of an error (Kass and Raftery, J. Am. Stat. Assoc. 90, 1995).
_EVIDENCE: Final = 3.0
# Probability from which a cause is reported where time ran out before all were tested.
_TOLD: Final = 1e-3
# Image places listed beside the first one.
_IMAGES: Final = 3
# Share of the answer's probability from which a cause counts as part of it.
_CONTAINED: Final = 0.5


def summary(result: DiagnosisResult) -> Summary:
    """The first screen: claim, constants that allow for it, fit, next step."""
    d = result.diagnosis
    return Summary(
        title=f"diagnose {result.title}",
        headline=headline(result),
        tables=(constants_table(answer_constants(d)),),
        lines=(
            _fit_sentence(d),
            *_beside(d),
            *_alike(d),
            *_seen(d),
            *_left_out(d),
            *_contained(d, result.plates),
        ),
        next_step=next(iter(next_steps(result)), ""),
        slips=result.slips,
        warnings=(
            *(() if d.sensitivity.claim_stands else (sensitivity_sentence(d),)),
            *result.cautions,
        ),
    )


def headline(result: DiagnosisResult) -> str:
    """The claim; limited to the frequencies where the plate file contradicts itself."""
    said = claim_sentence(result.diagnosis)
    if contradicts_itself(result.notices):
        return f"From the frequencies alone: {said[:1].lower()}{said[1:]}"
    return said


def claim_sentence(d: Diagnosis) -> str:
    """The claim in one sentence, with its size and probability."""
    p = probability_text(d.claim.probability)
    by_name = {cause.name: cause for cause in d.causes}
    match d.claim.kind:
        case "none":
            wrong, factor = probability_text(d.something_wrong), significant(d.bayes_factor, 2)
            return f"No evidence of an error (probability of one {wrong}, Bayes factor {factor})."
        case "named":
            cause = by_name[d.claim.causes[0]]
            acts_alone = cause.probability >= _CONTAINED * d.claim.probability
            if acts_alone and not d.beside:
                return f"{_capital(_found(d, cause))} (probability {p})."
            said = _capital(title_of(d, cause.name) + _of_plates(d, cause))
            if not acts_alone:
                return f"{said}, together with another error (probability {p})."
            return f"{said} (probability {p}){_alone(d, cause)}."
        case "class":
            which = listed([title_of(d, name) for name in d.claim.causes], "or")
            return (
                f"Something is wrong: {which}, which these frequencies cannot tell apart (probability {p})."
            )
        case "pair":
            number = {2: "Two", 3: "Three"}[len(d.claim.causes)]
            return f"{number} errors at once: {_found(d, d.several)} (probability {p})."
        case "other":
            within = {name: q for name, q in d.inclusion.items() if q >= _CONTAINED}
            if within:
                part = _with_probabilities(d, within)
                return f"Something is wrong that no known error explains by itself ({p}); part of it: {part}."
            return f"Something is wrong that no known error explains (probability {p})."
    return _undecided(d)


def _undecided(d: Diagnosis) -> str:
    """Headline where nothing is claimed: what is open is the cause, or whether there is an error at all."""
    acting = {**d.inclusion, OTHER: d.weighed.by_cause().get(OTHER, 0.0)}
    causes = dict(sorted(acting.items(), key=lambda entry: -entry[1])[:FEW])
    if d.weighed.is_cut_short:
        causes = {name: p for name, p in causes.items() if p >= _TOLD}
        begun = "Undecided: time was up before every cause was tested"
        return f"{begun}; most probable so far: {_with_probabilities(d, causes)}." if causes else f"{begun}."
    wrong, open_ = probability_text(d.something_wrong), _with_probabilities(d, causes)
    sure = {name: p for name, p in causes.items() if name != OTHER and p >= CLAIM_RULES.sure}
    if sure and d.weighed.unaccounted > SETS.unaccounted:
        rest = _with_probabilities(d, {name: p for name, p in causes.items() if name not in sure})
        also = f" ({rest})" if rest else ""
        begun = listed(
            [f"{title_of(d, name)} ({probability_text(p)} of what was tested)" for name, p in sure.items()],
            "and",
        )
        return f"{_capital(begun)}; what else is wrong is open{also}."
    if d.something_wrong >= CLAIM_RULES.sure:
        return f"Something is wrong ({wrong}); cause open: {open_}."
    if d.baseline.predictive_p <= CLAIM_RULES.explained:
        return f"The misfit is more than noise; cause open: {open_}."
    factor = significant(d.bayes_factor, 2)
    if d.bayes_factor < _EVIDENCE:
        return f"This test is too weak to exclude an error (Bayes factor {factor})."
    return f"Perhaps something is wrong ({wrong}, Bayes factor {factor}); cause open: {open_}."


def _with_probabilities(d: Diagnosis, causes: Mapping[str, float]) -> str:
    return ", ".join(f"{title_of(d, name)} {probability_text(p)}" for name, p in causes.items())


def _found(d: Diagnosis, cause: Cause) -> str:
    """A cause with its size and place; the effects of a set in turn."""
    said, in_list = [], _in_list(d, cause)
    of_list = dict(zip(cause.hypothesis.unmodelled, in_list, strict=False))
    for effect in cause.hypothesis.records:
        size = size_text(cause, (effect,))
        if effect.local == "point":
            said.append(f"something heavy was on the plate, {size}{_near(d, cause, effect)}")
        else:
            said.append(", ".join(t for t in (of_list.get(effect, effect.title), size) if t))
    told = bool(in_list) or any(e.is_anywhere for e in cause.hypothesis.records)
    where = f" ({cause.variant}{_or_images(d, cause)})" if cause.variant and not told else ""
    return f"{'; '.join(said) or title_of(d, cause.name)}{where}{_of_plates(d, cause)}"


def _or_images(d: Diagnosis, cause: Cause) -> str:
    """Phrase for a corner or edge that symmetry makes equal to others; "" for none."""
    facts = [case.models.facts for case in d.cases if case.name in cause.plates]
    for effect in cause.hypothesis.records:
        corners = effect.place is not None and images_of((effect.place[0], effect.place[1]), facts)[1:]
        along = effect.edges if effect.variant else None
        if corners or (along is not None and all(len(along(f)) > 1 for f in facts)):
            return ", or a place equal by symmetry"
    return ""


def _alone(d: Diagnosis, cause: Cause) -> str:
    """Size and place of a cause beside which another may act; "" where it has no size."""
    size = size_text(cause)
    return f": {size}{_near(d, cause)} if alone" if size else ""


def _near(d: Diagnosis, cause: Cause, effect: Effect | None = None) -> str:
    """The place of an effect with its images, "" where it has none; effect : as in `place_of`."""
    plate = next(case for case in d.cases if case.name in cause.plates).models.specimen.plate
    place = place_of(cause, plate, effect)
    if place is None:
        return ""
    first, *others = (f"({1e3 * x:.0f}, {1e3 * y:.0f})" for x, y in places_of(d, cause, effect))
    near = f"{listed([first, *others], 'or')} mm"
    if len(others) > _IMAGES:
        near = f"{first} mm or one of its {len(others)} images"
    return f" near {near}, +- {1e3 * max(place[1]):.0f} mm"


def _in_list(d: Diagnosis, cause: Cause) -> list[str]:
    """The errors of the list in words."""
    change = cause.hypothesis.listed
    case = next(case for case in d.cases if case.name in cause.plates)
    f, k = case.measurement.frequencies, change.spurious
    hz = "" if k is None else f"{f[k]:g} Hz"
    missed = listed([str(k + 1) for k in change.missed], "and")
    if missed and hz:
        return [f"{hz} is a misreading of mode {missed}"]
    if missed:
        return [f"the list lacks mode {missed}"]
    if hz:
        return [f"{hz} is not a mode of the plate"]
    return [f"misread frequency {f[i]:g} Hz" for i in change.misread]


def _of_plates(d: Diagnosis, cause: Cause) -> str:
    if len(d.cases) == 1:
        return ""
    return ", of all plates" if len(cause.plates) == len(d.cases) else f", of {listed(cause.plates, 'and')}"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _fit_sentence(d: Diagnosis) -> str:
    """How well the model fits, before and after allowing for the claim."""
    if d.extended is not None and d.claim.kind != OTHER:
        allowing = {"class": "Allowing for one of them", "pair": "Allowing for these"}
        before, after = (significant(100.0 * f.rms_as_stated, 2) for f in (d.baseline, d.extended))
        begun = allowing.get(d.claim.kind, "Allowing for it")
        return f"{begun}, the misfit at the stated sizes falls from {before} % to {after} %{_unexplained(d)}."
    noise = inferred_noise(d.weighed.plain)
    if d.claim.kind == OTHER and noise is not None:
        return f"Fit {significant(100.0 * d.baseline.rms, 2)} %{_unexplained(d)}."
    noisiest = max((case.measurement for case in d.cases), key=lambda m: m.relative_noise or 0.0)
    return fit_sentence(
        d.baseline.rms,
        stated=noisiest.relative_noise,
        measurement=noisiest,
        inferred=None if noise is None else noise[0],
        explained=d.plain_explained,
    )


def _unexplained(d: Diagnosis) -> str:
    """Misfit that neither noise nor the claim explains, if any."""
    probability, size = d.leftover
    return f"; {significant(100.0 * size, 2)} % remains unexplained" if probability >= 0.5 else ""


def stated_levels(d: Diagnosis) -> list[tuple[float, str]]:
    """The relative noise of each list that states one, and where it is stated."""
    found = []
    for case in d.cases:
        measurement, of = case.measurement, f" of {case.name}" if len(d.cases) > 1 else ""
        if measurement.relative_noise is not None:
            found.append((measurement.relative_noise, f"{stated_noise(measurement)}{of}"))
    return found


def _beside(d: Diagnosis) -> tuple[str, ...]:
    if not d.beside:
        return ()
    said = some_of([f"{title_of(d, name)} {probability_text(p)}" for name, p in d.beside.items()])
    return (f"Perhaps also: {said}.",)


def _alike(d: Diagnosis) -> tuple[str, ...]:
    """Causes that the frequencies cannot distinguish from the named one."""
    cause = next((c for c in d.causes if c.name in d.claim.causes), None)
    if d.claim.kind != "named" or cause is None or not cause.indistinguishable_from:
        return ()
    others = [title_of(d, name) for name in cause.indistinguishable_from[:FEW]]
    which = listed(others, "or")
    return (f"These frequencies cannot exclude {which}: only the assumed sizes of errors speak against it.",)


def _seen(d: Diagnosis) -> tuple[str, ...]:
    """The smallest detectable forgotten mass, or else the error with the lowest detection limit."""
    if d.claim.kind not in (NONE, "undecided"):
        return ()
    rows = [row for row in detectable_rows(d) if row.probability is not None]
    masses = {e.name for c in d.causes for e in c.hypothesis.records if e.local == "point"}
    mass = next((row for row in rows if row.cause in masses), None)
    if mass is not None and mass.smallest is not None:
        return (f"A forgotten mass of {detectable_size(mass)} or more would have been seen.",)
    seen = [row for row in rows if row.in_sd is not None]
    best = min(seen, key=lambda row: row.in_sd or 0.0, default=None)
    shown = f"{_capital(best.title)}: {detectable_size(best)} or more would have been seen" if best else ""
    if mass is not None:
        said = "a forgotten mass would not" if shown else "A forgotten mass would not have been seen"
        return (f"{'; '.join(t for t in (shown, said) if t)}.",)
    return (f"{shown}.",) if shown else ()


def _left_out(d: Diagnosis) -> tuple[str, ...]:
    """Frequencies to which the pairing of an incomplete list assigns no mode."""
    if d.claim.kind != NONE:
        return ()
    what = (
        "Peaks" if any(case.measurement.mode_probability is not None for case in d.cases) else "Frequencies"
    )
    plates = []
    for case in d.cases:
        left = [f"{f:g} Hz" for f in left_aside(case)]
        if left:
            plates.append(listed(left, "and") + (f" of {case.name}" if len(d.cases) > 1 else ""))
    return (f"{what} without a mode: {listed(plates, 'and')}.",) if plates else ()


def _contained(d: Diagnosis, plates: Sequence[Specimen]) -> tuple[str, ...]:
    """Errors of size, mass and scale contained in the intervals, once if equal for all plates."""
    said = [_contained_of(d, specimen) for specimen in plates]
    if len(set(said)) == 1:
        return (said[0],)
    return tuple(f"{s.name}: {text}" for s, text in zip(plates, said, strict=True))


def _contained_of(d: Diagnosis, specimen: Specimen) -> str:
    plate = specimen.plate

    def numbers(cause: str) -> set[str]:
        return {n for part in causes_in(cause) if (n := number_of(part, plate))}

    contained: dict[str, float] = defaultdict(float)
    if d.claim.kind in ("named", "class", "pair"):
        for claimed in d.claim.causes:
            contained |= dict.fromkeys(numbers(claimed), 1.0)
        for t, fraction in d.members:
            for name in numbers(t.hypothesis.cause):
                contained[name] += fraction
    found = [name for name, fraction in contained.items() if fraction >= _CONTAINED]
    return intervals_sentence(plate, scale_errors_of(d, specimen), shown_constants(d), found=found)


def shown_constants(d: Diagnosis) -> list[str]:
    """Constants that are not decided by the prior alone."""
    return [c.name for c in answer_constants(d) if c.verdict is not Verdict.PRIOR]


def sensitivity_sentence(d: Diagnosis) -> str:
    """Dependence of the claim on the scales of the priors."""
    inferred = d.weighed.none.marginal.comparison.noise is not None
    what = "errors and noise" if inferred else "errors"
    if d.sensitivity.claim_stands:
        return f"The claim does not depend on the assumed sizes of {what}."
    each = zip(d.sensitivity.claims, d.sensitivity.probabilities, strict=True)
    larger, smaller = (_short(d, claim, probability) for claim, probability in each)
    return (
        f"The claim depends on the assumed sizes of {what}: with three times as large ones {larger}; with a "
        f"third of them {smaller}."
    )


def _short(d: Diagnosis, claim: Claim, probability: Mapping[str, float]) -> str:
    """A claim in a few words; probability : of every cause, under those priors."""
    if claim.kind == NONE:
        return "no evidence of an error"
    if claim.kind == "undecided":
        return f"undecided, nothing wrong {probability_text(probability.get(NONE, 0.0))}"
    if not claim.causes:
        return "an unknown error"
    return listed([title_of(d, name) for name in claim.causes], "or" if claim.kind == "class" else "and")


def next_steps(result: DiagnosisResult) -> tuple[str, ...]:
    """Next steps, the most useful first: correct the list, check what is claimed, or measure more."""
    d, constants = result.diagnosis, answer_constants(result.diagnosis)
    mismatch = (step for plate in result.plates for step in mismatch_step(plate, result.notices))
    steps = [*bounds_step(result.notices), *mismatch]
    if d.claim.kind == OTHER:
        steps.append("see which modes are off: their shapes show where the cause acts.")
    further, decides = _further_test(result.candidates)
    one = result.plates[0]
    gauge = gauge_step(one, scale_errors_of(d, one), shown_constants(d)) if len(result.plates) == 1 else ()
    repeat = ("repeat the tap test and state its repeatability in the plate file: smaller errors then show.",)
    checks = tuple(effect.check[:1].lower() + effect.check[1:] for effect in checked_effects(d))
    asks = d.claim.kind in (NONE, "undecided") and not any(e.local == "point" for e in checked_effects(d))
    attached = attached_step(result.plates[0]) if asks and len(result.plates) == 1 else ()
    if decides and d.claim.kind != "named":
        steps += further
    steps += checks
    if inferred_noise(d.weighed.plain) is not None:
        steps += repeat
    steps += (*gauge, *attached)
    left = listed([c.name for c in constants if c.verdict in (Verdict.PRIOR, Verdict.BOTH)], "and")
    steps += [f"measure more modes: {left} may then be determined."] if left else []
    return tuple(dict.fromkeys((*steps, *further)))


def checked_effects(d: Diagnosis) -> tuple[Effect, ...]:
    """Effects for the laboratory to check: those claimed, or else the probable ones."""
    if d.claim.kind == NONE:
        return ()
    names = list(d.claim.causes)
    if d.claim.kind in ("undecided", OTHER):
        names = [name for name, p in d.inclusion.items() if p >= _LIKELY][:_CHECKED]
    causes = [c for c in d.causes if c.name in names]
    return tuple({e.name: e for cause in causes for e in cause.hypothesis.records}.values())


def _further_test(candidates: Sequence[Candidate]) -> tuple[tuple[str, ...], bool]:
    """The test most likely to decide between the causes, and whether it probably does."""
    if not candidates:
        return (), False
    best = max(candidates, key=lambda c: c.decided)
    chance = f"{100 * best.decided:.0f} %"
    if best.decided >= _DECIDES:
        return (f"do a further test: {best.description}; it decides with probability {chance}.",), True
    return (f"no single further test is likely to decide; the best is {best.description}, {chance}.",), False


def scale_errors_of(d: Diagnosis, specimen: Specimen) -> tuple[ScaleError, ...]:
    """Errors of the constants by sizes, mass and frequency scale of one plate, at the answer."""
    case = next(case for case in d.cases if case.models.specimen is specimen)
    models, paired = case.models, np.flatnonzero(case.modes >= 0)
    found = {c.name: c.value for c in answer_constants(d)}
    # plates of several materials have no constants in common
    constants = {n: found.get(n, models.parameters[n].prior.mean) for n in specimen.unknowns.names}
    prior_sd = {name: models.parameters[name].prior.sd for name in constants}
    taken_up = absorbed(specimen, models.bare.full, constants, case.modes[paired], prior_sd, paired)
    return taken_up.errors(usual=True)


def beyond_theory(result: DiagnosisResult) -> Iterator[Notice]:
    """Notices of sandwiches whose core is so soft that the error of plate theory may look like a cause."""
    rows = result.plain.frequencies
    for specimen in result.plates:
        modes = [row.mode for row in rows if row.plate == specimen.name and row.mode is not None]
        yield from sandwich_notices(specimen, modes)
