"""First screens: at most 12 lines and 120 words beside requested rows, and their figures."""

import pytest

from cpam_bayes.cli import COMMANDS
from cpam_bayes.render.figures import save_figures
from tests.answers import EVERY, QUICK, SLOW, answered


def size(summary):
    """Lines and words of a screen; a titled table contains requested rows."""
    said = [summary.title, *summary.slips, *summary.headline.splitlines(), *summary.lines, summary.next_step]
    own = [table for table in summary.tables if table.rows and not table.title]
    cells = [" ".join(row) for table in own for row in (table.headings or (), *table.rows)]
    lines = [line for line in (*said, *cells) if line]
    return len(lines), sum(len(line.split()) for line in lines)


def test_every_command_that_answers_on_the_screen_is_among_them():
    named = {name.partition(",")[0] for name in (*QUICK, *SLOW)}
    assert named == set(COMMANDS) - {"app"}  # whose answer is its page


@pytest.mark.parametrize("name", EVERY)
def test_a_first_screen_has_at_most_12_lines_and_120_words_and_each_figure_its_place_and_bytes(
    name, tmp_path
):
    result, written = answered(name), []
    report = result.report()
    lines, words = size(report.summary)
    assert 1 < lines <= 12
    assert words <= 120
    placed = [figure for section in report.sections for figure in section.figures]
    assert sorted(placed) == sorted(drawing.name for drawing in result.drawings())
    for place in ("first", "again"):
        (tmp_path / place).mkdir()
        save_figures(result.figures(), tmp_path / place)
        written.append({path.name: path.read_bytes() for path in (tmp_path / place).iterdir()})
    assert set(written[0]) == {f"{name}.{ending}" for name in placed for ending in ("png", "svg")}
    assert written[0] == written[1], "the same answer gives the same bytes"
