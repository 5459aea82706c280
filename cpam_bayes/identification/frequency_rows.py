"""Measured frequencies beside predicted ones, a row each, as screens, documents and figures show them."""

from __future__ import annotations

from dataclasses import dataclass

from cpam_bayes.mechanics.shapes import Mode

__all__ = ["FrequencyRow", "LeftOutPrediction", "MissedMode", "SampledFrequency"]


@dataclass(frozen=True, slots=True)
class FrequencyRow:
    """A measured frequency beside the predicted one, Hz; residual : predicted / measured - 1."""

    measured: float
    predicted: float
    residual: float
    kind: str
    label: str


@dataclass(frozen=True, slots=True)
class LeftOutPrediction:
    """A frequency predicted from all the others.

    residual : predicted / measured - 1
    sd : of prediction and noise together, relative
    leverage : fraction of the frequency in its own prediction
    standardised : the residual in standard deviations
    """

    residual: float
    sd: float
    leverage: float
    standardised: float


@dataclass(frozen=True, slots=True)
class SampledFrequency:
    """A measured frequency beside the posterior of its mode's frequency.

    measured, predicted, predicted_sd : Hz
    residual : predicted / measured - 1
    number : of the mode in ascending order, from 1
    """

    measured: float
    predicted: float
    predicted_sd: float
    residual: float
    number: int
    mode: Mode
    left_out: LeftOutPrediction


@dataclass(frozen=True, slots=True)
class MissedMode:
    """A mode in the range of the measured frequencies that these lack; predicted : Hz."""

    predicted: float
    number: int
    mode: Mode
