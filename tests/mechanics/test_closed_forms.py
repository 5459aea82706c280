"""The forward solver against closed forms, published values, and properties of any plate."""

import numpy as np
import pytest
import scipy.linalg

from cpam_bayes.effects import add_known_mass
from cpam_bayes.forward_model.model import NO_PARAMETERS, converged_model
from cpam_bayes.mechanics.convergence import Tolerance
from cpam_bayes.mechanics.dense import discretise_at
from cpam_bayes.mechanics.modes import solve
from cpam_bayes.mechanics.problem import Problem, Region
from cpam_bayes.mechanics.ritz import Quadrature, RitzSettings, ritz_space
from cpam_bayes.plate import read_specimen
from cpam_bayes.plate.edges import FIELDS
from cpam_bayes.plate.laminate import ENERGY_CONSISTENT
from tests.mechanics.test_problem import by_quadrature
from tests.plates import CARBON, CROSS_PLY_16S, frequencies, navier, plate

TIGHT = Tolerance(kept=1e-6, rich=1e-6)
LEISSA = {
    "FFFF": [13.468, 19.596, 24.270, 34.801, 34.801, 61.093],
    "CFFF": [3.4711, 8.5062, 21.284, 27.199, 30.955, 54.187],
}
TABLE_1 = {
    "ABAQUS": [160.0, 233.1, 297.3, 412.6, 412.6, 741.8],
    "ANSYS": [161.2, 231.9, 294.6, 413.7, 413.7, 728.6],
    "Rayleigh-Ritz": [163.2, 237.6, 299.9, 424.3, 424.3, 749.4],
}


def navier_of(problem: Problem, n_modes: int) -> np.ndarray:
    state = problem.nominal
    h = float(state.thickness)
    mass = float(state.density) * h * np.diag([1, 1, 1, h * h / 12, h * h / 12])
    return navier(state.stiffness(), mass, (float(state.length), float(state.width)), n_modes)


@pytest.mark.parametrize(
    ("layup", "thin", "thick"),
    [((0.0,), 0.001, 0.02), (CROSS_PLY_16S, 0.0032, 0.03), ((0.0, 90.0), 0.004, 0.03)],
    ids=["orthotropic", "cross", "unsymmetric"],
)
def test_simply_supported_plate_matches_navier(layup: tuple[float, ...], thin: float, thick: float) -> None:
    for thickness in (thin, thick):  # thick, in-plane modes are among the first 20
        problem = plate(0.3, 0.2, thickness, 1600.0, CARBON, layup, "SSSS", ENERGY_CONSISTENT)
        np.testing.assert_allclose(frequencies(problem, 20, TIGHT), navier_of(problem, 20), rtol=2e-6)


@pytest.mark.parametrize("edges", LEISSA)
def test_isotropic_square_tends_linearly_in_h_to_leissa(edges: str) -> None:
    # The twisting layer of a free edge makes the Mindlin frequencies approach Kirchhoff's linearly in h / a.
    # Leissa (1973) prints upper bounds of 5 digits from a Ritz basis of 36 terms, up to 0.15 % high for the
    # cantilever; the free square's are converged to the last digit.
    def parameter(h: float) -> np.ndarray:
        problem = plate(1.0, 1.0, h, 1000.0, {"E1": 70e9, "nu12": 0.3}, (0.0,), edges)
        d = problem.nominal.stiffness()[3, 3]
        return 2 * np.pi * frequencies(problem, 6, Tolerance(2e-5, 1e-5)) * np.sqrt(1000.0 * h / d)

    thick, thin = parameter(0.01), parameter(0.005)
    kirchhoff = 2 * thin - thick
    np.testing.assert_allclose(kirchhoff, LEISSA[edges], rtol=1e-3 if edges == "FFFF" else 2e-3)
    assert np.all(thick < thin), "shear deformation lowers every frequency"


@pytest.mark.parametrize("place", [(0.0, 0.0), (0.3, 0.2), (0.11, 0.07)])
def test_a_mass_is_a_rank_one_change_for_each_direction_of_motion(place: tuple[float, float]) -> None:
    mass, thickness, n = 0.05, 0.02, 8
    constants = CARBON | {"G13": 5.1e9, "G23": 3.0e9}
    bare = plate(0.3, 0.2, thickness, 1600.0, constants, (20.0, -65.0, 40.0), "FFFF", ENERGY_CONSISTENT)
    space = ritz_space("FFFF", bare.nominal, RitzSettings(7, 6, 1, True))
    k, m = by_quadrature(bare, space)
    rule = Quadrature(Region("point"), np.array([place]) / (0.3, 0.2), np.ones(1))
    for field in FIELDS:
        row = np.concatenate([space.evaluate(f, rule, "")[0] * float(f == field) for f in FIELDS])
        m += mass * (thickness**2 / 4 if field.startswith("phi") else 1.0) * np.outer(row, row)
    scale = 1.0 / np.sqrt(np.diagonal(m))
    lam = scipy.linalg.eigh(k * scale[:, None] * scale, m * scale[:, None] * scale, eigvals_only=True)
    expected = np.sqrt(lam[6 : 6 + n]) / (2 * np.pi)
    found, without = (
        solve(discretise_at(problem, space, {}), np.eye(1), np.eye(1), n).frequencies[0]
        for problem in (add_known_mass(bare, mass, *place), bare)
    )
    np.testing.assert_allclose(found, expected, rtol=1e-7)  # rounding: 1e-8 of the first eigenvalue
    assert np.min(expected / without) < 0.999, "the mass is felt"


def test_aluminium_plate_of_table_1_lies_within_the_published_solutions() -> None:
    model = converged_model(read_specimen("D&G"), NO_PARAMETERS, 6)
    found = model.predict(np.empty((1, 0))).frequencies[0]
    solutions = np.array(list(TABLE_1.values()))
    assert np.all(found > solutions.min(axis=0) - 0.05)  # printed to 0.1 Hz: half of it at either end
    assert np.all(found < solutions.max(axis=0) + 0.05)
    np.testing.assert_allclose(found, TABLE_1["ABAQUS"], rtol=0.01)  # the paper's own solver
    assert found[4] / found[3] - 1 < model.error[3] + model.error[4]  # the pair has one frequency
