"""Questions to a posterior: what is left open of each angle, and a layup that is given."""

import numpy as np
import pytest

from cpam_bayes.plate.layup import parse_layup
from cpam_bayes.stacking.queries import angle_information, bending_fractions, entropies, given_layup
from tests.stacking.cases import TRUE, answer, shortened


def test_entropy_is_zero_for_a_known_angle_and_the_log_of_the_grid_for_an_open_one() -> None:
    p = np.array([[0.0, 1.0, 0.0, 0.0], [0.25, 0.25, 0.25, 0.25], [0.5, 0.5, 0.0, 0.0]])
    np.testing.assert_allclose(entropies(p), [0.0, np.log(4.0), np.log(2.0)], atol=1e-15)


def test_plies_weigh_in_bending_as_their_second_moments() -> None:
    # two plies on either side of the middle: 1 - (1/2)^3 outside, (1/2)^3 inside
    np.testing.assert_allclose(bending_fractions(parse_layup("[?/?]_s")), [7 / 8, 1 / 8], rtol=1e-12)
    # a known ply in the middle of three: 1 - (2/3)^3 and (1/3)^3
    np.testing.assert_allclose(bending_fractions(parse_layup("[?/0/?]_s")), [19 / 27, 1 / 27], rtol=1e-12)


@pytest.mark.parametrize(
    ("certain", "better"), [((0.9, 0.6), True), ((0.6, 0.9), False), ((0.9, 0.9), False)]
)
def test_outer_angles_are_better_only_if_less_of_them_is_open(
    certain: tuple[float, float], better: bool
) -> None:
    p = np.array([[c, 1.0 - c] for c in certain])
    found = angle_information(parse_layup("[?/?]_s"), p)
    assert found.outer_better is better
    assert found.most_bits == 1.0
    np.testing.assert_array_equal(found.outer_first, [0, 1])


@pytest.mark.slow
def test_the_outer_angle_of_a_plate_is_better_determined_than_the_inner_one() -> None:
    own = answer()
    found = angle_information(own.specimen.plate.layup, own.marginals)
    assert found.outer_better
    # the outer ply has seven eighths of D: its angle is known but for the mirror image, the inner one is not
    assert found.entropy_bits[0] == pytest.approx(1.0, abs=0.05)
    assert found.entropy_bits[1] > 1.3


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
