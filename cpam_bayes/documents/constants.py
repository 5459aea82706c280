"""The documents of constants and layups: `identify`, `sequence` and `report`."""

from __future__ import annotations

from typing import Annotated, Literal, NotRequired, TypeAlias

from pydantic import Field
from typing_extensions import TypedDict

from cpam_bayes.documents.diagnosis import Diagnose
from cpam_bayes.documents.parts import (
    ByShape,
    Contraction,
    Estimate,
    FrequencyRow,
    Hertz,
    InConstants,
    KHat,
    LogEvidence,
    MissedMode,
    ModelAnswer,
    Moments,
    Nats,
    Number,
    Peak,
    Percent,
    PlateAnswer,
    Probability,
    Seconds,
    SequenceFrequency,
    Share,
    Slip,
    Spread,
    Texts,
    TimedAnswer,
    Value,
    ValueSpread,
    WithBounds,
    WorstError,
)
from cpam_bayes.identification.search import Residual
from cpam_bayes.inference.assessment import Diagnosis as ScalingDiagnosis
from cpam_bayes.inference.swarm import Status

NoiseSource: TypeAlias = Literal["residuals", "plate file"]
Laminate: TypeAlias = Annotated[dict[str, Value], Field(description="D, N m; moduli in bending, GPa")]


class Optimum(TypedDict):
    """An optimum that the noise cannot distinguish from the best one."""

    constants: InConstants
    objective: Annotated[Number, Field(description="what the swarm minimises")]
    rms_percent: Percent
    found_by: Annotated[int, Field(description="how many of the swarms")]


class PointIdentify(ModelAnswer, ByShape):
    """Point estimates of the constants by the particle swarm."""

    command: Literal["identify"]
    backend: Literal["pso"]
    residuals: Residual
    status: Status
    message: Annotated[str, Field(description="the status in words")]
    constants: dict[str, Estimate]
    frequencies_alone: NotRequired[
        Annotated[dict[str, Estimate], Field(description="the constants without their references")]
    ]
    angles_deg: NotRequired[Annotated[list[float], Field(description="of the unknown plies, deg")]]
    frequencies: list[FrequencyRow]
    optima: Annotated[list[Optimum], Field(description="the best first")]
    explained_by: list[Slip]
    rms_percent: Percent
    noise_percent: Percent
    noise_source: NoiseSource
    laminate: Laminate
    forward_solves: int
    swarms: int
    iterations: int


class PlateOfSeveral(TypedDict):
    """One list of several, and the fit of the shared constants to it."""

    plate: str
    specimen: str
    edges: str
    n_frequencies: int
    rms_percent: Percent
    noise_percent: Percent
    noise_source: NoiseSource
    source: str
    constants: InConstants
    misfit_over_noise: Number
    explained_by: list[Slip]
    relative_error_estimate: WorstError
    laminate: Laminate


class FrequencyOfSeveral(FrequencyRow):
    """A frequency of one of several lists."""

    plate: str


class OptimumOfSeveral(TypedDict):
    """An optimum of the joint density of all lists."""

    constants: InConstants
    log_density: Nats


class JointIdentify(TimedAnswer):
    """Constants shared by several lists."""

    command: Literal["identify"]
    backend: Literal["pso"]
    residuals: Residual
    status: Literal["done"]
    tests: Annotated[int, Field(description="number of lists")]
    specimens: Annotated[int, Field(description="number of plates")]
    scatter_percent: Annotated[Number, Field(description="from plate to plate, %; null for one plate")]
    constants: dict[str, Estimate]
    plates: list[PlateOfSeveral]
    frequencies: list[FrequencyOfSeveral]
    optima: list[OptimumOfSeveral]
    forward_solves: int


class Quantiles(Moments):
    """Moments and median."""

    median: Number


class PriorMoments(Spread):
    """A prior, in the unit of its constant."""

    kind: str


