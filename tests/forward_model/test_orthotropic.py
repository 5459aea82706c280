"""Plies of any order of moduli: woven fabrics, wood, plywood."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import cpam_bayes as cb
from cpam_bayes.forward_model.model import plate_problem
from cpam_bayes.forward_model.preconditions import exchange_notices
from cpam_bayes.mechanics.convergence import Tolerance
from cpam_bayes.plate.laminate import flexural_constants
from cpam_bayes.render.notices import sentence_of
from tests.plate_file import described
from tests.plates import frequencies

FABRIC = {"E1_GPa": 62.0, "E2_GPa": 62.0, "nu12": 0.05, "G12_GPa": 4.2, "G13_GPa": 3.5, "G23_GPa": 3.0}
SPRUCE = {"E1_GPa": 11.2, "E2_GPa": 0.91, "nu12": 0.51, "G12_GPa": 0.72}
ACROSS = {"E1_GPa": 0.91, "E2_GPa": 11.2, "nu12": 0.04, "G12_GPa": 0.72, "G13_GPa": 0.1, "G23_GPa": 0.6}
TIGHT = Tolerance(kept=1e-6, rich=1e-6)


def orthotropic(
    constants: dict[str, float],
    size: tuple[float, float, float] = (300.0, 200.0, 4.0),
    layup: str = "[0]",
    edges: str = "FFFF",
    **tables: Any,
) -> dict[str, Any]:
    material = {"symmetry": "orthotropic", **constants}
    return described(size, 450.0, material, layup=layup, edges=edges, **tables)


def axes_exchanged(constants: dict[str, float]) -> dict[str, float]:
    """The same ply with its axis 1 called 2: nu21 = nu12 E2 / E1, G13 and G23 change places."""
    exchanged = dict(constants)
    exchanged["E1_GPa"], exchanged["E2_GPa"] = constants["E2_GPa"], constants["E1_GPa"]
    exchanged["nu12"] = constants["nu12"] * constants["E2_GPa"] / constants["E1_GPa"]
    g13, g23 = (constants.get(key, constants["G12_GPa"]) for key in ("G13_GPa", "G23_GPa"))
    return exchanged | {"G13_GPa": g23, "G23_GPa": g13}


def lowest(plate: dict[str, Any], n_modes: int = 8) -> np.ndarray:
    return frequencies(plate_problem(cb.read_plate(plate)), n_modes, TIGHT)


def stiffness(constants: dict[str, float], layup: str) -> np.ndarray:
    return np.asarray(plate_problem(cb.read_plate(orthotropic(constants, layup=layup))).nominal.stiffness())


@pytest.mark.parametrize(
    ("constants", "layup", "turned"),
    [
        (FABRIC, "[0/45]_s", "[90/-45]_s"),
        (SPRUCE, "[0]", "[90]"),
        (ACROSS, "[0/90/0]", "[90/0/90]"),
        (ACROSS, "[0/30]", "[90/-60]"),
    ],
)
def test_exchanged_axes_are_plies_turned_by_90_degrees(
    constants: dict[str, float], layup: str, turned: str
) -> None:
    as_given, exchanged = stiffness(constants, layup), stiffness(axes_exchanged(constants), turned)
    np.testing.assert_allclose(exchanged, as_given, rtol=1e-12, atol=1e-12 * np.abs(as_given).max())


@pytest.mark.parametrize("constants", [FABRIC, SPRUCE, ACROSS], ids=["fabric", "spruce", "across"])
def test_a_thin_simply_supported_plate_has_the_frequencies_of_kirchhoff(constants: dict[str, float]) -> None:
    a, b, rho = 0.3, 0.2, 450.0

    def over_thickness(h: float) -> np.ndarray:
        return lowest(orthotropic(constants, (300.0, 200.0, 1e3 * h), edges="SSSS"), 5) / h

    h = 1.2e-3
    # shear deformation lowers them in proportion to (h / a)^2: extrapolated away with two thicknesses
    thin = (4.0 * over_thickness(h / 2) - over_thickness(h)) / 3.0
    e1, e2, g12 = (1e9 * constants[key] for key in ("E1_GPa", "E2_GPa", "G12_GPa"))
    nu12 = constants["nu12"]
    scale = 12.0 * rho * (1.0 - nu12**2 * e2 / e1)
    d11, d22, d12, d66 = e1 / scale, e2 / scale, nu12 * e2 / scale, g12 / (12.0 * rho)
    exact = sorted(
        0.5
        * np.pi
        * np.sqrt(d11 * (m / a) ** 4 + 2 * (d12 + 2 * d66) * (m * n / a / b) ** 2 + d22 * (n / b) ** 4)
        for m in range(1, 9)
        for n in range(1, 9)
    )[:5]
    np.testing.assert_allclose(thin, exact, rtol=5e-6)


@pytest.mark.parametrize("constants", [FABRIC, SPRUCE, ACROSS], ids=["fabric", "spruce", "across"])
def test_ritz_and_finite_elements_agree(constants: dict[str, float]) -> None:
    plate = orthotropic(constants, (150.0, 100.0, 4.0), "[0/90/0]", "CFFF")
    ritz, fem = (cb.forward(plate, solver=solver, n_modes=5) for solver in ("ritz", "fem"))
    allowed = ritz.error + fem.error
    assert allowed.max() < 5e-3
    assert np.all(np.abs(fem.frequencies / ritz.frequencies - 1.0) <= allowed)


def test_a_balanced_fabric_has_one_modulus_along_both_axes_and_another_between() -> None:
    def flexural(layup: str) -> dict[str, float]:
        return flexural_constants(stiffness(FABRIC, layup), 0.004)

    along, across, between = (flexural(layup) for layup in ("[0]", "[90]", "[45]"))
    e, nu, g = 62e9, FABRIC["nu12"], 4.2e9
    assert along["Ex"] == pytest.approx(across["Ex"], rel=1e-12)
    assert along["Ex"] == pytest.approx(e, rel=1e-12)
    # Jones, eq. 2.97 at 45 degrees
    assert between["Ex"] == pytest.approx(4.0 / (2.0 * (1.0 - nu) / e + 1.0 / g), rel=1e-12)


BOTH = {"E1_GPa": [5.0, 80.0], "E2_GPa": [5.0, 80.0], "nu12": [0.0, 0.3], "G12_GPa": [2.0, 8.0]}
LIST = {"frequencies_hz": [100.0, 200.0, 300.0, 400.0, 500.0]}
SQUARE = (200.0, 200.0, 3.0)


@pytest.mark.parametrize(
    ("plate", "said"),
    [
        (orthotropic(FABRIC, SQUARE, unknowns=BOTH, measurement=LIST), "the plate is square"),
        (orthotropic(FABRIC, layup="[?/?]_s", unknowns=BOTH, measurement=LIST), "ply angles are unknown"),
        (orthotropic(FABRIC, unknowns=BOTH, measurement=LIST), None),
        (orthotropic(FABRIC, layup="[0/?]_s", unknowns=BOTH, measurement=LIST), None),
        (orthotropic(FABRIC, SQUARE, edges="CFFF", unknowns=BOTH, measurement=LIST), None),
        (orthotropic(FABRIC, SQUARE, unknowns=BOTH | {"E2_GPa": [1.0, 5.0]}, measurement=LIST), None),
        (
            orthotropic(
                FABRIC, SQUARE, unknowns=BOTH, measurement=LIST | {"labels": ["", "(2,0)", "", "", ""]}
            ),
            None,
        ),
    ],
    ids=["square", "unknown angles", "oblong", "one known angle", "clamped", "bounds apart", "labelled"],
)
def test_moduli_that_can_change_places_are_said_to(plate: dict[str, Any], said: str | None) -> None:
    notices = exchange_notices(cb.read_plate(plate))
    assert len(notices) == (said is not None)
    assert said is None or said in sentence_of(notices[0])
