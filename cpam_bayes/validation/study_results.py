"""What a study found, kept as JSON: written whole, or case by case beside the cases that stay."""

from __future__ import annotations

import json
from collections.abc import Callable, Hashable, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any

Results = dict[str, Any]


def save_results(path: Path, results: Results) -> None:
    """Write the results; raises ``ValueError`` for NaN or infinity, which JSON has not."""
    path.parent.mkdir(exist_ok=True)
    path.write_text(json.dumps(results, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def saved_results(path: Path) -> Results:
    """What was saved before, empty if nothing was."""
    results: Results = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    return results


def with_saved(
    results: Results,
    path: Path,
    order: Sequence[Hashable],
    case_of: Callable[[Results], Hashable] = itemgetter("case"),
) -> Results:
    """The results with the cases that were saved before and not run again.

    Every list among the results holds rows, each of one case; it is merged case by case and brought into
    the given order, in which rows of cases that it lacks are dropped. All else is that of the results.
    """
    saved, place = saved_results(path), {case: i for i, case in enumerate(order)}
    both = dict(results)
    for key, rows in results.items():
        if isinstance(rows, list):
            new = {case_of(row) for row in rows}
            stay = [row for row in saved.get(key, []) if case_of(row) not in new]
            known = [row for row in (*stay, *rows) if case_of(row) in place]
            both[key] = sorted(known, key=lambda row: place[case_of(row)])
    return both
