"""One short identification and one forward solution, to be shown in every way."""

import pytest

from cpam_bayes.commands.solvers import ritz
from cpam_bayes.identification.point import identify
from cpam_bayes.plate import builtin


@pytest.fixture(scope="package")
def identification(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CPAM_BAYES_CACHE", str(tmp_path_factory.mktemp("cache")))
        return identify(builtin("A1"), 1)


@pytest.fixture(scope="package")
def forward_answer():
    return ritz(builtin("D1"), 3)
