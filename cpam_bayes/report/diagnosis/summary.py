"""`diagnose` in plain words: what is wrong, how sure, what could have been seen, what to do next."""

from __future__ import annotations

from typing import Final

import numpy as np

from cpam_bayes.diagnosis.diagnose import Cause, Diagnosis
from cpam_bayes.diagnosis.hypotheses import NONE, OTHER
from cpam_bayes.diagnosis.plates import DiagnosisResult
from cpam_bayes.formatting import significant
from cpam_bayes.identification.scale_errors import ScaleError, number_of
from cpam_bayes.plate import Specimen, unit_of
from cpam_bayes.plate.units import USER_UNITS
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
    decided_by,
    frequencies_text,
    mismatch_step,
    noise_sentence,
    plate_sentence,
    scale_sentences,
    stated_noise,
)
from cpam_bayes.report.summary import ConstantLine, Summary, more_modes_step

# Leading causes whose check in the laboratory is named where nothing is claimed.
_CHECKED: Final = 2
# Probability of deciding from which a further test is recommended as such.
_DECIDES: Final = 0.3


def summary(result: DiagnosisResult) -> Summary:
    """The claim, the constants that follow, what both rest on, and what to do next."""
    d = result.diagnosis
    rows = averaged_rows(d) if d.extended is None else constant_rows(d, d.extended)
    constants = tuple(_constant(d, row) for row in rows)
    use = [c.symbol for c in constants if c.determined != "no"]
    unseen, gauge = _unseen(d, result.plates[0], use) if len(result.plates) == 1 else ((), ())
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
            *unseen,
        ),
        warnings=(*depends, *(w for w in result.warnings if w not in result.slips)),
        next_steps=(*_next_steps(result, constants), *gauge),
    )


def _constant(d: Diagnosis, row: ConstantRow) -> ConstantLine:
    name = USER_UNITS[row.name][0]
    case = next(c for c in d.cases if name in c.models.specimen.unknowns.names)
    determined = DETERMINED[row.verdict]
    by = "the frequencies"
    if determined != "yes":
        by = decided_by(name, case.models.parameters[name].prior)
    return ConstantLine(
        symbol=name,
        title=constant_title(name, case.models.specimen.material),
        key=row.name,
        value=row.mean,
        interval=(row.q025, row.q975),
        unit=unit_of(name),
        reference=row.reference,
        determined=determined,
        by=by,
    )


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


def _next_steps(result: DiagnosisResult, constants: tuple[ConstantLine, ...]) -> tuple[str, ...]:
    d = result.diagnosis
    steps = [step for plate in result.plates for step in mismatch_step(plate, result.slips)]
    steps += _checks(d)
    asked = any("[[sensor]]" in step for step in steps)
    if not asked and d.claim.kind in (NONE, "undecided") and len(result.plates) == 1:
        steps += attached_step(result.plates[0])
    if result.candidates:
        best = result.candidates[0]
        chance = f"{100 * best.decided:.0f} %"
        if best.decided >= _DECIDES:
            steps.append(
                f"The most telling further test: {best.description}; the chance that it decides is {chance}."
            )
        else:
            steps.append(
                f"No single further test is likely to decide; the most telling one is {best.description} "
                f"(chance {chance})."
            )
    noise = noise_of(d.weighed.plain)
    if noise is not None:
        steps.append(
            "Repeat the tap test and give relative_std in [measurement]: with a measured repeatability "
            "smaller errors can be seen."
        )
    steps += more_modes_step(constants)
    return tuple(steps)


def _checks(d: Diagnosis) -> list[str]:
    """How the laboratory checks what is claimed, or the most probable causes where nothing is."""
    if d.claim.kind == NONE:
        return []
    claimed: list[Cause] = [c for c in d.causes if c.name in d.claim.causes]
    if d.claim.kind in ("undecided", OTHER):
        claimed = [c for c in d.causes if c.name not in (NONE, OTHER)][:_CHECKED]
    records = {e.name: e for cause in claimed for e in cause.hypothesis.records}
    return [f"Check for {e.title}: {e.check[:1].lower()}{e.check[1:]}" for e in records.values()]
