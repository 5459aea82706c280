"""Every reason not to trust an identification as it stands, in sentences."""

from __future__ import annotations

import math

import numpy as np

from cpam_bayes.formatting import significant
from cpam_bayes.forward_model.labels import shape_warnings
from cpam_bayes.forward_model.preconditions import SUSPICIOUS_RATIO
from cpam_bayes.forward_model.sandwich import sandwich_warnings
from cpam_bayes.forward_model.solve import LARGE_ERROR, error_warning
from cpam_bayes.identification.point import PointEstimate
from cpam_bayes.identification.sampled_result import SampledResult
from cpam_bayes.identification.search import Residual
from cpam_bayes.inference.diagnostics.completeness import TranscriptionError
from cpam_bayes.inference.diagnostics.constraints import (
    constraint_warnings,
    cut_warnings,
    limiting_constraints,
)
from cpam_bayes.plate import Specimen
from cpam_bayes.priors import TruncatedNormal

__all__ = ["point_warnings", "sampled_warnings"]

# The solver's error matters where it is more than this fraction of the noise.
_FRACTION_OF_NOISE = 0.2
# A search model is good to some 5e-5 of a frequency; beyond this it lacks something.
_SEARCH_ERROR = 3e-4
# A relative residual beyond this is no scatter of a measurement any more.
_POOR_FIT = 0.05
# A posterior predictive p-value this far out says that noise alone does not explain the residuals.
_P_LOW = 0.02


def point_warnings(result: PointEstimate, residual: Residual) -> tuple[str, ...]:
    """Everything that is a reason not to trust the numbers as they stand.

    residual : what the swarm minimised.
    """
    problems = list(result.warnings)
    problems += _other_misfit(result, residual)
    problems += _poor_fit(result)
    if result.swarm.status == "budget":
        problems.append(result.swarm.message)
    limit = _FRACTION_OF_NOISE * result.noise if math.isfinite(result.noise) else LARGE_ERROR
    problems += error_warning(result.error, limit)
    problems += _on_constraints(result)
    problems += _other_labels(result)
    problems += _of_shapes(result)
    problems += _unused(result.specimen)
    problems += sandwich_warnings(
        result.specimen, result.predicted, {c.name: c.value for c in result.constants}
    )
    return tuple(problems)


def _other_misfit(result: PointEstimate, residual: Residual) -> list[str]:
    """A warning if the swarm saw another misfit at its best than the full plate model has there."""
    measurement = result.specimen.measurement
    assert measurement is not None
    predicted = np.array([mode.frequency for mode in result.predicted])
    difference = predicted - measurement.frequencies
    scale = float(np.max(measurement.frequencies))
    if residual == "relative":
        difference, scale = difference / measurement.frequencies, 1.0
    reduced = math.sqrt(result.swarm.value / measurement.size)
    full = float(np.sqrt(np.mean(difference**2)))
    if abs(full - reduced) <= _SEARCH_ERROR * scale:
        return []
    unit, factor = ("%", 100.0) if residual == "relative" else ("Hz", 1.0)
    return [
        f"the reduced model of the search had an rms misfit of {significant(factor * reduced, 3)} {unit} at "
        f"these constants, the full model has {significant(factor * full, 3)} {unit}: others fit better"
    ]


def _poor_fit(result: PointEstimate) -> list[str]:
    measurement = result.specimen.measurement
    assert measurement is not None
    predicted = np.array([mode.frequency for mode in result.predicted])
    relative = predicted / measurement.frequencies - 1.0
    worst = int(np.argmax(np.abs(relative)))
    # Beyond this ratio the units are suspected, which `identify` says itself.
    off_by_units = abs(np.log1p(relative[worst])) > np.log(SUSPICIOUS_RATIO)
    if off_by_units or abs(relative[worst]) <= _POOR_FIT:
        return []
    return [
        f"the prediction of mode {worst + 1} is {100 * relative[worst]:+.1f} % off: even with its best "
        "constants the model does not describe this list; do not trust them before the plate, the "
        "edges and the order and completeness of the frequencies are checked"
    ]


