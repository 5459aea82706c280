"""Hybrids and plies with moduli in any order, against closed forms, other discretisations and bricks."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import cpam_bayes as cb
from cpam_bayes.forward_model.calculix.run import solve_modes
from cpam_bayes.forward_model.model import plate_problem, reference_constants
from cpam_bayes.forward_model.preconditions import exchange_notices
from cpam_bayes.forward_model.three_dimensions import LIMIT, sandwich_error
from cpam_bayes.mechanics.convergence import Tolerance
from cpam_bayes.plate import Specimen
from cpam_bayes.render.notices import sentence_of
from tests.hybrids import CARBON, HYBRID, hybrid, isotropic, of_layers, sandwich
from tests.plate_file import described
from tests.plates import frequencies, navier

LAYERS = {
    "heavy faces": [(4.0, 70.0, 2700.0), (8.0, 10.0, 600.0), (4.0, 70.0, 2700.0)],
    "heavy core": [(4.0, 70.0, 500.0), (8.0, 10.0, 6000.0), (4.0, 70.0, 500.0)],
    "steel under aluminium": [(6.0, 210.0, 7800.0), (10.0, 70.0, 2700.0)],
    "heavy upper half": [(8.0, 70.0, 500.0), (8.0, 70.001, 5000.0)],
}
# Two halves of different density.
HALVES = of_layers([(3.0, isotropic(70.0, 500.0)), (3.0, isotropic(40.0, 5000.0))], (200.0, 150.0))
FABRIC = {"E1_GPa": 62.0, "E2_GPa": 62.0, "nu12": 0.05, "G12_GPa": 4.2, "G13_GPa": 3.5, "G23_GPa": 3.0}
SPRUCE = {"E1_GPa": 11.2, "E2_GPa": 0.91, "nu12": 0.51, "G12_GPa": 0.72}
ACROSS = {"E1_GPa": 0.91, "E2_GPa": 11.2, "nu12": 0.04, "G12_GPa": 0.72, "G13_GPa": 0.1, "G23_GPa": 0.6}
OBLONG, SQUARE = (300.0, 200.0, 4.0), (200.0, 200.0, 3.0)
BOTH = {"E1_GPa": [5.0, 80.0], "E2_GPa": [5.0, 80.0], "nu12": [0.0, 0.3], "G12_GPa": [2.0, 8.0]}
LISTED = {"frequencies_hz": [100.0, 200.0, 300.0, 400.0, 500.0]}


def coupled_navier(layers: list[tuple[float, float, float]], sides, shear: np.ndarray) -> np.ndarray:
    """Frequencies of a supported plate of isotropic layers with nu = 0.3, first-order theory, Hz.
    With all coupling and inertia (Reddy, Mechanics of Laminated Composite Plates and Shells, section 6.3).
    layers : thickness m, E Pa, density kg/m3, bottom to top. shear : A_s, N/m"""
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
    mass = np.diag([i0, i0, i0, i2, i2])
    mass[0, 3] = mass[3, 0] = mass[1, 4] = mass[4, 1] = i1
    return navier(stiffness, mass, sides, 12)


@pytest.mark.parametrize("layers", LAYERS.values(), ids=LAYERS)
def test_thick_layers_have_the_frequencies_of_navier(layers: list[tuple[float, float, float]]) -> None:
    plate = of_layers([(t, isotropic(e, rho)) for t, e, rho in layers], (200.0, 150.0), "SSSS")
    shear = np.real(plate_problem(cb.read_plate(plate)).nominal.stiffness())[6:, 6:]
    closed = coupled_navier([(1e-3 * t, 1e9 * e, rho) for t, e, rho in layers], (0.2, 0.15), shear)
    assert_allclose(lowest(plate, 5), closed[:5], rtol=1e-5)


def test_elements_agree_where_the_halves_weigh_differently() -> None:
    ritz, fem = (cb.forward(HALVES, n_modes=6, solver=s) for s in ("ritz", "fem"))  # type: ignore[arg-type]
    assert_allclose(fem.frequencies, ritz.frequencies, rtol=3e-4)


def test_a_deck_has_a_card_for_each_material(tmp_path: Any) -> None:
    deck = cb.export(HYBRID, tmp_path / "hybrid.inp", element="brick").deck.text
    assert deck.count("*MATERIAL, NAME=PLY_1") == deck.count("*MATERIAL, NAME=PLY_2") == 1
    assert "** material carbon" in deck
    assert "".join(re.findall(r"SOLID SECTION.*MATERIAL=PLY_(\d)", deck)) == "1221221"
    densities = [float(value) for value in re.findall(r"DENSITY\n(.*)", deck)]
    assert_allclose(densities, [1590.0, 1900.0], rtol=1e-9)
    shells = cb.export(HYBRID, tmp_path / "shells.inp").deck.text
    rows = shells.split("*SHELL SECTION")[1].splitlines()[1:8]
    assert [1e6 * float(row.split(",")[0]) for row in rows] == [500, 375, 375, 500, 375, 375, 500]


def ritz_and_bricks(specimen: Specimen, n_modes: int, in_plane: int) -> tuple[np.ndarray, np.ndarray]:
    bricks = solve_modes(specimen, reference_constants(specimen), n_modes, in_plane=in_plane)
    return cb.forward(specimen, n_modes=n_modes).frequencies, bricks.frequencies


@pytest.mark.needs_ccx
@pytest.mark.parametrize(
    ("plate", "n_modes", "in_plane", "tolerance"),
    [
        # free-edge layers between plies of different angles are not in the theory (docs/theory.md)
        pytest.param(HYBRID, 6, 200, 2e-3, marks=[pytest.mark.slow, pytest.mark.weekly]),
        (HALVES, 4, 110, 1e-3),
    ],
    ids=["hybrid", "halves"],
)
def test_bricks_agree(plate: dict[str, Any], n_modes: int, in_plane: int, tolerance: float) -> None:
    assert_allclose(*ritz_and_bricks(cb.read_plate(plate), n_modes, in_plane), rtol=tolerance)


def test_the_error_of_a_sandwich_does_not_depend_on_where_x_is() -> None:
    turned = hybrid(layup="[f0/s/f0]", thickness_mm=10.0)
    plies = (("f", "carbon", 1.0), ("s", "core", 8.0))
    turned["ply"] = [{"name": name, "material": of, "thickness_mm": t} for name, of, t in plies]
    turned["material"] = {"carbon": CARBON, "core": isotropic(0.05, 75.0)}
    along = sandwich_error(cb.read_plate(turned), [300.0, 900.0])
    turned["plate"]["layup"] = "[f90/s/f90]"
    assert_allclose(sandwich_error(cb.read_plate(turned), [300.0, 900.0]), along, rtol=1e-9)
    assert_allclose(sandwich_error(cb.read_plate(HYBRID), [100.0, 1000.0, 10_000.0]), 0.0)


def test_a_core_that_is_too_soft_is_warned_of() -> None:
    near, beyond, stiff = (
        [n.facts["error"] for n in cb.forward(sandwich(t, g), n_modes=4).notices if n.code == "soft_core"]
        for t, g in ((1.0, 0.05), (1.0, 0.005), (0.5, 1.0))
    )
    assert 0.0 < near[0] < LIMIT < beyond[0]
    assert stiff == []


@pytest.mark.needs_ccx
def test_the_error_of_a_sandwich_is_that_against_bricks() -> None:
    specimen = cb.read_plate(sandwich(1.0, 0.02))
    ritz, bricks = ritz_and_bricks(specimen, 4, 60)
    assert_allclose(1.0 - ritz / bricks, sandwich_error(specimen, ritz), rtol=0.4, atol=5e-4)


def test_the_saved_study_of_sandwiches_is_that_of_the_rule_as_it_is() -> None:
    """studies/22_sandwiches.py: bricks of 30 sandwiches, free and with a clamped edge."""
    path = Path(__file__).parents[2] / "studies" / "results" / "22_sandwiches.json"
    cases = json.loads(path.read_text("utf-8"))["cases"]
    ratios = []
    for case in (c for c in cases if c["thickness_mm"] == 10.0):
        plate = sandwich(case["face"] * 10.0, 70.0 / case["ratio"], case["edges"])
        ritz = [mode["ritz_hz"] for mode in case["modes"]]
        expected = 100.0 * sandwich_error(cb.read_plate(plate), ritz)
        assert_allclose(expected, [mode["expected_percent"] for mode in case["modes"]], rtol=1e-6, atol=1e-9)
        found = np.array([mode["too_low_percent"] for mode in case["modes"]])
        counted = (expected > 0.5) & (expected < 5.0)
        ratios += (found[counted] / expected[counted]).tolist()
    assert len(ratios) > 50
    assert max(ratios) < 2.0
    assert 0.7 < np.median(ratios) < 1.1


def orthotropic(constants: dict[str, float], size=OBLONG, **tables: Any) -> dict[str, Any]:
    return described(size, 450.0, {"symmetry": "orthotropic", **constants}, **tables)


def lowest(plate: dict[str, Any], n_modes: int) -> np.ndarray:
    return frequencies(plate_problem(cb.read_plate(plate)), n_modes, Tolerance(kept=1e-6, rich=1e-6))


@pytest.mark.parametrize("constants", [FABRIC, SPRUCE, ACROSS], ids=["fabric", "spruce", "across"])
def test_a_thin_simply_supported_plate_has_the_frequencies_of_kirchhoff(constants: dict[str, float]) -> None:
    a, b, rho = 0.3, 0.2, 450.0

    def over_thickness(h: float) -> np.ndarray:
        return lowest(orthotropic(constants, (300.0, 200.0, 1e3 * h), edges="SSSS"), 5) / h

    h = 1.2e-3
    thin = (4.0 * over_thickness(h / 2) - over_thickness(h)) / 3.0  # without shear, ~ (h / a)^2
    e1, e2, g12 = (1e9 * constants[key] for key in ("E1_GPa", "E2_GPa", "G12_GPa"))
    nu12 = constants["nu12"]
    scale = 12.0 * rho * (1.0 - nu12**2 * e2 / e1)
    d11, d22, d12, d66 = e1 / scale, e2 / scale, nu12 * e2 / scale, g12 / (12.0 * rho)
    m, n = (np.pi * k.ravel() for k in np.meshgrid(np.arange(1, 9) / a, np.arange(1, 9) / b))
    exact = np.sqrt(d11 * m**4 + 2 * (d12 + 2 * d66) * (m * n) ** 2 + d22 * n**4) / (2 * np.pi)
    assert_allclose(thin, np.sort(exact)[:5], rtol=5e-6)


def with_both_unknown(size: tuple[float, float, float] = OBLONG, **changes: Any) -> dict[str, Any]:
    return orthotropic(FABRIC, size, **{"unknowns": BOTH, "measurement": LISTED, **changes})


EXCHANGES = {
    "square": (with_both_unknown(SQUARE), "the plate is square"),
    "unknown angles": (with_both_unknown(layup="[?/?]_s"), "ply angles are unknown"),
    "oblong": (with_both_unknown(), None),
    "one known angle": (with_both_unknown(layup="[0/?]_s"), None),
    "clamped": (with_both_unknown(SQUARE, edges="CFFF"), None),
    "bounds apart": (with_both_unknown(SQUARE, unknowns=BOTH | {"E2_GPa": [1.0, 5.0]}), None),
    "labelled": (with_both_unknown(SQUARE, measurement=LISTED | {"labels": ["", "(2,0)", "", "", ""]}), None),
}


@pytest.mark.parametrize(("plate", "said"), EXCHANGES.values(), ids=EXCHANGES)
def test_moduli_that_can_change_places_are_said_to(plate: dict[str, Any], said: str | None) -> None:
    notices = exchange_notices(cb.read_plate(plate))
    assert len(notices) == (said is not None)
    assert said is None or said in sentence_of(notices[0])
