"""Frequencies of a plate with a local change anywhere, on a small basis for each parameter set.

It consists of modes of the bare plate and its static responses to loads where the change is, see
``mechanics.loaded``. Both are expressed in one larger basis, common to all places.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from cpam_bayes.forward_model.local.fields import FieldPart, PointValues, values_at_points
from cpam_bayes.forward_model.model import PlateModel, Prediction, biased
from cpam_bayes.mechanics.affine import inverse_roots
from cpam_bayes.mechanics.loaded import (
    LoadedBlock,
    PlateModes,
    RitzBasis,
    at_points,
    in_common_basis,
    lowest_modes,
    ritz_basis,
)
from cpam_bayes.mechanics.problem import Array, Atom, Derivative, rigid_body_count
from cpam_bayes.parameters import ParameterSet
from cpam_bayes.plate.edges import FIELDS


class Change(Protocol):
    """The protocol of a local change: a point mass, a softer patch."""

    def batches(self, added: Array) -> list[Array]:
        """Rows of the parameters of the change (m, k) that are solved together."""
        ...

    def predict(self, model: LocalModel, x: Array, jacobian: bool) -> Prediction:
        """Frequencies at parameter vectors (m, n) and, if asked, their derivatives."""
        ...


@dataclass(frozen=True)
class LocalModel:
    """A plate with a local change at any place: parameter vectors in, frequencies out.

    bare : the bare plate on the basis common to all places, orthonormal in a reference energy, with the
        plate's parameters. Its symmetries are the parts of one block, with its known masses.
    leading : number of vectors of each part that are the bare plate's own
    modes : number of modes of the bare plate in these, by part, that a parameter set's basis holds
    parts : fields of the basis
    added : parameters of the change: its size, its place as fractions of length and width, its extent or its
        radius of gyration
    shift : (rad/s)^2, of the energy K + shift M in which the plate responds to loads
    change : the local change
    """

    bare: PlateModel
    leading: tuple[int, ...]
    modes: tuple[int, ...]
    parts: tuple[FieldPart, ...]
    added: ParameterSet
    shift: float
    change: Change

    @property
    def n_modes(self) -> int:
        """Number of modes predicted."""
        return self.bare.n_modes

    @property
    def block(self) -> LoadedBlock:
        """The block of the bare plate."""
        (block,) = self.bare.operator.blocks
        assert isinstance(block, LoadedBlock)
        return block

    @property
    def error(self) -> Array:
        """Estimated relative error of each frequency of the bare plate, (n_modes,)."""
        return self.bare.error

    @cached_property
    def parameters(self) -> ParameterSet:
        """The plate's parameters, then those of the change."""
        return self.bare.parameters.union(self.added)

    def admissible(self, x: Array) -> Array:
        """True where parameter vectors (m, n) satisfy the constraints of the material, (m,) bool."""
        return self.bare.admissible(np.atleast_2d(x)[:, : self.bare.parameters.size])

    def predict(self, x: Array, *, jacobian: bool = False) -> Prediction:
        """Frequencies at parameter vectors (m, n) and, if asked, their derivatives.

        d lambda = phi^T (dK - lambda dM) phi with phi fixed, over constants and change.
        """
        x = np.atleast_2d(x)
        frequencies = np.empty((len(x), self.n_modes))
        slopes = np.empty((*frequencies.shape, x.shape[1])) if jacobian else None
        for rows in self.change.batches(self.split(x)[1]):
            batch = self.change.predict(self, x[rows], jacobian)
            frequencies[rows] = batch.frequencies
            if slopes is not None:
                slopes[rows] = batch.jacobian
        return biased(Prediction(frequencies, slopes), self.bare.bias)

    def split(self, x: Array) -> tuple[Array, Array]:
        """The plate's parameters and those of the change, of parameter vectors (m, n)."""
        n = self.bare.parameters.size
        return x[:, :n], x[:, n:]


def bare_modes(model: LocalModel, plate: Array) -> PlateModes:
    """Modes of the bare plate without its known masses at parameter vectors (m, n)."""
    stiffness, inertia = model.bare.coefficients(plate)
    modes = PlateModes([], [], [], [])
    for block, n, k in zip(model.block.parts, model.leading, model.modes, strict=True):
        b = block.mass.assemble(inertia)
        a = block.stiffness.assemble(stiffness) + model.shift * b
        v, mu = _whitened(a[:, :n, :n], b[:, :n, :n], k)
        for of, one in zip(
            (modes.energy, modes.mass, modes.vectors, modes.masses), (a, b, v, mu), strict=True
        ):
            of.append(one)
    return modes


def changed_plate(
    model: LocalModel, bare: PlateModes, plate: Array, loads: Array
) -> tuple[RitzBasis, Array, Array]:
    """Basis, K + shift M and M (m, r, r) of the bare plate, for a change with loads (m, n_loads, n).

    The basis is its modes and its responses to the change and to its known masses, which K + shift M and M
    include.
    """
    block, m = model.block, len(plate)
    known = np.broadcast_to(block.rows, (m, *block.rows.shape))
    basis = ritz_basis(bare, np.concatenate((loads, known), axis=1))
    if not len(block.rows):
        return basis, basis.energy, basis.mass
    there = at_points(block.rows, basis)
    _, mass = model.bare.coefficients(plate)
    added = np.swapaxes(there, 1, 2) @ ((mass @ block.inertia)[..., None] * there)
    return basis, basis.energy + model.shift * added, basis.mass + added


