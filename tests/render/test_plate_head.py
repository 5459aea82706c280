"""The head of a page: a plate in words."""

import re

import pytest

from cpam_bayes.plate import builtin
from cpam_bayes.render.plate import edges_text, plate_head
from cpam_bayes.render.terminal import plain_text


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
