"""Frequencies of a plate with a point mass anywhere, by a small basis that fits each parameter set.

Per parameter set the Ritz basis is that of the bare plate and the plate's static responses to unit loads
where the change is (component mode synthesis with residual flexibility: Craig and Bampton, AIAA J. 6, 1968;
MacNeal, Comput. Struct. 1, 1971). Both stand in one larger basis, common to all places, in which
the bare plate is a few small blocks.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.forward_model.local.fields import FieldPart, PointValues, values_at_points
from cpam_bayes.forward_model.model import PlateModel, Prediction
from cpam_bayes.mechanics.affine import DenseOperator
from cpam_bayes.mechanics.problem import FIELDS, Atom, Derivative, rigid_body_count
from cpam_bayes.parameters import ParameterSet

Array = NDArray[Any]

# Parameter sets solved at a time: their matrices stay in the processor's cache.
_BATCH = 64
# Of a response that the bare basis holds already, relative to its flexibility.
_NUGGET = 1e-11


@dataclass(frozen=True)
class LocalModel:
    """A plate with a point mass at any place: parameter vectors in, frequencies out.

    bare : the bare plate on the basis common to all places, orthonormal in a reference energy; parameters
        are the plate's
    leading : number of vectors of each block that are the bare plate's own
    parts : fields of the basis
    added : the mass, then its place as fractions of length and width
    loads : fields on which the unit loads act, by their numbers
    shift : (rad/s)^2, of the energy K + shift M in which the plate answers them
    """

    bare: PlateModel
    leading: tuple[int, ...]
    parts: tuple[FieldPart, ...]
    added: ParameterSet
    loads: tuple[int, ...]
    shift: float

    @property
    def n_modes(self) -> int:
        """Number of modes predicted."""
        return self.bare.n_modes

    @property
    def error(self) -> Array:
        """Estimated relative error of each frequency of the bare plate, (n_modes,)."""
        return self.bare.error

    @cached_property
    def parameters(self) -> ParameterSet:
        """The plate's parameters, then those of the change."""
        return self.bare.parameters.union(self.added)

    def admissible(self, x: Array) -> Array:
        """Whether parameter vectors (m, n) satisfy the constraints (9), (m,) bool."""
        return self.bare.admissible(np.atleast_2d(x)[:, : self.bare.parameters.size])

    def predict(self, x: Array, *, jacobian: bool = False) -> Prediction:
        """Frequencies at parameter vectors (m, n) and, if asked, their derivatives.

        d lambda = phi^T (dK - lambda dM) phi with phi fixed, over constants, mass and place.
        """
        x = np.atleast_2d(x)
        found = [_predict(self, x[i : i + _BATCH], jacobian) for i in range(0, len(x), _BATCH)]
        slopes = [p.jacobian for p in found if p.jacobian is not None]
        return Prediction(
            np.concatenate([p.frequencies for p in found]) if found else np.empty((0, self.n_modes)),
            np.concatenate(slopes) if slopes else None,
        )


def _predict(model: LocalModel, x: Array, jacobian: bool) -> Prediction:
    n_plate, operator, m = model.bare.parameters.size, model.bare.operator, len(x)
    plate, added = x[:, :n_plate], x[:, n_plate:]
    stiffness, mass = model.bare.coefficients(plate)
    weights = _inertia(model, plate, added[:, 0])
    points = PointValues(added[:, 1]), PointValues(added[:, 2])
    rows = np.stack([_row(model, points, field, "", m) for field in FIELDS], axis=1)
    energies, masses, responses = _responses(model, operator, stiffness, mass, rows)
    a, b, at_place = _ritz(model, energies, masses, responses, rows)
    mass_there = np.swapaxes(at_place, 1, 2) @ (weights[:, :, None] * at_place)
    a += model.shift * mass_there
    b += mass_there
    back = np.swapaxes(np.linalg.inv(np.linalg.cholesky(a)), 1, 2)
    whitened = np.swapaxes(back, 1, 2) @ b @ back
    n_rigid = rigid_body_count(operator.problem.edges)
    wanted = slice(-1 - n_rigid, -1 - n_rigid - model.n_modes, -1)
    if not jacobian:
        lam = 1.0 / np.linalg.eigvalsh(whitened)[:, wanted] - model.shift
        return Prediction(np.sqrt(np.maximum(lam, 0.0)) / (2 * np.pi), None)
    mu, vectors = np.linalg.eigh(whitened)
    mu = mu[:, wanted]
    lam = 1.0 / mu - model.shift
    # phi^T B phi = mu for phi^T A phi = 1
    z = np.swapaxes(back @ vectors[:, :, wanted] / np.sqrt(mu)[:, None], 1, 2)
    phi = _in_basis(model, z, responses)
    slope = np.empty((m, model.n_modes, x.shape[1]))
    slope[..., :n_plate] = _plate_slopes(model, plate, phi, lam, weights, rows, added[:, 0])
    u = phi @ np.swapaxes(rows, 1, 2)
    per_mass = weights / np.where(added[:, :1] == 0.0, 1.0, added[:, :1])
    per_mass = np.where(added[:, :1] == 0.0, _inertia(model, plate, np.ones(m)), per_mass)
    slope[..., n_plate] = -lam * np.einsum("mif,mf->mi", u**2, per_mass)
    for k, axis in enumerate(_AXES):
        moved = np.stack([_row(model, points, field, axis, m) for field in FIELDS], axis=1)
        du = phi @ np.swapaxes(moved, 1, 2)
        slope[..., n_plate + 1 + k] = -2.0 * lam * np.einsum("mif,mif,mf->mi", u, du, weights)
    f = np.sqrt(np.maximum(lam, 0.0)) / (2 * np.pi)
    return Prediction(f, slope / (8 * np.pi**2 * f[..., None]))


