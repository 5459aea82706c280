"""Plates built by hand for tests, without a plate file."""

from dataclasses import replace
from itertools import product

import numpy as np
import scipy.linalg

from cpam_bayes.mechanics.convergence import Tolerance, converge
from cpam_bayes.mechanics.modes import solve
from cpam_bayes.mechanics.problem import PlateState, Problem, bare_plate
from cpam_bayes.parameters import ParameterSet
from cpam_bayes.plate import Specimen, builtin
from cpam_bayes.plate.laminate import FIVE_SIXTHS, complete_constants, laminate_geometry

CARBON = {"E1": 121.2e9, "E2": 9.34e9, "nu12": 0.23, "G12": 6.25e9}
GLASS = {"E1": 40.1e9, "E2": 8.9e9, "nu12": 0.23, "G12": 4.23e9}
CROSS_PLY_16S = tuple([0.0, 90.0] * 8 + [90.0, 0.0] * 8)
ANGLE_PLY_16S = tuple([45.0, -45.0] * 8 + [-45.0, 45.0] * 8)


def plate(length, width, thickness, density, constants, layup=(0.0,), edges="FFFF", shear=FIVE_SIXTHS):
    """A plate without unknowns; ``constants`` with only E1 and nu12 are isotropic."""
    sizes = map(np.asarray, (length, width, thickness, density))
    symmetry = "transversely_isotropic" if "E2" in constants else "isotropic"
    state = PlateState(*sizes, complete_constants(constants, symmetry), laminate_geometry(layup), shear)
    return bare_plate(ParameterSet(()), edges, state, lambda values: state)


def frequencies(problem: Problem, n_modes: int, tolerance: Tolerance | None = None) -> np.ndarray:
    """Converged frequencies of a plate without unknowns, (n_modes,) Hz."""
    found = converge(problem, {}, n_modes, tolerance).operator
    return solve(found, *found.coefficients({}), n_modes).frequencies[0]


def navier(stiffness, mass, sides, n_modes, highest=12):
    """Frequencies of a simply supported cross-ply plate, Navier's solution of the Mindlin equations, Hz.
    u = U cos(ax) sin(by), v = V sin cos, w = W sin sin, phi_x = X cos sin, phi_y = Y sin cos make every
    strain one trigonometric product, so each (m, n) is a 5 x 5 eigenproblem, in-plane modes included
    (Reddy, Mechanics of Laminated Composite Plates, section 7.2).
    stiffness : of the eight generalised strains (8, 8). mass : of U, V, W, X, Y (5, 5), per area."""
    found = []
    for m, n in product(range(highest + 1), repeat=2):
        a, b = m * np.pi / sides[0], n * np.pi / sides[1]
        strain = np.zeros((8, 5))
        for row, (x, y) in ((0, (0, 1)), (3, (3, 4))):
            strain[row, x], strain[row + 1, y] = -a, -b
            strain[row + 2, x], strain[row + 2, y] = b, a
        strain[6, 2], strain[6, 4], strain[7, 2], strain[7, 3] = b, 1, a, 1
        present = np.array([n > 0, m > 0, m > 0 and n > 0, n > 0, m > 0])
        if present.any():
            k, own = (w[np.ix_(present, present)] for w in (strain.T @ stiffness @ strain, mass))
            scale = 1 / np.sqrt(np.diag(own))
            both = (w * scale[:, None] * scale for w in (k, own))
            found.append(scipy.linalg.eigh(*both, eigvals_only=True))
    return np.sqrt(np.sort(np.concatenate(found))[:n_modes]) / (2 * np.pi)


def with_plate(name: str, **changes: object) -> Specimen:
    specimen = builtin(name)
    return replace(specimen, plate=replace(specimen.plate, **changes))  # type: ignore[arg-type]
