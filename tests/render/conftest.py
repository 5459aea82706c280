"""A quick solution, to be drawn and saved, and a browser."""

from collections.abc import Iterator

import pytest

from cpam_bayes.questions.forward import ForwardResult
from tests.answers import answered
from tests.browser import Browser, open_browser


@pytest.fixture(scope="package")
def forward_result() -> ForwardResult:
    """Three modes of a clamped plate."""
    return answered("forward")


@pytest.fixture(scope="package")
def browser() -> Iterator[Browser]:
    with open_browser() as opened:
        yield opened
