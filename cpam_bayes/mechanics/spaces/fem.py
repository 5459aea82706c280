"""Finite elements: the 8-node serendipity quadrilateral with reduced integration, by scikit-fem.

The element that ABAQUS calls S8R. All five fields share one scalar basis. Strain energies take
2 x 2 Gauss points an element: full integration would lock as the plate gets thin. Kinetic
energies take 3 x 3, which is exact: with 2 x 2 points the mass of eight nodes has rank four, and
modes without mass would appear.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array
from skfem import CellBasis, ElementQuadS2, MeshQuad1
from skfem.mapping import MappingIsoparametric
from skfem.quadrature import get_quadrature

from cpam_bayes.formatting import listed
from cpam_bayes.mechanics.problem import AREA, Derivative, PlateState, Region
from cpam_bayes.mechanics.spaces.mesh_file import read_mesh
from cpam_bayes.mechanics.spaces.ritz import Quadrature, layer_rates
from cpam_bayes.plate.edges import CONDITIONS, EDGES, FIELDS, STATED, Field, conditions

Array = NDArray[Any]

# Polynomial degree that the rules integrate: 2 x 2 and 3 x 3 points.
REDUCED, FULL = 3, 5
# Uniform elements along the longer side, and the least along the shorter.
_LONGER, _SHORTER = 24, 16
# Least width of an element, of the plate's side: thinner ones cost digits and gain nothing.
_THINNEST = 2e-4
# Points an element for a part of an edge: its ends are met within a thousandth of the edge.
_MIDPOINTS = 64
# Distance from the mesh, in units of the plate, at which a point still counts as on it.
_ON_MESH = 1e-6


@dataclass(frozen=True, slots=True)
class Grading:
    """Widths of the elements along the edges.

    first : of the outermost one, in decay lengths of the edge layer.
    growth : ratio of each further one to that before it.
    """

    first: float = 0.25
    growth: float = 3.0


DEFAULT_GRADING = Grading()


@dataclass(frozen=True, slots=True)
class ElementQuadrature(Quadrature):
    """A rule that knows its elements. cells : (m,) their numbers; local : (2, m, n_points / m)."""

    cells: Array
    local: Array


@dataclass(frozen=True)
class FemSpace:
    """Serendipity trial functions of the five fields on a mesh in reference coordinates.

    basis : the scalar basis with the reduced rule.
    free : unknowns of it that each field keeps.
    facets : boundary facets of the named edges.
    size : nominal length and width, m.
    stiffness_degree : of the polynomials that the rule of the stiffness integrates.
    """

    basis: Any
    free: Mapping[Field, Array]
    facets: Mapping[str, Array]
    size: tuple[float, float]
    stiffness_degree: int = REDUCED

    @property
    def n_elements(self) -> int:
        """Number of elements."""
        return int(self.basis.mesh.nelements)

    @property
    def extent(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Least and greatest x, and y, of the mesh, m."""
        nodes = self.basis.mesh.doflocs
        low, high = nodes.min(axis=1), nodes.max(axis=1)
        x, y = ((float(a * s), float(b * s)) for a, b, s in zip(low, high, self.size, strict=True))
        return x, y

    @property
    def area(self) -> float:
        """Area of the mesh, m2."""
        return float(self._area(AREA, FULL).weights.sum()) * self.size[0] * self.size[1]

    def covers(self, points: Array) -> Array:
        """True where points (n, 2) in reference coordinates are on the mesh, (n,) bool."""
        on_mesh = np.zeros(len(points), dtype=bool)
        on_mesh[self._locate(points)[0]] = True
        return on_mesh

    def dimension(self, field: Field) -> int:
        """Number of trial functions of a field."""
        return len(self.free[field])

    def quadrature(self, region: Region, matrix: Literal["stiffness", "mass"] = "stiffness") -> Quadrature:
        """Points and weights of a region.

        The area has 2 x 2 points an element for forms of the stiffness and 3 x 3 for those of the
        mass. An edge has three points an element, its weights add up to its length in units of the
        plate's nominal width (x0, x1) or length (y0, y1). Raises ``ValueError`` for an edge that
        the mesh does not name and for a point that is not on the mesh.
        """
        if region.kind in ("area", "projection"):
            return self._area(region, self.stiffness_degree if matrix == "stiffness" else FULL)
        return self._edge(region) if region.kind == "edge" else self._point(region)

    def evaluate(self, field: Field, quadrature: Quadrature, derivative: Derivative) -> csr_array[Any]:
        """Trial functions of a field at points, sparse (n_points, dimension), zero off the mesh."""
        if isinstance(quadrature, ElementQuadrature):
            values = self._values(quadrature.cells, quadrature.local, derivative)
        else:
            inside, cells, local = self._locate(quadrature.points)
            values = self._values(cells, local, derivative)
            at = coo_array(
                (np.ones(len(inside)), (inside, np.arange(len(inside)))),
                shape=(len(quadrature.points), len(inside)),
            )
            values = at.tocsr() @ values
        return values[:, self.free[field]]

    def _values(self, cells: Array, local: Array, derivative: Derivative) -> csr_array[Any]:
        """All scalar functions or a derivative of them at local points of cells, (n_points, N)."""
        basis = self.basis
        shape = (len(cells), local.shape[2], basis.Nbfun)
        values = np.empty(shape)
        for k in range(basis.Nbfun):
            field = basis.elem.gbasis(basis.mapping, local, k, tind=cells)[0]
            values[..., k] = field.grad["xy".index(derivative)] if derivative else np.asarray(field)
        columns = np.broadcast_to(basis.dofs.element_dofs[:, cells].T[:, None, :], shape)
        starts = np.arange(0, values.size + 1, basis.Nbfun)
        return csr_array((values.ravel(), columns.ravel(), starts), shape=(len(starts) - 1, basis.N))

    def _area(self, region: Region, degree: int) -> Quadrature:
        mapping, cells = self.basis.mapping, np.arange(self.n_elements)
        x, w = get_quadrature(self.basis.mesh.refdom, degree)
        local = np.broadcast_to(x[:, None, :], (2, len(cells), x.shape[1]))
        points = mapping.F(local, tind=cells)
        weights = np.abs(mapping.detDF(local, tind=cells)) * w
        return ElementQuadrature(region, points.reshape(2, -1).T, weights.ravel(), cells, local)

    def _edge(self, region: Region) -> Quadrature:
        if region.edge not in self.facets:
            raise ValueError(
                f"edge {region.edge!r} is not on the mesh, which has {sorted(self.facets)}; "
                "name its lines so in the mesh"
            )
        mapping, find = self.basis.mapping, self.facets[region.edge]
        cells = self.basis.mesh.f2t[0, find]
        x, w = get_quadrature(self.basis.mesh.brefdom, FULL)
        part = region.span != (0.0, 1.0)
        if part:  # its ends lie anywhere in an element
            x, w = (np.arange(_MIDPOINTS) + 0.5)[None] / _MIDPOINTS, np.full(_MIDPOINTS, 1.0 / _MIDPOINTS)
        points = mapping.G(x, find=find)
        local = mapping.invF(points, tind=cells)
        along = self.size[1 if region.edge[0] == "x" else 0]
        stretch = [self.size[i] / along * mapping.bndJ(i, 0, x, find=find) for i in (0, 1)]
        weights = np.hypot(*stretch) * w
        if part:
            t = points[1 if region.edge[0] == "x" else 0]
            weights = np.where((t >= region.span[0]) & (t <= region.span[1]), weights, 0.0)
        return ElementQuadrature(region, points.reshape(2, -1).T, weights.ravel(), cells, local)

    def _point(self, region: Region) -> Quadrature:
        points = np.array([region.point])
        inside, cells, local = self._locate(points)
        if not len(inside):
            place = tuple(float(c * s) for c, s in zip(region.point, self.size, strict=True))
            raise ValueError(
                f"point (x, y) = ({place[0]:g}, {place[1]:g}) m is not on the plate's mesh; "
                "give a point of the plate, not of a hole or beyond its outline"
            )
        return ElementQuadrature(region, points, np.ones(1), cells, local)

    def _locate(self, points: Array) -> tuple[Array, Array, Array]:
        """True for points (n, 2) on the mesh, with the element of each and its local coordinates."""
        mesh = self.basis.mesh
        nodes = mesh.doflocs[:, mesh.dofs.element_dofs]
        low, high = nodes.min(axis=1), nodes.max(axis=1)
        slack = 0.1 * (high - low) + _ON_MESH  # a curved side bulges beyond its nodes
        x = points.T[:, :, None]
        near = ((x >= (low - slack)[:, None]) & (x <= (high + slack)[:, None])).all(axis=0)
        which, cells = np.nonzero(near)
        target = points[which].T[:, :, None]
        mapping = MappingIsoparametric(mesh, mesh.elem(), mesh.bndelem)
        local = np.full(target.shape, 0.5)
        for _ in range(20 if len(which) else 0):
            miss = target - mapping.F(local, tind=cells)
            step = np.einsum("ijkl,jkl->ikl", mapping.invDF(local, tind=cells), miss)
            local = np.clip(local + step, 0.0, 1.0)
        miss = target - mapping.F(local, tind=cells)
        inside = np.flatnonzero(np.abs(miss).max(axis=(0, 2)) < _ON_MESH)
        located, first = np.unique(which[inside], return_index=True)
        keep = inside[first]
        return located, cells[keep], local[:, keep]


