"""Verdicts on printed values, from computed ones that are made up."""

from typing import Any

import numpy as np
import pytest

from cpam_bayes.printed.tables import PrintedValue, identified_layups, printed_table
from cpam_bayes.questions.paper.noise import MeansOfTen, NoisyAngles, noise_rows, noisy_angles
from cpam_bayes.questions.paper.rows import (
    AGREES,
    BUILT_IN,
    FOUR,
    INPUT,
    NOT_COMPUTED,
    NOT_REPRODUCIBLE,
    TWO,
    UNTOLD,
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
    (said,) = disagreements(rows, ())
    assert "(without the misprinted f9)" in said
    assert "misprinted" not in disagreements(rows[:8], ())[0]


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


def noise_results(mean: float, sd: float, on_bound: float = 0.0) -> dict[str, Any]:
    cell = {
        "repetition_mean": mean,
        "repetition_sd": sd,
        "on_bound": on_bound,
        "posterior_mean": mean,
        "q025": mean - 10.0,
        "q975": mean + 10.0,
    }
    levels = [{"level_percent": p, "constants": {"E1_GPa": cell, "nu12": cell}} for p in (1, 5, 10)]
    return {"groups": 10, "without_noise": {"E1_GPa": 68.0, "nu12": 0.3}, "levels": levels}


@pytest.mark.parametrize(
    ("mean", "sd", "on_bound", "verdict"),
    [
        (68.0, 2.0, 0.4, AGREES),
        (68.0, 0.1, 0.0, WITHIN),
        (50.0, 0.1, 0.0, NOT_REPRODUCIBLE),
        # within two standard errors of 27 %, and 38 % apart: not agreement
        (50.0, 30.0, 0.0, UNTOLD),
        # half of the ten on a bound: no standard error, however small or large their scatter
        (68.0, 2.0, 0.5, WITHIN),
        (50.0, 30.0, 0.5, NOT_REPRODUCIBLE),
    ],
)
def test_means_of_ten_agree_within_two_standard_errors_and_five_per_cent(
    mean: float, sd: float, on_bound: float, verdict: str
) -> None:
    found = {("noise", "A2", BUILT_IN): noise_results(mean, sd, on_bound)}
    rows = list(noise_rows(printed_table(10), found, packaged("sequences")))
    row = of(rows, "E1_GPa", "1 % disorder")  # printed 69.2
    assert row.verdict == verdict
    away = None if on_bound >= 0.5 else pytest.approx(abs(69.2 - mean) / (sd * 0.2**0.5))
    assert row.details["standard_errors"] == away
    assert row.details["printed_percent"] == -1.7


def test_a_mean_outside_its_own_interval_says_why() -> None:
    results = noise_results(60.0, 2.0)
    for level in results["levels"]:
        level["constants"]["E1_GPa"] = {**level["constants"]["E1_GPa"], "q025": 61.0}
    rows = list(noise_rows(printed_table(10), {("noise", "A2", BUILT_IN): results}, packaged("sequences")))
    said = [of(rows, quantity, "1 % disorder").reason for quantity in ("E1_GPa", "nu12")]
    assert ["ours lies outside its own interval" in reason for reason in said] == [True, False]


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


def test_a_change_below_the_standard_error_of_ten_cannot_be_shown() -> None:
    # printed changes of A2: E1 -1.7 -3.1 -6.4 %, nu12 2.3 7.2 11.9 %
    found = {("noise", "A2", BUILT_IN): noise_results(68.0, 68.0 * 0.03 * 10**0.5)}
    rows = tuple(noise_rows(printed_table(10), found, packaged("sequences")))
    found = MeansOfTen.of(rows)
    assert found == MeansOfTen(changes=6, hidden=2, constants=2, printed_grow=2, ours_grow=0)


def test_angles_are_compared_on_the_nearer_mirror_image_and_as_fibres_without_a_head() -> None:
    # ten ends: six at the printed sequence, two at its mirror image, two with one ply 10 degrees further
    ends = [[5, 90, 0, -85]] * 6 + [[-5, 90, 0, 85]] * 2 + [[5, 90, 0, 85]] * 2
    found = NoisyAngles.of(11, "1 % disorder", (5, 90, 0, -85), {"angles_deg": ends})
    assert (found.found, found.distinct, found.groups) == (8, 2, 10)
    # -85 and 85 are 10 degrees apart, not 170
    assert found.means_deg == pytest.approx((5.0, 90.0, 0.0, -87.0))
    assert found.verdict[0] == AGREES
    # eight at -85, two at 85: mean resultant length of the doubled angles
    length = abs(0.8 + 0.2 * np.exp(2j * np.radians(10.0)))
    assert found.spread_deg[3] == pytest.approx(0.5 * np.degrees(np.sqrt(-2.0 * np.log(length))))
    assert found.spread_deg[:3] == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)
    other = NoisyAngles.of(11, "1 % disorder", (40, 90, 0, -85), {"angles_deg": ends})
    assert (other.found, other.verdict[0]) == (0, NOT_REPRODUCIBLE)


