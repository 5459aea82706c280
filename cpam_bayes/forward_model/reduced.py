"""Reduced models of a plate, on principal directions of the modes of a few full solves.

Projection keeps the affine sum, only smaller, so that a stack of parameter sets is solved at once. In the
part of the prior box where a posterior lies, fewer directions suffice.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from cpam_bayes.forward_model.model import PlateModel, Prediction, model_on_basis, spread_out, training_sets
from cpam_bayes.mechanics.affine import AffineMatrix, AffineOperator, DenseBlock, DenseOperator, RitzBlock
from cpam_bayes.mechanics.loaded import unloaded
from cpam_bayes.mechanics.modes import check_rigid
from cpam_bayes.mechanics.problem import Array, rigid_body_count
from cpam_bayes.parameters import ParameterSet
from cpam_bayes.plate.edges import FIELDS


@dataclass(frozen=True, slots=True)
class ReductionSettings:
    """Settings of a reduced model.

    tolerance : relative error of a frequency allowed at the parameter sets from which the basis is made.
    training, checks : numbers of sets that are solved in the full space, and of fresh ones in a round.
    rounds : how often at most those with a larger error join the training.
    """

    tolerance: float = 5e-5
    training: int = 16
    checks: int = 8
    rounds: int = 2


DEFAULT_SETTINGS = ReductionSettings()


@dataclass(frozen=True, slots=True)
class ReducedModel:
    """A plate on a small basis: parameter vectors in, frequencies out.

    full : the plate from which it was made.
    fast : the projected operator.
    tolerance : relative error of a frequency to which the basis was made.
    """

    full: PlateModel
    fast: PlateModel
    tolerance: float

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


# Parameter sets that show the linear relations between the coefficients.
_RELATIONS = 160
# Modes of a block kept above those predicted; their allowed error, as a fraction of their distance from
# these, and its maximum.
_FURTHER, _ABOVE, _MOST_ABOVE = 1, 0.3, 0.1
# The same for a wide basis: a change of the plate adds modes above it to a mode.
_FURTHER_OF_WIDE = 10
# First step in the search for the number of directions; modes whose sets decide it.
_FIRST_STEP, _HARDEST = 6, 12
# Parameter sets above which the diagonal masses of a block pay.
_MANY = 40
# Blocks up to this size take as long together as one of them alone.
_TINY = 5
# Entries of a stack of matrices that are held at once.
_ENTRIES = 4_000_000
# Columns over rows up to which their principal directions are found by singular values.
_FEW_COLUMNS = 0.25
# Parameter sets at which rigid-body motions are computed: they depend on sizes alone.
_RIGID_SETS = 4
# Strain energy of a motion, over that of the first mode, below which it is one of a rigid body.
_FREE = 1e-6
# Directions with less than this part of a mode are rounding; energy of those left out of a wide basis, as a
# fraction of the tolerance.
_LEAST, _LEAST_OF_WIDE = 1e-5, 0.012
# Power of a further mode's frequency with which its energy is reduced in a wide basis.
_FALLING = 2.0
# Parameter sets that are solved on a wide basis, and checked there.
_ON_WIDE = 96
# Shift of the energy over the lowest eigenvalue: it makes a free plate stiff.
_SHIFT = 0.5


def reduce(
    model: PlateModel, rng: np.random.Generator, settings: ReductionSettings = DEFAULT_SETTINGS
) -> ReducedModel:
    """A reduced model that holds over the prior box of a converged plate.

    A wide basis comes from full solves at ``settings.training`` sets, with many modes beyond those predicted.
    On it many more sets are solved, and the principal directions of their modes are the basis. Each is
    checked at fresh sets; the error of the basis in an answer is computed there (``basis_error``).
    """
    problem, tolerance = model.operator.problem, settings.tolerance
    many = training_sets(problem, max(_RELATIONS, settings.training), rng)
    related = model.coefficients(spread_out(problem, many))
    full = replace(model, operator=compressed(model.operator, *related))

    def fit(known: _Solved) -> PlateModel:
        least = float(np.sqrt(_LEAST_OF_WIDE * tolerance))
        directions = _directions(full.operator, known, least, _FALLING)
        return _projected(full, directions, [block.size for _, block in directions])

    wide = _checked(full, many[: settings.training], fit, _FURTHER_OF_WIDE, settings, rng)

    def fit_on_wide(known: _Solved) -> PlateModel:
        directions = _directions(wide.operator, known)
        return _projected(wide, directions, _sizes(directions, known, tolerance))

    many = training_sets(problem, _ON_WIDE, rng)
    settings = replace(settings, checks=_ON_WIDE, rounds=1)
    return ReducedModel(full, _checked(wide, many, fit_on_wide, _FURTHER, settings, rng), tolerance)


def _checked(
    model: PlateModel,
    sets: Array,
    fit: Callable[[_Solved], PlateModel],
    further: int,
    settings: ReductionSettings,
    rng: np.random.Generator,
) -> PlateModel:
    """A smaller model, fitted to the modes of another at sets (m, n) and at those where checks fail."""
    known = _solved(model, sets, further)
    for _ in range(settings.rounds):
        small = fit(known)
        fresh = training_sets(model.operator.problem, settings.checks, rng)
        error = np.abs(small.predict(fresh).frequencies / model.predict(fresh).frequencies - 1.0).max(axis=1)
        bad = fresh[error > settings.tolerance]
        if not len(bad):
            return small
        known = known.joined(_solved(model, bad, further))
    return fit(known)


def focused(model: ReducedModel, x: Array, tolerance: float, fraction: float = 1.0) -> ReducedModel:
    """A reduced model projected once more, on the principal directions of its modes at points x (m, n).

    Each block keeps the fewest directions with which this ``fraction`` of its frequencies at x is within
    ``tolerance``, relative, of that of ``model``. One whose modes were labelled is returned unchanged.
    """
    if type(model) is not ReducedModel:  # the labelled shapes are those of its basis
        return model
    known = _solved(model.fast, x, 0)
    directions = _directions(model.fast.operator, known)
    sizes = _sizes(directions, known, tolerance, fraction)
    return replace(model, fast=_projected(model.fast, directions, sizes))


def basis_error(model: ReducedModel, x: Array) -> Array:
    """Relative errors of the basis at parameter vectors (m, n), by as many full solves, (m, n_modes).

    Modes are in ascending order. Matrices of the full space that the model lacks are made anew.
    """
    x, full = np.atleast_2d(x), model.full
    if not full.operator.blocks:
        assert full.basis is not None
        full = model_on_basis(full.operator.problem, x, full.n_modes, full.error, full.basis)
    return np.asarray(np.abs(model.fast.predict(x).frequencies / full.predict(x).frequencies - 1.0))


def compressed(operator: DenseOperator, stiffness: Array, mass: Array) -> DenseOperator:
    """The operator reduced to the independent directions of its coefficients.

    stiffness, mass : coefficients at many parameter sets (m, n_terms), which show the relations between them
    """
    blocks = tuple(block.compressed(stiffness, mass) for block in operator.blocks)
    return AffineOperator(operator.problem, operator.space, blocks)


def by_field(operator: DenseOperator, block: RitzBlock, vectors: Array) -> Array:
    """Each column (n, k) split into the parts of its fields, without those that are zero.

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


