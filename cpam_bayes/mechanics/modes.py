"""Modes of a discretised plate: eigenpairs and their derivatives, shapes on a grid, kinds and labels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import NDArray

from cpam_bayes.mechanics.affine import AffineOperator, DenseOperator, ModeVectors
from cpam_bayes.mechanics.problem import MEMBRANE_FIELDS, Region, rigid_body_count
from cpam_bayes.mechanics.ritz import Quadrature
from cpam_bayes.plate.edges import EDGES, FIELDS, Field, conditions

Array = NDArray[Any]

# A rigid-body motion has eigenvalue zero up to rounding, which grows with the range of K (up to
# 2e11 on thin plates); a deformation mode does not.
RIGID_TOLERANCE = 1e-4
# The same on a soft support, where the rigid-body motions have frequencies of their own.
SUPPORTED_TOLERANCE = 0.5
# A first deformation mode this far below the last one requested is really a rigid-body motion.
LEAST_SHARE = 1e-9
# Relative distance of eigenvalues below which their eigenvectors are arbitrary in their common plane.
COINCIDENT = 1e-9


class RigidBodyError(ValueError):
    """A number of zero-frequency modes that differs from the one that the edges leave."""


@dataclass(frozen=True, slots=True)
class Spectrum:
    """Lowest deformation modes of a stack of m parameter sets.

    eigenvalues : (m, n_modes), (rad/s)^2, ascending.
    block, column : (m, n_modes), place of the mode's vector in ``vectors``.
    vectors : one array (m, n_block, n_columns) per block, M-normalised, of these modes only, or ``None``.
    rigid : (m, n_rigid) eigenvalues of the rigid-body motions.
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


def solve(
    operator: AffineOperator[Any, Any],
    stiffness: Array,
    mass: Array,
    n_modes: int,
    *,
    vectors: bool = False,
) -> Spectrum:
    """Lowest deformation modes, K phi = lambda M phi, of a stack of coefficient sets.

    stiffness (m, n_stiffness), mass (m, n_mass): coefficients as from ``operator.coefficients``.
    Rigid-body motions, whose number is known from the edges, are left out. Raises
    ``RigidBodyError`` if the lowest eigenvalues show another number, ``ValueError`` if the space has
    too few modes.
    """
    stiffness, mass = np.atleast_2d(stiffness), np.atleast_2d(mass)
    n_rigid = rigid_body_count(operator.problem.edges)
    wanted = n_modes + n_rigid
    available = sum(b.size for b in operator.blocks) - n_rigid
    if available < n_modes:
        raise ValueError(f"{n_modes} modes asked for, the space has {available}")
    asked = [(b, min(wanted, b.size)) for b in operator.blocks]
    pairs = [b.eigenpairs(stiffness, mass, n) for b, n in asked] if vectors else []
    values = [lam for lam, _ in pairs] if vectors else [b.eigenvalues(stiffness, mass, n) for b, n in asked]
    counts = [v.shape[-1] for v in values]
    owner = np.repeat(np.arange(len(counts)), counts)
    place = np.concatenate([np.arange(c) for c in counts])
    pooled = np.concatenate(values, axis=-1)
    order = np.argsort(pooled, axis=-1, kind="stable")[..., : n_rigid + n_modes]
    ranked = np.take_along_axis(pooled, order, axis=-1)
    check_rigid(ranked, n_rigid, supported=operator.problem.supported)
    order = order[..., n_rigid:]
    block, column = owner[order], place[order]
    shapes = None
    if vectors:
        shapes = tuple(
            _vectors(block_vectors, b.size, np.nonzero(block == i), column)
            for i, (b, (_, block_vectors)) in enumerate(zip(operator.blocks, pairs, strict=True))
        )
    return Spectrum(ranked[..., n_rigid:], block, column, shapes, ranked[..., :n_rigid])


