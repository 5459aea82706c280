"""Every cause of the catalogue is hidden in a list at least once, and what the user reads is its claim.

The lists are those of elements that share nothing with the package, with noise of 0.2 %. A cause that the
constants imitate cannot be claimed: then nothing may be, and the answer says that these data need not have
shown it. Pairs of causes, most of the work, are weighed for a cause of each plate and for clean ones.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

import cpam_bayes as cb
from cpam_bayes.diagnosis.cases import hypotheses_of, plate_case
from cpam_bayes.diagnosis.diagnose import diagnose_cases
from cpam_bayes.effects import CATALOGUE
from cpam_bayes.plate import parse_specimen
from cpam_bayes.questions.diagnose import diagnosis_result
from validation.independent import lists
from validation.independent.lists import NominalPlate, Truth
from validation.independent.true_plate import Aux, TruePlate

_HALF = (0.0, 90.0) * 4
_METAL = {"E1": 70e9, "nu12": 0.33}
_CARBON = {"E1": 125e9, "E2": 9.0e9, "nu12": 0.30, "G12": 5.2e9}
FREE = NominalPlate(
    "free", TruePlate(0.271, 0.193, 2.1e-3, 2700, "FFFF", (0.0,), _METAL), "[0]", "aluminium", True, 10
)
CLAMPED = NominalPlate(
    "clamped", TruePlate(0.261, 0.143, 2.2e-3, 2700, "CFFF", (0.0,), _METAL), "[0]", "aluminium", True, 10
)
# thick, so that the transverse shear shows
THICK = NominalPlate(
    "thick",
    TruePlate(0.203, 0.151, 5.3e-3, 1580, "FFFF", (*_HALF, *_HALF[::-1]), _CARBON),
    "[(0/90)_4]_s",
    "carbon",
    True,
    10,
)
SUPPORTED = replace(FREE, name="supported", plate=replace(FREE.plate, edges="SSSS"))
PLATES = {plate.name: plate for plate in (FREE, CLAMPED, THICK, SUPPORTED)}

Listed = tuple[str, Truth]


@dataclass(frozen=True, slots=True)
class Case:
    """One list: the cause, the plate, and its size in SI with a place, or else how the list is made.

    quick : whether it is run by default. sets : whether several causes at once are weighed too.
    weekly : whether another case of its kind is enough for `.ci/run`.
    """

    cause: str
    plate: NominalPlate
    size: float = 0.0
    aux: Aux = field(default_factory=dict)
    made: Callable[[NominalPlate, np.random.Generator], Listed] | None = None
    quick: bool = False
    sets: bool = False
    weekly: bool = False

    def listed(self) -> Listed:
        """The plate's file and the truth."""
        rng = np.random.default_rng(7)
        if self.made is not None:
            return self.made(self.plate, rng)
        return lists.single(self.plate, self.cause, None, rng, size=self.size, aux=self.aux)


def _in_air(plate: NominalPlate, rng: np.random.Generator) -> Listed:
    """A list in air, of which the file says nothing.

    Frequencies in vacuum are those of the independent elements, which know no air; how much it lowers them is
    told by unreduced finite elements.
    """
    own = plate.drawn(rng)
    text = replace(plate, plate=own).file([100.0 + i for i in range(plate.n_modes)], stated=None)
    vacuum = parse_specimen(text, "plate.toml")
    f, in_air = (
        cb.forward(replace(vacuum, air_density=density), solver="fem").frequencies for density in (None, 1.2)
    )
    return lists.listed(plate, own, "one", {}, rng, on_list=lambda true: true * in_air / f, causes=("air",))


def _one_missed(plate: NominalPlate, rng: np.random.Generator) -> Listed:
    own = plate.drawn(rng)
    return lists.listed(plate, own, "one", {}, rng, missed=[4], causes=("mode_identity",))


def _one_misread(plate: NominalPlate, rng: np.random.Generator) -> Listed:
    """The sixth frequency is read 4.3 % too high."""
    factor = np.where(np.arange(plate.n_modes) == 5, 1.043, 1.0)
    own = plate.drawn(rng)
    return lists.listed(plate, own, "one", {}, rng, on_list=lambda f: f * factor, causes=("outlier",))


def _of_another_material(plate: NominalPlate, rng: np.random.Generator) -> Listed:
    """E1 is less by 45 % and E2 more by 60 %, each with 10 % in the file."""
    own = plate.drawn(rng)
    moved = {"E1": 0.55 * plate.plate.constants["E1"], "E2": 1.6 * plate.plate.constants["E2"]}
    other = replace(own, constants={**own.constants, **moved})
    return lists.listed(plate, other, "one", {}, rng, causes=("material",))


def _one_ply_missing(plate: NominalPlate, rng: np.random.Generator) -> Listed:
    """The third ply from the bottom was forgotten; the others fill the gauged thickness."""
    own = plate.drawn(rng)
    angles = (*own.angles_deg[:2], *own.angles_deg[3:])
    return lists.listed(plate, replace(own, angles_deg=angles), "one", {}, rng, causes=("layup",))


