"""Every reason not to trust the probabilities of stacking sequences as they stand, in sentences."""

from __future__ import annotations

import numpy as np

from cpam_bayes.inference.diagnostics.constraints import cut_warnings
from cpam_bayes.plate import user_name
from cpam_bayes.stacking.mixture import StackingMixture
from cpam_bayes.stacking.queries.best_fit import BestFit
from cpam_bayes.stacking.records import OVERLOOKED, StackingPosterior

# Errors of the surrogate's log evidence and of an exact one that a reader should hear of, nats.
_ROUGH, _DOUBTFUL = 0.3, 0.3
# Share of the probability of the first from which on an uncertain evidence matters.
_COUNTS = 1e-3
# No sequence explains a list whose residuals have a smaller probability by noise alone, or whose noise, where
# it is inferred, is larger, relative.
_UNEXPLAINED, _NOISY = 1e-3, 0.05
# Difference of emcee and importance sampling that a reader should hear of, in standard errors: the largest
# of a hundred moments of each of twenty classes exceeds it once in hundreds of times.
_DISAGREE = 5.0


def stacking_warnings(result: StackingPosterior, mixture: StackingMixture, fit: BestFit) -> tuple[str, ...]:
    """Everything that is a reason not to trust the probabilities as they stand."""
    problems = list(_misfits(result, fit))
    if result.specimen.plate.sd:
        problems.append("[plate.sd] is not counted with: sizes, density and mass are taken as exact")
    check = result.check
    if check is not None and check.rms > _ROUGH:
        problems.append(
            f"the log evidence of the surrogate is {check.rms:.2f} off (root mean square over draws from the "
            "posterior): the number of sequences in the credible set and the marginals are rough; the "
            "evidences of the sequences listed are computed without it"
        )
    if check is not None and check.overlooked > OVERLOOKED:
        problems.append(
            f"a sequence drawn from the posterior is better by {check.overlooked:.1f} in log evidence than "
            "every one listed: the list of the most probable sequences is not complete"
        )
    if result.unaccounted > 1e-3:
        problems.append(
            f"sequences with up to {result.unaccounted:.2g} of the probability were left out of the sums"
        )
    counts = result.probability * result.multiplicity > _COUNTS * result.probability[0]
    doubtful = np.flatnonzero(counts & (result.log_evidence_error > _DOUBTFUL))
    if len(doubtful):
        problems.append(
            f"the log evidence of {len(doubtful)} listed sequences is uncertain by up to "
            f"{result.log_evidence_error[doubtful].max():.2f}, first number {doubtful[0] + 1}"
        )
    constants = dict(zip(result.conditional.parameters.names, mixture.parameters.T, strict=True))
    problems += cut_warnings(result.specimen.material, constants)
    for c in mixture.sampled:
        name = f"the chains of sequence {c.index + 1}" if c.index >= 0 else "the chains of the given sequence"
        if not c.diagnostics.converged:
            problems.append(
                f"{name} have not converged: R-hat {c.diagnostics.r_hat:.3f}, "
                f"{c.diagnostics.ess_bulk:.0f} effective samples"
            )
        if c.worst_z > _DISAGREE:
            problems.append(
                f"{name} and importance sampling differ by {c.worst_z:.1f} standard errors in a mean or an sd"
            )
    return tuple(problems)


def _misfits(result: StackingPosterior, fit: BestFit) -> tuple[str, ...]:
    """What the fit of the most probable sequence says against all of them."""
    problems = []
    measurement = result.conditional.template.measurement
    advice = "check the list, the plate and the bounds, or ask `diagnose` with a layup that you believe in"
    if measurement.complete:
        advice = f"a mode may be missing (complete = false); {advice}"
    if fit.p_value is not None and fit.p_value < _UNEXPLAINED:
        problems.append(
            "no sequence explains the list: noise as stated leaves residuals like those of the most probable "
            f"one with probability {fit.p_value:.1g}; {advice}"
        )
    alone = int(np.isnan(fit.predicted).sum())
    if alone:
        problems.append(
            f"{alone} of the {len(fit.predicted)} frequencies belong to no mode of the most probable "
            f"sequence; {advice}"
        )
    if result.conditional.template.noise_is_inferred and fit.noise > _NOISY:
        problems.append(
            f"no sequence explains the list well: the noise inferred is {100 * fit.noise:.2g} %; {advice}"
        )
    if fit.bounds:
        ends = ", ".join(f"{user_name(name)} at its {which} bound" for name, which in fit.bounds)
        problems.append(f"given the most probable sequence, {ends}")
    return tuple(problems)
