"""The paper's noise study, section 7.4: inversions of perturbed lists, and one posterior at that noise.

A list of frequencies is inverted by the particle swarm as it is, which gives the reference. Then
noise of a level and an interpretation of eq. (12) is added to it, once for each group, every perturbed
list is inverted, and the mean over the groups is compared with the reference. A swarm that demonstrably
missed the minimum of eq. (7) is restarted: the noise is studied, not the luck of a search.

The paper takes the measured list. Where the plate model cannot fit that list, every inversion ends
on bounds and says nothing about noise: the list that the model itself predicts at the reference
constants (`model_list`) avoids that.

The posterior is that of the list *without* added noise, with the noise's standard deviations taken as
known. For a linear model it is as wide as the inversions' scatter about the truth and centred on the
reference, like their mean. The claim tested here is that one posterior then says as much as many inversions.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from itertools import count
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.answer import Notice
from cpam_bayes.forward_model.build import reduced_model
from cpam_bayes.forward_model.model import reference_constants
from cpam_bayes.identification.point import PointEstimate, estimate_constants
from cpam_bayes.identification.search import required
from cpam_bayes.inference.ensemble import EnsembleSettings
from cpam_bayes.inference.swarm import SwarmSettings
from cpam_bayes.parallel import run
from cpam_bayes.plate import Measurement, Specimen, to_user, user_name
from cpam_bayes.printed.repetition import (
    INTERPRETATIONS,
    POSTERIOR,
    Comparison,
    Evidence,
    Interpretation,
    InverseProblem,
    Inversion,
    InversionTask,
    PosteriorSummary,
    Shared,
    clusters,
    compare,
    equally_good,
    perturbation_sd,
    run_task,
    swarm_value,
)
from cpam_bayes.printed.tables import PrintedTable, perturbation_table
from cpam_bayes.running import TimeIsUpError, cut_short, single_blas_thread

Array = NDArray[Any]
ListSource = Literal["measured", "model"]

# Enough draws for a mean and a standard deviation to 3 %, in few steps.
ENSEMBLE_SETTINGS: Final = EnsembleSettings(walkers=24, round_steps=500, effective=1000.0, most_steps=10_000)
# Number of swarms that search for the reference.
_STARTS: Final = 10
# A standard deviation needs two groups.
_FEWEST_GROUPS: Final = 2
# A constant is recovered where it is this close, as a fraction of its search interval.
_FOUND_AGAIN = 1e-2


@dataclass(frozen=True, slots=True)
class Repetition:
    """Inversions of perturbed lists.

    constants : (groups, n) SI.
    on_bound : (groups, n) bool.
    lists : (groups, n_modes) Hz.
    reordered : fraction of the lists in which modes changed places.
    redrawn : frequencies drawn again because they were not positive.
    converged : number of swarms that did not exhaust their budget.
    restarted : number of swarms restarted because one missed the minimum.
    missed : number of lists on which none found it.
    solves : number of forward solves.
    """

    constants: Array
    on_bound: Array
    lists: Array
    reordered: float
    redrawn: int
    converged: int
    restarted: int
    missed: int
    solves: int

    @property
    def mean(self) -> Array:
        """Mean over the groups, (n,)."""
        return np.asarray(self.constants.mean(axis=0))

    @property
    def sd(self) -> Array:
        """Standard deviation over the groups, (n,)."""
        return np.asarray(self.constants.std(axis=0, ddof=1))


@dataclass(frozen=True, slots=True)
class Cell:
    """One level and interpretation: noise_sd (n_modes,) Hz, and one comparison for each constant."""

    level: float
    reading: Interpretation
    noise_sd: Array
    repetition: Repetition
    posterior: PosteriorSummary
    comparisons: tuple[Comparison, ...]


@dataclass(frozen=True, slots=True)
class Sensitivity:
    """The noise study of one plate.

    without_noise : the inversion of the list as it is, the reference of all percentages. starts,
    found_again : number of swarms tried for it, and of those that ended equally well.
    cells : for each level in turn, one per reading.
    """

    specimen: Specimen
    source: ListSource
    without_noise: PointEstimate
    starts: int
    found_again: int
    cells: tuple[Cell, ...]
    groups: int
    seconds: float

    @property
    def reference(self) -> Array:
        """Constants identified without noise, (n,)."""
        return np.array([c.value for c in self.without_noise.constants])


def model_list(
    specimen: Specimen, n_modes: int, notify: Callable[[str], None] = lambda text: None
) -> Specimen:
    """The specimen with the frequencies that its own model predicts at its reference constants.

    Raises ``ValueError`` if these are not inside the search bounds.
    """
    unknowns = specimen.unknowns
    x = unknowns.vector(reference_constants(specimen))
    for name, value, low, high in zip(unknowns.names, x, unknowns.lower, unknowns.upper, strict=True):
        if not low <= value <= high:
            shown, lowest, highest = (to_user(name, v) for v in (value, low, high))
            raise ValueError(
                f"{specimen.source}: material.{user_name(name)}: {shown:g} lies outside its search bounds "
                f"{lowest:g} to {highest:g}, where no inversion can find it again; widen these in [unknowns]"
            )
    model = reduced_model(specimen, unknowns, n_modes, notify=notify)
    predicted = model.full.predict(x[None]).frequencies[0]
    exact = Measurement(predicted, 0.0, None, None, ("",) * n_modes, complete=True)
    return replace(specimen, measurement=exact)


@single_blas_thread
def noise_study(
    specimen: Specimen,
    seed: int,
    *,
    source: ListSource,
    levels: Sequence[float] = (0.01, 0.05, 0.1),
    groups: int = 10,
    readings: Sequence[Interpretation] = INTERPRETATIONS,
    swarm_settings: SwarmSettings | None = None,
    chains: EnsembleSettings = ENSEMBLE_SETTINGS,
    executor: Executor | None = None,
    notify: Callable[[str], None] = lambda text: None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Sensitivity:
    """Repeat the inversion of a specimen's list with noise, and sample its posterior at that noise.

    The reference is the best of several swarms: a single one can end in a wrong optimum and spoil all
    percentages.

    source : origin of the list, for the record (`model_list` makes a "model" list).
    specimen : with a complete list.
    levels : of noise, as fractions, above 0; groups : 2 or more. The random numbers of a noisy list depend
    only on the seed, the level, the reading and the number of its group, not on other levels or on workers.

    Raises ``ValueError`` like ``estimate_constants``.
    """
    start = time.perf_counter()
    measurement, unknowns = required(specimen)
    settings = swarm_settings or SwarmSettings()
    plain = _plain(specimen, measurement)
    known = tuple((k, v) for k, v in specimen.material.constants.items() if k not in unknowns)
    problem = InverseProblem(
        model=reduced_model(plain, unknowns, measurement.size, notify=notify),
        unknowns=replace(unknowns, fixed=known),
        material=specimen.material,
        swarm=settings,
    )
    notify("inverting the list without noise")
    best_seed, found_again = _best_start(problem, measurement.frequencies, seed, executor)
    without_noise = estimate_constants(plain, best_seed, settings=settings, notify=notify)
    shared = Shared(
        problem=replace(problem, model=without_noise.model),
        measurement=required(plain)[0],
        reference=without_noise.swarm.best,
        chains=chains,
        seed=seed,
    )
    pairs = [(level, reading) for level in dict.fromkeys(levels) for reading in dict.fromkeys(readings)]
    # the longest first, so that none is started at the end
    items = [InversionTask(*pair, POSTERIOR) for pair in pairs]
    items += [InversionTask(*pair, group) for group in range(groups) for pair in pairs]
    notify("inverting noisy lists and sampling posteriors")
    results: dict[int, Any] = {}

    def keep(index: int, result: object) -> None:
        results[index] = result
        progress(len(results), len(items))

    try:
        run(run_task, shared, items, executor, on_result=keep, is_limited=True)
    except TimeIsUpError:
        wanted, groups = groups, _complete_groups(results, len(pairs))
        if groups < _FEWEST_GROUPS:
            raise
        cut_short("cut_groups", done=groups, of=wanted)
    cells = []
    for i, (level, reading) in enumerate(pairs):
        repetition = _collect([results[(group + 1) * len(pairs) + i] for group in range(groups)])
        posterior: PosteriorSummary = results[i]
        sd = perturbation_sd(measurement.frequencies, level, reading)
        at_reference = np.array([mode.frequency for mode in without_noise.predicted])
        residual = float(np.sqrt(np.mean(((at_reference - measurement.frequencies) / sd) ** 2)))
        comparisons = _comparisons(repetition, posterior, without_noise.swarm.best, residual)
        cells.append(Cell(level, reading, sd, repetition, posterior, comparisons))
    return Sensitivity(
        specimen=specimen,
        source=source,
        without_noise=without_noise,
        starts=_STARTS,
        found_again=found_again,
        cells=tuple(cells),
        groups=groups,
        seconds=time.perf_counter() - start,
    )


def _best_start(
    problem: InverseProblem, frequencies: Array, seed: int, executor: Executor | None
) -> tuple[int, int]:
    """The seed of the best of several swarms, and the number of them that end equally well."""
    others = (np.random.SeedSequence([seed, k]).generate_state(1)[0] for k in range(1, _STARTS))
    seeds = [seed, *(int(other) for other in others)]
    values = run(swarm_value, (problem, frequencies), seeds, executor)
    best = int(np.argmin(values))
    return seeds[best], sum(equally_good(value, values[best], frequencies) for value in values)


def _plain(specimen: Specimen, measurement: Measurement) -> Specimen:
    """The specimen with a list paired in ascending order, and sizes known exactly, as in the paper."""
    unlabelled = replace(measurement, labels=("",) * measurement.size, shapes=None)
    return replace(specimen, measurement=unlabelled, plate=replace(specimen.plate, sd={}))


def _collect(inversions: Sequence[Inversion]) -> Repetition:
    return Repetition(
        constants=np.array([i.constants for i in inversions]),
        on_bound=np.array([i.on_bound for i in inversions]),
        lists=np.array([i.frequencies for i in inversions]),
        reordered=float(np.mean([i.reordered for i in inversions])),
        redrawn=sum(i.redrawn for i in inversions),
        converged=sum(i.converged for i in inversions),
        restarted=sum(i.swarms - 1 for i in inversions),
        missed=sum(i.missed for i in inversions),
        solves=sum(i.solves for i in inversions),
    )


def _complete_groups(results: Mapping[int, object], n_pairs: int) -> int:
    """Number of leading groups that were inverted for all pairs, if all posteriors were sampled."""
    first = next(index for index in count() if index not in results)
    return max(first // n_pairs - 1, 0)


def _comparisons(
    repetition: Repetition, posterior: PosteriorSummary, reference: Array, residual: float
) -> tuple[Comparison, ...]:
    mean, sd = repetition.mean, repetition.sd
    offset = (reference - posterior.best) / posterior.sd
    return tuple(
        compare(
            Evidence(
                groups=len(repetition.constants),
                repetition_mean=float(mean[i]),
                repetition_sd=float(sd[i]),
                posterior_mean=float(posterior.mean[i]),
                posterior_sd=float(posterior.sd[i]),
                effective=posterior.effective,
                repetition_at_bound=float(repetition.on_bound[:, i].mean()),
                posterior_at_bound=float(posterior.next_to_bound[i]),
                clusters=clusters(repetition.constants[:, i]),
                peaks=int(posterior.peaks[i]),
                skewness=float(posterior.skewness[i]),
                contraction=float(posterior.contraction[i]),
                reordered=repetition.reordered,
                missed=repetition.missed / len(repetition.constants),
                weighting=float(posterior.swarm_sd[i] / posterior.linearised_sd[i]),
                offset=float(offset[i]),
                residual=residual,
            )
        )
        for i in range(len(mean))
    )


def own_table(specimen: Specimen) -> PrintedTable | None:
    """The paper's table of a built-in specimen, None otherwise: a file of the same name is another plate."""
    is_own = specimen.source == f"built-in {specimen.name}"
    return perturbation_table(specimen.name) if is_own else None


