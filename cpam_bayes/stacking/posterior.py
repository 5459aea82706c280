"""The posterior over every stacking sequence on the grid, and of the constants over all of them: a mixture.

Each stacking sequence is a component with its own evidence. Where there are few, every evidence is computed;
where there are many, a surrogate of it is trained first, and it is computed where the probability is. The
constants of the most probable class, and of each with a large probability, are sampled by emcee, started from
a swarm; this checks the importance sampling, whose draws the others keep. Each class is weighted by its
probability.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.errors import PlateFileError
from cpam_bayes.forward_model.build import reduced_model
from cpam_bayes.forward_model.known_errors import common_errors
from cpam_bayes.forward_model.model import (
    PlateModel,
    angle_parameters,
    converged_model,
    model_on_basis,
    plate_problem,
    reference_vector,
)
from cpam_bayes.forward_model.reduced import ReducedModel
from cpam_bayes.forward_model.three_dimensions import (
    THEORY_LEVEL,
    common_theory_errors,
    theory_bias,
    theory_error,
)
from cpam_bayes.identification.search import required
from cpam_bayes.inference.assessment import thinned
from cpam_bayes.inference.ensemble import (
    Diagnostics,
    EnsembleResult,
    EnsembleSettings,
    sample,
    start_positions,
)
from cpam_bayes.inference.importance import Rounds
from cpam_bayes.inference.sampling import arviz_data, by_user_name, hashed, sampled_about, swarm_on_posterior
from cpam_bayes.inference.swarm import SwarmSettings
from cpam_bayes.parallel import counted, run
from cpam_bayes.plate import Measurement, Specimen, angle_grid
from cpam_bayes.running import TimeIsUpError, cut_short, single_blas_thread, time_limit
from cpam_bayes.stacking.conditional import (
    CommonErrors,
    ConditionalFits,
    ConditionalPosterior,
    conditional_posterior,
    fit_conditionals,
)
from cpam_bayes.stacking.evaluation import of_sequence, scan_library, scanned_starts
from cpam_bayes.stacking.queries import GivenLayup
from cpam_bayes.stacking.records import (
    DEFAULT_SETTINGS,
    StackingPosterior,
    StackingProblem,
    StackingSettings,
    merge_indistinguishable,
)
from cpam_bayes.stacking.search import by_surrogate, exhaustive
from cpam_bayes.stacking.symmetry import PlySums, members, plate_symmetries, ply_sums

Array = NDArray[Any]

# Modes computed beyond those measured where the frequency list may lack some.
_SPARE_MODES = 4
# Sequences over which the error of theory is averaged, since it needs a known layup.
_THEORY_SEQUENCES = 32
# Sequences of which the one nearest to the list gives the common errors; members of the library with which
# all are tried, and sequences that are tried with the whole library.
_TRIED, _TRIED_WITH, _TRIED_AGAIN = 128, 12, 12
# Noise against which common errors are judged where none is stated, their least share of it, and the most
# directions of them that are parameters.
_USUAL_NOISE, _COUNTS, _MOST_COMMON = 0.002, 0.5, 3
# Constants from which optimisations may start.
_LIBRARY_SIZE = 96
# Noise of the two common starts, over the largest.
_START_NOISE = (0.05, 0.3)
# Optima with a smaller fraction of a conditional evidence are not used as starts.
_MIN_START_FRACTION = 1e-3


@single_blas_thread
def stacking_posterior(
    specimen: Specimen,
    seed: int,
    *,
    settings: StackingSettings = DEFAULT_SETTINGS,
    executor: Executor | None = None,
    notify: Callable[[str], None] = lambda text: None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> StackingPosterior:
    """Probability of every stacking sequence on the grid of a specimen's unknown angles.

    p(s | f) is proportional to Z_s, the evidence of sequence s: all have the same prior probability. Errors
    of sizes, mass and frequency scale are integrated out of it, as factors of all frequencies.

    progress : called with the numbers of done and of all pieces of the enumeration.

    The result does not depend on the executor. Raises ``ValueError`` if the specimen has no unknown angle,
    no measured frequencies or no unknown constants, or a layup that is unsymmetric or of several kinds of
    plies with too many unknown angles for every sequence to be computed.
    """
    start = time.perf_counter()
    problem = stacking_problem(specimen, seed, settings=settings, executor=executor, notify=notify)
    rng = np.random.default_rng([seed, 4])
    if problem.sums is None or settings.enumerates(problem.n_sequences):
        result = exhaustive(problem, rng, notify)
    else:
        result = by_surrogate(problem, problem.sums, rng, notify, progress)
    if problem.sums is not None:
        with time_limit(None):  # what is known by now is to be told
            result = merge_indistinguishable(result, problem, problem.sums)
    return replace(result, seconds=time.perf_counter() - start)


def stacking_problem(
    specimen: Specimen,
    seed: int,
    *,
    settings: StackingSettings = DEFAULT_SETTINGS,
    executor: Executor | None = None,
    notify: Callable[[str], None] = lambda text: None,
) -> StackingProblem:
    """The problem that ``stacking_posterior`` solves, with its reduced model; raises as that does."""
    measurement, unknowns = required(specimen)
    layup, grid = specimen.plate.layup, angle_grid(specimen.angle_grid_deg)
    sums = sums_of(specimen, settings)
    n_modes = measurement.size + (0 if measurement.complete else _SPARE_MODES)
    parameters = angle_parameters(specimen).union(unknowns)
    model = reduced_model(specimen, parameters, n_modes, bias=theory_bias(specimen), notify=notify)
    by_solver = np.hypot(model.full.error, model.tolerance)
    as_stated = conditional_posterior(model, layup.n_unknown, measurement, by_solver)
    library = scan_library(as_stated, _LIBRARY_SIZE, np.random.default_rng([seed, 8]))
    rng = np.random.default_rng([seed, 10])
    by_theory = _theory_error(specimen, model, grid, rng)
    nearest, constants = _nearest(as_stated, grid, library, rng)
    common, left = _common(_in_common(specimen, model, nearest, constants), measurement)
    error = np.sqrt(by_solver**2 + by_theory**2 + left**2)
    conditional = conditional_posterior(model, layup.n_unknown, measurement, error, common)
    return StackingProblem(
        specimen=specimen,
        conditional=conditional,
        symmetries=plate_symmetries(specimen),
        grid_deg=grid,
        sums=sums,
        starts=common_starts(specimen, conditional),
        library=library,
        settings=settings,
        executor=executor,
    )


def sums_of(specimen: Specimen, settings: StackingSettings = DEFAULT_SETTINGS) -> PlySums | None:
    """Sums over plies of a specimen with unknown angles, None where they do not apply and sequences are few.

    Raises ``PlateFileError`` without an unknown angle, and for a layup with too many that is unsymmetric or
    of several kinds of plies.
    """
    layup, grid = specimen.plate.layup, angle_grid(specimen.angle_grid_deg)
    if not layup.n_unknown:
        raise PlateFileError(
            f"{specimen.source}: plate.layup: received {layup.text}, which has no unknown angle; write "
            '"?" for one'
        )
    few = settings.enumerates(len(grid) ** layup.n_unknown)
    if few and (layup.kinds or not layup.is_symmetric):
        return None
    try:
        return ply_sums(layup, grid)
    except ValueError as error:
        raise PlateFileError(f"{specimen.source}: plate.layup: {error}") from None


def with_angles(specimen: Specimen, angles: Array) -> Specimen:
    """The specimen with given values (k,), degrees, of its unknown angles."""
    layup = specimen.plate.layup.with_angles(angles)
    return replace(specimen, plate=replace(specimen.plate, layup=layup))


def model_of(sequence: Specimen, model: ReducedModel) -> PlateModel:
    """Full model of a specimen with known angles, whose reduced model has them as parameters.

    Where some sequences couple bending with stretching, the space for all is not that of one.
    """
    problem, full = plate_problem(sequence, sequence.unknowns), model.full
    if full.operator.problem.nominal.symmetric and full.basis is not None:
        x = reference_vector(sequence, problem.parameters)[None]
        own = model_on_basis(problem, x, model.n_modes, full.error, full.basis)
    else:
        own = converged_model(sequence, sequence.unknowns, model.n_modes)
    problem = replace(problem, bias=full.operator.problem.bias)
    return replace(own, operator=replace(own.operator, problem=problem))


def _nearest(
    as_stated: ConditionalPosterior, grid: Array, library: Array, rng: np.random.Generator
) -> tuple[Array, Array]:
    """The evenly drawn sequence (k,), degrees, whose frequencies are nearest to the list, fitted to it.

    Second, its constants (n_constants,), at which modes are in the order of the list.
    """
    nearest = np.unique(rng.choice(grid, size=(_TRIED, as_stated.n_angles)), axis=0)
    for some, kept in ((library[:_TRIED_WITH], _TRIED_AGAIN), (library, 1)):
        starts, misfit = scanned_starts(as_stated, nearest, some, 1)
        best = np.argsort(misfit[:, 0], kind="stable")[:kept]
        nearest, starts = nearest[best], starts[best]
    return nearest[0], fit_conditionals(as_stated, nearest, starts).x[0, : as_stated.n_constants]


def _theory_error(specimen: Specimen, model: ReducedModel, grid: Array, rng: np.random.Generator) -> Array:
    """Relative sd (n_modes,) of first-order theory: root mean square over sequences of the grid.

    The common error by free edges, which differs between sequences, counts as scatter of single modes.
    """
    layup, squared = specimen.plate.layup, np.zeros(model.n_modes)
    of_clamps = common_theory_errors(specimen)[THEORY_LEVEL]
    x = reference_vector(specimen, model.parameters)
    for angles in rng.choice(grid, size=(_THEORY_SEQUENCES, layup.n_unknown)):
        x[: layup.n_unknown] = angles
        one = with_angles(specimen, angles)
        squared += theory_error(one, model.predict(x[None]).frequencies[0]) ** 2
        squared += common_theory_errors(one)[THEORY_LEVEL] ** 2 - of_clamps**2
    return np.asarray(np.sqrt(squared / _THEORY_SEQUENCES))


def _in_common(specimen: Specimen, model: ReducedModel, angles: Array, constants: Array) -> Array:
    """Common relative errors (n_errors, n_modes) of a sequence (k,) at its constants (n_constants,).

    One standard deviation of each: of sizes, mass, frequency scale and theory, as of ``common_errors``.
    """
    one = with_angles(specimen, angles)
    own = model_of(one, model)
    values = dict(zip(specimen.unknowns.names, map(float, constants), strict=True))
    return np.array(list(common_errors(one, own, values, np.arange(model.n_modes)).values()))


def _common(errors: Array, measurement: Measurement) -> tuple[CommonErrors, Array]:
    """Principal directions of relative errors (k, n), and the scatter (n,) of each mode by the rest.

    Thickness, mass and scale move all frequencies nearly alike: one factor has nearly all of it. Directions
    that are small beside the noise count as scatter.
    """
    relative = _USUAL_NOISE if measurement.relative_std is None else measurement.relative_std
    noise = measurement.noise_sd(relative) / measurement.frequencies
    _, sizes, directions = np.linalg.svd(errors, full_matrices=False)
    along = (sizes[:, None] * directions)[:_MOST_COMMON]
    sd = np.sqrt(np.mean(along**2, axis=1))
    counts = sd >= _COUNTS * noise.min()
    along, sd = along[counts], sd[counts]
    sign = np.where(along.sum(axis=1) < 0.0, -1.0, 1.0)
    left = np.sqrt(np.maximum(np.sum(errors**2, axis=0) - np.sum(along**2, axis=0), 0.0))
    return CommonErrors(sd, along * (sign / sd)[:, None]), left


def common_starts(specimen: Specimen, conditional: ConditionalPosterior) -> Array:
    """Starts (2, n) of every optimisation: the reference constants with little noise, the middle with much.

    Raises ``ValueError`` if neither satisfies the constraints (9).
    """
    p, template = conditional.parameters, conditional.template
    n = conditional.n_constants
    starts = np.ones((2, p.size))
    starts[0, :n] = reference_vector(specimen, template.model.parameters)[:n]
    starts[1, :n] = 0.5 * (p.lower[:n] + p.upper[:n])
    if template.noise_is_inferred:
        prior = p.parameters[-1].prior
        starts[:, -1] = np.clip(np.multiply(_START_NOISE, prior.upper), prior.lower, prior.upper)
    inside = np.isfinite(template.log_prior(starts))
    if not inside.any():
        raise ValueError(
            f"{specimen.source}: neither the reference constants nor the middle of [unknowns] meet the "
            "constraints (9); move the bounds"
        )
    return starts[inside][[0, -1]]


@dataclass(frozen=True, slots=True)
class MixtureSettings:
    """Settings of the sampling of the mixture.

    least : least probability of a class that is sampled by emcee; the most probable one always is.
    ensembles, swarm : for each class.
    rounds : of the importance sampling with which each is compared, and whose proposal its chains jump to.
    draws : number from the whole mixture.
    """

    least: float = 0.1
    ensembles: EnsembleSettings = field(
        default_factory=lambda: EnsembleSettings(
            walkers=32, round_steps=60, r_hat=1.02, effective=400.0, most_steps=3000, lengths=8.0, jumps=0.8
        )
    )
    swarm: SwarmSettings = field(default_factory=lambda: SwarmSettings(particles=16, iterations=20))
    rounds: Rounds = Rounds(log2_points=9, most=8, least=2, enough=1500.0, steady=0.02)  # noqa: RUF009
    draws: int = 4000


MIXTURE_SETTINGS = MixtureSettings()
EMCEE, IMPORTANCE = "emcee", "importance sampling"
"""Methods by which the draws of a class are sampled."""


@dataclass(frozen=True, slots=True)
class Moments:
    """Means and standard deviations of n parameters, and their standard errors, (n,) each."""

    mean: Array
    sd: Array
    mean_error: Array
    sd_error: Array


@dataclass(frozen=True, slots=True)
class SampledComponent:
    """The conditional posterior of one class of sequences, by emcee and by importance sampling.

    index : of the class in ``StackingPosterior.top``.
    draws : (d, n) of the chains, about one per autocorrelation time.
    chains, importance : moments by either method.
    log_evidence, log_evidence_error : by importance sampling, nats.
    effective, k_hat : effective number of its draws, and shape of its largest weights.
    """

    index: int
    draws: Array
    diagnostics: Diagnostics
    chains: Moments
    importance: Moments
    log_evidence: float
    log_evidence_error: float
    effective: float
    k_hat: float

    @property
    def worst_z(self) -> float:
        """Largest difference of a mean or an sd between emcee and importance sampling, in standard errors."""
        a, b = self.chains, self.importance
        z_mean = (a.mean - b.mean) / np.hypot(a.mean_error, b.mean_error)
        z_sd = (a.sd - b.sd) / np.hypot(a.sd_error, b.sd_error)
        return float(np.max(np.abs(np.concatenate((z_mean, z_sd)))))


@dataclass(frozen=True, slots=True)
class StackingMixture:
    """Equally probable draws of stacking sequence and constants.

    components : the classes sampled by emcee.
    given : a requested sequence, sampled too; its index is -1 where it is not listed.
    parameters : (m, n) SI.
    angles_deg : (m, k).
    origin : (m,) index of the draw's class in ``StackingPosterior.top``, -1 for an unlisted one.
    by_emcee : (m,) bool.
    emcee_fraction : probability of the classes sampled by emcee.
    listed_fraction : probability of the other listed classes.
    drawn_fraction : probability of all the rest, represented by sequences drawn from it.
    """

    components: tuple[SampledComponent, ...]
    given: SampledComponent | None
    parameters: Array
    angles_deg: Array
    origin: Array
    by_emcee: Array
    emcee_fraction: float
    listed_fraction: float
    drawn_fraction: float
    seconds: float

    @property
    def converged(self) -> bool:
        """Whether all chains have converged."""
        return all(c.diagnostics.converged for c in self.sampled)

    @property
    def sampled(self) -> tuple[SampledComponent, ...]:
        """All components sampled by emcee, the requested sequence included."""
        if self.given is None or any(c.index == self.given.index for c in self.components):
            return self.components
        return (*self.components, self.given)


def n_sampled_classes(answer: StackingPosterior, settings: MixtureSettings = MIXTURE_SETTINGS) -> int:
    """Number of leading classes that emcee samples, up to the last one with enough probability.

    Classes are in the order of the evidence of one sequence: a class of many may follow classes of few.
    """
    enough = answer.probability * answer.multiplicity >= settings.least
    return int(max(np.flatnonzero(enough), default=0)) + 1


@single_blas_thread
def sample_mixture(
    answer: StackingPosterior,
    seed: int,
    *,
    given: GivenLayup | None = None,
    settings: MixtureSettings = MIXTURE_SETTINGS,
    executor: Executor | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> StackingMixture:
    """Draws from the posterior of stacking sequence and constants together.

    p(x, s | f) = p(s | f) p(x | s, f).

    given : a sequence to be sampled whatever its probability.
    progress : called with the numbers of sampled and of all classes.

    The same seed gives the same draws whatever the executor.
    """
    start = time.perf_counter()
    n = n_sampled_classes(answer, settings)
    items = [
        (i, answer.top[i], answer.components.fits[i : i + 1], [seed, 6, i])  # numpy takes lists as seeds
        for i in range(n)
    ]
    extra = given is not None and (given.index is None or given.index >= n)
    if given is not None and extra:
        index = len(answer.top) if given.index is None else given.index
        items.append((index, given.angles_deg, given.fits, [seed, 6, index]))
    shared, count = (answer.conditional, settings), counted(progress, len(items))
    results: dict[int, SampledComponent] = {}

    def keep(index: int, component: SampledComponent) -> None:
        results[index] = component
        count(index, component)

    try:
        run(_sampled, shared, items, executor, batch_size=1, on_result=keep, is_limited=True)
    except TimeIsUpError:
        wanted, n = n, next(i for i in range(n + 1) if i not in results)
        if not n:
            keep(0, run(_sampled, shared, items[:1], executor)[0])
            n = 1
        cut_short("cut_sequences", done=n, of=wanted)
        given = None if extra or (given and (given.index or 0) >= n) else given
    components, given_component = tuple(results[i] for i in range(n)), None
    if given is not None:
        given_component = results[n] if extra else results[given.index or 0]
        if given.index is None:
            given_component = replace(given_component, index=-1)
    rng = np.random.default_rng([seed, 7])
    return _combined(answer, components, given_component, settings.draws, rng, start)


Item = tuple[int, Array, ConditionalFits, list[int]]


def _sampled(shared: tuple[ConditionalPosterior, MixtureSettings], item: Item) -> SampledComponent:
    """Sampled conditional posterior of one class; item : its index, angles, fits and key of the seed."""
    conditional, settings = shared
    index, angles, fits, key = item
    posterior = of_sequence(conditional, angles, conditional.least_noise(fits.x)).at(angles[None])
    seed = int(np.random.SeedSequence(key).generate_state(1)[0])
    rng = np.random.default_rng([seed, 1])
    bests, _, _ = swarm_on_posterior(posterior, seed, settings.swarm)
    # the swarm searches everywhere; the optima of the evidence are added so that none is missed
    optima = conditional.axes.to_x(fits.optima[0])
    starts = np.concatenate((optima[fits.weight[0] > _MIN_START_FRACTION][:, : bests.shape[1]], bests))
    n_walkers = settings.ensembles.ensembles * settings.ensembles.walkers
    # the optima first, then the particles, the best first: their misfits only order them
    walkers = start_positions(posterior, starts, np.arange(len(starts), dtype=float), n_walkers, rng)
    start = walkers.reshape(settings.ensembles.ensembles, settings.ensembles.walkers, -1)
    proposal, found, _ = sampled_about(posterior, optima, settings.rounds)
    chains = sample(posterior, start, seed, settings.ensembles, proposal=proposal)
    return SampledComponent(
        index=index,
        draws=thinned(chains).flat,
        diagnostics=chains.diagnostics,
        chains=_moments_of_chains(chains),
        importance=_moments_of_weighted(posterior.scores.to_x(found.points[0]), found.weight[0]),
        log_evidence=float(found.log_evidence[0]),
        log_evidence_error=float(found.standard_error[0]),
        effective=float(found.effective_size[0]),
        k_hat=float(found.k_hat[0]),
    )


def _moments_of_chains(chains: EnsembleResult) -> Moments:
    draws, effective = chains.draws, chains.diagnostics.ess_bulk
    mean, sd = draws.mean(axis=0), draws.std(axis=0)
    kurtosis = np.mean(((draws - mean) / sd) ** 4, axis=0)
    return Moments(mean, sd, sd / np.sqrt(effective), sd * np.sqrt((kurtosis - 1.0) / (4.0 * effective)))


def _moments_of_weighted(x: Array, weight: Array) -> Moments:
    """Moments of draws (p, n) with weights (p,)."""
    mean = weight @ x
    deviation = x - mean
    sd = np.sqrt(weight @ deviation**2)
    mean_error = np.sqrt(weight**2 @ deviation**2)
    sd_error = np.sqrt(weight**2 @ (deviation**2 - sd**2) ** 2) / (2.0 * sd)
    return Moments(mean, sd, mean_error, sd_error)


def _combined(
    answer: StackingPosterior,
    components: tuple[SampledComponent, ...],
    given: SampledComponent | None,
    size: int,
    rng: np.random.Generator,
    start: float,
) -> StackingMixture:
    n, listed = len(components), len(answer.top)
    mass = answer.probability * answer.multiplicity
    rest = np.flatnonzero(answer.classes_of(answer.drawn.sequences) < 0)
    drawn_fraction = max(1.0 - float(mass.sum()), 0.0) if len(rest) else 0.0
    drawn = answer.draw_weight[rest]
    weight = np.concatenate((mass, drawn_fraction * drawn / max(float(drawn.sum()), 1e-300)))
    weight = weight / weight.sum()
    # systematic resampling: each component in proportion to its weight, to within one
    at = (np.arange(size) + rng.uniform()) / size
    chosen = np.minimum(np.searchsorted(np.cumsum(weight), at), len(weight) - 1)
    parameters, sequences = [], []
    for i in np.unique(chosen):
        number = int(np.sum(chosen == i))
        if i < listed:
            draws = components[i].draws if i < n else answer.components.conditionals.draws[i]
            same_class = answer.class_members(i)
        else:
            draws = answer.drawn.conditionals.draws[rest[i - listed]]
            same_class = members(answer.drawn.sequences[rest[i - listed]], answer.symmetries)
        parameters.append(draws[_spread(len(draws), number, rng)])
        sequences.append(same_class[rng.integers(len(same_class), size=number)])
    # shuffled, so that any part of the draws is a sample of the whole
    order = rng.permutation(size)
    return StackingMixture(
        components=components,
        given=given,
        parameters=np.concatenate(parameters)[order],
        angles_deg=answer.grid_deg[np.concatenate(sequences)[order]],
        origin=np.where(chosen < listed, chosen, -1)[order],
        by_emcee=(chosen < n)[order],
        emcee_fraction=float(weight[:n].sum()),
        listed_fraction=float(weight[n:listed].sum()),
        drawn_fraction=float(weight[listed:].sum()),
        seconds=time.perf_counter() - start,
    )


def _spread(pool: int, number: int, rng: np.random.Generator) -> Array:
    """Rows (number,) of a pool of draws, each used once before any is used again."""
    rounds = [rng.permutation(pool) for _ in range(-(-number // pool))]
    return np.concatenate(rounds)[:number]


def inference_data(answer: StackingPosterior, mixture: StackingMixture, command: str, seed: int) -> Any:
    """The mixture for arviz, an ``xarray.DataTree``.

    Groups: posterior, one chain of equally probable draws in random order: the constants by the names and
    units of the plate file, angle_deg over `ply` (the unknown angles from the bottom), component, the draw's
    class in the list (-1: unlisted); sample_stats, the method that sampled each draw; constant_data, the list
    itself over `sequence` with probabilities, log evidences and their errors, and the marginals of the
    angles over `ply` and `angle`; observed_data, the measured frequencies over `mode`. Attributes: command,
    versions, plate, seed, hash of the problem, size of the credible set.
    """
    shown = answer.conditional.shown
    names = tuple(answer.conditional.parameters.names[i] for i in shown)
    frequencies = answer.conditional.template.measurement.frequencies
    data = arviz_data(
        command,
        answer.specimen,
        seed,
        names,
        {
            **hashed(answer.conditional.at(answer.top[:1])),
            "layup": answer.specimen.plate.layup.text,
            "enumerated": answer.enumerated,
            "credible_95_count": answer.credible_count,
            "effective_count": answer.effective_count,
            "unaccounted_probability": answer.unaccounted,
            "log_evidence": answer.log_evidence_total,
            "probability_by_emcee": mixture.emcee_fraction,
            "probability_by_importance_sampling": mixture.listed_fraction,
            "probability_by_drawn_sequences": mixture.drawn_fraction,
        },
        {
            "posterior": {
                **by_user_name(names, mixture.parameters[None][..., shown]),
                "angle_deg": mixture.angles_deg[None],
                "component": mixture.origin[None],
            },
            "sample_stats": {"sampled_by": np.where(mixture.by_emcee, EMCEE, IMPORTANCE)[None]},
            "observed_data": {"frequencies_hz": frequencies},
            "constant_data": {
                "sequence_angle_deg": answer.top,
                "sequence_probability": answer.probability,
                "sequence_multiplicity": answer.multiplicity,
                "sequence_log_evidence": answer.log_evidence,
                "sequence_log_evidence_error": answer.log_evidence_error,
                "angle_marginal": answer.marginals,
            },
        },
        dims={
            "angle_deg": ["ply"],
            "frequencies_hz": ["mode"],
            "sequence_angle_deg": ["sequence", "ply"],
            "angle_marginal": ["ply", "angle"],
            **{
                f"sequence_{what}": ["sequence"]
                for what in ("probability", "multiplicity", "log_evidence", "log_evidence_error")
            },
        },
        coords={
            "ply": np.arange(1, answer.conditional.n_angles + 1),
            "mode": np.arange(1, len(frequencies) + 1),
            "sequence": np.arange(1, len(answer.top) + 1),
            "angle": answer.grid_deg,
        },
    )
    data.posterior["angle_deg"].attrs["unit"] = "deg"
    return data
