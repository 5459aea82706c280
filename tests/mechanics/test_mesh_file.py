"""Meshes from files: what is read, and the messages for those that cannot be used."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cpam_bayes.mechanics.mesh_file import read_mesh
from tests.meshes import Quads, grid, rectangle

MM = (1 / 40.0, 1 / 20.0)  # a plate of 40 x 20
EDGES = ("x0", "y0", "x1", "y1")
FOUR = rectangle(40.0, 20.0, 2, 2)
INNER, METRES = replace(FOUR, lines={"x0": np.array([[1, 4]])}), replace(FOUR, points=1e-3 * FOUR.points)

# A 40 x 20 rectangle of two cells with named sides, as written by Gmsh 4.15.
GMSH_41 = Path(__file__).with_name("rectangle_41.msh").read_text("utf-8")


def test_format_41_with_its_named_sides_is_read(tmp_path: Path) -> None:
    path = tmp_path / "plate.msh"
    path.write_text(GMSH_41)
    mesh, named = read_mesh(path, MM, EDGES)
    assert mesh.nelements == 2
    np.testing.assert_allclose(mesh.p.max(axis=1), 1.0)
    for name, facets in named.items():
        ends = mesh.p[:, mesh.facets[:, facets]]["xy".index(name[0])]
        np.testing.assert_allclose(ends, float(name[1]), err_msg=name)


@pytest.mark.parametrize("binary", [False, True], ids=["text", "binary"])
@pytest.mark.parametrize("nodes", [4, 8, 9])
def test_cells_of_4_8_and_9_nodes_are_read_and_clockwise_ones_turned(
    tmp_path, nodes: int, binary: bool
) -> None:
    quads = rectangle(40.0, 20.0, 3, 2, order=1 if nodes == 4 else 2)
    cells = quads.cells[:, :nodes].copy()
    cells[1] = cells[1, [0, 3, 2, 1, 7, 6, 5, 4, 8][:nodes]]
    path = replace(quads, cells=cells).write(tmp_path / "plate.msh", binary=binary)
    mesh, named = read_mesh(path, MM, EDGES)
    assert (mesh.nelements, mesh.nfacets) == (6, 17)
    assert {k: len(v) for k, v in named.items()} == {"x0": 2, "x1": 2, "y0": 3, "y1": 3}
    assert mesh.doflocs.shape[1] == (12 if nodes == 4 else 35)  # middle nodes of 8-node cells are dropped
    jacobian = mesh.mapping().DF(np.array([[0.1, 0.8], [0.3, 0.6]]))
    np.testing.assert_allclose(np.linalg.det(np.moveaxis(jacobian, (0, 1), (-2, -1))), 1 / 6)


def _pieces(gap: float) -> Quads:
    one = rectangle(20.0, 20.0, 2, 2)
    n = len(one.points)
    other = one.points + np.array([20.0 + gap, 0.0, 0.0])
    return Quads(np.concatenate((one.points, other)), np.concatenate((one.cells, one.cells + n)), {})


def _overlapping() -> Quads:
    quads = rectangle(40.0, 20.0, 2, 1)
    points = np.concatenate((quads.points, [[35.0, 0.0, 0.0], [35.0, 18.0, 0.0]]))
    more = [[quads.cells[0, 3], quads.cells[0, 0], 6, 7]]
    return replace(quads, points=points, cells=np.concatenate((quads.cells, more)))


def _unshared_middles() -> Quads:
    quads = rectangle(40.0, 20.0, 2, 1, order=2)
    cells = quads.cells[:, :8].copy()
    shared = np.intersect1d(cells[0, 4:], cells[1, 4:])
    points = np.concatenate((quads.points, quads.points[shared]))
    cells[1][cells[1] == shared[0]] = len(quads.points)
    return replace(quads, points=points, cells=cells)


def _moved(*middle: float) -> Quads:
    points = FOUR.points.copy()
    points[4] = middle
    return replace(FOUR, points=points)


NO_PLATE = {
    "pieces": (_pieces(1.0), "2 pieces that share no side; merge coincident nodes"),
    "unmerged": (_pieces(0.0), "2 pieces that share no side"),
    # beyond the diagonal of a cell
    "folded": (_moved(39.0, 19.0, 0.0), r"cells are folded or without area, the first around"),
    "bow-tie": (replace(FOUR, cells=FOUR.cells[:, [0, 2, 1, 3]]), "4 cells are folded"),
    "overlapping": (_overlapping(), "cells overlap"),
    "middles": (_unshared_middles(), "neighbours must share the nodes in the middle"),
    "inner line": (INNER, r"1 of 1 lines of 'x0' are no sides of the plate's boundary"),
    "missing edge": (FOUR.without("y0"), r"\['y0'\] are held.*\['x0', 'x1', 'y1'\]"),
    "not flat": (_moved(20.0, 10.0, 3.0), "z varies by 3; accepted: a flat plate"),
    "nan": (_moved(np.nan, 10.0, 0.0), "not finite"),
    "metres": (METRES, r"extends over 0.04 x 0.02, the plate over 40 x 20 in the same unit"),
    "inches": (replace(FOUR, points=25.4 * FOUR.points), "check the mesh's unit"),
}


@pytest.mark.parametrize(("quads", "says"), NO_PLATE.values(), ids=NO_PLATE)
def test_a_mesh_that_is_no_plate_is_refused(tmp_path: Path, quads: Quads, says: str) -> None:
    path = quads.write(tmp_path / "plate.msh")
    with pytest.raises(ValueError, match=says) as caught:
        read_mesh(path, MM, ("y0",))
    assert str(caught.value).startswith(f"mesh {path}: ")


CELLS = """$MeshFormat
2.2 0 8
$EndMeshFormat
$Nodes
5
1 0 0 0
2 20 0 0
3 20 20 0
4 0 20 0
5 40 10 0
$EndNodes
$Elements
{}
$EndElements
"""
REFUSED = {  # Content of a file, and its message; by default "accepted: Gmsh format 2.2 or 4.1".
    "triangles": (CELLS.format("2\n1 2 2 1 1 1 2 3\n2 2 2 1 1 1 3 4"), "it has 2 triangle; .*recombine"),
    "mixed": (CELLS.format("2\n1 3 2 1 1 1 2 3 4\n2 2 2 1 1 2 5 3"), "it has 1 quad, 1 triangle; "),
    "lines": (CELLS.format("1\n1 1 2 1 1 1 2"), "it has no cells of a surface; "),
    "empty": ("", ""),
    "binary": ("\x00\xff\xfe" * 100, ""),
    "other": ("solid cube\nfacet normal", ""),
    "version": ("$MeshFormat\n9.9 0 8\n$EndMeshFormat\n", ""),
    "number": ("$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\nthree\n", ""),
    "cut": (GMSH_41[: len(GMSH_41) // 2], ""),
    "short": (GMSH_41.replace("7 1 5 6 4", "7 1 5 6"), ""),
    "kind": (GMSH_41.replace("2 1 3 2\n7", "2 1 777 2\n7"), ""),
}


@pytest.mark.parametrize(("content", "says"), REFUSED.values(), ids=REFUSED)
def test_other_cells_and_damaged_files_are_refused(tmp_path: Path, content: str, says: str) -> None:
    path = tmp_path / "plate.msh"
    path.write_bytes(content.encode("latin-1"))
    with pytest.raises(ValueError, match=r"plate.msh: .*" + (says or "accepted: Gmsh format 2.2 or 4.1")):
        read_mesh(path, MM, ())


def test_a_missing_file_a_directory_and_a_missing_meshio_are_said(tmp_path: Path, monkeypatch) -> None:
    path = tmp_path / "plate.msh"
    with pytest.raises(ValueError, match=r"plate.msh: No such file"):
        read_mesh(path, MM, ())
    with pytest.raises(ValueError, match="directory"):
        read_mesh(tmp_path, MM, ())
    monkeypatch.setitem(sys.modules, "meshio", None)
    with pytest.raises(ValueError, match="needs meshio; install it with the extra 'mesh'"):
        read_mesh(FOUR.write(path), MM, ())


def test_a_hole_is_boundary_too(tmp_path: Path) -> None:
    def ring(r: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        radius = 3.0 + 7.0 * r
        return 20 + 2 * radius * np.cos(2 * np.pi * a), 10 + radius * np.sin(2 * np.pi * a)

    quads = grid(np.linspace(0, 1, 3), np.linspace(0, 1, 13), ring, closed=True).without("y0", "y1")
    mesh, named = read_mesh(quads.write(tmp_path / "plate.msh"), MM, ("x0",))
    assert len(mesh.boundary_facets()) == 24
    assert len(named["x0"]) == 12
