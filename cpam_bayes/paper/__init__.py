"""The paper's tables as data, with what can be checked of them from their own digits."""

from cpam_bayes.paper.perturbation import (
    Contradiction,
    PerturbationTable,
    PrintedConstant,
    contradictions,
    perturbation_table,
)

__all__ = ["Contradiction", "PerturbationTable", "PrintedConstant", "contradictions", "perturbation_table"]