class Marginal(Quantiles, WithBounds):
    """A marginal posterior, in the unit of its constant."""

    prior: PriorMoments
    prior_contraction: Contraction
    share_at_lower_bound: Share
    share_at_upper_bound: Share


class Noise(Quantiles):
    """The inferred noise."""

    name: Annotated[str, Field(description="relative_std, a fraction, or absolute_sd, Hz")]


class LeftOut(TypedDict):
    """Leave-one-out prediction of a frequency."""

    residual_percent: Percent
    sd_percent: Percent
    leverage: Annotated[Number, Field(description="0 to 1")]


class SampledFrequency(FrequencyRow):
    """A measured frequency and its posterior prediction."""

    predicted_sd_hz: Hertz
    left_out: LeftOut | None


class ImportanceLeftOut(TypedDict):
    """Leave-one-out scores by importance sampling."""

    reliable: bool
    k_hat: Annotated[list[Number], Field(description="by frequency; above 0.7 not reliable")]
    log_score: Nats
    standard_error: Nats


class LeaveOneOut(TypedDict):
    """The leave-one-out log score."""

    log_score: Nats
    basis: Literal["draws", "optimum"]
    psis: ImportanceLeftOut | None


class Evidence(TypedDict):
    """Accuracy of the log evidence."""

    standard_error: Nats
    effective_size: Annotated[Number, Field(description="draws")]
    k_hat: KHat
    status: Literal["reliable", "unreliable"]
    exact_fraction: Annotated[Number, Field(description="effective share of draws on the whole basis")]


class Combination(TypedDict):
    """A product of powers of constants."""

    exponents: dict[str, Number]
    singular_value: Number
    sd_percent_by_data: Percent
    sd_percent_by_prior: Percent
    contraction: Number


class Profile(TypedDict):
    """The profile likelihood of a constant, in the unit of its name."""

    values: list[Number]
    drop: Annotated[list[Number], Field(description="below the best log likelihood, nats")]
    best: Number
    lower_95: Number
    upper_95: Number
    lower_open: bool
    upper_open: bool
    parts: int


class Identifiability(TypedDict):
    """Which combinations of constants the frequencies determine."""

    combinations: Annotated[list[Combination], Field(description="the best determined first")]
    profiles: dict[str, Profile]


class PowerScaling(TypedDict):
    """Sensitivity of a constant to powers of priors and likelihood; notable from 0.05."""

    prior: Number
    noise_prior: Number
    likelihood: Number
    diagnosis: ScalingDiagnosis


class MovedBound(TypedDict):
    """Effect of moving a search bound inwards."""

    constant: str
    bound: Literal["lower", "upper"]
    share_cut: Share
    shift_in_sd: dict[str, Number]


class Convergence(TypedDict):
    """Convergence of the chains, for the worst parameter."""

    r_hat: Number
    ess_bulk: Annotated[Number, Field(description="effective draws")]
    autocorrelation_time: Annotated[Number, Field(description="steps")]
    converged: bool
    steps: int


class Diagnostics(Convergence):
    """Convergence of the chains, and their time."""

    burn_in: int
    seconds_sampling: Seconds


class SampledIdentify(ModelAnswer, ByShape):
    """The posterior of the constants by emcee."""

    command: Literal["identify"]
    backend: Literal["emcee"]
    status: Status
    constants: dict[str, Marginal]
    nuisance: Annotated[dict[str, Marginal], Field(description="sizes and others that are sampled too")]
    noise: Annotated[Noise | None, Field(description="null where the plate file states it")]
    degrees_of_freedom: Annotated[Number, Field(description="of the residuals, null for a Gaussian")]
    frequencies: list[SampledFrequency]
    missed_modes: list[MissedMode]
    posterior_predictive_p_value: Number
    leave_one_out: LeaveOneOut
    log_evidence: Nats
    evidence: Evidence
    identifiability: Identifiability
    power_scaling: dict[str, PowerScaling]
    bounds_moved: list[MovedBound]
    explained_by: list[Slip]
    laminate: Annotated[dict[str, ValueSpread], Field(description="D, N m; moduli in bending, GPa")]
    diagnostics: Diagnostics
    forward_solves: int
    peaks: NotRequired[list[Peak]]


