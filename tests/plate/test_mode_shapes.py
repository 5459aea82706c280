"""A universal file gives frequencies, damping and shapes on the plate, and errors say what is missing."""

import sys
from functools import partial

import numpy as np
import pytest

import cpam_bayes as cb
from cpam_bayes.errors import PlateFileError
from tests.plate_file import OF_TABLE
from tests.universal import block, grid, mode_55, nodes_15, nodes_2411, units_164

MM = grid(200.0, 100.0)
SHAPE = np.stack((*np.zeros((2, len(MM))), (MM[:, 0] - 100.0) * (MM[:, 1] - 50.0)))
OTHER = np.stack((*np.zeros((2, len(MM))), np.cos(2.0 * np.pi * MM[:, 0] / 200.0)))
ONE = nodes_15(MM) + mode_55(101.5, SHAPE)
FILE = {"key": "shapes", "name": "modes.unv"}
UNREADABLE = ONE.replace("5.00000E+03", "5.0000?E+03")
MANY = nodes_15(MM) + "".join(mode_55(100.0 + i, SHAPE) for i in range(101))


@pytest.fixture
def shapes(measured):
    return partial(measured, **FILE)


def test_nodes_and_normal_modes_are_read_in_the_order_of_their_frequencies_and_nothing_else(shapes):
    found = shapes(nodes_15(MM) + mode_55(305.25, OTHER, 2, viscous=0.002) + mode_55(101.5, 3.0 * SHAPE))
    assert found.frequencies.tolist() == [101.5, 305.25]
    assert found.damping == pytest.approx([np.nan, 0.002], nan_ok=True)
    assert found.labels == ("", "")
    assert np.allclose(found.shapes.points, 1e-3 * MM)
    assert np.allclose(found.shapes.values, [3.0 * SHAPE, OTHER], rtol=1e-5)
    assert found.shapes.directions.tolist() == [False, False, True]
    assert "datasets 15 55; 2 real modes at 20 nodes in mm, by the size of the plate" in found.origin
    assert shapes(ONE.replace("\n", "\r\n"), "relative_std = 0.01\n").relative_std == 0.01
    head = block(151, "broken") + block(9999, "unknown")  # unused datasets need not be readable
    forced = mode_55(50.0, SHAPE).replace(f"{1:10d}{2:10d}{2:10d}", f"{1:10d}{5:10d}{2:10d}")
    assert shapes(head + ONE + mode_55(0.0, SHAPE) + forced).frequencies.tolist() == [101.5]


