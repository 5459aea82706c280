"""Every reason not to trust the probabilities of stacking sequences as they stand."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cpam_bayes.answer import Notice
from cpam_bayes.inference.assessment import cut_notices
from cpam_bayes.stacking.posterior import StackingMixture
from cpam_bayes.stacking.queries import BestFit
from cpam_bayes.stacking.records import OVERLOOKED, StackingPosterior

# Errors, nats, above which a notice is given: of the surrogate's log evidence, and of a computed one.
_ROUGH, _DOUBTFUL = 0.3, 0.3
# Least share of the first class's probability with which an uncertain evidence matters.
_COUNTS = 1e-3
# No sequence explains a list whose residuals have a smaller p-value by noise alone, or whose inferred
# relative noise is larger.
UNEXPLAINED, _NOISY = 1e-3, 0.05
# Difference of emcee and importance sampling, in standard errors, above which a notice is given: the largest
# of a hundred moments of each of twenty classes exceeds it once in hundreds of times.
_DISAGREE = 5.0


def stacking_notices(result: StackingPosterior, mixture: StackingMixture, fit: BestFit) -> tuple[Notice, ...]:
    """Every reason not to trust the probabilities as they stand."""
    n = result.conditional.n_constants
    draws = dict(zip(result.conditional.parameters.names[:n], mixture.parameters.T[:n], strict=True))
    return (
        *_of_fit(result, fit),
        *_of_sums(result),
        *cut_notices(result.specimen.material, draws),
        *_of_chains(mixture),
    )


def _of_sums(result: StackingPosterior) -> Iterator[Notice]:
    check = result.check
    if check is not None and check.rms > _ROUGH:
        yield Notice("rough_surrogate", facts={"rms": check.rms})
    if check is not None and check.overlooked > OVERLOOKED:
        yield Notice("overlooked_sequence", facts={"better": check.overlooked})
    if result.unaccounted > 1e-3:
        yield Notice("sequences_left_out", facts={"probability": result.unaccounted})
    counts = result.probability * result.multiplicity > _COUNTS * result.probability[0]
    doubtful = np.flatnonzero(counts & (result.log_evidence_error > _DOUBTFUL))
    if len(doubtful):
        worst = float(result.log_evidence_error[doubtful].max())
        facts = {"count": len(doubtful), "error": worst, "first": int(doubtful[0]) + 1}
        yield Notice("uncertain_evidences", facts=facts)


def _of_chains(mixture: StackingMixture) -> Iterator[Notice]:
    for c in mixture.sampled:
        number = c.index + 1 if c.index >= 0 else None
        if not c.diagnostics.converged:
            facts = {"number": number, "r_hat": c.diagnostics.r_hat, "ess_bulk": c.diagnostics.ess_bulk}
            yield Notice("sequence_chains", facts=facts)
        if c.worst_z > _DISAGREE:
            yield Notice("sequence_disagrees", facts={"number": number, "z": c.worst_z})


def _of_fit(result: StackingPosterior, fit: BestFit) -> Iterator[Notice]:
    """Notices that concern all sequences, from the fit of the most probable one."""
    template = result.conditional.template
    complete = template.measurement.complete
    if fit.p_value is not None and fit.p_value < UNEXPLAINED:
        yield Notice("no_sequence_explains", "slip", {"p": fit.p_value, "complete": complete})
    alone = int(np.isnan(fit.predicted).sum())
    if alone:
        facts = {"alone": alone, "of": len(fit.predicted), "complete": complete}
        yield Notice("frequencies_without_mode", facts=facts)
    if template.noise_is_inferred and fit.noise > _NOISY:
        yield Notice("sequence_noise", facts={"noise": fit.noise, "complete": complete})
    if fit.bounds:
        yield Notice("sequence_at_bounds", facts={"bounds": tuple(fit.bounds)})
