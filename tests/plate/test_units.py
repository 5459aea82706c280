"""Units change at the border only, and both ways from one table."""

import numpy as np
import pytest

from cpam_bayes.plate import USER_UNITS, angle_grid, to_si, to_user, user_name


@pytest.mark.parametrize(
    ("user", "value", "name", "si"),
    [
        ("E1_GPa", 121.2, "E1", 121.2e9),
        ("nu12", 0.23, "nu12", 0.23),
        ("length_mm", 3.2, "length", 0.0032),
        ("mass_g", 1.2, "mass", 0.0012),
        ("density_kg_m3", 1590.0, "density", 1590.0),
    ],
)
def test_numbers_are_scaled_without_rounding_twice(user, value, name, si):
    assert to_si(user, value) == si
    assert user_name(name) == user
    assert to_user(name, si) == value


@pytest.mark.parametrize("user", USER_UNITS)
def test_every_name_round_trips(user):
    name, factor = USER_UNITS[user]
    assert user_name(name) == user
    assert to_user(name, to_si(user, 7.3)) == pytest.approx(7.3, rel=1e-15)
    assert to_si(user, 1.0) == factor


@pytest.mark.parametrize("act", [lambda: to_si("E1", 1.0), lambda: to_user("E1_GPa", 1.0)])
def test_unknown_names_are_refused(act):
    with pytest.raises(ValueError, match="accepted"):
        act()


def test_the_angle_grid_is_that_of_eq_10():
    grid = angle_grid(5.0)
    assert grid.size == 36
    assert grid[0] == -85.0
    assert grid[-1] == 90.0
    assert 0.0 in grid
    assert np.array_equal(np.diff(grid), np.full(35, 5.0))


@pytest.mark.parametrize("step", [0.1, 0.3, 22.5, 36.0, 180.0])
def test_every_angle_grid_ends_at_90_and_omits_minus_90(step):
    grid = angle_grid(step)
    assert grid[-1] == 90.0
    assert grid[0] > -90.0
    assert grid.size == round(180.0 / step)


@pytest.mark.parametrize("step", [7.0, 0.0, -5.0, 1e-9, 200.0, float("nan"), float("inf")])
def test_steps_that_do_not_divide_180_are_refused(step):
    with pytest.raises(ValueError, match="accepted"):
        angle_grid(step)
