"""Every cause of the catalogue is hidden in a list at least once, and the user's claim is checked.

The lists are those of independent elements, with noise of 0.2 %. A cause that the constants imitate cannot be
claimed: then nothing may be, and the answer says so. Pairs are weighed for one cause of each plate.
"""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

import cpam_bayes as cb
from cpam_bayes.diagnosis.cases import hypotheses_of, plate_case
from cpam_bayes.diagnosis.diagnose import diagnose_cases
from cpam_bayes.effects import CATALOGUE
from cpam_bayes.effects.geometry import THICKNESS
from cpam_bayes.effects.masses import SENSOR_MASS
from cpam_bayes.effects.plies import MISORIENTATION, SHEAR_RATIO
from cpam_bayes.inference.ensemble import EnsembleSettings
from cpam_bayes.plate import parse_specimen
from cpam_bayes.questions.diagnose import diagnosis_result
from cpam_bayes.questions.diagnose.claim import scale_errors_of
from cpam_bayes.questions.diagnose.document import answer_constants
from tests.diagnosed import diagnosed
from tests.hybrids import HYBRID, UNKNOWNS
from tests.plate_file import PLATE
from validation.independent import lists
from validation.independent.lists import NominalPlate
from validation.independent.true_plate import FLAWS, Aux, TruePlate


def _plate(length, width, thickness, edges="FFFF"):
    return TruePlate(length, width, thickness, 2700, edges, (0.0,), {"E1": 70e9, "nu12": 0.33})


_HALF = (0.0, 90.0) * 4
_CARBON = {"E1": 125e9, "E2": 9.0e9, "nu12": 0.30, "G12": 5.2e9}
_OTHER_CARBON = {"E1": 0.55 * _CARBON["E1"], "E2": 1.6 * _CARBON["E2"]}
FREE = NominalPlate("free", _plate(0.271, 0.193, 2.1e-3), "[0]", "aluminium", True, 10)
CLAMPED = NominalPlate("clamped", _plate(0.261, 0.143, 2.2e-3, "CFFF"), "[0]", "aluminium", True, 10)
# thick, so that transverse shear matters
_CROSS_PLY = TruePlate(0.203, 0.151, 5.3e-3, 1580, "FFFF", (*_HALF, *_HALF[::-1]), _CARBON)
THICK = NominalPlate("thick", _CROSS_PLY, "[(0/90)_4]_s", "carbon", True, 10)
SUPPORTED = replace(FREE, name="supported", plate=replace(FREE.plate, edges="SSSS"))
OTHERS = [pytest.param(p, id=p.name, marks=pytest.mark.weekly) for p in (CLAMPED, THICK, SUPPORTED)]
SLOW = (pytest.mark.slow,)  # for a test that `.ci/run` runs too


@dataclass(frozen=True, slots=True)
class Case:
    """One list: the cause, the plate, its size in SI with a place, or else the change that makes the list.
    true : changes of the drawn plate. on_list : change of its frequencies
    missed, complete : modes missing from the list, and the file's statement
    sets : whether several simultaneous causes are weighed too
    marks : none if everyone runs it, slow if `.ci/run` does too; by default only the weekly run."""

    cause: str
    plate: NominalPlate
    size: float = 0.0
    aux: Aux = field(default_factory=dict)
    true: Any = lambda plate: {}
    on_list: Any = lambda own, f: f
    missed: tuple[int, ...] = ()
    complete: bool = True
    sets: bool = False
    marks: Any = (pytest.mark.slow, pytest.mark.weekly)

    def listed(self):
        rng = np.random.default_rng(7)
        how = {"missed": self.missed, "complete": self.complete}
        if self.cause in FLAWS:
            return lists.single(self.plate, self.cause, None, rng, size=self.size, aux=self.aux, **how)
        own = self.plate.drawn(rng)
        true, how["on_list"] = replace(own, **self.true(own)), lambda f: self.on_list(own, f)
        return lists.listed(self.plate, true, "one", {}, rng, causes=(self.cause,), **how)


def _in_air(own, f):
    """A list in air, which the independent elements lack: the shift is that of unreduced finite elements."""
    text = replace(FREE, plate=own).file([100.0 + i for i in range(FREE.n_modes)], stated=None)
    vacuum = parse_specimen(text, "plate.toml")
    without, in_air = (cb.forward(replace(vacuum, air_density=d), solver="fem") for d in (None, 1.2))
    return f * in_air.frequencies / without.frequencies


