"""The JSON document and the CSV file of `paper`."""

from __future__ import annotations

import csv
import io
from dataclasses import asdict
from typing import Any

from cpam_bayes import __version__
from cpam_bayes.comparison.records import PaperResult, Row
from cpam_bayes.comparison.summary import (
    disagreements,
    means_of_ten,
    notes,
    percentage_counts,
    verdict_counts,
)
from cpam_bayes.paper import percentage_checks, printed_table

_CSV = (
    *("table", "part", "specimen", "source", "quantity", "printed", "ours", "difference_percent"),
    *("q025", "q975", "verdict"),
)


def document(result: PaperResult) -> dict[str, Any]:
    """The JSON document of `paper`."""
    return {
        "command": result.command,
        "version": __version__,
        "seed": result.seed,
        "quick": result.quick,
        "tables": [
            {
                "table": number,
                "title": printed_table(number).title,
                "verdicts": verdict_counts(result.rows, number),
                "percentages": percentage_counts(number),
            }
            for number in result.numbers
        ],
        "rows": [_row(row) for row in result.rows],
        "disagreements": list(disagreements(result)),
        "audit": {
            "misprints": list(notes(result)),
            "means_of_ten": means_of_ten(result) or None,
            "percentages": [
                {
                    "table": check.table,
                    "specimen": check.row.specimen,
                    "source": check.row.source,
                    "quantity": check.column,
                    "printed_percent": float(check.printed),
                    "recomputed_percent": check.recomputed,
                    "possible_percent": [check.lowest, check.highest],
                    "agreement": check.agreement,
                }
                for number in result.numbers
                for check in percentage_checks(number)
            ],
            "misfits": [asdict(misfit) for misfit in result.misfits],
        },
        "hadamard": [{**asdict(w), "exists": w.exists, "unique": w.is_unique} for w in result.well_posed],
        "simulation": [asdict(error) for error in result.simulation_errors],
        "costs": [{**asdict(cost), "calculix_hours": cost.calculix_hours} for cost in result.costs],
        "computed": {task: dict(record) for task, record in result.computed.items()},
        "seconds": result.seconds,
        "warnings": list(result.warnings),
    }


def csv_text(result: PaperResult) -> str:
    """One line for each printed value."""
    sheet = io.StringIO()
    writer = csv.DictWriter(sheet, _CSV, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    for row in result.rows:
        cells = _row(row)
        if isinstance(row.ours, tuple):
            cells["ours"] = "/".join(f"{angle:g}" for angle in row.ours)
        writer.writerow({key: "" if value is None else value for key, value in cells.items()})
    return sheet.getvalue()


def _row(row: Row) -> dict[str, Any]:
    try:
        printed: float | str = float(row.printed)
    except ValueError:
        printed = row.printed
    ours = list(row.ours) if isinstance(row.ours, tuple) else row.ours
    return {
        "table": row.table,
        "part": row.part,
        "specimen": row.specimen,
        "source": row.source,
        "quantity": row.quantity,
        "printed": printed,
        "printed_text": row.printed,
        "ours": ours,
        "difference_percent": row.difference_percent,
        "q025": row.q025,
        "q975": row.q975,
        "verdict": row.verdict,
        "details": dict(row.details),
    }
