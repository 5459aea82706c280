"""Tables are plain lines in a file and drawn with rich on a terminal."""

import io

import pytest

from cpam_bayes.report.tables import Column, Table, facts, remarks, screen_text

LAYUP = "[(0/90)_8]_s"
TABLES = (
    facts("head", (("layup", LAYUP), ("edges", "FFFF"))),
    Table("values", (Column("name"), Column("value", number=True)), (("E1", "121.2"), ("nu12", "0.3"))),
    remarks("nothing", ()),
    remarks("warnings", ("[red]not a colour[/red] :warning:",), flagged=True),
)


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_a_file_gets_aligned_plain_lines():
    assert screen_text(TABLES, io.StringIO()) == (
        "head\n"
        f"  layup  {LAYUP}\n"
        "  edges  FFFF\n"
        "\n"
        "values\n"
        "  name  value\n"
        "  E1    121.2\n"
        "  nu12    0.3\n"
        "\n"
        "warnings\n"
        "  [red]not a colour[/red] :warning:\n"
    )


def test_a_terminal_gets_colours_and_every_bracket(monkeypatch):
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.delenv("NO_COLOR", raising=False)
    text = screen_text(TABLES, Terminal())
    assert "\x1b[" in text
    assert LAYUP in text
    assert "[red]not a colour[/red] :warning:" in text
    assert "nothing" not in text


@pytest.mark.parametrize("term", ["dumb", "unknown"])
def test_a_terminal_without_abilities_gets_plain_lines(monkeypatch, term):
    monkeypatch.setenv("TERM", term)
    assert screen_text(TABLES, Terminal()) == screen_text(TABLES, io.StringIO())
