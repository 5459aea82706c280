"""Words shared by screens and pages: the plate, constants, fit, intervals, digits."""

import math
import re
from dataclasses import replace
from datetime import date

import numpy as np
import pytest

import cpam_bayes as cb
from cpam_bayes.answer import Constant, Verdict
from cpam_bayes.formatting import decimals_of, file_stem, fixed, probable, significant, with_spread
from cpam_bayes.forward_model.known_errors import FREQUENCY_SCALE, ScaleError
from cpam_bayes.parameters import TruncatedNormal, Uniform
from cpam_bayes.plate import Measurement, builtin
from cpam_bayes.render import sentences
from cpam_bayes.render.plate import edges_text, plate_head
from cpam_bayes.render.report import plate_keys
from cpam_bayes.render.sentences import constants_headline, fit_sentence, intervals_sentence
from cpam_bayes.render.terminal import plain_text
from tests.plate_file import described

E1 = Constant("E1", 136.6e9, 2.7e9, (131.4e9, 141.9e9), Uniform(80e9, 200e9), 132e9, Verdict.DATA)
NU12 = Constant("nu12", 0.197, 0.056, (0.15, 0.307), Uniform(0.15, 0.45), 0.31, Verdict.BOTH)
G12 = Constant("G12", 4.0e9, math.nan, None, Uniform(2e9, 8e9), math.nan, Verdict.PRIOR)
SAID = [
    *((E1, ("determined",)), (NU12, ("partly", "0.15 to 0.45")), (G12, ("not known",))),
    (replace(NU12, prior=TruncatedNormal(0.3, 0.05, 0.15, 0.45)), ("partly", "0.3 +- 0.05")),
    (replace(E1, verdict=Verdict.PRIOR), ("not determined",)),
    (replace(E1, verdict=Verdict.MISFIT), ("not determined", "fit")),
    (replace(E1, verdict=Verdict.UNCONVERGED), ("not known", "converge")),
    (replace(E1, bound="lower"), ("not determined", "lower bound")),
    (replace(E1, elsewhere=(100e9,)), ("not determined", "100.0")),
    (replace(E1, rests_on=("nu12",)), ("determined", "nu12")),
]


def test_a_constant_has_its_unit_and_the_digits_of_its_spread():
    rows = [("E1", "136.6 GPa", "131.4 to 141.9"), ("nu12", "0.197", "0.150 to 0.307")]
    assert [row[:3] for row in sentences.constants_table((E1, NU12)).rows] == rows
    first, _, last = sentences.constant_rows((E1, NU12, G12)).records()
    assert (first["name"], first["value"], first["unit"]) == ("E1", pytest.approx(136.6), "GPa")
    assert (first["verdict"], last["q025"]) == ("determined by the data", None)


@pytest.mark.parametrize(("constant", "words"), SAID)
def test_what_decides_a_constant_is_said_in_few_words(constant, words):
    said = sentences.determined_text(constant)
    assert [word for word in words if word not in said] == []
    assert len(said.split()) <= 8
    assert sentences.constants_table((constant,)).flagged == (frozenset() if constant.is_determined else {0})


def test_the_headline_names_what_is_determined_and_what_is_left_open():
    assert constants_headline((E1, NU12), 10) == "The 10 frequencies determine E1."
    assert constants_headline((E1, G12), 10) == "The 10 frequencies determine E1, not G12."
    assert constants_headline((NU12,), 1) == "The frequency determines none of the constants."


def test_the_fit_is_told_against_the_noise():
    assert "as good as the stated repeatability of 0.2 %" in fit_sentence(0.0019, stated=0.002)
    assert "worse than" in fit_sentence(0.009, stated=0.002, explained=False)
    assert "0.2 %, but only far from stated" in fit_sentence(0.0021, stated=0.002, explained=False)
    assert "4.5 times the stated repeatability" in fit_sentence(0.009, stated=0.002)
    assert "1.3 %, high for a tap test" in fit_sentence(0.01, inferred=0.013)
    f = np.array([100.0, 200.0])
    hits = Measurement(f, 0.0, None, 0.004 * f, ("", ""), complete=True, origin="hits.csv: means of 5 hits")
    assert "as good as the scatter of the hits, 0.4 %." in fit_sentence(0.004, stated=0.004, measurement=hits)
    for own, good in (
        (0.002, "as good as the stated 0.2 % and the scatter of the hits, 0.4 % together."),
        (0.003999, "as good as the stated repeatability of 0.4 %."),
    ):
        assert good in fit_sentence(0.004, stated=0.004, measurement=replace(hits, relative_std=own))
    assert "nothing is left" in fit_sentence(0.0, inferred=math.nan, freedom=0)