def sensitivity_notices(result: Sensitivity) -> tuple[Notice, ...]:
    """Every reason not to trust the numbers as they stand."""
    return (
        *_of_the_list(result),
        *(notice for cell in result.cells for notice in _of_cell(cell, result.groups)),
        *_left_aside(result),
    )


def _of_the_list(result: Sensitivity) -> Iterator[Notice]:
    rms = result.without_noise.rms
    least = min(cell.level for cell in result.cells)
    if rms > least:
        yield Notice("misfit_beside_noise", facts={"misfit": rms, "level": least})
    if result.source == "model":
        known = reference_constants(result.specimen)
        lost = tuple(
            c.name
            for c in result.without_noise.constants
            if abs(c.value - known[c.name]) > _FOUND_AGAIN * (c.prior.upper - c.prior.lower)
        )
        if lost:
            yield Notice("constants_not_found_again", facts={"names": lost})
    if 2 * result.found_again < result.starts:
        yield Notice("swarms_in_worse_optima", facts={"found": result.found_again, "of": result.starts})


def _of_cell(cell: Cell, groups: int) -> Iterator[Notice]:
    """Notices about a level of noise by one reading."""
    at = {"level": cell.level, "reading": cell.reading, "noise_sd": float(cell.noise_sd[0])}
    found = cell.repetition
    if found.missed:
        yield Notice("inversions_missed", facts={**at, "count": found.missed, "of": groups})
    if not cell.posterior.converged:
        yield Notice("noise_chains", facts={**at, "ess_bulk": cell.posterior.effective})
    for constraint in cell.posterior.constraints:
        yield Notice("noise_posterior_cut", facts={**at, "constraint": constraint})
    if found.converged < groups:
        yield Notice("noise_swarms", facts={**at, "count": groups - found.converged, "of": groups})
    if found.redrawn:
        yield Notice("noise_redrawn", facts={**at, "count": found.redrawn})


def _left_aside(result: Sensitivity) -> Iterator[Notice]:
    """Notices of entries in the plate file that a noise study does not use."""
    specimen = result.specimen
    if specimen.plate.sd:
        yield Notice("sizes_exact", facts={"names": tuple(specimen.plate.sd)})
    if specimen.measurement is not None and specimen.measurement.names_modes:
        yield Notice("labels_not_used")
    unknowns = specimen.unknowns
    normal = tuple(n for n in unknowns.names if not unknowns[n].prior.is_range)
    if normal:
        yield Notice("prior_not_inverted", facts={"names": normal})


def level_percent(level: float) -> float:
    """A level in percent as written, without the rounding of a division by 100."""
    return round(100.0 * level, 10)
