"""What a mode looks like: its shape on a grid, its kind and its label."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.affine import AffineOperator
from cpam_bayes.modes import Spectrum, energy_terms
from cpam_bayes.problem import FIELDS, HELD, MEMBRANE_FIELDS, Field, Region
from cpam_bayes.spaces.protocol import Quadrature

Array = NDArray[Any]
Kind = Literal["bending", "in-plane", "coupled"]

# Share of in-plane kinetic energy under which a mode is called bending, and over 1 minus which in-plane.
PURE = 0.1
# A second separable part this large beside the first makes a mode a combination, as on square plates.
COMBINED = 0.5
_GRID = 41


@dataclass(frozen=True, slots=True)
class Mode:
    """One natural mode.

    label : "(m,n)", m and n counting nodal lines across x and across y, or half-waves in a direction
    whose two edges are both held; "(2,0)+(0,2)" for a combination of two such shapes.
    in_plane_share : share of the kinetic energy that is in-plane.
    """

    frequency: float
    kind: Kind
    label: str
    in_plane_share: float


def in_plane_share(operator: AffineOperator[Any, Any], spectrum: Spectrum, mass: Array) -> Array:
    """Share of the kinetic energy of every mode that is in u and v, (m, n_modes)."""
    _, energy = energy_terms(operator, spectrum)
    energy = energy * np.atleast_2d(mass)[:, None, :]
    own = [f.left.field in MEMBRANE_FIELDS for f in operator.problem.forms("mass")]
    return np.asarray(energy[..., own].sum(axis=-1) / energy.sum(axis=-1))


def mode_kind(share: float) -> Kind:
    """Bending, in-plane or coupled, by the in-plane share of the kinetic energy."""
    if share < PURE:
        return "bending"
    return "in-plane" if share > 1.0 - PURE else "coupled"


def shape_on_grid(
    operator: AffineOperator[Any, Any], spectrum: Spectrum, mode: int, field: Field, n: int = _GRID
) -> Array:
    """A field of one mode of the first parameter set on an n x n grid of the plate, (n, n)."""
    b, vector = spectrum.vector(0, mode)
    sizes = [operator.space.dimension(f) for f in FIELDS]
    whole = np.zeros(sum(sizes))
    whole[operator.blocks[b].index] = vector
    start = int(np.sum(sizes[: FIELDS.index(field)]))
    t = np.linspace(0.0, 1.0, n)
    points = np.stack(np.meshgrid(t, t, indexing="ij"), axis=-1).reshape(-1, 2)
    rule = Quadrature(Region("point"), points, np.ones(len(points)))
    values = operator.space.evaluate(field, rule, "")
    return np.asarray(values @ whole[start : start + operator.space.dimension(field)]).reshape(n, n)


def label_of_shape(values: Array, edges: str, field: Field) -> str:
    """Label of a shape given on a regular grid (nx, ny), from its leading separable parts."""
    left, sigma, right = np.linalg.svd(values)
    parts = 2 if sigma[1] > COMBINED * sigma[0] else 1
    names = []
    for i in range(parts):
        counts = []
        for profile, ends, axis in (
            (left[:, i], (edges[0], edges[2]), "x"),
            (right[i], (edges[1], edges[3]), "y"),
        ):
            held = all(field in HELD[e][axis] for e in ends)
            counts.append(_sign_changes(profile) + int(held))
        names.append(f"({counts[0]},{counts[1]})")
    return "+".join(sorted(set(names), reverse=True))


def _sign_changes(profile: Array) -> int:
    signs = np.sign(profile[np.abs(profile) > 0.03 * np.abs(profile).max()])
    return int(np.count_nonzero(np.diff(signs)))


def describe_modes(operator: AffineOperator[Any, Any], spectrum: Spectrum, mass: Array) -> tuple[Mode, ...]:
    """Frequency, kind and label of every mode of the first parameter set.

    The label of an in-plane mode is that of its larger displacement, named before it: "u(1,0)".
    """
    shares = in_plane_share(operator, spectrum, mass)[0]
    modes = []
    for i, share in enumerate(shares):
        fields: tuple[Field, ...] = MEMBRANE_FIELDS if share > 0.5 else ("w",)
        shapes = {f: shape_on_grid(operator, spectrum, i, f) for f in fields}
        field = max(shapes, key=lambda f: float(np.sum(shapes[f] ** 2)))
        label = label_of_shape(shapes[field], operator.problem.edges, field)
        modes.append(
            Mode(
                frequency=float(spectrum.frequencies[0, i]),
                kind=mode_kind(float(share)),
                label=label if field == "w" else field + label,
                in_plane_share=float(share),
            )
        )
    return tuple(modes)
