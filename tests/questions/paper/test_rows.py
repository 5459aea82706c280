"""Verdicts on printed values, from computed ones that are made up."""

from typing import Any

import pytest

from cpam_bayes.printed.tables import PrintedValue, identified_layups, printed_table
from cpam_bayes.questions.paper.rows import (
    AGREES,
    BUILT_IN,
    FOUR,
    INPUT,
    NOT_REPRODUCIBLE,
    TWO,
    WITHIN,
    Row,
    _of_constant,
    constant_rows,
    disagreements,
    frequency_rows,
    in_credible_set,
    input_rows,
    layup_rows,
)
from cpam_bayes.questions.paper.work import packaged

NO_BRICKS: dict[str, Any] = {"frequencies_hz": {}}


def marginal(value: float, q025: float, q975: float) -> dict[str, Any]:
    return {"value": value, "mean": value, "sd": 1.0, "q025": q025, "q975": q975, "bound": None}


def of(rows: list[Row], quantity: str, source: str = "CPAM") -> Row:
    (row,) = (row for row in rows if row.quantity == quantity and row.source == source)
    return row


@pytest.mark.parametrize("number", [2, 3, 4])
def test_tables_2_to_4_are_inputs(number: int) -> None:
    rows = list(input_rows(printed_table(number)))
    assert len(rows) == sum(len(row.values) for row in printed_table(number).rows)
    assert {row.verdict for row in rows} == {INPUT}
    assert {row.ours for row in rows} == {None}


def test_a_frequency_agrees_to_half_a_per_cent_or_half_a_digit_and_a_misprint_never_does() -> None:
    results = {"ritz_hz": [1661.0 * 1.004, 3478.0 * 1.006, *[4000.0] * 8], "fem_hz": None}
    table = printed_table(5)
    rows = list(frequency_rows(table, {("forward", "D1", BUILT_IN): results}, NO_BRICKS))
    found = [row.verdict for row in rows]
    assert found[:2] == [AGREES, NOT_REPRODUCIBLE]
    assert (rows[8].verdict, rows[8].reason[:18]) == (NOT_REPRODUCIBLE, "A digit is missing")
    assert rows[0].difference_percent == pytest.approx(100.0 * (1.0 / 1.004 - 1.0))


def test_the_rounding_of_a_low_frequency_is_no_disagreement() -> None:
    # 40 Hz is printed without decimals: 40.4 Hz is 1 % off and rounds to it
    results = {"ritz_hz": [40.4, *[90.0] * 5], "fem_hz": [40.4, *[90.0] * 5]}
    row = next(frequency_rows(printed_table(5), {("forward", "A2", BUILT_IN): results}, NO_BRICKS))
    assert row.verdict == AGREES


def test_a_constant_agrees_is_in_the_interval_or_is_not_reproducible_with_the_misfits() -> None:
    results = {
        "constants": {
            "E1_GPa": marginal(126.0, 120.0, 130.0),
            "E2_GPa": marginal(12.0, 9.0, 15.0),
            "nu12": marginal(0.3, 0.29, 0.31),
            "G12_GPa": marginal(6.58, 6.0, 7.0),
        },
        "rms_percent": 1.0,
        "printed": [{"source": s, "rms_percent": 2.5} for s in ("CPAM", "Hwang and Chang [8]")],
    }
    rows = list(constant_rows(printed_table(9), {("constants", "C1", BUILT_IN): results}))
    assert of(rows, "E1_GPa").verdict == AGREES
    assert of(rows, "E2_GPa").verdict == WITHIN
    assert of(rows, "nu12").verdict == NOT_REPRODUCIBLE
    assert "rms misfit is 2.5 %, with ours 1 %" in of(rows, "nu12").reason
    assert of(rows, "E2_GPa").q975 == 15.0
    assert len(rows) == 8


@pytest.mark.parametrize(("end", "verdict"), [(0.3149, NOT_REPRODUCIBLE), (0.3151, WITHIN)])
def test_half_a_unit_of_the_last_printed_digit_belongs_to_the_print(end: float, verdict: str) -> None:
    # 0.315 to 0.325 is printed as 0.32
    assert _of_constant(PrintedValue("0.32"), marginal(0.30, 0.29, end), "")[0] == verdict
    assert _of_constant(PrintedValue("0.320"), marginal(0.30, 0.29, end), "")[0] == NOT_REPRODUCIBLE


def test_the_misprinted_frequency_that_is_left_out_is_named() -> None:
    table = printed_table(5)
    ours = [float(v.text) * 1.1 for v in table.row("D1", "ABAQUS").values.values()]
    ours[8] = 10500.0
    results = {"ritz_hz": ours, "fem_hz": None}
    rows = list(frequency_rows(table, {("forward", "D1", BUILT_IN): results}, NO_BRICKS))
    (said,) = disagreements(rows, (), ())
    assert "(without the misprinted f9)" in said
    assert "misprinted" not in disagreements(rows[:8], (), ())[0]


def test_rows_of_table_8_are_compared_with_as_many_unknown_constants() -> None:
    constants = {name: marginal(70.0, 60.0, 80.0) for name in ("E1_GPa", "E2_GPa", "nu12", "G12_GPa")}
    sources = ("Hwang and Chang [8]", "CPAM", "Hwang and Chang [8], two constants", "CPAM, two constants")
    four = {
        "constants": constants,
        "rms_percent": 1.0,
        "printed": [{"source": s, "rms_percent": 1.0} for s in sources],
    }
    two = {**four, "constants": {k: marginal(0.34, 0.3, 0.4) for k in ("E1_GPa", "nu12")}}
    found = {("constants", "A1", FOUR): four, ("constants", "A1", TWO): two}
    rows = list(constant_rows(printed_table(8), found))
    assert {row.ours for row in rows if row.source.endswith("two constants")} == {0.34}
    assert {row.ours for row in rows if not row.source.endswith("two constants")} == {70.0}


def test_a_best_fit_outside_its_own_interval_says_why() -> None:
    inside, outside = marginal(126.5, 120.0, 130.0), marginal(126.5, 127.0, 130.0)
    said = []
    for ours in (inside, outside, {**outside, "bound": "lower"}):
        results = {
            "constants": {"E1_GPa": ours},
            "rms_percent": 1.0,
            "printed": [{"source": s, "rms_percent": 2.5} for s in ("CPAM", "Hwang and Chang [8]")],
        }
        rows = list(constant_rows(printed_table(9), {("constants", "C1", BUILT_IN): results}))
        said.append(of(rows, "E1_GPa"))
    assert [row.verdict for row in said] == [AGREES] * 3
    assert [bool(row.reason) for row in said] == [False, True, True]
    assert said[1].reason != said[2].reason


@pytest.mark.parametrize(
    ("probability", "count", "rank", "inside"),
    [(0.2, 10, None, True), (1e-9, 10, None, False), (0.01, 10, None, None), (0.01, 10, 3, True)],
)
def test_a_sequence_is_in_the_set_by_what_is_certain(
    probability: float, count: int, rank: int | None, inside: bool | None
) -> None:
    assert in_credible_set(probability, count, 1010, rank) is inside


def test_table_9b_has_a_row_for_every_printed_stacking_sequence() -> None:
    rows = list(layup_rows(printed_table(9), packaged("sequences")))
    assert [row.specimen for row in rows] == list(identified_layups())
    assert all(isinstance(row.ours, tuple) for row in rows)
    assert {row.verdict for row in rows} <= {WITHIN, NOT_REPRODUCIBLE}
