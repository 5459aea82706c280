"""The extended model: which mode each frequency is under it, and its constants by emcee."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.diagnosis.comparison import Comparison, PlateCase
from cpam_bayes.diagnosis.diagnose import Diagnosis
from cpam_bayes.diagnosis.evidence.marginal import Marginal
from cpam_bayes.diagnosis.evidence.weighing import Tested
from cpam_bayes.diagnosis.fit import Fit
from cpam_bayes.inference.ensemble import DEFAULT_SETTINGS, Diagnostics, EnsembleSettings, sample
from cpam_bayes.inference.posterior import NoiseModel, Posterior
from cpam_bayes.inference.proposal import AdaptationSettings, adapted
from cpam_bayes.mechanics.modes import Mode
from cpam_bayes.plate import Measurement
from cpam_bayes.running import single_blas_thread

__all__ = ["FrequencyRow", "MissedMode", "PairedFit", "left_aside", "paired_fit", "plain_mode_shapes"]

Array = NDArray[Any]


@dataclass(frozen=True, slots=True)
class FrequencyRow:
    """One measured frequency, what a fit predicts for it, and the mode it belongs to.

    predicted, predicted_sd, sigma : Hz; predicted is ``None`` for a frequency that is no mode. number :
    of the mode in ascending order, from 1. standardised : predicted - measured over the standard
    deviations of noise and prediction together.
    """

    plate: str
    measured: float
    predicted: float | None
    predicted_sd: float
    sigma: float
    standardised: float
    number: int | None
    mode: Mode | None

    @property
    def residual_percent(self) -> float | None:
        """predicted / measured - 1, in percent."""
        return None if self.predicted is None else 100.0 * (self.predicted / self.measured - 1.0)


@dataclass(frozen=True, slots=True)
class MissedMode:
    """A mode of the model that a list lacks under a hypothesis."""

    plate: str
    number: int
    mode: Mode


@dataclass(frozen=True, slots=True)
class PairedFit:
    """A fit with the mode of every frequency, and the modes that the measured frequencies lack."""

    frequencies: tuple[FrequencyRow, ...]
    missed: tuple[MissedMode, ...]


def paired_fit(d: Diagnosis, fit: Fit, leader: Tested) -> PairedFit:
    """All frequencies plate by plate; leader : the hypothesis that says which mode each is."""
    modes = [case.models.bare.full.modes(_plate_vector(leader, i)) for i, case in enumerate(d.cases)]
    return PairedFit(_frequency_rows(d, fit, leader, modes), _missed_modes(d, leader, modes))


def plain_mode_shapes(d: Diagnosis) -> tuple[Array, ...]:
    """Mode shapes of every plate by the plain model at its most probable constants."""
    return tuple(
        case.models.bare.full.shapes(_plate_vector(d.weighed.none, i)) for i, case in enumerate(d.cases)
    )


def _frequency_rows(
    d: Diagnosis, fit: Fit, leader: Tested, modes_of: Sequence[Sequence[Mode]]
) -> tuple[FrequencyRow, ...]:
    """All frequencies plate by plate; leader : the hypothesis that says which mode each is."""
    rows: list[FrequencyRow] = []
    start = 0
    standardised = fit.standardised
    parts = leader.marginal.comparison.model.parts
    for case, part, modes in zip(leader.cases or d.cases, parts, modes_of, strict=True):
        is_paired = case.modes >= 0
        if len(part.modes) < is_paired.sum() and leader.hypothesis.listed.spurious is not None:
            is_paired[leader.hypothesis.listed.spurious] = False
        numbers = iter(part.modes)
        for k in range(case.measurement.size):
            j = start + k
            number = int(next(numbers)) if is_paired[k] else None
            rows.append(
                FrequencyRow(
                    plate=case.name,
                    measured=float(fit.measured[j]),
                    predicted=None if number is None else float(fit.predicted[j]),
                    predicted_sd=float(fit.predicted_sd[j]),
                    sigma=float(fit.sigma[j]),
                    standardised=float("nan") if number is None else -float(standardised[j]),
                    number=None if number is None else number + 1,
                    mode=None if number is None or number >= len(modes) else modes[number],
                )
            )
        start += case.measurement.size
    return tuple(rows)


def left_aside(case: PlateCase) -> list[float]:
    """Frequencies of an incomplete list that its pairing gives no mode."""
    return [float(f) for f in case.measurement.frequencies[case.modes < 0]]


def _missed_modes(d: Diagnosis, leader: Tested, modes_of: Sequence[Sequence[Mode]]) -> tuple[MissedMode, ...]:
    """Modes in the range of the lists that these lack under a hypothesis."""
    missed: list[MissedMode] = []
    parts = leader.marginal.comparison.model.parts
    for case, part, modes in zip(leader.cases or d.cases, parts, modes_of, strict=True):
        highest = int(part.modes.max())
        gaps = set(range(highest)) - {int(k) for k in part.modes}
        if case.modes[-1] < 0:  # the last frequency is no mode, and there may be some below it
            last = case.measurement.frequencies[-1]
            gaps |= {k for k in range(highest + 1, len(modes)) if modes[k].frequency <= last}
        missed += [MissedMode(case.name, k + 1, modes[k]) for k in sorted(gaps) if k < len(modes)]
    return tuple(missed)


def _plate_vector(t: Tested, i: int) -> Array:
    """Parameters of the bare model of one plate where a hypothesis is most probable."""
    part, x = t.marginal.comparison.model.parts[i], t.marginal.best
    constants = np.array(x[part.columns])
    varied = part.scatter >= 0
    constants[varied] *= 1.0 + x[part.scatter[varied]]
    return constants


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
    """The part of a hypothesis that is no parameter of the plate, in words."""
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
