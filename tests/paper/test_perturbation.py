"""Tables 10 to 14 as data."""

from __future__ import annotations

from dataclasses import replace

import pytest

from cpam_bayes.paper import PrintedConstant, contradictions, perturbation_table
from cpam_bayes.plate import builtin, user_name

SPECIMENS = ("A2", "C1", "C3", "D1", "D3")


@pytest.mark.parametrize("name", SPECIMENS)
def test_a_table_has_the_unknowns_of_its_specimen_at_three_levels(name: str) -> None:
    table = perturbation_table(name)
    assert table is not None
    assert table.specimen == name
    assert table.levels_percent == (1.0, 5.0, 10.0)
    assert [row.key for row in table.constants] == [user_name(n) for n in builtin(name).unknowns.names]
    for row in table.constants:
        assert len(row.amount) == len(row.percent_error) == 3
    unknown_plies = builtin(name, sequence=True).plate.layup.n_unknown
    assert {len(angles) for angles in table.angles_deg} == ({unknown_plies} if unknown_plies else set())


def test_tables_are_numbered_as_in_the_paper() -> None:
    found = [perturbation_table(name) for name in SPECIMENS]
    assert [t.number for t in found if t is not None] == [10, 11, 12, 13, 14]


def test_there_is_no_table_for_other_plates() -> None:
    assert perturbation_table("B1") is None


def test_a_percentage_is_found_by_constant_and_level() -> None:
    table = perturbation_table("C1")
    assert table is not None
    assert table.percent_error("G12_GPa", 10.0) == -10.63
    assert table.percent_error("G12_GPa", 2.0) is None
    assert table.percent_error("G23_GPa", 10.0) is None


def test_one_printed_percentage_does_not_follow_from_its_row() -> None:
    found = [c for name in SPECIMENS if (t := perturbation_table(name)) for c in contradictions(t)]
    # 10.4 / 9.86 - 1 is 5.5 %, and 4.9 to 6.1 % before both were rounded
    assert [(c.table, c.key, c.level_percent, c.printed) for c in found] == [(13, "E2_GPa", 10.0, "7.41")]
    assert found[0].lowest == pytest.approx(100 * (10.35 / 9.865 - 1))
    assert found[0].highest == pytest.approx(100 * (10.45 / 9.855 - 1))


@pytest.mark.parametrize(
    ("printed", "possible"), [("85.6", False), ("85.7", True), ("115.8", True), ("115.9", False)]
)
def test_a_contradiction_begins_one_printed_digit_beyond_rounding(printed: str, possible: bool) -> None:
    table = perturbation_table("C1")
    assert table is not None
    # 2.0 over 1.0, each half a digit off: 1.95 / 1.05 - 1 to 2.05 / 0.95 - 1, so 85.71 to 115.79 %
    row = PrintedConstant("nu12", "1.0", ("2.0",), (printed,))
    assert (contradictions(replace(table, levels_percent=(1.0,), constants=(row,))) == ()) is possible
