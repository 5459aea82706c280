"""The posterior by which `identify --residuals whitened` answers: noise and sizes in one covariance."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import cpam_bayes as cb
from cpam_bayes.diagnosis.cases import plate_case
from cpam_bayes.plate import parse_specimen
from cpam_bayes.questions.identify.pso import PointResult
from tests.diagnosed import diagnosed
from tests.plate_file import PLATE

NOISE = 0.002
# All is exact but the thickness.
EXACT = "length_mm = 0\nwidth_mm = 0\ndensity_kg_m3 = 0\n"
ONE = PLATE.replace("nu12 = [0.15, 0.4]\n", "")


def identified(plate: str, thickness: float, **stated: float) -> PointResult:
    """A list by the model itself, of a plate whose thickness is known to so many mm."""
    f = cb.forward(parse_specimen(plate, "x"), n_modes=8).frequencies.tolist()
    sd = f"\n[plate.sd]\nthickness_mm = {thickness}\n{EXACT}"
    given = "".join(f"{key} = {value}\n" for key, value in stated.items())
    text = f"{plate}{sd}\n[measurement]\nfrequencies_hz = {f}\n{given}"
    return cb.identify(parse_specimen(text, "x"), seed=1, residuals="whitened")


def test_one_modulus_is_known_as_well_as_noise_and_thickness_let_it_be() -> None:
    found = identified(ONE, 0.0, relative_std=NOISE, frequency_scale_sd=0.0).constants["E1"]
    thick = identified(ONE, 0.03, relative_std=NOISE, frequency_scale_sd=0.0).constants["E1"]
    scale = identified(ONE, 0.0, relative_std=NOISE, frequency_scale_sd=0.004).constants["E1"]
    # f^2 goes with E: of eight frequencies with 0.2 % of noise the mean is known to 0.07 %, E to 0.14 %
    assert found.value == pytest.approx(69e9, rel=3e-4)
    assert found.sd / found.value == pytest.approx(2 * NOISE / 8**0.5, rel=0.08)
    # 1 % of thickness is 2 % of E, and 0.4 % of the scale 0.8 %
    assert thick.sd / thick.value == pytest.approx(np.hypot(0.02, 2 * NOISE / 8**0.5), rel=0.05)
    assert scale.sd / scale.value == pytest.approx(np.hypot(0.008, 2 * NOISE / 8**0.5), rel=0.05)
    for c in (found, thick, scale):
        assert c.interval is not None
        assert (c.interval[1] - c.interval[0]) / c.sd == pytest.approx(2 * 1.96, rel=0.05)


def test_what_a_file_leaves_out_is_known_as_usual() -> None:
    f = cb.forward(parse_specimen(ONE, "x"), n_modes=8).frequencies.tolist()
    text = f"{ONE}\n[measurement]\nfrequencies_hz = {f}\nrelative_std = {NOISE}\n"
    found = cb.identify(parse_specimen(text, "x"), seed=1, residuals="whitened").constants["E1"]
    # E goes with rho / h^2 and with sides to the fourth: 1 % of density and of thickness, 0.1 % of sides
    assert found.sd / found.value == pytest.approx(np.sqrt(0.02**2 + 0.01**2), rel=0.05)


def test_a_constant_of_which_the_list_says_little_keeps_what_was_known_of_it() -> None:
    known = PLATE.replace("nu12 = 0.33\n", "nu12 = 0.33\n\n[material.sd]\nnu12 = 0.003\n", 1)
    found = identified(known, 0.0, relative_std=0.02).constants["nu12"]
    assert found.value == pytest.approx(0.33, abs=0.002)
    assert found.sd == pytest.approx(0.003, rel=0.1)


@pytest.mark.slow
def test_on_the_panel_of_the_readme_it_holds_the_truth_and_answers_as_the_diagnosis_does() -> None:
    panel = str(Path(__file__).parents[2] / "examples" / "panel.toml")
    truth = {"E1": 136.5e9, "E2": 8.8e9, "G12": 4.62e9, "nu12": 0.32}
    found = cb.identify(panel, seed=0, residuals="whitened").constants
    diagnosis = diagnosed([plate_case(cb.read_plate(panel))], ["frequency_scale"], gain=False)
    for name, true in truth.items():
        one, (mean, sd, _, _) = found[name], diagnosis.averaged[name]
        assert one.interval is not None
        assert one.interval[0] < true < one.interval[1]
        assert one.value == pytest.approx(mean, abs=0.25 * sd)
        assert one.sd == pytest.approx(sd, rel=0.2)
