"""A reader who has only the page answers ten questions right: its words hold the numbers of the document."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from html import unescape
from pathlib import Path
from typing import Any

import pytest

import cpam_bayes as cb
from cpam_bayes import __version__
from cpam_bayes.combined import FullReport
from cpam_bayes.diagnosis import cases, plates
from cpam_bayes.diagnosis.answers.detectability import Detectable
from cpam_bayes.effects import CATALOGUE
from cpam_bayes.identification.verdicts import BY_DATA
from cpam_bayes.plate import builtin
from cpam_bayes.report.combined.questions import questions
from tests.plate_file import MEASURED, PLATE

PROJECT = Path(__file__).parents[3]
CHEAP = {"none", "other", "viscoelastic", "frequency_scale"}


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Iterator[FullReport]:
    """A quick report of an aluminium plate, with causes that need no further plate model."""
    path = tmp_path_factory.mktemp("plate") / "plate.toml"
    path.write_text(PLATE + MEASURED, encoding="utf-8")

    def few(*args: Any) -> list[Any]:
        return [(h, at) for h, at in cases.hypotheses_of(*args) if h.cause in CHEAP]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plates, "hypotheses_of", few)
        yield cb.full_report(path, seed=3, quick=True)


def answers(report: FullReport) -> dict[str, str]:
    """Question -> answer."""
    return dict(questions(report, report.in_words()).rows)


def with_diagnosis(report: FullReport, **changes: Any) -> FullReport:
    diagnosis = replace(report.diagnosis, diagnosis=replace(report.diagnosis.diagnosis, **changes))
    return replace(report, diagnosis=diagnosis)


def numbers(text: str, name: str) -> list[float]:
    """The numbers that follow the name of a constant."""
    (found,) = re.findall(rf"{name} (?:=|in) (\d+\.?\d*)(?: to (\d+\.?\d*))?", text)
    return [float(number) for number in found if number]


def test_the_page_holds_ten_questions_with_their_answers(report: FullReport, tmp_path: Path) -> None:
    report.save(tmp_path)
    page = unescape((tmp_path / "report.html").read_text("utf-8")).replace("±", "+-")
    asked = answers(report)
    assert len(asked) == 10
    for question, answer in asked.items():
        assert f">{question}<" in page
        assert f">{answer}<" in page


def test_the_tutorial_says_where_the_page_has_each_answer(report: FullReport) -> None:
    tutorial = (PROJECT / "docs" / "tutorial.md").read_text("utf-8")
    table = tutorial.partition("| question | where the page says it |")[2].partition("\n\n")[0]
    assert re.findall(r"^\| ([^|]+\?) \|", table, re.MULTILINE) == list(answers(report))


def test_the_answers_are_the_numbers_of_the_document(report: FullReport) -> None:
    asked, document = answers(report), report.to_dict()
    diagnosis = document["diagnosis"]
    constants = (diagnosis["extended"] or {"constants": diagnosis["averaged"]})["constants"]
    for key, row in constants.items():
        name, digits = key.split("_")[0], 0.06 * row["sd"]
        assert numbers(asked["What are the constants?"], name) == pytest.approx([row["mean"]], abs=digits)
        interval = [row["q025"], row["q975"]]
        assert numbers(asked["How sure are they?"], name) == pytest.approx(interval, abs=digits)
    open_ones = asked["Which are not determined by these frequencies?"]
    for key, row in constants.items():
        by_data = row["prior_contraction"] >= BY_DATA
        assert (key.split("_")[0] in open_ones.partition("Determined:")[2]) == by_data
    assert asked["What is wrong with the plate model?"] == diagnosis["sentence"]
    worst = max(diagnosis["baseline"]["frequencies"], key=lambda row: abs(row["residual_percent"]))
    said = asked["Which modes fit worst?"].partition(";")[0]
    assert f"measured {worst['measured_hz']:.6g} Hz" in said
    assert f"{abs(worst['residual_percent']):.2g} % too" in said
    assert ("too high" in said) == (worst["residual_percent"] > 0)
    assert "assume a noise of" in asked["Which noise do the intervals assume?"]
    assert asked["What should be done next?"] == report.in_words().next_steps[0]
    repeats = asked["Which version and seed repeat this page?"]
    assert __version__ in repeats
    assert f"cpam-bayes report {report.specimen.source} --seed 3" in repeats


def test_what_an_accelerometer_would_have_done_is_said_whatever_was_found(report: FullReport) -> None:
    question = "Would a forgotten accelerometer have shown?"
    (mass,) = (e.parameters[0] for e in CATALOGUE if e.name == "sensor_mass")
    assert answers(report)[question].startswith("Not asked")
    seen = with_diagnosis(report, detectable=(Detectable("sensor_mass", mass, 0.0068, 0.95),))
    # 0.3 m x 0.28 m x 3 mm of 2700 kg/m3 are 680 g
    assert answers(seen)[question] == (
        "From 6.8 g on, with 95 % probability, which is 1.0 % of the plate's mass; a lighter one may be "
        "there unseen."
    )
    unseen = with_diagnosis(report, detectable=(Detectable("sensor_mass", mass, None, 0.4),))
    assert answers(unseen)[question].startswith("No: these frequencies need not show an added mass")


def test_ply_angles_are_said_to_be_given_or_found(report: FullReport) -> None:
    question = "Are the ply angles determined?"
    assert answers(report)[question] == "There are none: the material is isotropic."
    given = replace(report, specimen=builtin("C1"))
    assert "the layup [(0/90)_8]_s, 32 plies, is taken from the plate file" in answers(given)[question]
    open_angles = replace(report, specimen=builtin("C1").with_unknown_angles())
    assert "`cpam-bayes sequence` gives each layup its probability" in answers(open_angles)[question]
