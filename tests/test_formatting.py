"""Numbers are written with the digits they are worth."""

import math

import pytest

from cpam_bayes.formatting import decimals_of, file_stem, fixed, probable, significant, with_spread


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (67.3279, 4, "67.33"),
        (0.35, 3, "0.350"),
        (999.96, 4, "1000"),
        (123456.7, 4, "123500"),
        (0.0, 4, "0"),
        (-0.0123456, 2, "-0.012"),
        (1.5e9, 3, "1.50e+09"),
        (2.5e-16, 2, "2.5e-16"),
        (math.nan, 4, "-"),
        (math.inf, 4, "-"),
    ],
)
def test_a_number_has_its_significant_digits(value, digits, text):
    assert significant(value, digits) == text


@pytest.mark.parametrize(
    ("value", "sd", "shown"),
    [
        (67.3279, 0.8609, ("67.33", "0.86")),
        (136.6, 12.2, ("137", "12")),
        (0.34998, 0.0216, ("0.350", "0.022")),
        (5.2, 0.0996, ("5.20", "0.10")),
        (5.2156, 123.0, ("5.216", "120")),
        (5.2156, math.nan, ("5.216", "-")),
        (5.2156, 0.0, ("5.216", "-")),
        (0.25, 1e-9, ("0.250000", "1.0e-09")),
    ],
)
def test_a_value_stops_at_the_second_digit_of_its_standard_deviation(value, sd, shown):
    assert with_spread(value, sd) == shown


def test_a_list_has_the_decimals_it_was_written_with_and_no_minus_before_zero():
    assert [decimals_of(f) for f in ([102.0, 311.0], [156.7, 232.25, 300.0], [1 / 3])] == [0, 2, 6]
    assert (fixed(-0.004, 2), fixed(-0.006, 2)) == ("0.00", "-0.01")


@pytest.mark.parametrize(
    ("name", "stem"),
    [
        ("D&G", "D&G"),
        ("plate 7", "plate_7"),
        ("a/b", "a_b"),
        ("../../etc", "etc"),
        ("a\\b:c*d?", "a_b_c_d"),
        ("...", "plate"),
        ("Platte größer", "Platte_größer"),
        ("x" * 300, "x" * 80),
    ],
)
def test_a_name_becomes_a_file_name_that_every_system_takes(name: str, stem: str) -> None:
    assert file_stem(name) == stem


@pytest.mark.parametrize(
    ("p", "text"), [(1.0, "1"), (0.12345, "0.123"), (3e-12, "3e-12"), (2.85e-51, "< 1e-12"), (0.0, "< 1e-12")]
)
def test_a_probability_that_no_computation_tells_from_zero_is_small(p, text):
    assert probable(p) == text
