"""A report on a terminal, in a file and in a pipe."""

import io

import pytest

from cpam_bayes.render.report import facts, remarks
from cpam_bayes.render.terminal import screen_tables, screen_text
from tests.render.small import REPORT, RESULT, Terminal

PLAIN = """\
identify D&G
  The list is in kHz, not Hz. Divide by 1000.
  1 frequency < 2 constants: E1 is determined.

Constants
          value  95 % interval  note
  E1  136.6 GPa  131 to 142     determined
  E2    8.9 GPa                 not determined

  Fit 0.19 %, `relative_std` +- 0.2 %.
  Next: is anything wrong?  cpam-bayes diagnose 'D&G'
"""
BEHIND = """
Layup
  layup  [(0/90)_8]_s

In words
  [red]no colour[/red] <script>

Computation
  time  1 s
"""


def test_a_file_gets_aligned_plain_lines() -> None:
    assert screen_text(screen_tables(REPORT), io.StringIO()) == PLAIN
    assert RESULT.summary() == PLAIN
    assert RESULT.summary(verbose=True) == PLAIN + BEHIND


def test_a_terminal_gets_colours_and_every_bracket(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.delenv("NO_COLOR", raising=False)
    text = screen_text(screen_tables(REPORT, verbose=True), Terminal())
    assert "\x1b[" in text
    assert "[(0/90)_8]_s" in text
    assert "[red]no colour[/red]" in text
    assert "nothing" not in text


@pytest.mark.parametrize("term", ["dumb", "unknown"])
def test_a_terminal_without_abilities_gets_plain_lines(monkeypatch: pytest.MonkeyPatch, term: str) -> None:
    monkeypatch.setenv("TERM", term)
    assert screen_text(screen_tables(REPORT), Terminal()) == PLAIN


def test_a_long_sentence_is_broken_and_a_table_is_not() -> None:
    text = screen_text((remarks("", ("word " * 60,)), facts("", (("a", "b" * 150),))), io.StringIO())
    sentence, table = text.split("\n\n")
    assert max(map(len, sentence.splitlines())) <= 100
    assert "b" * 150 in table