def fem_space(
    edges: str,
    nominal: PlateState,
    nx: int | None = None,
    ny: int | None = None,
    *,
    grading: Grading | None = DEFAULT_GRADING,
) -> FemSpace:
    """Elements for a rectangular plate with the given edges.

    edges : four of F, S, C for x = 0, y = 0, x = length, y = width.
    nx, ny : elements along x and y before grading; left out, about square ones. ``grading`` cuts the
    outermost ones further, down to a quarter of the decay length of a free edge's twisting layer; it also
    resolves the singular corner of a clamped and a free edge. ``None`` leaves them whole.

    With the default counts frequencies of six to ten modes are within 0.05 % of converged ones
    for h / a from 1/10 to 1/1000; the locking that reduced integration leaves grows like (a / h)^2
    beyond. Raises ``ValueError`` for counts below one.
    """
    size = _size(nominal)
    counts = [n if n is not None else d for n, d in zip((nx, ny), default_counts(nominal), strict=True)]
    if min(counts) < 1:
        raise ValueError(f"elements along x and y: received {counts}, accepted: 1 or more")
    h = float(np.real(nominal.thickness))
    cuts = [
        _cuts(n, h / rate / s, grading) for n, s, rate in zip(counts, size, layer_rates(nominal), strict=True)
    ]
    mesh = MeshQuad1.init_tensor(*cuts)
    boundary = mesh.boundary_facets()
    middle = mesh.p[:, mesh.facets[:, boundary]].mean(axis=1)
    facets = {
        name: boundary[np.isclose(middle["xy".index(name[0])], float(name[1]), atol=1e-12)] for name in EDGES
    }
    return _space(mesh, facets, edges, size)


