"""Natural frequencies of a cross-ply plate in about one page of scikit-fem, as a user would write them.

Bending of a Mindlin plate with w, phi_x, phi_y; 8-node elements, strain energy with 2 x 2 points, shear
correction 5/6, shift-invert eigensolver. Mesh, numbering and mass are made once. The stiffness is either
assembled at every call or summed from matrices assembled before.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import eigsh
from skfem import Basis, BilinearForm, ElementQuadS2, ElementVector, MeshQuad

from cpam_bayes.plate import Specimen
from cpam_bayes.plate.laminate import complete_constants

Array = NDArray[Any]
Frequencies = Callable[[Mapping[str, float]], Array]

# Entries of the stiffness that a cross-ply plate has: curvatures (0, 1, 2), shear yz (3) and xz (4).
ENTRIES = ((0, 0), (0, 1), (1, 1), (2, 2), (3, 3), (4, 4))
# Shift below zero, since K is singular on a free plate, Hz.
_SHIFT_HZ = 10.0
_RIGID = 3


def cross_ply_stiffness(angles_deg: Array, thickness: float, constants: Mapping[str, float]) -> Array:
    """D11 D12 D22 D66 and 5/6 A44, 5/6 A55 of plies at 0 or 90 degrees, (6,)."""
    complete = complete_constants(constants, "transversely_isotropic")
    c = {name: float(value) for name, value in complete.items()}
    scale = 1.0 / (1.0 - c["nu12"] ** 2 * c["E2"] / c["E1"])
    q11, q12, q22 = scale * c["E1"], scale * c["nu12"] * c["E2"], scale * c["E2"]
    z = np.linspace(-0.5, 0.5, len(angles_deg) + 1) * thickness
    cubes, heights = np.diff(z**3) / 3.0, np.diff(z)
    along = np.isclose(angles_deg, 0.0)
    if not np.all(along | np.isclose(angles_deg, 90.0)):
        raise ValueError(f"plies: received {angles_deg}, accepted: 0 and 90 degrees")
    return np.array(
        [
            cubes @ np.where(along, q11, q22),
            cubes.sum() * q12,
            cubes @ np.where(along, q22, q11),
            cubes.sum() * c["G12"],
            5 / 6 * heights @ np.where(along, c["G23"], c["G13"]),
            5 / 6 * heights @ np.where(along, c["G13"], c["G23"]),
        ]
    )


def plain_frequencies(specimen: Specimen, n_modes: int, mesh: int) -> tuple[Frequencies, Frequencies]:
    """Two functions from constants to frequencies, (n_modes,) Hz: one assembles at each call, one sums."""
    plate = specimen.plate
    angles, h = plate.layup.angles(np.empty(0)), plate.thickness
    lines = np.linspace(0.0, 1.0, mesh + 1)
    quads = MeshQuad.init_tensor(lines * plate.length, lines * plate.width)
    element = ElementVector(ElementQuadS2(), 3)
    basis = Basis(quads, element, intorder=3)
    inertia = plate.density * h * np.array([1.0, h * h / 12, h * h / 12])

    def strains(u: Any) -> list[Array]:
        g = u.grad
        return [g[1, 0], g[2, 1], g[1, 1] + g[2, 0], g[0, 1] + u[2], g[0, 0] + u[1]]

    @BilinearForm
    def kinetic_energy(u: Any, v: Any, _: Any) -> Array:
        return sum(i * a * b for i, a, b in zip(inertia, u, v, strict=True))

    def stiffness(values: Array) -> Any:
        @BilinearForm
        def strain_energy(u: Any, v: Any, _: Any) -> Array:
            left, right = strains(v), strains(u)
            total = 0.0
            for value, (i, j) in zip(values, ENTRIES, strict=True):
                if value:
                    total = total + value * left[i] * right[j]
                    if i != j:
                        total = total + value * left[j] * right[i]
            return total

        return strain_energy.assemble(basis)

    mass = kinetic_energy.assemble(Basis(quads, element, intorder=5))
    parts = [stiffness(row) for row in np.eye(len(ENTRIES))]

    def solve(k: Any) -> Array:
        shift = -((2 * np.pi * _SHIFT_HZ) ** 2)
        found = eigsh(k, k=n_modes + _RIGID, M=mass, sigma=shift, return_eigenvectors=False)
        return np.sqrt(np.sort(found)[-n_modes:]) / (2 * np.pi)

    def assembling(constants: Mapping[str, float]) -> Array:
        return solve(stiffness(cross_ply_stiffness(angles, h, constants)))

    def summing(constants: Mapping[str, float]) -> Array:
        values = cross_ply_stiffness(angles, h, constants)
        return solve(sum(v * part for v, part in zip(values, parts, strict=True)))

    return assembling, summing
