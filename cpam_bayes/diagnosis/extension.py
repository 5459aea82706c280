"""The constants of the extended model by emcee, averaged over the causes that are claimed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.diagnosis.diagnose import Diagnosis
from cpam_bayes.diagnosis.evidence.comparison import Comparison
from cpam_bayes.diagnosis.evidence.marginal import Marginal
from cpam_bayes.diagnosis.evidence.weighing import Tested
from cpam_bayes.inference.chains.ensemble import DEFAULT_SETTINGS, Diagnostics, EnsembleSettings, sample
from cpam_bayes.inference.noise import NoiseModel
from cpam_bayes.inference.posterior import Posterior
from cpam_bayes.inference.proposal import AdaptationSettings, adapted
from cpam_bayes.plate import Measurement
from cpam_bayes.threads import single_blas_thread

Array = NDArray[Any]

# Members of a claim that are sampled: those with so much of it, and so many.
_LEAST_FRACTION, _MOST_MEMBERS = 0.05, 3
# Draws that are handed on, and by how much starts are spread, in standard deviations of their scores.
_DRAWS, _SPREAD = 4000, 0.1
# Nodes of the quadrature that optima are sought from, and the mass that makes one worth it.
_MOST_STARTS, _NODE_FRACTION = 8, 0.01
# Trials to find a start inside the constraints (9) before the draw itself is taken.
_TRIALS = 20


@dataclass(frozen=True, slots=True)
class ComparedPosterior(Posterior):
    """The posterior of a comparison's parameters, with the noise and the discrepancy that it has."""

    comparison: Comparison = field(kw_only=True)

    def noise(self, x: Array, predicted: Array) -> Array:
        """Standard deviations of the measured frequencies, the same for every mode.

        x (m, n_parameters), predicted (m, n_modes) -> (m, n_frequencies, n_modes) Hz.
        """
        sigma = np.sqrt(self.comparison.variance(x))
        return np.asarray(sigma[:, :, None] + np.zeros(predicted.shape[1]))

    def log_likelihood(self, x: Array) -> Array:
        """Log likelihood of parameter vectors (m, n_parameters), discrepancies correlated, (m,)."""
        return self.comparison.log_likelihood(x)


@dataclass(frozen=True, slots=True)
class SampledMember:
    """One hypothesis of the claim, sampled.

    fraction : of what is averaged
    draws : (d, n) of all its parameters, equally probable
    mean, sd : (n,)
    note : what of the hypothesis is no parameter of the plate, "" if nothing is
    """

    tested: Tested
    fraction: float
    draws: Array
    mean: Array
    sd: Array
    diagnostics: Diagnostics
    note: str


@dataclass(frozen=True, slots=True)
class Resampled:
    """The constants of the extended model.

    constants : name -> mean, sd, 2.5 % and 97.5 % quantile, SI, averaged over the members by their fractions.
    draws : (d, n_constants), equally probable. not_sampled : fraction of the claim that the members lack.
    solves : forward solves of all chains.
    """

    constants: Mapping[str, tuple[float, float, float, float]]
    draws: Array
    members: tuple[SampledMember, ...]
    not_sampled: float
    solves: int

    @property
    def converged(self) -> bool:
        """Whether the chains of every member are."""
        return all(m.diagnostics.converged for m in self.members)


@single_blas_thread
def resample(
    diagnosis: Diagnosis,
    seed: int,
    settings: EnsembleSettings = DEFAULT_SETTINGS,
    *,
    notify: Callable[[str], None] = lambda text: None,
) -> Resampled | None:
    """The constants re-inferred by emcee under the leading members of the claim, averaged over these.

    ``None`` where nothing is claimed. A member that has less than a twentieth of the claim is left out, and
    all after the first three.
    """
    return resample_members(diagnosis.members, seed, settings, notify=notify) if diagnosis.members else None


def resample_members(
    members: Sequence[tuple[Tested, float]],
    seed: int,
    settings: EnsembleSettings = DEFAULT_SETTINGS,
    *,
    notify: Callable[[str], None] = lambda text: None,
) -> Resampled:
    """The same of hypotheses (at least one) with their fractions."""
    ranked = sorted(members, key=lambda m: -m[1])[:_MOST_MEMBERS]
    kept = [m for i, m in enumerate(ranked) if not i or m[1] >= _LEAST_FRACTION]
    whole = sum(fraction for _, fraction in kept)
    sampled, solves = [], 0
    for k, (tested, fraction) in enumerate(kept):
        notify(f"sampling {tested.hypothesis.cause} {tested.hypothesis.variant}".rstrip())
        member, cost = _sampled(tested, fraction / whole, seed, k, settings)
        sampled.append(member)
        solves += cost
    names = _shared_constants(sampled)
    draws = np.concatenate([_even(m, names, max(round(m.fraction * _DRAWS), 2)) for m in sampled])
    mean, sd = _mixed(sampled, names)
    low, high = np.quantile(draws, (0.025, 0.975), axis=0)
    constants = {
        name: (float(mean[i]), float(sd[i]), float(low[i]), float(high[i])) for i, name in enumerate(names)
    }
    total = sum(fraction for _, fraction in members)
    return Resampled(constants, draws, tuple(sampled), 1.0 - whole / total, solves)


