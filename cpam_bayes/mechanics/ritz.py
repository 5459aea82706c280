"""Discretisations in general, and Rayleigh-Ritz: Legendre polynomials enriched by edge exponentials.

A free edge of a thin Mindlin plate has a twisting boundary layer as wide as the thickness, in
which the tangential rotation decays like exp(-s d / h), d being the distance from the edge. A
polynomial basis resolves it slowly; one exponential at each edge solves this.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Protocol

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from cpam_bayes.mechanics.problem import MEMBRANE_FIELDS, Derivative, MatrixKind, PlateState, Region
from cpam_bayes.plate.edges import FIELDS, Field, conditions

Array = NDArray[Any]


@dataclass(frozen=True, slots=True)
class Quadrature:
    """Points (n, 2) in reference coordinates and weights (n,) of one region."""

    region: Region
    points: Array
    weights: Array


class Space(Protocol):
    """Trial functions of the five fields on the reference square.

    Every local form is ``B_left.T @ diag(W) @ B_right`` with B from ``evaluate`` and W from
    ``quadrature``; an effect needs nothing else, so it is written once for every space.
    """

    def dimension(self, field: Field) -> int:
        """Number of trial functions of a field."""
        ...

    def quadrature(self, region: Region, matrix: MatrixKind = "stiffness") -> Quadrature:
        """Points and weights that integrate products of two trial functions over the region.

        ``matrix`` matters to a space that underintegrates its stiffness.
        """
        ...

    def evaluate(self, field: Field, quadrature: Quadrature, derivative: Derivative) -> Any:
        """Trial functions at points, (n_points, dimension): dense or sparse."""
        ...


# Fraction of an exponential outside the polynomials that is needed for it to join a family.
_NEW_SHARE = 1e-5


@dataclass(frozen=True, slots=True)
class RitzSettings:
    """Size of a basis.

    degree_x, degree_y : number of Legendre polynomials in each direction.
    layers : exponentials at each edge, with rates s times ``spread`` to half-integer powers.
    coupled : whether w and the normal rotation have them too (clamped edges, layups with D16, D26 or A45).
    corner_layers : exponentials of u and v with decay lengths of 1/8, 1/32, 1/128 ... of the plate, which
    represent the power of the distance that the stress follows at a corner of a clamped and a free edge.
    """

    degree_x: int
    degree_y: int
    layers: int = 1
    coupled: bool = False
    corner_layers: int = 0
    spread: float = 2.0


def layer_rates(nominal: PlateState) -> tuple[float, float]:
    """Decay rates of the twisting layer at x-edges and y-edges, per unit of length / h.

    s^2 = h^2 (A44 - A45^2 / A55) / (D66 - D16^2 / D11) at an x-edge, where phi_y varies fast along
    x; indices exchanged at a y-edge. From the balance of twist and transverse shear in Mindlin's
    equations.
    """
    k = np.real(nominal.stiffness())
    h = float(np.real(nominal.thickness))
    a44, a55, a45 = k[6, 6], k[7, 7], k[6, 7]
    d11, d22, d66, d16, d26 = k[3, 3], k[4, 4], k[5, 5], k[3, 5], k[4, 5]
    at_x = h * np.sqrt((a44 - a45**2 / a55) / (d66 - d16**2 / d11))
    at_y = h * np.sqrt((a55 - a45**2 / a44) / (d66 - d26**2 / d22))
    return float(at_x), float(at_y)


def graded_quadrature(rates: Sequence[float], degree: int) -> tuple[Array, Array]:
    """Composite Gauss rule on [0, 1] with panels graded towards both ends.

    ``rates`` are the decay rates of the exponentials in units of the interval; panels begin with a
    width of 2 / max(rates) and grow by a factor of 3, each with enough points for products of two
    polynomials of the given degree.
    """
    first = 2.0 / max(rates) if rates else 0.5
    cuts = [0.0]
    while rates and (step := first * 3.0 ** (len(cuts) - 1)) + cuts[-1] < 0.4:
        cuts.append(cuts[-1] + step)
    nodes = np.array([*cuts, *[1.0 - c for c in reversed(cuts)]])
    points, weights = _gauss(max(12, degree + 2))
    half, middle = np.diff(nodes)[:, None] / 2, (nodes[1:] + nodes[:-1])[:, None] / 2
    return (middle + half * points).ravel(), (half * weights).ravel()


def broken_quadrature(breaks: tuple[float, ...]) -> tuple[Array, Array]:
    """Composite Gauss rule on [0, 1] with panels between given points, graded towards both ends."""
    towards_end = 1e-3 * 3.0 ** np.arange(6)
    nodes = np.concatenate(([0.0, 0.5, 1.0], towards_end, 1.0 - towards_end, np.array(breaks)))
    nodes = np.unique(nodes[(nodes >= 0.0) & (nodes <= 1.0)])
    return _composite(nodes[np.append(np.diff(nodes) > 1e-12, True)])


@cache
def _gauss(n: int) -> tuple[Array, Array]:
    """Points and weights of the Gauss rule on [-1, 1], (n,) each."""
    points, weights = legendre.leggauss(n)
    return points, weights


def _composite(nodes: Array) -> tuple[Array, Array]:
    points, weights = _gauss(20)
    half, middle = np.diff(nodes)[:, None] / 2, (nodes[1:] + nodes[:-1])[:, None] / 2
    return (middle + half * points).ravel(), (half * weights).ravel()


# Panels of a part of an edge, finer towards its ends.
_PART = np.array([0.0, 0.01, 0.05, 0.2, 0.5, 0.8, 0.95, 0.99, 1.0])


def _part_quadrature(start: float, end: float) -> tuple[Array, Array]:
    """Composite Gauss rule on a part of an edge, for polynomials and exponentials at either end."""
    return _composite(start + (end - start) * _PART)


@dataclass(frozen=True)
class Family:
    """Orthonormal functions of one coordinate on [0, 1], of one parity or of none.

    Functions are raw functions (Legendre polynomials of 2t - 1, then edge exponentials) times
    ``transform``, a matrix (n_raw, n). ``parity`` about the middle is 1, -1, or 0 for none.
    """

    degrees: Array
    rates: tuple[float, ...]
    signs: tuple[int, ...]
    transform: Array
    parity: int

    @property
    def size(self) -> int:
        """Number of functions."""
        return int(self.transform.shape[1])

    def evaluate(self, t: Array, derivative: bool) -> Array:
        """Functions or their first derivatives at points (n,), (n, size)."""
        return _raw(self.degrees, self.rates, self.signs, t, derivative) @ self.transform


def _raw(
    degrees: Array, rates: tuple[float, ...], signs: tuple[int, ...], t: Array, derivative: bool
) -> Array:
    """Legendre polynomials and e(-r t) + sign e(-r (1 - t)); signs 2 and 3 are the two ends separately."""
    columns = list(legendre_values(t, int(degrees.max(initial=0)) + 1)[int(derivative)][..., degrees].T)
    for r in rates:
        near, far = np.exp(-r * t), np.exp(-r * (1 - t))
        if derivative:
            near, far = -r * near, r * far
        for sign in signs:
            columns.append({1: near + far, -1: near - far, 2: near, 3: far}[sign])
    return np.stack(columns, axis=-1)


def legendre_values(t: Array, n: int) -> tuple[Array, Array]:
    """Orthonormal Legendre polynomials on [0, 1] of degrees below n and their derivatives, (..., n) each."""
    s = 2.0 * t - 1.0
    p, d = np.zeros((n, *t.shape)), np.zeros((n, *t.shape))
    p[0] = 1.0
    if n > 1:
        p[1], d[1] = s, 1.0
    for k in range(1, n - 1):
        p[k + 1] = ((2 * k + 1) * s * p[k] - k * p[k - 1]) / (k + 1)
        d[k + 1] = d[k - 1] + (2 * k + 1) * p[k]
    root = np.sqrt(2.0 * np.arange(n) + 1.0)
    return np.moveaxis(p, 0, -1) * root, 2.0 * np.moveaxis(d, 0, -1) * root


def make_families(
    n: int,
    rates: tuple[float, ...],
    held: tuple[bool, bool],
    split: bool,
    grid: tuple[Array, Array],
) -> tuple[Family, ...]:
    """Orthonormal families of n polynomials and the exponentials, zero at held ends.

    ``split`` gives an even and an odd family, which needs equal conditions at both ends.
    """
    t, w = grid
    classes = [(np.arange(0, n, 2), (1,)), (np.arange(1, n, 2), (-1,))] if split else [(np.arange(n), (2, 3))]
    families = []
    for degrees, signs in classes:
        raw = _raw(degrees, rates, signs, t, derivative=False)
        transform = np.eye(raw.shape[1])
        ends = [end for end, is_held in zip((0.0, 1.0), held, strict=True) if is_held]
        ends = ends[:1] if split else ends
        if ends:
            transform = _vanishing(_raw(degrees, rates, signs, np.array(ends), False))
        transform = _orthonormal(raw, transform, w, n_polynomials=len(degrees) - len(ends))
        families.append(Family(degrees, rates, signs, transform, signs[0] if split else 0))
    return tuple(families)


def _vanishing(values: Array) -> Array:
    """Combinations of raw functions that vanish where ``values`` (n_ends, n_raw) were taken, (n_raw, n).

    The lowest polynomials are used up for this, so that the order of the others is kept.
    """
    n_ends, n_raw = values.shape
    transform = np.eye(n_raw)[:, n_ends:]
    transform[:n_ends] = -np.linalg.solve(values[:, :n_ends], values[:, n_ends:])
    return transform


def _orthonormal(raw: Array, transform: Array, w: Array, n_polynomials: int) -> Array:
    """Orthonormal combinations of the functions ``raw @ transform`` under the weights w, (n_raw, n).

    Polynomials come first, being nearly orthonormal already, and an exponential that is nearly a
    combination of them is left out. The orthonormal functions are then rotated so that the exponentials
    precede the polynomials: leaving out the last function then leaves out the highest polynomial.
    """
    root = np.sqrt(w)[:, None]
    transform = transform / np.linalg.norm(root * (raw @ transform), axis=0)
    _, r = np.linalg.qr(root * (raw @ transform))
    kept = (np.arange(transform.shape[1]) < n_polynomials) | (np.abs(np.diagonal(r)) > _NEW_SHARE)
    functions = transform[:, kept]
    orthonormal = functions
    for _ in range(2):  # the second pass restores the digits that the first one lost
        _, r = np.linalg.qr(root * (raw @ orthonormal))
        orthonormal = np.linalg.solve(r.T, orthonormal.T).T
    coordinates = (root * (raw @ orthonormal)).T @ (root * (raw @ functions))
    turn, _ = np.linalg.qr(np.roll(coordinates, -n_polynomials, axis=1))
    return np.asarray(orthonormal @ turn)


@dataclass(frozen=True)
class Sector:
    """Products of one x-family and one y-family of a field.

    ``pairs`` (n, 2) : indices of the x-function and the y-function of each trial function.
    """

    field: Field
    x: Family
    y: Family
    pairs: Array

    @property
    def size(self) -> int:
        """Number of trial functions."""
        return len(self.pairs)

    def products(self, in_x: Array, in_y: Array) -> Array:
        """Values of the trial functions from those of the two families, (n, x.size) and (n, y.size)."""
        return np.asarray(in_x[:, self.pairs[:, 0]] * in_y[:, self.pairs[:, 1]])


@dataclass(frozen=True)
class RitzSpace:
    """Tensor-product trial functions of the five fields, sorted by parity about the centre lines.

    Sectors are ordered by field. Functions of one sector are orthonormal on the reference square.
    """

    sectors: tuple[Sector, ...]
    x_grid: tuple[Array, Array]
    y_grid: tuple[Array, Array]

    def field_sectors(self, field: Field) -> tuple[Sector, ...]:
        """Sectors of one field."""
        return tuple(s for s in self.sectors if s.field == field)

    def dimension(self, field: Field) -> int:
        """Number of trial functions of a field."""
        return sum(s.size for s in self.field_sectors(field))

    def restricted(self, keep: Array) -> RitzSpace:
        """The space of the trial functions marked in ``keep`` (n_functions,) bool."""
        parts = np.split(keep, np.cumsum([s.size for s in self.sectors])[:-1])
        sectors = [Sector(s.field, s.x, s.y, s.pairs[k]) for s, k in zip(self.sectors, parts, strict=True)]
        return RitzSpace(tuple(sectors), self.x_grid, self.y_grid)

    def quadrature(self, region: Region, matrix: MatrixKind = "stiffness") -> Quadrature:
        """Points and weights of a region, exact for the basis in either matrix."""
        del matrix
        (x, wx), (y, wy) = self.x_grid, self.y_grid
        if region.kind in ("area", "projection"):
            points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
            return Quadrature(region, points, np.outer(wx, wy).ravel())
        if region.kind == "point":
            return Quadrature(region, np.array([region.point]), np.ones(1))
        level = float(region.edge[1])
        if region.span != (0.0, 1.0):
            y, wy = x, wx = _part_quadrature(*region.span)
        if region.edge[0] == "x":
            return Quadrature(region, np.stack((np.full_like(y, level), y), axis=-1), wy)
        return Quadrature(region, np.stack((x, np.full_like(x, level)), axis=-1), wx)

    def evaluate(self, field: Field, quadrature: Quadrature, derivative: Derivative) -> Array:
        """Trial functions of a field at points, (n_points, dimension)."""
        return np.concatenate(
            [
                evaluate_sector(s, quadrature.points, derivative).reshape(len(quadrature.points), -1)
                for s in self.field_sectors(field)
            ],
            axis=1,
        )


def evaluate_sector(sector: Sector, points: Array, derivative: Derivative) -> Array:
    """Trial functions of one sector at points (n, 2), (n, size)."""
    x = sector.x.evaluate(points[:, 0], derivative == "x")
    y = sector.y.evaluate(points[:, 1], derivative == "y")
    return sector.products(x, y)


def ritz_space(edges: str, nominal: PlateState, settings: RitzSettings) -> RitzSpace:
    """Trial functions for a rectangular plate with the given edges, tuned to its nominal state.

    edges : four of F, S, C for x = 0, y = 0, x = length, y = width.
    """
    h = float(np.real(nominal.thickness))
    sizes = {"x": float(np.real(nominal.length)), "y": float(np.real(nominal.width))}
    s_x, s_y = layer_rates(nominal)
    powers = settings.spread ** (np.arange(settings.layers) - (settings.layers - 1) / 2)
    rates = {
        "x": tuple(float(r) for r in s_x * powers * sizes["x"] / h),
        "y": tuple(float(r) for r in s_y * powers * sizes["y"] / h),
    }
    k = np.real(nominal.stiffness())
    unsymmetric = np.abs(k[:3, 3:6]).max() > 1e-9 * np.sqrt(np.abs(k[0, 0] * k[3, 3]))
    corner_rates = tuple(8.0 * 4.0**k for k in range(settings.corner_layers))
    degrees = {"x": settings.degree_x, "y": settings.degree_y}
    grids = {axis: graded_quadrature(rates[axis] + corner_rates, degrees[axis]) for axis in "xy"}
    x0, y0, x1, y1 = conditions(edges)
    ends = {"x": (x0, x1), "y": (y0, y1)}
    made: dict[tuple[str, tuple[float, ...], tuple[bool, bool]], tuple[Family, ...]] = {}

    def families(field: Field, axis: str) -> tuple[Family, ...]:
        a, b = ends[axis]
        held = (field in a.held(axis), field in b.held(axis))
        tangential = field == ("phi_y" if axis == "x" else "phi_x")
        if field in MEMBRANE_FIELDS:
            # where B is not zero, the twisting layer also involves u and v
            its_rates = corner_rates + (rates[axis] if settings.coupled and unsymmetric else ())
        else:
            its_rates = rates[axis] if tangential or settings.coupled else ()
        # parity is a symmetry of the plate only if both edges are alike in every field
        key = (axis, its_rates, held)
        if key not in made:  # fields with the same functions have the same objects
            made[key] = make_families(degrees[axis], its_rates, held, a == b, grids[axis])
        return made[key]

    sectors = [
        Sector(field, x, y, np.argwhere(np.ones((x.size, y.size), dtype=bool)))
        for field in FIELDS
        for x in families(field, "x")
        for y in families(field, "y")
    ]
    return RitzSpace(tuple(sectors), grids["x"], grids["y"])
