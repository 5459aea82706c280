"""Behind the answer of `plates` there is nothing: its list is the answer."""

from __future__ import annotations

from cpam_bayes.forward_model.builtin import BuiltinPlates
from cpam_bayes.report.sections import Section


def sections(result: BuiltinPlates) -> tuple[Section, ...]:
    """Nothing beside the list of the specimens."""
    del result
    return ()