def compared_posterior(comparison: Comparison) -> ComparedPosterior:
    """The posterior that samplers ask for, of a comparison without a frequency left out."""
    listed = comparison.listed
    n = len(listed.frequencies)
    inferred = comparison.noise is not None
    amplitude = comparison.parameters.parameters[comparison.noise] if comparison.noise is not None else 1.0
    noise = NoiseModel(listed.scale, amplitude, 0.0, np.zeros(n))
    spread = None if inferred else np.sqrt(listed.variance)
    measurement = Measurement(listed.frequencies, 0.0, None, spread, ("",) * n, complete=True)
    return ComparedPosterior(
        comparison.model,
        measurement,
        comparison.parameters,
        noise,
        np.zeros(n, dtype=bool),
        comparison=comparison,
    )


def start_positions(marginal: Marginal, posterior: Posterior, size: int, rng: np.random.Generator) -> Array:
    """Starts (size, n): posterior draws of importance sampling, spread a little over their scores."""
    scores = marginal.comparison.scores
    z = scores.to_z(rng.permutation(marginal.resampled(size)))
    width = _SPREAD * np.maximum(z.std(axis=0), 1e-3)
    start = scores.to_x(z)
    open_ = np.arange(size)
    for _ in range(_TRIALS):
        trial = scores.to_x(z[open_] + width * rng.standard_normal((len(open_), z.shape[1])))
        good = np.isfinite(posterior.log_prob(trial))
        start[open_[good]] = trial[good]
        open_ = open_[~good]
        if not len(open_):
            break
    return start


def note_of(tested: Tested) -> str:
    """What of a hypothesis is no parameter of the plate, in words."""
    listed, notes = tested.hypothesis.listed, []
    if listed.missed and listed.spurious is not None:
        notes.append(
            f"frequency {listed.spurious + 1} is taken as misread for that of mode {listed.missed[0] + 1}"
        )
    elif listed.missed:
        notes.append(
            f"taken as missing from the list: mode {' and '.join(str(k + 1) for k in listed.missed)}"
        )
    elif listed.spurious is not None:
        notes.append(f"frequency {listed.spurious + 1} is taken as false and left out")
    if listed.misread is not None:
        notes.append(f"frequency {listed.misread + 1} is taken as misread and says little of the constants")
    if tested.marginal.comparison.discrepancy is not None:
        notes.append("a scatter of all modes that nothing explains is added to the noise")
    return "; ".join(notes)


def _sampled(
    tested: Tested, fraction: float, seed: int, number: int, settings: EnsembleSettings
) -> tuple[SampledMember, int]:
    marginal = tested.marginal
    posterior = compared_posterior(marginal.comparison)
    member_seed = int(np.random.SeedSequence([seed, number]).generate_state(1)[0])
    rng = np.random.default_rng([member_seed, 7])
    proposal = adapted(posterior, _optima(marginal), member_seed, AdaptationSettings())
    n = settings.ensembles * settings.walkers
    start = start_positions(marginal, posterior, n, rng).reshape(settings.ensembles, settings.walkers, -1)
    result = sample(posterior, start, member_seed, settings, proposal=proposal)
    draws = result.draws
    member = SampledMember(
        tested, fraction, draws, draws.mean(axis=0), draws.std(axis=0), result.diagnostics, note_of(tested)
    )
    return member, result.solves


def _optima(marginal: Marginal) -> Array:
    """Parameters (m, n) of the quadrature's nodes that carry mass, the best first."""
    order = np.argsort(-marginal.weight, kind="stable")[:_MOST_STARTS]
    kept = [i for k, i in enumerate(order) if not k or marginal.weight[i] >= _NODE_FRACTION]
    return np.asarray(marginal.comparison.scores.to_x(marginal.z[kept]))


def _shared_constants(members: Sequence[SampledMember]) -> list[str]:
    """Parameters of the plates that all members have, those of the causes left out."""
    comparisons = [m.tested.marginal.comparison for m in members]
    of_causes = {m.tested.marginal.comparison.parameters.names[c] for m in members for c in m.tested.columns}
    first = comparisons[0].model.parameters.names
    return [n for n in first if n not in of_causes and all(n in c.model.parameters for c in comparisons)]


def _columns(member: SampledMember, names: Sequence[str]) -> list[int]:
    every = member.tested.marginal.comparison.parameters.names
    return [every.index(name) for name in names]


def _even(member: SampledMember, names: Sequence[str], size: int) -> Array:
    """Draws of some parameters at even distances along the chains, (size, n_names)."""
    at = np.linspace(0, len(member.draws) - 1, size).round().astype(int)
    return np.asarray(member.draws[at][:, _columns(member, names)])


def _mixed(members: Sequence[SampledMember], names: Sequence[str]) -> tuple[Array, Array]:
    """Mean and standard deviation over the mixture of the members, (n_names,) each."""
    fraction = np.array([m.fraction for m in members])
    means = np.stack([m.mean[_columns(m, names)] for m in members])
    sds = np.stack([m.sd[_columns(m, names)] for m in members])
    mean = fraction @ means
    return mean, np.sqrt(fraction @ (sds**2 + (means - mean) ** 2))
