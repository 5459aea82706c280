"""A reduced model on the part of its box where a posterior lies: fewer vectors say as much there."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from cpam_bayes.forward_model.reduced import ReducedModel, ResidualForm
from cpam_bayes.mechanics.affine import AffineOperator, DenseBlock
from cpam_bayes.mechanics.modes import Spectrum, solve

Array = NDArray[Any]

# Parameter sets at which rigid-body motions are computed: they depend on sizes alone.
_RIGID_SETS = 4
# Eigenvalues below this fraction of the first mode's are those of rigid-body motions.
_RIGID = 1e-3
# Vectors with less than this fraction of the largest singular value are rounding.
_RANK = 1e-9


def focused(model: ReducedModel, x: Array, tolerance: float, fraction: float = 1.0) -> ReducedModel:
    """A reduced model projected once more, on the principal directions of its modes at points x (m, n).

    Each block keeps its rigid-body motions and the fewest principal directions (proper orthogonal
    decomposition of the M-normalised mode vectors) with which this ``fraction`` of its frequencies at x is
    within ``tolerance``, relative, of that of ``model``.
    """
    operator = model.fast.operator
    stiffness, mass = model.fast.coefficients(x)
    spectrum = solve(operator, stiffness, mass, model.n_modes, vectors=True)
    bases = [
        _basis(b, block, stiffness, mass, spectrum, tolerance, fraction)
        for b, block in enumerate(operator.blocks)
    ]
    used = [b for b, basis in enumerate(bases) if basis.shape[1]]
    blocks = tuple(_projected(operator.blocks[b], bases[b]) for b in used)
    fast = replace(model.fast, operator=AffineOperator(operator.problem, operator.space, blocks))
    residuals = tuple(ResidualForm(model.residuals[b].images @ bases[b]) for b in used if model.residuals)
    return replace(model, fast=fast, residuals=residuals)


def _basis(
    b: int,
    block: DenseBlock,
    stiffness: Array,
    mass: Array,
    spectrum: Spectrum,
    tolerance: float,
    fraction: float,
) -> Array:
    """Vectors (n, r) of one block, orthonormal in the mass of the first parameter set."""
    assert spectrum.vectors is not None
    root = np.linalg.cholesky(block.mass.assemble(mass[0])).T
    rigid = _principal(root @ _rigid(block, stiffness, mass, float(spectrum.eigenvalues.min())))
    sets, modes = np.nonzero(spectrum.block == b)
    if not len(sets):
        return np.asarray(np.linalg.solve(root, rigid))
    column, lam = spectrum.column[sets, modes], spectrum.eigenvalues[sets, modes]
    shapes = root @ spectrum.vectors[b][sets, :, column].T
    directions = _principal(shapes - rigid @ (rigid.T @ shapes))
    every = np.linalg.qr(np.column_stack((rigid, directions)))[0]
    distinct, place = np.unique(sets, return_inverse=True)

    def error(size: int) -> float:
        small = _projected(block, np.linalg.solve(root, every[:, :size]))
        eigenvalues = small.eigenvalues(stiffness[distinct], mass[distinct], size)[place, column]
        return float(np.quantile(np.sqrt(np.abs(eigenvalues) / lam) - 1.0, fraction, method="higher"))

    # more vectors never raise an error: the least number is found by halving
    low, high = max(int(column.max()), rigid.shape[1]), every.shape[1]
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if error(middle) <= tolerance else (middle, high)
    return np.asarray(np.linalg.solve(root, every[:, :high]))


def _rigid(block: DenseBlock, stiffness: Array, mass: Array, first: float) -> Array:
    """Rigid-body motions of a block at a few parameter sets, (n, k)."""
    vectors = []
    for i in np.unique(np.linspace(0, len(stiffness) - 1, _RIGID_SETS).astype(int)):
        lam, phi = scipy.linalg.eigh(block.stiffness.assemble(stiffness[i]), block.mass.assemble(mass[i]))
        vectors.append(phi[:, np.abs(lam) < _RIGID * first])
    return np.concatenate(vectors, axis=1)


def _principal(columns: Array) -> Array:
    """Orthonormal principal directions of columns (n, k), the largest first, (n, rank)."""
    if not columns.shape[1]:
        return np.empty((len(columns), 0))
    vectors, size, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(vectors[:, size > _RANK * size.max(initial=0.0)])


def _projected(block: DenseBlock, basis: Array) -> DenseBlock:
    return DenseBlock(
        block.stiffness.project(basis), block.mass.project(basis), np.arange(basis.shape[1]), block.n_terms
    )
