"""`report` in plain words: what its parts say, each thing once."""

from __future__ import annotations

from collections.abc import Iterable

from cpam_bayes.combined import FullReport
from cpam_bayes.report.sentences import plate_argument
from cpam_bayes.report.summary import Summary


def summary(result: FullReport) -> Summary:
    """The headlines of all parts, the constants with what may be wrong, warnings and next steps."""
    parts = [part.in_words() for part in result.parts]
    asked = [f"cpam-bayes {part.command}" for part in result.parts]
    steps = _each_once(step for part in parts for step in part.next_steps)
    quick = (
        f"Get the posterior of the constants and a ranking of further tests: cpam-bayes report "
        f"{plate_argument(result.specimen)} --out DIR",
    )
    return Summary(
        title=f"Report on plate {result.title}",
        headline=" ".join(part.headline for part in parts),
        slips=result.slips,
        constants=next((part.constants for part in reversed(parts) if part.constants), ()),
        tables=tuple(table for part in parts for table in part.tables),
        basis=_each_once(sentence for part in parts for sentence in part.basis),
        warnings=tuple(w for w in result.warnings if w not in result.slips),
        next_steps=(
            # What a step would ask for is on the page already.
            *(step for step in steps if not any(command in step for command in asked)),
            *(quick if result.quick else ()),
        ),
    )


def _each_once(sentences: Iterable[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(sentences))