def _sides_exchanged(plate: NominalPlate, rng: np.random.Generator) -> Listed:
    """The file's length is the plate's width, and the other way round."""
    own = plate.drawn(rng)
    turned = replace(own, length=own.width, width=own.length)
    return lists.listed(plate, turned, "one", {}, rng, causes=("swapped_sides",))


def _taped(plate: NominalPlate, rng: np.random.Generator) -> Listed:
    """A strip along x = 0 of 1.7 % of the plate's mass."""
    own = plate.drawn(rng)
    taped = replace(own, strips=(("x0", 0.017 * own.total_mass),))
    return lists.listed(plate, taped, "one", {}, rng, causes=("edge_mass",))


def _on_soft_supports(plate: NominalPlate, rng: np.random.Generator) -> Listed:
    """Springs of pi^4 D / (2 c a^3), c = 0.037, along the four edges."""
    soft = replace(plate.drawn(rng), shift=0.037 * 2.0 / np.pi**4)
    return lists.listed(plate, soft, "one", {}, rng, causes=("soft_support",))


def _patch(x: float, y: float, plate: NominalPlate) -> Aux:
    """A bell, its standard deviation 7.1 % of the shorter side."""
    sides = np.array([plate.plate.length, plate.plate.width])
    return {"form": "smooth", "x": x, "y": y, "half": (0.071 * sides.min() / sides).tolist()}


# What frequencies can show, at sizes and places that no grid has.
SHOWN = (
    Case("sensor_mass", FREE, 0.031, {"x": 0.8437, "y": 0.2362}, quick=True),
    Case("edge_mass", FREE, made=_taped, weekly=True),
    Case("support", FREE, 34.0, weekly=True),
    Case("soft_support", SUPPORTED, made=_on_soft_supports, weekly=True),
    Case("length", FREE, 0.0171, sets=True),
    Case("width", FREE, -0.0233, weekly=True),
    Case("taper_x", FREE, -0.137, weekly=True),
    Case("taper_y", FREE, 0.163, weekly=True),
    Case("skew", FREE, 6.3, weekly=True),
    Case("warp", FREE, 1.31e-3),
    Case("membrane_stress", FREE, 4.7e6, weekly=True),
    Case("outline", FREE, 0.087, {"form": "rectangle", "x": 1.0, "y": 0.0, "ratio": 1.18}, weekly=True),
    Case("damage", FREE, 0.77, _patch(0.463, 0.527, FREE)),
    Case("viscoelastic", FREE, 0.037),
    Case("mode_identity", FREE, made=_one_missed),
    Case("outlier", FREE, made=_one_misread, quick=True),
    Case("clamp_rotation", CLAMPED, 0.071),
    Case("clamp_translation", CLAMPED, 0.0063, sets=True, weekly=True),
    Case("soft_clamp", CLAMPED, 2.3, {"ratio": 1.55}, weekly=True),
    Case("clamp_slip", CLAMPED, 0.13, weekly=True),
    Case("clamp_length", CLAMPED, 4.1e-3, weekly=True),
    Case("misorientation", THICK, 8.3, sets=True, weekly=True),
    Case("outer_ply_angle", THICK, 17.0, weekly=True),
    Case("inner_ply_angle", THICK, 63.0, weekly=True),
    Case("layup", THICK, made=_one_ply_missing, sets=True),
    Case("swapped_sides", THICK, made=_sides_exchanged, sets=True, weekly=True),
    Case("transverse_shear", THICK, -0.87, weekly=True),
    Case("material", THICK, made=_of_another_material, weekly=True),
)
# Half the ratio that is assumed, the least that is possible: what these frequencies show and do not decide.
OPEN = Case("shear_ratio", THICK, -0.49)
# What the constants imitate: thin plates have nothing else that moves their modes alike.
ABSORBED = (
    Case("air", FREE, 1.2, made=_in_air, weekly=True),
    Case("thickness", FREE, 0.027),
    Case("density", FREE, -0.034, weekly=True),
    Case("frequency_scale", FREE, 0.0083, weekly=True),
    Case("resin_skin", THICK, 8.3e-5, weekly=True),
)


def _diagnosed(
    case: Case, catalogue: tuple[cb.effects.Effect, ...] = CATALOGUE, *, power: bool = False
) -> cb.DiagnosisResult:
    """What a user would be told of the list. power : with the sizes that it would have shown."""
    plate = plate_case(parse_specimen(case.listed()[0], f"{case.plate.name}.toml"))
    hypotheses = hypotheses_of([plate], catalogue)
    return diagnosis_result(
        diagnose_cases([plate], hypotheses=hypotheses, sets=case.sets, gain=False, power=power), 0
    )


