"""`forward --solver ccx`: the program CalculiX, through files."""

from __future__ import annotations

import time

import numpy as np

from cpam_bayes.forward_model.calculix import Element, solve_modes
from cpam_bayes.forward_model.model import reference_constants
from cpam_bayes.plate import Specimen
from cpam_bayes.report.forward.screen import ForwardAnswer, ModeShape

_WORDS: dict[Element, str] = {
    "brick": "20-node bricks, layers of C3D20R",
    "shell": "8-node composite shells, S8R",
}


def ccx(specimen: Specimen, n_modes: int, element: Element = "brick") -> ForwardAnswer:
    """Three-dimensional bricks, or shells, solved by CalculiX."""
    start = time.perf_counter()
    found = solve_modes(specimen, reference_constants(specimen), n_modes, element=element)
    return ForwardAnswer(
        specimen=specimen,
        solver=f"CalculiX, {_WORDS[element]}",
        modes=found.modes,
        error=np.full(n_modes, np.nan),
        shapes=tuple(ModeShape(*shape) for shape in found.shapes),
        seconds=time.perf_counter() - start,
        no_estimate="not estimated",
    )
