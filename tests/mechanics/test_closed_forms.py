"""The forward solver against closed forms and published values."""

from __future__ import annotations

import numpy as np
import pytest

from cpam_bayes.mechanics.convergence import Tolerance
from cpam_bayes.mechanics.problem import Problem
from cpam_bayes.plate.laminate import ENERGY_CONSISTENT
from tests.plates import CARBON, CROSS_PLY_16S, GLASS, frequencies, plate

TIGHT = Tolerance(kept=1e-6, rich=1e-6)


def navier(problem: Problem, n_modes: int, highest: int = 12) -> np.ndarray:
    """Frequencies of a simply supported cross-ply plate, Navier's solution of the Mindlin equations.

    u = U cos(ax) sin(by), v = V sin cos, w = W sin sin, phi_x = X cos sin, phi_y = Y sin cos make
    every generalised strain one trigonometric product, so each (m, n) is a 5 x 5 eigenproblem
    (Reddy, Mechanics of Laminated Composite Plates, section 7.2), in-plane modes included.
    """
    state = problem.nominal
    c, h = state.stiffness(), float(state.thickness)
    inertia = float(state.density) * h * np.array([1, 1, 1, h * h / 12, h * h / 12])
    found = []
    for m in range(highest + 1):
        for n in range(highest + 1):
            a, b = m * np.pi / float(state.length), n * np.pi / float(state.width)
            strain = np.zeros((8, 5))
            strain[0, 0], strain[1, 1], strain[2, 0], strain[2, 1] = -a, -b, b, a
            strain[3, 3], strain[4, 4], strain[5, 3], strain[5, 4] = -a, -b, b, a
            strain[6, 2], strain[6, 4], strain[7, 2], strain[7, 3] = b, 1, a, 1
            present = [n > 0, m > 0, m > 0 and n > 0, n > 0, m > 0]
            if not any(present):
                continue
            k = (strain.T @ c @ strain)[np.ix_(present, present)]
            scale = 1 / np.sqrt(inertia[present])
            found.append(np.linalg.eigvalsh(k * scale[:, None] * scale))
    return np.sqrt(np.sort(np.concatenate(found))[:n_modes]) / (2 * np.pi)


@pytest.mark.parametrize(
    ("layup", "thickness"),
    [
        ((0.0,), 0.001),
        ((0.0,), 0.02),
        (CROSS_PLY_16S, 0.0032),
        (CROSS_PLY_16S, 0.03),
        ((0.0, 90.0), 0.004),
        ((0.0, 90.0), 0.03),
    ],
    ids=["orthotropic-thin", "orthotropic-thick", "cross-thin", "cross-thick", "B-thin", "B-thick"],
)
def test_simply_supported_plate_matches_navier(layup: tuple[float, ...], thickness: float) -> None:
    # in the thick cases in-plane modes are among the first 20
    problem = plate(0.3, 0.2, thickness, 1600.0, CARBON, layup, "SSSS", ENERGY_CONSISTENT)
    np.testing.assert_allclose(frequencies(problem, 20, TIGHT), navier(problem, 20), rtol=2e-6)


def test_exact_in_plane_modes_of_a_simply_supported_plate_are_found() -> None:
    problem = plate(0.3, 0.2, 0.06, 1600.0, GLASS, (0.0,), "SSSS")
    own = problem.nominal
    shear_wave = np.sqrt(GLASS["G12"] / 1600.0)
    exact = [shear_wave / (2 * 0.3), shear_wave / (2 * 0.2)]  # v = sin(pi x / a), u = sin(pi y / b)
    assert own.stiffness()[2, 2] == pytest.approx(GLASS["G12"] * 0.06)
    found = frequencies(problem, 12, TIGHT)
    for f in exact:
        assert np.min(np.abs(found / f - 1)) < 1e-6


def test_thin_simply_supported_orthotropic_plate_tends_to_kirchhoff() -> None:
    # error of shear deformation falls like (h / a)^2: extrapolated away with two thicknesses
    a, b = 0.3, 0.2

    def parameter(h: float) -> np.ndarray:
        problem = plate(a, b, h, 1600.0, CARBON, (0.0,), "SSSS")
        return frequencies(problem, 4, TIGHT) / h

    h = 0.001
    thin = (4 * parameter(h / 2) - parameter(h)) / 3
    d = plate(a, b, 1.0, 1600.0, CARBON).nominal.stiffness()
    exact = sorted(
        np.pi
        / 2
        * np.sqrt(
            (
                d[3, 3] * (m / a) ** 4
                + 2 * (d[3, 4] + 2 * d[5, 5]) * (m * n / a / b) ** 2
                + d[4, 4] * (n / b) ** 4
            )
            / 1600.0
        )
        for m in range(1, 6)
        for n in range(1, 6)
    )[:4]
    np.testing.assert_allclose(thin, exact, rtol=2e-6)


LEISSA = {
    "FFFF": [13.468, 19.596, 24.270, 34.801, 34.801, 61.093],
    "CFFF": [3.4711, 8.5062, 21.284, 27.199, 30.955, 54.187],
}


@pytest.mark.parametrize("edges", LEISSA)
def test_isotropic_square_tends_linearly_in_h_to_leissa(edges: str) -> None:
    # The twisting layer of a free edge makes the Mindlin frequencies approach Kirchhoff's linearly
    # in h / a. Leissa (1973) prints upper bounds of 5 digits from a Ritz basis of 36 terms, which
    # are up to 0.15 % high for the cantilever; the free square's are converged to the last digit.
    def parameter(h: float) -> np.ndarray:
        problem = plate(1.0, 1.0, h, 1000.0, {"E1": 70e9, "nu12": 0.3}, (0.0,), edges)
        d = problem.nominal.stiffness()[3, 3]
        return 2 * np.pi * frequencies(problem, 6, Tolerance(2e-5, 1e-5)) * np.sqrt(1000.0 * h / d)

    thick, thin = parameter(0.01), parameter(0.005)
    kirchhoff = 2 * thin - thick
    np.testing.assert_allclose(kirchhoff, LEISSA[edges], rtol=1e-3 if edges == "FFFF" else 2e-3)
    assert np.all(thick < thin), "shear deformation lowers every frequency"


CONVERGED_HZ = {
    "C1": [100.366, 298.584, 324.574, 360.347, 381.139, 600.611],
    "A2": [40.9165, 90.673, 240.069, 276.238, 340.704, 566.456],
    "D1": [1351.155, 3015.301, 3150.239, 4044.149, 4055.798, 6775.498, 8143.114, 8273.099,
           8849.348, 9154.067],
}  # fmt: skip
THIN_AND_THICK = {
    "C1": plate(0.26, 0.26, 0.0032, 1590.0, CARBON, CROSS_PLY_16S),
    "A2": plate(0.25, 0.28, 0.003, 2700.0, {"E1": 69e9, "nu12": 0.33}, (0.0,), "CFFF"),
    "D1": plate(0.101, 0.053, 0.0035, 1550.0, CARBON | {"G23": 3.0e9}, (0.0,) * 20),
}


@pytest.mark.parametrize("name", CONVERGED_HZ)
def test_converged_references_are_met(name: str) -> None:
    # references: two bases of an independent program agree to 2e-6 (shear factor 5/6)
    found = frequencies(THIN_AND_THICK[name], len(CONVERGED_HZ[name]))
    np.testing.assert_allclose(found, CONVERGED_HZ[name], rtol=2e-4 if name != "D1" else 5e-4)
