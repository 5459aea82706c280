"""The basis of a plate with a local change: modes of the bare plate and responses to loads at all places."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from cpam_bayes.forward_model.local.fields import PatchForm, field_parts
from cpam_bayes.forward_model.local.model import Change, LocalModel, PointMass
from cpam_bayes.forward_model.local.patch import FURTHER, Patch, loads_of_modes
from cpam_bayes.forward_model.model import PlateModel, spread_out, training_sets
from cpam_bayes.forward_model.reduced import compressed
from cpam_bayes.mechanics.affine import AffineOperator, DenseBlock
from cpam_bayes.mechanics.dense import discretise
from cpam_bayes.mechanics.loaded import LoadedBlock, symmetry_parts
from cpam_bayes.mechanics.problem import MEMBRANE_FIELDS, Array, Problem, rigid_body_count
from cpam_bayes.mechanics.ritz import RitzSettings, RitzSpace, evaluate_sector, ritz_space
from cpam_bayes.parameters import ParameterSet
from cpam_bayes.plate.edges import FIELDS
from cpam_bayes.running import single_blas_thread


@dataclass(frozen=True, slots=True)
class LocalSettings:
    """Settings of the basis.

    further : polynomials added to those of the bare plate's space in each direction
    modes : number of modes of the bare plate in the leading basis beyond those predicted
    constants, places : numbers of training sets, and of places at each
    leading, rest : energy that may be missing of a mode, and of a response at the largest mass
    """

    further: int = 4
    modes: int = 6
    constants: int = 16
    places: int = 60
    leading: float = 1e-4
    rest: float = 5e-3


POINT_SETTINGS = LocalSettings()
PATCH_SETTINGS = LocalSettings(further=8, modes=6, constants=10, places=24, leading=3e-4, rest=1e-3)
# Shift of the energy over the lowest eigenvalue: it makes a free plate stiff.
_SHIFT = 0.3
_RIGID = 1e-4
# Fraction of the mean radius of gyration of a point mass, for its responses.
_ROTATION = 0.3
# Factor on loads of known masses: at known places, any missing part of their responses is an error.
_KNOWN = 10.0


def local_space(problem: Problem, settings: RitzSettings) -> RitzSpace:
    """Trial functions for a local change: all of them, but few for stretching where it is uncoupled."""
    space = ritz_space(problem.edges, problem.nominal, settings)
    k = np.real(problem.nominal.stiffness())
    if np.abs(k[:3, 3:6]).max() > 1e-9 * np.sqrt(np.abs(k[0, 0] * k[3, 3])):
        return space
    keep = [
        (s.pairs.max(axis=1) < 8) if s.field in MEMBRANE_FIELDS else np.ones(s.size, bool)
        for s in space.sectors
    ]
    return space.restricted(np.concatenate(keep))


@single_blas_thread
def point_mass_model(plate: PlateModel, samples: Array, added: ParameterSet) -> LocalModel:
    """A plate with a point mass anywhere.

    plate : converged on a Ritz space
    samples : (m, n_parameters), the centre of its priors first
    added : the mass, kg, its place, and its radius of gyration, m
    """
    how = POINT_SETTINGS
    trained, rng = _training(plate, samples, how)
    space, parts = trained.plain.operator.space, trained.block.parts
    rows = rows_at(space, parts, _training_places(rng, how.places))
    # its translation, and its rotation about the midplane, of which a part is enough: what the basis lacks
    # of it acts like a smaller radius of gyration, which is free
    arm = np.hypot(
        float(np.real(plate.operator.problem.nominal.thickness)) / 2,
        _ROTATION * added.parameters[3].prior.mean,
    )
    inertia = np.sqrt(added.parameters[0].prior.upper) * np.array([1.0, 1.0, 1.0, arm, arm])[:, None, None]
    by_block = [(inertia * r)[r.any(axis=(1, 2))].reshape(-1, r.shape[-1]) for r in rows]
    grown = [
        _basis(trained, b, [np.sqrt(top) * loads for top in trained.highest], how)
        for b, loads in enumerate(by_block)
    ]
    # fields of blocks that hold responses: a load on another one adds nothing
    answering = [v.shape[1] > n and r for (v, n), r in zip(grown, rows, strict=True)]
    loads = tuple(i for i in range(len(FIELDS)) if any(r is not False and r[i].any() for r in answering))
    return _assembled(trained, grown, added, PointMass(loads))


@single_blas_thread
def patch_model(plate: PlateModel, samples: Array, added: ParameterSet, form: PatchForm) -> LocalModel:
    """A plate with a softer patch anywhere.

    plate, samples : as for ``point_mass_model``
    added : the fraction of stiffness lost, the place, and the extent over the shorter side
    """
    patch, how = patch_of(form, plate.operator.problem), PATCH_SETTINGS
    trained, rng = _training(plate, samples, how)
    indices = [part.index for part in trained.block.parts]
    parts = field_parts(trained.plain.operator.space, indices, [np.eye(len(index)) for index in indices])
    low, high = added.parameters[3].prior.lower, added.parameters[3].prior.upper
    by_set = []
    for s, row in enumerate(trained.sets):
        extents = np.exp(rng.uniform(np.log(low), np.log(high), how.places))
        where = np.column_stack((_training_places(rng, how.places), extents))
        by_set.append(
            loads_of_modes(
                patch, trained.plain, parts, row, where, _lowest(trained, s, plate.n_modes + FURTHER)
            )
        )
    ends = np.cumsum([0, *(len(index) for index in indices)])
    grown = [
        _basis(
            trained, b, [loads[..., ends[b] : ends[b + 1]].reshape(-1, len(index)) for loads in by_set], how
        )
        for b, index in enumerate(indices)
    ]
    return _assembled(trained, grown, added, patch)


def patch_of(form: PatchForm, problem: Problem) -> Patch:
    """The patch of a plate, with its extent relative to the shorter side."""
    sides = [float(np.real(side)) for side in (problem.nominal.length, problem.nominal.width)]
    return Patch(form, (min(sides) / sides[0], min(sides) / sides[1]))


@dataclass(frozen=True, slots=True)
class _Training:
    """A plate at the sets of constants from which its basis is made.

    plain : in the full space
    block : its symmetries as parts, with known masses
    sets : (m, n_parameters)
    stiffness, mass : (m, n_terms) coefficients
    modes : eigenvalues (m, k) and vectors (m, k, n) of every part
    last, highest : (m,) eigenvalues of the last mode of the leading basis, and of the last one predicted
    first : lowest eigenvalue of a deformation mode
    shift : of the energy in which the plate responds to loads
    """

    plain: PlateModel
    block: LoadedBlock
    sets: Array
    stiffness: Array
    mass: Array
    modes: list[tuple[Array, Array]]
    last: Array
    highest: Array
    first: float
    shift: float


def _training(plate: PlateModel, samples: Array, how: LocalSettings) -> tuple[_Training, np.random.Generator]:
    # the seed is fixed: a model does not depend on the run that first needed it
    rng = np.random.default_rng(0)
    problem, n_modes = plate.operator.problem, plate.n_modes
    assert plate.basis is not None
    settings, _ = plate.basis
    degrees = settings.degree_x + how.further, settings.degree_y + how.further
    settings = replace(settings, degree_x=degrees[0], degree_y=degrees[1])
    operator = discretise(problem, local_space(problem, settings), problem.parameters.mapping(samples))
    plain = PlateModel(operator, n_modes, plate.error, (settings, np.empty(0, dtype=bool)))
    many = spread_out(problem, training_sets(problem, 160, rng))
    operator = compressed(operator, *plain.coefficients(many))
    plain, block = replace(plain, operator=operator), symmetry_parts(operator)
    x = np.vstack((samples[:1], training_sets(problem, how.constants, rng)))
    stiffness, mass = plain.coefficients(x)
    n_rigid = rigid_body_count(problem.edges)
    wanted = n_rigid + n_modes + how.modes
    modes = [part.modes(stiffness, mass, min(wanted, part.size)) for part in block.parts]
    lowest = np.sort(np.concatenate([lam for lam, _ in modes], axis=1), axis=1)
    first = float(lowest[0, n_rigid])
    last, highest = lowest[:, wanted - 1], lowest[:, n_rigid + n_modes - 1]
    return _Training(plain, block, x, stiffness, mass, modes, last, highest, first, _SHIFT * first), rng


def _lowest(trained: _Training, s: int, k: int) -> list[Array]:
    """The k lowest deformation modes at one set of constants, of unit energy, by block (n, k)."""
    first = rigid_body_count(trained.plain.operator.problem.edges)
    order = np.argsort(np.concatenate([lam[s] for lam, _ in trained.modes]))[first : first + k]
    out, start = [], 0
    for lam, vectors in trained.modes:
        at = order - start
        inside = (at >= 0) & (at < lam.shape[1])
        of_block = np.zeros((vectors.shape[2], k))
        of_block[:, inside] = vectors[s, at[inside]].T / np.sqrt(lam[s, at[inside]])
        start += lam.shape[1]
        out.append(of_block)
    return out


def _basis(trained: _Training, b: int, loads: list[Array], how: LocalSettings) -> tuple[Array, int]:
    """The basis of one part (n, r), and the number of its vectors that are the bare plate's own.

    loads : (n_loads, n) for every set of constants, as large as they act on a mode of unit energy; those of
    known masses are added
    """
    block = trained.block.parts[b]
    known = (
        _KNOWN
        * np.sqrt(trained.mass @ trained.block.inertia)[..., None]
        * trained.block.split(trained.block.rows)[b]
    )
    loads = [
        np.concatenate((load, np.sqrt(top) * own))
        for load, top, own in zip(loads, trained.highest, known, strict=True)
    ]
    k, m = block.stiffness.assemble(trained.stiffness), block.mass.assemble(trained.mass)
    root = np.linalg.cholesky(k[0] + trained.shift * m[0]).T
    lam, vectors = trained.modes[b]
    # the frequency of a rigid-body motion is rounding error
    rigid = np.abs(lam) < _RIGID * trained.first
    basis = _grown(np.empty((block.size, 0)), root @ vectors[0, rigid[0]].T, 0.0)
    bare_modes = [
        (v[chosen] / np.sqrt(one[chosen])[:, None]).T
        for one, v, chosen in zip(lam, vectors, ~rigid & (lam <= trained.last[:, None]), strict=True)
    ]
    basis = _grown(basis, root @ np.concatenate(bare_modes, axis=1), how.leading)
    leading = basis.shape[1]
    if any(v.shape[1] for v in bare_modes):  # a block without modes in range answers no load
        responses = [
            scipy.linalg.solve(one + trained.shift * inertia, load.T, assume_a="pos")
            for one, inertia, load in zip(k, m, loads, strict=True)
        ]
        basis = _grown(basis, root @ np.concatenate(responses, axis=1), how.rest)
    return scipy.linalg.solve_triangular(root, basis), leading


def _training_places(rng: np.random.Generator, n: int) -> Array:
    """Places all over the plate, a third of them on its edges and corners, (n, 2)."""
    points = rng.uniform(size=(n, 2))
    edge = np.arange(n) % 3 == 0
    points[edge, 0] = np.round(points[edge, 0])
    corner = np.arange(n) % 9 == 0
    points[corner] = np.round(points[corner])
    swap = np.arange(n) % 2 == 0
    points[swap] = points[swap, ::-1]
    return points


def rows_at(space: RitzSpace, parts: Sequence[DenseBlock], points: Array) -> list[Array]:
    """The five fields of the trial functions of every part at points, (5, n_points, n) each."""
    whole = np.zeros((len(FIELDS), len(points), sum(s.size for s in space.sectors)))
    first = 0
    for sector in space.sectors:
        values = evaluate_sector(sector, points, "")
        whole[FIELDS.index(sector.field), :, first : first + sector.size] = values
        first += sector.size
    return [whole[:, :, part.index] for part in parts]


def _grown(basis: Array, snapshots: Array, tolerance: float) -> Array:
    """An orthonormal basis extended to leave less than ``tolerance`` of every snapshot (n, k)."""
    rest = snapshots - basis @ (basis.T @ snapshots)
    if not rest.size:
        return basis
    # directions by their part of all snapshots; squares keep half the digits, of which three are needed
    u = np.linalg.eigh(rest @ rest.T)[1][:, ::-1][:, : rest.shape[1]]
    parts = (u.T @ rest) ** 2
    missing = np.cumsum(parts[::-1], axis=0)[::-1].max(axis=1)
    rank = int(np.count_nonzero(missing > tolerance))
    joined = np.column_stack((basis, u[:, :rank]))
    return np.asarray(np.linalg.qr(joined)[0]) if joined.shape[1] else joined


def _assembled(
    trained: _Training, grown: list[tuple[Array, int]], added: ParameterSet, change: Change
) -> LocalModel:
    operator, block = trained.plain.operator, trained.block
    # the largest number of modes of a part that any set of constants has in range
    in_range = [int((lam <= trained.last[:, None]).sum(axis=1).max()) for lam, _ in trained.modes]
    used = [
        (part, rows, v, leading, min(k, leading))
        for part, rows, (v, leading), k in zip(
            block.parts, block.split(block.rows), grown, in_range, strict=True
        )
        if v.size
    ]
    # known masses where there are only rigid-body motions change no mode
    there = np.any([(v.shape[1] > n) & rows.any(axis=1) for _, rows, v, n, _ in used], axis=0)
    loaded = LoadedBlock(
        tuple(part.project(v) for part, _, v, *_ in used),
        np.concatenate([rows[there] @ v for _, rows, v, *_ in used], axis=1),
        block.inertia[:, there],
    )
    parts = field_parts(operator.space, [p.index for p, *_ in used], [v for _, _, v, *_ in used])
    bare = replace(trained.plain, operator=AffineOperator(operator.problem, operator.space, (loaded,)))
    leading, modes = (tuple(of) for of in zip(*((n, k) for *_, n, k in used), strict=True))
    return LocalModel(bare, leading, modes, parts, added, trained.shift, change)
