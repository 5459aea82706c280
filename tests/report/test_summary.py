"""A summary is shown as slips, headline, constants, basis, warnings and next steps, in this order."""

from __future__ import annotations

import math

import pytest

from cpam_bayes.report.summary import (
    ConstantLine,
    Determined,
    Summary,
    determined_by,
    sentence,
    summary_tables,
)
from cpam_bayes.report.tables import plain_text


def line(
    symbol: str, determined: Determined, interval: tuple[float, float] | None = (60.0, 70.0)
) -> ConstantLine:
    return ConstantLine(
        symbol=symbol,
        title="Young's modulus",
        key=f"{symbol}_GPa",
        value=65.0,
        interval=interval,
        unit="GPa",
        reference=math.nan,
        determined=determined,
        by="its bounds 10 to 200 GPa",
    )


def test_the_parts_stand_in_the_order_in_which_they_matter() -> None:
    shown = summary_tables(
        Summary(
            title="identify plate 7",
            slips=("frequencies in kHz for Hz",),
            headline="The answer.",
            constants=(line("E1", "yes"), line("E2", "no")),
            basis=("Six frequencies.",),
            warnings=("a warning",),
            next_steps=("Weigh the plate.",),
        )
    )
    text = "\n".join(plain_text(table) for table in shown if table.rows)
    order = [
        "Frequencies in kHz for Hz.",
        "The answer.",
        "E1",
        "Six frequencies.",
        "A warning.",
        "Weigh the plate.",
    ]
    places = [text.index(part) for part in order]
    assert places == sorted(places)
    assert "yes, to +-7.7 %" in text
    assert "no, by its bounds 10 to 200 GPa" in text


@pytest.mark.parametrize(
    ("constants", "said"),
    [
        ((line("E1", "yes"),), "The 6 frequencies determine the constant: E1."),
        ((line("E1", "yes"), line("E2", "yes")), "The 6 frequencies determine both constants: E1 and E2."),
        ((line("E1", "partly"),), "The 6 frequencies determine none of the constants alone."),
        (
            (line("E1", "yes"), line("E2", "no"), line("G12", "no")),
            "The 6 frequencies determine 1 of 3 constants: E1. Do not use E2 and G12: the values come from "
            "bounds or priors, not from the plate.",
        ),
    ],
)
def test_the_headline_says_which_constants_to_use(constants: tuple[ConstantLine, ...], said: str) -> None:
    assert determined_by(constants, 6) == said


def test_a_constant_without_an_interval_says_so() -> None:
    assert line("E1", "no", None).interval_text == "not known"
    assert line("E1", "yes", None).determined_text == "yes"


def test_a_warning_becomes_a_sentence_unless_it_begins_with_a_key() -> None:
    assert sentence("the sensor weighs 5 g") == "The sensor weighs 5 g."
    assert sentence("nu12 and others") == "nu12 and others."
    assert sentence("[plate.sd] is missing") == "[plate.sd] is missing."
