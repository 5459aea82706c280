"""The same plate by other solvers, each written as its users would; every call starts afresh.

A solver returns the lowest deformation frequencies, (n_modes,) Hz, rigid-body motions left out.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
from typing import Any, Literal

import numpy as np
import scipy.linalg
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy.sparse.linalg import eigsh
from skfem import Basis, BilinearForm, ElementQuadS2, ElementVector, MeshQuad

from cpam_bayes.forward_model.calculix.deck import Element
from cpam_bayes.forward_model.calculix.run import PROGRAM_VARIABLE, solve_modes
from cpam_bayes.mechanics.problem import PlateState
from cpam_bayes.plate import Specimen

Array = NDArray[np.float64]
# All five fields, or w and the rotations alone, which suffice for the bending of a symmetric laminate.
Fields = Literal[3, 5]

# Generalised strains as sums (field, derivative); fields are u v w phi_x phi_y.
_STRAINS: tuple[tuple[tuple[int, str], ...], ...] = (
    ((0, "x"),),
    ((1, "y"),),
    ((0, "y"), (1, "x")),
    ((3, "x"),),
    ((4, "y"),),
    ((3, "y"), (4, "x")),
    ((2, "y"), (4, "")),
    ((2, "x"), (3, "")),
)
# Shift of the shift-invert eigensolver below zero, where rigid-body motions make K singular, Hz.
_SHIFT_HZ = 10.0


def has_panels() -> bool:
    """Whether the library ``panels`` can be imported."""
    return importlib.util.find_spec("panels") is not None


def has_calculix() -> bool:
    """Whether CalculiX's program is installed."""
    return shutil.which(os.environ.get(PROGRAM_VARIABLE) or "ccx") is not None


def _inertia(state: PlateState, fields: Fields) -> Array:
    h = float(state.thickness)
    rotary = h * h / 12
    return float(state.density) * h * np.array([1.0, 1.0, 1.0, rotary, rotary])[5 - fields :]


def serendipity(state: PlateState, mesh: tuple[int, int], n_modes: int, fields: Fields = 5) -> Array:
    """scikit-fem: 8-node elements, strain energy with 2 x 2 points, shift-invert eigensolver."""
    first = 5 - fields
    unused = 3 if fields == 3 else 0  # membrane strains
    stiffness = np.real(state.stiffness())[unused:, unused:]
    inertia = _inertia(state, fields)
    w, px, py = 2 - first, 3 - first, 4 - first

    def strains(u: Any) -> Array:
        g = u.grad
        bending = [
            g[px, 0],
            g[py, 1],
            g[px, 1] + g[py, 0],
            g[w, 1] + u[py],
            g[w, 0] + u[px],
        ]
        membrane = [g[0, 0], g[1, 1], g[0, 1] + g[1, 0]] if fields == 5 else []
        return np.stack(membrane + bending)

    @BilinearForm
    def strain_energy(u: Any, v: Any, _: Any) -> Array:
        return np.sum(strains(v) * np.tensordot(stiffness, strains(u), 1), axis=0)

    @BilinearForm
    def kinetic_energy(u: Any, v: Any, _: Any) -> Array:
        return np.einsum("i,iek,iek->ek", inertia, u, v)

    x = np.linspace(0.0, float(state.length), mesh[0] + 1)
    y = np.linspace(0.0, float(state.width), mesh[1] + 1)
    quads, element = MeshQuad.init_tensor(x, y), ElementVector(ElementQuadS2(), fields)
    k = strain_energy.assemble(Basis(quads, element, intorder=3))
    m = kinetic_energy.assemble(Basis(quads, element, intorder=5))
    n_rigid = 3 if fields == 3 else 6
    shift = -((2 * np.pi * _SHIFT_HZ) ** 2)
    return _frequencies(eigsh(k, k=n_modes + n_rigid, M=m, sigma=shift, return_eigenvectors=False), n_modes)


