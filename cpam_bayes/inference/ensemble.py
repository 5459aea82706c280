"""Ensemble sampling by emcee, started from the particle swarm: independent ensembles in parallel rounds.

Sampling ends when the ensembles agree (R-hat) and hold enough effective samples, or at a budget. A run that
was killed resumes from its last stored round, bit-identical to an uninterrupted one; a stored round that was
damaged is set aside and sampled again.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np

from cpam_bayes.inference.importance import Proposal, about_optima
from cpam_bayes.inference.laplace import POLISHED, find_optima
from cpam_bayes.inference.posterior import Posterior
from cpam_bayes.mechanics.problem import Array
from cpam_bayes.parameters import ParameterSet
from cpam_bayes.running import cut_short, is_time_up
from cpam_bayes.storage import ARRAYS, read_arrays, write_arrays

# Window over the autocorrelation time.
_WINDOW = 5.0
# Most optima about which walkers start, and redraws of walkers outside the constraints.
_MOST_OPTIMA, _MOST_REDRAWN = 4, 20


def integrated_times(chain: Array) -> Array:
    """Autocorrelation time (n,), steps, of every parameter of a chain (steps, walkers, n).

    tau = 1 + 2 sum_k rho(k) up to the first lag that is at least five times tau (Sokal, 1996), with the
    autocovariance averaged over the walkers (Goodman and Weare, 2010). Deviations are taken from the mean of
    the whole ensemble: from each walker's own mean, as in emcee, tau is too low by 2 window tau / steps.

    nan where a walker does not move. Where no lag is long enough, the largest sum, a lower bound of tau.
    """
    steps = len(chain)
    size = 1 << (2 * steps - 1).bit_length()  # zeros beyond the chain: no lag wraps round
    frequency = np.fft.rfft(chain - chain.mean(axis=(0, 1)), n=size, axis=0)
    covariance = np.fft.irfft(np.abs(frequency) ** 2, n=size, axis=0)[:steps].mean(axis=1)
    found = np.full(chain.shape[2], np.nan)
    for i in np.flatnonzero(np.all(np.ptp(chain, axis=0) > 0.0, axis=0)):
        sums = 2.0 * np.cumsum(covariance[:, i] / covariance[0, i]) - 1.0
        long_enough = np.arange(steps) >= _WINDOW * sums
        found[i] = sums[np.argmax(long_enough)] if long_enough.any() else sums.max()
    return found


class StoreError(ValueError):
    """A store that cannot be used: of another problem or version, damaged, or not to be written."""


class Rounds:
    """Store of the finished rounds of one problem in a directory; a round of another problem is refused.

    Raises ``StoreError`` where the directory cannot be made, or holds rounds of an earlier version.
    """

    def __init__(self, directory: Path, key: str) -> None:
        self.directory, self.key = directory, key
        try:
            directory.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StoreError(f"store {directory}: cannot be made: {error.strerror}") from error
        self._refuse_earlier_rounds()

    def path(self, i: int) -> Path:
        """Path of the file of a round."""
        return self.directory / f"round_{i:04d}{ARRAYS}"

    def read(self, i: int) -> tuple[Array, Array, list[Any]] | None:
        """A stored round; ``None`` if it was not finished, or is damaged and was set aside.

        Raises ``StoreError`` for a round of another problem, and one that cannot be read.
        """
        import emcee

        path = self.path(i)
        try:
            stored = read_arrays(path)
        except OSError as error:
            raise StoreError(f"store {path}: cannot be read: {error.strerror}") from error
        if stored is None:
            return None
        if str(stored.get("problem")) != self.key:
            raise StoreError(
                f"store {path}: holds another problem (plate, priors, data, settings, seed "
                "or version differ); choose another directory or remove it"
            )
        chain, log_prob = stored["chain"], stored["log_prob"]
        states = [
            emcee.State(
                chain[e, -1],
                log_prob=log_prob[e, -1],
                random_state=(
                    "MT19937",
                    stored["random_keys"][e],
                    int(stored["random_position"][e]),
                    int(stored["random_has_gauss"][e]),
                    float(stored["random_gauss"][e]),
                ),
            )
            for e in range(len(chain))
        ]
        return chain, log_prob, states

    def write(self, i: int, chain: Array, log_prob: Array, states: list[Any]) -> str | None:
        """Store a round; returns a message if it could not be stored."""
        random = [s.random_state for s in states]
        arrays = {
            "problem": np.array(self.key),
            "chain": chain,
            "log_prob": log_prob,
            "random_keys": np.stack([r[1] for r in random]),
        }
        for k, name in ((2, "position"), (3, "has_gauss"), (4, "gauss")):
            arrays[f"random_{name}"] = np.array([r[k] for r in random])
        path = self.path(i)
        try:
            write_arrays(path, arrays)
        except OSError as error:
            return (
                f"store {path}: cannot be written ({error.strerror or error}); {i} rounds before it are kept "
                "and the same command goes on from there, those from it on are in this answer alone"
            )
        return None

    def _refuse_earlier_rounds(self) -> None:
        earlier = sorted(self.directory.glob("round_*.h5"))
        if earlier:
            raise StoreError(
                f"store {self.directory}: holds rounds of an earlier version ({earlier[0].name} and on), "
                "which this one cannot go on from and leaves alone; choose another directory"
            )


class Density(Protocol):
    """The target of the sampler: log probabilities of parameter vectors."""

    @property
    def parameters(self) -> ParameterSet:
        """Parameters in the order of the vectors."""
        ...

    def log_prob(self, x: Array) -> Array:
        """Log probability (m,) of vectors (m, n) up to a constant, -inf outside the support."""
        ...


@dataclass(frozen=True, slots=True)
class EnsembleSettings:
    """Settings of the ensemble sampler.

    ensembles, walkers : independent ensembles and walkers in each.
    round_steps : steps between two checks of the chains.
    r_hat, effective : largest R-hat and fewest effective draws of converged chains.
    most_steps : the budget.
    lengths : least length of a chain in autocorrelation times: a time is known to sqrt(20 / (lengths
    walkers)) (Sokal, 1996).
    jumps : share of the steps that jump to draws of a proposal, where there is one.
    """

    ensembles: int = 2
    walkers: int = 100
    round_steps: int = 100
    r_hat: float = 1.01
    effective: float = 1000.0
    most_steps: int = 10_000
    lengths: float = 10.0
    jumps: float = 0.5


DEFAULT_SETTINGS = EnsembleSettings()


@dataclass(frozen=True, slots=True)
class Diagnostics:
    """State of the chains, the worst over the parameters.

    autocorrelation_time : steps; where unknown, the number of all steps, so that no chain is long enough.
    """

    r_hat: float
    ess_bulk: float
    autocorrelation_time: float
    converged: bool
    steps: int
    burn_in: int


@dataclass(frozen=True, slots=True)
class EnsembleResult:
    """Chains of all ensembles after burn-in.

    chain : (ensembles, steps, walkers, n).
    log_prob : (ensembles, steps, walkers).
    solves : forward solves of all steps and of the fit of the proposal.
    not_stored : why rounds are missing in the store, ``None`` if none are.
    """

    chain: Array
    log_prob: Array
    diagnostics: Diagnostics
    status: Literal["converged", "budget"]
    solves: int
    not_stored: str | None = None

    @property
    def draws(self) -> Array:
        """All draws in one list, (n_draws, n)."""
        return self.chain.reshape(-1, self.chain.shape[-1])


def start_positions(
    posterior: Posterior, swarm: Array, values: Array, n: int, rng: np.random.Generator
) -> Array:
    """Walker positions (n, n_parameters) about the optima that a swarm found.

    The swarm's distinct personal bests, the best first, are refined to optima of the posterior. Walkers are
    shared among these by their mass, by Laplace's method. Raises ``ValueError`` where no particle is in the
    support of the prior.

    swarm : (m, n_plate) personal bests.
    values : (m,) their misfits.
    """
    scores = posterior.scores
    starts = scores.to_z(_unlike(posterior, swarm, values))
    optima = find_optima(posterior, starts, log2_draws=0, settings=POLISHED)
    proposal = Proposal(scores, about_optima(optima).alone())
    found, missing = np.empty((n, posterior.parameters.size)), np.arange(n)
    for _ in range(_MOST_REDRAWN):
        found[missing] = proposal.draw(len(missing), rng)
        missing = missing[~np.isfinite(posterior.log_prob(found[missing]))]
        if not len(missing):
            return found
    # near a constraint of the material: ever closer to the best optimum, which satisfies it
    best, near = scores.to_x(optima.z[0]), 0.5
    while len(missing):
        found[missing] = best + near * (proposal.draw(len(missing), rng) - best)
        missing = missing[~np.isfinite(posterior.log_prob(found[missing]))]
        near = max(0.9 * near, 1e-3)
    return found


def _unlike(posterior: Posterior, swarm: Array, values: Array) -> Array:
    """The best distinct personal bests of a swarm as parameters (k, n) of a posterior."""
    parameters = posterior.parameters
    order = np.argsort(values, kind="stable")
    order = order[np.isfinite(values[order])]
    starts: list[Array] = []
    for i in order:
        x = np.clip(swarm[i], parameters.lower[: swarm.shape[1]], parameters.upper[: swarm.shape[1]])
        if posterior.noise_is_inferred:
            x = np.append(x, _noise_of(posterior, x[None]))
        far = all(np.linalg.norm((x - s) / parameters.prior_sd) > 0.3 for s in starts)
        if far and np.isfinite(posterior.log_prob(x[None])[0]):
            starts.append(x)
        if len(starts) == _MOST_OPTIMA:
            break
    if not starts:
        raise ValueError(
            "chains cannot start: no particle of the swarm is within the bounds and the constraints (9)"
        )
    return np.array(starts)


def _noise_of(posterior: Posterior, x: Array) -> float:
    """Noise amplitude suggested by the residuals at a particle (1, n_plate)."""
    f = posterior.measurement.frequencies
    predicted = posterior.predict(x)[0]
    nearest = predicted[np.abs(predicted[None, :] - f[:, None]).argmin(axis=1)]
    paired = predicted[: len(f)] if posterior.measurement.complete else nearest
    return posterior.noise_model.suggested(paired - f)


def problem_hash(posterior: Posterior, at: Array) -> str:
    """Hash of a posterior: names, priors, data and the log probability at some vectors (m, n)."""
    own = posterior.measurement
    parts = [
        posterior.parameters.names,
        [repr(p.prior) for p in posterior.parameters.parameters],
        own.frequencies.tolist(),
        own.resolution,
        own.relative_std,
        None if own.frequency_sd is None else own.frequency_sd.tolist(),
        own.complete,
        own.labels,
        posterior.degrees_of_freedom,
        posterior.log_prob(at).tolist(),
    ]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:32]


def chain_hash(
    posterior: Posterior,
    start: Array,
    settings: EnsembleSettings,
    seed: int,
    proposal: Proposal | None = None,
) -> str:
    """Hash of all inputs of a chain: the posterior, its start, settings, seed and proposal."""
    flat = start.reshape(-1, start.shape[-1])
    parts = [
        problem_hash(posterior, flat),
        flat.tolist(),
        [settings.ensembles, settings.walkers, settings.round_steps, settings.jumps],
        seed,
        None if proposal is None else proposal.log_density(flat).tolist(),
    ]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:32]


def sample(
    posterior: Posterior,
    start: Array,
    seed: int,
    settings: EnsembleSettings = DEFAULT_SETTINGS,
    *,
    proposal: Proposal | None = None,
    store: Path | None = None,
    progress: Callable[[Diagnostics], None] = lambda diagnostics: None,
) -> EnsembleResult:
    """Sample a posterior until the ensembles agree or the budget ends.

    start : (ensembles, walkers, n).
    proposal : covers the posterior; without one there are local moves only.
    store : a directory for the rounds; stored rounds of the same problem, proposal included, are resumed,
    those of another one raise ``StoreError``. A round that cannot be written ends the storing but not the
    sampling: the result says so. ``progress`` is called with the diagnostics after each round.

    Moves: differential evolution (ter Braak, 2006), nine in ten with the usual factor, one in ten with factor
    1, which jumps between separate optima; mixed with them, Metropolis-Hastings jumps to independent draws of
    a proposal (Tierney, 1994), fixed before the chains begin.
    """
    key = chain_hash(posterior, start, settings, seed, proposal)
    rounds = Rounds(store, key) if store is not None else None
    return sample_density(
        posterior, start, seed, settings, proposal=proposal, rounds=rounds, progress=progress
    )


def sample_density(
    density: Density,
    start: Array,
    seed: int,
    settings: EnsembleSettings = DEFAULT_SETTINGS,
    *,
    proposal: Proposal | None = None,
    rounds: Rounds | None = None,
    progress: Callable[[Diagnostics], None] = lambda diagnostics: None,
) -> EnsembleResult:
    """Sample any density as ``sample`` does a posterior; rounds : of the store, if there is one."""
    samplers = [_sampler(density, settings, proposal) for _ in range(settings.ensembles)]
    states = [_state(start[e], density, seed, e) for e in range(settings.ensembles)]
    chains: list[Array] = []
    log_probs: list[Array] = []
    not_stored: str | None = None
    while True:
        i = len(chains)
        stored = rounds.read(i) if rounds is not None and not_stored is None else None
        if stored is None:
            pieces = [
                _advance(s, state, settings.round_steps) for s, state in zip(samplers, states, strict=True)
            ]
            chain, log_prob = (np.stack([p[k] for p in pieces]) for k in (0, 1))
            states = [p[2] for p in pieces]
            if rounds is not None and not_stored is None:
                not_stored = rounds.write(i, chain, log_prob, states)
        else:
            chain, log_prob, states = stored
        chains.append(chain)
        log_probs.append(log_prob)
        found = diagnose_chains(np.concatenate(chains, axis=1), settings)
        progress(found)
        ended = is_time_up() and not found.converged
        if ended:
            cut_short("cut_chains", done=found.steps, of=settings.most_steps)
        if found.converged or found.steps >= settings.most_steps or ended:
            return EnsembleResult(
                np.concatenate(chains, axis=1)[:, found.burn_in :],
                np.concatenate(log_probs, axis=1)[:, found.burn_in :],
                found,
                "converged" if found.converged else "budget",
                start[..., 0].size * found.steps + (0 if proposal is None else proposal.solves),
                not_stored,
            )


def diagnose_chains(chain: Array, settings: EnsembleSettings) -> Diagnostics:
    """Convergence of chains (ensembles, steps, walkers, n), the worst over the parameters.

    R-hat is that of the split halves of whole ensembles: walkers of one ensemble are not independent
    (Gelman and Rubin, 1992; Vehtari et al., 2021, without rank normalisation). The effective
    number of samples is the number of draws over the integrated autocorrelation time (Goodman and
    Weare, 2010), estimated from the second halves of the chains; five such times are left out as burn-in.
    If a walker does not move the time is unknown, and the chains count as not converged.
    """
    steps = chain.shape[1]
    half = chain[:, steps // 2 :]
    tau = np.max([integrated_times(e) for e in half], axis=0)
    worst = float(np.max(tau)) if np.all(np.isfinite(tau)) else float(steps)
    burn_in = min(int(np.ceil(5.0 * worst)), steps // 2)
    kept = chain[:, burn_in:]
    n_draws = kept.shape[0] * kept.shape[1] * kept.shape[2]
    r_hat = float(np.max(_split_r_hat(kept)))
    ess = n_draws / worst
    long_enough = kept.shape[1] >= settings.lengths * worst
    converged = bool(long_enough and r_hat <= settings.r_hat and ess >= settings.effective)
    return Diagnostics(r_hat, ess, worst, converged, steps, burn_in)


def _split_r_hat(chain: Array) -> Array:
    """R-hat (n,) of every parameter over the halves of ensembles, infinite for chains of one step."""
    n_ensembles, steps, walkers, n = chain.shape
    half = steps // 2
    if not half:
        return np.full(n, np.inf)
    parts = chain[:, : 2 * half].reshape(n_ensembles * 2, half * walkers, n)
    within = parts.var(axis=1, ddof=1).mean(axis=0)
    between = parts.mean(axis=1).var(axis=0, ddof=1)
    return np.asarray(np.sqrt(1.0 + between / within))


def moves_of(proposal: Proposal | None, jumps: float) -> list[tuple[Any, float]]:
    """Moves of emcee and their shares: jumps to draws of a proposal q, where there is one, and local moves.

    A jump from x to a draw y of q is accepted with the probability min(1, p(y) q(x) / (p(x) q(y))).
    """
    import emcee

    local = [(emcee.moves.DEMove(), 0.9), (emcee.moves.DEMove(gamma0=1.0), 0.1)]
    if proposal is None:
        return local

    def jump(x: Array, rng: np.random.RandomState) -> tuple[Array, Array]:
        new = proposal.draw(len(x), rng)
        return new, proposal.log_density(x) - proposal.log_density(new)

    return [(emcee.moves.MHMove(jump), jumps), *((move, (1.0 - jumps) * share) for move, share in local)]


def _sampler(density: Density, settings: EnsembleSettings, proposal: Proposal | None) -> Any:
    import emcee

    moves = moves_of(proposal, settings.jumps)
    n = density.parameters.size
    sampler = emcee.EnsembleSampler(settings.walkers, n, density.log_prob, moves=moves, vectorize=True)
    # emcee wraps the function to print all parameters of a call that fails or is interrupted
    sampler.log_prob_fn = density.log_prob
    return sampler


def _state(start: Array, density: Density, seed: int, ensemble: int) -> Any:
    import emcee

    words = np.random.SeedSequence([seed, ensemble]).generate_state(624)
    random_state = np.random.RandomState(words).get_state()
    return emcee.State(start, log_prob=density.log_prob(start), random_state=random_state)


def _advance(sampler: Any, state: Any, steps: int) -> tuple[Array, Array, Any]:
    """One round of one ensemble: chain (steps, walkers, n), log probabilities, final state."""
    sampler.reset()
    end = sampler.run_mcmc(state, steps, skip_initial_state_check=True)
    return sampler.get_chain().copy(), sampler.get_log_prob().copy(), end