def lowest_frequencies(
    operator: DenseOperator, near: Array, n_modes: int, masks: Sequence[Array] = ()
) -> list[Array]:
    """The lowest frequencies of each matrix of an operator, and of its restrictions, (m, n_modes) Hz each.

    The operator is from ``discretise_at``. A large block is not solved for all its eigenvalues.

    near : (m,) rough values of the first eigenvalues
    masks : the trial functions of every restriction, (n_functions,) bool each
    """
    n_rigid = rigid_body_count(operator.problem.edges)
    wanted = n_rigid + n_modes
    values: list[list[Array]] = [[] for _ in range(len(masks) + 1)]
    for block in operator.blocks:
        kept = [np.ones(block.size, bool), *(mask[block.index] for mask in masks)]
        for of_all, of_block in zip(values, block.lowest(near, wanted, kept), strict=True):
            of_all.append(of_block)
    ranked = [np.sort(np.concatenate(of_all, axis=1), axis=1)[:, :wanted] for of_all in values]
    for lam in ranked:
        if lam.shape[1] < wanted:
            raise ValueError(f"{n_modes} modes asked for, the space has {lam.shape[1] - n_rigid}")
        check_rigid(lam, n_rigid, supported=operator.problem.supported)
    return [np.sqrt(np.maximum(lam[:, n_rigid:], 0.0)) / (2 * np.pi) for lam in ranked]


def _vectors(mode_vectors: ModeVectors, size: int, where: tuple[Array, ...], column: Array) -> Array:
    """Vectors of the modes ``where`` (parameter sets, modes) of one block; zero in other columns."""
    sets, modes = where
    if not len(sets):
        return np.zeros((len(column), size, 0))
    columns = column[sets, modes]
    vectors = np.zeros((len(column), size, int(columns.max()) + 1))
    vectors[sets, :, columns] = mode_vectors(sets, columns)
    return vectors


def check_rigid(ranked: Array, n_rigid: int, *, supported: bool) -> None:
    """Raise ``RigidBodyError`` unless the lowest eigenvalues (..., n) show n_rigid rigid-body motions.

    supported : whether the plate lies on a soft support
    """
    tolerance = SUPPORTED_TOLERANCE if supported else RIGID_TOLERANCE
    first = ranked[..., n_rigid]
    largest = np.abs(ranked[..., :n_rigid]).max(axis=-1, initial=0.0)
    least = LEAST_SHARE * ranked[..., -1]
    if np.any(first <= least) or np.any(largest > tolerance * first):
        seen = ", ".join(f"{v:.3g}" for v in ranked.reshape(-1, ranked.shape[-1])[0][: n_rigid + 2])
        raise RigidBodyError(
            f"the edges leave {n_rigid} rigid-body motions, the lowest eigenvalues are {seen} (rad/s)^2"
        )


def energy_terms(operator: AffineOperator[Any, Any], spectrum: Spectrum) -> tuple[Array, Array]:
    """phi^T K_q phi and phi^T M_q phi of every mode and term, (m, n_modes, n_terms) each.

    With them d lambda / d p = sum_q (d theta_q / d p) phi^T K_q phi - lambda (d mu_q / d p) phi^T M_q phi
    (Fox and Kapoor, AIAA J. 6, 1968, eq. 8).
    """
    if spectrum.vectors is None:
        raise ValueError("the spectrum was solved without vectors; solve with vectors=True")
    terms: tuple[list[Array], list[Array]] = ([], [])
    where = []
    for b, block in enumerate(operator.blocks):
        sets, modes = np.nonzero(spectrum.block == b)
        if len(sets):
            phi = spectrum.vectors[b][sets, :, spectrum.column[sets, modes]]
            for energies, energy in zip(terms, block.energies(phi), strict=True):
                energies.append(energy)
            where.append(np.ravel_multi_index((sets, modes), spectrum.eigenvalues.shape))
    order = np.argsort(np.concatenate(where))
    stiffness, mass = (np.concatenate(e)[order].reshape(*spectrum.eigenvalues.shape, -1) for e in terms)
    return stiffness, mass


def _bilinear(operator: AffineOperator[Any, Any], block: int, phi: Array, psi: Array) -> tuple[Array, Array]:
    """phi^T K_q psi and phi^T M_q psi for every term, by polarisation of the energies."""
    k, m = operator.blocks[block].energies(np.stack((phi + psi, phi - psi)))
    return (k[0] - k[1]) / 4, (m[0] - m[1]) / 4


