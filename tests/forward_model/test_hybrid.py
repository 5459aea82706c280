"""Hybrid plates against closed forms, other discretisations and bricks."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.linalg
from numpy.testing import assert_allclose

import cpam_bayes as cb
from cpam_bayes.errors import PlateFileError
from cpam_bayes.forward_model.build import model_key
from cpam_bayes.forward_model.calculix import solve_modes
from cpam_bayes.forward_model.model import NO_PARAMETERS, plate_problem, reference_constants
from cpam_bayes.forward_model.reduced import DEFAULT_SETTINGS
from cpam_bayes.forward_model.theory_error import LIMIT, sandwich_error
from cpam_bayes.mechanics.convergence import Tolerance
from cpam_bayes.plate.laminate import ENERGY_CONSISTENT
from tests.hybrids import CARBON, GLASS, HYBRID, hybrid, isotropic, of_layers, sandwich
from tests.plates import frequencies

TIGHT = Tolerance(kept=1e-6, rich=1e-6)


def lowest(plate: dict[str, Any], n_modes: int) -> np.ndarray:
    return frequencies(plate_problem(cb.read_plate(plate)), n_modes, TIGHT)


@pytest.mark.parametrize("edges", ["FFFF", "CFFF"])
def test_a_hybrid_of_two_equal_materials_is_the_plain_plate(edges: str) -> None:
    plain = hybrid(layup="[0/45/-45/90]_s", edges=edges, density_kg_m3=1590.0, thickness_mm=2.0)
    plain["material"] = {k: v for k, v in CARBON.items() if k != "density_kg_m3"}
    del plain["ply"]
    both = hybrid(layup="[a0/b45/a-45/b90]_s", edges=edges, thickness_mm=2.0)
    both["ply"] = [{"name": n, "material": n, "thickness_mm": 0.25} for n in "ab"]
    both["material"] = {"a": CARBON, "b": CARBON}
    found, expected = (cb.forward(p, n_modes=8) for p in (both, plain))
    assert_allclose(
        found.frequencies, expected.frequencies, rtol=1e-6
    )  # rounding in stiffnesses of a thin plate
    assert [m.label for m in found.modes] == [m.label for m in expected.modes]


def navier(layers: list[tuple[float, float, float]], a: float, b: float, shear: np.ndarray) -> np.ndarray:
    """Frequencies of a supported plate of isotropic layers with nu = 0.3, first-order theory, Hz.

    u = U cos sin, v = V sin cos, w = W sin sin, phi_x = X cos sin, phi_y = Y sin cos solve it exactly (Reddy,
    Mechanics of Laminated Composite Plates and Shells, section 6.3), with all coupling and inertia.

    layers : thickness m, E Pa, density kg/m3, bottom to top. shear : A_s, N/m
    """
    thickness = np.array([t for t, _, _ in layers])
    z = np.concatenate(([0.0], np.cumsum(thickness))) - thickness.sum() / 2
    moments = np.array([np.diff(z**k) / k for k in (1, 2, 3)])
    q = np.array([e for _, e, _ in layers]) / (1 - 0.09)
    a_, b_, d_ = moments @ q
    i0, i1, i2 = moments @ np.array([rho for _, _, rho in layers])
    plane = np.array([[1.0, 0.3, 0.0], [0.3, 1.0, 0.0], [0.0, 0.0, 0.35]])
    stiffness = np.zeros((8, 8))
    stiffness[:6, :6] = np.block([[a_ * plane, b_ * plane], [b_ * plane, d_ * plane]])
    stiffness[6:, 6:] = shear
    found = []
    for m in range(1, 4):
        for n in range(1, 4):
            p, r = m * np.pi / a, n * np.pi / b
            strain = np.zeros((8, 5))  # amplitudes of the strains for U, V, W, X, Y
            for row, (i, j) in ((0, (0, 1)), (3, (3, 4))):
                strain[row, i], strain[row + 1, j] = -p, -r
                strain[row + 2, i], strain[row + 2, j] = r, p
            strain[6, 2], strain[6, 4] = r, 1.0
            strain[7, 2], strain[7, 3] = p, 1.0
            mass = np.diag([i0, i0, i0, i2, i2])
            mass[0, 3] = mass[3, 0] = mass[1, 4] = mass[4, 1] = i1
            found += scipy.linalg.eigh(strain.T @ stiffness @ strain, mass)[0].tolist()
    return np.sort(np.sqrt(found)) / (2 * np.pi)


@pytest.mark.parametrize(
    "layers",
    [
        pytest.param([(4.0, 70.0, 2700.0), (8.0, 10.0, 600.0), (4.0, 70.0, 2700.0)], id="heavy faces"),
        pytest.param([(4.0, 70.0, 500.0), (8.0, 10.0, 6000.0), (4.0, 70.0, 500.0)], id="heavy core"),
        pytest.param([(6.0, 210.0, 7800.0), (10.0, 70.0, 2700.0)], id="steel under aluminium"),
        pytest.param([(8.0, 70.0, 500.0), (8.0, 70.001, 5000.0)], id="heavy upper half"),
    ],
)
def test_thick_layers_have_the_frequencies_of_navier(layers: list[tuple[float, float, float]]) -> None:
    plate = of_layers([(t, isotropic(e, rho)) for t, e, rho in layers], (200.0, 150.0), "SSSS")
    shear = np.real(plate_problem(cb.read_plate(plate)).nominal.stiffness())[6:, 6:]
    closed = navier([(1e-3 * t, 1e9 * e, rho) for t, e, rho in layers], 0.2, 0.15, shear)
    # in-plane modes without a node across one side are not among those with m, n > 0
    found = lowest(plate, 5)
    assert all(np.abs(closed / f - 1.0).min() < 1e-5 for f in (found[0], found[1], found[2]))
    assert_allclose(found[0], closed[0], rtol=1e-5)


def test_elements_agree_where_the_halves_weigh_differently() -> None:
    plate = of_layers([(3.0, isotropic(70.0, 500.0)), (3.0, isotropic(40.0, 5000.0))], (200.0, 150.0))
    ritz, fem = (cb.forward(plate, n_modes=6, solver=s) for s in ("ritz", "fem"))  # type: ignore[arg-type]
    assert_allclose(fem.frequencies, ritz.frequencies, rtol=3e-4)


def test_a_deck_has_a_card_for_each_material(tmp_path: Any) -> None:
    deck = cb.export(HYBRID, tmp_path / "hybrid.inp", element="brick").deck.text
    assert deck.count("*MATERIAL, NAME=PLY_1") == deck.count("*MATERIAL, NAME=PLY_2") == 1
    assert "** material carbon" in deck
    sections = [line.split("MATERIAL=")[1] for line in deck.splitlines() if line.startswith("*SOLID SECTION")]
    assert [int(s.split(",")[0].removeprefix("PLY_")) for s in sections] == [1, 2, 2, 1, 2, 2, 1]
    densities = [
        float(b) for a, b in zip(deck.splitlines(), deck.splitlines()[1:], strict=False) if a == "*DENSITY"
    ]
    assert_allclose(densities, [1590.0, 1900.0], rtol=1e-9)
    shells = cb.export(HYBRID, tmp_path / "shells.inp").deck.text
    rows = shells.split("*SHELL SECTION")[1].splitlines()[1:8]
    assert [1e6 * float(row.split(",")[0]) for row in rows] == [500, 375, 375, 500, 375, 375, 500]


@pytest.mark.needs_ccx
@pytest.mark.slow
def test_bricks_agree() -> None:
    specimen = cb.read_plate(HYBRID)
    ritz = cb.forward(specimen, n_modes=6).frequencies
    bricks = solve_modes(specimen, reference_constants(specimen), 6, in_plane=200).frequencies
    # free-edge layers of plies turned against each other are not in the theory (docs/theory_error.md)
    assert_allclose(ritz, bricks, rtol=2e-3)


@pytest.mark.needs_ccx
def test_bricks_agree_where_the_halves_weigh_differently() -> None:
    plate = of_layers([(3.0, isotropic(70.0, 500.0)), (3.0, isotropic(40.0, 5000.0))], (200.0, 150.0))
    specimen = cb.read_plate(plate)
    ritz = cb.forward(specimen, n_modes=4).frequencies
    bricks = solve_modes(specimen, reference_constants(specimen), 4, in_plane=110).frequencies
    assert_allclose(ritz, bricks, rtol=1e-3)


def test_a_model_is_of_one_hybrid() -> None:
    def key(plate: dict[str, Any]) -> str:
        specimen = cb.read_plate(plate)
        return model_key(specimen, NO_PARAMETERS, 5, ENERGY_CONSISTENT, DEFAULT_SETTINGS, None)

    exchanged = hybrid(layup="[g0_2/c45/c-45/g90]_s", thickness_mm=3.25)
    heights = hybrid(thickness_mm=3.06)
    heights["ply"][0]["thickness_mm"] = 0.26
    dense = hybrid()
    dense["material"]["glass"] = {**GLASS, "density_kg_m3": 2000.0}
    assert len({key(plate) for plate in (HYBRID, exchanged, heights, dense)}) == 4


@pytest.mark.parametrize("question", [cb.diagnose, cb.sequence, cb.report])
def test_what_takes_plates_of_one_material_says_so(question: Any) -> None:
    plate = hybrid(layup="[c0/g?/g-45/c90]_s" if question is cb.sequence else HYBRID["plate"]["layup"])
    plate["plate"]["thickness_mm"] = 2.5 if question is cb.sequence else 3.0
    plate["unknowns"] = {"glass": {"E1_GPa": [20.0, 60.0]}}
    plate["measurement"] = {"frequencies_hz": [109.3, 202.1, 248.2]}
    with pytest.raises(PlateFileError) as error:
        question(plate)
    assert len(error.value.problems) == 1
    assert "equal plies of one material" in str(error.value)


# Sandwiches


def test_a_laminate_without_a_core_is_none() -> None:
    assert_allclose(sandwich_error(cb.read_plate(HYBRID), [100.0, 1000.0, 10_000.0]), 0.0)
    assert_allclose(sandwich_error(cb.read_plate("D1"), [1000.0, 10_000.0]), 0.0)


def test_the_error_of_a_sandwich_vanishes_with_the_frequency_and_grows_with_the_softness_of_the_core() -> (
    None
):
    f = np.array([1.0, 100.0, 1000.0])
    soft, stiff = (sandwich_error(cb.read_plate(sandwich(1.0, g)), f) for g in (0.02, 0.1))
    assert soft[0] < 1e-6
    assert np.all(np.diff(soft) > 0.0)
    assert np.all(stiff < soft)


def test_the_error_does_not_depend_on_where_x_is() -> None:
    core = isotropic(0.05, 75.0)
    turned = hybrid(layup="[f0/s/f0]", thickness_mm=10.0)
    turned["ply"] = [
        {"name": "f", "material": "carbon", "thickness_mm": 1.0},
        {"name": "s", "material": "core", "thickness_mm": 8.0},
    ]
    turned["material"] = {"carbon": CARBON, "core": core}
    along = sandwich_error(cb.read_plate(turned), [300.0, 900.0])
    turned["plate"]["layup"] = "[f90/s/f90]"
    assert_allclose(sandwich_error(cb.read_plate(turned), [300.0, 900.0]), along, rtol=1e-9)


def test_a_core_that_is_too_soft_is_warned_of() -> None:
    near, beyond, stiff = (
        [n.facts["error"] for n in cb.forward(sandwich(t, g), n_modes=4).notices if n.code == "soft_core"]
        for t, g in ((1.0, 0.05), (1.0, 0.005), (0.5, 1.0))
    )
    assert 0.0 < near[0] < LIMIT < beyond[0]
    assert stiff == []


@pytest.mark.needs_ccx
@pytest.mark.parametrize(("face_mm", "core_GPa"), [(1.0, 0.1), (1.0, 0.02), (2.0, 0.1)])
def test_the_error_of_a_sandwich_is_that_against_bricks(face_mm: float, core_GPa: float) -> None:
    specimen = cb.read_plate(sandwich(face_mm, core_GPa))
    ritz = cb.forward(specimen, n_modes=4).frequencies
    bricks = solve_modes(specimen, reference_constants(specimen), 4, in_plane=60).frequencies
    rule = sandwich_error(specimen, ritz)
    assert_allclose(1.0 - ritz / bricks, rule, rtol=0.4, atol=5e-4)


def test_the_saved_study_of_sandwiches_is_that_of_the_rule_as_it_is() -> None:
    """studies/22_sandwiches.py: bricks of 30 sandwiches, free and with a clamped edge."""
    path = Path(__file__).parents[2] / "studies" / "results" / "22_sandwiches.json"
    cases = json.loads(path.read_text("utf-8"))["cases"]
    ratios = []
    for case in cases:
        plate = sandwich(case["face"] * 10.0, 70.0 / case["ratio"], case["edges"])
        if case["thickness_mm"] != 10.0:
            continue
        ritz = [mode["ritz_hz"] for mode in case["modes"]]
        expected = 100.0 * sandwich_error(cb.read_plate(plate), ritz)
        assert_allclose(expected, [mode["expected_percent"] for mode in case["modes"]], rtol=1e-6, atol=1e-9)
        found = np.array([mode["too_low_percent"] for mode in case["modes"]])
        counted = (expected > 0.5) & (expected < 5.0)
        ratios += (found[counted] / expected[counted]).tolist()
    assert len(ratios) > 50
    assert max(ratios) < 2.0
    assert 0.7 < np.median(ratios) < 1.1
