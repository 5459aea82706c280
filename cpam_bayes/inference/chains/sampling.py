"""From a posterior to converged chains: a swarm on it, the ensembles started from that swarm."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.inference.chains.ensemble import (
    DEFAULT_SETTINGS,
    Diagnostics,
    EnsembleResult,
    EnsembleSettings,
    sample,
    start_positions,
)
from cpam_bayes.inference.posterior import Posterior
from cpam_bayes.inference.proposal import AdaptationSettings, adapted
from cpam_bayes.inference.swarm.pso import SwarmSettings, minimise
from cpam_bayes.threads import single_blas_thread

Array = NDArray[Any]

# Of the proposal that chains jump to: it need not be as good as that of an evidence.
JUMPS = AdaptationSettings()


@single_blas_thread
def sample_posterior(
    posterior: Posterior,
    seed: int,
    *,
    settings: EnsembleSettings = DEFAULT_SETTINGS,
    swarm_settings: SwarmSettings | None = None,
    store: Path | None = None,
    progress: Callable[[Diagnostics], None] = lambda diagnostics: None,
) -> EnsembleResult:
    """Chains of a posterior by emcee, started from a swarm that maximises it.

    Raises ``ValueError`` if no particle is in the support of the prior, ``StoreError`` if the store
    cannot be used.
    """
    bests, values, _ = swarm_on_posterior(posterior, seed, swarm_settings or SwarmSettings())
    return sample_from(posterior, bests, values, seed, settings=settings, store=store, progress=progress)


def sample_from(
    posterior: Posterior,
    bests: Array,
    values: Array,
    seed: int,
    *,
    settings: EnsembleSettings = DEFAULT_SETTINGS,
    store: Path | None = None,
    progress: Callable[[Diagnostics], None] = lambda diagnostics: None,
) -> EnsembleResult:
    """Chains of a posterior by emcee, started from the personal bests of a swarm.

    bests : (m, n_plate) parameters of the plate, without the noise.
    values : (m,) their misfits.

    Raises as ``sample_posterior`` does.
    """
    rng = np.random.default_rng([seed, 1])
    n_walkers = settings.ensembles * settings.walkers
    walkers = start_positions(posterior, bests, values, n_walkers, rng)
    start = walkers.reshape(settings.ensembles, settings.walkers, -1)
    best = walkers[np.argmax(posterior.log_prob(walkers))]
    proposal = adapted(posterior, best[None], seed, JUMPS)
    return sample(posterior, start, seed, settings, proposal=proposal, store=store, progress=progress)


def swarm_on_posterior(posterior: Posterior, seed: int, settings: SwarmSettings) -> tuple[Array, Array, int]:
    """Personal bests of the plate's parameters, their values and the solves of a swarm on -log p."""
    rng = np.random.default_rng(seed)
    n = posterior.model.parameters.size
    swarm = minimise(
        lambda x: -posterior.log_prob(x),
        posterior.parameters.lower,
        posterior.parameters.upper,
        posterior.parameters.sample(rng, settings.particles),
        settings,
        rng,
        feasible=lambda x: np.isfinite(posterior.log_prior(x)),
    )
    return swarm.personal_bests[:, :n], swarm.personal_values, swarm.evaluations
