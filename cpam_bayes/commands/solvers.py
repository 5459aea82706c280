"""The plate solvers of `forward`, behind one call: (specimen, n_modes) -> ForwardAnswer."""

from __future__ import annotations

import time

import numpy as np

from cpam_bayes.measurement import Specimen
from cpam_bayes.model import NO_PARAMETERS, converged_model
from cpam_bayes.report.forward import ForwardAnswer, ModeShape
from cpam_bayes.shapes import shape_on_grid


def ritz(specimen: Specimen, n_modes: int) -> ForwardAnswer:
    """First-order shear deformation theory on a converged Ritz space."""
    start = time.perf_counter()
    model = converged_model(specimen, NO_PARAMETERS, n_modes)
    reference = np.empty(0)
    spectrum = model.spectrum(reference, vectors=True)
    shapes = tuple(
        ModeShape(*(shape_on_grid(model.operator, spectrum, i, field) for field in ("u", "v", "w")))
        for i in range(n_modes)
    )
    return ForwardAnswer(
        specimen=specimen,
        solver="Ritz, first-order shear deformation",
        modes=model.modes(reference),
        error=model.error,
        shapes=shapes,
        seconds=time.perf_counter() - start,
    )
