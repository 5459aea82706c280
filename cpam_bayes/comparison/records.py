"""Rows of the comparison, the audit of the print, and the answer to the question `paper`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import ClassVar

from cpam_bayes.result import Result

__all__ = ["AGREES", "INPUT", "NOT_REPRODUCIBLE", "WITHIN", "Misfit", "PaperResult", "Row", "kind_of"]

AGREES, WITHIN, INPUT, NOT_REPRODUCIBLE = "agrees", "within the posterior", "input", "not reproducible"


@dataclass(frozen=True, slots=True)
class Row:
    """One printed value beside the computed one.

    printed : as printed. ours : number, or angles in degrees from the outermost ply, or None for inputs.
    difference_percent : printed over ours, less one.
    q025, q975 : posterior interval of the quantity, where there is one.
    verdict : one of the four of this module; "not reproducible" is followed by ": " and why.
    details : further computed numbers by name, such as the other solvers.
    """

    table: int
    part: str
    specimen: str
    source: str
    quantity: str
    printed: str
    ours: float | tuple[float, ...] | None
    difference_percent: float | None
    q025: float | None
    q975: float | None
    verdict: str
    details: Mapping[str, float | None] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Misfit:
    """A printed set of constants and ours against the same frequencies; forward solves only.

    objective : F of eq. (7), Hz^2. rms_percent : root mean square of the relative residuals.
    case : "as built in", "two constants" or "four constants".
    swarms_found : how many of the swarms ended within 0.1 % of the least F.
    swarms_converged : how many of them called themselves converged.
    on_bounds : constants of ours that sit on a bound.
    """

    table: int
    specimen: str
    case: str
    source: str
    objective: float
    rms_percent: float
    our_objective: float
    our_rms_percent: float
    swarms: int
    swarms_found: int
    swarms_converged: int
    on_bounds: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class PaperResult(Result):
    """Tables of the paper beside what this package computes.

    Attributes
    ----------
    numbers : of the tables
    rows : one for each printed value
    misfits : of the printed constants, beside ours
    computed : task -> version, date and seconds of the computation behind the rows
    quick : whether the small effort was asked for
    seconds : wall clock of this run, without what was stored
    """

    question: ClassVar[str] = "comparison"
    command: ClassVar[str] = "paper"

    numbers: tuple[int, ...]
    rows: tuple[Row, ...]
    misfits: tuple[Misfit, ...]
    computed: Mapping[str, Mapping[str, str | float]]
    quick: bool
    seconds: float

    def texts(self) -> Mapping[str, str]:
        """The rows as a CSV file, and the page as Markdown."""
        report = import_module(f"cpam_bayes.report.{self.question}.document")
        markdown = import_module(f"cpam_bayes.report.{self.question}.markdown")
        return {"paper.csv": report.csv_text(self), "comparison.md": markdown.page(self.to_dict())}

    @property
    def title(self) -> str:
        """The table, where one was asked for."""
        return f"{self.numbers[0]}" if len(self.numbers) == 1 else ""


def kind_of(verdict: str) -> str:
    """The verdict without its reason."""
    return verdict.partition(":")[0]
