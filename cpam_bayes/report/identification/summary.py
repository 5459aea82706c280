"""`identify` by the swarm in plain words."""

from __future__ import annotations

import math

import numpy as np

from cpam_bayes.formatting import significant
from cpam_bayes.identification.identify import PointResult
from cpam_bayes.identification.point import ConstantEstimate, PointEstimate
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
    plate_argument,
    plate_sentence,
    reliance_sentences,
    rests_on,
    scale_sentences,
    stated_noise,
)
from cpam_bayes.report.summary import ConstantLine, Summary, determined_by, more_modes_step


def summary(result: PointResult) -> Summary:
    """The constants, what decides them, what they rest on, and what to do next."""
    estimate = result.estimate
    constants = tuple(_constant(result, c) for c in estimate.constants)
    use = [c.symbol for c in constants if c.determined != "no"]
    unseen, gauge = scale_sentences(result.specimen, estimate.scale_errors, use)
    return Summary(
        title=f"identify {result.title}",
        slips=result.slips,
        headline=_headline(result, constants),
        constants=constants,
        basis=(
            _fit(result),
            _noise(estimate),
            plate_sentence(result.specimen),
            contained_sentence(result.specimen.plate),
            *unseen,
            *reliance_sentences(estimate.reliances, lambda name: result.specimen.unknowns[name].prior, use),
        ),
        warnings=(
            *(high_noise_warning(estimate.noise) if estimate.noise_is_inferred and not result.slips else ()),
            *(w for w in result.warnings if w not in result.slips),
        ),
        next_steps=_next_steps(result, constants, gauge),
    )


def _headline(result: PointResult, constants: tuple[ConstantLine, ...]) -> str:
    said = determined_by(constants, len(result.frequencies))
    if result.angles is None:
        return said
    angles = "/".join(f"{a:g}" for a in result.angles.angles_deg)
    how = f": `cpam-bayes sequence {plate_argument(result.specimen)}` gives each its probability"
    return (
        f"The unknown angles that fit best are {angles}; other angles may fit as well"
        f"{'' if result.specimen.plate.layup.kinds else how}. {said}"
    )


def _constant(result: PointResult, c: ConstantEstimate) -> ConstantLine:
    specimen = result.specimen
    unit = to_user(c.name, 1.0)
    verdict, prior = DETERMINED[c.verdict], specimen.unknowns[c.name].prior
    by = decider(c.verdict, c.name, prior)
    if c.bound is not None:
        end = c.lower if c.bound == "lower" else c.upper
        by, verdict = f"its {c.bound} bound {to_user(c.name, end):.5g} {unit_of(c.name)}".rstrip(), "no"
    elif not math.isfinite(c.sd):
        verdict = "no"
    elif c.elsewhere:
        by, verdict = "the choice between several optima that fit alike", "no"
    return ConstantLine(
        symbol=c.name,
        title=constant_title(c.name, specimen.material),
        key=user_name(c.name),
        value=unit * c.value,
        interval=None if c.interval is None else (unit * c.interval[0], unit * c.interval[1]),
        unit=unit_of(c.name),
        reference=unit * c.reference,
        determined=verdict,
        by=by,
        rests_on=rests_on(c.name, result.estimate.reliances, lambda name: specimen.unknowns[name].prior),
    )


def _fit(result: PointResult) -> str:
    residuals = np.array([row.residual for row in result.frequencies])
    worst = int(np.argmax(np.abs(residuals)))
    side = "too high" if residuals[worst] > 0 else "too low"
    return (
        f"With these constants the plate model repeats the {frequencies_text(len(residuals))} to "
        f"{significant(100 * result.estimate.rms, 2)} % (root mean square); the worst is frequency "
        f"{worst + 1}, predicted {significant(100 * abs(residuals[worst]), 2)} % {side}."
    )


def _noise(estimate: PointEstimate) -> str:
    measurement = estimate.specimen.measurement
    assert measurement is not None
    n, k = measurement.size, len(estimate.constants)
    if not math.isfinite(estimate.noise):
        return (
            f"No intervals can be given: {frequencies_text(n)} for {k} unknowns leave nothing to tell the "
            "noise by."
        )
    if not estimate.noise_is_inferred:
        return noise_sentence(estimate.noise, f"the level is {stated_noise(measurement)}")
    return noise_sentence(
        estimate.noise, f"the level is estimated from the misfit of {n} frequencies with {k} constants fitted"
    )


def _next_steps(
    result: PointResult, constants: tuple[ConstantLine, ...], gauge: tuple[str, ...]
) -> tuple[str, ...]:
    """What costs nothing first; gauge : what to measure of the plate."""
    plate = plate_argument(result.specimen)
    steps = [
        *mismatch_step(result.specimen, result.slips, [row.label for row in result.frequencies]),
        *attached_step(result.specimen),
    ]
    if result.angles is None:
        steps += diagnose_step(result.specimen)
        steps.append(f"Get the full posterior of the constants: cpam-bayes identify {plate} --backend emcee")
    elif not result.specimen.plate.layup.kinds:  # the other commands want a known layup
        steps.append(f"Get the probability of every layup on the grid: cpam-bayes sequence {plate}")
        steps.append(
            f"Get all of it, with the most probable layup, on one page: cpam-bayes report {plate} --out DIR"
        )
    steps += gauge
    if result.estimate.noise_is_inferred:
        steps.append(
            "Repeat the tap test and give relative_std in [measurement]: a measured noise is better than one "
            "estimated from the misfit."
        )
    return (*steps, *more_modes_step(constants))