def _marked(cases: tuple[Case, ...]) -> list[object]:
    """As parameters of a test; all but the quick ones are slow."""
    return [pytest.param(case, id=case.cause, marks=_marks(case)) for case in cases]


def _marks(case: Case) -> list[pytest.MarkDecorator]:
    if case.quick:
        return []
    return [pytest.mark.slow, pytest.mark.weekly] if case.weekly else [pytest.mark.slow]


def test_every_cause_of_the_catalogue_is_hidden() -> None:
    assert {case.cause for case in (*SHOWN, *ABSORBED, OPEN)} == {effect.name for effect in CATALOGUE}


@pytest.mark.parametrize("case", _marked(SHOWN))
def test_the_claim_is_what_was_hidden(case: Case) -> None:
    found = _diagnosed(case)
    assert found.claim in ("named", "class")
    assert case.cause in found.causes


def test_two_misread_frequencies_are_claimed_at_once() -> None:
    """The third 3 % too low, the seventh 4.3 % too high: neither alone explains the list."""
    factor = np.where(np.arange(FREE.n_modes) == 2, 0.97, np.where(np.arange(FREE.n_modes) == 6, 1.043, 1.0))

    def misread(plate: NominalPlate, rng: np.random.Generator) -> Listed:
        own = plate.drawn(rng)
        return lists.listed(plate, own, "one", {}, rng, on_list=lambda f: f * factor, causes=("outlier",))

    few = tuple(effect for effect in CATALOGUE if effect.name in ("outlier", "mode_identity", "density"))
    found = _diagnosed(Case("outlier", FREE, made=misread, sets=True), few)
    assert (found.claim, found.causes) == ("pair", ("outlier", "outlier#2"))
    (both,) = (h for h in found.to_dict()["hypotheses"] if h["cause"] == "outlier + outlier#2")
    sizes = [both["parameters"][name] for name in ("misreading", "misreading#2")]
    for size, true in zip(sizes, (-3.0, 4.3), strict=True):
        assert size["mean"] == pytest.approx(true, abs=3.0 * size["sd"])
        assert size["sd"] < 0.5
    headline = found.summary().splitlines()[1]
    assert "misread frequency 296 Hz" in headline
    assert "misread frequency 602.7 Hz" in found.summary()


@pytest.mark.slow
def test_a_shear_ratio_within_its_limits_is_left_open_and_leads() -> None:
    found = _diagnosed(OPEN)
    assert found.claim in ("undecided", "class")
    assert found.causes[0] == "shear_ratio"


@pytest.mark.parametrize("case", _marked(ABSORBED))
def test_what_the_constants_imitate_is_not_claimed_and_is_said_to_be_unseen(case: Case) -> None:
    found = _diagnosed(case, power=True)
    assert found.claim == "none"
    assert case.cause in {row["cause"] for row in found.to_dict()["absorbed"]}
    smallest = {row.cause: row.smallest for row in found.diagnosis.detectable}
    least = smallest[case.cause]
    assert least is None or least > abs(case.size)
    # of others it is told what these data would have shown
    assert smallest["warp"] is not None


@pytest.mark.slow
@pytest.mark.parametrize(
    "plate",
    [pytest.param(p, marks=[pytest.mark.weekly] if p is CLAMPED else []) for p in PLATES.values()],
    ids=PLATES,
)
def test_nothing_is_claimed_of_a_plate_without_a_flaw(plate: NominalPlate) -> None:
    case = Case("none", plate, made=lambda p, rng: lists.listed(p, p.drawn(rng), "clean", {}, rng), sets=True)
    assert _diagnosed(case).claim in ("none", "undecided")


@pytest.mark.slow
@pytest.mark.weekly
def test_a_list_that_says_it_lacks_modes_is_diagnosed_like_any_other() -> None:
    (mass,) = (case for case in SHOWN if case.cause == "sensor_mass")

    def lacking(plate: NominalPlate, rng: np.random.Generator) -> Listed:
        how = {"size": mass.size, "aux": mass.aux, "missed": [4], "complete": False}
        return lists.single(plate, mass.cause, None, rng, **how)

    found = _diagnosed(replace(mass, made=lacking))
    assert found.claim in ("named", "class")
    assert "sensor_mass" in found.causes


@pytest.mark.slow
def test_what_no_cause_explains_is_no_cause() -> None:
    """A smooth discrepancy of sixteen times the noise."""
    case = Case("other", FREE, made=lambda plate, rng: lists.smooth(plate, 16.0, rng), sets=True)
    assert _diagnosed(case).claim in ("other", "undecided")


@pytest.mark.slow
@pytest.mark.weekly
def test_a_cause_that_the_catalogue_lacks_is_not_replaced_by_a_wrong_one() -> None:
    (warped,) = (case for case in SHOWN if case.cause == "warp")
    others = tuple(effect for effect in CATALOGUE if effect.name != "warp")
    found = _diagnosed(replace(warped, sets=True), others)
    assert found.claim in ("none", "undecided", "other")
