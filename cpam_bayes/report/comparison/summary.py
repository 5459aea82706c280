"""`paper` in plain words: how many printed values come out, and the largest disagreements."""

from __future__ import annotations

from cpam_bayes.comparison.records import AGREES, NOT_REPRODUCIBLE, WITHIN, PaperResult
from cpam_bayes.comparison.summary import (
    KINDS,
    disagreements,
    means_of_ten,
    percentage_counts,
    verdict_counts,
)
from cpam_bayes.paper import printed_table
from cpam_bayes.report.summary import Summary
from cpam_bayes.report.tables import Table, headed


def summary(result: PaperResult) -> Summary:
    """Verdicts by table, and the disagreements in words."""
    counts = {kind: sum(verdict_counts(result.rows, n)[kind] for n in result.numbers) for kind in KINDS}
    computed = counts[AGREES] + counts[WITHIN] + counts[NOT_REPRODUCIBLE]
    tables = f"Table {result.numbers[0]}" if len(result.numbers) == 1 else f"{len(result.numbers)} tables"
    said = (
        f"Of {computed} printed values of {tables} that can be computed, {counts[AGREES]} agree, "
        f"{counts[WITHIN]} lie within the posterior's 95 % interval or set, and {counts[NOT_REPRODUCIBLE]} "
        "are not reproducible."
        if computed
        else f"{tables} holds inputs only: nothing to be computed."
    )
    quick = (
        "Computed with --quick, small swarms and linearised intervals: not to be quoted. "
        if result.quick
        else ""
    )
    return Summary(
        title=f"paper {result.title}".rstrip(),
        slips=result.slips,
        headline=f"{quick}{said}",
        tables=(verdicts_table(result),),
        basis=(*disagreements(result), *filter(None, (means_of_ten(result),))),
        warnings=tuple(w for w in result.warnings if w not in result.slips),
        next_steps=(
            "Read every row, with the reason where a value is not reproducible: --verbose, or paper.csv with "
            "--out DIR.",
        ),
    )


def verdicts_table(result: PaperResult) -> Table:
    """Counts of verdicts, a row each table."""
    rows = []
    for number in result.numbers:
        verdicts, percent = verdict_counts(result.rows, number), percentage_counts(number)
        counts = [*(verdicts[kind] for kind in KINDS), *percent.values()]
        rows.append((str(number), printed_table(number).title, *(str(count or "") for count in counts)))
    columns = headed(
        *("#table", "title", *(f"#{kind}" for kind in KINDS)),
        *("#percentages that follow", "#before rounding", "#do not follow"),
    )
    return Table(
        "Printed values by verdict, printed percentages by whether they follow", columns, tuple(rows)
    )
