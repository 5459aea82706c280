"""The posterior of the constants of a plate: the answer of `sample`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from numpy.typing import NDArray

from cpam_bayes.forward_model.mode_shapes.assurance import ShapePairing
from cpam_bayes.forward_model.model import SIZES
from cpam_bayes.identification.frequency_rows import LeftOutPrediction, MissedMode, SampledFrequency
from cpam_bayes.identification.reliance import Reliance
from cpam_bayes.identification.scale_errors import ScaleError
from cpam_bayes.identification.verdicts import Verdict
from cpam_bayes.inference.chains.ensemble import (
    EnsembleResult,
)
from cpam_bayes.inference.diagnostics.assessment import Assessment
from cpam_bayes.inference.diagnostics.completeness import TranscriptionError
from cpam_bayes.inference.evidence import Evidence
from cpam_bayes.inference.noise import NOISE_NAMES
from cpam_bayes.inference.pairing import Pairing
from cpam_bayes.inference.posterior import Posterior
from cpam_bayes.mechanics.shapes import Mode
from cpam_bayes.result import PlateResult

Array = NDArray[Any]

__all__ = ["ConstantPosterior", "SampledResult"]


@dataclass(frozen=True, slots=True)
class ConstantPosterior:
    """Marginal posterior of one parameter, SI.

    contraction : 1 - (sd / prior sd)^2. at_lower, at_upper : shares of the draws within 1 % of the
    search interval of a bound. bound : the one that the posterior is in contact with, which then has
    a say whatever the contraction. reference : of the plate file, ``nan`` for the noise.
    """

    name: str
    mean: float
    sd: float
    q025: float
    median: float
    q975: float
    lower: float
    upper: float
    contraction: float
    at_lower: float
    at_upper: float
    bound: Literal["lower", "upper"] | None
    verdict: Verdict
    reference: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class SampledResult(PlateResult):
    """The posterior of one specimen's constants.

    Attributes
    ----------
    posterior : what was sampled; ``posterior.log_prob`` takes parameter vectors
    constants : marginal posteriors of all parameters
    predicted, predicted_sd : (n_modes,) posterior mean and sd of the model's frequencies, Hz
    modes : the model's modes at the most probable draw
    shapes : of these modes, (n_modes, 3, n, n), u, v and w on a regular grid
    pairing : of the measured frequencies with them
    p_value : posterior predictive p-value of the sum of squared standardised residuals
    laminate : name -> (mean, sd)
    error : relative error of the solver at the most probable draw in the modes that have a frequency
    scale_errors : what errors of sizes, mass and frequency scale do to the constants
    reliances : intervals that rest on the bounds or the prior of another constant
    doubt : a pairing of a complete list that is far more probable than one to one
    evidence : by importance sampling
    assessment : what determines the posterior and how it fits
    result : chains and diagnostics of the ensembles
    seconds_sampling : of the ensembles, without the plate model, the swarm and what follows
    by_shape : what measured shapes say of the modes at the reference constants, None without them
    """

    question: ClassVar[str] = "posterior"
    command: ClassVar[str] = "identify"
    draws: ClassVar[str] = "cpam_bayes.identification.draws"

    posterior: Posterior
    constants: tuple[ConstantPosterior, ...]
    predicted: Array
    predicted_sd: Array
    modes: tuple[Mode, ...]
    shapes: Array
    pairing: Pairing
    p_value: float
    laminate: Mapping[str, tuple[float, float]]
    error: Array
    scale_errors: tuple[ScaleError, ...]
    reliances: tuple[Reliance, ...]
    doubt: TranscriptionError | None
    evidence: Evidence
    assessment: Assessment
    result: EnsembleResult
    forward_solves: int
    seconds_sampling: float
    seconds: float
    by_shape: ShapePairing | None = None

    @property
    def status(self) -> str:
        """Either "converged", or "budget" where the chains used all their steps."""
        return self.result.status

    @property
    def elastic_constants(self) -> tuple[ConstantPosterior, ...]:
        """The elastic constants, without noise and sizes."""
        return tuple(c for c in self.constants if c.name not in (*NOISE_NAMES, *SIZES))

    @property
    def sizes(self) -> tuple[ConstantPosterior, ...]:
        """The sizes of the plate that have a standard deviation."""
        return tuple(c for c in self.constants if c.name in SIZES)

    @property
    def frequencies(self) -> tuple[SampledFrequency | None, ...]:
        """One row for each measured frequency, None where it belongs to no mode."""
        measured, left_out = self.posterior.measurement.frequencies, self.assessment.left_out
        rows: list[SampledFrequency | None] = []
        k = 0  # place among the frequencies that have a mode
        for f, j in zip(measured, self.pairing.mode, strict=True):
            if j < 0:
                rows.append(None)
                continue
            rows.append(
                SampledFrequency(
                    measured=float(f),
                    predicted=float(self.predicted[j]),
                    predicted_sd=float(self.predicted_sd[j]),
                    residual=float(self.predicted[j]) / float(f) - 1.0,
                    number=int(j) + 1,
                    mode=self.modes[j],
                    left_out=LeftOutPrediction(
                        residual=-float(left_out.residual[k] / f),
                        sd=float(left_out.sd[k] / f),
                        leverage=float(left_out.leverage[k]),
                        standardised=float(left_out.standardised[k]),
                    ),
                )
            )
            k += 1
        return tuple(rows)

    @property
    def missed(self) -> tuple[MissedMode, ...]:
        """Modes in the range of the measured frequencies that these lack."""
        return tuple(
            MissedMode(float(self.predicted[j]), int(j) + 1, self.modes[j]) for j in self.pairing.missed
        )

    @property
    def ess_per_second(self) -> float:
        """Effective samples of the worst parameter for each second of sampling."""
        return self.result.diagnostics.ess_bulk / self.seconds_sampling
