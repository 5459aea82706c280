"""Table 9 as data."""

from __future__ import annotations

import pytest

from cpam_bayes.paper.layups import identified_layups
from cpam_bayes.plate import builtin, user_name

CASES = ("B1", "B2", "C1", "C2", "C3", "C4", "D1", "D2", "D3", "D4", "F1", "F2", "G1", "G2")


def test_table_9_has_all_its_cases() -> None:
    assert tuple(identified_layups()) == CASES


@pytest.mark.parametrize("name", CASES)
def test_a_case_has_the_unknown_plies_and_constants_of_its_specimen(name: str) -> None:
    found = identified_layups()[name]
    specimen = builtin(name, sequence=True)
    assert found.specimen == name
    assert len(found.angles_deg) == specimen.plate.layup.n_unknown
    constants = [] if name[0] in "FG" else [user_name(n) for n in specimen.unknowns.names]
    assert list(found.constants) == constants


@pytest.mark.parametrize("name", CASES)
def test_printed_sequences_are_those_of_the_plates_but_for_one_ply_of_f1_and_f2(name: str) -> None:
    found = identified_layups()[name].angles_deg
    true = builtin(name).plate.layup.angles_deg[: len(found)].tolist()
    wrong = {i: a for i, (a, b) in enumerate(zip(found, true, strict=True)) if a != b}
    assert wrong == {"F1": {5: 85}, "F2": {4: 50}}.get(name, {})