def polynomial(state: PlateState, degree: int, n_modes: int, fields: Fields = 5) -> Array:
    """Ritz with products of Legendre polynomials, one dense eigenproblem without any symmetry."""
    h_x, h_y = (_products(degree, float(size)) for size in (state.length, state.width))
    stiffness, first = np.real(state.stiffness()), 5 - fields
    size = degree * degree
    k = np.zeros((fields * size, fields * size))
    for i, left in enumerate(_STRAINS):
        for j, right in enumerate(_STRAINS):
            if stiffness[i, j] == 0.0 or (fields == 3 and (i < 3 or j < 3)):
                continue
            for f, df in left:
                for g, dg in right:
                    rows = slice((f - first) * size, (f - first + 1) * size)
                    columns = slice((g - first) * size, (g - first + 1) * size)
                    along_x, along_y = h_x[df == "x", dg == "x"], h_y[df == "y", dg == "y"]
                    k[rows, columns] += stiffness[i, j] * np.kron(along_x, along_y)
    scale = 1.0 / np.sqrt(np.repeat(_inertia(state, fields), size))
    k *= scale[:, None] * scale
    n_rigid = 3 if fields == 3 else 6
    values = scipy.linalg.eigh(
        k, eigvals_only=True, subset_by_index=[0, n_modes + n_rigid - 1], overwrite_a=True, check_finite=False
    )
    return _frequencies(values, n_modes)


def _products(degree: int, size: float) -> dict[tuple[bool, bool], Array]:
    """Integrals over [0, size] of products of orthonormal polynomials or their derivatives."""
    t, weights = legendre.leggauss(degree + 1)
    norms = np.sqrt((2 * np.arange(degree) + 1) / size)
    values = legendre.legvander(t, degree - 1) * norms
    slopes = legendre.legval(t, legendre.legder(np.eye(degree))).T * norms * (2 / size)
    both = {False: values, True: slopes}
    weights = weights * (size / 2)
    return {(a, b): (both[a].T * weights) @ both[b] for a in both for b in both}


def panels_plate(
    state: PlateState, angles_deg: Array, degree: int, n_modes: int, theory: Literal["fsdt", "clpt"]
) -> Array:
    """The library ``panels``: Ritz with Bardell's functions, five or three fields, all edges freed.

    Its own eigensolver checks residuals more closely than rounding allows on a free plate and gives
    up, hence LAPACK's on its matrices.
    """
    from panels.shell import Shell

    c = {name: float(value) for name, value in state.constants.items()}
    shell = Shell(
        a=float(state.length),
        b=float(state.width),
        m=degree,
        n=degree,
        stack=[float(angle) for angle in angles_deg],
        plyt=float(state.thickness) / len(angles_deg),
        laminaprop=tuple(c[name] for name in ("E1", "E2", "nu12", "G12", "G13", "G23")),
        rho=float(state.density),
        model=f"plate_{theory}_donnell",
    )
    shell.fsdt_shear_correction = state.shear.factor
    fields = ("u", "v", "w", "phix", "phiy") if theory == "fsdt" else ("u", "v", "w")
    for edge in ("x1", "x2", "y1", "y2"):
        for field in fields:
            setattr(shell, edge + field, 1.0)
            setattr(shell, edge + field + "r", 1.0)
    k, m = shell.calc_kC(silent=True).toarray(), shell.calc_kM(silent=True).toarray()
    return _frequencies(scipy.linalg.eigh(k, m, eigvals_only=True, subset_by_index=[0, n_modes + 5]), n_modes)


def calculix(specimen: Specimen, element: Element, in_plane: int, n_modes: int) -> Array:
    """CalculiX through files; shells (S8R) or bricks (C3D20R), about ``in_plane`` elements in the plane."""
    constants = specimen.material.complete()
    given = {name: float(value) for name, value in constants.items()}
    return solve_modes(
        specimen, given, n_modes, element=element, in_plane=in_plane, timeout=300.0
    ).frequencies


def _frequencies(eigenvalues: Array, n_modes: int) -> Array:
    """The highest n_modes of the eigenvalues asked for: the rigid-body motions are below them."""
    return np.sqrt(np.sort(eigenvalues)[-n_modes:]) / (2 * np.pi)
