"""What a mode looks like: its shape on a grid, its kind and its label."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import NDArray

from cpam_bayes.mechanics.affine import AffineOperator
from cpam_bayes.mechanics.modes import Spectrum, energy_terms
from cpam_bayes.mechanics.problem import FIELDS, HELD, MEMBRANE_FIELDS, Field, Region
from cpam_bayes.mechanics.spaces.protocol import Quadrature

Array = NDArray[Any]
Kind = Literal["bending", "in-plane", "coupled"]

# Fraction of in-plane kinetic energy under which a mode is called bending, and over 1 minus which in-plane.
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

    A plate that is free all round has parts P_m(x) P_n(y), Legendre polynomials, which look like its
    modes and tell a ring, f(x) + f(y), from a product; other plates have the leading separable parts.
    """
    free = all(field not in HELD[e][axis] for e, axis in zip(edges, "xyxy", strict=True))
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
    parts = []
    for i in range(2):
        counts = []
        for profile, ends, axis in (
            (left[:, i], (edges[0], edges[2]), "x"),
            (right[i], (edges[1], edges[3]), "y"),
        ):
            held = all(field in HELD[e][axis] for e in ends)
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

    The label of an in-plane mode is that of its larger displacement, named before it: "u(1,0)".

    extent : as of ``shapes_on_grid``, where the plate is no rectangle.
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
