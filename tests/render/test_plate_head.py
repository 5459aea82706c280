"""The head of a page: a plate in words."""

import re
from datetime import date

import pytest

import cpam_bayes as cb
from cpam_bayes.plate import builtin
from cpam_bayes.render.plate import edges_text, plate_head
from cpam_bayes.render.report import plate_keys
from cpam_bayes.render.terminal import plain_text
from tests.plate_file import described


@pytest.mark.parametrize(
    ("edges", "text"),
    [
        ("FFFF", "free on all four edges"),
        ("CFFF", "clamped at x = 0; free at y = 0, x = length and y = width"),
        ("SCSF", "simply supported at x = 0 and x = length; clamped at y = 0; free at y = width"),
    ],
)
def test_edges_are_said_in_words(edges, text):
    assert edges_text(edges) == text


def test_the_head_has_the_slips_of_print_of_a_specimen():
    text = plain_text(plate_head(builtin("C1"), None))
    assert "layup     [(0/90)_8]_s, 32 plies" in text
    assert re.search(r"note +Table 2 prints this layup as", text)


def test_laboratory_operator_date_and_specimen_are_printed() -> None:
    given = described((200, 100, 3), 2700, {"isotropic": True, "E1_GPa": 69, "nu12": 0.33})
    plate = cb.read_plate(
        {**given, "specimen": "s7", "laboratory": "Hall 3", "operator": "A. Weber", "date": date(2026, 3, 5)}
    )
    head = [("specimen", "s7"), ("laboratory", "Hall 3"), ("operator", "A. Weber"), ("date", "2026-03-05")]
    assert list(plate_head(plate, None).rows[:4]) == head
    assert plate_keys("forward", 0, plate)["date"] == "2026-03-05"
    assert "laboratory" not in plate_keys("forward", 0, cb.read_plate(given))
