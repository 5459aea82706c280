"""What a claimed cause is worth: residuals, evidence, predictions of frequencies left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.diagnosis.claim import Claim
from cpam_bayes.diagnosis.evidence.marginal import Marginal, sampled_marginal
from cpam_bayes.diagnosis.evidence.scan import Tested, marginal_of
from cpam_bayes.diagnosis.evidence.weighing import Weighed
from cpam_bayes.diagnosis.fit import Fit
from cpam_bayes.diagnosis.fitting import PlateCase
from cpam_bayes.diagnosis.hypotheses import NONE

Array = NDArray[Any]


@dataclass(frozen=True, slots=True)
class Gain:
    """What the claimed cause is worth.

    log_bayes_factor : of the claimed causes, their variants averaged over their priors
    held_out : (n_f,) log predictive density of each frequency from all others, extended less plain
    stable : fraction of the frequencies without which the claimed cause still is ahead of none and of the
        best outsider
    """

    rms_before: float
    rms_after: float
    log_bayes_factor: float
    held_out: Array
    stable: float

    @property
    def held_out_difference(self) -> float:
        """Sum of the differences."""
        return float(self.held_out.sum())

    @property
    def held_out_se(self) -> float:
        """Standard error of the sum, from the scatter of the differences."""
        n = len(self.held_out)
        return float(np.sqrt(n) * self.held_out.std(ddof=1)) if n > 1 else float("nan")


def gain_of(
    cases: Sequence[PlateCase],
    weighed: Weighed,
    claim: Claim,
    members: Sequence[tuple[Tested, float]],
    baseline: Fit,
    extended: Fit,
    scatter: float,
) -> Gain:
    """The gain of the claimed causes, ``members`` with their fractions, over the plain model."""
    leader = members[0][0]
    claimed = {t.hypothesis.cause for t, _ in members}
    outsider = next(
        (t for t in weighed.tested if t.hypothesis.cause not in (*claimed, NONE, *claim.causes)), None
    )
    n = len(baseline.measured)
    with_cause = left_out(cases, leader, n, weighed.none.marginal, scatter)
    none = left_out(cases, weighed.none, n, None, scatter)
    held_out = (leader.marginal.log_evidence - with_cause) - (weighed.none.marginal.log_evidence - none)
    ahead = with_cause + np.log(leader.hypothesis.prior) > none + np.log(weighed.none.hypothesis.prior)
    if outsider is not None:
        other = left_out(cases, outsider, n, weighed.none.marginal, scatter)
        ahead &= with_cause + np.log(leader.hypothesis.prior) > other + np.log(outsider.hypothesis.prior)
    return Gain(
        baseline.rms,
        extended.rms,
        weighed.log_bayes_factor(claimed),
        held_out,
        float(np.mean(ahead)),
    )


def left_out(cases: Sequence[PlateCase], t: Tested, n: int, none: Marginal | None, scatter: float) -> Array:
    """Log evidences of a hypothesis without each of the frequencies in turn, (n,).

    One that is about the list itself has the evidence of the whole list where the frequency that it
    explains is the one left out.
    """
    evidences = np.full(n, t.marginal.log_evidence)
    first = t.marginal if t.marginal.is_refined and t.marginal.quadrature is not None else None
    listed = t.hypothesis.listed
    before = sum(case.measurement.size for case in cases[: t.plates[0]])  # frequencies of other plates
    for i in range(n):
        if listed.misread is not None and i == before + listed.misread:
            continue
        at = i
        if listed.spurious is not None:
            if i == before + listed.spurious:
                continue
            at = i - (i > before + listed.spurious)
        marginal = marginal_of(
            cases, t.hypothesis, t.plates, scatter=scatter, none=none, left_out=at, screened=first
        )
        evidences[i] = sampled_marginal(marginal).log_evidence
    return evidences
