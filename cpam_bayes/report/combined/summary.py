"""`report` in plain words: what its parts say, each thing once."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from cpam_bayes.combined import FullReport
from cpam_bayes.report.sentences import HIGH_NOISE, plate_argument
from cpam_bayes.report.summary import Summary

FREQUENCIES_ALONE: Final = "from the frequencies alone"
"""What is added to the title of a section whose constants are not those of the summary."""
_TWO_ANSWERS: Final = (
    "The constants of this summary allow for the errors of the plate model that were weighed, each with its "
    "probability; what [material.sd] says of a reference counts as knowledge, and the layup is that of the "
    f"plate file. What is said to be {FREQUENCIES_ALONE} takes the plate model for right and knows of the "
    "constants nothing but the bounds of [unknowns]: its values, its noise and its p-value are others, and "
    "are not the answer."
)


def summary(result: FullReport) -> Summary:
    """The headlines of all parts, the constants with what may be wrong, warnings and next steps."""
    parts = [part.in_words() for part in result.parts]
    *_, diagnosis = parts
    asked = [f"cpam-bayes {part.command}" for part in result.parts]
    steps = _each_once(step for part in (diagnosis, *parts[1:-1]) for step in part.next_steps)
    quick = (
        f"Get the posterior of the constants and a ranking of further tests: cpam-bayes report "
        f"{plate_argument(result.specimen)} --out DIR",
    )
    return Summary(
        title=f"Report on plate {result.title}",
        headline="\n".join(part.headline for part in parts),
        slips=result.slips,
        constants=diagnosis.constants,
        tables=tuple(table for part in parts for table in part.tables),
        basis=(_TWO_ANSWERS, *diagnosis.basis),
        # The diagnosis infers a noise of its own, whose level stands in its headline.
        warnings=_each_once(
            w
            for part in parts
            for w in part.warnings
            if w not in result.slips and not w.startswith(HIGH_NOISE)
        ),
        next_steps=(
            # What a step would ask for is on the page already.
            *(step for step in steps if not any(command in step for command in asked)),
            *(quick if result.quick else ()),
        ),
    )


def _each_once(sentences: Iterable[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(sentences))
