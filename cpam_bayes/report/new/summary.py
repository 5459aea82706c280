"""`new` in plain words."""

from __future__ import annotations

import shlex

from cpam_bayes.forward_model.new_plate import NewPlateResult
from cpam_bayes.report.summary import Summary


def summary(result: NewPlateResult) -> Summary:
    """What was written, what it lacks, and what to do with it."""
    path = shlex.quote(str(result.path))
    lacks = "it can be read as it is" if not result.missing else "it lacks what is listed below"
    return Summary(
        title="new",
        headline=f"The plate file {result.path} is written; {lacks}.",
        basis=(
            *result.missing,
            "The constants and bounds are typical ones of the kind of material, not those of the plate.",
        ),
        next_steps=(
            "Fill in the lines that begin with # where the plate has them, and put the constants of the data "
            "sheet.",
            f"See how the file is understood: cpam-bayes forward {path}",
        ),
    )
