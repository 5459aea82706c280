"""`diagnose` in plain words: what is wrong, how sure, what could have been seen, what to do next."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import Final

import numpy as np

from cpam_bayes.diagnosis.diagnose import Cause, Diagnosis
from cpam_bayes.diagnosis.fitting import PlateCase
from cpam_bayes.diagnosis.hypotheses import NONE, OTHER, causes_in
from cpam_bayes.diagnosis.next_test.next_measurement import Candidate
from cpam_bayes.diagnosis.plates import DiagnosisResult
from cpam_bayes.formatting import significant
from cpam_bayes.identification.scale_errors import ScaleError, number_of
from cpam_bayes.plate import Specimen, unit_of
from cpam_bayes.plate.units import USER_UNITS
from cpam_bayes.priors import Prior
from cpam_bayes.report.diagnosis.rows import (
    ConstantRow,
    absorbed_biases,
    averaged_rows,
    constant_rows,
    hidden_causes,
    noise_of,
    tested_causes,
)
from cpam_bayes.report.diagnosis.words import (
    claim_sentence,
    seen_sentences,
    sensitivity_sentence,
)
from cpam_bayes.report.sentences import (
    DETERMINED,
    attached_step,
    constant_title,
    contained_sentence,
    decider,
    frequencies_text,
    mismatch_step,
    noise_sentence,
    plate_sentence,
    reliance_sentences,
    rests_on,
    scale_sentences,
    stated_noise,
)
from cpam_bayes.report.summary import ConstantLine, Summary, more_modes_step

# Causes whose check in the laboratory is named where nothing is claimed: their number, and least probability.
_CHECKED: Final = 2
_LIKELY: Final = 0.1
# Fraction of the answer from which it contains what hypotheses of it contain.
_CONTAINED: Final = 0.5
# Probability of deciding from which a further test is recommended as such.
_DECIDES: Final = 0.3


def summary(result: DiagnosisResult) -> Summary:
    """The claim, the constants that follow, what both rest on, and what to do next."""
    d = result.diagnosis
    rows = averaged_rows(d) if d.extended is None else constant_rows(d, d.extended)
    constants = tuple(_constant(d, row) for row in rows)
    use = [c.symbol for c in constants if c.determined != "no"]
    unseen, gauge = _unseen(d, result.plates[0], use) if len(result.plates) == 1 else ((), ())
    relied = reliance_sentences(d.reliances, lambda name: _prior(d, name), use)
    depends = () if d.sensitivity.claim_stands else (sensitivity_sentence(d),)
    return Summary(
        title=f"diagnose {result.title}",
        slips=result.slips,
        headline=claim_sentence(d),
        constants=constants,
        basis=(
            _weighed(d),
            _constants_from(d),
            *_gain(d),
            *_noise(d),
            *(plate_sentence(s) if len(result.plates) == 1 else _named(s) for s in result.plates),
            *seen_sentences(d),
            *_contained(d, result.plates),
            *unseen,
            *relied,
        ),
        warnings=(*depends, *(w for w in result.warnings if w not in result.slips)),
        next_steps=_next_steps(result, constants, gauge),
    )


def _constant(d: Diagnosis, row: ConstantRow) -> ConstantLine:
    name = USER_UNITS[row.name][0]
    case = _case_with(d, name)
    return ConstantLine(
        symbol=name,
        title=constant_title(name, case.models.specimen.material),
        key=row.name,
        value=row.mean,
        interval=(row.q025, row.q975),
        unit=unit_of(name),
        reference=row.reference,
        determined=DETERMINED[row.verdict],
        by=decider(row.verdict, name, _prior(d, name)),
        rests_on=rests_on(name, d.reliances, lambda other: _prior(d, other)),
    )


def _case_with(d: Diagnosis, constant: str) -> PlateCase:
    """The first plate of which a constant is unknown."""
    return next(c for c in d.cases if constant in c.models.specimen.unknowns.names)


def _prior(d: Diagnosis, constant: str) -> Prior:
    return _case_with(d, constant).models.parameters[constant].prior


def _weighed(d: Diagnosis) -> str:
    n, causes = len(d.baseline.measured), len(tested_causes(d))
    return (
        f"{causes} causes were weighed against the plate model as it stands, which repeats the "
        f"{frequencies_text(n)} to {significant(100 * d.baseline.rms, 2)} % (root mean square)."
    )


def _constants_from(d: Diagnosis) -> str:
    if d.extended is None:
        return "The constants are averaged over all causes and none, each with its probability."
    return "The constants are those of the model that contains what was found, not of the plate model alone."


def _gain(d: Diagnosis) -> tuple[str, ...]:
    if d.gain is None or d.extended is None:
        return ()
    before, after = (significant(100 * rms, 2) for rms in (d.gain.rms_before, d.gain.rms_after))
    return (
        f"The extended model brings the misfit from {before} % to {after} %; without any one frequency the "
        f"claim stays ahead in {100 * d.gain.stable:.0f} % of the cases.",
    )


def _noise(d: Diagnosis) -> tuple[str, ...]:
    claimed = d.extended is not None
    noise = noise_of(d.members if claimed else d.weighed.plain)
    if noise is None:
        return _stated(d)
    model = "extended model" if claimed else "plate model"
    return (noise_sentence(noise[0], f"the level is inferred from the misfit of the {model}"),)


def _stated(d: Diagnosis) -> tuple[str, ...]:
    """The noise of the plate files."""
    said = []
    for case in d.cases:
        measurement, of = case.measurement, f" of {case.name}" if len(d.cases) > 1 else ""
        if measurement.frequency_sd is not None:
            level = float(np.mean(measurement.frequency_sd / measurement.frequencies))
        elif measurement.relative_std is not None:
            level = measurement.relative_std
        else:
            continue
        said.append(noise_sentence(level, f"the level is {stated_noise(measurement)}{of}"))
    return tuple(said)


def _named(specimen: Specimen) -> str:
    return f"{specimen.name}: {plate_sentence(specimen)}"


def _contained(d: Diagnosis, plates: Sequence[Specimen]) -> tuple[str, ...]:
    """Which errors of size, mass and scale the intervals contain, once where all plates are alike."""
    said = [_contained_of(d, specimen) for specimen in plates]
    if len(set(said)) == 1:
        return (said[0],)
    return tuple(f"{s.name}: {text}" for s, text in zip(plates, said, strict=True))


def _contained_of(d: Diagnosis, specimen: Specimen) -> str:
    plate = specimen.plate

    def numbers(cause: str) -> set[str]:
        return {n for part in causes_in(cause) if (n := number_of(part, plate))}

    if d.extended is not None and d.claim.kind != OTHER:
        contained: dict[str, float] = defaultdict(float)
        for claimed in d.claim.causes:
            contained |= dict.fromkeys(numbers(claimed), 1.0)
        for t, fraction in d.members:
            for name in numbers(t.hypothesis.cause):
                contained[name] += fraction
        return contained_sentence(plate, found=[name for name, f in contained.items() if f >= _CONTAINED])
    weight = sum(c.probability for c in d.causes if numbers(c.name) - set(plate.sd))
    return contained_sentence(plate, weight=weight)


def _unseen(d: Diagnosis, specimen: Specimen, shown: list[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Errors of size, mass and scale as `scale_sentences` says them, from the causes that are absorbed."""
    errors = []
    for cause in hidden_causes(d):
        name = number_of(cause.name, specimen.plate)
        if name is None:
            continue
        _, unit, per_unit = absorbed_biases(d, cause)
        if unit != "%":
            continue
        # An unmodelled excess of the true number shows as this error of the constants.
        shift = {USER_UNITS[key][0]: value for key, value in per_unit.items()}
        sd = specimen.plate.sd.get(name)
        known = None if sd is None else float(sd / getattr(specimen.plate, name))
        errors.append(ScaleError(name, shift, cause.visible, known))
    return scale_sentences(specimen, errors, shown)


