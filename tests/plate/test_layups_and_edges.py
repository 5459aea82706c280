"""The notation of layups, and the table of edge conditions, which files, models, decks and drawings read."""

import pickle
import re
from itertools import product
from pathlib import Path

import numpy as np
import pytest

import cpam_bayes
from cpam_bayes.errors import LayupError
from cpam_bayes.mechanics.problem import rigid_body_count
from cpam_bayes.plate.edges import CONDITIONS, FIELDS, STATED, conditions, is_stated, yielding
from cpam_bayes.plate.layup import MAX_PLIES, format_angles, from_angles, parse_layup
from tests.effort import peak_memory

KNOWN = [  # notation, and the angles from bottom to top
    *(("[0_20]", [0] * 20), ("[(0)_002]", [0, 0]), ("[(0/90)_8]_s", [0, 90] * 8 + [90, 0] * 8)),
    ("[45/-45/0_2]_2s", [45, -45, 0, 0] * 2 + [0, 0, -45, 45] * 2),
    ("[(0/(45/-45)_2)_2/90]", [0, 45, -45, 45, -45] * 2 + [90]),
    *(("[\u00b145/0]", [45, -45, 0]), ("[\u221245]_s", [-45, -45]), ("[\u221330]", [-30, 30])),
    *(("[-+30]", [-30, 30]), ("[\u00b130_2]_s", [30, -30, 30, -30, -30, 30, -30, 30])),
    *(("[22.5/-7.25/.5]", [22.5, -7.25, 0.5]), ("[-90/-0]", [90, 0]), ("[0/90]_2T", [0, 90, 0, 90])),
    *(("[0,90]_s", [0, 90, 90, 0]), ("[0 90 90 0]", [0, 90, 90, 0]), ("[45; -45]", [45, -45])),
    *((text, [0, 90, 0, 90, 90, 0, 90, 0]) for text in ("[0/90]2s", "[0\u00b0/90deg]_{2S}")),
    (" [ 0 / 90 _ 2 ] _ 2 s ", [0, 90, 90] * 2 + [90, 90, 0] * 2),
    ("[0 (45 -45)_2]", [0, 45, -45, 45, -45]),
]
UNKNOWN = [  # and the number of the unknown angle of each ply, or -1
    ("[(?/?/?/?)_4]_s", [0, 1, 2, 3] * 4 + [3, 2, 1, 0] * 4),
    ("[(0/?/90/?)_4]_s", [-1, 0, -1, 1] * 4 + [1, -1, 0, -1] * 4),
    *(("[?_4/0/?]", [0, 0, 0, 0, -1, 1]), ("[?/(?/(?)_2)_2]", [0, 1, 2, 2, 1, 2, 2])),
]
MALFORMED = {
    0: ["0/90"],
    1: ["[(0/90", "[\u00b1?]"],
    3: ["[0//90]", "[0/95]", "[0/x]", "[0_0]"],
    4: ["[0/1e1]", "[0]_"],
    5: ["[0]_s2", "[0 90/0]", "[22,5/45]"],
    7: ["[0/90]_{2s"],
}


@pytest.mark.parametrize(("text", "angles"), KNOWN)
def test_known_layups_expand_bottom_to_top(text, angles):
    layup = parse_layup(text)
    assert layup.angles_deg.tolist() == angles
    assert (layup.n_plies, layup.n_unknown, layup.unknown_names) == (len(angles), 0, ())


@pytest.mark.parametrize(("text", "index"), UNKNOWN)
def test_each_written_question_mark_is_one_unknown_however_often_repeated(text, index):
    layup, n = parse_layup(text), max(index) + 1
    assert layup.unknown_index.tolist() == index
    assert np.array_equal(np.isnan(layup.angles_deg), layup.unknown_index >= 0)
    assert (layup.n_unknown, layup.unknown_names) == (n, tuple(f"angle_{i + 1}" for i in range(n)))


def test_symmetry_holds_whatever_the_unknown_angles():
    assert all(parse_layup(text).is_symmetric for text in ("[(?/?)_2]_s", "[?_3]", "[90/0/-90]"))
    assert not any(parse_layup(text).is_symmetric for text in ("[?/?]", "[0/90]"))


def test_unknown_angles_fill_every_ply_they_stand_for_and_a_wrong_choice_is_refused():
    layup = parse_layup("[(?/0/?)_2]_s")
    full = layup.angles(np.array([[10.0, 20.0], [30.0, 40.0]]))
    assert full.shape == (2, 12)
    assert full[1].tolist() == [30, 0, 40, 30, 0, 40, 40, 0, 30, 40, 0, 30]
    known = layup.with_angles([-90.0, 45.0])
    assert (known.n_unknown, known.text) == (0, "[(90/0/45)_2]_s")
    assert parse_layup("[0/90]").angles(np.empty((3, 0))).tolist() == [[0, 90]] * 3
    for unknown in (np.zeros(3), np.zeros((2, 1)), 5.0):
        with pytest.raises(ValueError, match=r"accepted: \(\.\.\., 2\)"):
            layup.angles(unknown)
    for unknown in (np.zeros((2, 2)), [0.0, 95.0]):
        with pytest.raises(ValueError, match=r"accepted: (\(2,\)|-90 to 90)"):
            layup.with_angles(unknown)


