"""A plate as an ABAQUS-format input deck, and CalculiX run on it through files."""

from cpam_bayes.forward_model.calculix.deck import Deck, Element, plate_deck
from cpam_bayes.forward_model.calculix.run import (
    PROGRAM_VARIABLE,
    CalculixError,
    CalculixModes,
    read_eigenvalues,
    run_deck,
    solve_modes,
)

__all__ = [
    "PROGRAM_VARIABLE",
    "CalculixError",
    "CalculixModes",
    "Deck",
    "Element",
    "plate_deck",
    "read_eigenvalues",
    "run_deck",
    "solve_modes",
]
