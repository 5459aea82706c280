"""Which mode each measured frequency is, under a fit of a diagnosis, and the modes themselves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.diagnosis.diagnose import Diagnosis
from cpam_bayes.diagnosis.evidence.weighing import Tested
from cpam_bayes.diagnosis.fit import Fit
from cpam_bayes.diagnosis.fitting import PlateCase
from cpam_bayes.mechanics.shapes import Mode, shapes_on_grid

__all__ = [
    "FrequencyRow",
    "MissedMode",
    "PairedFit",
    "left_aside",
    "paired_fit",
    "plain_mode_shapes",
]

Array = NDArray[Any]

_SHAPE_POINTS = 31


@dataclass(frozen=True, slots=True)
class FrequencyRow:
    """One measured frequency, what a fit predicts for it, and the mode it belongs to.

    predicted, predicted_sd, sigma : Hz; predicted is ``None`` for a frequency that is no mode. number :
    of the mode in ascending order, from 1. standardised : predicted - measured over the standard
    deviations of noise and prediction together.
    """

    plate: str
    measured: float
    predicted: float | None
    predicted_sd: float
    sigma: float
    standardised: float
    number: int | None
    mode: Mode | None

    @property
    def residual_percent(self) -> float | None:
        """predicted / measured - 1, in percent."""
        return None if self.predicted is None else 100.0 * (self.predicted / self.measured - 1.0)


@dataclass(frozen=True, slots=True)
class MissedMode:
    """A mode of the model that a list lacks under a hypothesis."""

    plate: str
    number: int
    mode: Mode


@dataclass(frozen=True, slots=True)
class PairedFit:
    """A fit with the mode of every frequency, and the modes that the measured frequencies lack."""

    frequencies: tuple[FrequencyRow, ...]
    missed: tuple[MissedMode, ...]


def paired_fit(d: Diagnosis, fit: Fit, leader: Tested) -> PairedFit:
    """All frequencies plate by plate; leader : the hypothesis that says which mode each is."""
    modes = [case.models.bare.full.modes(_plate_vector(leader, i)) for i, case in enumerate(d.cases)]
    return PairedFit(_frequency_rows(d, fit, leader, modes), _missed_modes(d, leader, modes))


def plain_mode_shapes(d: Diagnosis) -> tuple[Array, ...]:
    """Mode shapes of every plate by the plain model at its most probable constants."""
    shapes = []
    for i, case in enumerate(d.cases):
        model = case.models.bare.full
        spectrum = model.spectrum(_plate_vector(d.weighed.none, i), vectors=True)
        shapes.append(shapes_on_grid(model.operator, spectrum, n=_SHAPE_POINTS))
    return tuple(shapes)


def _frequency_rows(
    d: Diagnosis, fit: Fit, leader: Tested, modes_of: Sequence[Sequence[Mode]]
) -> tuple[FrequencyRow, ...]:
    """All frequencies plate by plate; leader : the hypothesis that says which mode each is."""
    rows: list[FrequencyRow] = []
    start = 0
    standardised = fit.standardised
    for i, (case, part) in enumerate(zip(d.cases, leader.marginal.comparison.model.parts, strict=True)):
        modes = modes_of[i]
        n = case.measurement.size
        spurious = leader.hypothesis.listed.spurious if len(part.modes) < n else None
        paired = iter(part.modes)
        listed = []
        for k in range(n):
            j = start + k
            false_peak = k == spurious
            number = None if false_peak else int(next(paired))
            listed.append(
                FrequencyRow(
                    plate=case.name,
                    measured=float(fit.measured[j]),
                    predicted=None if false_peak else float(fit.predicted[j]),
                    predicted_sd=float(fit.predicted_sd[j]),
                    sigma=float(fit.sigma[j]),
                    standardised=float("nan") if false_peak else -float(standardised[j]),
                    number=None if number is None else number + 1,
                    mode=None if number is None or number >= len(modes) else modes[number],
                )
            )
        start += n
        nan = float("nan")
        listed += [FrequencyRow(case.name, f, None, nan, nan, nan, None, None) for f in left_aside(case)]
        rows += sorted(listed, key=lambda row: row.measured)
    return tuple(rows)


def left_aside(case: PlateCase) -> list[float]:
    """Frequencies of an incomplete list that its most probable pairing gives no mode."""
    measurement = case.models.specimen.measurement
    if measurement is None or measurement.complete:
        return []
    kept = set(case.measurement.frequencies.tolist())
    return [f for f in measurement.frequencies.tolist() if f not in kept]


def _missed_modes(d: Diagnosis, leader: Tested, modes_of: Sequence[Sequence[Mode]]) -> tuple[MissedMode, ...]:
    """Modes in the range of the lists that these lack under a hypothesis."""
    missed: list[MissedMode] = []
    for i, (case, part) in enumerate(zip(d.cases, leader.marginal.comparison.model.parts, strict=True)):
        gaps = sorted(set(range(int(part.modes.max()) + 1)) - {int(k) for k in part.modes})
        if gaps:
            modes = modes_of[i]
            missed += [MissedMode(case.name, k + 1, modes[k]) for k in gaps if k < len(modes)]
    return tuple(missed)


def _plate_vector(t: Tested, i: int) -> Array:
    """Parameters of the bare model of one plate where a hypothesis is most probable."""
    part, x = t.marginal.comparison.model.parts[i], t.marginal.best
    constants = np.array(x[part.columns])
    varied = part.scatter >= 0
    constants[varied] *= 1.0 + x[part.scatter[varied]]
    return constants
