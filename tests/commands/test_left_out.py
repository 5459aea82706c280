"""An accelerometer of 5 % of the plate's mass that the plate file leaves out: no screen is calm about it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import cpam_bayes as cb
from tests.plate_file import Run, described

PROJECT = Path(__file__).parent.parent.parent
TRUE_E1 = 121.2
CONSTANTS = {"E1_GPa": TRUE_E1, "E2_GPa": 9.34, "nu12": 0.23, "G12_GPa": 6.25}
PLATE = described(
    (260.0, 190.0, 3.2),
    1590.0,
    {**CONSTANTS, "sd": {"E1_GPa": 12.0, "E2_GPa": 0.93, "nu12": 0.03, "G12_GPa": 0.63}},
    layup="[(0/90)_8]_s",
    unknowns={"E1_GPa": [50, 200], "E2_GPa": [5, 20], "nu12": [0.15, 0.4], "G12_GPa": [3, 12]},
)
# 12.6 g on a plate of 251 g
SENSOR = {"mass_g": 12.6, "x_mm": 190.0, "y_mm": 130.0}


@pytest.fixture(scope="module")
def loaded() -> np.ndarray:
    """Frequencies of the plate with the accelerometer, Hz."""
    return cb.forward({**PLATE, "sensor": [SENSOR]}, n_modes=8).frequencies


def without_sensor(frequencies: np.ndarray) -> dict[str, object]:
    listed = [round(float(f), 1) for f in frequencies]
    return {**PLATE, "measurement": {"frequencies_hz": listed, "resolution_hz": 0.1}}


@pytest.mark.slow
def test_identify_asks_for_it_and_does_not_miss_the_truth(loaded: np.ndarray) -> None:
    found = cb.identify(without_sensor(loaded), seed=0)
    assert "cpam-bayes diagnose" in found.report().summary.next_step
    assert "accelerometer" in str(found.report().sections)
    assert any(notice.code == "high_noise" for notice in found.notices)
    interval = found.constants["E1"].interval
    assert interval is not None
    assert interval[0] < 1e9 * TRUE_E1 < interval[1]


def contains_the_truth(found: cb.DiagnosisResult) -> bool:
    e1 = found.to_dict()["constants"]["E1_GPa"]
    return bool(e1["q025"] < TRUE_E1 < e1["q975"])


@pytest.mark.slow
@pytest.mark.weekly
def test_diagnose_leads_with_it_in_exact_frequencies(loaded: np.ndarray) -> None:
    found = cb.diagnose(without_sensor(loaded), next_test="never")
    # eight frequencies without a stated noise: a mass of another form than a point may be a misreading
    assert found.claim in ("named", "class")
    assert found.causes[0] == "sensor_mass"
    said = found.report().summary.headline.lower()
    assert "something heavy was on the plate" in said or "added mass" in said
    assert contains_the_truth(found)


@pytest.mark.slow
@pytest.mark.weekly
def test_diagnose_is_not_calm_about_it_in_noise(loaded: np.ndarray) -> None:
    noise = 0.006 * np.random.default_rng(4).standard_normal(len(loaded))
    found = cb.diagnose(without_sensor(loaded * (1.0 + noise)), next_test="never")
    if found.claim in ("none", "undecided"):
        assert any("forgotten mass" in line for line in found.report().summary.lines)
    assert contains_the_truth(found)


@pytest.mark.slow
def test_a_misfit_of_several_times_the_stated_noise_is_the_first_line(run: Run, tmp_path: Path) -> None:
    """One frequency with two digits swapped: the misfit is far below what a list of a wrong plate leaves."""
    text = (PROJECT / "examples" / "panel.toml").read_text("utf-8")
    right, wrong = tmp_path / "right.toml", tmp_path / "wrong.toml"
    right.write_text(text, "utf-8")
    wrong.write_text(text.replace("310.2", "301.2"), "utf-8")
    for path, expected in ((right, False), (wrong, True)):
        _, out, _ = run("identify", path, "--quiet")
        first = out.splitlines()[1]
        assert ("times the stated noise" in first) == expected
