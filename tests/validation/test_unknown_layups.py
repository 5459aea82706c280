"""Built-in plates with unknown angles: the layup that they have in truth."""

import numpy as np
import pytest

from validation.sequences import known_angles, with_unknown_layup


def test_own_angles_stand_at_the_places_of_the_unknown_ones() -> None:
    # C1 is [(0/90)_8]_s
    np.testing.assert_array_equal(known_angles(with_unknown_layup("C1", "[(?/?)_8]_s")), [0.0, 90.0])
    np.testing.assert_array_equal(
        known_angles(with_unknown_layup("C1", "[0/?/?/90/(0/90)_6]_s")), [90.0, 0.0]
    )


@pytest.mark.parametrize(("layup", "unknown"), [(None, 4), ("[(?/?)_8]_s", 2)])
def test_a_plate_has_its_own_unknown_angles_or_those_of_a_layup(layup: str | None, unknown: int) -> None:
    assert with_unknown_layup("C1", layup).plate.layup.n_unknown == unknown
    assert with_unknown_layup("C1", layup, 30.0).angle_grid_deg == 30.0