_AXES: tuple[Derivative, Derivative] = ("x", "y")


def _row(
    model: LocalModel, points: tuple[PointValues, PointValues], field: Any, derivative: Derivative, m: int
) -> Array:
    n_basis = sum(b.size for b in model.bare.operator.blocks)
    return values_at_points(model.parts, n_basis, Atom(field, derivative), *points, m)


def _inertia(model: LocalModel, plate: Array, mass: Array) -> Array:
    """m for u, v, w and m (h / 2)^2 for the rotations, (m, 5)."""
    thickness = model.bare.operator.problem.state(model.bare.parameters.mapping(plate)).thickness
    rotary = mass * (np.asarray(thickness) / 2) ** 2
    return np.stack([mass, mass, mass, rotary, rotary], axis=-1)


def _responses(
    model: LocalModel, operator: DenseOperator, stiffness: Array, mass: Array, rows: Array
) -> tuple[list[Array], list[Array], list[Array]]:
    """K + shift M and M of each block, (m, n, n), and its responses to unit loads, (m, n, n_loads)."""
    energies, masses, responses = [], [], []
    start = 0
    for block in operator.blocks:
        part = slice(start, start + block.size)
        start = part.stop
        m = block.mass.assemble(mass)
        k = block.stiffness.assemble(stiffness) + model.shift * m
        energies.append(k)
        masses.append(m)
        responses.append(np.linalg.solve(k, np.swapaxes(rows[:, model.loads, part], 1, 2)))
    return energies, masses, responses


def _ritz(
    model: LocalModel, energies: list[Array], masses: list[Array], responses: list[Array], rows: Array
) -> tuple[Array, Array, Array]:
    """Energy and mass of the Ritz basis (m, r, r), and its five fields at the place, (m, 5, r)."""
    m, r, n_loads = len(rows), sum(model.leading), len(model.loads)
    a, b = (np.zeros((m, r + n_loads, r + n_loads)) for _ in range(2))
    at_place = np.zeros((m, len(FIELDS), r + n_loads))
    start, column = 0, 0
    for k, mass, g, n in zip(energies, masses, responses, model.leading, strict=True):
        here = rows[:, :, start : start + k.shape[-1]]
        lead = slice(column, column + n)
        start, column = start + k.shape[-1], lead.stop
        inertia = mass @ g
        a[:, lead, lead], b[:, lead, lead] = k[:, :n, :n], mass[:, :n, :n]
        at_place[:, :, lead] = here[:, :, :n]
        at_place[:, :, r:] += here @ g
        b[:, lead, r:] = inertia[:, :n]
        b[:, r:, r:] += np.swapaxes(g, 1, 2) @ inertia
    # (K + shift M) g is the load itself
    loaded = at_place[:, model.loads]
    a[:, r:] = loaded
    a[:, :r, r:] = np.swapaxes(loaded[:, :, :r], 1, 2)
    b[:, r:, :r] = np.swapaxes(b[:, :r, r:], 1, 2)
    i = np.arange(r, r + n_loads)
    diagonal = a[:, i, i]
    # where an edge holds the field, the load does nothing
    a[:, i, i] += np.where(diagonal > 0.0, _NUGGET * diagonal, 1.0)
    return a, b, at_place


def _in_basis(model: LocalModel, z: Array, responses: list[Array]) -> Array:
    """Vectors (m, k, r) of the Ritz basis in the basis common to all places, (m, k, n)."""
    r, column = sum(model.leading), 0
    blocks = []
    for g, n in zip(responses, model.leading, strict=True):
        phi = z[:, :, r:] @ np.swapaxes(g, 1, 2)
        phi[:, :, :n] += z[:, :, column : column + n]
        column += n
        blocks.append(phi)
    return np.concatenate(blocks, axis=-1)


def _plate_slopes(
    model: LocalModel, plate: Array, phi: Array, lam: Array, weights: Array, rows: Array, mass: Array
) -> Array:
    """Derivatives of the eigenvalues over the plate's own parameters, (m, n_modes, n_plate)."""
    operator, (m, n_modes, _) = model.bare.operator, phi.shape
    d_stiffness, d_mass = model.bare.coefficient_derivatives(plate)
    k_terms = np.zeros((m, n_modes, d_stiffness.shape[1]))
    m_terms = np.zeros((m, n_modes, d_mass.shape[1]))
    start = 0
    for block in operator.blocks:
        vectors = phi[:, :, start : start + block.size].reshape(m * n_modes, block.size)
        start += block.size
        k, mass_terms = block.energies(vectors)
        k_terms += k.reshape(k_terms.shape)
        m_terms += mass_terms.reshape(m_terms.shape)
    slope = k_terms @ d_stiffness - lam[..., None] * (m_terms @ d_mass)
    if "thickness" in model.bare.parameters:  # the rotary inertia of the mass
        i = model.bare.parameters.names.index("thickness")
        u = phi @ np.swapaxes(rows[:, 3:], 1, 2)
        slope[..., i] -= lam * np.einsum("mif,mf->mi", u**2, 2.0 * weights[:, 3:] / plate[:, i : i + 1])
    return np.asarray(slope)
