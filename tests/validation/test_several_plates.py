"""Plates diagnosed together: a sister without the flaw, further tests of the plate with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cpam_bayes.plate import Specimen, parse_specimen
from tests.test_studies import quick
from validation.claims import scoring
from validation.independent import lists
from validation.independent.true_plate import FLAWS, TruePlate, natural_frequencies
from validation.several_plates import ALONE, CLAMPED, LOADED, SISTER, Laboratory, files, spread

PLATE = replace(lists.FINAL[0], name="panel")
LABORATORY = Laboratory(PLATE, 8.0, 0)
NOISY = 5 * lists.NOISE


@pytest.fixture(scope="module")
def made() -> tuple[lists.Truth, dict[str, Specimen]]:
    truth, texts = files(LABORATORY, "taper_x", 0)
    return truth, {setup: parse_specimen(text, f"{setup}.toml") for setup, text in texts.items()}


def frequencies(specimen: Specimen) -> np.ndarray:
    assert specimen.measurement is not None
    return np.asarray(specimen.measurement.frequencies)


def test_a_sister_is_another_plate_and_a_further_test_the_same_one(
    made: tuple[lists.Truth, dict[str, Specimen]],
) -> None:
    named = {setup: (s.name, s.specimen) for setup, s in made[1].items()}
    assert len({name for name, _ in named.values()}) == 4
    assert named[CLAMPED][1] == named[LOADED][1] == named[ALONE][1] != named[SISTER][1]
    assert len({s.material.name for s in made[1].values()}) == 1
    assert made[1][CLAMPED].plate.edges == "CFFF"
    assert [s.mass for s in made[1][LOADED].sensors] == pytest.approx([0.02 * PLATE.plate.total_mass])


def test_further_tests_have_the_flaw_and_a_sister_lacks_it(
    made: tuple[lists.Truth, dict[str, Specimen]],
) -> None:
    truth, specimens = made
    own = replace(PLATE.plate, constants=truth.constants)

    def flawed(plate: TruePlate) -> np.ndarray:
        return natural_frequencies(FLAWS["taper_x"].apply(plate, truth.sizes["taper_x"], {}), PLATE.n_modes)

    clamped = replace(own, edges="CFFF")
    for setup, plate in ((ALONE, own), (CLAMPED, clamped)):
        np.testing.assert_allclose(frequencies(specimens[setup]), flawed(plate), rtol=NOISY, atol=0.1)
    assert np.abs(flawed(clamped) / natural_frequencies(clamped, PLATE.n_modes) - 1.0).max() > NOISY
    # constants that scatter by 2 % from common ones move frequencies by 1 % and less than two of them
    bare = natural_frequencies(own, PLATE.n_modes)
    shift = np.log(frequencies(specimens[SISTER]) / bare)
    assert np.abs(shift).max() < 0.05


def test_a_flaw_out_of_reach_is_told() -> None:
    with pytest.raises(lists.UnreachableError, match="thickness reaches"):
        files(replace(LABORATORY, ratio=300.0), "thickness", 0)


def test_the_spread_is_that_of_the_constants_over_that_alone() -> None:
    alone = [{"relative_sd": {"E1_GPa": 0.02, "nu12": 0.1}}]
    assert spread([{"relative_sd": {"E1_GPa": 0.01, "nu12": 0.05}}], alone) == pytest.approx(0.5)


@pytest.mark.slow
def test_a_sister_narrows_the_constants_and_its_answer_is_scored_as_any_other() -> None:
    found = quick("13_several_plates")
    alone, sister = found["setups"]
    assert sister["constants_spread"] < 1.0
    for setup in (alone, sister):
        assert sum(setup[category] for category in scoring.CATEGORIES) == setup["trials"] == 1
