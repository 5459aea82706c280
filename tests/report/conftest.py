"""One short identification and one forward solution, to be shown in every way."""

from dataclasses import replace

import pytest

from cpam_bayes.forward_model.solve import forward
from cpam_bayes.identification.identify import identify


@pytest.fixture(scope="package")
def point(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CPAM_BAYES_CACHE", str(tmp_path_factory.mktemp("cache")))
        return identify("A1", seed=1)


@pytest.fixture(scope="package")
def identification(point):
    """The estimate alone, to be changed and put back by `result_of`."""
    return point.estimate


@pytest.fixture(scope="package")
def result_of(point):
    """The result with another estimate."""

    def result(estimate, warnings=()):
        return replace(point, specimen=estimate.specimen, estimate=estimate, warnings=warnings)

    return result


@pytest.fixture(scope="package")
def forward_result():
    return forward("D1", 3)
