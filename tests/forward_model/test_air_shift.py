"""What air would change: against the full model in air, and how it is told."""

from __future__ import annotations

from dataclasses import replace

import pytest

from cpam_bayes.forward_model.model import NO_PARAMETERS, ROOM_AIR, air_shifts, converged_model
from cpam_bayes.plate import builtin
from cpam_bayes.render.plate import air_text


@pytest.mark.parametrize("name", ["C1", pytest.param("A2", marks=pytest.mark.slow)])
def test_the_shift_is_that_of_converged_frequencies_in_air(name):
    specimen = builtin(name)
    in_vacuum, in_air = (
        converged_model(replace(specimen, air_density=rho), NO_PARAMETERS, 4).predict([[]]).frequencies[0]
        for rho in (None, ROOM_AIR)
    )
    # both spaces are good to 1e-4 of a frequency, and the ratio to far less
    assert air_shifts(specimen, 4) == pytest.approx(in_air / in_vacuum - 1.0, abs=2e-5)


def test_air_lowers_bending_and_leaves_in_plane_modes_alone():
    shifts = air_shifts(builtin("D3"), 5)
    # the fifth mode of D3 moves in its plane
    assert (shifts[:4] < -1e-3).all()
    assert abs(shifts[4]) < 1e-5


def test_the_head_of_a_screen_says_what_air_is_in_the_model_or_would_change():
    specimen = builtin("C1")
    assert air_text(specimen, air_shifts(specimen)) == (
        "not in the model; 1.2 kg/m3 would lower the first 6 frequencies by 0.40 to 0.63 %"
    )
    in_air = replace(specimen, air_density=1.15)
    assert air_text(in_air, air_shifts(in_air)) == "1.15 kg/m3, in the model"
    unknown = replace(builtin("F1"), measurement=None)
    assert air_text(unknown, air_shifts(unknown)).startswith("not in the model; ")
