"""Constants of hybrids and of orthotropic plies with moduli in any order, from frequencies of one plate."""

import json

import numpy as np
import pytest

import cpam_bayes as cb
from cpam_bayes.inference.swarm import material_swarm
from cpam_bayes.stacking.symmetry import plate_symmetries
from tests.hybrids import HYBRID, UNKNOWNS, hybrid
from tests.plate_file import described

# Frequencies of tests.hybrids.HYBRID at these constants, GPa; its reference differs.
TRUTH = {"carbon.E1": 128.0, "carbon.E2": 8.6, "glass.E1": 43.0}


def set_truth(plate):
    for name, value in TRUTH.items():
        material, constant = name.split(".")
        plate["material"][material] = {**plate["material"][material], f"{constant}_GPa": value}


@pytest.fixture(scope="module")
def measured():
    plate = hybrid()
    set_truth(plate)
    f = cb.forward(plate, n_modes=10, solver="fem").frequencies  # finite elements, not the model fitted
    listed = {"frequencies_hz": f.round(3).tolist(), "resolution_hz": 0.001, "relative_std": 0.001}
    return {**HYBRID, "unknowns": UNKNOWNS, "measurement": listed}


@pytest.mark.slow
def test_the_swarm_finds_the_constants_of_both_materials(measured):
    result = cb.identify(measured, seed=0)
    found = result.to_dict()["constants"]
    assert list(found) == ["carbon.E1_GPa", "carbon.E2_GPa", "glass.E1_GPa"]
    for name, value in TRUTH.items():
        assert abs(found[f"{name}_GPa"]["value"] / value - 1.0) < 0.004
    json.dumps(result.to_dict(), allow_nan=False)
    shown = result.report()
    assert "Young's modulus along the fibres, glass" in str(shown.sections)
    assert "cpam-bayes diagnose" in shown.summary.next_step


@pytest.mark.slow
@pytest.mark.weekly
def test_the_posterior_covers_the_constants_of_both_materials(measured, tmp_path):
    result = cb.sample(measured, seed=0)
    assert result.status == "converged"
    for name, constant in result.constants.items():
        assert abs(constant.value - 1e9 * TRUTH[name]) < 3.0 * constant.sd
    result.save(tmp_path)
    assert (tmp_path / "posterior.nc").exists()
    stored = result.to_arviz().posterior
    assert {"carbon.E1_GPa", "carbon.E2_GPa", "glass.E1_GPa"} <= set(stored.data_vars)
    assert stored["glass.E1_GPa"].attrs["unit"] == "GPa"
    other = hybrid(layup="[c0/g90/c90]_s", thickness_mm=1.75)  # another layup, from the stored draws
    predicted = cb.predict(tmp_path / "posterior.nc", other, n_modes=4)
    set_truth(other)
    for mode, f in zip(predicted.modes, cb.forward(other, n_modes=4).frequencies, strict=True):
        assert abs(mode.mean - f) < 4.0 * mode.sd + 2e-4 * f


@pytest.mark.slow
def test_unknown_angles_and_the_sequence_of_a_hybrid_are_found(measured):
    plate = {**measured, "plate": {**measured["plate"], "layup": "[c0_2/g?/g?/c90]_s"}}
    plate["unknowns"] = {**plate["unknowns"], "angle_grid_deg": 45.0}
    assert tuple(np.abs(cb.identify(plate, seed=0).angles.angles_deg)) == (45.0, 45.0)
    found = cb.sequence(plate, seed=0)
    assert tuple(np.abs(found.answer.top[0])) == (45.0, 45.0)
    assert found.answer.probability[0] * found.answer.multiplicity[0] > 0.99
    assert "carbon.E1" in found.summary()
    for name, value in TRUTH.items():
        mean, sd = (found.to_dict()["constants"][f"{name}_GPa"][key] for key in ("mean", "sd"))
        assert abs(mean - value) < 3.0 * sd


@pytest.mark.parametrize(("layup", "turns"), [("[c?/g0/c?]", True), ("[c?/c0/g?]", False)])
def test_turned_upside_down_a_hybrid_is_another_plate_where_its_plies_differ(layup, turns):
    symmetries = plate_symmetries(cb.read_plate(hybrid(layup=layup, thickness_mm=0.875)))
    assert any("upside down" in s.name for s in symmetries) is turns


def test_a_swarm_starts_within_the_constraints_of_each_material(measured):
    glass = {"nu12": [0.1, 0.4], "E2_GPa": [5.0, 60.0], "E1_GPa": [5.0, 60.0]}
    plate = cb.read_plate({**measured, "unknowns": {"glass": glass, "carbon": {"E1_GPa": [5.0, 60.0]}}})
    swarm = material_swarm(plate.material, plate.unknowns, 200, np.random.default_rng(0))
    constants = plate.unknowns.mapping(swarm)
    assert plate.material.admissible(constants).all()
    assert np.all(constants["glass.E1"] >= constants["glass.E2"])
    assert constants["carbon.E1"].min() >= 9.34e9


# Spruce with its grain along x, and the same sheet with axis 1 across the grain.
GRAIN_1 = {"E1_GPa": 11.0, "E2_GPa": 0.9, "nu12": 0.53, "G12_GPa": 0.75, "G13_GPa": 0.6, "G23_GPa": 0.1}
GRAIN_2 = GRAIN_1 | {"E1_GPa": 0.9, "E2_GPa": 11.0, "nu12": 0.53 * 0.9 / 11.0, "G13_GPa": 0.1, "G23_GPa": 0.6}
CUT = "nu12 < 0.5, a positive definite stiffness, first of eq. (9)"


def sheet(constants, layup, kind="orthotropic", **tables):
    return described((400.0, 160.0, 3.0), 430.0, {"symmetry": kind, **constants}, layup=layup, **tables)


def around(constants):
    bounds = {key: [0.5 * constants[key], 2.0 * constants[key]] for key in ("E1_GPa", "E2_GPa", "G12_GPa")}
    return bounds | {"nu12": [0.0, 0.9]}


@pytest.fixture(scope="module")
def of_spruce():
    f = cb.forward(sheet(GRAIN_1, "[0]"), n_modes=8).frequencies
    return {"frequencies_hz": [round(float(v), 2) for v in f], "relative_std": 0.002}


@pytest.mark.slow
@pytest.mark.parametrize(("known", "layup"), [(GRAIN_1, "[0]"), (GRAIN_2, "[90]")], ids=["along", "across"])
def test_the_constants_of_spruce_are_found_in_either_order(of_spruce, known, layup):
    point = cb.identify(sheet(known, layup, unknowns=around(known), measurement=of_spruce))
    assert point.notices == ()
    for constant in point.estimate.constants:
        truth = point.specimen.material.complete()[constant.name]
        assert abs(constant.value - truth) < 0.5 * constant.sd  # only rounding, far below the stated noise


@pytest.mark.slow
def test_a_constraint_in_the_way_is_named_by_swarm_and_posterior(of_spruce):
    reference = {key: GRAIN_1[key] for key in ("E1_GPa", "E2_GPa", "G12_GPa")} | {"nu12": 0.4}
    tables = {"unknowns": around(reference), "measurement": of_spruce}
    plate = sheet(reference, "[0]", "transversely_isotropic", **tables)
    point, posterior = cb.identify(plate), cb.sample(plate)
    assert [n.facts["constraint"].text for n in point.notices] == [CUT]
    assert [n.facts["constraint"].text for n in posterior.notices if n.code == "cut_posterior"] == [CUT]
    for document in (point.to_dict(), posterior.to_dict()):
        assert any(CUT in warning for warning in document["warnings"])
