"""A reduced model of a plate: a small basis for the whole prior box, with an error for every frequency.

In each block of the operator the basis is made of modes solved at parameter sets that fill the box, chosen
greedily. Projection leaves the affine sum as it is, only smaller, so a stack of parameter sets is solved at
once. The error of a frequency follows from the residual of its mode in the full space. On the part of the box
where a posterior lies fewer vectors say as much.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from cpam_bayes.forward_model.model import PlateModel, Prediction, training_sets
from cpam_bayes.mechanics.affine import AffineMatrix, AffineOperator, DenseBlock, DenseOperator, RitzBlock
from cpam_bayes.mechanics.loaded import symmetry_parts
from cpam_bayes.mechanics.modes import SUPPORTED_TOLERANCE, Spectrum, solve
from cpam_bayes.mechanics.ritz import RitzSpace
from cpam_bayes.parameters import ParameterSet
from cpam_bayes.plate.edges import FIELDS

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
        """True where parameter vectors (m, n) satisfy the constraints of the material, (m,) bool."""
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
    operator: AffineOperator[RitzSpace, DenseBlock],
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


# LAPACK's bound: machine precision times the largest eigenvalue. Up to 0.6 of it was seen.
_ROUNDING_FACTOR = 1.0
# Modes that join a basis before its errors are estimated again.
_MODES_PER_ROUND = 3


def compressed(operator: DenseOperator, stiffness: Array, mass: Array) -> DenseOperator:
    """The operator with as few terms as its coefficients have independent directions.

    stiffness, mass : coefficients at many parameter sets (m, n_terms), which show the linear
    relations between them. A fixed layup of orthotropic plies has six stiffness terms, a fixed
    thickness and density one mass term.
    """
    blocks = [block.compressed(stiffness, mass) for block in operator.blocks]
    return AffineOperator(operator.problem, operator.space, tuple(blocks))


def reduce(
    model: PlateModel,
    rng: np.random.Generator,
    settings: ReductionSettings = DEFAULT_SETTINGS,
    *,
    light: bool = False,
) -> ReducedModel:
    """A reduced model that holds over the prior box of a converged plate.

    The basis of each block takes the modes that it represents worst, among those at
    ``settings.training`` parameter sets, until the frequencies of all are within
    ``settings.tolerance`` (a greedy method; the errors are the true ones). Of ``settings.checks``
    other sets and the corners of the box, those with the largest error estimates and a few more then
    join the training,
    until none of their errors is large.

    light : without residuals, for a model that only predictions are asked of
    """
    x = training_sets(model.operator.problem, settings.training, rng)
    stiffness, mass = model.coefficients(x)
    operator = compressed(model.operator, stiffness, mass)
    spectrum = solve(operator, stiffness, mass, model.n_modes, vectors=True)
    size = _log_trace(stiffness)
    middle = int(np.argmin(np.abs(size - np.median(size))))
    first = spectrum.eigenvalues[middle, 0]
    reference = _Reference(
        laminate=np.real(model.operator.problem.state(model.parameters.mapping(x[middle])).stiffness()),
        factors=tuple(_factor(b, stiffness[middle], mass[middle], first) for b in operator.blocks),
        rounding=_rounding(operator, stiffness[middle], mass[middle]),
    )
    bases = _rigid_vectors(operator, stiffness[middle], mass[middle], first)
    if model.operator.problem.rigid_content:  # rigid-body motions change with a parameter, linearly
        for other in (int(np.argmin(size)), int(np.argmax(size))):
            more = _rigid_vectors(operator, stiffness[other], mass[other], first)
            joined = (np.column_stack(pair) for pair in zip(bases, more, strict=True))
            bases = [_orthonormal(v, b, mass[middle]) for v, b in zip(joined, operator.blocks, strict=True)]
    if _sides_vary(model, x):
        bases = [
            _orthonormal(by_field(operator, block, rigid), block, mass[middle])
            for block, rigid in zip(operator.blocks, bases, strict=True)
        ]
    checks = np.vstack((_corners(model), training_sets(model.operator.problem, settings.checks, rng)))
    for last in (*(False,) * (settings.rounds - 1), True):
        bases = [
            _greedy_basis(b, operator, stiffness, mass, spectrum, basis, settings.tolerance)
            for b, basis in enumerate(bases)
        ]
        reduced = _assemble(model, operator, bases, reference, light=light and last)
        if last:
            break
        # the estimate does not see a mode that the basis lacks altogether: some sets are solved anyway
        estimate = reduced.error(checks).max(axis=1)
        doubtful = np.argsort(estimate)[::-1][: settings.checks // 10]
        doubtful = doubtful[estimate[doubtful] > 2.0 * settings.tolerance]
        examined = np.union1d(doubtful, np.arange(min(settings.checks // 10, len(checks))))
        stiffness, mass = model.coefficients(checks[examined])
        spectrum = solve(operator, stiffness, mass, model.n_modes, vectors=True)
        error = reduced.predict(checks[examined]).frequencies / spectrum.frequencies - 1.0
        if not len(doubtful) and error.max() <= 2.0 * settings.tolerance:
            break
        checks = np.delete(checks, examined, axis=0)
    return replace(reduced, residuals=()) if light else reduced


def _corners(model: PlateModel) -> Array:
    """Admissible corners of the prior box, at most 64 of them, (n, n_parameters)."""
    parameters = model.parameters
    signs = np.array(list(product((False, True), repeat=min(parameters.size, 6))))
    high = np.zeros((len(signs), parameters.size), dtype=bool)
    high[:, : signs.shape[1]] = signs
    corners = np.where(high, parameters.upper, parameters.lower)
    return corners[model.admissible(corners)]


@dataclass(frozen=True, slots=True)
class _Reference:
    """Laminate stiffness (8, 8) of the residuals' norm, its Cholesky factor in every block, rounding."""

    laminate: Array
    factors: tuple[Array, ...]
    rounding: Array


