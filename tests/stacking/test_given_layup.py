"""The probability of a sequence that is named."""

import numpy as np
import pytest

from cpam_bayes.stacking.queries.given_layup import given_layup
from tests.stacking.cases import TRUE, answer, shortened


def test_a_listed_sequence_has_the_place_and_probability_of_its_class() -> None:
    own = answer()
    found = given_layup(own, np.array(TRUE))  # the list has its mirror image
    assert found.rank == 1
    assert found.probability == own.probability[0]
    assert found.log_evidence == own.log_evidence[0]


def test_one_that_is_not_listed_is_computed() -> None:
    own = answer()
    found = given_layup(shortened(2), own.top[2])
    assert found.rank is None
    # two estimates of one integral, their errors, and one point in a thousand more
    tolerance = 4.0 * np.hypot(found.log_evidence_error, own.log_evidence_error[2]) + 0.01
    assert found.log_evidence == pytest.approx(own.log_evidence[2], abs=tolerance)
    assert np.log(found.probability) == pytest.approx(np.log(own.probability[2]), abs=tolerance)


def test_minus_ninety_degrees_is_ninety() -> None:
    own = answer()
    np.testing.assert_array_equal(given_layup(own, np.array([-90.0, 30.0])).angles_deg, [90.0, 30.0])


@pytest.mark.parametrize("angles", [(10.0, 0.0), (0.0, 30.0, 60.0)])
def test_a_sequence_off_the_grid_is_refused(angles: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="accepted: 2 angles on the grid of 30 degrees"):
        given_layup(answer(), np.array(angles))