def _misread(factors):
    return lambda own, f: f * [factors.get(i, 1.0) for i in range(len(f))]


# A bell with a standard deviation of 7.1 % of the shorter side.
_PATCH = {"form": "smooth", "x": 0.463, "y": 0.527, "half": [0.071 * 0.193 / 0.271, 0.071]}
SHOWN = (  # Causes that frequencies can show, at sizes and places off every grid.
    Case("sensor_mass", FREE, 0.031, {"x": 0.8437, "y": 0.2362}, marks=()),
    Case("sensor_mass", FREE, 0.031, {"x": 0.8437, "y": 0.2362}, missed=(4,), complete=False),
    # a strip along x = 0 with 1.7 % of the plate's mass
    Case("edge_mass", FREE, true=lambda p: {"strips": (("x0", 0.017 * p.total_mass),)}),
    Case("support", FREE, 34.0),
    # springs of pi^4 D / (2 c a^3), c = 0.037, along the four edges
    Case("soft_support", SUPPORTED, true=lambda p: {"shift": 0.037 * 2.0 / np.pi**4}),
    Case("length", FREE, 0.0171, sets=True),
    Case("width", FREE, -0.0233),
    Case("taper_x", FREE, -0.137),
    Case("taper_y", FREE, 0.163),
    Case("skew", FREE, 6.3),
    Case("warp", FREE, 1.31e-3),
    Case("membrane_stress", FREE, 4.7e6),
    Case("outline", FREE, 0.087, {"form": "rectangle", "x": 1.0, "y": 0.0, "ratio": 1.18}),
    Case("damage", FREE, 0.77, _PATCH),
    Case("viscoelastic", FREE, 0.037),
    Case("mode_identity", FREE, missed=(4,), marks=SLOW),
    Case("outlier", FREE, on_list=_misread({5: 1.043}), marks=SLOW),
    Case("clamp_rotation", CLAMPED, 0.071),
    Case("clamp_translation", CLAMPED, 0.0063, sets=True),
    Case("soft_clamp", CLAMPED, 2.3, {"ratio": 1.55}),
    Case("clamp_slip", CLAMPED, 0.13),
    Case("clamp_length", CLAMPED, 4.1e-3),
    Case("misorientation", THICK, 8.3, sets=True),
    Case("outer_ply_angle", THICK, 17.0),
    Case("inner_ply_angle", THICK, 63.0),
    # the third ply from the bottom is missing; the others fill the gauged thickness
    Case("layup", THICK, true=lambda p: {"angles_deg": p.angles_deg[:2] + p.angles_deg[3:]}, sets=True),
    # length and width are exchanged in the file
    Case("swapped_sides", THICK, true=lambda p: {"length": p.width, "width": p.length}, sets=True),
    Case("transverse_shear", THICK, -0.87),
    # E1 is 45 % lower and E2 60 % higher than the file states to 10 %
    Case("material", THICK, true=lambda p: {"constants": {**p.constants, **_OTHER_CARBON}}),
)
# Half the assumed ratio, the smallest possible: these frequencies show it but do not decide.
OPEN = Case("shear_ratio", THICK, -0.49)
ABSORBED = (  # Causes that the constants imitate: in thin plates nothing else shifts the modes alike.
    Case("air", FREE, 1.2, on_list=_in_air),
    Case("thickness", FREE, 0.027, marks=SLOW),
    Case("density", FREE, -0.034),
    Case("frequency_scale", FREE, 0.0083),
    Case("resin_skin", THICK, 8.3e-5),
)


def _diagnosed(case, catalogue=CATALOGUE, *, power=False, file=""):
    """The user's answer for the list, or for a file. power : with detection limits"""
    plate = plate_case(parse_specimen(file or case.listed()[0], f"{case.plate.name}.toml"))
    hypotheses = hypotheses_of([plate], catalogue)
    found = diagnose_cases([plate], hypotheses=hypotheses, sets=case.sets, gain=False, power=power)
    return diagnosis_result(found, 0)


def _marked(cases):
    ids = [case.cause if case.complete else f"{case.cause}, incomplete" for case in cases]
    return [pytest.param(case, id=name, marks=case.marks) for case, name in zip(cases, ids, strict=True)]


