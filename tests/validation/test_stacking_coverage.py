"""Randomised credible sets of sequences hold the true one as often as their level says."""

import numpy as np
import pytest

from tests.stacking.cases import specimen
from validation.sequences import (
    CoverageSettings,
    Trial,
    known_angles,
    randomised_place,
    stacking_coverage,
    summarised,
    with_unknown_layup,
)

SINGLE, SIZE = np.array([0.3, 0.1, 0.1, 0.05]), np.array([2, 1, 2, 2])


def test_the_place_is_the_probability_of_what_comes_before() -> None:
    assert randomised_place(SINGLE, SIZE, 0, 0.0) == 0.0
    assert randomised_place(SINGLE, SIZE, 0, 1.0) == pytest.approx(0.6)
    # classes 1 and 2 are equally probable, so they share a place
    assert randomised_place(SINGLE, SIZE, 1, 0.5) == pytest.approx(0.75)
    assert randomised_place(SINGLE, SIZE, 2, 0.5) == pytest.approx(0.75)
    assert randomised_place(SINGLE, SIZE, 3, 1.0) == pytest.approx(1.0)


@pytest.mark.parametrize(("power", "number", "seed"), [(1, 4000, 0), (3, 300, 1)])
def test_places_of_draws_from_the_probabilities_are_uniform_and_of_too_sure_ones_do_not_pass(
    power: int, number: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    stated = (SINGLE * SIZE) ** power / np.sum((SINGLE * SIZE) ** power)
    true = rng.choice(4, size=number, p=SINGLE * SIZE)
    places = [randomised_place(stated / SIZE, SIZE, int(i), rng.uniform()) for i in true]
    found = summarised(tuple(Trial(i, (0.0,), p, 0.5, 1, 1, 0.0) for i, p in enumerate(places)))
    assert found.passes == (power == 1)
    assert (found.p_uniform > 0.01) if power == 1 else (found.z < 0.0)


@pytest.mark.slow
@pytest.mark.weekly
def test_sets_of_simulated_plates_hold_the_true_sequence() -> None:
    settings = CoverageSettings(library=400, log2_points=7)
    found = stacking_coverage(specimen(), 24, 0, settings=settings)
    assert [t.number for t in found] == list(range(24))
    assert summarised(found).passes
    # and not because they hold everything: uniform places, half of them in the smaller half
    assert summarised(found, 0.5).passes
    assert summarised(found).p_uniform > 0.01
    np.testing.assert_array_less([t.set_size for t in found], 36)
    again = stacking_coverage(specimen(), 2, 0, settings=settings)
    assert again == found[:2]


# Built-in plates with unknown angles


@pytest.mark.parametrize(
    ("layup", "angles"), [(None, None), ("[(?/?)_8]_s", [0.0, 90.0]), ("[0/?/?/90/(0/90)_6]_s", [90.0, 0.0])]
)
def test_a_plate_has_its_own_unknown_angles_or_those_of_a_layup_that_stand_at_their_places(
    layup: str | None, angles: list[float] | None
) -> None:
    found = with_unknown_layup("C1", layup, 30.0)
    assert found.angle_grid_deg == 30.0
    assert found.plate.layup.n_unknown == (4 if angles is None else 2)
    if angles is not None:  # C1 is [(0/90)_8]_s
        np.testing.assert_array_equal(known_angles(found), angles)