def eigenvalue_derivatives(
    operator: AffineOperator[Any, Any], spectrum: Spectrum, d_stiffness: Array, d_mass: Array
) -> Array:
    """Derivatives of the eigenvalues with respect to parameters, (m, n_modes, n_parameters).

    d lambda = phi^T (dK - lambda dM) phi. Where modes of one block coincide, their derivatives along
    a parameter are the eigenvalues of Phi^T (dK - lambda dM) Phi over the coinciding shapes Phi,
    ascending: those of the sorted eigenvalues as that parameter grows (Lancaster, Numer. Math. 6,
    1964).

    d_stiffness, d_mass : derivatives of the coefficients, (m, n_terms, n_parameters).
    """
    k_energy, m_energy = energy_terms(operator, spectrum)
    lam = spectrum.eigenvalues[..., None]
    derivative = k_energy @ d_stiffness - lam * (m_energy @ d_mass)
    for s, members in _coincident(spectrum):
        size = len(members)
        matrix = np.zeros((derivative.shape[2], size, size))
        for p in range(size):
            matrix[:, p, p] = derivative[s, members[p]]
            for q in range(p):
                block, phi = spectrum.vector(s, members[p])
                k, m = _bilinear(operator, block, phi, spectrum.vector(s, members[q])[1])
                value = k @ d_stiffness[s] - spectrum.eigenvalues[s, members[p]] * (m @ d_mass[s])
                matrix[:, p, q] = matrix[:, q, p] = value
        derivative[s, members] = np.linalg.eigvalsh(matrix).T
    return np.asarray(derivative)


def _coincident(spectrum: Spectrum) -> list[tuple[int, list[int]]]:
    """Groups of modes of one block whose eigenvalues coincide: (parameter set, modes)."""
    lam = spectrum.eigenvalues
    close = lam[:, 1:] - lam[:, :-1] < COINCIDENT * lam[:, 1:]
    groups: list[tuple[int, list[int]]] = []
    for s in np.flatnonzero(close.any(axis=1)):
        starts = np.flatnonzero(np.concatenate(([True], ~close[s])))
        for run in np.split(np.arange(lam.shape[1]), starts[1:]):
            for block in np.unique(spectrum.block[s, run]):
                members = run[spectrum.block[s, run] == block].tolist()
                if len(members) > 1:
                    groups.append((int(s), members))
    return groups


Kind = Literal["bending", "in-plane", "coupled"]

# Fraction of in-plane kinetic energy below which a mode is called bending, and above 1 minus which in-plane.
PURE = 0.1
# A second separable part this large beside the first makes a mode a combination, as on square plates.
COMBINED = 0.5
_GRID = 41
# Highest Legendre polynomial that a label may name.
_HIGHEST = 16
_DISPLACEMENTS: tuple[Field, ...] = ("u", "v", "w")
Extent = tuple[tuple[float, float], tuple[float, float]]
UNIT_SQUARE: Extent = ((0.0, 1.0), (0.0, 1.0))


@dataclass(frozen=True, slots=True)
class Mode:
    """One natural mode.

    label : "(m,n)", m and n counting nodal lines across x and across y, or half-waves in a direction whose
    two edges are both held; "(2,0)+(0,2)" for a combination of two such shapes.
    in_plane_fraction : fraction of the kinetic energy that is in-plane.
    """

    frequency: float
    kind: Kind
    label: str
    in_plane_fraction: float


def in_plane_fraction(operator: AffineOperator[Any, Any], spectrum: Spectrum, mass: Array) -> Array:
    """Fraction of the kinetic energy of every mode that is in u and v, (m, n_modes)."""
    _, energy = energy_terms(operator, spectrum)
    energy = energy * np.atleast_2d(mass)[:, None, :]
    is_membrane = [f.left.field in MEMBRANE_FIELDS for f in operator.problem.forms("mass")]
    return np.asarray(energy[..., is_membrane].sum(axis=-1) / energy.sum(axis=-1))


def mode_kind(fraction: float) -> Kind:
    """Bending, in-plane or coupled, by the in-plane fraction of the kinetic energy."""
    if fraction < PURE:
        return "bending"
    return "in-plane" if fraction > 1.0 - PURE else "coupled"


def grid_points(extent: Extent = UNIT_SQUARE, n: int = _GRID) -> Array:
    """Points of an n x n grid in reference coordinates, (n * n, 2), x the slower."""
    x, y = (np.linspace(low, high, n) for low, high in extent)
    return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)


def shapes_at(operator: AffineOperator[Any, Any], spectrum: Spectrum, points: Array) -> Array:
    """u, v and w of the modes of the first parameter set at points, (n_modes, 3, n_points).

    points : (n_points, 2) in reference coordinates.
    """
    sizes = [operator.space.dimension(f) for f in FIELDS]
    vectors = np.zeros((spectrum.eigenvalues.shape[1], sum(sizes)))
    for mode, whole in enumerate(vectors):
        b, vector = spectrum.vector(0, mode)
        whole[operator.blocks[b].index] = vector
    rule = Quadrature(Region("point"), points, np.ones(len(points)))
    shapes = np.empty((len(vectors), len(_DISPLACEMENTS), len(points)))
    for k, field in enumerate(_DISPLACEMENTS):
        start = int(np.sum(sizes[: FIELDS.index(field)]))
        coefficients = vectors[:, start : start + operator.space.dimension(field)]
        shapes[:, k] = (operator.space.evaluate(field, rule, "") @ coefficients.T).T
    return shapes


