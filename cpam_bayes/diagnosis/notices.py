"""Every reason not to trust a diagnosis as it stands."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cpam_bayes.answer import Notice, each_once
from cpam_bayes.diagnosis.cases import differing_priors
from cpam_bayes.diagnosis.diagnose import Diagnosis
from cpam_bayes.diagnosis.hypotheses import NONE
from cpam_bayes.forward_model.labels import shape_notices
from cpam_bayes.forward_model.preconditions import count_notices
from cpam_bayes.inference.assessment import cut_notices

# A predictive p-value this far out says that noise alone does not explain the residuals.
_P_LOW = 0.02
# Fraction of the cases in which the claimed cause must stay ahead without one frequency.
_STABLE = 0.8
# Importance sampling whose standard error of a log evidence is above this is warned of, nats.
_ROUGH = 0.3
# Probability of sets that were not weighed from which it is said.
_UNWEIGHED = 0.01


def diagnosis_notices(d: Diagnosis) -> tuple[Notice, ...]:
    """Every reason not to trust a diagnosis as it stands."""
    material = d.cases[0].models.specimen.material
    fit = d.baseline if d.extended is None else d.extended
    draws = dict(zip(fit.constants, fit.draws.T, strict=True))
    unknowns = _unknowns(d) & set(d.baseline.constants)
    return (
        *count_notices(len(d.baseline.measured), len(unknowns)),
        *_of_residuals(d),
        *cut_notices(material, draws),
        *_of_leaving_out(d),
        *([_of_optima(d)] if d.optima else []),
        *each_once(n for case in d.cases for n in shape_notices(case.by_shape, case.measurement, "best")),
        *_of_priors(d),
        *_of_evidences(d),
    )


def _of_residuals(d: Diagnosis) -> Iterator[Notice]:
    if d.claim.kind == NONE and d.baseline.predictive_p < _P_LOW:
        inferred = d.weighed.none.marginal.comparison.noise is not None
        yield Notice("unexplained_by_none", facts={"p": d.baseline.predictive_p, "inferred": inferred})
    if d.extended is not None and d.extended.predictive_p < _P_LOW:
        yield Notice("unexplained_by_claim", facts={"p": d.extended.predictive_p})


def _of_leaving_out(d: Diagnosis) -> Iterator[Notice]:
    if d.gain is not None and d.gain.stable < _STABLE:
        yield Notice("single_frequencies", facts={"stable": d.gain.stable})


def _of_priors(d: Diagnosis) -> Iterator[Notice]:
    names = differing_priors(d.cases)
    if names:
        yield Notice("differing_priors", facts={"names": names, "taken": d.cases[0].name})


def _of_evidences(d: Diagnosis) -> Iterator[Notice]:
    rough = max((t.marginal.error for t in d.weighed.tested if np.isfinite(t.marginal.error)), default=0.0)
    if rough > _ROUGH:
        yield Notice("rough_evidences", facts={"error": float(rough)})
    if d.weighed.unaccounted > _UNWEIGHED:
        yield Notice("unweighed_sets", facts={"probability": d.weighed.unaccounted})


def _unknowns(d: Diagnosis) -> set[str]:
    return {name for case in d.cases for name in case.models.specimen.unknowns.names}


def _of_optima(d: Diagnosis) -> Notice:
    """Several optima, and the measured mode shapes that would decide between the first two."""
    first, second = d.optima[:2]
    apart = {
        n: second.constants[n] / v - 1.0 for n, v in first.constants.items() if v and n in second.constants
    }
    name = max(apart, key=lambda n: abs(apart[n]))
    swapped = None
    for i, k, a, b in first.differences(second)[:1]:
        swapped = {"plate": d.cases[i].name if len(d.cases) > 1 else "", "frequency": k + 1, "modes": (a, b)}
    return Notice(
        "several_optima",
        facts={
            "count": len(d.optima),
            "fractions": tuple(o.fraction for o in d.optima[:2]),
            "constant": name,
            "apart": abs(apart[name]),
            "swapped": swapped,
        },
    )
