"""Meshes of a rectangular plate: 8-node shells, or 20-node bricks in layers through the thickness.

Both are regular grids of vertices and of the middles between two neighbouring vertices; a node
stands where at most one of its indices is a middle. Edge elements are narrow: a free edge has a
twisting boundary layer as wide as the thickness, and the stress at a clamped face is singular.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.mechanics.problem import EDGES

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

# Widths of the elements at an edge, in thicknesses, from the edge inwards. Clamped bricks are
# 0.3 to 0.4 % too stiff with elements of 7 thicknesses there, and within 0.01 % of their limit with
# these.
_EDGE_WIDTHS: dict[str, tuple[float, ...]] = {"F": (3.0,), "S": (), "C": (0.5, 1.0)}
_FEWEST_INSIDE = 2
# Fewest layers of bricks: the shear stress of a homogeneous plate is a parabola in z.
_LAYERS = 4
# Below this fraction of the spacing a sensor is taken to sit on a grid line.
_ON_LINE = 1e-9

# Nodes of an element by their offset from its first vertex on the grid of half steps: vertices,
# then middles, in the order that ABAQUS and CalculiX share.
_FACE = [(0, 0), (2, 0), (2, 2), (0, 2)]
_SIDES = [(1, 0), (2, 1), (1, 2), (0, 1)]
_SHELL = np.array(_FACE + _SIDES)
_BRICK = np.array(
    [(*p, 0) for p in _FACE]
    + [(*p, 2) for p in _FACE]
    + [(*p, 0) for p in _SIDES]
    + [(*p, 2) for p in _SIDES]
    + [(*p, 1) for p in _FACE]
)


@dataclass(frozen=True, slots=True, eq=False)
class PlateMesh:
    """Nodes and elements, numbered from 1.

    nodes : (n, 3) m, z = 0 at the midplane.
    elements : (n_layers, n_elements, 8 or 20) node numbers, layers from the bottom up, shells one layer.
    edges : nodes of x0, y0, x1, y1.
    surfaces : (2, nx, ny) vertices on the bottom and on top of bricks, (1, nx, ny) of shells.
    x, y : (nx,), (ny,) m, where they stand.
    """

    nodes: Floats
    elements: Integers
    edges: dict[str, Integers]
    surfaces: Integers
    x: Floats
    y: Floats

    def node_at(self, x: float, y: float) -> int:
        """The vertex nearest to a point, on top of bricks."""
        i, j = np.argmin(np.abs(self.x - x)), np.argmin(np.abs(self.y - y))
        return int(self.surfaces[-1, i, j])


def element_counts(length: float, width: float, in_plane: int) -> tuple[int, int]:
    """Elements along x and y, about square and about ``in_plane`` together, at least 4 each."""
    along_x = round(np.sqrt(in_plane * length / width))
    along_y = round(np.sqrt(in_plane * width / length))
    return max(along_x, 4), max(along_y, 4)


def grid_lines(
    length: float, n: int, thickness: float, ends: tuple[str, str], points: Sequence[float] = ()
) -> Floats:
    """Element boundaries on [0, length], about n elements, one boundary at each of ``points``.

    ends : edge condition, F, S or C, at 0 and at length. Edge elements are narrow where the
    uniform spacing is wider than the boundary layer there.
    """
    spacing = length / n
    low, high = (
        np.cumsum([w * thickness for w in _EDGE_WIDTHS[end] if w * thickness < spacing]) for end in ends
    )
    first, last = (edge[-1] if edge.size else 0.0 for edge in (low, high))
    inside = max(n - low.size - high.size, _FEWEST_INSIDE)
    middle = np.linspace(first, length - last, inside + 1)
    lines = np.unique(np.concatenate(([0.0], low, middle, length - high, [length])))
    return _through(lines, points, _ON_LINE * spacing)


def _through(lines: Floats, points: Sequence[float], tolerance: float) -> Floats:
    """The lines, the nearest moved onto each point, or one added where that one must stay."""
    fixed = [lines[0], lines[-1]]
    for point in points:
        nearest = int(np.argmin(np.abs(lines - point)))
        if lines[nearest] not in fixed:
            lines[nearest] = point
        elif abs(lines[nearest] - point) > tolerance:
            lines = np.sort(np.append(lines, point))
        fixed.append(point)
    return lines


def layer_boundaries(heights: Floats) -> tuple[Floats, Integers]:
    """Boundaries z (n_layers + 1,) of layers of bricks, and the run of plies each belongs to.

    heights : (n_runs,) m, thicknesses of the runs of equal plies, bottom to top. A run has one
    layer, more where it is thicker than a quarter of the plate.
    """
    fraction = heights / heights.sum()
    counts = np.maximum(np.ceil(fraction * _LAYERS - 1e-9), 1).astype(np.int64)
    owner = np.repeat(np.arange(len(heights)), counts)
    z = np.concatenate(([0.0], np.cumsum((heights / counts)[owner])))
    return z - z[-1] / 2, owner


def shell_mesh(x: Floats, y: Floats) -> PlateMesh:
    """8-node shells between the lines x and y."""
    return _grid_mesh((x, y), _SHELL)


def brick_mesh(x: Floats, y: Floats, z: Floats) -> PlateMesh:
    """20-node bricks between the lines x, y and z, one layer of elements between two z."""
    return _grid_mesh((x, y, z), _BRICK)


def _grid_mesh(lines: tuple[Floats, ...], offsets: Integers) -> PlateMesh:
    steps = [_with_middles(axis) for axis in lines]
    index = np.indices([len(axis) for axis in steps])
    is_node = (index % 2).sum(axis=0) <= 1
    number = np.zeros(is_node.shape, dtype=np.int64)
    number[is_node] = np.arange(1, np.count_nonzero(is_node) + 1)

    nodes = np.zeros((np.count_nonzero(is_node), 3))
    for k, axis in enumerate(steps):
        nodes[:, k] = axis[index[k][is_node]]

    # First vertex of every element, layer by layer.
    firsts = np.indices([len(axis) - 1 for axis in lines]) * 2
    corners = np.moveaxis(firsts, 0, -1).reshape(*firsts.shape[1:3], -1, len(lines))
    at = np.moveaxis(corners, 2, 0).reshape(corners.shape[2], -1, 1, len(lines)) + offsets
    elements = number[tuple(np.moveaxis(at, -1, 0))]

    edges = {}
    for name in EDGES:
        side = -1 if name[1] == "1" else 0
        on_edge = np.take(number, side, axis="xy".index(name[0]))
        edges[name] = on_edge[on_edge > 0]
    vertices = number[::2, ::2]
    surfaces = vertices[None] if vertices.ndim == 2 else np.moveaxis(vertices[..., [0, -1]], -1, 0)
    return PlateMesh(nodes, elements, edges, surfaces, x=lines[0], y=lines[1])


def _with_middles(axis: Floats) -> Floats:
    steps = np.empty(2 * len(axis) - 1)
    steps[::2] = axis
    steps[1::2] = (axis[1:] + axis[:-1]) / 2
    return steps
