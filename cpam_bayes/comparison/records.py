"""Rows of the comparison, the audit of the print, and the answer to the question `paper`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import ClassVar

from cpam_bayes.result import Result

__all__ = [
    "AGREES",
    "INPUT",
    "NOT_REPRODUCIBLE",
    "WITHIN",
    "Cost",
    "Misfit",
    "PaperResult",
    "Row",
    "SimulationError",
    "WellPosed",
    "kind_of",
]

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


@dataclass(frozen=True, slots=True)
class WellPosed:
    """Hadamard's conditions for the constants of a plate from its measured frequencies, at the best optimum.

    Existence
        left_percent : root of the residual sum of squares over the degrees of freedom, of relative residuals;
        None where there are none. repeatability_percent : 97.5 % quantile of what a tap test repeats within.
    Uniqueness
        rank, condition : of the sensitivities d ln f / d ln x; condition is None where the rank is not full.
        optima : that the misfit does not tell apart, the best one among them. layups : stacking sequences in
        the 95 % set where angles are unknown too, None where that was not computed.
    Stability
        percent_per_percent : name -> sd of a constant, %, for 1 % of noise on each frequency, to first order
        and without bounds; None where the rank is not full.
    """

    table: int
    specimen: str
    case: str
    frequencies: int
    unknowns: int
    left_percent: float | None
    repeatability_percent: float
    rank: int
    condition: float | None
    optima: int
    layups: int | None
    percent_per_percent: Mapping[str, float | None]

    @property
    def exists(self) -> bool | None:
        """Whether what is left is within the repeatability of a tap test; None where nothing can be left."""
        return None if self.left_percent is None else self.left_percent <= self.repeatability_percent

    @property
    def is_unique(self) -> bool:
        """Whether the sensitivities have full rank and no other optimum, or layup, fits as well."""
        return self.rank == self.unknowns and self.optima == 1 and self.layups in (None, 1)


@dataclass(frozen=True, slots=True)
class SimulationError:
    """What the simulation of Table 5, or 1, gets wrong on a plate, by the diagnosis of its measured list.

    printed_rms_percent : of the printed simulation, with the reference constants, against the measured list;
        None where none is printed
    plain_rms_percent, extended_rms_percent : of the plain model with its own constants, and extended by what
        is claimed; None where nothing is
    claim, causes, probability : of the diagnosis
    log_bayes_factor : of what is claimed against the plain model. held_out, held_out_se : log predictive
        density of frequencies left out, less the plain model's, and its standard error
    """

    table: int
    specimen: str
    printed_rms_percent: float | None
    plain_rms_percent: float
    claim: str
    causes: tuple[str, ...]
    probability: float
    extended_rms_percent: float | None
    log_bayes_factor: float | None
    held_out: float | None
    held_out_se: float | None


@dataclass(frozen=True, slots=True)
class Cost:
    """Forward solves of a plate's optimum, single swarms and posterior, and their wall time.

    calculix_seconds : of one run of CalculiX on that plate, None where none was timed.
    """

    specimen: str
    case: str
    forward_solves: int
    seconds: float
    calculix_seconds: float | None

    @property
    def calculix_hours(self) -> float | None:
        """What as many runs of CalculiX take one after another."""
        return None if self.calculix_seconds is None else self.forward_solves * self.calculix_seconds / 3600.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class PaperResult(Result):
    """Tables of the paper beside what this package computes.

    Attributes
    ----------
    numbers : of the tables
    rows : one for each printed value
    misfits : of the printed constants, beside ours
    well_posed : Hadamard's conditions, one for each plate and choice of unknowns
    simulation_errors : what the simulation of Tables 1 and 5 gets wrong, by plate
    costs : forward solves and seconds, one for each plate and choice of unknowns
    computed : task -> version, date and seconds of the computation behind the rows
    quick : whether the small effort was asked for
    seconds : wall clock of this run, without what was stored
    """

    question: ClassVar[str] = "comparison"
    command: ClassVar[str] = "paper"

    numbers: tuple[int, ...]
    rows: tuple[Row, ...]
    misfits: tuple[Misfit, ...]
    well_posed: tuple[WellPosed, ...] = ()
    simulation_errors: tuple[SimulationError, ...] = ()
    costs: tuple[Cost, ...] = ()
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