def fem_space_from_mesh(path: str | Path, edges: str, nominal: PlateState, *, unit: float = 1e-3) -> FemSpace:
    """Elements read from a file: any outline, with holes, of 4-, 8- or 9-node quadrilaterals.

    The file has the plate's own coordinates, x and y from the corner x = y = 0, in units of
    ``unit`` metres: millimetres as the plate file. The nominal length and width only scale it to
    reference coordinates, so a plate whose length varies is the mesh stretched. Lines in groups
    named x0, y0, x1, y1 get the conditions of ``edges``, in this order; other boundary is free.
    S needs an edge along its axis: on an oblique one the held fields would be the wrong ones.

    Raises ``ValueError`` for a file or mesh that cannot be used, and says why.
    """
    size = _size(nominal)
    held = tuple(name for name, c in zip(EDGES, conditions(edges), strict=True) if not c.is_free)
    mesh, facets = read_mesh(Path(path), (unit / size[0], unit / size[1]), held)
    space = _space(mesh, facets, edges, size)
    anywhere = [letter for letter in STATED if not CONDITIONS[letter].follows_axis]
    for name, condition in zip(EDGES, conditions(edges), strict=True):
        if condition.follows_axis and not _along_its_axis(space, name):
            raise ValueError(
                f"mesh {path}: edge {name!r} is {condition.name} but not one straight line of "
                f"constant {name[0]}; accepted on other lines: {listed(anywhere, 'and')}"
            )
    return space


def default_counts(nominal: PlateState) -> tuple[int, int]:
    """Elements along x and y that ``fem_space`` takes by itself, before grading."""
    size = _size(nominal)
    nx, ny = (max(_SHORTER, round(_LONGER * s / max(size))) for s in size)
    return nx, ny


def _size(nominal: PlateState) -> tuple[float, float]:
    return float(np.real(nominal.length)), float(np.real(nominal.width))


def _cuts(n: int, layer: float, grading: Grading | None) -> Array:
    """n equal elements of [0, 1], the first and last cut into ones that grow from ``layer`` on."""
    if grading is None:
        return np.linspace(0.0, 1.0, n + 1)
    inside: list[float] = []
    step = max(grading.first * layer, _THINNEST)
    while sum(inside) + grading.growth * step / 2 < 1.0 / max(n, 2) and len(inside) < 6:
        inside.append(step)
        step *= grading.growth
    strips = np.cumsum(inside)
    return np.unique(np.concatenate((np.linspace(0.0, 1.0, n + 1), strips, 1.0 - strips)))


def _space(mesh: Any, facets: Mapping[str, Array], edges: str, size: tuple[float, float]) -> FemSpace:
    basis = CellBasis(mesh, ElementQuadS2(), intorder=REDUCED)
    held: dict[Field, list[Array]] = {field: [] for field in FIELDS}
    for name, condition in zip(EDGES, conditions(edges), strict=True):
        for field in condition.held(name):
            held[field].append(basis.get_dofs(facets[name]).all())
    everything = np.arange(basis.N)
    free = {field: np.setdiff1d(everything, np.concatenate([[], *parts])) for field, parts in held.items()}
    return FemSpace(basis, free, facets, size)


def _along_its_axis(space: FemSpace, name: str) -> bool:
    nodes = space.basis.get_dofs(space.facets[name]).all()
    return bool(np.ptp(space.basis.doflocs["xy".index(name[0]), nodes]) < _ON_MESH)
