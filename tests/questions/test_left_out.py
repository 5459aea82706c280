"""An accelerometer of 5 % of the plate's mass, missing in the plate file, raises a warning everywhere."""

from pathlib import Path

import numpy as np
import pytest

import cpam_bayes as cb
from tests.plate_file import described

pytestmark = pytest.mark.slow

PANEL = Path(__file__).parents[2] / "examples" / "panel.toml"
TRUE_E1 = 121.2
SD = {"E1_GPa": 12.0, "E2_GPa": 0.93, "nu12": 0.03, "G12_GPa": 0.63}
CONSTANTS = {"E1_GPa": TRUE_E1, "E2_GPa": 9.34, "nu12": 0.23, "G12_GPa": 6.25, "sd": SD}
UNKNOWNS = {"E1_GPa": [50, 200], "E2_GPa": [5, 20], "nu12": [0.15, 0.4], "G12_GPa": [3, 12]}
PLATE = described((260.0, 190.0, 3.2), 1590.0, CONSTANTS, layup="[(0/90)_8]_s", unknowns=UNKNOWNS)
SENSOR = {"mass_g": 12.6, "x_mm": 190.0, "y_mm": 130.0}  # 12.6 g on a plate of 251 g


@pytest.fixture(scope="module")
def loaded():
    return cb.forward({**PLATE, "sensor": [SENSOR]}, n_modes=8).frequencies


def without_sensor(frequencies):
    listed = [round(float(f), 1) for f in frequencies]
    return {**PLATE, "measurement": {"frequencies_hz": listed, "resolution_hz": 0.1}}


def test_identify_asks_for_it_and_does_not_miss_the_truth(loaded):
    found = cb.identify(without_sensor(loaded), seed=0)
    assert "cpam-bayes diagnose" in found.report().summary.next_step
    assert "accelerometer" in str(found.report().sections)
    assert any(notice.code == "high_noise" for notice in found.notices)
    low, high = found.constants["E1"].interval
    assert low < 1e9 * TRUE_E1 < high


@pytest.mark.weekly
@pytest.mark.parametrize("noise", [0.0, 0.006])
def test_diagnose_leads_with_it_in_exact_frequencies_and_is_not_calm_in_noise(loaded, noise):
    noisy = loaded * (1.0 + noise * np.random.default_rng(4).standard_normal(len(loaded)))
    found = cb.diagnose(without_sensor(noisy), next_test="never")
    summary = found.report().summary
    if not noise:
        assert found.causes[0] == "sensor_mass"  # eight frequencies, no stated noise: it may look misread
        assert found.claim in ("named", "class")
        said = summary.headline.lower()
        assert "something heavy was on the plate" in said or "added mass" in said
    elif found.claim in ("none", "undecided"):
        assert any("forgotten mass" in line for line in summary.lines)
    e1 = found.to_dict()["constants"]["E1_GPa"]
    assert e1["q025"] < TRUE_E1 < e1["q975"]


def test_a_misfit_of_several_times_the_stated_noise_is_the_first_line(run, tmp_path):
    """One frequency with two digits exchanged: the misfit is far below that of a wrong plate."""
    path, text = tmp_path / "panel.toml", PANEL.read_text("utf-8")
    for listed, expected in ((text, False), (text.replace("310.2", "301.2"), True)):
        path.write_text(listed, "utf-8")
        _, out, _ = run("identify", path, "--quiet")
        assert ("times the stated noise" in out.splitlines()[1]) == expected