def _whitened(energy: Array, mass: Array, k: int) -> tuple[Array, Array]:
    """The k lowest modes (m, n, k), of unit energy, and their masses (m, k)."""
    inverse = inverse_roots(energy)
    back = np.swapaxes(inverse, 1, 2)
    mu, v = np.linalg.eigh(inverse @ mass @ back)
    return back @ v[:, :, -k:], mu[:, -k:]


def eigenvalues(model: LocalModel, energy: Array, mass: Array, vectors: bool) -> tuple[Array, Array | None]:
    """Eigenvalues (m, n_modes) of deformation modes and, if asked, M-normalised vectors (m, n_modes, r)."""
    n_rigid = rigid_body_count(model.bare.operator.problem.edges)
    modes = slice(n_rigid, n_rigid + model.n_modes)
    return lowest_modes(energy, mass, model.shift, modes, vectors=vectors)


def prediction(lam: Array, slope: Array | None) -> Prediction:
    """Frequencies from eigenvalues (m, n_modes), with their derivatives (m, n_modes, n)."""
    f = np.sqrt(np.maximum(lam, 0.0)) / (2 * np.pi)
    return Prediction(f, None if slope is None else slope / (8 * np.pi**2 * f[..., None]))


def plate_slopes(model: LocalModel, slopes: tuple[Array, Array], phi: Array, lam: Array) -> Array:
    """Derivatives of the bare plate's energies over its parameters, (m, n_modes, n_plate).

    slopes : of the coefficients of K and M, (m, n_terms, n_plate) each
    """
    m, n_modes, n = phi.shape
    d_stiffness, d_mass = slopes
    energies = model.block.energies(phi.reshape(m * n_modes, n))
    k_terms, m_terms = (e.reshape(m, n_modes, -1) for e in energies)
    return np.asarray(k_terms @ d_stiffness - lam[..., None] * (m_terms @ d_mass))


# Parameter sets solved at a time: their matrices fit in the processor's cache.
_BATCH = 64
_AXES: tuple[Derivative, Derivative] = ("x", "y")


@dataclass(frozen=True, slots=True)
class PointMass:
    """A mass glued to the surface; parameters are the mass, its place and its radius of gyration.

    loads : indices of the fields on which its inertia acts
    """

    loads: tuple[int, ...]

    def batches(self, added: Array) -> list[Array]:
        """Rows of the parameters of the change (m, 4) that are solved together."""
        rows = np.arange(len(added))
        return [rows[i : i + _BATCH] for i in range(0, len(rows), _BATCH)]

    def predict(self, model: LocalModel, x: Array, jacobian: bool) -> Prediction:
        """Frequencies at parameter vectors (m, n) and, if asked, their derivatives."""
        plate, added = model.split(x)
        mass, gyration, m = added[:, 0], added[:, 3], len(x)
        weights = point_inertia(model, plate, mass, gyration)
        points = PointValues(added[:, 1]), PointValues(added[:, 2])
        rows = rows_in_basis(model, points, "", m)
        basis, energy, inertia = changed_plate(model, bare_modes(model, plate), plate, rows[:, self.loads])
        at_place = at_points(rows, basis)
        mass_there = np.swapaxes(at_place, 1, 2) @ (weights[:, :, None] * at_place)
        lam, z = eigenvalues(model, energy + model.shift * mass_there, inertia + mass_there, jacobian)
        if z is None:
            return prediction(lam, None)
        phi = in_common_basis(z, basis)
        n_plate = plate.shape[1]
        slope = np.empty((*lam.shape, x.shape[1]))
        slope[..., :n_plate] = plate_slopes(model, model.bare.coefficient_derivatives(plate), phi, lam)
        u = phi @ np.swapaxes(rows, 1, 2)
        turning = np.einsum("mif,mif->mi", u[..., 3:], u[..., 3:])
        if "thickness" in model.bare.parameters:  # the rotary inertia of the mass
            i = model.bare.parameters.names.index("thickness")
            slope[..., i] -= lam * turning * (0.5 * mass * plate[:, i])[:, None]
        of_one = point_inertia(model, plate, np.ones(m), gyration)
        slope[..., n_plate] = -lam * np.einsum("mif,mf->mi", u**2, of_one)
        for k, axis in enumerate(_AXES):
            du = phi @ np.swapaxes(rows_in_basis(model, points, axis, m), 1, 2)
            slope[..., n_plate + 1 + k] = -2.0 * lam * np.einsum("mif,mif,mf->mi", u, du, weights)
        slope[..., n_plate + 3] = -2.0 * lam * turning * (mass * gyration)[:, None]
        return prediction(lam, slope)


def rows_in_basis(
    model: LocalModel, points: tuple[PointValues, PointValues], derivative: Derivative, m: int
) -> Array:
    """The five fields of the basis at one point per parameter set, (m, 5, n)."""
    n_basis = model.block.size
    return np.stack(
        [values_at_points(model.parts, n_basis, Atom(f, derivative), *points, m) for f in FIELDS], axis=1
    )


def point_inertia(model: LocalModel, plate: Array, mass: Array, gyration: Array) -> Array:
    """Inertia: m for u, v, w and m ((h / 2)^2 + r^2) for the rotations, (m, 5)."""
    thickness = model.bare.operator.problem.state(model.bare.parameters.mapping(plate)).thickness
    rotary = mass * ((np.asarray(thickness) / 2) ** 2 + gyration**2)
    return np.stack([mass, mass, mass, rotary, rotary], axis=-1)
