"""Every reason not to trust a diagnosis as it stands, in sentences."""

from __future__ import annotations

import numpy as np

from cpam_bayes.diagnosis.cases import differing_priors
from cpam_bayes.diagnosis.diagnose import Diagnosis
from cpam_bayes.diagnosis.extension import Resampled
from cpam_bayes.diagnosis.hypotheses import NONE
from cpam_bayes.formatting import listed, significant
from cpam_bayes.forward_model.labels import shape_warnings
from cpam_bayes.inference.diagnostics.constraints import cut_warnings

__all__ = ["diagnosis_warnings"]

# A predictive p-value this far out says that noise alone does not explain the residuals.
_P_LOW = 0.02
# Fraction of the cases in which the claimed cause must stay ahead without one frequency.
_STABLE = 0.8
# Importance sampling whose standard error of a log evidence is above this is warned of, nats.
_ROUGH = 0.3


def diagnosis_warnings(
    d: Diagnosis, resampled: Resampled | None = None, *, emcee: bool = False
) -> tuple[str, ...]:
    """Everything that is a reason not to trust a diagnosis, or its constants by emcee, as they stand.

    emcee : whether it was asked for.
    """
    problems = []
    if emcee and resampled is None:
        problems.append("nothing is claimed, so there is no extended model for emcee to sample")
    n, unknowns = len(d.baseline.measured), len(_unknowns(d) & set(d.baseline.constants))
    if n <= unknowns:
        many = "frequency" if n == 1 else "frequencies"
        problems.append(f"{n} {many} for {unknowns} unknowns: little is left to show what is wrong")
    inferred = d.weighed.none.marginal.comparison.noise is not None
    noise = "any repeatability that is believed" if inferred else "the stated repeatability"
    if d.claim.kind == NONE and d.baseline.predictive_p < _P_LOW:
        problems.append(
            f"predictive p-value {d.baseline.predictive_p:.2g}: the residuals are larger than {noise} "
            "explains, although no cause is more probable than none"
        )
    if d.extended is not None and d.extended.predictive_p < _P_LOW:
        problems.append(
            f"predictive p-value {d.extended.predictive_p:.2g} with the claimed cause: it does not "
            f"explain all of the residuals by {noise}"
        )
    fit = d.baseline if d.extended is None else d.extended
    draws = dict(zip(fit.constants, fit.draws.T, strict=True))
    problems += cut_warnings(d.cases[0].models.specimen.material, draws)
    if d.gain is not None and d.gain.stable < _STABLE:
        problems.append(
            f"the claim holds without one frequency in {100 * d.gain.stable:.0f} % of the cases only: single "
            "frequencies decide it"
        )
    if d.optima:
        problems.append(_of_optima(d))
    for case in d.cases:
        said = shape_warnings(case.by_shape, case.measurement)
        problems += [f"{text}; the most probable pairing is taken" for text in said]
    differing = differing_priors(d.cases)
    if differing:
        problems.append(
            f"the files give {listed(differing, 'and')} different priors ([material], [material.sd] or "
            f"[unknowns]): those of {d.cases[0].name} were taken for all plates; give all files the same"
        )
    rough = max((t.marginal.error for t in d.weighed.tested if np.isfinite(t.marginal.error)), default=0.0)
    if rough > _ROUGH:
        problems.append(
            f"log evidences are known to {significant(float(rough), 2)} only: probabilities are rough"
        )
    if resampled is not None and not resampled.converged:
        problems.append(
            "the chains of the extended model used their budget before they converged: its constants by "
            "emcee are not reliable"
        )
    return tuple(problems)


def _unknowns(d: Diagnosis) -> set[str]:
    return {name for case in d.cases for name in case.models.specimen.unknowns.names}


def _of_optima(d: Diagnosis) -> str:
    """Several optima, and the measured mode shapes that would decide between the first two."""
    first, second = d.optima[:2]
    percent = " and ".join(f"{100 * o.fraction:.0f} %" for o in d.optima[:2])
    apart = {
        n: second.constants[n] / v - 1.0 for n, v in first.constants.items() if v and n in second.constants
    }
    name = max(apart, key=lambda n: abs(apart[n]))
    text = (
        f"{len(d.optima)} optima explain the frequencies, with {percent} of the probability for the first "
        f"two: {name} differs by {100 * abs(apart[name]):.2g} % between them"
    )
    swapped = first.differences(second)
    if not swapped:
        return text
    i, k, a, b = swapped[0]
    plate = f"{d.cases[i].name}: " if len(d.cases) > 1 else ""
    return (
        f"{text}; the order of two modes differs: {plate}frequency {k + 1} is mode {a} by the first and {b} "
        "by the second. Its nodal lines decide: label it under [measurement] labels"
    )
