"""What is wrong with a plate of two materials is found as on a plate of one."""

from typing import Any

import numpy as np
import pytest

import cpam_bayes as cb
from cpam_bayes.effects.geometry import THICKNESS
from cpam_bayes.effects.masses import SENSOR_MASS
from cpam_bayes.effects.plies import MISORIENTATION, SHEAR_RATIO
from cpam_bayes.questions.diagnose.document import answer_constants
from tests.hybrids import HYBRID

UNKNOWNS = {
    "carbon": {"E1_GPa": [80.0, 180.0], "E2_GPa": [5.0, 16.0]},
    "glass": {"E1_GPa": [20.0, 60.0]},
}
NOISE = 0.001
# One draw of the noise, in its own unit.
DRAWN = np.array([0.4, -1.1, 0.2, 0.9, -0.5, 0.1, -0.3, 1.2, -0.7, 0.6])


def measured(sensors: list[dict[str, Any]], plate: dict[str, Any] = HYBRID) -> dict[str, Any]:
    """The plate with the list of finite elements that masses stand on, of which the file says nothing."""
    f = cb.forward({**plate, "sensor": sensors}, n_modes=len(DRAWN), solver="fem").frequencies
    noisy = [round(float(v), 2) for v in f * (1.0 + NOISE * DRAWN)]
    return {
        **plate,
        "unknowns": UNKNOWNS,
        "measurement": {"frequencies_hz": noisy, "resolution_hz": 0.01, "relative_std": NOISE},
    }


CAUSES = (SENSOR_MASS, THICKNESS, MISORIENTATION, SHEAR_RATIO)


@pytest.mark.slow
def test_an_added_mass_on_a_hybrid_is_found_with_its_size_and_place() -> None:
    # 9 g on a plate of some 310 g
    result = cb.diagnose(
        measured([{"mass_g": 9.0, "x_mm": 280.0, "y_mm": 185.0}]), catalogue=CAUSES, next_test="never"
    )
    assert (result.claim, result.diagnosis.causes[0].name) == ("named", SENSOR_MASS.name)
    size = result.to_dict()["hypotheses"][0]["parameters"][SENSOR_MASS.parameters[0].name]
    assert abs(size["mean"] - 9.0) < 3.0 * size["sd"]
    found = {constant.name: constant for constant in answer_constants(result.diagnosis)}
    for name, value in (("carbon.E1", 121.2e9), ("carbon.E2", 9.34e9), ("glass.E1", 40.1e9)):
        assert abs(found[name].value - value) < 3.0 * found[name].sd


@pytest.mark.slow
def test_of_a_hybrid_with_nothing_wrong_nothing_is_claimed() -> None:
    result = cb.diagnose(measured([]), catalogue=CAUSES, next_test="never")
    assert result.claim in ("none", "undecided")
    assert result.diagnosis.causes[0].name == "none"
    assert "carbon.E1" in result.summary()