@dataclass(frozen=True, slots=True)
class _Modes:
    """Modes of one block at some of the parameter sets.

    sets, column : (k,) the set of each, and the index of its eigenvalue in the block.
    eigenvalues : (k,)
    away : (k,) relative distance of its frequency from the last one predicted, 0 below it.
    vectors : (k, n), M-normalised.
    """

    sets: Array
    column: Array
    eigenvalues: Array
    away: Array
    vectors: Array

    def joined(self, other: _Modes, n_sets: int) -> _Modes:
        """These modes and those at other sets, which are numbered from n_sets on."""
        return _Modes(
            np.concatenate((self.sets, n_sets + other.sets)),
            np.concatenate((self.column, other.column)),
            np.concatenate((self.eigenvalues, other.eigenvalues)),
            np.concatenate((self.away, other.away)),
            np.concatenate((self.vectors, other.vectors)),
        )


@dataclass(frozen=True, slots=True)
class _Solved:
    """Modes of an operator at parameter sets.

    stiffness, mass : (m, n_terms) coefficients
    ranked : (m, n_rigid + n_modes) lowest eigenvalues
    n_rigid : number of these that are of rigid-body motions
    blocks : modes of each block, those predicted and the next ones
    """

    stiffness: Array
    mass: Array
    ranked: Array
    n_rigid: int
    blocks: tuple[_Modes, ...]

    @property
    def frequencies(self) -> Array:
        """Natural frequencies, (m, n_modes), Hz."""
        return np.asarray(np.sqrt(np.maximum(self.ranked[:, self.n_rigid :], 0.0)) / (2 * np.pi))

    def joined(self, other: _Solved) -> _Solved:
        """Both, one after the other."""
        pairs = zip(self.blocks, other.blocks, strict=True)
        return _Solved(
            np.concatenate((self.stiffness, other.stiffness)),
            np.concatenate((self.mass, other.mass)),
            np.concatenate((self.ranked, other.ranked)),
            self.n_rigid,
            tuple(a.joined(b, len(self.ranked)) for a, b in pairs),
        )


