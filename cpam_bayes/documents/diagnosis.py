"""The document of `diagnose`."""

from __future__ import annotations

from typing import Annotated, Literal, NotRequired

from pydantic import Field
from typing_extensions import TypedDict

from cpam_bayes.diagnosis.hypotheses import Kind
from cpam_bayes.documents.parts import (
    Contraction,
    FrequencyRow,
    Hertz,
    InConstants,
    KHat,
    MissedMode,
    Moments,
    Nats,
    Number,
    OfMaterial,
    Peak,
    Percent,
    Probability,
    Spread,
    StandardError,
    Texts,
    TimedAnswer,
    WorstError,
)


class Plate(TypedDict):
    """One of the plates."""

    plate: str
    specimen: str
    source: str


class Claimed(TypedDict):
    """A claim with its causes and probability."""

    claim: Kind
    causes: Annotated[Texts, Field(description="names claimed")]
    probability: Annotated[Number, Field(description="of the claim, 0 to 1")]


class Claims(TypedDict):
    """Claims under rescaled priors."""

    scales_times_3: Claimed
    scales_divided_by_3: Claimed


class Range(TypedDict):
    """A probability under rescaled priors."""

    scales_times_3: Probability
    scales_divided_by_3: Probability


class DiagnosedConstant(Moments):
    """A constant in the unit of its name."""

    prior_contraction: Contraction
    reference: OfMaterial


class Size(Spread):
    """The size of an error."""

    unit: str


class Weighed(TypedDict):
    """A weighed set of causes."""

    cause: Annotated[str, Field(description='"a + b" for two')]
    probability: Probability
    probability_range: Range
    log_bayes_factor: Annotated[Number, Field(description="against none, nats")]
    log_evidence_error: StandardError
    k_hat: KHat
    parameters: dict[str, Size]
    places_mm: Annotated[
        dict[str, list[list[Number]]],
        Field(description="x, y of each effect of one place, then of its images"),
    ]
    indistinguishable_from: Annotated[Texts, Field(description="causes with the same signature")]
    max_shift_percent: Annotated[Number, Field(description="largest change of a frequency, %")]
    leftover_percent: Annotated[Number, Field(description="scatter that nothing explains, %")]
    variant: str | None
    plates: Annotated[Texts, Field(description="those that it acts on")]
    absorbed: Annotated[bool, Field(description="by the constants")]
    visible_share: Annotated[Number, Field(description="of its signature that constants do not absorb")]
    prior: Probability


class DiagnosedFrequency(FrequencyRow):
    """A measured frequency and its fit."""

    plate: str
    predicted_sd_hz: Hertz
    noise_sd_hz: Hertz
    standardised: Annotated[Number, Field(description="residual over its standard deviation")]


class MissedOfPlate(MissedMode):
    """A mode within the range of a plate's list that the list lacks."""

    plate: str


class FitOfLists(TypedDict):
    """Constants and frequencies of a fit."""

    constants: dict[str, DiagnosedConstant]
    frequencies: list[DiagnosedFrequency]
    rms_percent: Percent
    log_evidence: Nats


class PlateFit(FitOfLists):
    """The fit of one plate of several."""

    plate: str
    log_evidence_of: str


class Fit(FitOfLists):
    """A fit of all lists, by the plain model or as `Extended`."""

    rms_as_stated_percent: Annotated[Number, Field(description="misfit, sizes, mass and scale as stated, %")]
    log_evidence_error: StandardError
    k_hat: KHat
    posterior_predictive_p_value: Number
    predictive_p: Annotated[Number, Field(description="the same against the stated noise, or its prior")]
    noise_percent: Annotated[Spread | None, Field(description="inferred noise, %; null where stated")]
    nuisance: Annotated[dict[str, Spread], Field(description="sizes, and deviations from plate to plate")]
    missed_modes: list[MissedOfPlate]
    plates: NotRequired[Annotated[list[PlateFit], Field(description="where there are several")]]


class Member(TypedDict):
    """A set of causes in the extended model."""

    cause: str
    variant: str | None
    plates: Texts
    share: Annotated[Number, Field(description="of its weight, 0 to 1")]


class Extended(Fit):
    """The fit of the extended model."""

    members: list[Member]


class DiagnosedOptimum(TypedDict):
    """An optimum: constants, and the modes paired there."""

    probability: Probability
    constants: InConstants
    modes: Annotated[list[Texts], Field(description="labels, plate by plate")]