def _rounding(operator: DenseOperator, stiffness: Array, mass: Array) -> Array:
    """Largest error of an eigenvalue by rounding: machine precision times the largest eigenvalue."""
    # that of a plate with known masses is less
    parts = symmetry_parts(operator).parts
    largest = [part.eigenvalues(stiffness[None], mass[None], part.size).max() for part in parts]
    return np.asarray(_ROUNDING_FACTOR * np.finfo(float).eps * max(largest))


def _log_trace(stiffness: Array) -> Array:
    return np.asarray(np.log(np.sum(np.abs(stiffness), axis=-1)))


def _factor(block: RitzBlock, stiffness: Array, mass: Array, shift: float) -> Array:
    """Lower Cholesky factor of K + shift M, definite also where there are rigid-body motions."""
    one = block.dense()
    return np.asarray(np.linalg.cholesky(one.stiffness.assemble(stiffness) + shift * one.mass.assemble(mass)))


def _rigid_vectors(operator: DenseOperator, stiffness: Array, mass: Array, first: float) -> list[Array]:
    """Rigid-body motions of every block, (n, n_rigid); they depend on the sides alone."""
    # on a soft support they have frequencies of their own, well below those of the modes
    highest = (SUPPORTED_TOLERANCE if operator.problem.supported else 1e-3) * first
    vectors = []
    for block in operator.blocks:
        lam, phi = block.modes(stiffness[None], mass[None], min(block.size, 7))  # of rigid ones there are six
        vectors.append(phi[0, np.abs(lam[0]) < highest].T)
    return vectors


def _sides_vary(model: PlateModel, x: Array) -> bool:
    """Whether length or width is not the same at all parameter vectors (m, n)."""
    state = model.operator.problem.state(model.parameters.mapping(x))
    return any(bool(np.ptp(np.atleast_1d(np.real(side))) > 0.0) for side in (state.length, state.width))


def by_field(operator: DenseOperator, block: RitzBlock, vectors: Array) -> Array:
    """Each column (n, k) cut into the parts of its fields, without those that are zero.

    On the reference square a rotation is w = length xi with phi_x = -1. Where the sides vary, so does
    the part of each field, and each is needed by itself.
    """
    if not vectors.size:
        return vectors
    ends = np.cumsum([operator.space.dimension(field) for field in FIELDS])
    field = np.searchsorted(ends, block.index, side="right")
    parts = [np.where((field == i)[:, None], vectors, 0.0) for i in range(len(FIELDS))]
    every = np.concatenate(parts, axis=1)
    size = np.linalg.norm(every, axis=0)
    return every[:, size > 1e-6 * size.max()]