def test_intervals_name_what_they_contain_and_the_largest_error_that_they_do_not():
    specimen = builtin("A1")
    errors = (
        ScaleError("length", {"E1": -3.0}, 0.9, None),  # shows in the frequencies
        ScaleError("thickness", {"E1": -2.0}, 0.0, None),
        ScaleError("density", {"E1": 1.0}, 0.0, None),
        ScaleError(FREQUENCY_SCALE, {"E1": -2.0}, 0.0, None),
    )
    said = intervals_sentence(specimen.plate, errors, ["E1"])
    assert re.search(r"contain noise\..*thickness \(1 % more moves E1 by -2.0 %\)", said, re.S)
    gauged = replace(specimen.plate, sd={"thickness": 1e-5})
    stated = (errors[0], replace(errors[1], sd=0.003), *errors[2:])
    for part in ("noise and thickness", "frequency scale"):
        assert part in intervals_sentence(gauged, stated, ["E1"])
    assert "thickness" in intervals_sentence(specimen.plate, (), ["E1"], found=["thickness"])
    (step,) = sentences.gauge_step(specimen, errors, ["E1"])
    assert step.endswith("thickness and density are known: gauge and weigh the plate.")
    for name, left in (("density", "thickness is known: gauge"), ("thickness", "density is known: weigh")):
        known = replace(specimen.plate, sd={name: 1e-5})
        (step,) = sentences.gauge_step(replace(specimen, plate=known), errors, ["E1"])
        assert step.endswith(f"{left} the plate.")
    moves = [row[1] for row in sentences.errors_table(stated, ["E1"]).rows]
    assert moves == ["-3.0", "-2.0", "+1.0", "-2.0"]


def test_edges_are_said_in_words():
    assert edges_text("FFFF") == "free on all four edges"
    assert edges_text("CFFF") == "clamped at x = 0; free at y = 0, x = length and y = width"
    text = "simply supported at x = 0 and x = length; clamped at y = 0; free at y = width"
    assert edges_text("SCSF") == text


def test_the_head_has_the_slips_of_print_laboratory_operator_date_and_specimen():
    text = plain_text(plate_head(builtin("C1"), None))
    assert "layup     [(0/90)_8]_s, 32 plies" in text
    assert re.search(r"note +Table 2 prints this layup as", text)
    given = described((200, 100, 3), 2700, {"isotropic": True, "E1_GPa": 69, "nu12": 0.33})
    head = [("specimen", "s7"), ("laboratory", "Hall 3"), ("operator", "A. Weber"), ("date", "2026-03-05")]
    plate = cb.read_plate({**given, **dict(head), "date": date(2026, 3, 5)})
    assert list(plate_head(plate, None).rows[:4]) == head
    assert plate_keys("forward", 0, plate)["date"] == "2026-03-05"
    assert "laboratory" not in plate_keys("forward", 0, cb.read_plate(given))


def test_a_number_has_its_significant_digits():
    texts = {(67.3279, 4): "67.33", (0.35, 3): "0.350", (999.96, 4): "1000", (123456.7, 4): "123500"}
    texts |= {(0.0, 4): "0", (-0.0123456, 2): "-0.012", (1.5e9, 3): "1.50e+09", (2.5e-16, 2): "2.5e-16"}
    texts |= {(math.nan, 4): "-", (math.inf, 4): "-"}
    assert {given: significant(*given) for given in texts} == texts


def test_a_value_stops_at_the_second_digit_of_its_standard_deviation():
    shown = {(67.3279, 0.8609): ("67.33", "0.86"), (136.6, 12.2): ("137", "12")}
    shown |= {(0.34998, 0.0216): ("0.350", "0.022"), (5.2, 0.0996): ("5.20", "0.10")}
    shown |= {(5.2156, 123.0): ("5.216", "120"), (5.2156, math.nan): ("5.216", "-")}
    shown |= {(5.2156, 0.0): ("5.216", "-"), (0.25, 1e-9): ("0.250000", "1.0e-09")}
    assert {given: with_spread(*given) for given in shown} == shown


def test_decimals_are_those_written_no_minus_stands_before_zero_and_small_is_small():
    assert [decimals_of(f) for f in ([102.0, 311.0], [156.7, 232.25, 300.0], [1 / 3])] == [0, 2, 6]
    assert (fixed(-0.004, 2), fixed(-0.006, 2)) == ("0.00", "-0.01")
    shown = ["1", "0.123", "3e-12", "< 1e-12", "< 1e-12"]  # no computation can tell these from zero
    assert [probable(p) for p in (1.0, 0.12345, 3e-12, 2.85e-51, 0.0)] == shown


def test_a_name_becomes_a_file_name_that_every_system_takes():
    stems = {"D&G": "D&G", "plate 7": "plate_7", "a/b": "a_b", "../../etc": "etc", "...": "plate"}
    stems |= {"a\\b:c*d?": "a_b_c_d", "Platte größer": "Platte_größer", "x" * 300: "x" * 80}
    assert {name: file_stem(name) for name in stems} == stems
