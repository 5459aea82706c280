"""An accelerometer of 5 % of the plate's mass that the plate file leaves out: no screen is calm about it."""

from __future__ import annotations

import numpy as np
import pytest

import cpam_bayes as cb

TRUE_E1 = 121.2
PLATE = {
    "name": "accelerometer left out",
    "plate": {
        "length_mm": 260.0,
        "width_mm": 190.0,
        "thickness_mm": 3.2,
        "density_kg_m3": 1590.0,
        "layup": "[(0/90)_8]_s",
        "edges": "FFFF",
    },
    "material": {
        "isotropic": False,
        "E1_GPa": TRUE_E1,
        "E2_GPa": 9.34,
        "nu12": 0.23,
        "G12_GPa": 6.25,
        "sd": {"E1_GPa": 12.0, "E2_GPa": 0.93, "nu12": 0.03, "G12_GPa": 0.63},
    },
    "unknowns": {
        "E1_GPa": [50.0, 200.0],
        "E2_GPa": [5.0, 20.0],
        "nu12": [0.15, 0.4],
        "G12_GPa": [3.0, 12.0],
    },
}
# 12.6 g on a plate of 251 g
SENSOR = {"mass_g": 12.6, "x_mm": 190.0, "y_mm": 130.0}


@pytest.fixture(scope="module")
def loaded() -> np.ndarray:
    """Frequencies of the plate with the accelerometer, Hz."""
    return cb.forward({**PLATE, "sensor": [SENSOR]}, n_modes=8).frequencies


def without_sensor(frequencies: np.ndarray) -> dict[str, object]:
    listed = [round(float(f), 1) for f in frequencies]
    return {**PLATE, "measurement": {"frequencies_hz": listed, "resolution_hz": 0.1}}


def test_identify_asks_for_it_and_does_not_miss_the_truth(loaded: np.ndarray) -> None:
    said = cb.identify(without_sensor(loaded), seed=0).in_words()
    assert "accelerometer" in said.next_steps[0]
    assert any("the plate model may lack something" in warning for warning in said.warnings)
    assert any("nothing attached to the plate" in sentence for sentence in said.basis)
    e1 = said.constants[0]
    assert e1.interval is not None
    assert e1.interval[0] < TRUE_E1 < e1.interval[1]


@pytest.mark.slow
def test_diagnose_names_it_in_exact_frequencies(loaded: np.ndarray) -> None:
    said = cb.diagnose(without_sensor(loaded), next_test="never").in_words()
    assert said.headline.startswith("The plate model lacks one thing: accelerometer or other added mass")
    e1 = said.constants[0]
    assert e1.interval is not None
    assert e1.interval[0] < TRUE_E1 < e1.interval[1]


@pytest.mark.slow
def test_diagnose_is_not_calm_about_it_in_noise(loaded: np.ndarray) -> None:
    noise = 0.006 * np.random.default_rng(4).standard_normal(len(loaded))
    said = cb.diagnose(without_sensor(loaded * (1.0 + noise)), next_test="never").in_words()
    everything = " ".join((said.headline, *said.basis, *said.next_steps))
    assert "accelerometer" in everything
    if said.headline.startswith("No evidence"):
        assert "An error may be there all the same" in said.headline
    e1 = said.constants[0]
    assert e1.interval is not None
    assert e1.interval[0] < TRUE_E1 < e1.interval[1]
