"""The paper's tables as data, with what can be checked of them from their own digits."""

from importlib import import_module
from typing import Any

from cpam_bayes.paper.percentages import PercentageCheck, percentage_checks
from cpam_bayes.paper.perturbation import (
    Contradiction,
    PerturbationTable,
    PrintedConstant,
    contradictions,
    perturbation_table,
)
from cpam_bayes.paper.records import Misprint, PrintedRow, PrintedTable, PrintedValue
from cpam_bayes.paper.tables import printed_table

__all__ = [
    "Contradiction",
    "Misprint",
    "PercentageCheck",
    "PerturbationTable",
    "PrintedConstant",
    "PrintedRow",
    "PrintedTable",
    "PrintedValue",
    "contradictions",
    "percentage_checks",
    "perturbation_table",
    "printed_table",
    "table",
]


def table(number: int | None = None, **options: Any) -> Any:
    """One table, or all, printed values beside computed ones: what `cpam-bayes paper` prints.

    options : of `cpam_bayes.comparison.compare.compare`, which is loaded when it is asked for: this package
    is data that others compute with.

    Raises
    ------
    ValueError
        If the paper has no such table.

    Examples
    --------
    >>> import cpam_bayes as cb
    >>> result = cb.paper.table(2)
    >>> result.rows[0].printed, result.rows[0].verdict
    ('30.00', 'input')
    """
    return import_module("cpam_bayes.comparison.compare").compare(number, **options)
