"""Laminate theory for the independent elements: the 8 x 8 stiffness of a stack of plies.

Written anew from the textbooks, so that an error of the package's laminates cannot hide in a truth:
Jones, Mechanics of Composite Materials (A, B, D), and Rohwer, Composites Science and Technology 32
(1988), for a transverse shear stiffness that is consistent in energy.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Constants = Mapping[str, float]

# Cured epoxy, Pa (Daniel and Ishai, Engineering Mechanics of Composite Materials).
RESIN: dict[str, float] = {"E1": 3.5e9, "E2": 3.5e9, "nu12": 0.35, "G12": 3.5e9 / 2.7}


def completed(constants: Constants) -> dict[str, float]:
    """The six constants of a ply: G13 = G12 and G23 of a transversely isotropic ply where left out.

    G23 = E2 / (2 (1 + nu23)), nu23 = nu12 (1 - nu12 E2 / E1) / (1 - nu12). Without E2: isotropic.
    """
    c = dict(constants)
    if "E2" not in c:
        shear = c["E1"] / (2.0 * (1.0 + c["nu12"]))
        return {"E1": c["E1"], "E2": c["E1"], "nu12": c["nu12"], "G12": shear, "G13": shear, "G23": shear}
    c.setdefault("G13", c["G12"])
    nu23 = c["nu12"] * (1.0 - c["nu12"] * c["E2"] / c["E1"]) / (1.0 - c["nu12"])
    c.setdefault("G23", c["E2"] / (2.0 * (1.0 + nu23)))
    return c


def plane_stress(c: Constants, angle_deg: float) -> Array:
    """Plane-stress stiffness of a ply in plate axes, (3, 3) Pa, order xx, yy, xy with gamma_xy."""
    minor = c["nu12"] * c["E2"] / c["E1"]
    scale = 1.0 / (1.0 - c["nu12"] * minor)
    q = np.array(
        [
            [scale * c["E1"], scale * minor * c["E1"], 0.0],
            [scale * minor * c["E1"], scale * c["E2"], 0.0],
            [0.0, 0.0, c["G12"]],
        ]
    )
    cos, sin = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    # strains of the ply from strains of the plate
    turn = np.array(
        [
            [cos**2, sin**2, cos * sin],
            [sin**2, cos**2, -cos * sin],
            [-2 * cos * sin, 2 * cos * sin, cos**2 - sin**2],
        ]
    )
    return np.asarray(turn.T @ q @ turn)


def shear_stress(c: Constants, angle_deg: float) -> Array:
    """Transverse shear stiffness of a ply in plate axes, (2, 2) Pa, order yz, xz."""
    cos, sin = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    turn = np.array([[cos, -sin], [sin, cos]])  # gamma_23, gamma_13 from gamma_yz, gamma_xz
    return np.asarray(turn.T @ np.diag([c["G23"], c["G13"]]) @ turn)


def stiffness(plies: Sequence[tuple[Constants, float, float]], correction: float | None = None) -> Array:
    """The 8 x 8 stiffness [A B; B D; A_s] of plies (constants, angle in deg, thickness in m), bottom to top.

    correction : factor of the integral of the shear stiffness; None: Rohwer's energy-consistent one.
    Strains: eps_x, eps_y, gamma_xy, kappa_x, kappa_y, kappa_xy, gamma_yz, gamma_xz.
    """
    faces = np.concatenate([[0.0], np.cumsum([t for _, _, t in plies])])
    faces -= faces[-1] / 2.0
    moduli = [plane_stress(c, angle) for c, angle, _ in plies]
    shears = [shear_stress(c, angle) for c, angle, _ in plies]
    out = np.zeros((8, 8))
    for k, q in enumerate(moduli):
        low, high = faces[k], faces[k + 1]
        out[:3, :3] += q * (high - low)
        out[:3, 3:6] += q * (high**2 - low**2) / 2.0
        out[3:6, 3:6] += q * (high**3 - low**3) / 3.0
        out[6:, 6:] += shears[k] * (high - low)
    out[3:6, :3] = out[:3, 3:6].T
    if correction is not None:
        out[6:, 6:] *= correction
    else:
        out[6:, 6:] = _energy_consistent(faces, moduli, shears, out)
    return out


def _energy_consistent(
    faces: Array, moduli: Sequence[Array], shears: Sequence[Array], abd: NDArray[Any]
) -> Array:
    """Shear stiffness whose energy is that of the stresses in equilibrium with cylindrical bending."""
    neutral = -np.linalg.solve(abd[:3, :3], abd[:3, 3:6])  # membrane strains that bending brings, N = 0
    flexibility = np.linalg.inv(abd[3:6, 3:6] + abd[3:6, :3] @ neutral)
    points, weights = np.polynomial.legendre.leggauss(4)
    compliance = np.zeros((2, 2))
    below = np.zeros((3, 3))  # integral of Q (eps0 + z) from the lower face
    for k, q in enumerate(moduli):
        low, high = faces[k], faces[k + 1]
        z = low + (high - low) * (points + 1.0) / 2.0
        inverse = np.linalg.inv(shears[k])
        for zi, wi in zip(z, weights * (high - low) / 2.0, strict=True):
            a = -(below + q @ (neutral * (zi - low) + np.eye(3) * (zi**2 - low**2) / 2.0)) @ flexibility
            # tau_yz and tau_xz of the forces V_y = M_y,y and V_x = M_x,x
            f = np.array([[a[1, 1], a[2, 0]], [a[2, 1], a[0, 0]]])
            compliance += wi * f.T @ inverse @ f
        below = below + q @ (neutral * (high - low) + np.eye(3) * (high**2 - low**2) / 2.0)
    return np.asarray(np.linalg.inv(compliance))