def _greedy_basis(
    b: int,
    operator: DenseOperator,
    stiffness: Array,
    mass: Array,
    spectrum: Spectrum,
    start: Array,
    tolerance: float,
) -> Array:
    """Basis of one block, grown from a start by the worst represented modes until all are well.

    Every round takes the worst modes of a few different parameter sets.
    """
    assert spectrum.vectors is not None
    block = operator.blocks[b]
    sets, modes = np.nonzero(spectrum.block == b)
    if not len(sets):
        return start
    column, lam = spectrum.column[sets, modes], spectrum.eigenvalues[sets, modes]
    vectors = spectrum.vectors[b][sets, :, column]
    basis = start if start.size else _orthonormal(vectors[:1].T, block, mass[0])
    rest = np.arange(len(sets))
    while True:
        small = _projected_block(block, basis)
        distinct, place = np.unique(sets[rest], return_inverse=True)
        eigenvalues = small.eigenvalues(stiffness[distinct], mass[distinct], small.size)
        missing = column[rest] >= small.size
        ratio = np.abs(eigenvalues[place, np.where(missing, 0, column[rest])]) / lam[rest]
        error = np.where(missing, np.inf, np.sqrt(ratio) - 1.0)
        if error.max() <= tolerance:
            return basis
        # a mode that is missing shifts all above it: the lowest bad one of a set is to blame
        bad = np.flatnonzero(error > tolerance)
        bad = bad[np.argsort(lam[rest[bad]], kind="stable")]
        _, first = np.unique(sets[rest[bad]], return_index=True)
        lowest = bad[first]
        worst = lowest[np.argsort(error[lowest])[::-1]][:_MODES_PER_ROUND]
        grown = _orthonormal(np.column_stack((basis, vectors[rest[worst]].T)), block, mass[0])
        if grown.shape[1] == basis.shape[1]:  # nothing new in them: rounding is all that is left
            return basis
        basis = grown
        # in a larger space no eigenvalue is higher (Courant and Fischer): what is represented well remains so
        rest = rest[np.isin(sets[rest], sets[rest[bad]])]


def _orthonormal(vectors: Array, block: RitzBlock, mass: Array) -> Array:
    """The span of columns (n, k), orthonormal in the mass of one parameter set; dependent ones go."""
    m = block.mass_at(mass)
    kept = np.empty((len(vectors), 0))
    for column in vectors.T:
        size = np.sqrt(column @ m @ column)
        for _ in range(2):
            column = column - kept @ (kept.T @ (m @ column))
        rest = np.sqrt(max(column @ m @ column, 0.0))
        if rest > 1e-7 * size:
            kept = np.column_stack((kept, column / rest))
    return kept


def _projected_block(block: RitzBlock, basis: Array) -> DenseBlock:
    small = block.project(basis)
    return replace(small, mass=_cleaned(small.mass))


def _cleaned(mass: AffineMatrix) -> AffineMatrix:
    """A mass that is diagonal but for rounding, made so: it then needs no factorisation."""
    stack = mass.stack.copy()
    stack[np.abs(stack) < 1e-12 * np.abs(stack).max(initial=0.0)] = 0.0
    return AffineMatrix(stack, mass.active)


def _assemble(
    model: PlateModel, operator: DenseOperator, bases: list[Array], reference: _Reference, *, light: bool
) -> ReducedModel:
    """The reduced model on given bases; blocks without a mode in range are left out."""
    used = [b for b, v in enumerate(bases) if v.size]
    forms = [_residual_form(operator.blocks[b], bases[b], reference.factors[b]) for b in used if not light]
    blocks = tuple(_projected_block(operator.blocks[b], bases[b]) for b in used)
    fast = AffineOperator(operator.problem, operator.space, blocks)
    return ReducedModel(
        full=model,
        fast=PlateModel(fast, model.n_modes, model.error),
        residuals=tuple(forms),
        reference=reference.laminate,
        rounding=reference.rounding,
    )


def _residual_form(block: RitzBlock, basis: Array, factor: Array) -> ResidualForm:
    one = block.dense()
    images = np.concatenate((one.stiffness.stack @ basis, one.mass.stack @ basis))
    n_terms, n, r = images.shape
    columns = np.moveaxis(images, 0, 1).reshape(n, n_terms * r)
    columns = scipy.linalg.solve_triangular(factor, columns, lower=True)
    if n_terms * r < n:  # the norm is all that is asked: fewer rows say the same
        columns = np.asarray(np.linalg.qr(columns, mode="r"))
    return ResidualForm(np.moveaxis(columns.reshape(-1, n_terms, r), 1, 0))


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
    blocks = tuple(operator.blocks[b].project(bases[b]) for b in used)
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
        small = block.project(np.linalg.solve(root, every[:, :size]))
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
