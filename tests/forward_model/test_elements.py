"""Plates on finite elements: a valid error estimate, mass and covered points of meshes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cpam_bayes.forward_model.elements import element_model
from cpam_bayes.forward_model.model import plate_problem
from cpam_bayes.mechanics import fem
from cpam_bayes.mechanics.fem import discretise_sparse
from cpam_bayes.mechanics.modes import grid_points, shapes_on_grid, solve
from cpam_bayes.plate import Specimen
from cpam_bayes.plate.layup import parse_layup
from tests.meshes import Quads, grid, rectangle
from tests.plates import with_plate

N_MODES = 10


def finer(specimen: Specimen) -> np.ndarray:
    """Frequencies on 1.6 times as many elements a side, the outermost a quarter as wide."""
    problem = plate_problem(specimen)
    counts = [round(1.6 * n) for n in fem.default_counts(problem.nominal)]
    grading = fem.Grading(first=fem.DEFAULT_GRADING.first / 4, growth=2.0)
    space = fem.fem_space(problem.edges, problem.nominal, *counts, grading=grading)
    operator = discretise_sparse(problem, space, {})
    return solve(operator, *operator.coefficients({}), N_MODES).frequencies[0]


# D4 is thick and clamped, so that its edges matter. A plate with h / a = 1/2800 tests locking.
@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("D4", {}),
        ("A2", {"edges": "CCCC"}),
        pytest.param("C2", {"edges": "SSSS", "layup": parse_layup("[30/-60]")}, marks=pytest.mark.slow),
        ("D2", {"edges": "CSFF", "layup": parse_layup("[45/-45]_s")}),
        pytest.param("A1", {"thickness": 1e-4}, marks=pytest.mark.slow),
    ],
    ids=["D4", "clamped", "unsymmetric", "mixed", "locking"],
)
def test_the_error_estimate_covers_the_error_and_is_not_far_above(name: str, changes) -> None:
    specimen = with_plate(name, **changes)
    model = element_model(specimen, N_MODES).model
    true = np.abs(model.spectrum(np.empty((1, 0))).frequencies[0] / finer(specimen) - 1.0)
    assert np.all(true <= model.error)  # the finer mesh has a tenth to a fifth of the default one's error
    assert model.error.max() < 10 * true.max()


def ring(folder: Path) -> Path:
    """A ring within a 200 x 200 mm plate: radii 30 to 100 mm."""

    def around(r: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        radius = 30.0 + 70.0 * r
        return 100 + radius * np.cos(2 * np.pi * a), 100 + radius * np.sin(2 * np.pi * a)

    quads = grid(np.linspace(0, 1, 4), np.linspace(0, 1, 25), around, order=2, closed=True)
    return quads.without("y0", "y1").write(folder / "ring.msh")


def oblique(folder: Path) -> Path:
    """A 200 x 100 mm parallelogram whose upper edge is shifted by 60 mm in x."""
    straight = rectangle(200.0, 100.0, 12, 8)
    moved = straight.points + 0.6 * straight.points[:, [1, 2, 2]]
    return Quads(moved, straight.cells, straight.lines).write(folder / "oblique.msh")


def on_mesh(path: Path, **changes: object) -> Specimen:
    return with_plate("A1", **{"length": 0.2, "width": 0.2, "mesh": path, **changes})


def test_a_weighed_plate_with_a_hole_gets_its_density_from_the_area_of_its_mesh(tmp_path: Path) -> None:
    area = np.pi * (0.1**2 - 0.03**2)
    weighed = on_mesh(ring(tmp_path), mass=0.3, density=0.3 / (0.2 * 0.2 * 3e-3), thickness=3e-3)
    found = element_model(weighed, 2)
    density = found.specimen.plate.density
    assert found.space.area == pytest.approx(area, rel=1e-4)  # 24 parabolic sides instead of a circle
    assert density == pytest.approx(0.3 / (area * 3e-3), rel=1e-4)
    given = replace(weighed, plate=replace(weighed.plate, mass=None, density=density))
    a, b = (element_model(s, 2).model.predict(np.empty((1, 0))).frequencies for s in (weighed, given))
    np.testing.assert_allclose(a, b, rtol=1e-12)
    assert element_model(given, 2).specimen is given
    points = np.array([[0.5, 0.5], [0.5, 0.9], [0.99, 0.99], [0.5, 0.64], [0.5, 0.66]])  # hole and outside
    np.testing.assert_array_equal(found.space.covers(points), [False, True, False, False, True])


def test_shapes_of_an_oblique_plate_reach_as_far_as_its_mesh(tmp_path: Path) -> None:
    found = element_model(on_mesh(oblique(tmp_path), width=0.1), 3)
    (x0, x1), (y0, y1) = found.space.extent
    np.testing.assert_allclose([x0, x1, y0, y1], [0.0, 0.26, 0.0, 0.1], atol=1e-12)
    extent = ((0.0, x1 / 0.2), (0.0, 1.0))
    spectrum = found.model.spectrum(np.empty((1, 0)), vectors=True)
    shapes = shapes_on_grid(found.model.operator, spectrum, extent)
    on = found.space.covers(grid_points(extent)).reshape(shapes.shape[2:])
    assert on.mean() == pytest.approx(200 / 260, abs=0.02)
    assert np.all(shapes[:, :, ~on] == 0.0)
    assert np.all(np.abs(shapes[0, 2, -3:, -3:]).max() > 0.5 * np.abs(shapes[0, 2]).max())
