"""Documents of plates and modes: built-in, written, computed, recorded, predicted, designed."""

from __future__ import annotations

from typing import Annotated, Literal, TypeAlias

from pydantic import Field
from typing_extensions import TypedDict

from cpam_bayes.answer import Verdict
from cpam_bayes.documents.parts import (
    Answer,
    ByShape,
    ComputedMode,
    Handling,
    Head,
    Hertz,
    InConstants,
    Interval,
    Millimetres,
    Mode,
    ModelAnswer,
    Number,
    Pair,
    PairedBy,
    Places,
    PlateAnswer,
    PlateHead,
    Spread,
    Texts,
)
from cpam_bayes.forward_model.calculix.deck import Element
from cpam_bayes.identification.added_mass import Finding
from cpam_bayes.plate.laminate import MaterialSymmetry
from cpam_bayes.plate.modal_analysis.fit import Taken


class BuiltinPlate(TypedDict):
    """A built-in specimen."""

    name: str
    specimen: str
    length_mm: float
    width_mm: float
    thickness_mm: float
    density_kg_m3: Number
    layup: Annotated[str, Field(description="bottom to top, deg")]
    edges: Annotated[str, Field(description="at x=0, y=0, x=length, y=width")]
    material: str
    isotropic: bool
    symmetry: MaterialSymmetry
    unknowns: Annotated[Texts, Field(description="names of the constants")]
    frequencies: Annotated[int, Field(description="how many were measured")]
    thickness_class: Literal["thin", "thick"]
    notes: Texts


class Plates(Head):
    """The built-in specimens."""

    command: Literal["plates"]
    plates: list[BuiltinPlate]


class New(Head):
    """A plate file that was written."""

    command: Literal["new"]
    path: str
    missing: Annotated[Texts, Field(description="what the file still needs")]
    handling: Handling | None


class App(Head):
    """A page that has ended."""

    command: Literal["app"]
    address: str
    folder: Annotated[str, Field(description="of the plate files")]


class ForwardMode(ComputedMode):
    """A mode and its measured frequency, if any."""

    in_plane_share: Annotated[Number, Field(description="of the kinetic energy, 0 to 1")]
    relative_error_estimate: Annotated[Number, Field(description="of the frequency, a fraction")]
    measured_hz: Hertz
    paired_by: PairedBy


class Reference(TypedDict):
    """A constant used in the computation."""

    value: Annotated[Number, Field(description="in the unit of its name")]
    source: Annotated[str, Field(description="where it comes from")]


class Forward(ModelAnswer, ByShape):
    """Natural frequencies at the reference constants."""

    command: Literal["forward"]
    solver: Annotated[str, Field(description="in words")]
    modes: list[ForwardMode]
    handling: Handling | None
    no_error_estimate: Annotated[str | None, Field(description="why there is none")]
    constants: dict[str, Reference]


class Deck(PlateHead):
    """An input file for CalculiX and ABAQUS."""

    command: Literal["export"]
    to: Literal["ccx"]
    path: str
    element: Element
    element_type: Annotated[str, Field(description="its name in ABAQUS")]
    nodes: int
    elements: int
    masses: Annotated[int, Field(description="known masses on the plate")]
    modes: Annotated[int, Field(description="modes that are asked for, without rigid-body motions")]
    rigid_body_motions: int


class Universal(PlateHead):
    """Predicted modes in a universal file."""

    command: Literal["export"]
    to: Literal["uff"]
    path: str
    nodes: int
    measured_nodes: Annotated[bool, Field(description="nodes of measured shapes, not of a grid")]
    modes: list[ComputedMode]


Export: TypeAlias = Annotated[Deck | Universal, Field(discriminator="to")]


class Pole(TypedDict):
    """A mode with its damping."""

    hz: Hertz
    sd: Annotated[Number, Field(description="standard deviation of the frequency, Hz")]
    damping: Annotated[Number, Field(description="ratio")]
    damping_sd: Annotated[Number, Field(description="standard deviation of the ratio")]
    height: Annotated[Number, Field(description="of its peak, over the contribution of other modes")]
    peak_hz: Annotated[Number, Field(description="frequency of the peak, Hz")]
    hits: Annotated[int, Field(description="that show it")]


class OtherPole(TypedDict):
    """A pole that is not a mode."""

    hz: Hertz
    height: Number
    hits: int
    taken: Taken


class Poles(Answer):
    """Natural frequencies and damping from frequency responses."""

    command: Literal["poles"]
    files: Texts
    read: Annotated[str, Field(description="what the files were read as")]
    responses: int
    line_hz: Annotated[Number, Field(description="spacing of the lines, Hz")]
    range_hz: Annotated[Pair, Field(description="ends of the range, Hz")]
    order: Annotated[int, Field(description="of the model that gives the poles")]
    modes: list[Pole]
    others: list[OtherPole]