def _next_steps(
    result: DiagnosisResult, constants: tuple[ConstantLine, ...], gauge: tuple[str, ...]
) -> tuple[str, ...]:
    """What costs nothing first, then what is claimed, the same test once more, another test.

    gauge : what to measure of the plate.
    """
    d = result.diagnosis
    steps = [step for plate in result.plates for step in mismatch_step(plate, result.slips)]
    checks = _checks(d)
    asked = any("[[sensor]]" in step for step in checks)
    if not asked and d.claim.kind in (NONE, "undecided") and len(result.plates) == 1:
        steps += attached_step(result.plates[0])
    steps += [*checks, *gauge]
    if noise_of(d.weighed.plain) is not None:
        steps.append(
            "Repeat the tap test and give relative_std in [measurement]: with a measured repeatability "
            "smaller errors can be seen."
        )
    return (*steps, *more_modes_step(constants), *_further_test(result.candidates))


def _further_test(candidates: Sequence[Candidate]) -> tuple[str, ...]:
    """The test that most probably decides which cause it is, recommended where it probably does."""
    if not candidates:
        return ()
    best = max(candidates, key=lambda c: c.decided)
    chance = f"{100 * best.decided:.0f} %"
    if best.decided >= _DECIDES:
        return (f"Do a further test: {best.description}; the chance that it decides is {chance}.",)
    if len(candidates) == 1:
        return (f"One further test was computed and is not likely to decide: {best.description}, {chance}.",)
    return (
        f"No single further test is likely to decide what is wrong: of the {len(candidates)} that were "
        f"computed the best chance is {chance}, with {best.description}.",
    )


def _checks(d: Diagnosis) -> list[str]:
    """How the laboratory checks what is claimed, or the probable causes where nothing is."""
    if d.claim.kind == NONE:
        return []
    claimed: list[Cause] = [c for c in d.causes if c.name in d.claim.causes]
    if d.claim.kind in ("undecided", OTHER):
        likely = [c for c in d.causes if c.name not in (NONE, OTHER) and c.probability >= _LIKELY]
        claimed = likely[:_CHECKED]
    records = {e.name: e for cause in claimed for e in cause.hypothesis.records}
    return [f"Check for {e.title}: {e.check[:1].lower()}{e.check[1:]}" for e in records.values()]
