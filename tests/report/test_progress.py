"""Progress: a line now and then, a bar on a terminal, nothing when quiet."""

import io
import itertools
import sys

import pytest

from cpam_bayes.report import progress as module
from cpam_bayes.report.progress import announce, duration, progress


class Terminal(io.StringIO):
    def isatty(self):
        return True


def work(total, quiet=False):
    with progress("identify C1", total, quiet, lambda best: f"rms {best:.1f} Hz") as shown:
        shown.notify("building the plate model")
        for iteration in range(total + 1):
            shown.tick(iteration, 10.0 / (iteration + 1))


@pytest.mark.parametrize("total", [1, 7, 400])
def test_a_file_gets_about_ten_lines(capsys, total):
    work(total)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == f"identify C1: up to {total} iterations"
    assert lines[1] == "identify C1: building the plate model"
    assert lines[2] == f"identify C1: iteration 0 of {total}, rms 10.0 Hz"
    assert len(lines) == min(total, 10) + 3


def test_quiet_is_quiet(capsys):
    work(20, quiet=True)
    announce("forward C1", quiet=True)
    assert capsys.readouterr() == ("", "")


def test_a_terminal_gets_a_bar_that_goes_away(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.setattr(sys, "stderr", Terminal())
    work(5)
    drawn = sys.stderr.getvalue()
    assert "iteration 5 of 5, rms 1.7 Hz" in drawn
    assert "\x1b[2K" in drawn  # the line is cleared in the end


def test_without_standard_error_the_work_goes_on(monkeypatch):
    monkeypatch.setattr(sys, "stderr", None)
    announce("forward C1", quiet=False)
    work(3)


def a_clock(monkeypatch, seconds):
    """A clock that goes on by so many seconds whenever it is looked at."""
    looks = itertools.count()
    monkeypatch.setattr(module.time, "monotonic", lambda: seconds * next(looks))


def test_long_work_says_what_is_left(monkeypatch, capsys):
    a_clock(monkeypatch, 30.0)
    work(20)
    lines = capsys.readouterr().err.splitlines()[2:]
    assert lines[0] == "identify C1: iteration 0 of 20, rms 10.0 Hz"
    assert lines[1] == "identify C1: iteration 2 of 20, rms 3.3 Hz, at most 9 min left"
    assert lines[-2] == "identify C1: iteration 18 of 20, rms 0.5 Hz, at most 1 min left"
    assert lines[-1] == "identify C1: iteration 20 of 20, rms 0.5 Hz"


def test_a_bar_says_what_is_left(monkeypatch):
    a_clock(monkeypatch, 4000.0)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "140")
    monkeypatch.setattr(sys, "stderr", Terminal())
    with progress("identify C1", 5, False, lambda best: f"rms {best:.1f} Hz") as shown:
        for iteration in range(3):
            shown.tick(iteration, 3.3)
    assert "iteration 2 of 5, rms 3.3 Hz, at most 3 h 20 min left" in sys.stderr.getvalue()


def test_short_work_has_no_estimate(monkeypatch, capsys):
    a_clock(monkeypatch, 0.1)
    work(20)
    assert "left" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (11.0, "15 s"),
        (59.0, "1 min"),
        (61.0, "2 min"),
        (3599.0, "1 h"),
        (3601.0, "1 h 1 min"),
        (7200.0, "2 h"),
    ],
)
def test_durations_are_rounded_up(seconds, text):
    assert duration(seconds) == text
