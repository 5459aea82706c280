"""The screen of `design`."""

from __future__ import annotations

from cpam_bayes.report.design.summary import candidates_table
from cpam_bayes.report.plates.head import plate_section
from cpam_bayes.report.sections import COMPUTATION, Section
from cpam_bayes.report.tables import Table, facts, headed
from cpam_bayes.specimen_design.design import DesignResult

_MOST_ROWS = 60


def sections(result: DesignResult) -> tuple[Section, ...]:
    """Maps, the plate, all candidates, and how they were computed."""
    maps = ("information", *(result.constants if len(result.constants) > 1 else ()))
    n = len(result.candidates)
    title = "All candidates" if n <= _MOST_ROWS else f"The {_MOST_ROWS} best of {n} candidates"
    computation = (
        ("model", "Ritz, first-order shear deformation, at the reference constants"),
        ("information", "Laplace's approximation: the Fisher information of the list beside the priors"),
        ("specimens", f"{len({id(c.geometry) for c in result.candidates})} computed"),
        ("time", f"{result.seconds:.1f} s"),
    )
    return (
        Section("Maps of the expected information", (), maps, folded=False),
        plate_section(result.specimen, result.air_shifts),
        Section(title, (candidates_table(result, result.candidates[:_MOST_ROWS], title), _failed(result))),
        Section(COMPUTATION, (facts("Computation", computation),)),
    )


def _failed(result: DesignResult) -> Table:
    rows = tuple((g.layup.text, g.edges, f"{g.ratio:.3g}", said) for g, said in result.failed)
    columns = headed("layup", "edges", "#length / width", "why")
    return Table("Specimens that cannot be computed", columns, rows, frozenset(range(len(rows))))
