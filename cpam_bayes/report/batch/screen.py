"""The screen of `batch`."""

from __future__ import annotations

from cpam_bayes.batches.batch import BatchResult
from cpam_bayes.report.batch.summary import plates_table
from cpam_bayes.report.sections import COMPUTATION, Section
from cpam_bayes.report.tables import Table, facts


def sections(result: BatchResult) -> tuple[Section, ...]:
    """The control chart, all plates, what each was warned of, and the computation."""
    charts = ("control_chart",) if result.done else ()
    computation = (
        (
            "constants",
            "swarms as of identify --residuals relative; limits by Laplace's approximation of the posterior",
        ),
        ("models", f"{result.models} of {len(result.rows)} plates"),
        ("from the store", str(result.from_store)),
        ("time", f"{result.seconds:.1f} s"),
    )
    return (
        Section("Control chart", (), charts, folded=False),
        Section("All plates", (plates_table(result, result.rows, "All plates"), _remarks(result))),
        Section(COMPUTATION, (facts("Computation", computation),)),
    )


def _remarks(result: BatchResult) -> Table:
    rows = tuple((row.name, row.message) for row in result.done if row.message)
    return facts("Warnings of the identifications", rows)
