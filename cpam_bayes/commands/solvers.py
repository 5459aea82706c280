"""`forward --solver ritz`, and what solvers of a plate model share."""

from __future__ import annotations

import time

import numpy as np

from cpam_bayes.forward_model.model import NO_PARAMETERS, PlateModel, converged_model
from cpam_bayes.mechanics.shapes import UNIT_SQUARE, Array, Extent, Mode, describe_modes, shapes_on_grid
from cpam_bayes.plate import Specimen
from cpam_bayes.report.forward.screen import ForwardAnswer, ModeShape


def ritz(specimen: Specimen, n_modes: int) -> ForwardAnswer:
    """First-order shear deformation theory on a converged Ritz space."""
    start = time.perf_counter()
    model = converged_model(specimen, NO_PARAMETERS, n_modes)
    modes, shapes = described(model)
    return ForwardAnswer(
        specimen=specimen,
        solver="Ritz, first-order shear deformation",
        modes=modes,
        error=model.error,
        shapes=tuple(ModeShape(*shape) for shape in shapes),
        seconds=time.perf_counter() - start,
    )


def described(model: PlateModel, extent: Extent = UNIT_SQUARE) -> tuple[tuple[Mode, ...], Array]:
    """Modes of a model without parameters, and their u, v, w on a grid, (n_modes, 3, n, n)."""
    none = np.empty((1, 0))
    spectrum = model.spectrum(none, vectors=True)
    _, mass = model.coefficients(none)
    modes = describe_modes(model.operator, spectrum, mass, extent)
    return modes, shapes_on_grid(model.operator, spectrum, extent)