class PredictedMode(Mode, Interval):
    """A predicted frequency with its interval."""

    mean_hz: Hertz
    sd_hz: Hertz
    measured_q025: Annotated[Number, Field(description="lower end for a measurement, Hz")]
    measured_q975: Annotated[Number, Field(description="upper end for a measurement, Hz")]
    measured_hz: Hertz
    paired_by: PairedBy


class StoredPosterior(TypedDict):
    """The posterior behind the prediction."""

    source: str
    plate: str
    specimen: str
    draws: int
    constants: dict[str, Spread]


class Predict(ModelAnswer):
    """Frequencies of another plate from a stored posterior."""

    command: Literal["predict"]
    posterior: StoredPosterior
    sizes_of_posterior: Annotated[bool, Field(description="sizes are drawn with the constants")]
    frequencies: list[PredictedMode]


class Candidate(TypedDict):
    """A specimen or test, and what it would determine."""

    description: str
    information_nats: Annotated[Number, Field(description="expected information on the constants, nats")]
    length_mm: Millimetres
    width_mm: Millimetres
    thickness_mm: Millimetres
    layup: Annotated[str | None, Field(description="null for an isotropic material")]
    edges: str
    modes: Annotated[int, Field(description="length of the list")]
    is_present: Annotated[bool, Field(description="the plate as it is")]
    sd: InConstants
    information_by_constant: Annotated[dict[str, Number], Field(description="nats")]
    verdict: dict[str, Verdict]


class FailedCandidate(TypedDict):
    """A specimen that cannot be computed."""

    layup: str
    edges: str
    ratio: Annotated[Number, Field(description="length / width")]
    message: str


class Design(PlateAnswer):
    """Specimens and tests, the most informative first."""

    command: Literal["design"]
    constants: Annotated[Texts, Field(description="those that are asked for")]
    prior_sd: InConstants
    relative_std: Annotated[Number, Field(description="repeatability of a frequency, a fraction")]
    relative_std_is_usual: Annotated[bool, Field(description="not stated")]
    relative_std_needed: Annotated[
        Number, Field(description="at which the first candidate determines the constants")
    ]
    resolution_hz: Hertz
    candidates: list[Candidate]
    failed: list[FailedCandidate]


class Coin(TypedDict):
    """A further list and the mass found in it."""

    list: Annotated[str, Field(description="name of its file")]
    finding: Finding
    radius_mm: Annotated[Number, Field(description="about the place, with 95 % probability, mm")]
    found_g: Annotated[Number, Field(description="g, null where none is claimed")]
    sd_g: Annotated[Number, Field(description="g")]
    q025_g: Annotated[Number, Field(description="lower end of the 95 % interval, g")]
    q975_g: Annotated[Number, Field(description="upper end of the 95 % interval, g")]
    x_mm: Millimetres
    y_mm: Millimetres
    probability: Annotated[Number, Field(description="that a mass was added, 0 to 1")]
    stated_g: Annotated[Number, Field(description="sealed mass, g")]
    distance_mm: Annotated[Number, Field(description="from the sealed place, mm")]
    shifts_inside: Annotated[int | None, Field(description="shifts within what the seal predicts")]
    shifts: Annotated[int, Field(description="how many there are")]
    hash: Annotated[str | None, Field(description="SHA-256 of the sealed file")]
    images_mm: Annotated[Places, Field(description="mirror images of the place, mm")]


class Shift(TypedDict):
    """A frequency of a further list, and its prediction with the sealed mass."""

    list: str
    mode: Annotated[int, Field(description="number, from 1")]
    first_hz: Annotated[Number, Field(description="of the first list, Hz")]
    predicted_hz: Hertz
    sd_hz: Hertz
    measured_hz: Hertz
    inside: Annotated[bool, Field(description="within the 95 % interval")]


class Prove(PlateHead, Answer):
    """The coin test: mass and place of what was stuck to the plate."""

    command: Literal["prove"]
    hash: Annotated[str | None, Field(description="SHA-256 of the sealed file")]
    coins: list[Coin]
    detection_limit_g: Annotated[Number, Field(description="smallest mass that would have been claimed, g")]
    coverage: Annotated[dict[str, Number] | None, Field(description="share inside 95 % intervals, 0 to 1")]
    shifts: list[Shift]
    repeatability: Annotated[Pair | None, Field(description="its 95 % interval, a fraction")]
    shift_error: Annotated[Number, Field(description="bound of the error of a shift, a fraction")]