def test_every_cause_of_the_catalogue_is_hidden():
    assert {case.cause for case in (*SHOWN, *ABSORBED, OPEN)} == {effect.name for effect in CATALOGUE}


@pytest.mark.parametrize("case", _marked(SHOWN))
def test_the_claim_is_what_was_hidden(case):
    found = _diagnosed(case)
    assert found.claim in ("named", "class")
    assert case.cause in found.causes


def test_two_misread_frequencies_are_claimed_at_once():
    """The third 3 % too low, the seventh 4.3 % too high: neither alone explains the list."""
    few = tuple(effect for effect in CATALOGUE if effect.name in ("outlier", "mode_identity", "density"))
    found = _diagnosed(Case("outlier", FREE, on_list=_misread({2: 0.97, 6: 1.043}), sets=True), few)
    assert (found.claim, found.causes) == ("pair", ("outlier", "outlier#2"))
    (both,) = (h for h in found.to_dict()["hypotheses"] if h["cause"] == "outlier + outlier#2")
    for name, true in (("misreading", -3.0), ("misreading#2", 4.3)):
        size = both["parameters"][name]
        assert size["mean"] == pytest.approx(true, abs=3.0 * size["sd"])
        assert size["sd"] < 0.5
    assert "misread frequency 296 Hz" in found.summary().splitlines()[1]
    assert "misread frequency 602.7 Hz" in found.summary()


@pytest.mark.slow
@pytest.mark.weekly
def test_a_shear_ratio_within_its_limits_is_left_open_and_leads():
    found = _diagnosed(OPEN)
    assert found.claim in ("undecided", "class")
    assert found.causes[0] == "shear_ratio"


@pytest.mark.parametrize("case", _marked(ABSORBED))
def test_what_the_constants_imitate_is_not_claimed_and_is_said_to_be_unseen(case):
    found = _diagnosed(case, power=True)
    assert found.claim == "none"
    assert case.cause in {row["cause"] for row in found.to_dict()["absorbed"]}
    smallest = {row.cause: row.smallest for row in found.diagnosis.detectable}
    assert smallest[case.cause] is None or smallest[case.cause] > abs(case.size)
    assert smallest["warp"] is not None  # for others the detection limit is given


@pytest.mark.slow
@pytest.mark.parametrize("plate", [pytest.param(FREE, id="free"), *OTHERS])
def test_nothing_is_claimed_of_a_plate_without_a_flaw(plate):
    assert _diagnosed(Case("none", plate, sets=True)).claim in ("none", "undecided")


@pytest.mark.slow
def test_what_no_cause_explains_is_no_cause():
    """A smooth discrepancy of sixteen times the noise."""
    file, _ = lists.smooth(FREE, 16.0, np.random.default_rng(7))
    assert _diagnosed(Case("other", FREE, sets=True), file=file).claim in ("other", "undecided")


@pytest.mark.slow
@pytest.mark.weekly
def test_a_cause_that_the_catalogue_lacks_is_not_replaced_by_a_wrong_one():
    (warped,) = (case for case in SHOWN if case.cause == "warp")
    others = tuple(effect for effect in CATALOGUE if effect.name != "warp")
    assert _diagnosed(replace(warped, sets=True), others).claim in ("none", "undecided", "other")


WEIGHED = PLATE.replace("density_kg_m3 = 2700.0", "mass_g = 680.4")
KNOWN = WEIGHED.replace("nu12 = 0.33\n", "nu12 = 0.33\n\n[material.sd]\nE1_GPa = 0.69\nnu12 = 0.0033\n", 1)
GAUGED = "[plate.sd]\nthickness_mm = 0.003\n\n[material]\n"
SISTERS = WEIGHED.replace("[material]\n", f'{GAUGED}name = "aluminium"\n', 1)


def listing(text, thickness_mm=3.0, relative_std=0.001):
    """File of a plate of 3 mm with the list of one of another thickness and equal mass."""
    f = cb.forward(parse_specimen(text.replace("= 3.0", f"= {thickness_mm}", 1), "x"), n_modes=8).frequencies
    rounded = [round(float(v), 2) for v in f]
    return f"{text}\n[measurement]\nfrequencies_hz = {rounded}\nrelative_std = {relative_std}\n"


