"""Stacking sequences: plates with an unknown layup, and calibration of the probabilities of sequences.

For the calibration, sequence and constants are drawn from the prior, a list is simulated, and every sequence
on the grid gets its probability. Randomised credible sets of a level must then contain the true sequence as
often as the level says (Cook, Gelman and Rubin, 2006, for continuous parameters).
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import kstest

from cpam_bayes.calibration import prior_draw
from cpam_bayes.forward_model.build import reduced_model
from cpam_bayes.forward_model.model import angle_parameters, reference_vector
from cpam_bayes.forward_model.reduced import ReducedModel
from cpam_bayes.parallel import counted, run
from cpam_bayes.plate import Measurement, Specimen, angle_grid, builtin
from cpam_bayes.plate.layup import parse_layup
from cpam_bayes.running import single_blas_thread
from cpam_bayes.stacking.conditional import (
    ConditionalPosterior,
    conditional_posterior,
    fit_conditionals,
    importance_evidence,
)
from cpam_bayes.stacking.symmetry import Symmetry, all_sequences, canonical, classes, plate_symmetries

Array = NDArray[Any]

# Plates with an unknown layup


def with_unknown_layup(plate: str, layup: str | None, step_deg: float | None = None) -> Specimen:
    """A built-in plate with unknown angles, its own or those of ``layup``, on another grid if wanted."""
    specimen = builtin(plate, sequence=True)
    if layup is not None:
        specimen = replace(specimen, plate=replace(specimen.plate, layup=parse_layup(layup)))
    return specimen if step_deg is None else replace(specimen, angle_grid_deg=step_deg)


def known_angles(specimen: Specimen) -> Array:
    """The built-in plate's own angles at the positions of the unknown ones, (k,) degrees."""
    known = builtin(specimen.name).plate.layup.angles_deg
    layup = specimen.plate.layup
    return np.array([known[np.flatnonzero(layup.unknown_index == i)[0]] for i in range(layup.n_unknown)])


def with_noise_free_list(specimen: Specimen, noise: float) -> tuple[Specimen, Array, float]:
    """A specimen with the noise-free list of its own sequence, that sequence, and the model's error.

    noise : relative standard deviation that the list states. The constants are the reference ones.
    """
    assert specimen.measurement is not None
    n = specimen.measurement.size
    model = reduced_model(specimen, angle_parameters(specimen).union(specimen.unknowns), n)
    angles = known_angles(specimen)
    x = np.concatenate((angles, reference_vector(specimen, specimen.unknowns)))
    frequencies = model.predict(x[None]).frequencies[0]
    listed = Measurement(frequencies, 0.0, noise, None, ("",) * n, complete=True)
    return replace(specimen, measurement=listed), angles, float(model.full.error.max())


# Calibration

# Allowed difference of a coverage from its level, in binomial standard deviations.
ALLOWED = 2.6


@dataclass(frozen=True, slots=True)
class CoverageSettings:
    """Noise of the lists, and settings for evaluating each list.

    relative_std : of the noise. modes : number in a list. library : number of draws of the constants whose
    frequencies are tabulated for every class. starts : number of them from which an optimisation starts.
    max_misfit : rms misfit of the nearest of them beyond which a class is left out: at 1 % noise a misfit
    half as large costs a hundred nats. near : nats below the best within which an evidence is computed by
    importance sampling, not by Laplace's method.
    log2_points : of the importance sample.
    """

    relative_std: float = 0.01
    modes: int = 6
    library: int = 1200
    starts: int = 2
    max_misfit: float = 0.12
    near: float = 7.0
    log2_points: int = 8


@dataclass(frozen=True, slots=True)
class Trial:
    """One simulated list.

    truth_deg : (k,) sequence.
    place : probability of the sequences before the true one, including part of its own: uniform if the
    probabilities are right.
    probability : of the true class.
    rank : of it.
    set_size : number of sequences in the 95 % set.
    error : largest standard error of a log evidence that matters.
    """

    number: int
    truth_deg: tuple[float, ...]
    place: float
    probability: float
    rank: int
    set_size: int
    error: float


