"""Eigenpairs of a dense affine operator: frequencies, mode vectors, derivatives, rigid-body count."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from cpam_bayes.affine import AffineMatrix, AffineOperator, Block
from cpam_bayes.problem import rigid_body_count

Array = NDArray[Any]

# A rigid-body motion has eigenvalue zero but for rounding, which grows with the range of K (up to
# 2e11 on thin plates); a deformation mode has not.
RIGID_TOLERANCE = 1e-4
# From this size on LAPACK finds a few eigenvectors sooner than all of them.
LARGE = 100


class RigidBodyError(ValueError):
    """The number of zero-frequency modes is not the one that the edges leave."""


@dataclass(frozen=True, slots=True)
class Spectrum:
    """Lowest deformation modes of a stack of m parameter sets.

    eigenvalues : (m, n_modes), (rad/s)^2, ascending. block, column : (m, n_modes), where the
    mode's vector stands in ``vectors``: one array (m, n_block, n_kept) a block, M-normalised, or
    ``None``. rigid : (m, n_rigid) eigenvalues of the rigid-body motions.
    """

    eigenvalues: Array
    block: Array
    column: Array
    vectors: tuple[Array, ...] | None
    rigid: Array

    @property
    def frequencies(self) -> Array:
        """Natural frequencies, (m, n_modes), Hz."""
        return np.sqrt(np.maximum(self.eigenvalues, 0.0)) / (2 * np.pi)

    def vector(self, index: int, mode: int) -> tuple[int, Array]:
        """Block of one mode and its vector in that block."""
        if self.vectors is None:
            raise ValueError("the spectrum was solved without vectors; solve with vectors=True")
        b = int(self.block[index, mode])
        return b, self.vectors[b][index, :, int(self.column[index, mode])]


def _whitened(block: Block, stiffness: Array, mass: Array) -> tuple[Array, Array, bool]:
    """K in coordinates in which M is the identity, and the map back (diagonal or full)."""
    k = block.stiffness.assemble(stiffness)
    if is_diagonal(block.mass):
        diagonal = np.diagonal(block.mass.stack, axis1=1, axis2=2)
        scale = 1.0 / np.sqrt(mass[..., block.mass.active] @ diagonal)
        return k * scale[..., :, None] * scale[..., None, :], scale, True
    back = np.linalg.inv(np.linalg.cholesky(block.mass.assemble(mass)))
    back = np.swapaxes(back, -1, -2)
    return np.swapaxes(back, -1, -2) @ k @ back, back, False


def is_diagonal(matrix: AffineMatrix) -> bool:
    """Whether every matrix of the sum is diagonal."""
    off = matrix.stack.copy()
    i = np.arange(off.shape[-1])
    off[:, i, i] = 0.0
    return not off.any()


def solve(
    operator: AffineOperator, stiffness: Array, mass: Array, n_modes: int, *, vectors: bool = False
) -> Spectrum:
    """Lowest deformation modes, K phi = lambda M phi, of a stack of coefficient sets.

    stiffness (m, n_stiffness), mass (m, n_mass): coefficients as from ``operator.coefficients``.
    The number of rigid-body motions is known from the edges and taken off. Raises
    ``RigidBodyError`` if the lowest eigenvalues show another number, ``ValueError`` if the space
    is smaller than what is asked for.
    """
    stiffness, mass = np.atleast_2d(stiffness), np.atleast_2d(mass)
    n_rigid = rigid_body_count(operator.problem.edges)
    wanted = n_modes + n_rigid
    if sum(b.size for b in operator.blocks) <= wanted:
        raise ValueError(f"{n_modes} modes asked for, the space has {sum(b.size for b in operator.blocks)}")
    values, shapes = [], []
    for block in operator.blocks:
        k, back, diagonal = _whitened(block, stiffness, mass)
        if vectors:
            lam, phi = _lowest_eigenpairs(k, min(wanted, block.size))
            shapes.append(back[..., :, None] * phi if diagonal else back @ phi)
        else:
            lam = np.linalg.eigvalsh(k)
        values.append(lam[..., : min(wanted, block.size)])
    counts = [v.shape[-1] for v in values]
    owner = np.repeat(np.arange(len(counts)), counts)
    place = np.concatenate([np.arange(c) for c in counts])
    pooled = np.concatenate(values, axis=-1)
    order = np.argsort(pooled, axis=-1, kind="stable")[..., : n_rigid + n_modes]
    ranked = np.take_along_axis(pooled, order, axis=-1)
    _check_rigid(ranked, n_rigid)
    order = order[..., n_rigid:]
    return Spectrum(
        eigenvalues=ranked[..., n_rigid:],
        block=owner[order],
        column=place[order],
        vectors=tuple(shapes) if vectors else None,
        rigid=ranked[..., :n_rigid],
    )


def _lowest_eigenpairs(k: Array, n: int) -> tuple[Array, Array]:
    """The n lowest eigenpairs of a stack of symmetric matrices (m, size, size)."""
    if k.shape[-1] < LARGE:
        lam, phi = np.linalg.eigh(k)
        return lam[..., :n], phi[..., :n]
    pairs = [scipy.linalg.eigh(one, subset_by_index=(0, n - 1), driver="evr") for one in k]
    return np.stack([p[0] for p in pairs]), np.stack([p[1] for p in pairs])


def _check_rigid(ranked: Array, n_rigid: int) -> None:
    first = ranked[..., n_rigid]
    largest = np.abs(ranked[..., :n_rigid]).max(axis=-1, initial=0.0)
    if np.any(first <= 0.0) or np.any(largest > RIGID_TOLERANCE * first):
        raise RigidBodyError(
            f"the edges leave {n_rigid} rigid-body motions, the lowest eigenvalues are "
            f"{ranked.reshape(-1, ranked.shape[-1])[0][: n_rigid + 2]} (rad/s)^2"
        )


def energy_terms(operator: AffineOperator, spectrum: Spectrum) -> tuple[Array, Array]:
    """phi^T K_q phi and phi^T M_q phi of every mode and term, (m, n_modes, n_terms) each.

    With them d lambda / d p = sum_q (d theta_q / d p) phi^T K_q phi - lambda (d mu_q / d p) phi^T M_q phi.
    """
    if spectrum.vectors is None:
        raise ValueError("the spectrum was solved without vectors; solve with vectors=True")
    m, n_modes = spectrum.eigenvalues.shape
    problem = operator.problem
    energy = {
        "stiffness": np.zeros((m, n_modes, len(problem.forms("stiffness")))),
        "mass": np.zeros((m, n_modes, len(problem.forms("mass")))),
    }
    for b, block in enumerate(operator.blocks):
        sets, modes = np.nonzero(spectrum.block == b)
        if not len(sets):
            continue
        phi = spectrum.vectors[b][sets, :, spectrum.column[sets, modes]]
        for kind, matrix in (("stiffness", block.stiffness), ("mass", block.mass)):
            images = np.einsum("qij,kj->kqi", matrix.stack, phi, optimize=True)
            energy[kind][sets[:, None], modes[:, None], matrix.active] = np.einsum(
                "kqi,ki->kq", images, phi
            )
    return energy["stiffness"], energy["mass"]
