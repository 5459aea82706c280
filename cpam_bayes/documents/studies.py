"""Documents of many plates and many lists: comparison, batch, calibration, noise study, the paper."""

from __future__ import annotations

from typing import Annotated, Literal, NotRequired, TypeAlias

from pydantic import Field
from typing_extensions import TypedDict

from cpam_bayes.answer import Verdict
from cpam_bayes.diagnosis.hypotheses import Kind
from cpam_bayes.documents.constants import Convergence
from cpam_bayes.documents.diagnosis import Size
from cpam_bayes.documents.parts import (
    Answer,
    Bound,
    Certificate,
    Interval,
    Moments,
    Nats,
    Number,
    Pair,
    Percent,
    PlateAnswer,
    PlateHead,
    Probability,
    Share,
    StandardError,
    Texts,
    TimedAnswer,
    Value,
    ValueSpread,
)
from cpam_bayes.inference.swarm import Status
from cpam_bayes.printed.noise_study import ListSource
from cpam_bayes.printed.repetition import Cause, Interpretation
from cpam_bayes.printed.tables import Agreement
from cpam_bayes.questions.batch.result import BatchVerdict
from cpam_bayes.questions.identify.slips import SlipKind
from cpam_bayes.questions.paper.rows import Verdict as PaperVerdict


class ConstantDifference(TypedDict):
    """A constant of the second plate relative to that of the first."""

    percent: Percent
    sd_percent: Percent
    probability_larger: Probability
    determined: bool


class Compare(Answer):
    """Differences of the constants of two plates."""

    command: Literal["compare"]
    plates: Texts
    differences: dict[str, ConstantDifference]


class Coverage(TypedDict):
    """Coverage of intervals of one level."""

    level: Annotated[float, Field(description="of the intervals, 0 to 1")]
    share: Share
    standard_error: Number


class Calibrated(TypedDict):
    """Coverage and ranks of a constant over all simulated lists."""

    coverage: list[Coverage]
    rank_counts: list[int]
    p_value: Annotated[Number, Field(description="of uniform ranks")]


class Calibrate(PlateHead, Answer):
    """Coverage of the intervals by simulated lists."""

    command: Literal["calibrate"]
    lists: int
    converged: Annotated[int, Field(description="lists whose chains converged")]
    constants: dict[str, Calibrated]
    rank_band: Annotated[list[Pair], Field(description="95 % of the counts of uniform ranks")]


class Laplace(TypedDict):
    """The Gaussian by which limits are judged."""

    centre: Number
    sd: Number


class RowConstant(ValueSpread, Interval):
    """A constant of a plate, in the unit of its name."""

    verdict: Verdict
    laplace: Laplace


class RowClaim(TypedDict):
    """The diagnosis of a plate in brief."""

    claim: Kind
    causes: Texts
    probability: Probability
    probability_none: Probability


class BatchRow(Certificate):
    """A plate of a batch."""

    file: str
    name: str
    status: Literal["done", "failed"]
    message: Annotated[str, Field(description="why it failed, or its warnings")]
    specimen: NotRequired[str]
    constants: dict[str, RowConstant]
    limits: Annotated[dict[str, Number], Field(description="probability of meeting each, 0 to 1")]
    verdict: BatchVerdict | None
    rms_percent: Percent
    noise_percent: Percent
    search: Annotated[str | None, Field(description="how the swarms ended")]
    slip: Annotated[SlipKind | None, Field(description="of the plate file")]
    diagnosis: RowClaim | None


class Chart(TypedDict):
    """A control chart, in the unit of the constant."""

    median: Number
    sigma: Number
    lower: Number
    upper: Number
    outside: Annotated[Texts, Field(description="plates beyond the limits")]


class PopulationConstant(TypedDict):
    """Mean, scatter and next plate of a constant of the material."""

    mean: Moments
    scatter_percent: Moments
    next_plate: Moments


class Population(TypedDict):
    """Mean constants of the material, and their scatter."""

    plates: int
    status: Status
    constants: dict[str, PopulationConstant]
    diagnostics: Convergence


