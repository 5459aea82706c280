"""Figures of `forward`: all mode shapes."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from cpam_bayes.forward_model.solve import ForwardResult
from cpam_bayes.report.modal_assurance.figure import assurance_figures
from cpam_bayes.report.mode_shapes import extent_of, shapes_figure


def figures(result: ForwardResult) -> dict[str, Figure]:
    """All mode shapes: deflection with its nodal lines, or the deformed grid of in-plane modes."""
    plate = result.specimen.plate
    extent = extent_of(plate.length, plate.width)
    if result.extent is not None:
        (x0, x1), (y0, y1) = result.extent
        extent = (1e3 * x0, 1e3 * x1, 1e3 * y0, 1e3 * y1)
    figure = shapes_figure(
        f"{result.specimen.name}, edges {plate.edges}, {result.solver}",
        [f"{i}: {m.frequency:.6g} Hz\n{m.kind} {m.label}" for i, m in enumerate(result.modes, 1)],
        [np.stack((shape.u, shape.v, shape.w)) for shape in result.shapes],
        [mode.in_plane_fraction > 0.5 for mode in result.modes],
        extent,
        plate.edges if plate.mesh is None else "FFFF",
    )
    return {"modes": figure} | assurance_figures(
        result.specimen.name, result.by_shape, result.specimen.measurement
    )
