"""Simulation-based calibration: whether the posterior is right when nature is as the model says.

Talts, Betancourt, Simpson, Vehtari and Gelman (2018): parameters are drawn from the prior, a list of
frequencies is simulated at them, its posterior is sampled as for any other list, and the true value
is ranked among nearly independent draws. Over many repetitions the ranks are uniform if prior,
likelihood and sampler are all right.

The simulated lists follow the model of the posterior: frequencies of the same forward model, every
one scattered independently with variance (s f)^2 + resolution^2 / 12 + (e f)^2, rounding being the
Gaussian that the likelihood takes it for. A list is not sorted after that: a complete list is paired
with the modes by position. One difference is left: f is the mode's frequency here and the listed one
in the likelihood, a relative shift of the modes by 2 s^2, or of 2 s sqrt(n_modes) standard deviations
of a common factor: 0.05 at the noise of 1 % that the prior expects.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.forward_model.reduced import DEFAULT_SETTINGS as REDUCTION
from cpam_bayes.forward_model.store import reduced_model
from cpam_bayes.inference.chains.ensemble import EnsembleResult, EnsembleSettings
from cpam_bayes.inference.chains.sampling import sample_posterior
from cpam_bayes.inference.posterior import ForwardModel, Posterior, plate_posterior
from cpam_bayes.inference.swarm.pso import SwarmSettings
from cpam_bayes.parallel import run
from cpam_bayes.plate import Measurement, read_specimen
from cpam_bayes.validation.draw_store import DrawStore

Array = NDArray[Any]

# Draws that a true value is ranked among: its rank is one of a hundred.
N_DRAWS = 99
# Shorter than what an identification needs: a rank asks for a hundred draws, not for the tails.
SETTINGS = EnsembleSettings(walkers=40, round_steps=80, r_hat=1.05, effective=2.0 * N_DRAWS, most_steps=3000)


@dataclass(frozen=True, slots=True)
class Nature:
    """What frequencies come from: a forward model and its own relative errors (n_modes,)."""

    model: ForwardModel
    solver_error: Array


class Source(Protocol):
    """Makes a nature in whichever process needs it; equal sources make equal ones."""

    def __call__(self) -> Nature:
        """The model and its error."""
        ...

    def __hash__(self) -> int:
        """Of what it is made from: a process makes each nature once."""
        ...


@dataclass(frozen=True, slots=True)
class PlateSource:
    """The reduced model of a plate, from the cache on disk where it is there.

    plate : name of a built-in specimen or path of a plate file.
    n_modes : frequencies in a list.
    """

    plate: str
    n_modes: int

    def __call__(self) -> Nature:
        """The reduced model over the specimen's unknowns, its error that of an identification."""
        specimen = read_specimen(self.plate)
        model = reduced_model(specimen, specimen.unknowns, self.n_modes)
        return Nature(model, np.hypot(model.full.error, REDUCTION.tolerance))


@dataclass(frozen=True, slots=True)
class Experiment:
    """What every repetition does.

    source : of the frequencies.
    resolution : Hz.
    relative_std : of the noise, ``None`` to draw it from its prior and infer it.
    seed : of all repetitions; each depends on it and on its own number alone.
    """

    source: Source
    resolution: float
    relative_std: float | None
    seed: int
    settings: EnsembleSettings = SETTINGS
    swarm: SwarmSettings = field(default_factory=SwarmSettings)


@dataclass(frozen=True, slots=True)
class Repetition:
    """One repetition: the truth and where it lies in its posterior.

    truth : parameters, SI, the noise last where it is inferred.
    ranks : of the true values among ``N_DRAWS`` nearly independent draws.
    below : shares of all draws kept that lie below them.
    ordered : whether the noise left the list in ascending order.
    """

    number: int
    truth: tuple[float, ...]
    ranks: tuple[int, ...]
    below: tuple[float, ...]
    ordered: bool
    converged: bool
    r_hat: float
    autocorrelation_time: float
    effective: float
    steps: int


def calibrate(
    experiment: Experiment,
    repetitions: int,
    *,
    store: Path | None = None,
    executor: Executor | None = None,
    batch_size: int | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> tuple[Repetition, ...]:
    """Repetitions 0 to n - 1 of an experiment, in order, the same bit for bit whoever computes them.

    store : a file of JSON lines that takes every repetition as it ends; one of the same experiment is
    gone on with, one of another raises ``StoreError``. ``progress`` is called with the number done.
    """
    _nature(experiment.source)  # builds what workers then find in the cache on disk
    kept = DrawStore.open(store, experiment_hash(experiment)) if store is not None else None
    done = {r["number"]: _repetition(r) for r in kept.records} if kept is not None else {}

    def take(repetition: Repetition) -> None:
        if kept is not None:
            kept.append(asdict(repetition))
        done[repetition.number] = repetition
        progress(len(done))

    missing = [i for i in range(repetitions) if i not in done]
    if missing:
        run(
            repeat,
            experiment,
            missing,
            executor,
            batch_size=batch_size,
            on_result=lambda index, found: take(found),
        )
    return tuple(done[i] for i in range(repetitions))


def _repetition(record: dict[str, Any]) -> Repetition:
    fields: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in record.items()}
    return Repetition(**fields)


