"""Behind the answer of `cache` there is nothing."""

from __future__ import annotations

from cpam_bayes.forward_model.stored_models import CacheResult
from cpam_bayes.report.sections import Section


def sections(result: CacheResult) -> tuple[Section, ...]:
    """Nothing beside the counts."""
    del result
    return ()
