"""What is left open of each angle, and the weight of its plies in bending."""

import numpy as np
import pytest

from cpam_bayes.plate.layup import parse_layup
from cpam_bayes.stacking.queries.angle_information import angle_information, bending_fractions, entropies
from tests.stacking.cases import answer


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
