"""Every reason not to trust an identification as it stands."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from cpam_bayes.answer import Constant, Notice, as_written
from cpam_bayes.forward_model.labels import ShapePairing, same_label, shape_notices
from cpam_bayes.forward_model.preconditions import (
    LARGE_ERROR,
    SUSPICIOUS_RATIO,
    count_notices,
    error_notices,
)
from cpam_bayes.forward_model.theory_error import sandwich_notices
from cpam_bayes.identification.point import PointEstimate
from cpam_bayes.identification.search import Residual
from cpam_bayes.inference.assessment import cut_notices, limiting_constraints
from cpam_bayes.inference.completeness import TranscriptionError
from cpam_bayes.inference.ensemble import EnsembleResult
from cpam_bayes.inference.posterior import Posterior
from cpam_bayes.mechanics.modes import Mode
from cpam_bayes.plate import Specimen

__all__ = ["point_notices", "sampled_notices"]

# The solver's error matters where it is more than this fraction of the noise.
_FRACTION_OF_NOISE = 0.2
# A search model is good to some 5e-5 of a frequency; beyond this it lacks something.
_SEARCH_ERROR = 3e-4
# A relative residual beyond this is no scatter of a measurement any more.
_POOR_FIT = 0.05
# A posterior predictive p-value this far out says that noise alone does not explain the residuals.
_P_LOW = 0.02


def point_notices(result: PointEstimate, residual: Residual) -> tuple[Notice, ...]:
    """Every reason not to trust the numbers of a swarm as they stand.

    residual : what the swarm minimised.
    """
    limit = _FRACTION_OF_NOISE * result.noise if math.isfinite(result.noise) else LARGE_ERROR
    found = {c.name: c.value for c in result.constants}
    return (
        *result.notices,
        *_other_misfit(result, residual),
        *_poor_fit(result),
        *([Notice("swarms_disagree")] if result.swarm.status == "budget" else []),
        *error_notices(result.error, limit),
        *_on_constraints(result),
        *_other_labels(result),
        *_of_shapes(result),
        *_unused(result.specimen, residual),
        *sandwich_notices(result.specimen, result.predicted, found),
    )


def _other_misfit(result: PointEstimate, residual: Residual) -> Iterator[Notice]:
    """A notice if the swarm saw another misfit at its best than the full plate model has there."""
    measurement = result.specimen.measurement
    assert measurement is not None
    predicted = np.array([mode.frequency for mode in result.predicted])
    if residual == "whitened":  # a part in 1e4 of a frequency, over the noise, is for the density to say
        return
    difference = predicted - measurement.frequencies
    scale = float(np.max(measurement.frequencies))
    if residual == "relative":
        difference, scale = difference / measurement.frequencies, 1.0
    reduced = math.sqrt(result.swarm.value / measurement.size)
    full = float(np.sqrt(np.mean(difference**2)))
    if abs(full - reduced) > _SEARCH_ERROR * scale:
        yield Notice(
            "search_model", facts={"reduced": reduced, "full": full, "relative": residual == "relative"}
        )


def _poor_fit(result: PointEstimate) -> Iterator[Notice]:
    measurement = result.specimen.measurement
    assert measurement is not None
    predicted = np.array([mode.frequency for mode in result.predicted])
    relative = predicted / measurement.frequencies - 1.0
    worst = int(np.argmax(np.abs(relative)))
    # Beyond this ratio the units are suspected, which a notice of its own says.
    off_by_units = abs(np.log1p(relative[worst])) > np.log(SUSPICIOUS_RATIO)
    if not off_by_units and abs(relative[worst]) > _POOR_FIT:
        yield Notice("poor_fit", facts={"mode": worst + 1, "residual": float(relative[worst])})


def _on_constraints(result: PointEstimate) -> Iterator[Notice]:
    specimen = result.specimen
    best = np.array([c.value for c in result.constants])
    for constraint in limiting_constraints(specimen.material, specimen.unknowns, best):
        yield Notice("optimum_on_constraint", facts={"constraint": constraint})


def _other_labels(result: PointEstimate) -> Iterator[Notice]:
    measurement = result.specimen.measurement
    assert measurement is not None
    for i, (given, mode) in enumerate(zip(measurement.labels, result.predicted, strict=True), 1):
        if given and same_label(given) != same_label(mode.label):
            yield Notice("other_label", facts={"frequency": i, "given": given, "found": mode.label})


def _of_shapes(result: PointEstimate) -> tuple[Notice, ...]:
    measurement, pairing = result.specimen.measurement, result.by_shape
    assert measurement is not None
    several = pairing is not None and len(pairing.assignments) > 1
    return shape_notices(pairing, measurement, "best" if several else None)


def _unused(specimen: Specimen, residual: Residual) -> Iterator[Notice]:
    """Notices of entries of the plate file that the swarm does not use."""
    unknowns = specimen.unknowns
    names = tuple(name for name in unknowns.names if not unknowns[name].prior.is_range)
    if names and residual != "whitened":
        yield Notice("prior_not_fitted", facts={"names": names})


def sampled_notices(
    specimen: Specimen,
    posterior: Posterior,
    chains: EnsembleResult,
    constants: Mapping[str, Constant],
    modes: Sequence[Mode],
    p_value: float,
    doubt: TranscriptionError | None,
    pairing: ShapePairing | None,
) -> tuple[Notice, ...]:
    """Every reason not to trust the numbers of a sampled posterior as they stand.

    modes : of the model at the most probable draw. p_value : posterior predictive. pairing : by shape.
    """
    measurement = posterior.measurement
    notices = [*count_notices(measurement.size, len(constants))]
    if chains.status == "budget":
        d = chains.diagnostics
        facts = {"steps": d.steps, "r_hat": d.r_hat, "ess_bulk": d.ess_bulk}
        notices.append(Notice("chains_not_converged", facts=facts))
    if chains.not_stored is not None:
        notices += as_written([chains.not_stored])
    if doubt is not None:
        notices.append(transcription_notice(doubt))
    draws = dict(zip(posterior.parameters.names, chains.draws.T, strict=True))
    notices += cut_notices(specimen.material, draws)
    if p_value < _P_LOW:
        notices.append(Notice("unexplained_residuals", facts={"p": p_value}))
    notices += shape_notices(pairing, measurement, "all" if posterior.alternatives else None)
    found = {name: c.value for name, c in constants.items()}
    return (*notices, *sandwich_notices(specimen, modes, found))


def transcription_notice(doubt: TranscriptionError) -> Notice:
    """A complete list that looks as if it were not."""
    facts = {
        "missed": None if doubt.missed is None else (doubt.missed.label, doubt.missed.frequency),
        "spurious": doubt.spurious,
        "log_odds": doubt.log_odds,
    }
    return Notice("doubtful_list", facts=facts)
