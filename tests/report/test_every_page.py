"""The pages of commands that take longer, as a browser shows them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import cpam_bayes as cb
from cpam_bayes.comparison.compare import compare
from cpam_bayes.inference.chains.ensemble import EnsembleSettings
from cpam_bayes.inference.swarm.settings import SwarmSettings
from cpam_bayes.result import Result
from cpam_bayes.stacking.sequence import stacking_result
from tests.browser import Browser, faults, open_browser
from tests.stacking.cases import answer, mixture

pytestmark = [pytest.mark.needs_browser, pytest.mark.slow]

WIDE, PHONE = 1280, 390
CHAINS = EnsembleSettings(walkers=16, round_steps=300, effective=100.0, most_steps=600)
SWARM = SwarmSettings(particles=20, iterations=30)

# By the command; those that are quick stand in test_page.py.
MADE: dict[str, Callable[[Path], Result]] = {
    "identify --backend emcee": lambda store: cb.sample("A1", settings=CHAINS),
    "sequence": lambda store: stacking_result(answer(), mixture(), None, 0, 5),
    "sensitivity": lambda store: cb.sensitivity(
        "A1", levels=(0.01,), groups=3, settings=SWARM, chains=CHAINS
    ),
    "report": lambda store: cb.full_report("A1", quick=True),
    "paper": lambda store: compare(7, quick=True, store=store),
}


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with open_browser() as opened:
        yield opened


@pytest.mark.parametrize("command", MADE)
def test_the_page_of_a_command_has_no_fault_on_a_screen_and_on_a_phone(
    browser: Browser, command: str, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    MADE[command](tmp_path / "store").save(out)
    page = out / "report.html"
    assert faults(browser, page, WIDE) == []
    assert faults(browser, page, PHONE) == []
    assert page.stat().st_size < 5_000_000
