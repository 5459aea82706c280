"""The mode of each measured frequency under a fitted model, and the modes that the lists lack."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from cpam_bayes.diagnosis.comparison import PlateCase
from cpam_bayes.diagnosis.diagnose import Diagnosis
from cpam_bayes.diagnosis.evidence.weighing import Tested
from cpam_bayes.diagnosis.fit import Fit
from cpam_bayes.mechanics.modes import Mode
from cpam_bayes.mechanics.problem import Array


@dataclass(frozen=True, slots=True)
class FrequencyRow:
    """One measured frequency, its prediction by a fit, and its mode.

    predicted, predicted_sd, sigma : Hz; predicted is ``None`` for a false peak. number : of the mode in
    ascending order, from 1. standardised : predicted - measured over the standard deviations of noise and
    prediction together.
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
    """The mode of every frequency under a fit, and the modes that the lists lack."""

    frequencies: tuple[FrequencyRow, ...]
    missed: tuple[MissedMode, ...]


def paired_fit(d: Diagnosis, fit: Fit, leader: Tested) -> PairedFit:
    """Paired fit of all frequencies, plate by plate; leader : the hypothesis whose pairing is used."""
    modes = [case.models.bare.full.modes(_plate_vector(leader, i)) for i, case in enumerate(d.cases)]
    return PairedFit(_frequency_rows(d, fit, leader, modes), _missed_modes(d, leader, modes))


def plain_mode_shapes(d: Diagnosis) -> tuple[Array, ...]:
    """Mode shapes of every plate by the plain model at its most probable constants."""
    return tuple(
        case.models.bare.full.shapes(_plate_vector(d.weighed.none, i)) for i, case in enumerate(d.cases)
    )


def _frequency_rows(
    d: Diagnosis, fit: Fit, leader: Tested, modes_of: Sequence[Sequence[Mode]]
) -> tuple[FrequencyRow, ...]:
    """Rows of all frequencies, plate by plate; leader : the hypothesis whose pairing is used."""
    rows: list[FrequencyRow] = []
    start = 0
    standardised = fit.standardised
    parts = leader.marginal.comparison.model.parts
    for case, part, modes in zip(leader.cases or d.cases, parts, modes_of, strict=True):
        is_paired = case.modes >= 0
        if len(part.modes) < is_paired.sum() and leader.hypothesis.listed.spurious is not None:
            is_paired[leader.hypothesis.listed.spurious] = False
        numbers = iter(part.modes)
        for k in range(case.measurement.size):
            j = start + k
            number = int(next(numbers)) if is_paired[k] else None
            rows.append(
                FrequencyRow(
                    plate=case.name,
                    measured=float(fit.measured[j]),
                    predicted=None if number is None else float(fit.predicted[j]),
                    predicted_sd=float(fit.predicted_sd[j]),
                    sigma=float(fit.sigma[j]),
                    standardised=float("nan") if number is None else -float(standardised[j]),
                    number=None if number is None else number + 1,
                    mode=None if number is None or number >= len(modes) else modes[number],
                )
            )
        start += case.measurement.size
    return tuple(rows)


def left_aside(case: PlateCase) -> list[float]:
    """Frequencies of an incomplete list that its pairing takes for false peaks."""
    return [float(f) for f in case.measurement.frequencies[case.modes < 0]]


def _missed_modes(d: Diagnosis, leader: Tested, modes_of: Sequence[Sequence[Mode]]) -> tuple[MissedMode, ...]:
    """Modes in the range of the lists that are not listed under a hypothesis."""
    missed: list[MissedMode] = []
    parts = leader.marginal.comparison.model.parts
    for case, part, modes in zip(leader.cases or d.cases, parts, modes_of, strict=True):
        highest = int(part.modes.max())
        gaps = set(range(highest)) - {int(k) for k in part.modes}
        if case.modes[-1] < 0:  # the last frequency is no mode, and there may be some below it
            last = case.measurement.frequencies[-1]
            gaps |= {k for k in range(highest + 1, len(modes)) if modes[k].frequency <= last}
        missed += [MissedMode(case.name, k + 1, modes[k]) for k in sorted(gaps) if k < len(modes)]
    return tuple(missed)


def _plate_vector(t: Tested, i: int) -> Array:
    """Bare-model parameters of the i-th plate at the optimum of a hypothesis."""
    at: Array = t.marginal.comparison.model.parts[i].plate_vector(t.marginal.best[None])[0]
    return at