def shapes_on_grid(
    operator: AffineOperator[Any, Any],
    spectrum: Spectrum,
    extent: Extent = UNIT_SQUARE,
    n: int = _GRID,
) -> Array:
    """u, v and w of the modes of the first parameter set on a grid, (n_modes, 3, n, n).

    extent : least and greatest x, and y, of the grid in reference coordinates.
    """
    shapes = shapes_at(operator, spectrum, grid_points(extent, n))
    return shapes.reshape(*shapes.shape[:2], n, n)


def label_of_shape(values: Array, edges: str, field: Field) -> str:
    """Label of a shape given on a regular grid (nx, ny), from its leading parts.

    For a plate that is free all round the parts are P_m(x) P_n(y), Legendre polynomials, which resemble
    its modes and tell a ring, f(x) + f(y), from a product; for others the leading separable parts.
    """
    free = all(field not in e.held(name) for e, name in zip(conditions(edges), EDGES, strict=True))
    parts = _legendre_parts(values) if free else _separable_parts(values, edges, field)
    (largest, first), (second, other) = parts
    names = {first, other} if second > COMBINED * largest else {first}
    return "+".join(sorted((f"({m},{n})" for m, n in names), reverse=True))


def _legendre_parts(values: Array) -> list[tuple[float, tuple[int, int]]]:
    """The two largest coefficients of a shape in products of Legendre polynomials, with their degrees."""
    v_x, v_y = (
        legvander(np.linspace(-1.0, 1.0, n), _HIGHEST) * np.sqrt(2 * np.arange(_HIGHEST + 1) + 1)
        for n in values.shape
    )
    c = np.abs(np.linalg.pinv(v_x) @ values @ np.linalg.pinv(v_y).T)
    order = np.argsort(c, axis=None)[::-1][:2]
    degrees = np.stack(np.unravel_index(order, c.shape), axis=1)
    return [(float(c[m, n]), (int(m), int(n))) for m, n in degrees]


def _separable_parts(values: Array, edges: str, field: Field) -> list[tuple[float, tuple[int, int]]]:
    """The two leading singular parts of a shape, with their nodal lines or half-waves."""
    left, sigma, right = np.linalg.svd(values)
    x0, y0, x1, y1 = conditions(edges)
    parts = []
    for i in range(2):
        counts = []
        for profile, ends, axis in (
            (left[:, i], (x0, x1), "x"),
            (right[i], (y0, y1), "y"),
        ):
            held = all(field in e.held(axis) for e in ends)
            counts.append(_sign_changes(profile) + int(held))
        parts.append((float(sigma[i]), (counts[0], counts[1])))
    return parts


def _sign_changes(profile: Array) -> int:
    signs = np.sign(profile[np.abs(profile) > 0.03 * np.abs(profile).max()])
    return int(np.count_nonzero(np.diff(signs)))


def describe_modes(
    operator: AffineOperator[Any, Any], spectrum: Spectrum, mass: Array, extent: Extent = UNIT_SQUARE
) -> tuple[Mode, ...]:
    """Frequency, kind and label of every mode of the first parameter set.

    The label of an in-plane mode is that of its larger displacement, preceded by its name: "u(1,0)".

    extent : as in ``shapes_on_grid``, where the plate is not a rectangle.
    """
    shares = in_plane_fraction(operator, spectrum, mass)[0]
    modes = []
    for i, (fraction, shape) in enumerate(
        zip(shares, shapes_on_grid(operator, spectrum, extent), strict=True)
    ):
        by_field = dict(zip(_DISPLACEMENTS, shape, strict=True))
        fields: tuple[Field, ...] = MEMBRANE_FIELDS if fraction > 0.5 else ("w",)
        field = max(fields, key=lambda f: float(np.sum(by_field[f] ** 2)))
        label = label_of_shape(by_field[field], operator.problem.edges, field)
        modes.append(
            Mode(
                frequency=float(spectrum.frequencies[0, i]),
                kind=mode_kind(float(fraction)),
                label=label if field == "w" else field + label,
                in_plane_fraction=float(fraction),
            )
        )
    return tuple(modes)
