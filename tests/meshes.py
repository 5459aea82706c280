"""Gmsh files of quadrilaterals for tests."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import meshio
import numpy as np

Map = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
_KIND = {4: "quad", 8: "quad8", 9: "quad9"}


@dataclass(frozen=True)
class Quads:
    """Points (n, 3), cells (m, 4, 8 or 9) and named lines (k, 2 or 3) of a mesh."""

    points: np.ndarray
    cells: np.ndarray
    lines: dict[str, np.ndarray]

    def write(self, path: Path, *, binary: bool = False) -> Path:
        kinds = {2: "line", 3: "line3"}
        cells: list[Any] = [(kinds[line.shape[1]], line) for line in self.lines.values()]
        cells.append((_KIND[self.cells.shape[1]], self.cells))
        tags = [np.full(len(line), i) for i, line in enumerate(self.lines.values(), 1)]
        tags.append(np.full(len(self.cells), 99))
        groups = {name: np.array([i, 1]) for i, name in enumerate(self.lines, 1)}
        data = {"gmsh:physical": tags, "gmsh:geometrical": tags}
        named = groups | {"plate": np.array([99, 2])}
        mesh = meshio.Mesh(self.points, cells, cell_data=data, field_data=named)
        meshio.write(path, mesh, file_format="gmsh22", binary=binary)
        return path

    def without(self, *names: str) -> Self:
        return replace(self, lines={k: v for k, v in self.lines.items() if k not in names})


def grid(s: np.ndarray, t: np.ndarray, f: Map, order: int = 1, *, closed: bool = False) -> Quads:
    """Cells of the unit square divided at s and t, mapped by f; ``closed`` joins t = 1 to t = 0.
    ``order`` 2 : 9-node cells whose middle nodes are mapped too. Lines: x0 (s = 0), x1, y0 (t = 0), y1."""
    s, t = (np.interp(np.arange(order * len(c) - order + 1) / order, range(len(c)), c) for c in (s, t))
    a, b = np.meshgrid(s, t, indexing="ij")
    number = np.arange(a.size).reshape(a.shape)
    if closed:
        number[:, -1] = number[:, 0]
    x, y = f(a.ravel(), b.ravel())

    def nodes(*offsets: tuple[int, int]) -> np.ndarray:
        n, m = number.shape
        parts = [number[i : n - order + i : order, j : m - order + j : order] for i, j in offsets]
        return np.stack([part.ravel() for part in parts], axis=-1)

    ends = [(0, 0), (order, 0), (order, order), (0, order)]
    middles = [(1, 0), (2, 1), (1, 2), (0, 1), (1, 1)] if order == 2 else []
    cells = nodes(*ends, *middles)

    def line(along: np.ndarray) -> np.ndarray:
        return np.stack([along[:-1:order], along[order::order], along[1::order]][: order + 1], axis=-1)

    lines = {"x0": number[0], "y0": number[:, 0], "x1": number[-1], "y1": number[:, -1]}
    return Quads(np.stack((x, y, np.zeros_like(x)), axis=-1), cells, {k: line(v) for k, v in lines.items()})


def rectangle(length: float, width: float, nx: int, ny: int, order: int = 1) -> Quads:
    s, t = np.linspace(0.0, 1.0, nx + 1), np.linspace(0.0, 1.0, ny + 1)
    return grid(s, t, lambda a, b: (a * length, b * width), order)


def distorted(quads: Quads, amount: float) -> Quads:
    """The mesh of a rectangle with its inner nodes moved by a field that vanishes on its sides."""
    x, y, _ = quads.points.T
    a, b = x / x.max(), y / y.max()
    bubble = np.sin(np.pi * a) * np.sin(np.pi * b)
    moved = quads.points.copy()
    moved[:, 0] += amount * x.max() * bubble * np.cos(3 * np.pi * b)
    moved[:, 1] += amount * y.max() * bubble * np.sin(4 * np.pi * a)
    return replace(quads, points=moved)
