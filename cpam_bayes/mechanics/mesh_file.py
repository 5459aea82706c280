"""Quadrilateral meshes from Gmsh files, checked, in the reference coordinates of a plate."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from skfem import MeshQuad1, MeshQuad2

from cpam_bayes.plate.edges import EDGES

Array = NDArray[Any]

# Cells of a plate by number of nodes. A 9-node cell is read as its 8 outer nodes.
_QUADS = {"quad": 4, "quad8": 8, "quad9": 8}
_LINES = ("line", "line3")
# Extent of the mesh, relative to the plate, beyond which the file must be in other units.
_LARGEST, _SMALLEST = 5.0, 0.2
# Points of an element at which it must not be folded: corners and 3 x 3 Gauss points.
_GAUSS = (0.5 - np.sqrt(0.15), 0.5, 0.5 + np.sqrt(0.15))
_CHECKED = np.array(
    [(0, 0), (1, 0), (1, 1), (0, 1), *((a, b) for a in _GAUSS for b in _GAUSS)], dtype=float
).T


def read_mesh(
    path: Path, scale: tuple[float, float], required: tuple[str, ...]
) -> tuple[Any, dict[str, Array]]:
    """The mesh of a file with x and y multiplied by ``scale``, and the facets of each named edge.

    Nodes that no quadrilateral uses are left out. A curved cell is bounded by the parabolas
    through its outer nodes. Raises ``ValueError`` for a file that cannot be read, a mesh that is
    not a plate (triangles, folded or overlapping cells, pieces that are not joined, other units) and
    a ``required`` edge that it does not name.
    """
    file = _read(path)
    try:
        kind, cells = _cells(file)
        points = _plane(file.points, cells) * scale
        _check_extent(points[np.unique(cells)], scale)
        cells = _counter_clockwise(points, cells)
        mesh, corners = _mesh(points, cells, _QUADS[kind])
        _check_shape(mesh, scale)
        _check_joined(mesh)
        named = _named_edges(file, mesh, corners)
        missing = [name for name in required if name not in named]
        if missing:
            raise ValueError(
                f"edges {missing} are held but no group of lines is named so; it names "
                f"{_line_groups(file)} (in Gmsh: a physical curve of that name)"
            )
        return mesh, named
    except ValueError as error:
        raise ValueError(f"mesh {path}: {error}") from None


def _read(path: Path) -> Any:
    try:
        import meshio
    except ImportError:
        raise ValueError(
            f"mesh {path}: reading meshes needs meshio; install it with the extra 'mesh'"
        ) from None
    # what the reader raises where a file is damaged or not a Gmsh file
    damaged = (
        meshio.ReadError,
        ArithmeticError,
        AssertionError,
        LookupError,
        MemoryError,
        TypeError,
        ValueError,
        struct.error,
    )
    try:
        return meshio.gmsh.read(path)
    except OSError as error:
        reason = error.strerror or str(error)
    except damaged as error:
        reason = f"not a Gmsh file that can be read ({type(error).__name__}: {error})"
    raise ValueError(f"mesh {path}: {reason}; accepted: Gmsh format 2.2 or 4.1")


def _cells(file: Any) -> tuple[str, Array]:
    """Kind of the quadrilaterals and their outer nodes, (n, 4 or 8)."""
    counts: dict[str, int] = {}
    for block in file.cells:
        if len(block.data) and block.dim == 2:
            counts[block.type] = counts.get(block.type, 0) + len(block.data)
    if list(counts) not in [[kind] for kind in _QUADS]:
        cells = ", ".join(f"{n} {kind}" for kind, n in counts.items()) or "no cells of a surface"
        raise ValueError(
            f"it has {cells}; accepted: 4-, 8- or 9-node quadrilaterals of one kind "
            "(in Gmsh: recombine all surfaces)"
        )
    (kind,) = counts
    data = np.concatenate([block.data for block in file.cells if block.type == kind])
    return kind, data[:, : _QUADS[kind]]


def _plane(points: Array, cells: Array) -> Array:
    """x and y of the points (n, 2 or 3), checked to be finite and of one z."""
    used = points[np.unique(cells)]
    if not np.all(np.isfinite(used)):
        raise ValueError("it has coordinates that are not finite numbers")
    extent = np.ptp(used, axis=0)
    if len(extent) > 2 and extent[2] > 1e-6 * extent.max():
        raise ValueError(f"z varies by {extent[2]:g}; accepted: a flat plate in the x-y plane")
    return np.asarray(points[:, :2])


def _check_extent(points: Array, scale: tuple[float, float]) -> None:
    extent = np.ptp(points, axis=0)
    if extent.max() > _LARGEST or extent.min() < _SMALLEST:
        mesh, plate = extent / scale, 1.0 / np.array(scale)
        raise ValueError(
            f"it extends over {mesh[0]:.4g} x {mesh[1]:.4g}, the plate over {plate[0]:.4g} x "
            f"{plate[1]:.4g} in the same unit (mm in a plate file); check the mesh's unit and "
            "the plate's length and width"
        )


def _counter_clockwise(points: Array, cells: Array) -> Array:
    """The cells, all oriented counter-clockwise."""
    x, y = np.moveaxis(points[cells[:, :4]], -1, 0)
    doubled = np.sum(x * np.roll(y, -1, axis=1) - np.roll(x, -1, axis=1) * y, axis=1)
    reverse = [0, 3, 2, 1] if cells.shape[1] == 4 else [0, 3, 2, 1, 7, 6, 5, 4]
    return np.where((doubled < 0)[:, None], cells[:, reverse], cells)


def _mesh(points: Array, cells: Array, n_nodes: int) -> tuple[Any, Array]:
    """The mesh and, for its vertices, their numbers among ``points``."""
    corners, t = np.unique(cells[:, :4], return_inverse=True)
    t = np.ascontiguousarray(t.reshape(-1, 4).T)
    p = np.ascontiguousarray(points[corners].T)
    straight = MeshQuad1(p, t)
    if n_nodes == 4:
        return straight, corners
    middle, t_middle = np.unique(cells[:, 4:], return_inverse=True)
    if len(middle) != straight.nfacets:
        raise ValueError(
            f"{len(middle)} nodes on {straight.nfacets} sides; neighbours must share the nodes in "
            "the middle of their sides (in Gmsh: merge duplicate nodes)"
        )
    # With the ninth node where the eight put it, the map has no bubble that the element lacks: only
    # then are rigid motions and constant strains exact in a curved cell.
    nodes = points[cells]
    centre = nodes[:, 4:].sum(axis=1) / 2 - nodes[:, :4].sum(axis=1) / 4
    t_all = np.concatenate(
        (
            t,
            len(corners) + t_middle.reshape(-1, 4).T,
            len(corners) + len(middle) + np.arange(len(cells))[None],
        )
    )
    p_all = np.concatenate((p, points[middle].T, centre.T), axis=1)
    return MeshQuad2(p_all, np.ascontiguousarray(t_all)), corners


def _check_shape(mesh: Any, scale: tuple[float, float]) -> None:
    jacobian = mesh.mapping().DF(_CHECKED)
    area = jacobian[0, 0] * jacobian[1, 1] - jacobian[0, 1] * jacobian[1, 0]
    folded = np.flatnonzero(area.min(axis=1) <= 1e-6 * np.abs(area).max(axis=1))
    if len(folded):
        place = mesh.p[:, mesh.t[:, folded[0]]].mean(axis=1) / scale
        raise ValueError(
            f"{len(folded)} cells are folded or without area, the first around "
            f"({place[0]:.4g}, {place[1]:.4g}); corners must go round a cell and its angles stay "
            "below 180 degrees"
        )
    sides = np.concatenate([mesh.t[[i, (i + 1) % 4]] for i in range(4)], axis=1)
    if np.unique(sides, axis=1).shape[1] < sides.shape[1]:
        raise ValueError("cells overlap: a side belongs to two cells that lie on one side of it")


def _check_joined(mesh: Any) -> None:
    inner = mesh.f2t[:, mesh.f2t[1] >= 0]
    graph = coo_array((np.ones(inner.shape[1]), inner), shape=(mesh.nelements, mesh.nelements))
    pieces, _ = connected_components(graph, directed=False)
    if pieces > 1:
        raise ValueError(
            f"it is {pieces} pieces that share no side; merge coincident nodes (in Gmsh: merge "
            "duplicate nodes), one plate is accepted"
        )


def _named_edges(file: Any, mesh: Any, corners: Array) -> dict[str, Array]:
    """Boundary facets of the groups named as edges."""
    boundary = mesh.boundary_facets()
    number = {(a, b): f for f, (a, b) in zip(boundary, mesh.facets[:, boundary].T, strict=True)}
    vertex = np.full(len(file.points), -1)
    vertex[corners] = np.arange(len(corners))
    named = {}
    for name in EDGES:
        lines = _lines(file, name)
        if not len(lines):
            continue
        pairs = np.unique(np.sort(vertex[lines], axis=1), axis=0)
        facets = [number.get((a, b), -1) for a, b in pairs]
        if -1 in facets:
            raise ValueError(
                f"{facets.count(-1)} of {len(facets)} lines of {name!r} are no sides of the "
                "plate's boundary; accepted: sides of cells on the outline or a hole"
            )
        named[name] = np.array(facets)
    return named


def _lines(file: Any, name: str) -> Array:
    """End points of the lines of a physical group, (n, 2)."""
    lines = [np.empty((0, 2), dtype=int)]
    for k, block in enumerate(file.cells):
        if block.type not in _LINES:
            continue
        if name in file.cell_sets:
            members = file.cell_sets[name][k]
        elif name in file.field_data and "gmsh:physical" in file.cell_data:
            tag, dimension = file.field_data[name]
            members = (file.cell_data["gmsh:physical"][k] == tag) & (dimension == 1)
        else:
            continue
        lines.append(block.data[members][:, :2])
    return np.concatenate(lines)


def _line_groups(file: Any) -> list[str]:
    names = {*file.field_data, *file.cell_sets}
    return sorted(name for name in names if len(_lines(file, name)))
