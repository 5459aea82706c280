"""Progress: an occasional line, a bar on a terminal, nothing when quiet."""

import itertools
import re
import sys

import pytest

from cpam_bayes.parallel import run
from cpam_bayes.render import terminal as module
from cpam_bayes.render.terminal import Terminal as Watch
from cpam_bayes.render.terminal import announce, duration, forecasting, progress
from tests.render.small import Terminal

AT_MOST = "this part takes at most about 10 min"


def a_clock(monkeypatch, seconds):
    """A clock that advances by this many seconds at each reading."""
    looks = itertools.count()
    monkeypatch.setattr(module.time, "monotonic", lambda: seconds * next(looks))


def work(total, quiet=False):
    with progress("identify C1", total, quiet, lambda best: f"rms {best:.1f} Hz") as shown:
        shown.notify("building the plate model")
        for iteration in range(total + 1):
            shown.tick(iteration, 10.0 / (iteration + 1))


@pytest.mark.parametrize("total", [1, 7, 400])
def test_a_file_gets_about_ten_lines_and_items_are_counted_by_their_name(capsys, total):
    work(total)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == f"identify C1: up to {total} iterations"
    assert lines[1] == "identify C1: building the plate model"
    assert lines[2] == f"identify C1: iteration 0 of {total}, rms 10.0 Hz"
    assert len(lines) == min(total, 10) + 3
    with progress("batch", 2, False, counted="plates") as shown:
        shown.tick(1, 1.0)
    assert capsys.readouterr().err.splitlines() == ["batch: 2 plates", "batch: 1 of 2 plates"]


def test_quiet_is_quiet_and_without_standard_error_the_work_goes_on(monkeypatch, capsys):
    work(20, quiet=True)
    announce("forward C1", quiet=True)
    assert capsys.readouterr() == ("", "")
    monkeypatch.setattr(sys, "stderr", None)
    announce("forward C1", quiet=False)
    work(3)


def test_a_terminal_gets_a_bar_that_says_what_is_left_and_goes_away(monkeypatch):
    a_clock(monkeypatch, 4000.0)
    for name, value in (("TERM", "xterm"), ("COLUMNS", "140")):
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(sys, "stderr", Terminal())
    with progress("identify C1", 5, False, lambda best: f"rms {best:.1f} Hz") as shown:
        for iteration in range(3):
            shown.tick(iteration, 3.3)
    said = r"iteration 2 of 5, rms 3.3 Hz, at most about \d+ h \d\d min left"  # the bar reads the clock too
    assert re.search(said, sys.stderr.getvalue())
    work(5)
    for part in ("iteration 5 of 5, rms 1.7 Hz", "\x1b[2K"):  # the line is cleared at the end
        assert part in sys.stderr.getvalue()


def expected(capsys):
    lines = capsys.readouterr().err.splitlines()
    said = ("this part", "longer than")
    return [(lines[i - 1] if i else "", line) for i, line in enumerate(lines) if line.startswith(said)]


@pytest.mark.parametrize(("seconds", "said"), [(30.0, [AT_MOST]), (2.9, []), (0.1, [])])
def test_what_takes_above_a_minute_is_said_once_as_soon_as_it_is_known(monkeypatch, capsys, seconds, said):
    a_clock(monkeypatch, seconds)
    work(20)
    lines = capsys.readouterr().err.splitlines()
    told = [i for i, line in enumerate(lines) if line.startswith("this part")]
    assert [lines[i] for i in told] == said
    assert all(lines[i - 1].startswith("identify C1: iteration 2 of 20") for i in told)
    assert any("left" in line for line in lines) == (seconds > 1.0)
    if said:
        shown = {2: "0 of 20, rms 10.0 Hz", 3: "2 of 20, rms 3.3 Hz, at most about 9 min left"}
        shown |= {-2: "18 of 20, rms 0.5 Hz, at most about 1 min left", -1: "20 of 20, rms 0.5 Hz"}
        assert {i: lines[i].removeprefix("identify C1: iteration ") for i in shown} == shown


def doubled(shared, item):
    return run(quadrupled, shared, range(50))[0] + 2 * item


def quadrupled(shared, item):
    return 4 * item


def test_items_that_are_shared_out_and_a_stage_of_items_say_their_time_once(monkeypatch, capsys):
    a_clock(monkeypatch, 20.0)
    with forecasting():
        announce("two by two", False)
        assert run(doubled, None, range(30)) == list(range(0, 60, 2))
    assert expected(capsys) == [("two by two", "this part takes about 10 min")]
    run(doubled, None, range(30))
    assert not expected(capsys)
    with forecasting(), Watch().stage("design", 30, counted="specimens") as shown:
        run(quadrupled, None, range(30), on_result=lambda index, _: shown.tick(index + 1, 0.0))
    assert [said for _, said in expected(capsys)] == ["this part takes about 13 min"]


def test_a_later_end_corrects_what_was_said(monkeypatch, capsys):
    seconds = iter([0.0, 20.0, 40.0, 60.0, 80.0, 900.0, *(1000.0 + 100.0 * i for i in range(20))])
    monkeypatch.setattr(module.time, "monotonic", lambda: next(seconds))
    with forecasting():
        run(quadrupled, None, range(10))
    said = ["this part takes about 4 min", "longer than expected: about 15 min left"]
    assert [line for _, line in expected(capsys)] == said


@pytest.mark.parametrize("options", [(), ("--quiet",)])
def test_a_command_says_what_its_parts_take_unless_it_is_quiet(run, monkeypatch, options):
    a_clock(monkeypatch, 30.0)
    status, _, said = run("identify", "A1", "--swarms", "1", *options)
    assert status == 0
    assert ("this part takes at most about " in said) == (not options)


def test_durations_are_rounded_up():
    given = (11, 59, 61, 3599, 3601, 7200)
    said = ["15 s", "1 min", "2 min", "1 h", "1 h 1 min", "2 h"]
    assert [duration(seconds) for seconds in given] == said