class Batch(TimedAnswer):
    """The constants of many plates."""

    command: Literal["batch"]
    plates: int
    failed: int
    models: Annotated[int, Field(description="geometries, whose plates share one model")]
    from_store: Annotated[int, Field(description="plates that a former run had finished")]
    limits: Texts
    rows: list[BatchRow]
    control_chart: dict[str, Chart | None]
    population: Population | None


class Compared(TypedDict):
    """Repeated inversions beside the posterior, in the unit of the constant."""

    repetition_mean: Number
    repetition_sd: Number
    percent_error: Annotated[Number, Field(description="of the mean, %")]
    percent_standard_error: Annotated[Number, Field(description="of the mean, %")]
    paper_percent_error: Annotated[Number, Field(description="printed, %")]
    paper_in_standard_errors: Number
    posterior_mean: Number
    posterior_sd: Number
    sd_ratio: Number
    causes: Annotated[list[Cause], Field(description="why both differ, empty where they agree")]
    means_agree: bool
    sds_agree: bool
    shift_in_standard_errors: Number
    share_on_bound: Share
    posterior_share_next_to_bound: Share
    posterior_skewness: Number
    posterior_sd_over_prior_sd: Number
    linearised_posterior_sd: Number
    linearised_repetition_sd: Number
    repetitions: list[Number]


class Reading(TypedDict):
    """A level of noise in one interpretation of eq. (12)."""

    noise_sd_hz: Annotated[list[Number], Field(description="by frequency, Hz")]
    reordered_share: Share
    redrawn: int
    swarms_converged: int
    swarms_restarted: int
    lists_missed: int
    posterior_converged: bool
    posterior_effective: Annotated[Number, Field(description="draws")]
    constants: dict[str, Compared]


class Readings(TypedDict):
    """The requested interpretations of eq. (12)."""

    relative: NotRequired[Reading]
    rms: NotRequired[Reading]


class Level(TypedDict):
    """A level of noise."""

    level_percent: Percent
    reading: Interpretation
    constants: Annotated[dict[str, Compared], Field(description="of `reading`")]
    readings: Readings


class NoiseFreeConstant(Value):
    """A constant without added noise, in the unit of its name."""

    bound: Bound


class WithoutNoise(TypedDict):
    """The inversion of the list without added noise."""

    constants: dict[str, NoiseFreeConstant]
    rms_percent: Percent
    status: Status
    swarms: int
    swarms_that_found_it: int


class Contradiction(TypedDict):
    """A printed percentage that does not follow from the printed values."""

    constant: str
    level_percent: Percent
    printed_percent: Percent
    possible_percent: Annotated[Pair, Field(description="%")]


class PrintedTable(TypedDict):
    """The paper's table."""

    table: int
    angles_deg: list[list[float]]
    contradictions: list[Contradiction]


# beside a key named list
Numbers: TypeAlias = list[float]
Levels: TypeAlias = list[Level]


class Sensitivity(PlateAnswer):
    """The paper's repetition beside the posterior."""

    command: Literal["sensitivity"]
    list: Annotated[ListSource, Field(description="what noise is added to")]
    frequencies_hz: Numbers
    groups: int
    without_noise: WithoutNoise
    levels: Levels
    paper: PrintedTable | None
    forward_solves: int


class TableCounts(TypedDict):
    """A table, and the number of its values by verdict."""

    table: int
    title: str
    verdicts: dict[str, int]
    verdicts_of_others: Annotated[dict[str, int], Field(description="of values from works that it cites")]
    percentages: dict[str, int]


class PaperRow(Interval):
    """A printed value beside the computed one."""

    table: int
    part: str
    specimen: str
    source: Annotated[str, Field(description="who computed or measured it")]
    quantity: Annotated[str, Field(description="its unit is in its name")]
    printed: float | str
    printed_text: str
    ours: Annotated[list[float] | Number, Field(description="angles, deg, as a list; null for inputs")]
    difference_percent: Annotated[Number, Field(description="printed / ours - 1, %")]
    verdict: Annotated[str, Field(description="`verdict_kind`, and the reason")]
    verdict_kind: PaperVerdict
    details: Annotated[dict[str, Number], Field(description="further computed numbers")]