def repeat(experiment: Experiment, number: int) -> Repetition:
    """One repetition: draw, simulate, sample, rank."""
    nature = _nature(experiment.source)
    rng = np.random.default_rng([experiment.seed, number])
    truth, measurement = simulate(experiment, nature, rng)
    posterior = plate_posterior(nature.model, measurement, nature.solver_error)
    sampler_seed = int(rng.integers(2**31))
    result = sample_posterior(
        posterior, sampler_seed, settings=experiment.settings, swarm_settings=experiment.swarm
    )
    chain = second_half(result)
    few = spread_draws(chain, N_DRAWS, rng)
    diagnostics = result.diagnostics
    return Repetition(
        number=number,
        truth=tuple(float(x) for x in truth),
        ranks=tuple(int(r) for r in np.sum(few < truth, axis=0)),
        below=tuple(float(b) for b in np.mean(chain.reshape(-1, len(truth)) < truth, axis=0)),
        ordered=bool(np.all(np.diff(measurement.frequencies) >= 0)),
        converged=diagnostics.converged,
        r_hat=diagnostics.r_hat,
        autocorrelation_time=diagnostics.autocorrelation_time,
        effective=diagnostics.ess_bulk,
        steps=diagnostics.steps,
    )


def simulate(experiment: Experiment, nature: Nature, rng: np.random.Generator) -> tuple[Array, Measurement]:
    """Parameters from the prior, (n,), and a list of frequencies that was measured at them."""
    truth = prior_draw(_any_posterior(experiment, nature), rng)
    model = nature.model
    f = model.predict(truth[None, : model.parameters.size]).frequencies[0]
    s = truth[-1] if experiment.relative_std is None else experiment.relative_std
    variance = (s * f) ** 2 + experiment.resolution**2 / 12 + (nature.solver_error * f) ** 2
    listed = f + np.sqrt(variance) * rng.standard_normal(len(f))
    return truth, _measurement(experiment, listed)


def prior_draw(posterior: Posterior, rng: np.random.Generator) -> Array:
    """One draw from the prior within the constraints (9), by rejection, (n,)."""
    while True:
        x = posterior.parameters.sample(rng, 16)
        inside = np.isfinite(posterior.log_prior(x))
        if inside.any():
            return np.asarray(x[int(np.argmax(inside))])


def second_half(result: EnsembleResult) -> Array:
    """The later half of all steps, (ensembles, steps, walkers, n): as much again as burn-in took."""
    return result.chain[:, max(result.diagnostics.steps // 2 - result.diagnostics.burn_in, 0) :]


def spread_draws(chain: Array, n_draws: int, rng: np.random.Generator) -> Array:
    """Draws spread evenly over the steps, each of another walker as long as there are some, (n_draws, n).

    chain : (ensembles, steps, walkers, n).
    """
    ensembles, steps, walkers, _ = chain.shape
    at = ((np.arange(n_draws) + 0.5) * steps / n_draws).astype(int)
    who = np.resize(rng.permutation(ensembles * walkers), n_draws)
    return np.asarray(chain[who // walkers, at, who % walkers])


def experiment_hash(experiment: Experiment) -> str:
    """Hash of all that a repetition depends on: priors, predictions, noise, settings, seed."""
    nature = _nature(experiment.source)
    posterior = _any_posterior(experiment, nature)
    rng = np.random.default_rng(0)
    x = np.stack([prior_draw(posterior, rng) for _ in range(3)])
    predicted = nature.model.predict(x[:, : nature.model.parameters.size]).frequencies
    parts = [
        posterior.parameters.names,
        [repr(p.prior) for p in posterior.parameters.parameters],
        [[f"{f:.7g}" for f in row] for row in predicted],
        [f"{e:.3g}" for e in nature.solver_error],
        experiment.resolution,
        experiment.relative_std,
        experiment.seed,
        asdict(experiment.settings),
        asdict(experiment.swarm),
        N_DRAWS,
    ]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:32]


def parameter_names(experiment: Experiment) -> tuple[str, ...]:
    """Names in the order of truths and ranks."""
    return _any_posterior(experiment, _nature(experiment.source)).parameters.names


@lru_cache(maxsize=4)
def _nature(source: Source) -> Nature:
    return source()


def _any_posterior(experiment: Experiment, nature: Nature) -> Posterior:
    """A posterior whose list says nothing, for its priors."""
    listed = np.ones(len(nature.solver_error))
    return plate_posterior(nature.model, _measurement(experiment, listed), nature.solver_error)


def _measurement(experiment: Experiment, listed: Array) -> Measurement:
    labels = ("",) * len(listed)
    return Measurement(listed, experiment.resolution, experiment.relative_std, None, labels, complete=True)
