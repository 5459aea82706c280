"""The table of edge conditions, which plate files, models, decks and drawings read."""

import re
from itertools import product
from pathlib import Path

import pytest

import cpam_bayes
from cpam_bayes.mechanics.problem import rigid_body_count
from cpam_bayes.plate.edges import CONDITIONS, FIELDS, STATED, conditions, is_stated, yielding


def test_conditions_stand_in_the_order_of_the_letters_and_hold_nothing_that_is_sprung() -> None:
    names = [condition.name for condition in conditions("CFSF")]
    assert names == ["clamped", "free", "simply supported", "free"]
    assert [condition.is_free for condition in conditions("CFSF")] == [False, True, False, True]
    for condition in CONDITIONS.values():
        for held in (condition.held_x, condition.held_y):
            assert set(held) <= set(FIELDS)
            assert not set(held) & set(condition.sprung)


def test_only_conditions_with_a_name_are_stated_in_a_plate_file() -> None:
    assert STATED == "FSC"
    assert all(is_stated("".join(edges)) for edges in product(STATED, repeat=4))
    assert not any(is_stated(text) for text in ("", "FFF", "FFFFF", "ffff", "FFFR"))


def test_a_clamp_gives_way_once_in_each_way() -> None:
    turning, moving = ("phi_x", "phi_y"), ("u", "v", "w")
    softer = yielding("C", turning)
    assert softer is not None
    assert CONDITIONS[softer].sprung == turning
    assert yielding(softer, turning) is None
    assert yielding(softer, moving) == yielding("C", FIELDS)
    assert yielding("F", turning) is None


@pytest.mark.parametrize("letter", [letter for letter, c in CONDITIONS.items() if c.is_clamp])
def test_a_clamp_leaves_no_rigid_motion_even_on_springs(letter: str) -> None:
    assert rigid_body_count(f"{letter}FFF") == 0


def test_no_other_module_decides_by_a_letter() -> None:
    """A new condition is a row of the table: elsewhere its properties are asked for."""
    package = Path(cpam_bayes.__file__).parent
    sources = {path.relative_to(package): path.read_text("utf-8") for path in package.rglob("*.py")}
    # the plates that a diagnosis is tested by are a model of their own
    sources = {path: text for path, text in sources.items() if "validation" not in path.parts}
    decides = re.compile(r"""[=!]= "[FSC]"|"[FSC]+" (not )?in [\w.]*edges|[=!]= "[FSC]{4}\"""")
    assert [str(path) for path, text in sources.items() if decides.search(text)] == []
