"""Parts shared by the documents of several commands, each declared once.

Annotations describe the JSON text: an enum stands for its value.
"""

from __future__ import annotations

from typing import Annotated, Literal, NotRequired, TypeAlias

from pydantic import Field

# a dependency of pydantic, which rejects the TypedDict of Python 3.11
from typing_extensions import TypedDict

from cpam_bayes.answer import Verdict
from cpam_bayes.mechanics.modes import Kind
from cpam_bayes.questions.identify.slips import SlipKind

Number: TypeAlias = float | None
"""Null where unknown or not finite."""
Hertz: TypeAlias = Annotated[Number, Field(description="Hz")]
Percent: TypeAlias = Annotated[Number, Field(description="%")]
Millimetres: TypeAlias = Annotated[Number, Field(description="mm")]
Probability: TypeAlias = Annotated[Number, Field(description="probability, 0 to 1")]
Share: TypeAlias = Annotated[Number, Field(description="a fraction, 0 to 1")]
Nats: TypeAlias = Annotated[Number, Field(description="nats")]
KHat: TypeAlias = Annotated[Number, Field(description="of importance sampling; above 0.7 not reliable")]
OfMaterial: TypeAlias = Annotated[Number, Field(description="the constant of [material]")]
SearchBound: TypeAlias = Annotated[Number, Field(description="of [unknowns]")]
Contraction: TypeAlias = Annotated[Number, Field(description="1 - (sd / sd of the prior)^2")]
ResidualPercent: TypeAlias = Annotated[Number, Field(description="predicted / measured - 1, %")]
WorstError: TypeAlias = Annotated[Number, Field(description="of the worst frequency, a fraction")]
AirDensity: TypeAlias = Annotated[Number, Field(description="kg/m3, null for vacuum")]
Seconds: TypeAlias = Annotated[float, Field(description="wall clock, s, not reproducible")]
Texts: TypeAlias = list[str]
Pair: TypeAlias = Annotated[list[float], Field(min_length=2, max_length=2)]
Places: TypeAlias = list[Pair]
"""Pairs of x and y."""
InConstants: TypeAlias = Annotated[
    dict[str, Number], Field(description="by constant, named as in [unknowns], in the unit of its name")
]
StandardError: TypeAlias = Annotated[Number, Field(description="standard error, nats")]
ModeKind: TypeAlias = Annotated[Kind, Field(description="of the mode")]
Bound: TypeAlias = Annotated[Literal["lower", "upper"] | None, Field(description="that the value sits on")]
PairedBy: TypeAlias = Annotated[
    Literal["shape", "label", "order"] | None, Field(description="what pairs the measured frequency")
]


class Value(TypedDict):
    """A number without its spread."""

    value: Number


class Spread(TypedDict):
    """Mean and standard deviation."""

    mean: Number
    sd: Number


class Interval(TypedDict):
    """The ends of a 95 % interval."""

    q025: Annotated[Number, Field(description="lower end of the 95 % interval")]
    q975: Annotated[Number, Field(description="upper end of the 95 % interval")]


class Moments(Spread, Interval):
    """Mean, standard deviation, and the ends of the 95 % interval."""


class WithBounds(TypedDict):
    """Search bounds, verdict and reference of a constant, in the unit of its name."""

    lower: SearchBound
    upper: SearchBound
    bound: Bound
    verdict: Verdict
    reference: OfMaterial


class ValueSpread(Value):
    """A number and its standard deviation."""

    sd: Number


class Estimate(ValueSpread, Interval, WithBounds):
    """A point estimate of a constant by the swarm, in the unit of its name."""


class LogEvidence(TypedDict):
    """A log evidence and its accuracy."""

    log_evidence: Nats
    log_evidence_error: StandardError
    k_hat: KHat


class SequenceFrequency(TypedDict):
    """A measured frequency and the mode it is paired with."""

    measured_hz: Hertz
    predicted_hz: Annotated[Number, Field(description="Hz, null without a mode")]
    residual_percent: ResidualPercent


class FrequencyRow(SequenceFrequency):
    """A measured frequency and the label of the mode it is paired with."""

    label: Annotated[str | None, Field(description="of the mode")]
    kind: ModeKind | None


