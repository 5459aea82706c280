"""The pages of the commands as a browser shows them: whole, readable, nothing out of reach."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import cpam_bayes as cb
from cpam_bayes.inference.ensemble import EnsembleSettings
from cpam_bayes.inference.swarm import SwarmSettings
from cpam_bayes.questions.plates import plates
from cpam_bayes.questions.sequence import stacking_result
from cpam_bayes.result import Result
from tests.browser import Browser, faults, open_browser
from tests.stacking.cases import answer, mixture

pytestmark = pytest.mark.needs_browser

WIDE, PHONE = 1280, 390
CHAINS = EnsembleSettings(walkers=16, round_steps=300, effective=100.0, most_steps=600)
SWARM = SwarmSettings(particles=20, iterations=30)

QUICK: dict[str, Callable[[Path], Result]] = {
    "batch": lambda store: cb.batch("A1", "no such plate", limits=["E1_GPa >= 60"]),
    "forward": lambda store: cb.forward("D1", 3),
    "identify": lambda store: cb.identify("A1"),
    "plates": lambda store: plates(),
}
SLOW: dict[str, Callable[[Path], Result]] = {
    "identify --backend emcee": lambda store: cb.sample("A1", settings=CHAINS),
    "sequence": lambda store: stacking_result(answer(), mixture(), None, 0, 5),
    "sensitivity": lambda store: cb.sensitivity(
        "A1", levels=(0.01,), groups=3, settings=SWARM, chains=CHAINS
    ),
    "report": lambda store: cb.report("A1", quick=True),
    "paper": lambda store: cb.paper(7, quick=True, store=store),
}
MADE = QUICK | SLOW


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with open_browser() as opened:
        yield opened


@pytest.mark.parametrize("command", [*QUICK, *(pytest.param(name, marks=pytest.mark.slow) for name in SLOW)])
def test_the_page_of_a_command_has_no_fault_on_a_screen_and_on_a_phone(
    browser: Browser, command: str, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    result = MADE[command](tmp_path / "store")
    placed = [figure for section in result.report().sections for figure in section.figures]
    assert sorted(placed) == sorted(drawing.name for drawing in result.drawings())
    result.save(out)
    page = out / "report.html"
    assert faults(browser, page, WIDE) == []
    assert faults(browser, page, PHONE) == []
    assert page.stat().st_size < 5_000_000
