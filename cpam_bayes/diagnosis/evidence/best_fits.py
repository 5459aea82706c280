"""How well a hypothesis can explain the lists at all, whatever its sizes were believed to be."""

from __future__ import annotations

import numpy as np

from cpam_bayes.diagnosis.evidence.marginal import Marginal
from cpam_bayes.inference.derivatives import Expansion
from cpam_bayes.inference.optimise import Array, maximise
from cpam_bayes.inference.standard_normal import MAX_SCORE
from cpam_bayes.threads import single_blas_thread

# Fraction of the priors' weight that is kept: scores that nothing determines stay where they are.
_KEPT = 1e-3
# Optima and draws of the posterior that the search begins from.
_OPTIMA, _DRAWS = 4, 4


@single_blas_thread
def best_log_likelihood(marginal: Marginal) -> float:
    """The largest log likelihood within the bounds of the priors, noise and discrepancy at their priors.

    What a prior says of constants and sizes is left out, so that hypotheses are compared by what the data
    can tell of them.
    """
    comparison = marginal.comparison
    n, n_model = comparison.parameters.size, comparison.model.parameters.size
    weight = np.where(np.arange(n) < n_model, 1.0 - _KEPT, 0.0)

    def target(z: Array, rows: Array) -> Expansion:
        del rows
        e = comparison.expand(z)
        return Expansion(
            e.value + 0.5 * np.sum(weight * z**2, axis=1),
            e.gradient + weight * z,
            e.curvature - np.diag(weight),
        )

    draws = comparison.scores.to_z(marginal.resampled(_DRAWS))
    start = np.concatenate((marginal.z[:_OPTIMA], draws))
    bound = np.full(n, MAX_SCORE)
    maxima = maximise(target, start, -bound, bound, most_steps=30, promised=1e-2)
    best = maxima.u[
        int(np.argmax(np.where(np.isfinite(maxima.expansion.value), maxima.expansion.value, -np.inf)))
    ]
    log_prior = -0.5 * float(np.sum(best[n_model:] ** 2))
    return float(comparison.log_likelihood(comparison.scores.to_x(best[None]))[0]) + log_prior