def _on_constraints(result: PointEstimate) -> tuple[str, ...]:
    specimen = result.specimen
    best = np.array([c.value for c in result.constants])
    return constraint_warnings(
        "the best constants lie on the constraint",
        limiting_constraints(specimen.material, specimen.unknowns, best),
    )


def _other_labels(result: PointEstimate) -> list[str]:
    measurement = result.specimen.measurement
    assert measurement is not None
    problems = []
    for i, (given, mode) in enumerate(zip(measurement.labels, result.predicted, strict=True), 1):
        if given and given.replace(" ", "") != mode.label.replace(" ", ""):
            problems.append(
                f"frequency {i} is labelled {given} in the plate file and compared with the mode that "
                f"follows from it; at these constants its shape is rather {mode.label}"
            )
    return problems


def _of_shapes(result: PointEstimate) -> list[str]:
    measurement = result.specimen.measurement
    assert measurement is not None
    return [
        f"{text}; the swarm takes the most probable pairing, --backend emcee weighs them all"
        if result.by_shape is not None and len(result.by_shape.assignments) > 1
        else text
        for text in shape_warnings(result.by_shape, measurement)
    ]


def _unused(specimen: Specimen) -> list[str]:
    """What the plate file gives and the swarm has no use for."""
    problems = []
    priors = [
        name for name in specimen.unknowns.names if isinstance(specimen.unknowns[name].prior, TruncatedNormal)
    ]
    if priors:
        problems.append(
            f"mean and sd of {', '.join(priors)} in [unknowns] do not enter the swarm's fit, only "
            "the bounds do"
        )
    return problems


def sampled_warnings(result: SampledResult) -> tuple[str, ...]:
    """Everything that is a reason not to trust the numbers as they stand."""
    problems = []
    measurement = result.posterior.measurement
    unknowns = len(result.elastic_constants)
    if measurement.size <= unknowns:
        many = "frequency" if measurement.size == 1 else "frequencies"
        problems.append(f"{measurement.size} {many} for {unknowns} unknowns: the prior decides")
    if result.result.status == "budget":
        d = result.result.diagnostics
        problems.append(
            f"the chains used their budget of {d.steps} steps before they converged (R-hat "
            f"{d.r_hat:.3f}, {d.ess_bulk:.0f} effective samples): means and intervals are not reliable; "
            "allow more steps"
        )
    if result.result.not_stored is not None:
        problems.append(result.result.not_stored)
    if result.doubt is not None:
        problems.append(transcription_error_sentence(result.doubt))
    draws = dict(zip(result.posterior.parameters.names, result.result.draws.T, strict=True))
    problems += cut_warnings(result.specimen.material, draws)
    if result.p_value < _P_LOW:
        problems.append(
            f"posterior predictive p-value {result.p_value:.3f}: the residuals are larger than the noise "
            "of the plate file explains, the plate model lacks something or the noise is larger"
        )
    weighed = "; all pairings are weighed by their probability" if result.posterior.alternatives else ""
    problems += [f"{text}{weighed}" for text in shape_warnings(result.by_shape, measurement)]
    found = {c.name: c.mean for c in result.elastic_constants}
    return (*problems, *sandwich_warnings(result.specimen, result.modes, found))


def transcription_error_sentence(doubt: TranscriptionError) -> str:
    """What of a complete list looks as if it were not, and what to do about it."""
    times = f"{np.exp(doubt.log_odds):.0f}" if doubt.log_odds < np.log(1e4) else "more than 10000"
    if doubt.missed is not None:
        what = f"lacks the mode {doubt.missed.label}, near {doubt.missed.frequency:.4g} Hz"
    else:
        what = f"holds a frequency that belongs to no mode, {doubt.spurious:.6g} Hz"
    return (
        f"the list looks as if it {what}: that is {times} times as probable as one frequency for every "
        "mode; if so, set complete = false in [measurement]"
    )
