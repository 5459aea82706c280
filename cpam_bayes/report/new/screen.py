"""Behind the answer of `new` there is nothing."""

from __future__ import annotations

from cpam_bayes.forward_model.new_plate import NewPlateResult
from cpam_bayes.report.sections import Section


def sections(result: NewPlateResult) -> tuple[Section, ...]:
    """Nothing beside the file."""
    del result
    return ()
