"""A hypothesis that was tested, with its marginal likelihood."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cpam_bayes.diagnosis.evidence.comparison import Comparison
from cpam_bayes.diagnosis.evidence.marginal import Marginal
from cpam_bayes.diagnosis.evidence.shifts import ShiftTable
from cpam_bayes.diagnosis.fitting import PlateCase, effect_columns
from cpam_bayes.diagnosis.hypotheses import Hypothesis


@dataclass(frozen=True, slots=True)
class Tested:
    """One hypothesis with its marginal likelihood; of an incomplete list, with one of its pairings.

    plates : numbers of the plates that have it; all of them where they share it
    probability : among all that were tested
    log_bayes_factor : against none
    shift : of the log frequencies, with the constants of the plain model; ``None`` where the list is paired
        otherwise
    cases : the plates with the pairing of incomplete lists; none where all lists are complete
    as_plain : the hypothesis with the plain model's most probable pairing; ``None`` where lists are complete
    """

    hypothesis: Hypothesis
    plates: tuple[int, ...]
    marginal: Marginal
    probability: float = 0.0
    log_bayes_factor: float = 0.0
    shift: ShiftTable | None = None
    cases: tuple[PlateCase, ...] = ()
    as_plain: Comparison | None = None

    @property
    def columns(self) -> tuple[int, ...]:
        """Columns of the effect's parameters."""
        return effect_columns(self.marginal.comparison, self.hypothesis)

    @property
    def key(self) -> tuple[str, str, tuple[int, ...]]:
        """The same for all pairings of one hypothesis."""
        return (self.hypothesis.cause, self.hypothesis.variant, self.plates)

    @property
    def log_weight(self) -> float:
        """Log of prior times evidence."""
        return float(np.log(self.hypothesis.prior) + self.marginal.log_evidence)


def ranked(tested: Sequence[Tested]) -> list[Tested]:
    """Hypotheses, those with most prior times evidence first."""
    return sorted(tested, key=lambda t: t.log_weight, reverse=True)


def distinct_hypotheses(tested: Sequence[Tested]) -> list[Hypothesis]:
    """Every hypothesis once, whatever the number of its pairings."""
    return list({t.key: t.hypothesis for t in tested}.values())


def prior_of(tested: Sequence[Tested]) -> float:
    """Sum of the priors, every hypothesis counted once."""
    return float(sum(h.prior for h in distinct_hypotheses(tested)))