CONSTANTS = ("E1_GPa", "E2_GPa", "nu12", "G12_GPa")


def noise_of_all_constants() -> dict[str, Any]:
    """Repetitions of Table 11 in which all constants are as E1."""
    known = noise_results(127.6, 1.0)
    cell = known["levels"][0]["constants"]["E1_GPa"]
    for level in known["levels"]:
        level["constants"] = dict.fromkeys(CONSTANTS, cell)
    known["without_noise"] = dict.fromkeys(CONSTANTS, 126.0)
    return known


def test_the_search_of_angles_with_the_constants_is_the_repetition_that_is_compared() -> None:
    known = noise_of_all_constants()
    cell = known["levels"][0]["constants"]["E1_GPa"]
    together = {
        **known,
        "levels": [
            {
                "angles_deg": [[5, 90, 0, 90]] * 10,
                "constants": {n: {**cell, "repetition_mean": 100.0} for n in CONSTANTS},
            }
        ]
        * 3,
    }
    computed = {("noise", "C1", BUILT_IN): known, ("angles", "C1", BUILT_IN): together}
    rows = list(noise_rows(printed_table(11), computed, packaged("sequences")))
    assert of(rows, "E1_GPa", "1 % disorder").ours == 100.0
    angles = of(rows, "angles_deg", "1 % disorder")
    assert (angles.verdict, angles.ours) == (AGREES, pytest.approx((5.0, 90.0, 0.0, 90.0)))
    alone = list(noise_rows(printed_table(11), {("noise", "C1", BUILT_IN): known}, packaged("sequences")))
    assert of(alone, "E1_GPa", "1 % disorder").verdict == AGREES
    left_out = of(alone, "angles_deg", "1 % disorder")
    assert (left_out.ours, left_out.verdict) == (None, NOT_COMPUTED)


@pytest.mark.parametrize(("bits", "less"), [([1.5, 0.9, 0.4, 0.1], 3), ([0.1, 0.9, 0.4, 1.5], 0)])
def test_what_one_list_tells_of_the_angles_stands_beside_the_inversions(bits: list[float], less: int) -> None:
    known = noise_of_all_constants()
    ends = [[5, 90, 0, 90]] * 9 + [[5, 90, 0, 85]]
    together = {**known, "levels": [{**level, "angles_deg": ends} for level in known["levels"]]}
    weighed = {
        "bits": bits,
        "most_bits": 5.17,
        "true_probability": 0.2,
        "printed_probability": 0.01,
        "credible_95_count": 30,
        "constants": {key: {"mean": 127.0, "sd": 1.0, "q025": 125.0, "q975": 129.0} for key in CONSTANTS},
    }
    computed = {
        ("noise", "C1", BUILT_IN): known,
        ("angles", "C1", BUILT_IN): together,
        ("layups", "C1", BUILT_IN): {"levels": [weighed] * 3},
    }
    rows = list(noise_rows(printed_table(11), computed, packaged("sequences")))
    angles = of(rows, "angles_deg", "1 % disorder").details
    assert [angles[f"bits_{i}"] for i in (1, 2, 3, 4)] == bits
    assert (angles["true_probability"], angles["printed_probability"]) == (0.2, 0.01)
    constant = of(rows, "E1_GPa", "1 % disorder").details
    assert (constant["layups_mean"], constant["layups_q975"]) == (127.0, 129.0)
    said = noisy_angles(rows)
    assert f"less of the innermost in {less})" in said
    # of 127.6, 129.5 and 132.65 GPa one lies within, of the other constants none
    assert "1 of 12 printed constants" in said
    # the innermost scatters, the others do not
    assert ("holds by the bits and by" in said) == (less == 3)
    assert "bits" not in noisy_angles([row for row in rows if "bits_1" not in row.details])