Identify: TypeAlias = PointIdentify | JointIdentify | SampledIdentify


class Layup(LogEvidence):
    """A stacking sequence with its constants."""

    angles_deg: Annotated[list[float], Field(description="of the unknown plies, from the bottom, deg")]
    probability: Probability
    constants: Annotated[InConstants | None, Field(description="means, in the unit of the name")]
    constants_sd: Annotated[InConstants | None, Field(description="in the unit of the name")]


class ListedSequence(Layup):
    """A stacking sequence of the list."""

    equivalent: Annotated[int, Field(description="sequences with the same frequencies, itself among them")]
    same_bending_deg: Annotated[list[list[float]], Field(description="angles of the same bending, deg")]
    sampled_by: Annotated[str, Field(description="where the constants come from")]


class Mixture(TypedDict):
    """The draws of the constants over all sequences."""

    draws: int
    sampled_by_emcee: Annotated[int, Field(description="sequences")]
    probability_by_emcee: Probability
    probability_by_importance_sampling: Probability
    probability_by_drawn_sequences: Probability
    converged: bool
    worst_difference_in_standard_errors: Number
    seconds: Seconds


class MissedFrequency(TypedDict):
    """A mode within the range of the list that the list lacks."""

    predicted_hz: Hertz


class PrintedSequence(Layup):
    """The layup printed in the paper."""

    rank: Annotated[int | None, Field(description="from 1, null where it is not listed")]


class Learned(TypedDict):
    """The surrogate of the log evidence."""

    from_sequences: int
    rms_error_nats: Number
    largest_error_nats: Number
    overlooked_nats: Number
    correction_nats: Number
    effective_share: Number


class Sequence(PlateAnswer):
    """The probability of every stacking sequence on the grid."""

    command: Literal["sequence"]
    enumerated: Annotated[int, Field(description="before symmetries are merged")]
    classes: Annotated[int | None, Field(description="after they are merged, null if not counted")]
    symmetries: Texts
    angle_grid_deg: Annotated[list[float], Field(description="deg")]
    log_evidence: Annotated[Number, Field(description="of all sequences together, nats")]
    sequences: Annotated[list[ListedSequence], Field(description="the most probable first")]
    credible_95_count: Annotated[int, Field(description="sequences that hold 95 % of the probability")]
    effective_count: Annotated[Number, Field(description="exp of the entropy")]
    unaccounted_probability: Annotated[Number, Field(description="at most, 0 to 1")]
    angle_marginals: Annotated[list[list[Number]], Field(description="ply by ply, over `angle_grid_deg`")]
    angle_entropy_bits: Annotated[list[Number], Field(description="ply by ply")]
    angle_entropy_most_bits: Annotated[Number, Field(description="of an unknown angle")]
    outer_plies_better_determined: bool
    constants: dict[str, Moments]
    mixture: Mixture
    frequencies: list[SequenceFrequency]
    missed_modes: list[MissedFrequency]
    p_value: Number
    noise_percent: Percent
    noise_inferred: bool
    printed_sequence: PrintedSequence | None
    learned: Learned | None
    basis_error: WorstError


class Report(PlateAnswer):
    """Constants, stacking sequences and diagnosis, each as from its own command."""

    command: Literal["report"]
    quick: bool
    status: Literal["done", "not converged"]
    identification: PointIdentify | SampledIdentify
    stacking: Sequence | None
    diagnosis: Diagnose
    all_rows: Annotated[
        PointIdentify | SampledIdentify | None, Field(description="with frequencies that were left out")
    ]
