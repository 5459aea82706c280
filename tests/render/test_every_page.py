"""The pages of the commands as a browser shows them: whole, readable, nothing out of reach."""

from pathlib import Path

import pytest

from tests.answers import EVERY, answered
from tests.browser import Browser, faults

pytestmark = pytest.mark.needs_browser

WIDE, PHONE = 1280, 390


@pytest.mark.parametrize("name", EVERY)
def test_the_page_of_a_command_has_no_fault_on_a_screen_and_on_a_phone(
    browser: Browser, name: str, tmp_path: Path
) -> None:
    answered(name).save(tmp_path)
    page = tmp_path / "report.html"
    assert faults(browser, page, WIDE) == []
    assert faults(browser, page, PHONE) == []
    assert page.stat().st_size < 5_000_000
