"""Constants of two materials from the frequencies of one plate, computed at known constants."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

import cpam_bayes as cb
from cpam_bayes.inference.swarm import material_swarm
from tests.hybrids import HYBRID, hybrid

# Frequencies of tests.hybrids.HYBRID at these constants, GPa: the reference is another.
TRUTH = {"carbon.E1": 128.0, "carbon.E2": 8.6, "glass.E1": 43.0}


@pytest.fixture(scope="module")
def measured() -> dict[str, Any]:
    plate = hybrid()
    for name, value in TRUTH.items():
        material, constant = name.split(".")
        plate["material"][material] = {**plate["material"][material], f"{constant}_GPa": value}
    # finite elements, so that the inverse problem is not solved by the model that made the list
    f = cb.forward(plate, n_modes=10, solver="fem").frequencies
    return {
        **HYBRID,
        "unknowns": {
            "carbon": {"E1_GPa": [80.0, 180.0], "E2_GPa": [5.0, 16.0]},
            "glass": {"E1_GPa": [20.0, 60.0]},
        },
        "measurement": {
            "frequencies_hz": [round(float(v), 3) for v in f],
            "resolution_hz": 0.001,
            "relative_std": 0.001,
        },
    }


@pytest.mark.slow
def test_the_swarm_finds_the_constants_of_both_materials(measured: dict[str, Any]) -> None:
    result = cb.identify(measured, seed=0)
    found = result.to_dict()["constants"]
    assert list(found) == ["carbon.E1_GPa", "carbon.E2_GPa", "glass.E1_GPa"]
    for name, value in TRUTH.items():
        assert abs(found[f"{name}_GPa"]["value"] / value - 1.0) < 0.004
    json.dumps(result.to_dict(), allow_nan=False)
    shown = result.report()
    behind = str(shown.sections)
    assert "Young's modulus along the fibres, glass" in behind
    # no advice that a hybrid cannot follow
    assert "cpam-bayes diagnose" not in shown.summary.next_step + behind
    assert result.constants == cb.identify(measured, seed=0).constants


@pytest.mark.slow
def test_the_posterior_covers_the_constants_of_both_materials(
    measured: dict[str, Any], tmp_path: Any
) -> None:
    result = cb.sample(measured, seed=0)
    assert result.status == "converged"
    for name, constant in result.constants.items():
        assert abs(constant.value - 1e9 * TRUTH[name]) < 3.0 * constant.sd
    result.save(tmp_path)
    assert (tmp_path / "posterior.nc").exists()
    stored = result.to_arviz().posterior
    assert {"carbon.E1_GPa", "carbon.E2_GPa", "glass.E1_GPa"} <= set(stored.data_vars)
    assert stored["glass.E1_GPa"].attrs["unit"] == "GPa"
    # another layup of the same plies, from the stored draws
    other = hybrid(layup="[c0/g90/c90]_s", thickness_mm=1.75)
    predicted = cb.predict(tmp_path / "posterior.nc", other, n_modes=4)
    for name, value in TRUTH.items():
        material, constant = name.split(".")
        other["material"][material] = {**other["material"][material], f"{constant}_GPa": value}
    truth = cb.forward(other, n_modes=4).frequencies
    for mode, f in zip(predicted.modes, truth, strict=True):
        assert abs(mode.mean - f) < 4.0 * mode.sd + 2e-4 * f


@pytest.mark.slow
def test_unknown_angles_of_a_hybrid_are_found(measured: dict[str, Any]) -> None:
    plate = {**measured, "plate": {**measured["plate"], "layup": "[c0_2/g?/g?/c90]_s"}}
    plate["unknowns"] = {**plate["unknowns"], "angle_grid_deg": 45.0}
    angles = cb.identify(plate, seed=0).angles
    assert tuple(np.abs(angles.angles_deg)) == (45.0, 45.0)


def test_a_swarm_starts_within_the_constraints_of_each_material(measured: dict[str, Any]) -> None:
    plate = cb.read_plate(
        {
            **measured,
            "unknowns": {
                "glass": {"nu12": [0.1, 0.4], "E2_GPa": [5.0, 60.0], "E1_GPa": [5.0, 60.0]},
                "carbon": {"E1_GPa": [5.0, 60.0]},
            },
        }
    )
    swarm = material_swarm(plate.material, plate.unknowns, 200, np.random.default_rng(0))
    constants = plate.unknowns.mapping(swarm)
    assert plate.material.admissible(constants).all()
    assert np.all(constants["glass.E1"] >= constants["glass.E2"])
    assert constants["carbon.E1"].min() >= 9.34e9
