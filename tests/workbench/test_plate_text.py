"""Edits of a plate file as a text: the value changes, everything else stays."""

import tomllib
from pathlib import Path

import pytest

from cpam_bayes.workbench.plate_text import (
    FIELDS,
    numbers_in,
    with_block,
    with_file,
    with_sensors,
    with_value,
)

PANEL = (Path(__file__).parents[2] / "examples" / "panel.toml").read_text("utf-8")


def without(data: dict, key: str) -> dict:
    table, _, name = key.rpartition(".")
    inner = {k: v for k, v in (data[table] if table else data).items() if k != name}
    return {**data, table: inner} if table else inner


@pytest.mark.parametrize("key", [key for key in FIELDS if not key.startswith("environment")])
def test_a_field_changes_its_own_value_and_no_other(key: str) -> None:
    before = tomllib.loads(PANEL)
    after = tomllib.loads(with_value(PANEL, key, "17"))
    assert without(after, key) == without(before, key)
    table, _, name = key.rpartition(".")
    assert (after[table] if table else after)[name] in (17, [17], "17")


def test_a_table_that_is_not_there_is_made_and_an_empty_field_takes_its_key_away() -> None:
    with_air = with_value(PANEL, "environment.air_density_kg_m3", "1.19")
    assert tomllib.loads(with_air)["environment"] == {"air_density_kg_m3": 1.19}
    assert (
        "relative_std" not in tomllib.loads(with_value(PANEL, "measurement.relative_std", ""))["measurement"]
    )


def test_a_list_over_several_lines_is_replaced_whole() -> None:
    text = "[measurement]\nfrequencies_hz = [\n  80.2, # first\n  146.3,\n]\nrelative_std = 0.01\n"
    after = tomllib.loads(with_value(text, "measurement.frequencies_hz", "90 91"))
    assert after == {"measurement": {"frequencies_hz": [90, 91], "relative_std": 0.01}}


@pytest.mark.parametrize(
    ("typed", "read"),
    [
        ("102, 311; 342", ["102", "311", "342"]),
        ("102,5 311,2", ["102,5", "311,2"]),
        ("102.5,311.2,342.1", ["102.5", "311.2", "342.1"]),
        ("102\n311\r\n342\n", ["102", "311", "342"]),
        ("1\t102.5\n", ["1", "102.5"]),
    ],
)
def test_pasted_lists_are_read_however_they_are_parted(typed: str, read: list[str]) -> None:
    assert numbers_in(typed) == read


@pytest.mark.parametrize(
    ("typed", "read"),
    [
        *((typed, typed) for typed in ("abc", "1e", "--2", "0x10", '"', "nan", "1 2", "[", "é")),
        *(("007", 7.0), (".5", 0.5), ("5.", 5.0), ("+3", 3.0), ("1e3", 1000.0), ("3,1", 3.1)),
    ],
)
def test_a_number_as_people_type_it_is_that_number_and_else_kept_as_words(typed: str, read: object) -> None:
    text = with_value(PANEL, "plate.length_mm", typed)
    assert tomllib.loads(text)["plate"]["length_mm"] == read
    pairs = zip(PANEL.split("\n"), text.split("\n"), strict=True)
    # comments and order stay
    assert [old.split("#")[1:] == new.split("#")[1:] for old, new in pairs if old != new] == [True]


def test_masses_and_the_material_are_replaced_as_a_whole() -> None:
    one = with_sensors(PANEL, [{"mass_g": "1.2", "x_mm": "3", "y_mm": "4"}])
    assert tomllib.loads(one)["sensor"] == [{"mass_g": 1.2, "x_mm": 3, "y_mm": 4}]
    assert tomllib.loads(with_sensors(one, [])) == tomllib.loads(PANEL)
    other = tomllib.loads(with_block(PANEL, "material", ["E1_GPa = 70.0"]))
    assert other["material"].pop("E1_GPa") == 70.0
    assert without(other, "material") == without(tomllib.loads(PANEL), "material")


@pytest.mark.parametrize("source", ['recordings = ["hits"]\nrange_hz = [20.0, 900.0]', 'peaks = "peaks.csv"'])
def test_a_file_that_is_dropped_takes_the_place_of_whatever_the_list_was(source: str) -> None:
    text = f"[measurement]\n{source}\nleft_out = [2]\nrelative_std = 0.002\n"
    measured = tomllib.loads(with_file(text, "table", "modes.csv"))["measurement"]
    assert measured == {"table": "modes.csv", "relative_std": 0.002}