# f^2 ~ E h^3 / m: 1 % of E is 0.33 % of h, less with its prior; plates differ by 2.5 % in E, 0.9 % in h
@pytest.mark.parametrize(
    ("plates", "thinner", "least", "sd", "near"),
    [
        ({KNOWN: 2.85}, 0.05, 0.95, (0.0028, 0.0008), 0.001),  # five times the tolerance; at four p is 0.6
        ({KNOWN.replace("[material]\n", GAUGED, 1): 2.88}, 0.04, 0.95, (0.0028, 0.0008), 0.001),
        ({SISTERS: 2.88, SISTERS.replace("plate 7", "sister"): 3.0}, 0.04, 0.5, (0.009, 0.002), 0.002),
    ],
    ids=["of a known material", "gauged", "beside a sister plate"],
)
def test_a_weighed_plate_that_is_thinner_than_stated_is_found_so(plates, thinner, least, sd, near):
    cases = [plate_case(parse_specimen(listing(text, h), "x")) for text, h in plates.items()]
    (cause,) = (c for c in diagnosed(cases, ["thickness"], gain=False).causes if c.name == "thickness")
    assert cause.probability > least
    mean, spread, _ = cause.parameters["thickness_deviation"]
    assert (mean, spread) == (pytest.approx(-thinner, abs=near), pytest.approx(sd[0], abs=sd[1]))


@pytest.mark.slow
def test_all_commands_say_the_same_of_an_error_of_a_size():
    plate = parse_specimen(listing(WEIGHED, relative_std=0.002), "x")
    settings = EnsembleSettings(walkers=16, round_steps=100, effective=200.0, most_steps=400)
    identified = cb.identify(plate, seed=1).estimate.scale_errors
    sampled = cb.sample(plate, seed=1, settings=settings).scale_errors
    found = diagnosed([plate_case(plate)], ["frequency_scale"], gain=False)
    diagnosis = scale_errors_of(found, found.cases[0].models.specimen)
    for one, *others in zip(identified, sampled, diagnosis, strict=True):
        for other in others:
            assert other.name == one.name
            for constant in ("E1", "nu12"):
                assert np.isclose(other.shift[constant], one.shift[constant], rtol=0.02, atol=0.02)


NOISE = 0.001
# One draw of the noise, in units of its sd.
DRAWN = np.array([0.4, -1.1, 0.2, 0.9, -0.5, 0.1, -0.3, 1.2, -0.7, 0.6])
CAUSES = (SENSOR_MASS, THICKNESS, MISORIENTATION, SHEAR_RATIO)


def diagnosed_hybrid(*sensors):
    """Diagnosis of a finite-element list with masses that the file does not state."""
    f = cb.forward({**HYBRID, "sensor": list(sensors)}, n_modes=len(DRAWN), solver="fem").frequencies
    listed = {"frequencies_hz": (f * (1.0 + NOISE * DRAWN)).round(2).tolist(), "resolution_hz": 0.01}
    file = {**HYBRID, "unknowns": UNKNOWNS, "measurement": {**listed, "relative_std": NOISE}}
    return cb.diagnose(file, catalogue=CAUSES, next_test="never")


@pytest.mark.slow
def test_an_added_mass_on_a_hybrid_is_found_with_its_size_and_place():
    result = diagnosed_hybrid({"mass_g": 9.0, "x_mm": 280.0, "y_mm": 185.0})  # 9 g on a plate of about 310 g
    assert (result.claim, result.diagnosis.causes[0].name) == ("named", SENSOR_MASS.name)
    size = result.to_dict()["hypotheses"][0]["parameters"][SENSOR_MASS.parameters[0].name]
    assert abs(size["mean"] - 9.0) < 3.0 * size["sd"]
    found = {constant.name: constant for constant in answer_constants(result.diagnosis)}
    for name, value in (("carbon.E1", 121.2e9), ("carbon.E2", 9.34e9), ("glass.E1", 40.1e9)):
        assert abs(found[name].value - value) < 3.0 * found[name].sd


@pytest.mark.slow
@pytest.mark.weekly
def test_of_a_hybrid_with_nothing_wrong_nothing_is_claimed():
    result = diagnosed_hybrid()
    assert result.claim in ("none", "undecided")
    assert result.diagnosis.causes[0].name == "none"
    assert "carbon.E1" in result.summary()
