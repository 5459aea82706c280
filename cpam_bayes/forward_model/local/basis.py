"""The basis of a plate with a local change: modes of the bare plate and responses to loads at all places."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from cpam_bayes.forward_model.local.fields import field_parts
from cpam_bayes.forward_model.local.model import LocalModel
from cpam_bayes.forward_model.model import PlateModel, training_sets
from cpam_bayes.forward_model.reduction import compressed
from cpam_bayes.mechanics.affine import AffineOperator, DenseBlock, DenseOperator
from cpam_bayes.mechanics.dense import discretise
from cpam_bayes.mechanics.problem import FIELDS, MEMBRANE_FIELDS, Problem, rigid_body_count
from cpam_bayes.mechanics.spaces.ritz import RitzSettings, RitzSpace, evaluate_sector, ritz_space
from cpam_bayes.parameters import ParameterSet

Array = NDArray[Any]


@dataclass(frozen=True, slots=True)
class LocalSettings:
    """How the basis is made.

    further : polynomials added to those of the bare plate's space in each direction
    modes : of the bare plate that the leading basis holds, over those predicted
    constants, places : numbers of training sets, and of places at each
    leading, rest : energies that may be missing of a mode, and of a response at the largest mass
    """

    further: int = 4
    modes: int = 6
    constants: int = 12
    places: int = 60
    leading: float = 1e-4
    rest: float = 1e-3


def local_space(problem: Problem, settings: RitzSettings, further: int) -> RitzSpace:
    """Trial functions for a local change: more polynomials, but for stretching where it stands alone."""
    richer = replace(
        settings, degree_x=settings.degree_x + further, degree_y=settings.degree_y + further
    )
    space = ritz_space(problem.edges, problem.nominal, richer)
    k = np.real(problem.nominal.stiffness())
    if np.abs(k[:3, 3:6]).max() > 1e-9 * np.sqrt(np.abs(k[0, 0] * k[3, 3])):
        return space
    keep = [
        (s.pairs.max(axis=1) < 8) if s.field in MEMBRANE_FIELDS else np.ones(s.size, bool)
        for s in space.sectors
    ]
    return space.restricted(np.concatenate(keep))


def point_mass_model(
    problem: Problem,
    settings: RitzSettings,
    samples: Array,
    n_modes: int,
    error: Array,
    added: ParameterSet,
    how: LocalSettings = LocalSettings(),
) -> LocalModel:
    """A plate with a point mass anywhere.

    problem, settings : the bare plate and the space on which it is converged
    samples : (m, n_parameters), the centre of its priors first
    error : (n_modes,) of the bare plate
    added : the mass, kg, and its place
    """
    rng = np.random.default_rng(0)
    space = local_space(problem, settings, how.further)
    operator = discretise(problem, space, problem.parameters.mapping(samples))
    plain = PlateModel(operator, n_modes, error)
    operator = compressed(operator, *plain.coefficients(training_sets(problem, 160, rng)))
    plain = replace(plain, operator=operator)
    x = np.vstack((samples[:1], training_sets(problem, how.constants, rng)))
    stiffness, mass = plain.coefficients(x)
    n_rigid = rigid_body_count(problem.edges)
    wanted = n_modes + how.modes + n_rigid
    modes = [_modes(block, stiffness, mass, wanted) for block in operator.blocks]
    lowest = np.sort(np.concatenate([lam for lam, _ in modes], axis=1), axis=1)
    first, last = lowest[0, n_rigid], lowest[:, wanted - 1]
    shift = 0.3 * float(first)
    points = _training_places(rng, how.places)
    heaviest = added.parameters[0].prior.upper
    rows = _rows(operator, points)
    bases, leading = [], []
    for block, row, (lam, vectors) in zip(operator.blocks, rows, modes, strict=True):
        m = block.mass.assemble(mass[:1])[0]
        root = np.linalg.cholesky(block.stiffness.assemble(stiffness[:1])[0] + shift * m).T
        rigid = vectors[0][:, np.abs(lam[0]) < 1e-4 * first]
        basis = np.linalg.qr(root @ rigid)[0] if rigid.size else np.zeros((block.size, 0))
        own = [
            v[:, (one > 1e-4 * first) & (one <= top)] / np.sqrt(np.abs(one[(one > 1e-4 * first) & (one <= top)]))
            for one, v, top in zip(lam, vectors, last, strict=True)
        ]
        has_modes = any(v.shape[1] for v in own)
        basis = _grown(basis, root @ np.concatenate(own, axis=1), how.leading)
        leading.append(basis.shape[1])
        responses = []
        highest = lowest[:, n_rigid + n_modes - 1]
        thickness = np.broadcast_to(np.real(problem.nominal.thickness), 1)[0]
        for k, inertia, top in zip(
            block.stiffness.assemble(stiffness), block.mass.assemble(mass), highest, strict=True
        ):
            factor = scipy.linalg.cho_factor(k + shift * inertia)
            for number, r in enumerate(row):
                if r.any() and has_modes:
                    arm = thickness / 2 if number >= 3 else 1.0
                    g = scipy.linalg.cho_solve(factor, r.T) * arm * np.sqrt(heaviest * top)
                    responses.append(g)
        if responses:
            basis = _grown(basis, root @ np.concatenate(responses, axis=1), how.rest)
        bases.append(scipy.linalg.solve_triangular(root, basis))
    return _assembled(plain, bases, leading, added, shift)


def _modes(block: DenseBlock, stiffness: Array, mass: Array, n: int) -> tuple[Array, Array]:
    n = min(n, block.size)
    k, m = block.stiffness.assemble(stiffness), block.mass.assemble(mass)
    pairs = [scipy.linalg.eigh(a, b, subset_by_index=(0, n - 1)) for a, b in zip(k, m, strict=True)]
    return np.stack([p[0] for p in pairs]), np.stack([p[1] for p in pairs])


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


def _rows(operator: DenseOperator, points: Array) -> list[Array]:
    """The five fields of the trial functions of every block at points, (5, n_points, n) each."""
    whole = np.zeros((len(FIELDS), len(points), sum(s.size for s in operator.space.sectors)))
    first = 0
    for sector in operator.space.sectors:
        values = evaluate_sector(sector, points, "")
        whole[FIELDS.index(sector.field), :, first : first + sector.size] = values
        first += sector.size
    return [whole[:, :, block.index] for block in operator.blocks]


def _grown(basis: Array, snapshots: Array, tolerance: float) -> Array:
    """An orthonormal basis with what it takes to leave less than ``tolerance`` of every snapshot (n, k)."""
    rest = snapshots - basis @ (basis.T @ snapshots)
    if not rest.size:
        return basis
    u, _, _ = np.linalg.svd(rest, full_matrices=False)
    parts = (u.T @ rest) ** 2
    missing = np.cumsum(parts[::-1], axis=0)[::-1].max(axis=1)
    rank = int(np.count_nonzero(missing > tolerance))
    joined = np.column_stack((basis, u[:, :rank]))
    return np.asarray(np.linalg.qr(joined)[0]) if joined.shape[1] else joined


def _assembled(
    plain: PlateModel, bases: list[Array], leading: list[int], added: ParameterSet, shift: float
) -> LocalModel:
    used = [i for i, v in enumerate(bases) if v.shape[1]]
    operator = plain.operator
    blocks, indices = [], []
    for i in used:
        block, v = operator.blocks[i], bases[i]
        k, m = block.stiffness.project(v), block.mass.project(v)
        blocks.append(DenseBlock(k, m, np.arange(v.shape[1]), block.n_terms))
        indices.append(block.index)
    kept = [bases[i] for i in used]
    parts = field_parts(operator.space, indices, kept)
    grown = {s.field for s in _grown_fields(parts, leading, used, kept)}
    loads = tuple(i for i, field in enumerate(FIELDS) if field in grown)
    small = AffineOperator(operator.problem, operator.space, tuple(blocks))
    bare = PlateModel(small, plain.n_modes, plain.error)
    return LocalModel(bare, tuple(leading[i] for i in used), parts, added, loads, shift)


def _grown_fields(parts, leading, used, kept):
    starts = np.cumsum([0, *(v.shape[1] for v in kept)])
    n_lead = {int(a): leading[i] for a, i in zip(starts, used)}
    return [p for p in parts if p.columns.stop - p.columns.start > n_lead[p.columns.start]]