def _solved(model: PlateModel, x: Array, further: int) -> _Solved:
    """A plate solved at parameter vectors (m, n), with ``further`` modes per block above those predicted."""
    at_once = max(1, _ENTRIES // max(block.size for block in model.operator.blocks) ** 2)
    parts = (_solved_at_once(model, x[i : i + at_once], further) for i in range(0, len(x), at_once))
    return functools.reduce(_Solved.joined, parts)


def _solved_at_once(model: PlateModel, x: Array, further: int) -> _Solved:
    operator = model.operator
    stiffness, mass = model.coefficients(x)
    n_rigid = rigid_body_count(operator.problem.edges)
    wanted = n_rigid + model.n_modes
    pairs = [b.eigenpairs(stiffness, mass, min(wanted + further, b.size)) for b in operator.blocks]
    ranked = np.sort(np.concatenate([values for values, _ in pairs], axis=1), axis=1)[:, :wanted]
    check_rigid(ranked, n_rigid, supported=operator.problem.supported)
    rigid = ranked[:, n_rigid - 1, None] if n_rigid else np.full((len(x), 1), -np.inf)
    last = ranked[:, -1, None]
    blocks = []
    for values, vectors in pairs:
        below = np.count_nonzero(values <= last, axis=1)[:, None]
        chosen = (values > rigid) & (np.arange(values.shape[1]) < below + further)
        sets, column = np.nonzero(chosen)
        away = np.sqrt(np.maximum(values / last, 1.0))[chosen] - 1.0
        blocks.append(_Modes(sets, column, values[chosen], away, vectors(sets, column)))
    return _Solved(stiffness, mass, ranked, n_rigid, tuple(blocks))


def _directions(
    operator: DenseOperator, known: _Solved, least: float = _LEAST, falling: float = 0.0
) -> list[tuple[int, DenseBlock]]:
    """Every block on its rigid-body motions, with their number, and on principal directions of its modes.

    Modes have the same energy; that of those above the last one predicted falls with a power of their
    frequency over its own. Directions are principal in the energy of the first set, so that the part left
    out of a mode is the error of its eigenvalue. They are made orthonormal in the mass of that set.
    """
    projected = []
    shift = _SHIFT * known.ranked[0, known.n_rigid]
    for block, modes in zip(operator.blocks, known.blocks, strict=True):
        mass = block.mass_at(known.mass[0])
        root = np.linalg.cholesky(block.stiffness_at(known.stiffness[0]) + shift * mass).T
        rigid = _principal(root @ _rigid(block, known, operator.problem.supported), _LEAST)
        size = np.sqrt(np.abs(modes.eigenvalues) * (1.0 + modes.away) ** falling)
        shapes = root @ (modes.vectors / size[:, None]).T
        every = np.column_stack((rigid, _principal(shapes - rigid @ (rigid.T @ shapes), least)))
        if every.shape[1]:
            every = scipy.linalg.solve_triangular(root, np.linalg.qr(every)[0])
        projected.append((rigid.shape[1], block.project(_orthonormal(every, mass))))
    return projected


def _orthonormal(vectors: Array, mass: Array) -> Array:
    """Vectors (n, r) made orthonormal in a mass (n, n), each leading set with its span kept."""
    if not vectors.shape[1]:
        return vectors
    for _ in range(2):  # the second pass restores the digits that the first one lost
        root = np.linalg.cholesky(vectors.T @ mass @ vectors)
        vectors = scipy.linalg.solve_triangular(root, vectors.T, lower=True).T
    return vectors


def _rigid(block: RitzBlock, known: _Solved, supported: bool) -> Array:
    """Rigid-body motions of a block at a few parameter sets, of unit mass over a shift, (n, k).

    supported : whether they have frequencies of their own
    """
    last = min(known.n_rigid, block.size) - 1
    if last < 0:
        return np.empty((block.size, 0))
    vectors: list[Array] = []
    for i in np.unique(np.linspace(0, len(known.ranked) - 1, _RIGID_SETS).astype(int)):
        highest, first = known.ranked[i, known.n_rigid - 1 : known.n_rigid + 1]
        if vectors and not supported:  # the motions of other constants are the same, those of other sizes not
            strained = vectors[0].T @ block.stiffness_at(known.stiffness[i]) @ vectors[0]
            if np.abs(np.diagonal(strained)).sum() <= _FREE:
                continue
        lam, phi = block.modes(known.stiffness[i, None], known.mass[i, None], last + 1)
        vectors.append(phi[0, lam[0] <= 0.5 * (highest + first)].T / np.sqrt(first))
    return np.concatenate(vectors, axis=1)


def _principal(columns: Array, least: float) -> Array:
    """Orthonormal principal directions of columns (n, k) above a least part, the largest first, (n, rank)."""
    if columns.shape[1] < _FEW_COLUMNS * len(columns):
        directions, size, _ = np.linalg.svd(columns, full_matrices=False)
        return np.asarray(directions[:, size > least])
    squares, vectors = np.linalg.eigh(columns @ columns.T)
    return np.asarray(vectors[:, squares > least**2][:, ::-1])


def _sizes(
    directions: list[tuple[int, DenseBlock]], known: _Solved, tolerance: float, fraction: float = 1.0
) -> list[int]:
    """Number of directions of each block for which this fraction of its modes is within a tolerance."""
    return [
        _enough(block, modes, known, n_rigid, tolerance, fraction)
        for (n_rigid, block), modes in zip(directions, known.blocks, strict=True)
    ]


def _projected(model: PlateModel, directions: list[tuple[int, DenseBlock]], sizes: list[int]) -> PlateModel:
    """A model on the leading directions of each block; the smallest, of rigid-body motions, are joined."""
    pairs = zip((block for _, block in directions), sizes, strict=True)
    every = [_leading(block, size) for block, size in pairs if size]
    small = tuple(block for block in every if block.size <= _TINY)
    blocks = tuple(block for block in every if block.size > _TINY)
    if small:
        blocks = (unloaded(small).dense(), *blocks)
    return replace(model, operator=AffineOperator(model.operator.problem, model.operator.space, blocks))


def _enough(
    block: DenseBlock, modes: _Modes, known: _Solved, n_rigid: int, tolerance: float, fraction: float
) -> int:
    """Number of directions of one block, at least the rigid-body motions."""
    if not len(modes.sets):
        return n_rigid
    allowed = np.clip(_ABOVE * modes.away, tolerance, max(tolerance, _MOST_ABOVE))

    def excess(size: int, rows: Array) -> Array:
        distinct, place = np.unique(modes.sets[rows], return_inverse=True)
        cut = _leading if len(distinct) > _MANY else _cut
        values = cut(block, size).eigenvalues(known.stiffness[distinct], known.mass[distinct], size)
        error = np.sqrt(np.abs(values[place, modes.column[rows]]) / modes.eigenvalues[rows]) - 1.0
        return np.asarray(error / allowed[rows])

    def is_enough(size: int, rows: Array) -> bool:
        return bool(np.quantile(excess(size, rows), fraction, method="higher") <= 1.0)

    def least(low: int, step: int, rows: Array) -> int:
        # more vectors never raise an error: the least number is found by doubling, then by halving
        high = min(low + step, block.size)
        while high < block.size and not is_enough(high, rows):
            low, step = high, 2 * step
            high = min(low + step, block.size)
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (low, middle) if is_enough(middle, rows) else (middle, high)
        return high

    low, rows = max(int(modes.column.max()), n_rigid), np.arange(len(modes.sets))
    if fraction < 1.0:
        return least(low, _FIRST_STEP, rows)
    # a few sets are the hardest ones, whatever the number: any found to be harder join them
    error, size = excess(min(low + _FIRST_STEP, block.size), rows), low
    hard = np.empty(0, dtype=int)
    while True:
        hard = np.union1d(hard, modes.sets[np.argsort(-error, kind="stable")[:_HARDEST]])
        size = least(size, _FIRST_STEP, np.flatnonzero(np.isin(modes.sets, hard)))
        error = excess(size, rows)
        if size == block.size or error.max() <= 1.0:
            return size


def _cut(block: DenseBlock, size: int) -> DenseBlock:
    """A block on its leading functions."""
    stiffness, mass = (
        AffineMatrix(matrix.stack[:, :size, :size], matrix.active) for matrix in (block.stiffness, block.mass)
    )
    return DenseBlock(stiffness, mass, np.arange(size), block.n_terms)


def _leading(block: DenseBlock, size: int) -> DenseBlock:
    """A block on the span of its leading functions.

    Two mass terms, as a rule translation and rotation, are both made diagonal.
    """
    small = _cut(block, size)
    if len(small.mass.stack) == 2:
        small = small.project(np.linalg.eigh(small.mass.stack[1])[1])
    return small
