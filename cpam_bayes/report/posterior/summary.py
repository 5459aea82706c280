"""`identify --backend emcee`, the posterior of the constants, in plain words."""

from __future__ import annotations

import numpy as np

from cpam_bayes.formatting import listed, significant
from cpam_bayes.identification.sampled import ConstantPosterior, SampledResult
from cpam_bayes.inference.noise import NOISE_NAMES
from cpam_bayes.plate import to_user, unit_of, user_name
from cpam_bayes.report.sentences import (
    DETERMINED,
    attached_step,
    constant_title,
    contained_sentence,
    decider,
    diagnose_step,
    frequencies_text,
    high_noise_warning,
    mismatch_step,
    noise_sentence,
    plate_sentence,
    reliance_sentences,
    rests_on,
    scale_sentences,
    stated_noise,
)
from cpam_bayes.report.summary import ConstantLine, Summary, determined_by, more_modes_step


def summary(result: SampledResult) -> Summary:
    """The constants, what decides them, what they rest on, and what to do next."""
    constants = tuple(_constant(result, c) for c in result.elastic_constants)
    use = [c.symbol for c in constants if c.determined != "no"]
    unseen, gauge = scale_sentences(result.specimen, result.scale_errors, use)
    headline = determined_by(constants, result.posterior.measurement.size)
    if result.status == "budget":
        headline = f"The chains did not converge: do not use this answer, allow more steps. {headline}"
    return Summary(
        title=f"identify {result.title}",
        slips=result.slips,
        headline=headline,
        constants=constants,
        basis=(
            _fit(result),
            *_gaps(result),
            *_noise(result),
            plate_sentence(result.specimen),
            contained_sentence(result.specimen.plate),
            *unseen,
            *reliance_sentences(result.reliances, lambda name: result.posterior.parameters[name].prior, use),
        ),
        warnings=(
            *(() if result.slips else high_noise_warning(_inferred(result))),
            *(w for w in result.warnings if w not in result.slips),
        ),
        next_steps=_next_steps(result, constants, gauge),
    )


def _constant(result: SampledResult, c: ConstantPosterior) -> ConstantLine:
    unit = to_user(c.name, 1.0)
    by = decider(c.verdict, c.name, result.posterior.parameters[c.name].prior)
    if c.bound is not None:
        end = to_user(c.name, c.lower if c.bound == "lower" else c.upper)
        by = f"its {c.bound} bound {end:.5g} {unit_of(c.name)}".rstrip()
    return ConstantLine(
        symbol=c.name,
        title=constant_title(c.name, result.specimen.material),
        key=user_name(c.name),
        value=unit * c.mean,
        interval=(unit * c.q025, unit * c.q975),
        unit=unit_of(c.name),
        reference=unit * c.reference,
        determined=DETERMINED[c.verdict],
        by=by,
        rests_on=rests_on(c.name, result.reliances, lambda name: result.posterior.parameters[name].prior),
    )


def _fit(result: SampledResult) -> str:
    rows = [row for row in result.frequencies if row is not None]
    residuals = np.array([row.residual for row in rows])
    n = len(result.frequencies)
    if not residuals.size:
        return f"None of the {frequencies_text(n)} belongs to a mode of the plate model."
    worst = int(np.argmax(np.abs(residuals)))
    side = "too high" if residuals[worst] > 0 else "too low"
    rms = significant(100 * float(np.sqrt(np.mean(residuals**2))), 2)
    return (
        f"The plate model repeats the {frequencies_text(n)} to {rms} % (root mean square); the worst "
        f"is {rows[worst].measured:.6g} Hz, predicted {significant(100 * abs(residuals[worst]), 2)} % {side}."
    )


def _gaps(result: SampledResult) -> tuple[str, ...]:
    """Modes that the list lacks, and frequencies that belong to no mode."""
    said = []
    if result.missed:
        modes = [
            f"{m.mode.label or m.mode.kind} near {significant(m.predicted, 4)} Hz" for m in result.missed
        ]
        many = "1 mode" if len(modes) == 1 else f"{len(modes)} modes"
        said.append(f"The list lacks {many} that the plate model has in its range: {listed(modes, 'and')}.")
    rows = zip(result.posterior.measurement.frequencies, result.frequencies, strict=True)
    alone = [f"{f:.6g} Hz" for f, row in rows if row is None]
    if alone:
        verb = "belongs" if len(alone) == 1 else "belong"
        said.append(f"{listed(alone, 'and')} {verb} to no mode of the plate model.")
    return tuple(said)


def _noise(result: SampledResult) -> tuple[str, ...]:
    measurement = result.posterior.measurement
    if not any(c.name in NOISE_NAMES for c in result.constants):
        stated = measurement.frequency_sd
        if stated is None and measurement.relative_std is None:
            return ()
        level = measurement.relative_std if stated is None else np.mean(stated / measurement.frequencies)
        return (noise_sentence(float(level or 0.0), f"the level is {stated_noise(measurement)}"),)
    return (noise_sentence(_inferred(result), "the level is inferred from the misfit"),)


def _inferred(result: SampledResult) -> float:
    """The inferred noise, relative; 0 where the plate file states it."""
    noise = [c for c in result.constants if c.name in NOISE_NAMES]
    if not noise:
        return 0.0
    relative = noise[0].name == "relative_std"
    typical = 1.0 if relative else float(np.mean(result.posterior.measurement.frequencies))
    return noise[0].mean / typical


def _next_steps(
    result: SampledResult, constants: tuple[ConstantLine, ...], gauge: tuple[str, ...]
) -> tuple[str, ...]:
    """What costs nothing first; gauge : what to measure of the plate."""
    found = [None if row is None else row.mode.label for row in result.frequencies]
    steps = [*mismatch_step(result.specimen, result.slips, found), *attached_step(result.specimen)]
    if result.status == "budget":
        steps.insert(0, "Allow more steps: --steps N.")
    return (*steps, *diagnose_step(result.specimen), *gauge, *more_modes_step(constants))
