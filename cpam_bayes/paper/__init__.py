"""The paper's tables as data, with what can be checked of them from their own digits."""

from cpam_bayes.paper.disorder import (
    Contradiction,
    DisorderTable,
    PrintedConstant,
    contradictions,
    disorder_table,
)

__all__ = ["Contradiction", "DisorderTable", "PrintedConstant", "contradictions", "disorder_table"]
