"""What every command shows: at most 12 lines and 120 words besides rows asked for, and its figures."""

from itertools import chain
from pathlib import Path

import pytest

from cpam_bayes.cli import COMMANDS
from cpam_bayes.render.figures import save_figures
from cpam_bayes.render.report import Summary
from tests.answers import EVERY, QUICK, SLOW, answered


def size(summary: Summary) -> tuple[int, int]:
    """Lines and words of a screen; a table with a title holds rows that were asked for."""
    said = [summary.title, *summary.slips, *summary.headline.splitlines(), *summary.lines, summary.next_step]
    own = [table for table in summary.tables if table.rows and not table.title]
    cells = [" ".join(row) for table in own for row in (table.headings or (), *table.rows)]
    lines = [line for line in (*said, *cells) if line]
    return len(lines), len(list(chain.from_iterable(line.split() for line in lines)))


def test_every_command_that_answers_on_the_screen_is_among_them() -> None:
    named = {name.partition(",")[0] for name in (*QUICK, *SLOW)}
    assert named == set(COMMANDS) - {"app"}  # whose answer is its page


@pytest.mark.parametrize("name", EVERY)
def test_a_first_screen_has_at_most_12_lines_and_120_words(name: str) -> None:
    lines, words = size(answered(name).report().summary)
    assert 1 < lines <= 12
    assert words <= 120


@pytest.mark.parametrize("name", EVERY)
def test_the_same_answer_gives_the_same_bytes_of_every_figure_and_each_has_its_place(
    name: str, tmp_path: Path
) -> None:
    result, written = answered(name), []
    placed = [figure for section in result.report().sections for figure in section.figures]
    assert sorted(placed) == sorted(drawing.name for drawing in result.drawings())
    for place in ("first", "again"):
        (tmp_path / place).mkdir()
        save_figures(result.figures(), tmp_path / place)
        written.append({path.name: path.read_bytes() for path in (tmp_path / place).iterdir()})
    assert set(written[0]) == {f"{name}.{ending}" for name in placed for ending in ("png", "svg")}
    assert written[0] == written[1]
