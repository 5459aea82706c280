"""The commands, one module each: `add` says its options, `prepare` makes of them a call of the library.

This module is imported for `--help`: it loads nothing beyond the standard library.
"""

from typing import Final

COMMANDS: Final = (
    "plates",
    "new",
    "poles",
    "forward",
    "export",
    "identify",
    "predict",
    "design",
    "sensitivity",
    "sequence",
    "diagnose",
    "report",
    "batch",
    "paper",
    "cache",
)
SOLVERS: Final = ("ritz", "fem", "ccx")
ELEMENTS: Final = ("brick", "shell")
"""What CalculiX computes with."""
MATERIALS: Final = ("carbon", "glass", "fabric", "spruce", "metal")
"""What a new plate file can begin with."""
BACKENDS: Final = ("pso", "emcee")
NOISE_SHAPES: Final = {"gaussian": float("inf"), "student-t": 4.0}
"""Name of a shape of noise -> its degrees of freedom."""
