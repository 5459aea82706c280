"""What an engineer must be told about an identification, in sentences."""

from __future__ import annotations

import math

import numpy as np

from cpam_bayes.formatting import significant
from cpam_bayes.identification.point import SUSPICIOUS_RATIO, ConstantEstimate, Identification, Residual
from cpam_bayes.plate import Specimen, to_user, user_name
from cpam_bayes.priors import TruncatedNormal

__all__ = ["error_warning", "noise_sentence", "verdict_sentences", "warnings_of"]

# The solver's error matters where it is more than this share of the noise ...
_SHARE_OF_NOISE = 0.2
# ... or, where the noise is not known, more than this share of a frequency.
_LARGE_ERROR = 1e-3
# A search model is good to some 5e-5 of a frequency; beyond this it lacks something.
_SEARCH_ERROR = 3e-4
# A residual beyond this share of a frequency is no scatter of a measurement any more.
_POOR_FIT = 0.05


def warnings_of(result: Identification, residual: Residual) -> tuple[str, ...]:
    """Everything that is a reason not to trust the numbers as they stand.

    residual : what the swarm minimised.
    """
    found = list(result.warnings)
    found += _other_misfit(result, residual)
    found += _poor_fit(result)
    if result.swarm.status == "budget":
        found.append(result.swarm.message)
    limit = _SHARE_OF_NOISE * result.noise if math.isfinite(result.noise) else _LARGE_ERROR
    found += error_warning(result.error, limit)
    found += _other_labels(result)
    found += _unused(result.specimen)
    return tuple(found)


def error_warning(error: np.typing.NDArray[np.float64], limit: float = _LARGE_ERROR) -> list[str]:
    """A warning if the solver's estimated relative error (n_modes,) is above a limit."""
    worst = float(np.max(error))
    if not worst > limit:
        return []
    return [
        f"the solver's error is up to {significant(100 * worst, 2)} % of a frequency "
        f"(mode {int(np.argmax(error)) + 1}), which is not small here"
    ]


def verdict_sentences(result: Identification) -> tuple[str, ...]:
    """Which constants to believe, and why not the others."""
    if not math.isfinite(result.noise):
        n = result.predicted
        first = (
            f"No standard deviations: {len(n)} frequencies for {len(result.constants)} unknowns "
            "leave nothing to tell the noise by. Give relative_std or more frequencies.",
        )
        on_bound = [c for c in result.constants if c.bound is not None]
        return first + tuple(_verdict(result, c) for c in on_bound)
    doubtful = tuple(_verdict(result, c) for c in result.constants if c.verdict != "determined")
    sure = [c.name for c in result.constants if c.verdict == "determined"]
    told = f"Determined by the frequencies: {', '.join(sure) or 'none of the constants'}."
    return (*doubtful, told)


def _verdict(result: Identification, constant: ConstantEstimate) -> str:
    name = constant.name
    if constant.bound is not None:
        value = constant.lower if constant.bound == "lower" else constant.upper
        shown = f"{to_user(name, value):g} {user_name(name).removeprefix(name).strip('_')}".strip()
        return (
            f"{name} sits on its {constant.bound} bound, {shown}: the bound decided, not the "
            "frequencies. Its sd does not hold there, and the other constants depend on the bound."
        )
    share = 100 * constant.sd / result.specimen.unknowns[name].prior.sd
    spread = f"its sd is {share:.0f} % of that of the search interval"
    if constant.verdict == "not determined":
        return f"{name} is not determined by the frequencies: {spread}. Do not use its value."
    return f"{name} is weakly determined by the frequencies: {spread}."


def noise_sentence(result: Identification) -> str:
    """What the standard deviations stand on."""
    measurement = result.specimen.measurement
    assert measurement is not None
    if not math.isfinite(result.noise):
        return "not known"
    level = f"{significant(100 * result.noise, 2)} % of a frequency"
    rounding = f", and the rounding to {measurement.resolution:g} Hz" if measurement.resolution else ""
    if not result.noise_is_inferred:
        key = "frequency_sd_hz, on average" if measurement.frequency_sd is not None else ""
        return f"{level}, from the plate file ({key or 'relative_std'}){rounding}"
    freedom = measurement.size - len(result.constants)
    return (
        f"{level}, inferred from the residuals ({measurement.size} frequencies less "
        f"{len(result.constants)} unknowns: {freedom} left over){rounding}"
    )


def _other_misfit(result: Identification, residual: Residual) -> list[str]:
    """A warning if the swarm saw another misfit at its best than the full plate model has there."""
    measurement = result.specimen.measurement
    assert measurement is not None
    predicted = np.array([mode.frequency for mode in result.predicted])
    difference = predicted - measurement.frequencies
    scale = float(np.max(measurement.frequencies))
    if residual == "relative":
        difference, scale = difference / measurement.frequencies, 1.0
    seen = math.sqrt(result.swarm.value / measurement.size)
    own = float(np.sqrt(np.mean(difference**2)))
    if abs(own - seen) <= _SEARCH_ERROR * scale:
        return []
    unit, factor = ("%", 100.0) if residual == "relative" else ("Hz", 1.0)
    return [
        f"the fast model of the search had an rms misfit of {significant(factor * seen, 3)} {unit} at these "
        f"constants, the plate solver has {significant(factor * own, 3)} {unit}: they are not the best ones"
    ]


def _poor_fit(result: Identification) -> list[str]:
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


def _other_labels(result: Identification) -> list[str]:
    measurement = result.specimen.measurement
    assert measurement is not None
    found = []
    for i, (given, mode) in enumerate(zip(measurement.labels, result.predicted, strict=True), 1):
        if given and given.replace(" ", "") != mode.label.replace(" ", ""):
            found.append(
                f"frequency {i} is labelled {given} in the plate file and compared with the mode that "
                f"follows from it; at these constants its shape is rather {mode.label}"
            )
    return found


def _unused(specimen: Specimen) -> list[str]:
    """What the plate file gives and the swarm has no use for."""
    found = []
    if specimen.plate.sd:
        names = ", ".join(user_name(name) for name in specimen.plate.sd)
        found.append(f"[plate.sd] is not used by the swarm: the sd leave out that of {names}")
    priors = [
        name for name in specimen.unknowns.names if isinstance(specimen.unknowns[name].prior, TruncatedNormal)
    ]
    if priors:
        found.append(
            f"mean and sd of {', '.join(priors)} in [unknowns] do not enter the swarm's fit, only "
            "the bounds do"
        )
    return found