@dataclass(frozen=True, slots=True)
class CoverageSummary:
    """How often randomised sets contain the truth.

    covered : fraction at the level.
    sd : binomial standard deviation.
    z : their difference in units of it.
    p_uniform : p-value of the places' uniformity, by Kolmogorov and Smirnov.
    """

    level: float
    trials: int
    covered: float
    sd: float
    z: float
    p_uniform: float

    @property
    def passes(self) -> bool:
        """Whether the coverage agrees with the level, within 2.6 binomial standard deviations."""
        return abs(self.z) <= ALLOWED


@dataclass(frozen=True, slots=True)
class _Shared:
    """Data shared by all trials: the model, the classes (c, k) with sizes, and the library of their lists.

    library : (p, n) constants.
    lists : (c, p, modes) Hz.
    """

    model: ReducedModel
    symmetries: tuple[Symmetry, ...]
    grid_deg: Array
    classes: Array
    size: Array
    library: Array
    lists: Array
    settings: CoverageSettings
    seed: int


@single_blas_thread
def stacking_coverage(
    specimen: Specimen,
    trials: int,
    seed: int,
    *,
    settings: CoverageSettings | None = None,
    executor: Executor | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[Trial, ...]:
    """Trials 0 to n - 1 on a plate with unknown angles and constants, identical for any executor.

    All of them share one reduced model. A list is not sorted: its frequencies are paired by position, as in
    the likelihood. Raises ``ValueError`` as ``plate_symmetries`` does.
    """
    shared = _shared(specimen, settings or CoverageSettings(), seed)
    return tuple(run(_trial, shared, range(trials), executor, on_result=counted(progress, trials)))


def summarised(trials: tuple[Trial, ...], level: float = 0.95) -> CoverageSummary:
    """Coverage of the randomised sets of one level."""
    place = np.array([t.place for t in trials])
    covered = float(np.mean(place <= level))
    sd = float(np.sqrt(level * (1.0 - level) / len(place)))
    return CoverageSummary(
        level, len(place), covered, sd, (covered - level) / sd, float(kstest(place, "uniform").pvalue)
    )


def randomised_place(single: Array, size: Array, true: int, fraction: float) -> float:
    """Position, from 0 to 1, of the true class among classes in descending order of probability.

    The set of a level contains all sequences before the level is reached, and part of the one there:
    sum of the more probable sequences + fraction * (sum of the equally probable ones) <= level.

    single : (c,) probability of one sequence of each class.
    size : (c,) number of sequences in it.
    fraction : uniform random number.
    """
    mass = single * size
    return float(mass[single > single[true]].sum() + fraction * mass[single == single[true]].sum())


def _shared(specimen: Specimen, settings: CoverageSettings, seed: int) -> _Shared:
    grid = angle_grid(specimen.angle_grid_deg)
    g, k = len(grid), specimen.plate.layup.n_unknown
    symmetries = plate_symmetries(specimen)
    distinct = classes(all_sequences(g, k), symmetries)
    model = reduced_model(specimen, angle_parameters(specimen).union(specimen.unknowns), settings.modes)
    conditional = _posterior(model, k, np.ones(settings.modes), settings)
    rng = np.random.default_rng([seed, 1])
    library = np.stack([prior_draw(conditional.template, rng) for _ in range(settings.library)])
    lists = [
        conditional.at(np.repeat(grid[c][None], len(library), axis=0)).predict(library)[:, : settings.modes]
        for c in distinct.representative
    ]
    return _Shared(
        model,
        symmetries,
        grid,
        distinct.representative,
        distinct.size,
        library,
        np.stack(lists),
        settings,
        seed,
    )


def _posterior(
    model: ReducedModel, n_angles: int, frequencies: Array, settings: CoverageSettings
) -> ConditionalPosterior:
    measurement = Measurement(
        frequencies, 0.0, settings.relative_std, None, ("",) * len(frequencies), complete=True
    )
    error = np.asarray(np.hypot(model.full.error, model.tolerance))
    return conditional_posterior(model, n_angles, measurement, error)


def _trial(shared: _Shared, number: int) -> Trial:
    rng = np.random.default_rng([shared.seed, 2, number])
    settings, grid, k = shared.settings, shared.grid_deg, shared.classes.shape[1]
    sequence = rng.integers(len(grid), size=(k,))
    empty = _posterior(shared.model, k, np.ones(settings.modes), settings)
    x = prior_draw(empty.template, rng)
    f = empty.at(grid[sequence][None]).predict(x[None])[0, : settings.modes]
    sd = np.diagonal(_posterior(shared.model, k, f, settings).template.noise(x[None], f[None])[0])
    conditional = _posterior(shared.model, k, f + sd * rng.standard_normal(len(f)), settings)
    log_evidence, error = _evidences(shared, conditional)
    mass = shared.size * np.exp(log_evidence - log_evidence.max())
    mass = mass / mass.sum()
    single = mass / shared.size
    true_class = canonical(sequence[None], shared.symmetries).representative[0]
    true = int(np.flatnonzero(np.all(shared.classes == true_class, axis=1))[0])
    order = np.argsort(-single, kind="stable")
    cumulative = np.cumsum(np.repeat(single[order], shared.size[order]))
    return Trial(
        number=number,
        truth_deg=tuple(float(a) for a in grid[sequence]),
        place=randomised_place(single, shared.size, true, rng.uniform()),
        probability=float(mass[true]),
        rank=int(np.flatnonzero(order == true)[0]) + 1,
        set_size=int(np.searchsorted(cumulative, 0.95)) + 1,
        error=float(np.max(error[mass > 0.01])),
    )


def _evidences(shared: _Shared, conditional: ConditionalPosterior) -> tuple[Array, Array]:
    """Log evidence of every class, and its standard error for those that matter, (c,)."""
    settings, angles = shared.settings, shared.grid_deg[shared.classes]
    starts, misfit = _starts(shared, conditional)
    log_evidence, error = np.full(len(angles), -np.inf), np.zeros(len(angles))
    kept = np.flatnonzero(misfit <= max(settings.max_misfit, 2.0 * float(misfit.min())))
    fits = fit_conditionals(conditional, angles[kept], starts[kept])
    log_evidence[kept] = fits.log_evidence
    near = np.flatnonzero(fits.log_evidence > fits.log_evidence.max() - settings.near)
    sampled = importance_evidence(conditional, angles[kept[near]], fits[near], settings.log2_points)
    log_evidence[kept[near]], error[kept[near]] = sampled.log_evidence, sampled.error
    return log_evidence, error


def _starts(shared: _Shared, conditional: ConditionalPosterior) -> tuple[Array, Array]:
    """Constants whose lists are most like the measured one, for every class (c, starts, n), and their misfit.

    Multiplying all stiffnesses by a^2 multiplies all frequencies by a: each draw of the library is also tried
    with the factor that suits the list best, if that stays within the bounds. If modes cross there are many
    optima, and the nearest draw is in the right one more often than a fixed start.
    """
    parameters = conditional.template.model.parameters
    ratio = np.log(conditional.template.measurement.frequencies / shared.lists)
    factor = np.exp(2.0 * ratio.mean(axis=2))
    moduli = np.array([name[0] in "EG" for name in parameters.names])
    scaled = np.where(moduli, factor[..., None] * shared.library, shared.library)
    inside = np.all((scaled >= parameters.lower) & (scaled <= parameters.upper), axis=2)
    plain = np.broadcast_to(shared.library, scaled.shape)
    misfit = np.concatenate((np.where(inside, ratio.var(axis=2), np.inf), np.mean(ratio**2, axis=2)), axis=1)
    best = np.argsort(misfit, axis=1, kind="stable")[:, : shared.settings.starts]
    both = np.concatenate((scaled, plain), axis=1)
    nearest = np.sqrt(misfit.min(axis=1))
    return np.asarray(np.take_along_axis(both, best[..., None], axis=1)), nearest