@pytest.mark.parametrize(
    ("text", "position"), [(text, at) for at, texts in MALFORMED.items() for text in texts]
)
def test_malformed_layups_are_refused_at_their_position(text, position):
    with pytest.raises(LayupError) as caught:
        parse_layup(text)
    assert (caught.value.text, caught.value.position) == (text, position)
    first, shown, caret = str(caught.value).split("\n")
    assert f"character {position + 1}" in first
    assert shown == f"  {text}"
    assert caret == f"  {' ' * position}^"
    assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)


@pytest.mark.parametrize(
    "text", ["[(0/90)_500000]", f"[0_{'9' * 4000}]", "[?]_2001", "[" + "/".join(["0_999"] * 1500) + "]"]
)
def test_layups_of_too_many_plies_are_refused_before_they_are_built(text):
    with peak_memory() as peak, pytest.raises(LayupError, match=f"up to {MAX_PLIES}"):
        parse_layup(text)
    assert peak() < 1e6  # a list of a million plies would take 8 MB
    assert parse_layup("[0_1000]_s").n_plies == MAX_PLIES


def test_long_and_deep_texts_are_refused_and_nothing_unprintable_is_shown():
    with pytest.raises(LayupError, match="characters") as caught:
        parse_layup("[" + "0/" * 10_000_000 + "0]")
    assert len(str(caught.value)) < 400
    with pytest.raises(LayupError, match="nested too deeply"):
        parse_layup("[" + "(" * 3000 + "0" + ")" * 3000 + "]")
    with pytest.raises(LayupError) as caught:
        parse_layup("[0/\x1b[31m]")
    assert "\x1b" not in str(caught.value)


@pytest.mark.parametrize(
    ("angles", "text"),
    [
        *(([0] * 20, "[0_20]"), ([0, 90, 0], "[0/90/0]"), ([-90, -0.0], "[90/0]")),
        ([45, -45, 0, 0] * 2 + [0, 0, -45, 45] * 2, "[(45/-45/0_2)_2]_s"),
        ([1e-7, 0.1 + 0.2], "[0.0000001/0.30000000000000004]"),
    ],
)
def test_known_angles_are_written_compactly_and_read_back_exactly(angles, text):
    assert format_angles(angles) == text
    layup = from_angles(angles)
    assert layup.text == text
    assert layup.angles_deg.tolist() == parse_layup(text).angles_deg.tolist()


@pytest.mark.parametrize("angles", [[], [91.0], [float("nan")], [0.0] * (MAX_PLIES + 1)])
def test_impossible_angle_lists_are_refused(angles):
    with pytest.raises(ValueError, match="accepted"):
        from_angles(angles)


def test_conditions_stand_in_the_order_of_the_letters_and_hold_nothing_that_is_sprung() -> None:
    names = [condition.name for condition in conditions("CFSF")]
    assert names == ["clamped", "free", "simply supported", "free"]
    assert [letter for letter, condition in CONDITIONS.items() if condition.is_free] == ["F"]
    for condition in CONDITIONS.values():
        for held in (condition.held_x, condition.held_y):
            assert set(held) <= set(FIELDS)
            assert not set(held) & set(condition.sprung)


def test_only_conditions_with_a_name_are_stated_in_a_plate_file() -> None:
    assert STATED == "FSC"
    assert all(is_stated("".join(edges)) for edges in product(STATED, repeat=4))
    assert not any(is_stated(text) for text in ("", "FFF", "FFFFF", "ffff", "FFFR"))


def test_a_clamp_gives_way_once_in_each_way_and_leaves_no_rigid_motion_even_on_springs() -> None:
    turning, moving = ("phi_x", "phi_y"), ("u", "v", "w")
    softer = yielding("C", turning)
    assert softer is not None
    assert CONDITIONS[softer].sprung == turning
    assert yielding(softer, turning) is yielding("F", turning) is None
    assert yielding(softer, moving) == yielding("C", FIELDS)
    clamps = [letter for letter, condition in CONDITIONS.items() if condition.is_clamp]
    assert "C" in clamps
    assert [rigid_body_count(f"{letter}FFF") for letter in clamps] == [0] * len(clamps)


def test_no_other_module_decides_by_a_letter() -> None:
    """A new condition is a row of the table: elsewhere its properties are used."""
    package = Path(cpam_bayes.__file__).parent
    sources = {path.relative_to(package): path.read_text("utf-8") for path in package.rglob("*.py")}
    sources = {path: text for path, text in sources.items() if "validation" not in path.parts}
    decides = re.compile(r"""[=!]= "[FSC]"|"[FSC]+" (not )?in [\w.]*edges|[=!]= "[FSC]{4}\"""")
    assert [str(path) for path, text in sources.items() if decides.search(text)] == []
