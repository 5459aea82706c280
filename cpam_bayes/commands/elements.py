"""`forward --solver fem`: finite elements, on a rectangle or on the mesh of a file."""

from __future__ import annotations

import time

import numpy as np

from cpam_bayes.commands.solvers import described
from cpam_bayes.forward_model.elements import element_model
from cpam_bayes.mechanics.shapes import Extent, grid_points
from cpam_bayes.plate import Specimen
from cpam_bayes.report.forward.screen import ForwardAnswer, ModeShape


def fem(specimen: Specimen, n_modes: int) -> ForwardAnswer:
    """First-order shear deformation theory on 8-node elements."""
    start = time.perf_counter()
    found = element_model(specimen, n_modes)
    plate, space = found.specimen.plate, found.space
    (x0, x1), (y0, y1) = space.extent
    extent: Extent = (x0 / plate.length, x1 / plate.length), (y0 / plate.width, y1 / plate.width)
    modes, shapes = described(found.model, extent)
    n = shapes.shape[-1]
    shapes[:, :, ~space.covers(grid_points(extent, n)).reshape(n, n)] = np.nan
    on = "" if plate.mesh is None else f" of {plate.mesh.name}, {space.area * 1e6:.6g} mm2"
    return ForwardAnswer(
        specimen=found.specimen,
        solver=f"finite elements, first-order shear deformation, {space.n_elements} 8-node elements{on}",
        modes=modes,
        error=found.model.error,
        shapes=tuple(ModeShape(*shape) for shape in shapes),
        seconds=time.perf_counter() - start,
        no_estimate="" if plate.mesh is None else "not known: the mesh of a file is the only one",
        extent=space.extent,
    )
