"""A reduced model of a plate: a small basis for the whole prior box, with an error for every frequency.

In each block of the operator the basis is made of modes solved at parameter sets that fill the box,
chosen greedily. Projection leaves the affine sum as it is, only smaller, so a
stack of parameter sets is solved at once. The error of a frequency follows from the residual of
its mode in the full space.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.forward_model.model import PlateModel, Prediction
from cpam_bayes.mechanics.affine import DenseOperator
from cpam_bayes.mechanics.modes import Spectrum, solve
from cpam_bayes.parameters import ParameterSet

Array = NDArray[Any]

# Amplification of a residual by the gap to the first mode that a basis lacks.
_GAP = 2.0


@dataclass(frozen=True, slots=True)
class ReductionSettings:
    """How a reduced model is built.

    tolerance : relative error of a frequency allowed at the training sets.
    training, checks : numbers of parameter sets that the basis is made from and examined at.
    rounds : how often the doubtful ones join the training.
    """

    tolerance: float = 5e-5
    training: int = 160
    checks: int = 400
    rounds: int = 4


DEFAULT_SETTINGS = ReductionSettings()


@dataclass(frozen=True, slots=True)
class ResidualForm:
    """Residuals of one block in the energy norm of a reference stiffness.

    images : (n_terms, n, r), L^-1 K_q V for the terms of K, then L^-1 M_q V for those of M, where
    L L^T is the reference stiffness, shifted to be definite, and V the reduced basis.
    """

    images: Array


@dataclass(frozen=True, slots=True)
class ReducedModel:
    """A plate on a small basis: parameter vectors in, frequencies and their errors out.

    fast : the projected operator.
    residuals : one ``ResidualForm`` a block, none of a model that knows no errors.
    reference : (8, 8) laminate stiffness of the residuals' norm.
    rounding : () what rounding in the full space may add to an eigenvalue, (rad/s)^2, for the reference
    stiffness.
    """

    full: PlateModel
    fast: PlateModel
    residuals: tuple[ResidualForm, ...]
    reference: Array
    rounding: Array

    @property
    def n_modes(self) -> int:
        """Number of modes predicted."""
        return self.full.n_modes

    @property
    def parameters(self) -> ParameterSet:
        """The parameters that vary, in the order of the vectors."""
        return self.full.parameters

    def admissible(self, x: Array) -> Array:
        """Whether parameter vectors (m, n) satisfy the constraints of the material, (m,) bool."""
        return self.full.admissible(x)

    def predict(self, x: Array, *, jacobian: bool = False) -> Prediction:
        """Frequencies at parameter vectors (m, n) and, if asked, their derivatives."""
        return self.fast.predict(x, jacobian=jacobian)

    def error(self, x: Array) -> Array:
        """Estimated relative error of the frequencies against the full space, (m, n_modes).

        delta f / f = g eta / (2 alpha), eta = |L^-1 (K - lambda M) v|^2 / lambda. alpha bounds K from
        below by the reference stiffness L L^T: it is the least eigenvalue of the laminate's
        stiffness against the reference one, or 1 if that is less. g stands for the gap,
        lambda_i / (lambda_i - lambda) of the first mode i that the basis lacks.
        """
        x = np.atleast_2d(x)
        stiffness, mass = self.fast.coefficients(x)
        spectrum = solve(self.fast.operator, stiffness, mass, self.n_modes, vectors=True)
        eta = _residual_norms(self.residuals, self.fast.operator, stiffness, mass, spectrum)
        state = self.fast.operator.problem.state(self.fast.parameters.mapping(x))
        alpha = coercivity(state.stiffness(), self.reference)
        rounding = self.rounding / spectrum.eigenvalues
        return np.asarray((_GAP * eta / np.minimum(alpha, 1.0)[..., None] + rounding) / 2.0)


def coercivity(stiffness: Array, reference: Array) -> Array:
    """Least eigenvalue of laminate stiffnesses (..., 8, 8) against a reference (8, 8), (...)."""
    back = np.linalg.inv(np.linalg.cholesky(reference))
    return np.asarray(np.linalg.eigvalsh(back @ stiffness @ back.T)[..., 0])


def _residual_norms(
    residuals: tuple[ResidualForm, ...],
    operator: DenseOperator,
    stiffness: Array,
    mass: Array,
    spectrum: Spectrum,
) -> Array:
    """|L^-1 (K - lambda M) v|^2 / lambda of every mode of a reduced operator, (m, n_modes)."""
    if spectrum.vectors is None:
        raise ValueError("the spectrum was solved without vectors; solve with vectors=True")
    eta = np.zeros_like(spectrum.eigenvalues)
    for b, (block, form) in enumerate(zip(operator.blocks, residuals, strict=True)):
        sets, modes = np.nonzero(spectrum.block == b)
        if not len(sets):
            continue
        n_k = len(block.stiffness.active)
        n_terms, n, r = form.images.shape
        v = spectrum.vectors[b][sets, :, spectrum.column[sets, modes]]
        lam = spectrum.eigenvalues[sets, modes]
        weight = np.empty((len(sets), n_terms, r))
        weight[:, :n_k] = stiffness[sets][:, block.stiffness.active, None] * v[:, None]
        weight[:, n_k:] = -(lam[:, None] * mass[sets][:, block.mass.active])[..., None] * v[:, None]
        # one product for all modes: K and M of every set would be far larger than the modes
        images = np.moveaxis(form.images, 1, 0).reshape(n, n_terms * r)
        residual = weight.reshape(len(sets), n_terms * r) @ images.T
        eta[sets, modes] = np.sum(residual**2, axis=-1) / lam
    return eta
