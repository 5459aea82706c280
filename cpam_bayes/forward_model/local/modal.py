"""A plate on a few of its own modes: made from a few full solves, accurate to a few per cent of a change.

Rayleigh-Ritz in modes of the plate at the parameter sets that matter, in its rigid-body motions and in its
static responses to the inertia of known masses (residual flexibility: MacNeal, Comput. Struct. 1, 1971). For
questions that need no more digits: which further test tells causes apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from cpam_bayes.effects import Effect, add_known_mass
from cpam_bayes.forward_model.local.basis import patch_of, rows_at
from cpam_bayes.forward_model.local.fields import FieldPart, PointValues, field_parts
from cpam_bayes.forward_model.local.model import (
    LocalModel,
    PointMass,
    eigenvalues,
    point_inertia,
    prediction,
    rows_in_basis,
)
from cpam_bayes.forward_model.local.patch import Patch, lost_energy
from cpam_bayes.forward_model.model import PlateModel, Prediction
from cpam_bayes.forward_model.reduced import by_field
from cpam_bayes.mechanics.affine import AffineOperator
from cpam_bayes.mechanics.loaded import LoadedBlock, symmetry_parts
from cpam_bayes.mechanics.modes import SUPPORTED_TOLERANCE
from cpam_bayes.mechanics.problem import Array, rigid_body_count
from cpam_bayes.plate import Sensor

# Modes kept beyond those predicted.
_FURTHER = 16
# Shift of the energy over the lowest eigenvalue: it makes a free plate stiff.
_SHIFT = 0.3
# Eigenvalues below this fraction of the first mode's are those of rigid-body motions.
_RIGID = 1e-3
# Amplitudes of directions, of vectors of unit energy, that are left out of modes and of rigid-body motions.
_RANK, _SAME = 1e-3, 1e-9


@dataclass(frozen=True, slots=True)
class ModalPlate:
    """A plate on its modes.

    model : the plate, all modes in one block
    parts : fields of the modes
    shift : (rad/s)^2, of an energy K + shift M that is definite
    """

    model: PlateModel
    parts: tuple[FieldPart, ...]
    shift: float


def on_modes(full: PlateModel, x: Array, masses: Sequence[Sensor] = ()) -> ModalPlate:
    """A plate on its modes at parameter vectors x (m, n), with known masses that ``full`` does not have.

    The n_modes + 16 lowest modes of each parameter set are taken.
    """
    operator, problem = full.operator, full.operator.problem
    block = symmetry_parts(operator)
    stiffness, mass = full.coefficients(np.atleast_2d(x))
    wanted = rigid_body_count(problem.edges) + full.n_modes + _FURTHER
    pairs = [part.modes(stiffness, mass, min(wanted, part.size)) for part in block.parts]
    ranked = np.sort(np.concatenate([lam for lam, _ in pairs], axis=1), axis=1)[:, :wanted]
    first = float(ranked[0, rigid_body_count(problem.edges)])
    places = [(s.x / float(problem.nominal.length), s.y / float(problem.nominal.width)) for s in masses]
    at_places = rows_at(operator.space, block.parts, np.array(places).reshape(-1, 2))
    # those of the plate itself first, then the five fields of each added mass
    loads = [
        np.concatenate((own, np.swapaxes(rows, 0, 1).reshape(-1, own.shape[1])))
        for own, rows in zip(block.split(block.rows), at_places, strict=True)
    ]
    highest = (SUPPORTED_TOLERANCE if problem.supported else _RIGID) * first
    bases: list[Array] = []
    for part, load, (lam, v) in zip(block.parts, loads, pairs, strict=True):
        energy = part.stiffness.assemble(stiffness[0]) + _SHIFT * first * part.mass.assemble(mass[0])
        is_rigid = np.abs(lam) < highest
        rigid, modes = v[is_rigid].T, v[(lam <= ranked[:, -1:]) & ~is_rigid].T
        answers = scipy.linalg.solve(energy, load.T, assume_a="pos")
        root = np.linalg.cholesky(energy).T
        basis = _with_directions(np.empty((part.size, 0)), root @ by_field(operator, part, rigid), _SAME)
        basis = _with_directions(basis, root @ np.concatenate((modes, answers), axis=1), _RANK)
        bases.append(scipy.linalg.solve_triangular(root, basis))
    for sensor in masses:
        problem = add_known_mass(problem, sensor.mass, sensor.x, sensor.y)
    n_k, n_m = block.n_terms
    n_added = 5 * len(masses)
    joined = LoadedBlock(
        tuple(
            replace(part.project(v), n_terms=(n_k, n_m + n_added))
            for part, v in zip(block.parts, bases, strict=True)
        ),
        np.concatenate([load @ v for load, v in zip(loads, bases, strict=True)], axis=1),
        scipy.linalg.block_diag(block.inertia, np.eye(n_added)),
    ).dense()
    index, whole = np.concatenate([part.index for part in block.parts]), scipy.linalg.block_diag(*bases)
    projected = AffineOperator(problem, operator.space, (replace(joined, index=np.arange(joined.size)),))
    parts = field_parts(operator.space, [index], [whole])
    return ModalPlate(PlateModel(projected, full.n_modes, full.error), parts, _SHIFT * first)


def _with_directions(basis: Array, columns: Array, least: float) -> Array:
    """An orthonormal basis (n, r) extended by the directions of columns (n, k) above a least amplitude."""
    size = np.linalg.norm(columns, axis=0)
    # a load on a field that the block does not have causes no response
    columns = columns[:, size > 0.0] / size[size > 0.0]
    if not columns.shape[1]:
        return basis
    directions, size, _ = np.linalg.svd(columns - basis @ (basis.T @ columns), full_matrices=False)
    return np.asarray(np.linalg.qr(np.column_stack((basis, directions[:, size > least])))[0])


def changed_on_modes(plate: ModalPlate, effect: Effect) -> LocalModel:
    """A plate on its modes with an effect whose place is a parameter."""
    if effect.local is None:
        raise ValueError(f"effect {effect.name}: at any place, but its form is not given in `local`")
    (block,) = plate.model.operator.blocks
    n, loaded = block.size, symmetry_parts(plate.model.operator)
    model = replace(plate.model, operator=replace(plate.model.operator, blocks=(loaded,)))
    if effect.local == "point":
        change: PointMass | Patch = MassOnModes(())
    else:
        patch = patch_of(effect.local, plate.model.operator.problem)
        change = PatchOnModes(patch.form, patch.radius)
    return LocalModel(model, (n,), (n,), plate.parts, effect.parameter_set, plate.shift, change)


@dataclass(frozen=True, slots=True)
class MassOnModes(PointMass):
    """A mass glued to the surface of a plate on its modes."""

    def predict(self, model: LocalModel, x: Array, jacobian: bool) -> Prediction:
        """Frequencies at parameter vectors (m, n)."""
        plate, added = model.split(x)
        energy, mass = _plain(model, plate, jacobian)
        points = PointValues(added[:, 1]), PointValues(added[:, 2])
        rows = rows_in_basis(model, points, "", len(x))
        weights = point_inertia(model, plate, added[:, 0], added[:, 3])
        there = np.swapaxes(rows, 1, 2) @ (weights[:, :, None] * rows)
        return prediction(eigenvalues(model, energy + model.shift * there, mass + there, False)[0], None)


@dataclass(frozen=True, slots=True)
class PatchOnModes(Patch):
    """A softer patch of a plate on its modes."""

    def predict(self, model: LocalModel, x: Array, jacobian: bool) -> Prediction:
        """Frequencies at parameter vectors (m, n)."""
        plate, added = model.split(x)
        energy, mass = _plain(model, plate, jacobian)
        lost = lost_energy(self, model, plate, added, energy)
        return prediction(eigenvalues(model, energy - added[:, 0, None, None] * lost, mass, False)[0], None)


def _plain(model: LocalModel, plate: Array, jacobian: bool) -> tuple[Array, Array]:
    """K + shift M and M of a plate without its change at parameter vectors (m, n)."""
    if jacobian:
        raise ValueError("a plate on its modes has no derivatives; use its reduced model")
    (block,) = model.block.parts
    stiffness, inert = model.bare.coefficients(plate)
    mass = block.mass.assemble(inert)
    return block.stiffness.assemble(stiffness) + model.shift * mass, mass
