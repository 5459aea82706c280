"""What a sampled posterior is worth: what determines it, what moves it, and whether it fits its data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.inference.chains.ensemble import EnsembleResult
from cpam_bayes.inference.diagnostics.identifiability import Combination, combinations, paired
from cpam_bayes.inference.diagnostics.power_scaling import (
    MovedBound,
    PowerScaling,
    moved_bounds,
    power_scaling,
)
from cpam_bayes.inference.diagnostics.predictive import (
    ImportanceLeftOut,
    LeftOut,
    importance_leave_one_out,
    leave_one_out,
)
from cpam_bayes.inference.diagnostics.profiles import Profile, profile_likelihoods
from cpam_bayes.inference.pairing import Pairing
from cpam_bayes.inference.posterior import Posterior

Array = NDArray[Any]


@dataclass(frozen=True, slots=True)
class Assessment:
    """What determines a posterior and how it fits, from the draws and from the optimum.

    combinations : best determined first.
    profiles : of the constants.
    power_scaling : of all parameters.
    left_out : in closed form.
    importance : ``None`` where a list may lack modes, whose frequencies do not stand each for itself.
    """

    combinations: tuple[Combination, ...]
    profiles: tuple[Profile, ...]
    power_scaling: tuple[PowerScaling, ...]
    moved_bounds: tuple[MovedBound, ...]
    left_out: LeftOut
    importance: ImportanceLeftOut | None


@dataclass(frozen=True, slots=True)
class ThinnedDraws:
    """Draws one autocorrelation time apart, ensembles as chains.

    step : steps of the chains between two.
    draws : (chains, draws, n).
    log_prob : (chains, draws).
    """

    step: int
    draws: Array
    log_prob: Array

    @property
    def flat(self) -> Array:
        """All draws in one list, (n_draws, n)."""
        return self.draws.reshape(-1, self.draws.shape[-1])


def thinned(result: EnsembleResult) -> ThinnedDraws:
    """Draws of the ensembles, thinned by the autocorrelation time.

    An ensemble is one chain, step by step with all its walkers: these move by each other's positions and are
    no chains of their own, by which R-hat could tell that a sampler has not mixed.
    """
    step = max(1, int(np.ceil(result.diagnostics.autocorrelation_time)))
    chain, log_prob = result.chain[:, ::step], result.log_prob[:, ::step]
    n_ensembles, _, _, n = chain.shape
    return ThinnedDraws(step, chain.reshape(n_ensembles, -1, n), log_prob.reshape(n_ensembles, -1))


def assess(
    posterior: Posterior, result: EnsembleResult, pairing: Pairing, constants: tuple[str, ...]
) -> Assessment:
    """Assess a sampled posterior; ``constants`` are the parameters that have profiles.

    The Jacobian is that at the most probable draw, the noise its median there, since its most probable
    value is too small where few frequencies are left over.
    """
    draws = thinned(result).flat
    best = result.draws[int(result.log_prob.argmax())].copy()
    n_plate = posterior.model.parameters.size
    best[n_plate:] = np.median(draws[:, n_plate:], axis=0)
    predicted = posterior.predict(draws)
    log_likelihood, pointwise = log_likelihoods(posterior, draws, predicted, pairing)
    log_prior = [p.prior.log_density(draws[:, i]) for i, p in enumerate(posterior.parameters.parameters)]
    return Assessment(
        combinations=combinations(posterior, best, pairing),
        profiles=profile_likelihoods(posterior, constants, result.draws, result.log_prob.ravel()),
        power_scaling=power_scaling(
            posterior.parameters.names,
            draws,
            np.sum(log_prior[:n_plate], axis=0),
            np.sum(log_prior[n_plate:], axis=0) + np.zeros(len(draws)),
            log_likelihood,
        ),
        moved_bounds=moved_bounds(posterior.parameters, draws),
        left_out=leave_one_out(posterior, draws, predicted, pairing, best),
        importance=None if pointwise is None else importance_leave_one_out(pointwise),
    )


def log_likelihoods(
    posterior: Posterior, x: Array, predicted: Array, pairing: Pairing
) -> tuple[Array, Array | None]:
    """Log likelihood at x (m, n) with the frequencies predicted there, (m,), and by frequency.

    The latter (m, n_frequencies) is ``None`` where pairings are summed over.
    """
    if not posterior.measurement.complete:
        return posterior.log_likelihood(x), None
    rows, columns = paired(pairing)
    pointwise = posterior.log_density(predicted, posterior.noise(x, predicted))[:, rows, columns]
    return pointwise.sum(axis=1), pointwise