class Gain(TypedDict):
    """Gain of the extended model over the plain one."""

    rms_percent_before: Percent
    rms_percent_after: Percent
    log_bayes_factor: Nats
    held_out_log_score_difference: Annotated[Number, Field(description="of frequencies left out, nats")]
    held_out_log_score_se: StandardError
    held_out_log_score_by_frequency: list[Number]
    held_out_hypotheses: int
    stable_share: Annotated[Number, Field(description="of the frequencies without which the claim stands")]


class Detectable(TypedDict):
    """The detection limit of a cause."""

    cause: str
    smallest: Annotated[Number, Field(description="in `unit`, null where no size would be claimed")]
    unit: str | None
    probability_of_claim: Annotated[Number, Field(description="at that size, 0 to 1")]


class Tested(TypedDict):
    """The hypotheses that were weighed."""

    hypotheses: int
    causes: Texts


class NextTest(TypedDict):
    """A further test."""

    name: str
    description: str
    information_nats: Annotated[Number, Field(description="expected, nats")]
    possible_nats: Annotated[Number, Field(description="at most, nats")]
    probability_decided: Annotated[Number, Field(description="that the claim is then one cause, 0 to 1")]


class Absorbed(TypedDict):
    """A cause that the constants absorb, and the bias it causes."""

    cause: str
    visible_share: Number
    absorbed: bool
    unit: str
    bias_percent_per_unit: Annotated[dict[str, Number], Field(description="of each constant, %")]
    bias_percent: Annotated[dict[str, Number], Field(description="of each constant at `at`, %")]
    at: Annotated[Number, Field(description="size of the cause, in `unit`")]


class Density(TypedDict):
    """Prior density of a size."""

    kind: str
    scale: Annotated[Number, Field(description="in `unit`")]


class Gross(Density):
    """Prior density of a gross error."""

    fraction: Annotated[Number, Field(description="its probability, 0 to 1")]


class SizePrior(Density):
    """The prior of a size."""

    mean: Number
    gross: Gross | None
    lower: Number
    upper: Number
    unit: str


class Priors(TypedDict):
    """Prior probabilities, 0 to 1."""

    none: Number
    other: Number
    sets_tested: Annotated[Number, Field(description="of several causes at once, as far as weighed")]
    families: Annotated[dict[str, dict[str, Number]], Field(description="family, cause: probability")]
    effects: Annotated[dict[str, dict[str, SizePrior]], Field(description="cause, size: its prior")]


class Diagnose(TimedAnswer, Claimed):
    """Probabilities of errors of the plate, the list or the model, and the constants that allow for them."""

    command: Literal["diagnose"]
    plate: NotRequired[Annotated[str, Field(description="where there is one")]]
    specimen: NotRequired[Annotated[str, Field(description="where there is one")]]
    source: NotRequired[Annotated[str, Field(description="where there is one")]]
    plates: list[Plate]
    sentence: Annotated[str, Field(description="the claim in words")]
    something_wrong: Annotated[Number, Field(description="probability that something is, 0 to 1")]
    inclusion: Annotated[dict[str, Number], Field(description="probability of each cause")]
    constants: Annotated[dict[str, DiagnosedConstant], Field(description="averaged over all sets")]
    claim_stands: Annotated[bool, Field(description="with other scales of the priors")]
    unaccounted_probability: Annotated[Number, Field(description="of sets that were not weighed, at most")]
    claims_by_prior_scales: Claims
    hypotheses: Annotated[list[Weighed], Field(description="the most probable first")]
    baseline: Fit
    extended: Annotated[Extended | None, Field(description="null where nothing is claimed")]
    averaged: Annotated[dict[str, DiagnosedConstant], Field(description="as `constants`")]
    optima: list[DiagnosedOptimum]
    gain: Gain | None
    detectable: list[Detectable]
    tested: Tested
    next_measurement: Annotated[list[NextTest], Field(description="the most informative first")]
    absorbed: list[Absorbed]
    not_tested: Annotated[Texts, Field(description="what was left out, in words")]
    priors: Priors
    material_scatter: Annotated[Number, Field(description="relative sd from plate to plate, a fraction")]
    air_density_kg_m3: Annotated[dict[str, Number], Field(description="by plate, null for vacuum")]
    basis_error: WorstError
    peaks: NotRequired[list[Peak]]
    notes: Annotated[Texts, Field(description="of the plate files")]
