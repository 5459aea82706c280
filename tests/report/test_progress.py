"""Progress: a line now and then, a bar on a terminal, nothing when quiet."""

import io
import sys

import pytest

from cpam_bayes.report.progress import announce, progress


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
