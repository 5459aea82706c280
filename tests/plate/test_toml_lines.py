"""Lines are found for every way TOML has of saying a thing."""

import tomllib

import pytest

from cpam_bayes.plate.toml_lines import line_numbers
from tests.effort import calls

TEXT = '''# a comment with [brackets] and = signs
top = """
[not.a.table]
no = "key"
"""
a.b = 1  # dotted
"quoted key" = 'it''s' # odd
[plate] # after
  length = 3.2
  "sd".x = 1_000
  inline = { y = 1, z = [2,
    3], "w" = { v = 4 } }
[[sensor]]
mass = 1
[[sensor]]
# nothing
mass = [
  1, # one
  2.5e-3,

  "a, ] b",
]
[sensor.place]
x = 1979-05-27 07:32:00
[last]
y = 1
'''.replace("'it''s'", "'it'")


def test_lines_of_tables_keys_and_elements_are_found():
    tomllib.loads(TEXT)
    lines = line_numbers(TEXT)
    expected = {
        ("top",): 2,
        ("a", "b"): 6,
        ("quoted key",): 7,
        ("plate",): 8,
        ("plate", "length"): 9,
        ("plate", "sd", "x"): 10,
        ("plate", "inline"): 11,
        ("plate", "inline", "y"): 11,
        ("plate", "inline", "z", 0): 11,
        ("plate", "inline", "z", 1): 12,
        ("plate", "inline", "w", "v"): 12,
        ("sensor",): 13,
        ("sensor", 0, "mass"): 14,
        ("sensor", 1): 15,
        ("sensor", 1, "mass"): 17,
        ("sensor", 1, "mass", 1): 19,
        ("sensor", 1, "mass", 2): 21,
        ("sensor", 1, "place"): 23,
        ("sensor", 1, "place", "x"): 24,
        ("last", "y"): 26,
    }
    assert {path: lines.get(path) for path in expected} == expected
    assert ("not",) not in lines
    assert ("no",) not in lines


def test_invalid_text_gives_what_was_reached():
    assert line_numbers("a = 1\nb = ]\nc = 3") == {("a",): 1, ("b",): 2}
    assert line_numbers("a = " + "[" * 100_000)[("a",)] == 1


class Counted(str):
    """A text that counts how many of its characters were searched for line ends."""

    searched = 0

    def count(self, part, start=0, end=None):
        self.searched += (len(self) if end is None else end) - start
        return super().count(part, start, end)


def test_a_large_file_is_scanned_in_linear_time():
    def effort(elements):
        text = Counted("x = [\n" + "1.0, # one\n" * elements + "]\n")
        with calls() as made:
            assert line_numbers(text)[("x", elements - 1)] == elements + 1
        assert text.searched <= len(text)
        return made()

    once, twice = effort(1000), effort(2000)
    assert twice == pytest.approx(2 * once, rel=0.05)
    text = "x = [\n" + "1.0, # one\n" * 60_000 + "]\n"
    assert line_numbers(text)[("x", 59_999)] == 60_001
