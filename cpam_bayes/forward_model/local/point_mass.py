"""A point mass at any place of a plate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.forward_model.local.fields import PointValues, values_at_points
from cpam_bayes.forward_model.local.model import (
    LocalModel,
    RitzBasis,
    bare_modes,
    eigenvalues,
    in_common_basis,
    plate_slopes,
    prediction,
    ritz_basis,
)
from cpam_bayes.forward_model.model import Prediction
from cpam_bayes.mechanics.problem import FIELDS, Atom, Derivative

Array = NDArray[Any]
# Parameter sets solved at a time: their matrices stay in the processor's cache.
_BATCH = 64
_AXES: tuple[Derivative, Derivative] = ("x", "y")


@dataclass(frozen=True, slots=True)
class PointMass:
    """A mass glued to the surface; parameters are the mass, its place and its radius of gyration.

    loads : fields on which its inertia acts, by their numbers
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
        weights = _inertia(model, plate, mass, gyration)
        points = PointValues(added[:, 1]), PointValues(added[:, 2])
        rows = _rows(model, points, "", m)
        basis = ritz_basis(bare_modes(model, plate), rows[:, self.loads])
        at_place = _at_place(model, rows, basis)
        mass_there = np.swapaxes(at_place, 1, 2) @ (weights[:, :, None] * at_place)
        lam, z = eigenvalues(
            model, basis.energy + model.shift * mass_there, basis.mass + mass_there, jacobian
        )
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
        of_one = _inertia(model, plate, np.ones(m), gyration)
        slope[..., n_plate] = -lam * np.einsum("mif,mf->mi", u**2, of_one)
        for k, axis in enumerate(_AXES):
            du = phi @ np.swapaxes(_rows(model, points, axis, m), 1, 2)
            slope[..., n_plate + 1 + k] = -2.0 * lam * np.einsum("mif,mif,mf->mi", u, du, weights)
        slope[..., n_plate + 3] = -2.0 * lam * turning * (mass * gyration)[:, None]
        return prediction(lam, slope)


def _rows(
    model: LocalModel, points: tuple[PointValues, PointValues], derivative: Derivative, m: int
) -> Array:
    """The five fields of the basis at one point a parameter set, (m, 5, n)."""
    n_basis = sum(b.size for b in model.bare.operator.blocks)
    return np.stack(
        [values_at_points(model.parts, n_basis, Atom(f, derivative), *points, m) for f in FIELDS], axis=1
    )


def _at_place(model: LocalModel, rows: Array, basis: RitzBasis) -> Array:
    """The five fields of the Ritz basis at the place, (m, 5, r)."""
    leading, answers = [], np.zeros((*rows.shape[:2], basis.responses[0].shape[-1]))
    start = 0
    for v, g in zip(basis.modes, basis.responses, strict=True):
        leading.append(rows[:, :, start : start + v.shape[1]] @ v)
        answers += rows[:, :, start : start + g.shape[1]] @ g
        start += g.shape[1]
    return np.concatenate([*leading, answers], axis=-1)


def _inertia(model: LocalModel, plate: Array, mass: Array, gyration: Array) -> Array:
    """m for u, v, w and m ((h / 2)^2 + r^2) for the rotations, (m, 5)."""
    thickness = model.bare.operator.problem.state(model.bare.parameters.mapping(plate)).thickness
    rotary = mass * ((np.asarray(thickness) / 2) ** 2 + gyration**2)
    return np.stack([mass, mass, mass, rotary, rotary], axis=-1)
