"""The commands, one module each, with `prepare(args)`: options in, the work still to be done out.

This module is imported for `--help`, so it names the solvers and back ends without loading them.
"""

from collections.abc import Callable
from importlib import import_module
from typing import Any, Final

SOLVERS: Final = {
    "ritz": "cpam_bayes.commands.solvers:ritz",
    "fem": "cpam_bayes.commands.elements:fem",
    "ccx": "cpam_bayes.commands.calculix:ccx",
}
"""Name of a solver -> the function (specimen, n_modes) -> ForwardAnswer; ccx also takes element."""

ELEMENTS: Final = ("brick", "shell")
"""What CalculiX computes with."""

BACKENDS: Final = {
    "pso": "cpam_bayes.commands.swarm:identify_by_swarm",
    "emcee": "cpam_bayes.commands.ensemble:identify_by_ensembles",
}
"""Name of a back end -> the function (specimen, args) -> Answer."""

NOISE_SHAPES: Final = {"gaussian": float("inf"), "student-t": 4.0}
"""Name of a shape of noise -> its degrees of freedom."""

DEFAULT_SEED: Final = 0
MOST_MODES: Final = 100


def load(place: str) -> Callable[..., Any]:
    """Import the function "module:name"."""
    module, _, name = place.partition(":")
    function: Callable[..., Any] = getattr(import_module(module), name)
    return function