class Percentage(TypedDict):
    """A printed percentage beside the one recomputed from printed values."""

    table: int
    specimen: str
    source: str
    quantity: str
    printed_percent: Percent
    recomputed_percent: Percent
    possible_percent: Annotated[Pair, Field(description="ends of what the printed digits allow, %")]
    agreement: Agreement


class Misfit(TypedDict):
    """Misfit of printed constants and of ours to the same frequencies."""

    table: int
    specimen: str
    case: str
    source: Annotated[str, Field(description="who printed them")]
    objective: Annotated[Number, Field(description="F of eq. (7), Hz^2")]
    rms_percent: Percent
    our_objective: Annotated[Number, Field(description="F of eq. (7), Hz^2")]
    our_rms_percent: Percent
    swarms: int
    swarms_found: Annotated[int, Field(description="swarms that ended at the least F")]
    swarms_converged: int
    on_bounds: Annotated[Texts, Field(description="constants that sit on a bound, or `E1 = E2`")]
    beyond_eq_8: Annotated[dict[str, Pair], Field(description="bounds other than those of eq. (8)")]


class Audit(TypedDict):
    """Contradictions within the print, and what it can show."""

    misprints: Texts
    means_of_ten: str | None
    not_determined: str | None
    angles: Texts
    percentages: list[Percentage]
    misfits: list[Misfit]


class WellPosed(TypedDict):
    """Hadamard's conditions for the constants of a plate."""

    table: int
    specimen: str
    case: str
    frequencies: int
    unknowns: int
    left_percent: Percent
    repeatability_percent: Percent
    rounding_percent: Percent
    rank: int
    condition: Number
    optima: int
    layups: int | None
    percent_per_percent: Annotated[dict[str, Number], Field(description="sd, %, for 1 % of noise")]
    exists: bool | None
    unique: bool


class SimulationError(TypedDict):
    """The error of the paper's simulation of a plate."""

    table: int
    specimen: str
    printed_rms_percent: Percent
    plain_rms_percent: Percent
    claim: Kind
    sentence: Annotated[str, Field(description="the claim in words")]
    causes: Texts
    sizes: Annotated[dict[str, Size], Field(description="of what is claimed, by name")]
    probability: Probability
    extended_rms_percent: Percent
    log_bayes_factor: Nats
    held_out: Annotated[Number, Field(description="difference of log scores, nats")]
    held_out_se: StandardError
    frequency_ratio: Annotated[Number, Field(description="measured over the printed plate's, geometric mean")]
    scaled_rms_percent: Annotated[Number, Field(description="misfit that this factor leaves, %")]
    thickness_mm: Annotated[Number, Field(description="as printed")]
    of_one_material_mm: Annotated[
        dict[str, Number], Field(description="thickness of the material's other plates")
    ]


class Cost(TypedDict):
    """Forward solves for a plate, and their time."""

    specimen: str
    case: str
    forward_solves: int
    seconds: Number
    calculix_seconds: Annotated[Number, Field(description="of one solve, s")]
    calculix_hours: Annotated[Number, Field(description="of as many solves, h")]


class Computation(TypedDict):
    """Date and version of a computation."""

    version: NotRequired[str]
    fingerprint: NotRequired[str]
    date: NotRequired[str]
    seconds: NotRequired[Number]


class Paper(TimedAnswer):
    """The paper's tables beside what the package computes."""

    command: Literal["paper"]
    quick: bool
    tables: list[TableCounts]
    rows: list[PaperRow]
    disagreements: Annotated[Texts, Field(description="the largest first")]
    audit: Audit
    hadamard: list[WellPosed]
    simulation: list[SimulationError]
    costs: list[Cost]
    computed: dict[str, Computation]