def test_a_file_that_is_cut_short_inside_a_mode_is_refused(shapes, refused):
    other = mode_55(305.25, OTHER)
    cut = (ONE + other)[: -(len(other) // 2)]
    (problem,) = refused(cut, **FILE)
    assert f"cut short: the dataset that begins at line {ONE.count(chr(10)) + 1} has no end" in problem
    assert refused(cut.replace("\n", "\r\n"), **FILE) == [problem]
    assert shapes(ONE + other + "\n").frequencies.tolist() == [101.5, 305.25]


@pytest.mark.parametrize(
    ("nodes", "words"),
    [
        (nodes_15(1e-3 * MM), "in m, by the size of the plate, from the corner"),
        (nodes_2411(MM), "datasets 55 2411;"),
        (nodes_2411(1e-3 * MM) + units_164(1.0), "in m, from the corner"),
        (nodes_15(MM) + units_164(1000.0), "in mm, from the corner"),
        (nodes_15(MM / 25.4) + units_164(1.0 / 0.0254), "in in, from the corner"),
        (nodes_15(MM - (100.0, 50.0)), "from the middle"),
    ],
)
def test_nodes_lie_on_the_plate_in_any_unit_and_from_the_middle(shapes, nodes, words):
    found = shapes(nodes + mode_55(101.5, SHAPE))
    assert np.allclose(found.shapes.points, 1e-3 * MM, atol=1e-8)
    assert words in found.origin


def test_damping_is_viscous_or_half_of_hysteretic_or_of_the_complex_eigenvalue(shapes):
    real = mode_55(100.0, SHAPE, viscous=0.004) + mode_55(200.0, SHAPE, hysteretic=0.006)
    found = shapes(nodes_15(MM) + real + mode_55(300.0, SHAPE * (1.0 + 0.5j), damping=0.01))
    assert found.frequencies == pytest.approx([100.0, 200.0, 300.0], rel=1e-5)
    assert found.damping == pytest.approx([0.004, 0.003, 0.01], rel=1e-4)
    assert np.allclose(found.shapes.values[2], SHAPE * (1.0 + 0.5j), rtol=1e-5)


def test_shapes_are_taken_at_the_nodes_that_all_modes_have(shapes):
    some = [3, 1, 20, 7]
    at = np.array(some) - 1
    found = shapes(ONE + mode_55(305.0, OTHER[:, at], 2, nodes=some))
    assert found.shapes.nodes.tolist() == sorted(some)
    assert np.allclose(found.shapes.values[1, 2], OTHER[2, np.sort(at)], rtol=1e-5)
    assert np.allclose(found.shapes.points, 1e-3 * MM[np.sort(at)])


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (nodes_15(MM), "no modes, accepted: datasets 55"),
        (mode_55(101.5, SHAPE), "no nodes, accepted: a dataset 15 or 2411"),
        (nodes_15(MM[:4]) + mode_55(101.5, SHAPE), "no coordinates of the nodes 5 6 7 8 9 10, accepted"),
        (nodes_15(MM) + mode_55(101.5, 0.0 * SHAPE), "a mode that moves at no node"),
        (nodes_15(2.0 * MM) + mode_55(101.5, SHAPE), "do not lie on the plate, received x 0 to 400"),
        (nodes_15(MM) + units_164(1.0) + mode_55(101.5, SHAPE), "in m by dataset 164, accepted: the plane"),
        (nodes_15(MM[:, [0, 0, 1]] * [1, 0, 1]) + mode_55(101.5, SHAPE), "do not lie on the plate"),
        (nodes_15(MM) + mode_55(101.5, SHAPE[:, :2], nodes=[1, 2]), "2 nodes that all modes have"),
        (nodes_15(MM)[:-30] + "\n    -1\n" + mode_55(101.5, SHAPE), "a dataset 15 that ends within a node"),
        (UNREADABLE, "dataset 2, of type 55: cannot be read, accepted: the columns of its format"),
        (ONE.replace("2.00000E+02", "        nan"), "values that are no numbers"),
        (nodes_15(MM).replace("\n        20", "\n       1.5") + mode_55(101.5, SHAPE), "no whole numbers"),
        (nodes_15(MM) + units_164(1e-300) + mode_55(101.5, SHAPE), "received a factor of length of 1e-300"),
        ("    -1\n" * 30_000, "received 15000 datasets, accepted: 10000 at most"),
        (MANY, "too many modes, received 101"),
    ],
)
def test_what_a_file_lacks_is_said(refused, content, said):
    (problem,) = refused(content, **FILE)
    assert problem.startswith("modes.unv: ")
    assert said in problem


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ('labels = ["(1,1)"]\n', r"measurement\.labels: beside shapes"),
        ("frequency_sd_hz = [1.0]\n", r"measurement\.frequency_sd_hz: beside shapes"),
        ("frequencies_hz = [101.5]\n", "frequencies_hz and shapes, accepted: one of"),
    ],
)
def test_the_file_must_be_there_and_alone(shapes, tmp_path, more, said):
    with pytest.raises(PlateFileError, match=said):
        shapes(ONE, more)
    path = tmp_path / "bar.toml"
    path.write_text(f'{OF_TABLE}shapes = "gone.unv"\n', encoding="utf-8")
    with pytest.raises(PlateFileError, match=r'measurement\.shapes: no such file, received "gone\.unv"'):
        cb.read_plate(path)
    (tmp_path / "gone.unv").mkdir()
    with pytest.raises(PlateFileError, match="a directory, accepted: a universal file of modes"):
        cb.read_plate(path)


def test_without_the_library_the_extra_is_named(refused, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyuff", None)
    assert 'pip install "cpam-bayes[uff]"' in refused(ONE, **FILE)[0]
