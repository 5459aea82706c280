"""Laminates: the symmetric 8 x 8 stiffness [A B; B D; A_s] from ply constants and ply angles.

Generalised strains are ordered ``(eps_x, eps_y, gamma_xy, kappa_x, kappa_y, kappa_xy, gamma_yz, gamma_xz)``.
Plies may be of several materials. Invariants and integrals of angle functions are then concatenated by
material on the last axis, 5 each per material. Every function is vectorised over leading axes and accepts
complex input, so that derivatives can be taken by a complex step.

The symmetry of a ply determines which constants it has and what they must satisfy:

* isotropic: E1 and nu12 are the only constants, eq. (11), and -1 < nu12 < 1/2;
* transversely isotropic about the fibres, like the paper's composites: G23 follows from eq. (6), and the
  constants satisfy eq. (9);
* orthotropic, like fabrics, wood and plywood: all are free, and the stiffness in plane stress is positive
  definite (Jones, Mechanics of Composite Materials, section 2.4).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final, Literal, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[Any]
Value = TypeVar("Value")

N_STRAINS = 8
_INVARIANTS = 5
MEMBRANE = slice(0, 3)
CURVATURE = slice(3, 6)
SHEAR = slice(6, 8)

# Gauss points per ply: the shear stresses are quadratic in z, their energy quartic, 3 points are exact.
_GAUSS_Z, _GAUSS_W = np.polynomial.legendre.leggauss(3)


@dataclass(frozen=True, slots=True)
class ShearModel:
    """The model of the transverse shear stiffness A_s of a stack of plies.

    ``factor is None`` : energy-consistent, from the equilibrium shear stresses of the layup
    (Rohwer, 1988; Whitney, 1973). Otherwise A_s is ``factor`` times the integral of the ply
    moduli, 5/6 being Reissner's value for a homogeneous section.
    """

    factor: float | None = None


ENERGY_CONSISTENT = ShearModel()
FIVE_SIXTHS = ShearModel(5.0 / 6.0)


@dataclass(frozen=True, eq=False)
class PlyStack:
    """Positions and materials of plies, without their angles.

    interfaces : (n_plies + 1,) z / h, from -1/2 to 1/2.
    material : (n_plies,) indices into ``names``.
    density : (n_plies,) relative to the mean of the plate.
    names : of the materials; constants of a material "c" are called "c.E1", those of "" just "E1".
    """

    interfaces: Array
    material: Array
    density: Array
    names: tuple[str, ...] = ("",)

    @property
    def is_symmetric(self) -> bool:
        """Whether the upper half mirrors the lower."""
        even = np.allclose(self.interfaces, -self.interfaces[::-1], rtol=0.0, atol=1e-12)
        return bool(even and np.array_equal(self.material, self.material[::-1]))

    @cached_property
    def mass_moments(self) -> tuple[float, float]:
        """Integrals of density times z and times 12 z^2 over the thickness, for unit thickness and density.

        They are 0 and 1 for a plate of uniform density.
        """
        first, second = (float(np.diff(self.interfaces**k) @ self.density) / k for k in (2, 3))
        return first, 12.0 * second

    def reordered(self, order: Sequence[int]) -> PlyStack:
        """The plies at these positions, bottom to top, filling the thickness at the same mean density."""
        at = list(order)
        thickness = np.diff(self.interfaces)[at] / np.diff(self.interfaces)[at].sum()
        density = self.density[at] / (self.density[at] @ thickness)
        interfaces = np.concatenate(([0.0], np.cumsum(thickness))) - 0.5
        return replace(self, interfaces=interfaces, material=self.material[at], density=density)


def equal_plies(n: int) -> PlyStack:
    """The stack of n plies of equal thickness and one material."""
    return PlyStack(np.arange(n + 1) / n - 0.5, np.zeros(n, dtype=np.intp), np.ones(n))


def constants_of(constants: Mapping[str, Value], material: str) -> Mapping[str, Value]:
    """The constants of one material of a hybrid by their plain names; of material "" unchanged."""
    if not material:
        return constants
    start = f"{material}."
    return {name.removeprefix(start): v for name, v in constants.items() if name.startswith(start)}


def reduced_stiffness(constants: Mapping[str, ArrayLike]) -> Array:
    """Plane-stress ply stiffness ``(Q11, Q12, Q22, Q66)`` on the last axis.

    Q11 = E1 / (1 - nu12 nu21), Q12 = nu12 Q22, Q22 = E2 / (1 - nu12 nu21), Q66 = G12 with
    nu21 = nu12 E2 / E1 (Jones, Mechanics of Composite Materials, eq. 2.61).

    constants : E1, E2, nu12, G12, each (...), Pa.

    Returns (..., 4), Pa.
    """
    e1, e2 = np.asarray(constants["E1"]), np.asarray(constants["E2"])
    nu12, g12 = np.asarray(constants["nu12"]), np.asarray(constants["G12"])
    inverse = 1.0 / (1.0 - nu12 * nu12 * e2 / e1)
    q22 = e2 * inverse
    return _on_last_axis(e1 * inverse, nu12 * q22, q22, g12)


def stiffness_invariants(reduced: Array) -> Array:
    """Tsai-Pagano invariants ``(U1, ..., U5)`` of a ply, (..., 4) -> (..., 5), Pa."""
    q11, q12, q22, q66 = (reduced[..., i] for i in range(4))
    return _on_last_axis(
        (3 * q11 + 3 * q22 + 2 * q12 + 4 * q66) / 8,
        (q11 - q22) / 2,
        (q11 + q22 - 2 * q12 - 4 * q66) / 8,
        (q11 + q22 + 6 * q12 - 4 * q66) / 8,
        (q11 + q22 - 2 * q12 + 4 * q66) / 8,
    )


def angle_functions(angles_deg: ArrayLike) -> Array:
    """Angle functions ``(1, cos 2t, cos 4t, sin 2t, sin 4t)`` of plies, (...) degrees -> (..., 5)."""
    t = np.deg2rad(1.0) * np.asarray(angles_deg)
    return np.stack((1.0 + 0.0 * t, np.cos(2 * t), np.cos(4 * t), np.sin(2 * t), np.sin(4 * t)), -1)


def rotated_stiffness(invariants: Array, weights: Array) -> Array:
    """Stiffness ``(X11, X12, X22, X66, X16, X26)`` of plies whose angle functions sum to ``weights``.

    X11 = U1 w0 + U2 w1 + U3 w2 and so on (Jones, section 2.7): with ``weights`` the angle
    functions of one ply it is the ply's own Qbar, with their integral over z, z or z^2 it is A,
    B or D.

    invariants (..., 5), weights (..., 5) -> (..., 6); for n materials (..., 5 n) each, summed over them.
    """
    if weights.shape[-1] > _INVARIANTS:
        groups = (slice(i, i + _INVARIANTS) for i in range(0, weights.shape[-1], _INVARIANTS))
        return np.asarray(sum(rotated_stiffness(invariants[..., g], weights[..., g]) for g in groups))
    u1, u2, u3, u4, u5 = (invariants[..., i] for i in range(5))
    w0, w1, w2, w3, w4 = (weights[..., i] for i in range(5))
    even, odd, quad, half = u1 * w0 + u3 * w2, u2 * w1, u3 * w4, 0.5 * u2 * w3
    return _on_last_axis(
        even + odd, u4 * w0 - u3 * w2, even - odd, u5 * w0 - u3 * w2, half + quad, half - quad
    )


def _on_last_axis(*entries: Array) -> Array:
    """Arrays, broadcast and stacked on a new last axis; faster than ``np.stack``."""
    shape = np.broadcast_shapes(*(e.shape for e in entries))
    stacked = np.empty((*shape, len(entries)), dtype=np.result_type(*entries))
    for i, entry in enumerate(entries):
        stacked[..., i] = entry
    return stacked


def _side_by_side(arrays: list[Array]) -> Array:
    """Arrays (..., k) concatenated on the last axis, their leading axes broadcast."""
    if len(arrays) == 1:
        return arrays[0]
    shape = np.broadcast_shapes(*(a.shape[:-1] for a in arrays))
    return np.concatenate([np.broadcast_to(a, (*shape, a.shape[-1])) for a in arrays], axis=-1)


# Position of each entry of a symmetric matrix in (X11, X12, X22, X66, X16, X26).
_ENTRIES_3 = np.array([[0, 1, 4], [1, 2, 5], [4, 5, 3]])
# The same in (X11, X22, X12), and for the adjugate in (X22, X11, -X12, -X21).
_ENTRIES_2, _ADJUGATE_2 = np.array([[0, 2], [2, 1]]), np.array([[0, 2], [3, 1]])


def _merge_equal_plies(angles_deg: Array, plies: PlyStack) -> tuple[Array, Array, Array]:
    """Neighbouring plies of equal angle and material merged: angles, materials (m,), interfaces (m + 1,)."""
    starts = run_starts(angles_deg, plies)
    return angles_deg[starts], plies.material[starts], plies.interfaces[np.append(starts, angles_deg.size)]


def run_starts(angles_deg: Array, plies: PlyStack) -> Array:
    """Index (m,) of the first ply of each run of neighbours of equal angle and material."""
    change = (np.diff(angles_deg) != 0.0) | (np.diff(plies.material) != 0)
    return np.concatenate(([0], np.flatnonzero(change) + 1))


@dataclass(frozen=True)
class LaminateGeometry:
    """The part of a layup that does not depend on the elastic constants, for unit thickness.

    in_plane, coupling, flexural : (..., 5), lamination parameters: integrals of the angle functions times
    1, z and z^2; for n materials (..., 5 n), each integrated over its own plies.
    first, zeroth : (..., n_points, 5 n) at Gauss points, their running integrals from the bottom times z and
    times 1; ``zeroth`` is ``None`` where the laminate is symmetric.
    ply, material, weight : of the points, angle functions (..., n_points, 5), materials, weights (n_points,).
    names : of the materials, as in ``PlyStack``.
    """

    in_plane: Array
    coupling: Array
    flexural: Array
    symmetric: bool
    ply: Array
    first: Array
    zeroth: Array | None
    weight: Array
    material: Array
    names: tuple[str, ...] = ("",)

    def at_points(self, values: Array) -> Array:
        """Values by material, (..., n_materials), at the points, (..., n_points); as they are for one."""
        return values if len(self.names) == 1 else np.asarray(values[..., self.material])

    @property
    def is_one_layup(self) -> bool:
        """Whether it is one layup of known angles, whose stiffness has a closed form."""
        return self.in_plane.ndim == 1 and not np.iscomplexobj(self.in_plane)

    @cached_property
    def closed_form(self) -> ClosedForm:
        """The stiffness of one layup as a function of the constants of its plies."""
        n = len(self.names)
        units = np.zeros((4 * n, _INVARIANTS * n))
        for k in range(n):
            at = slice(4 * k, 4 * k + 4), slice(_INVARIANTS * k, _INVARIANTS * (k + 1))
            units[at] = stiffness_invariants(np.eye(4))
        linear = _membrane_and_bending(self, units)
        running = [self.first] if self.zeroth is None else [self.zeroth, self.first]
        rows = np.concatenate([_running_rows(units, each) for each in running], axis=-1)
        return ClosedForm(linear.reshape(4 * n, -1), self._shear_energy(rows))

    def _shear_energy(self, rows: Array) -> Array:
        """Shear energy as quadratic forms, (2 n_materials, 3, k, k); see ``ClosedForm``.

        rows : (3, n_points, 4 n_materials, r), rows x, y and xy of the running stiffness per reduced
            stiffness and entry of a compliance.
        """
        n_points, stress = rows.shape[1], {}
        for column, (yz, xz) in enumerate(((2, 0), (1, 2))):  # of Qx, of Qy
            for name, row in (("yz", yz), ("xz", xz)):
                placed = np.zeros((n_points, rows.shape[2], 2, rows.shape[3]))
                placed[:, :, column] = rows[row]
                stress["xy"[column] + name] = placed.reshape(n_points, -1)
        forms = []
        for k in range(len(self.names)):
            weight = 0.5 * self.weight * (self.material == k)
            c2, s2 = self.ply[:, 1] * weight, self.ply[:, 3] * weight
            for sign in (1.0, -1.0):  # 1 / G23, 1 / G13
                s_yz, s_xz, s_mix = (
                    (w[:, None]) for w in (weight + sign * c2, weight - sign * c2, -sign * s2)
                )
                for i, j in ("yy", "xx", "yx"):
                    left, right = (stress[i + "yz"], stress[i + "xz"]), (stress[j + "yz"], stress[j + "xz"])
                    form = left[0].T @ (s_yz * right[0] + s_mix * right[1])
                    form = form + left[1].T @ (s_xz * right[1] + s_mix * right[0])
                    forms.append(0.5 * (form + form.T))
        return np.array(forms).reshape(-1, 3, *forms[0].shape)


@dataclass(frozen=True, slots=True, eq=False)
class ClosedForm:
    """Stiffness of one layup of unit thickness as a function of the reduced stiffnesses q of its materials.

    [A B; B D] is linear in q. The shear stresses are linear in the products of q with the compliances c of
    bending along x and along y, so that the entries (yy, xx, xy) of the shear compliance are the sum
    over s_k of s_k X^T T_k X with s = (1/G23, 1/G13) and X_ab = q_a c_b.

    linear : (4 n_materials, 64) entries of the 8 x 8 stiffness per entry of q.
    energy : (2 n_materials, 3, k, k), the T_k, symmetric; k is 24 n_materials, 48 where A and D couple.
    """

    linear: Array
    energy: Array

    @property
    def _coupled(self) -> slice:
        """The strains of the compliance: curvatures, with the membrane strains where they couple."""
        r = self.energy.shape[-1] // (2 * len(self.linear))
        return slice(6 - r, 6)

    def values(self, q: Array, s: Array) -> Array:
        """The 8 x 8 stiffness at q (..., 4 n_materials) and s (..., 2 n_materials), real or complex."""
        unit = (q @ self.linear).reshape(*q.shape[:-1], N_STRAINS, N_STRAINS)
        compliance = np.linalg.inv(unit[..., self._coupled, self._coupled])
        x, images = self._products(q, compliance)
        h = (s[..., None, :] @ np.sum(images * x[..., None, None, :], axis=-1))[..., 0, :]
        shape = np.broadcast_shapes(unit.shape[:-2], h.shape[:-1])
        if shape != unit.shape[:-2] or h.dtype != unit.dtype:
            unit = np.array(np.broadcast_to(unit, (*shape, N_STRAINS, N_STRAINS)), dtype=h.dtype)
        unit[..., SHEAR, SHEAR] = _inverse2(h[..., _ENTRIES_2])
        return np.asarray(unit)

    def _products(self, q: Array, compliance: Array) -> tuple[Array, Array]:
        """X (..., k) and T X (..., 2 n_materials, 3, k)."""
        columns = np.swapaxes(compliance[..., :, -3:-1], -1, -2)
        x = q[..., :, None] * columns.reshape(*columns.shape[:-2], 1, -1)
        x = x.reshape(*x.shape[:-2], -1)
        k = x.shape[-1]
        return x, (x @ self.energy.reshape(-1, k).T).reshape(*x.shape[:-1], *self.energy.shape[:-1])

    def first_order(self, q: Array, s: Array) -> Array:
        """``values`` at complex steps q (..., n, 4 n_materials), s (..., n, 2 n_materials), to first order.

        The n sets of a row share their real parts. With H = Y^-1 the shear compliance and X that of
        bending, dY = -Y dH Y and dc = -X (d[A B; B D]) X.
        """
        q0, s0 = q.real[..., 0, :], s.real[..., 0, :]
        unit = (q0 @ self.linear).reshape(*q0.shape[:-1], N_STRAINS, N_STRAINS)
        at = self._coupled
        r = at.stop - at.start
        compliance = np.linalg.inv(unit[..., at, at])
        x, images = self._products(q0, compliance)
        by_s = np.sum(images * x[..., None, None, :], axis=-1)
        shear = _inverse2((s0[..., None, :] @ by_s)[..., 0, _ENTRIES_2])
        columns = np.swapaxes(compliance[..., :, -3:-1], -1, -2)
        # derivatives by X, (..., 3, 4 n_materials, 2 r), then by q at fixed c and by c at fixed q
        k = x.shape[-1]
        by_x = 2.0 * (s0[..., None, :] @ images.reshape(*images.shape[:-3], -1, 3 * k))
        by_x = by_x.reshape(*x.shape[:-1], 3, len(self.linear), 2 * r)
        by_q = (by_x @ columns.reshape(*columns.shape[:-2], 1, -1, 1))[..., 0]
        by_c = (q0[..., None, None, :] @ by_x).reshape(*x.shape[:-1], 3, 2, r)
        by_stiffness = np.swapaxes(by_c @ compliance[..., None, :, :], -1, -2) @ columns[..., None, :, :]
        entries = self.linear.reshape(-1, N_STRAINS, N_STRAINS)[:, at, at].reshape(len(self.linear), -1)
        by_q -= by_stiffness.reshape(*by_q.shape[:-1], r * r) @ entries.T
        h = q.imag @ np.swapaxes(by_q, -1, -2) + s.imag @ by_s
        steps = np.empty((*h.shape[:-1], N_STRAINS, N_STRAINS), dtype=complex)
        unit[..., SHEAR, SHEAR] = shear
        steps.real = unit[..., None, :, :]
        steps.imag = (q.imag @ self.linear).reshape(*q.shape[:-1], N_STRAINS, N_STRAINS)
        shear = shear[..., None, :, :]
        steps.imag[..., SHEAR, SHEAR] = -shear @ h[..., _ENTRIES_2] @ shear
        return steps


def _running_rows(units: Array, running: Array) -> Array:
    """Rows x, y and xy of the running stiffness (n_points, 5 n) for the invariants (4 n, 5 n) of unit plies.

    Returns (3, n_points, 4 n, 3).
    """
    entries = np.stack([rotated_stiffness(unit, running) for unit in units], axis=1)
    return np.stack([entries[..., row] for row in _ENTRIES_3])


def _membrane_and_bending(geometry: LaminateGeometry, invariants: Array) -> Array:
    """[A B 0; B D 0; 0 0 0] of unit thickness, (..., 8, 8)."""
    a, b, d = (
        rotated_stiffness(invariants, weights)[..., _ENTRIES_3]
        for weights in (geometry.in_plane, geometry.coupling, geometry.flexural)
    )
    unit = np.zeros((*a.shape[:-2], N_STRAINS, N_STRAINS), dtype=np.result_type(a, b, d))
    unit[..., MEMBRANE, MEMBRANE] = a
    unit[..., CURVATURE, CURVATURE] = d
    unit[..., MEMBRANE, CURVATURE] = b
    unit[..., CURVATURE, MEMBRANE] = b
    return unit


def laminate_geometry(
    angles_deg: ArrayLike, *, symmetric: bool | None = None, plies: PlyStack | None = None
) -> LaminateGeometry:
    """Lamination parameters and running integrals of a layup.

    angles_deg : (n_plies,) bottom to top, or (..., n_plies) for a stack of layups.
    symmetric : whether all of them are symmetric about the midplane; by default determined from the angles.
    plies : by default equal ones.
    """
    angles = np.asarray(angles_deg)
    plies = plies or equal_plies(angles.shape[-1])
    if symmetric is None:
        symmetric = bool(np.array_equal(angles, angles[..., ::-1])) and plies.is_symmetric
    if angles.ndim == 1 and not np.iscomplexobj(angles):
        angles, material, z = _merge_equal_plies(angles, plies)
    else:
        material, z = plies.material, plies.interfaces
    functions = angle_functions(angles)
    by_material = _apart(functions, material, len(plies.names))
    moments = [np.diff(z**k) / k for k in (1, 2, 3)]
    in_plane, coupling, flexural = (np.einsum("...kj,k->...j", by_material, m) for m in moments)
    if symmetric:  # the lower half carries half of the energy
        keep = z[:-1] < -1e-12
        functions, by_material, material = functions[..., keep, :], by_material[..., keep, :], material[keep]
        bottom, top = z[:-1][keep], np.minimum(z[1:][keep], 0.0)
        coupling = np.zeros_like(coupling)
    else:
        bottom, top = z[:-1], z[1:]
    middle, half = (top + bottom) / 2, (top - bottom) / 2
    points = middle[:, None] + half[:, None] * _GAUSS_Z

    def running(power: int) -> Array:
        whole = by_material * ((top**power - bottom**power) / power)[:, None]
        below = np.cumsum(whole, axis=-2) - whole
        part = (points**power - bottom[:, None] ** power) / power
        at_points = below[..., :, None, :] + by_material[..., :, None, :] * part[..., None]
        shape = (*by_material.shape[:-2], -1, by_material.shape[-1])
        return np.asarray(at_points.reshape(shape))

    return LaminateGeometry(
        in_plane=in_plane,
        coupling=coupling,
        flexural=flexural,
        symmetric=symmetric,
        ply=np.repeat(functions, len(_GAUSS_Z), axis=-2),
        first=running(2),
        zeroth=None if symmetric else running(1),
        weight=(half[:, None] * _GAUSS_W).ravel() * (2.0 if symmetric else 1.0),
        material=np.repeat(material, len(_GAUSS_Z)),
        names=plies.names,
    )


def _apart(functions: Array, material: Array, n: int) -> Array:
    """Angle functions (..., n_plies, 5) by material, zero for the plies of other materials, (..., 5 n)."""
    if n == 1:
        return functions
    return np.concatenate([functions * (material == k)[:, None] for k in range(n)], axis=-1)


def _shear_compliance(
    geometry: LaminateGeometry, invariants: Array, abd: Array, g13: Array, g23: Array
) -> Array:
    """Energy-consistent transverse shear compliance of unit thickness, (..., 2, 2), order (yz, xz).

    g13, g23 : (..., n_materials), Pa.

    Equilibrium gives tau_xz = -F11 Qx - F32 Qy and tau_yz = -F31 Qx - F22 Qy with
    F(z) = int_{-h/2}^{z} Qbar (b + zeta d) dzeta, [a b; b^T d] the inverse of [A B; B D], once two
    cylindrical bendings M_x,x = Qx and M_y,y = Qy are assumed (Rohwer, DLR-FB 88-14, 1988). The
    energy int tau^T S tau dz = Q^T A_s^{-1} Q defines A_s.
    """
    if geometry.symmetric:
        d = np.linalg.inv(abd[..., 3:6, 3:6])
        b = None
    else:
        inverse = np.linalg.inv(abd[..., :6, :6])
        b, d = inverse[..., :3, 3:], inverse[..., 3:, 3:]

    mean, half = 0.5 / g23 + 0.5 / g13, 0.5 / g23 - 0.5 / g13
    h_yy, h_xx, h_xy = _energy_of_layups(geometry, invariants, d, b, mean, half)
    return np.asarray(_on_last_axis(h_yy, h_xx, h_xy)[..., _ENTRIES_2])


def _energy_of_layups(
    geometry: LaminateGeometry, invariants: Array, d: Array, b: Array | None, mean: Array, half: Array
) -> Array:
    """Entries (yy, xx, xy) of the shear compliance of a stack of layups, (3, ...), point by point."""

    def rows(running: Array, columns: Array) -> tuple[Array, Array, Array, Array]:
        p11, p12, p22, p66, p16, p26 = np.moveaxis(
            rotated_stiffness(invariants[..., None, :], running), -1, 0
        )
        c = columns[..., None, :, :]
        f11 = p11 * c[..., 0, 0] + p12 * c[..., 1, 0] + p16 * c[..., 2, 0]
        f31 = p16 * c[..., 0, 0] + p26 * c[..., 1, 0] + p66 * c[..., 2, 0]
        f22 = p12 * c[..., 0, 1] + p22 * c[..., 1, 1] + p26 * c[..., 2, 1]
        f32 = p16 * c[..., 0, 1] + p26 * c[..., 1, 1] + p66 * c[..., 2, 1]
        return f11, f22, f31, f32

    f11, f22, f31, f32 = rows(geometry.first, d)
    if b is not None and geometry.zeroth is not None:
        g11, g22, g31, g32 = rows(geometry.zeroth, b)
        f11, f22, f31, f32 = f11 + g11, f22 + g22, f31 + g31, f32 + g32
    c2, s2 = geometry.ply[..., 1], geometry.ply[..., 3]
    mean, half, weight = geometry.at_points(mean), geometry.at_points(half), geometry.weight
    s_yz, s_xz, s_mix = (mean + half * c2) * weight, (mean - half * c2) * weight, -half * s2 * weight
    h_yy = np.sum(s_yz * f22 * f22 + s_xz * f32 * f32 + 2 * s_mix * f22 * f32, axis=-1)
    h_xx = np.sum(s_yz * f31 * f31 + s_xz * f11 * f11 + 2 * s_mix * f31 * f11, axis=-1)
    h_xy = np.sum(s_yz * f22 * f31 + s_xz * f32 * f11 + s_mix * (f22 * f11 + f32 * f31), axis=-1)
    return np.stack((h_yy, h_xx, h_xy))


def _inverse2(x: Array) -> Array:
    determinant = x[..., 0, 0] * x[..., 1, 1] - x[..., 0, 1] * x[..., 1, 0]
    adjugate = _on_last_axis(x[..., 1, 1], x[..., 0, 0], -x[..., 0, 1], -x[..., 1, 0])[..., _ADJUGATE_2]
    return np.asarray(adjugate / determinant[..., None, None])


def laminate_stiffness(
    constants: Mapping[str, ArrayLike],
    layup: ArrayLike | LaminateGeometry,
    thickness: ArrayLike,
    shear: ShearModel = ENERGY_CONSISTENT,
) -> Array:
    """Stiffness of a laminate against the eight generalised strains, [A B 0; B D 0; 0 0 A_s].

    (A, B, D)_ij = sum_k Qbar_ij,k (z_k - z_{k-1}, (z_k^2 - z_{k-1}^2) / 2, (z_k^3 - z_{k-1}^3) / 3)
    (Jones, eq. 4.22 to 4.24); A_s as ``shear`` says.

    constants : E1, E2, G12, G13, G23 in Pa and nu12, each (...); those of several materials by full names.
    layup : angles in degrees (n_plies,) or (..., n_plies) bottom to top, or a ``LaminateGeometry``.
    thickness : (...), m.

    Returns (..., 8, 8) in N/m, N, N m and N/m.
    """
    geometry = layup if isinstance(layup, LaminateGeometry) else laminate_geometry(layup)
    h = np.asarray(thickness)
    plies = [constants_of(constants, name) for name in geometry.names]
    reduced = [reduced_stiffness(ply) for ply in plies]
    if geometry.is_one_layup and shear.factor is None:
        return geometry.closed_form.values(
            _side_by_side(reduced), _shear_compliances(plies)
        ) * thickness_powers(h)
    invariants = _side_by_side([stiffness_invariants(each) for each in reduced])
    g13, g23 = (_side_by_side([np.asarray(ply[g])[..., None] for ply in plies]) for g in ("G13", "G23"))
    coupled = _membrane_and_bending(geometry, invariants)
    shape = np.broadcast_shapes(coupled.shape[:-2], h.shape, g13.shape[:-1], g23.shape[:-1])
    kind = np.result_type(coupled, h, g13, g23)
    unit = np.array(np.broadcast_to(coupled, (*shape, N_STRAINS, N_STRAINS)), dtype=kind)
    if shear.factor is None:
        compliance = _shear_compliance(geometry, invariants, unit, g13, g23)
        unit[..., SHEAR, SHEAR] = _inverse2(compliance)
    else:
        part, c2, s2 = (geometry.in_plane[..., i::_INVARIANTS] for i in (0, 1, 3))
        mean, half = (g23 + g13) / 2, (g23 - g13) / 2
        unit[..., 6, 6] = np.sum(mean * part + half * c2, axis=-1)
        unit[..., 7, 7] = np.sum(mean * part - half * c2, axis=-1)
        unit[..., 6, 7] = unit[..., 7, 6] = -np.sum(half * s2, axis=-1)
        unit[..., SHEAR, SHEAR] *= shear.factor
    return np.asarray(unit * thickness_powers(h))


def first_order_stiffness(
    constants: Mapping[str, ArrayLike],
    layup: ArrayLike | LaminateGeometry,
    thickness: ArrayLike,
    shear: ShearModel = ENERGY_CONSISTENT,
) -> Array:
    """``laminate_stiffness`` at n complex steps (..., n) from one set of constants, to first order.

    For one layup in closed form, with the common real part of the steps computed once.
    """
    geometry = layup if isinstance(layup, LaminateGeometry) else laminate_geometry(layup)
    plies = [constants_of(constants, name) for name in geometry.names]
    varied = any(np.iscomplexobj(value) for ply in plies for value in ply.values())
    if not (varied and geometry.is_one_layup and shear.factor is None):
        return laminate_stiffness(constants, geometry, thickness, shear)
    q, s = _side_by_side([reduced_stiffness(ply) for ply in plies]), _shear_compliances(plies)
    shape = np.broadcast_shapes(q.shape[:-1], s.shape[:-1])
    q, s = (np.broadcast_to(each, (*shape, each.shape[-1])) for each in (q, s))
    return np.asarray(geometry.closed_form.first_order(q, s) * thickness_powers(thickness))


def _shear_compliances(plies: list[Mapping[str, ArrayLike]]) -> Array:
    """1/G23 and 1/G13 of each material, (..., 2 n_materials)."""
    return _on_last_axis(*(1.0 / np.asarray(ply[name]) for ply in plies for name in ("G23", "G13")))


def thickness_powers(thickness: ArrayLike) -> Array:
    """Powers of h that scale the entries of the 8 x 8 stiffness of unit thickness, (..., 8, 8)."""
    h = np.asarray(thickness)
    return np.asarray(_on_last_axis(h, h * h, h * h * h)[..., _THICKNESS_POWERS])


# Exponents of h less one: 0 for A and A_s, 1 for B, 2 for D.
_OF_STRAIN = np.isin(np.arange(N_STRAINS), (3, 4, 5)).astype(int)
_THICKNESS_POWERS = _OF_STRAIN[:, None] + _OF_STRAIN


def flexural_constants(stiffness: Array, thickness: float) -> dict[str, float]:
    """Bending stiffness and flexural engineering constants of one laminate.

    Ex = 12 / (h^3 d11), Ey = 12 / (h^3 d22), Gxy = 12 / (h^3 d66), nuxy = -d12 / d11 with d the
    bending block of the inverse of [A B; B D] (Jones, section 4.4; Daniel and Ishai, eq. 7.91).

    stiffness : (8, 8), thickness : m.

    Returns D11 D12 D22 D66 D16 D26 in N m, Ex Ey Gxy in Pa, nuxy.
    """
    d = np.linalg.inv(stiffness[:6, :6])[3:, 3:]
    factor = 12 / thickness**3
    entries = {"D11": (3, 3), "D12": (3, 4), "D22": (4, 4), "D66": (5, 5), "D16": (3, 5), "D26": (4, 5)}
    constants = {name: float(stiffness[entry]) for name, entry in entries.items()}
    constants["Ex"], constants["Ey"] = float(factor / d[0, 0]), float(factor / d[1, 1])
    constants["Gxy"], constants["nuxy"] = float(factor / d[2, 2]), float(-d[0, 1] / d[0, 0])
    return constants


MaterialSymmetry: TypeAlias = Literal["isotropic", "transversely_isotropic", "orthotropic"]

CONSTANTS = ("E1", "E2", "nu12", "G12", "G13", "G23")
ISOTROPIC_CONSTANTS = ("E1", "nu12")
_MODULI = ("E1", "E2", "G12", "G13", "G23")

CONSTRAINTS: Final[Mapping[MaterialSymmetry, tuple[str, ...]]] = {
    "isotropic": ("-1 < nu12 < 0.5",),
    "transversely_isotropic": (
        "nu12 < 0.5, a positive definite stiffness, first of eq. (9)",
        "|nu12 (1 - nu12 E2/E1) / (1 - nu12)| < 1, second of eq. (9)",
        "|nu12| < sqrt(E1/E2), third of eq. (9)",
        "E1 > E2, fourth of eq. (9)",
    ),
    "orthotropic": ("|nu12| < sqrt(E1/E2), a positive definite stiffness",),
}
"""The constraints on the constants of a ply, in the order of `constraint_margins`."""


def through_thickness_poisson(
    E1: Array | float,
    E2: Array | float,
    nu12: Array | float,
) -> Array:
    """Poisson's ratio nu23 of a transversely isotropic ply, the second part of eq. (6).

    E1, E2 : (...) Pa.
    nu12 : (...); returns (...). Complex arrays pass through.
    """
    return np.asarray(nu12 * (1.0 - nu12 * E2 / E1) / (1.0 - nu12))


def complete_constants(constants: Mapping[str, ArrayLike], symmetry: MaterialSymmetry) -> dict[str, Array]:
    """Fill in the constants that follow from the others, eq. (6) and (11).

    constants : E1, E2, nu12, G12 and optionally G13, G23, or E1 and nu12 alone when isotropic;
        each (...), Pa or dimensionless, real or complex
    returns E1 E2 nu12 G12 G13 G23: where they are left out, G13 = G12, and G23 by eq. (6) or, for an
        orthotropic ply, G23 = G12; isotropic: E2 = E1 and each shear modulus E1 / (2 (1 + nu12))
    raises ValueError for a missing or an unknown constant
    """
    _require_names(constants, symmetry)
    given = {name: _inexact(value) for name, value in constants.items()}
    if symmetry == "isotropic":
        E, nu = given["E1"], given["nu12"]
        G = np.asarray(E / (2.0 * (1.0 + nu)))
        return {"E1": E, "E2": E, "nu12": nu, "G12": G, "G13": G, "G23": G}
    E1, E2, nu12, G12 = (given[name] for name in ("E1", "E2", "nu12", "G12"))
    G23 = given.get("G23")
    if G23 is None and symmetry == "orthotropic":
        G23 = G12
    elif G23 is None:
        G23 = np.asarray(E2 / (2.0 * (1.0 + through_thickness_poisson(E1, E2, nu12))))
    return {
        "E1": E1,
        "E2": E2,
        "nu12": nu12,
        "G12": G12,
        "G13": given.get("G13", G12),
        "G23": G23,
    }


def constraint_margins(constants: Mapping[str, ArrayLike], symmetry: MaterialSymmetry) -> NDArray[np.float64]:
    """Margins by which a set of constants meets each of its `CONSTRAINTS`, positive where it does.

    Transversely isotropic, eq. (9): the determinant of the stiffness, 1 - |nu23|, sqrt(E1 / E2) - |nu12| and
    E1 / E2 - 1. The first is zero at nu12 = 1/2, whatever E1 and E2 are.

    constants : real, as for `complete_constants`, broadcast to a common shape (...)
    returns (..., n_constraints), NaN where a constant is NaN
    raises ValueError for a missing or an unknown constant
    """
    return _margins(complete_constants(constants, symmetry), symmetry)


def _margins(full: Mapping[str, Array], symmetry: MaterialSymmetry) -> NDArray[np.float64]:
    """``constraint_margins`` of all six constants."""
    E1, E2, nu12 = np.broadcast_arrays(*(np.real(full[name]) for name in ("E1", "E2", "nu12")))
    if symmetry == "isotropic":
        return np.asarray(np.minimum(0.5 - nu12, 1.0 + nu12)[..., None])
    with np.errstate(all="ignore"):
        in_plane = np.sqrt(E1 / E2) - np.abs(nu12)
        if symmetry == "orthotropic":
            return np.asarray(in_plane[..., None])
        ratio = E2 / E1
        nu23 = through_thickness_poisson(E1, E2, nu12).real
        determinant = (1.0 - nu23**2) * (1.0 - nu12**2 * ratio) - (
            nu12 * ratio * np.sqrt(E1 / E2) + nu12 * nu23 * np.sqrt(ratio)
        ) ** 2
        return np.stack((determinant, 1.0 - np.abs(nu23), in_plane, E1 / E2 - 1.0), axis=-1)


def constraint_violations(
    constants: Mapping[str, ArrayLike], symmetry: MaterialSymmetry
) -> NDArray[np.bool_]:
    """True for each of its `CONSTRAINTS` that a set of constants violates; NaN violates all that it enters.

    constants : as for `constraint_margins`, (...); returns (..., n_constraints)
    raises ValueError for a missing or an unknown constant
    """
    return np.asarray(~(constraint_margins(constants, symmetry) > 0.0))


def is_admissible(constants: Mapping[str, ArrayLike], symmetry: MaterialSymmetry) -> NDArray[np.bool_]:
    """True where constants meet all their `CONSTRAINTS` and every modulus is positive.

    constants : as for `constraint_margins`, (...); returns (...)
    raises ValueError for a missing or an unknown constant
    """
    full = complete_constants(constants, symmetry)
    allowed = (_margins(full, symmetry) > 0.0).all(axis=-1)
    for name in _MODULI:
        allowed = allowed & (np.real(full[name]) > 0.0)
    return np.asarray(allowed)


def _inexact(value: ArrayLike) -> Array:
    array = np.asarray(value)
    return array if np.issubdtype(array.dtype, np.inexact) else array.astype(np.float64)


def _require_names(constants: Mapping[str, ArrayLike], symmetry: MaterialSymmetry) -> None:
    isotropic = symmetry == "isotropic"
    accepted = ISOTROPIC_CONSTANTS if isotropic else CONSTANTS
    required = ISOTROPIC_CONSTANTS if isotropic else CONSTANTS[:4]
    missing = [name for name in required if name not in constants]
    unknown = [name for name in constants if name not in accepted]
    if missing or unknown:
        raise ValueError(
            f"elastic constants of a ply, {symmetry.replace('_', ' ')}: received {sorted(constants)}, "
            f"required {list(required)}, accepted {list(accepted)}"
        )
