"""A softer patch at any place of a plate, of any extent."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cpam_bayes.forward_model.local.fields import (
    ATOMS,
    BENT,
    STRAIN_OF,
    Parts,
    PatchForm,
    PatchPoints,
    PatchRule,
    patch_rules,
)
from cpam_bayes.forward_model.local.model import (
    LocalModel,
    bare_modes,
    changed_plate,
    eigenvalues,
    plate_slopes,
    prediction,
)
from cpam_bayes.forward_model.model import PlateModel, Prediction
from cpam_bayes.mechanics.loaded import columns_of, in_common_basis
from cpam_bayes.mechanics.problem import LAMINATE_ENTRIES, LAMINATE_FORMS, Array, rigid_body_count

SOFTENED = np.flatnonzero(LAMINATE_ENTRIES.min(axis=0) >= BENT[0])
_LEFT = np.array([ATOMS.index(LAMINATE_FORMS[q].left) for q in SOFTENED])
_RIGHT = np.array([ATOMS.index(LAMINATE_FORMS[q].right) for q in SOFTENED])

# Parameter sets solved at a time: their matrices fit in the processor's cache.
_BATCH = 32
# Modes beyond those predicted whose stresses load the patch.
FURTHER = 1
# Depth from which the lost energy is bounded by the plate's: below it every direction keeps some stiffness.
_DEEP = 0.5
# Quadrature points in each direction, up to each extent.
_POINTS: dict[PatchForm, tuple[tuple[float, int], ...]] = {
    "bell": ((0.06, 10), (0.12, 12), (0.2, 16), (np.inf, 20)),
    "rectangle": ((0.06, 6), (0.12, 8), (0.2, 11), (np.inf, 16)),
}
_TRAINING_POINTS = 16


@dataclass(frozen=True, slots=True)
class Patch:
    """Bending and transverse shear stiffness reduced by a fraction d g(x, y); parameters d, place and extent.

    form : of g, "bell" or "rectangle"
    radius : of an extent of one, in fractions of length and width
    """

    form: PatchForm
    radius: tuple[float, float]

    def batches(self, added: Array) -> list[Array]:
        """Rows of the parameters of the change (m, 4) that are solved together, of similar extent."""
        order = np.argsort(added[:, 3], kind="stable")
        return [order[i : i + _BATCH] for i in range(0, len(order), _BATCH)]

    def predict(self, model: LocalModel, x: Array, jacobian: bool) -> Prediction:
        """Frequencies at parameter vectors (m, n) and, if asked, their derivatives."""
        plate, added = model.split(x)
        depth = added[:, 0, None, None]
        sizes, roots = _sides(model.bare, plate)
        at = PatchPoints(model.parts, self.rules(added[:, 1:]), sizes)
        bare = bare_modes(model, plate)
        of_modes = roots @ at.rows(bare.vectors, columns_of(bare.vectors))
        of_modes = of_modes.reshape(len(x), -1, sum(model.modes))
        chosen = _lowest(model, bare.masses)
        n_loads = chosen.shape[1]
        strained = np.take_along_axis(of_modes, chosen[:, None], axis=2).reshape(len(x), len(BENT), -1)
        loads = at.loads(np.swapaxes(roots, 1, 2) @ strained, n_loads)
        basis, energy, mass = changed_plate(model, bare, plate, loads)
        n_answers = n_loads + len(model.block.rows)
        of_answers = roots @ at.rows(basis.responses, [slice(0, n_answers)] * len(basis.responses))
        rows = np.concatenate((of_modes, of_answers.reshape(len(x), -1, n_answers)), axis=2)
        lost = np.swapaxes(rows, 1, 2) @ rows
        deep = np.flatnonzero(added[:, 0] > _DEEP)
        if len(deep):
            lost[deep] = _bounded(basis.energy[deep], lost[deep])
        lam, z = eigenvalues(model, energy - depth * lost, mass, jacobian)
        if z is None:
            return prediction(lam, None)
        phi = in_common_basis(z, basis)
        slopes = model.bare.coefficient_derivatives(plate)
        of_plate, of_change = self._slopes(model, added, phi, slopes[0], roots @ _strains_of_atoms(sizes))
        of_plate = plate_slopes(model, slopes, phi, lam) - depth * of_plate
        return prediction(lam, np.concatenate((of_plate, -of_change), axis=-1))

    def rules(
        self, where: Array, *, with_ends: bool = False, points: int | None = None
    ) -> tuple[PatchRule, PatchRule]:
        """Quadratures in x and y over patches at places and with extents (m, 3)."""
        width = where[:, 2:] * np.array(self.radius)
        ends, counts = zip(*_POINTS[self.form], strict=True)
        n = np.array(counts)[np.searchsorted(ends, where[:, 2])]
        return patch_rules(
            self.form, where[:, :2], width, n if points is None else np.full_like(n, points), with_ends
        )

    def _slopes(
        self, model: LocalModel, added: Array, phi: Array, slopes: Array, roots: Array
    ) -> tuple[Array, Array]:
        """Derivatives of the energies that vectors (m, n_modes, n) lose in the patch.

        By the plate's parameters, at a depth of one, and by those of the change.

        slopes : of the coefficients of the stiffness, (m, n_terms, n_plate)
        roots : (m, 5, n_atoms): its square times derivatives is an energy density
        """
        (m, n_modes, _), n_blocks = phi.shape, len(model.leading)
        rules = self.rules(added[:, 1:], with_ends=True)
        ends = np.cumsum([0, *(block.size for block in model.block.parts)]).tolist()
        vectors = [
            np.ascontiguousarray(np.swapaxes(phi[:, :, ends[b] : ends[b + 1]], 1, 2)) for b in range(n_blocks)
        ]
        atoms = PatchPoints(model.parts, rules).rows(vectors, [slice(0, n_modes)] * n_blocks)
        density = np.sum((roots @ atoms) ** 2, axis=1).reshape(m, -1, n_modes)
        weights = _moved_weights(self, rules)
        of_change = np.concatenate((weights[:, :1], added[:, :1, None] * weights[:, 1:]), axis=1) @ density
        atoms = atoms.reshape(m, len(ATOMS), -1, n_modes)
        return _form_slopes(model, slopes, atoms, weights[:, :1]), np.swapaxes(of_change, 1, 2)


def lost_energy(patch: Patch, model: LocalModel, plate: Array, added: Array, energy: Array) -> Array:
    """Energy that the basis vectors of one block lose in a patch at a depth of one, (m, r, r).

    energy : of the vectors, (m, r, r)
    """
    m, _, r = energy.shape
    sizes, roots = _sides(model.bare, plate)
    at = PatchPoints(model.parts, patch.rules(added[:, 1:]), sizes)
    rows = (roots @ at.rows([np.broadcast_to(np.eye(r), (m, r, r))], [slice(0, r)])).reshape(m, -1, r)
    lost = np.swapaxes(rows, 1, 2) @ rows
    deep = np.flatnonzero(added[:, 0] > _DEEP)
    if len(deep):
        lost[deep] = _bounded(energy[deep], lost[deep])
    return np.asarray(lost)


def _bounded(energy: Array, lost: Array) -> Array:
    """Energies (m, r, r) of a patch, bounded by that of the plate.

    A response may vary so fast that the quadrature over the patch exceeds the energy that there is.
    """
    root = np.linalg.cholesky(energy)
    back = np.linalg.inv(root)
    share, directions = np.linalg.eigh(back @ lost @ np.swapaxes(back, 1, 2))
    directions = root @ directions
    bounded = (directions * np.minimum(share, 1.0)[:, None]) @ np.swapaxes(directions, 1, 2)
    return np.where(share[:, -1, None, None] > 1.0, bounded, lost)


def _moved_weights(patch: Patch, rules: tuple[PatchRule, PatchRule]) -> Array:
    """Weights of the points of the patch and their derivatives by x, y and the extent, (m, 4, n_points)."""
    along, across = rules
    pairs = (
        (along.weight, across.weight),
        (along.per_centre, across.weight),
        (along.weight, across.per_centre),
        (patch.radius[0] * along.per_width, across.weight),
        (along.weight, patch.radius[1] * across.per_width),
    )
    # points in the order of _grid_values: y before x
    parts = [(b[:, :, None] * a[:, None, :]).reshape(len(a), -1) for a, b in pairs]
    return np.stack((*parts[:3], parts[3] + parts[4]), axis=1)


def _sides(bare: PlateModel, plate: Array) -> tuple[dict[str, Array], Array]:
    """Lengths that divide derivatives, (m,), and R (m, 5, 5): (R strain)^2 is an energy density."""
    state = bare.operator.problem.state(bare.parameters.mapping(plate))
    m = len(plate)
    stiffness = state.stiffness()[..., BENT[0] :, BENT[0] :]
    roots = np.swapaxes(np.linalg.cholesky(stiffness), -1, -2) * np.sqrt(state.area)[..., None, None]
    sizes = {"length": state.length, "width": state.width, "": np.ones(())}
    return (
        {name: np.broadcast_to(size, (m,)) for name, size in sizes.items()},
        np.broadcast_to(roots, (m, len(BENT), len(BENT))),
    )


def _strains_of_atoms(sizes: dict[str, Array]) -> Array:
    """Maps (m, 5, 8) of derivatives of the fields to strains."""
    out = np.zeros((len(sizes[""]), len(BENT), len(ATOMS)))
    for i, (q, size) in enumerate(STRAIN_OF):
        out[:, q, i] = 1.0 / sizes[size]
    return out


def _form_slopes(model: LocalModel, slopes: Array, atoms: Array, weight: Array) -> Array:
    """Derivatives of the energies in the patch by the plate's parameters, (m, n_modes, n_plate)."""
    first = 0
    for term in model.bare.operator.problem.terms:
        if term.name == "laminate":
            break
        first += len(term.forms) if term.matrix == "stiffness" else 0
    of_modes = np.moveaxis(atoms, 3, 1)  # (m, n_modes, atoms, points)
    gram = (of_modes * weight[:, None]) @ np.swapaxes(of_modes, 2, 3)
    energies = gram[:, :, _LEFT, _RIGHT] * np.where(_LEFT == _RIGHT, 1.0, 2.0)
    return np.asarray(energies @ slopes[:, first + SOFTENED])


def _lowest(model: LocalModel, masses: list[Array]) -> Array:
    """Columns (m, k) of the modes that load the patch: the lowest deformation modes."""
    first = rigid_body_count(model.bare.operator.problem.edges)
    order = np.argsort(-np.concatenate(masses, axis=1), axis=1)
    return np.asarray(order[:, first : first + model.n_modes + FURTHER])


def loads_of_modes(
    patch: Patch, plain: PlateModel, parts: Parts, plate: Array, where: Array, modes: list[Array]
) -> Array:
    """Work of the stresses of modes over patches on the basis, with all stiffness lost, (m, k, n).

    plate : the plate's parameters, (n_plate,)
    where : place and extent, (m, 3)
    modes : of each block, (n, k)
    """
    m, k = len(where), modes[0].shape[1]
    sizes, roots = _sides(plain, np.tile(plate, (m, 1)))
    at = PatchPoints(parts, patch.rules(where, points=_TRAINING_POINTS), sizes)
    strains = at.rows([np.broadcast_to(v, (m, *v.shape)) for v in modes], [slice(0, k)] * len(modes))
    return at.loads(np.swapaxes(roots, 1, 2) @ (roots @ strains), k)
