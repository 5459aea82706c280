"""A quick solution, to be drawn and saved."""

import pytest

from cpam_bayes.questions.forward import ForwardResult
from tests.answers import answered


@pytest.fixture(scope="package")
def forward_result() -> ForwardResult:
    """Three modes of a clamped plate."""
    return answered("forward")