class Mode(TypedDict):
    """A mode of the plate model."""

    kind: ModeKind
    label: Annotated[str, Field(description="half waves or nodal lines")]


class ComputedMode(Mode):
    """A mode with its frequency."""

    frequency_hz: Hertz


class MissedMode(Mode):
    """A mode within the range of the list that the list lacks."""

    predicted_hz: Hertz


class Shape(TypedDict):
    """A measured shape and the mode it is paired with."""

    measured_hz: Hertz
    mode: Annotated[int | None, Field(description="number of the mode, from 1; null for none")]
    label: str | None
    probability: Probability


class Slip(TypedDict):
    """A slip of the plate file that explains the misfit of its list."""

    slip: SlipKind
    number: Annotated[int, Field(description="of the mode or frequency, from 1; 0 for the plate")]
    frequency_hz: Hertz
    rms_percent: Annotated[Number, Field(description="misfit without the slip, %")]
    probability: Probability


class Peak(TypedDict):
    """A candidate peak of recorded hits."""

    hz: Hertz
    mode_probability: Annotated[Number, Field(description="of being a mode, by its height alone")]
    damping: Annotated[Number, Field(description="ratio")]
    predicted_hz: Annotated[Number, Field(description="of the mode that it was paired with, Hz")]
    taken: Annotated[str, Field(description="its classification")]
    probability: Annotated[Number | None, Field(description="of this classification")]


class HandledMode(TypedDict):
    """A mode at the places of `Handling`; deflections are fractions of its largest one."""

    mode: Annotated[int, Field(description="number, from 1")]
    frequency_hz: Hertz
    at_pads: Annotated[Number, Field(description="deflection")]
    at_hit: Annotated[Number, Field(description="deflection")]
    at_sensor: Annotated[Number, Field(description="deflection")]
    lines_mm: Annotated[Pair | None, Field(description="positions of two lines that disturb it least, mm")]
    lines_across: Annotated[Literal["x", "y"] | None, Field(description="the axis that the lines cross")]


class Handling(TypedDict):
    """Where to hold the plate, where to hit it, and where to measure; places are x and y, mm."""

    pads_mm: Annotated[Places, Field(description="of a free plate, else empty")]
    hits_mm: Places
    sensor_mm: Pair
    modes: list[HandledMode]


class Damping(TypedDict):
    """Damping of a measured frequency."""

    measured_hz: Hertz
    damping_ratio: Number
    loss_factor: Number


class Head(TypedDict):
    """Keys at the head of every document."""

    version: Annotated[str, Field(description="of cpam_bayes")]
    fingerprint: Annotated[str, Field(description="hash of the sources that the answer depends on")]


class Seeded(Head):
    """Keys of a document that a seed reproduces."""

    seed: Annotated[int, Field(description="repeats the answer bit for bit")]


class Answer(Seeded):
    """Keys of a computed answer."""

    warnings: Annotated[Texts, Field(description="every reason not to trust the numbers")]


class TimedAnswer(Answer):
    """An answer with its computing time."""

    seconds: Seconds


class Certificate(TypedDict):
    """Who tested the plate and when, as stated in the plate file."""

    laboratory: NotRequired[str]
    operator: NotRequired[str]
    date: NotRequired[str]


class PlateHead(Seeded, Certificate):
    """Keys at the head of a document about one plate."""

    plate: Annotated[str, Field(description="its name")]
    specimen: Annotated[str, Field(description="equal for tests of one plate")]
    source: Annotated[str, Field(description="path of the plate file, or the built-in specimen")]
    damping: NotRequired[Annotated[list[Damping], Field(description="where a table of modes gives it")]]


class PlateAnswer(PlateHead, TimedAnswer):
    """An answer about one plate."""

    notes: Annotated[Texts, Field(description="of the plate file")]


class ModelAnswer(PlateAnswer):
    """An answer from a converged plate model."""

    relative_error_estimate: WorstError
    air_density_kg_m3: AirDensity


class ByShape(TypedDict):
    """Pairing by measured shapes, if there are any."""

    modal_assurance: NotRequired[Annotated[list[list[Number]], Field(description="measured x computed")]]
    shapes: NotRequired[list[Shape]]
