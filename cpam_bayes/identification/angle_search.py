"""Ply angles and constants of a specimen: the paper's fuzzy swarm, and plain enumeration.

A parameter vector holds the unknown constants in their order and then the unknown angles, which are
on the grid of eq. (10). F is that of eq. (7), measured and predicted frequencies paired in ascending
order; the labels of a list are not used.

For a given sequence only the constants are sought: a bounded least-squares problem in four or five
unknowns. All problems of a stack take their damped Gauss-Newton steps together (``maximise``), so that
the model is called once per iteration.

Where two modes cross, sorted frequencies have a kink and steps shrink before the minimum is reached.
Three starts are enough on C1: against fourteen, one of thirty sequences was left 2e-5 of F too high.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.forward_model.build import reduced_model
from cpam_bayes.forward_model.model import (
    ForwardModel,
    angle_parameters,
    discretisation_error,
    reference_vector,
)
from cpam_bayes.forward_model.reduced import ReducedModel, basis_error
from cpam_bayes.identification.search import (
    FOUND_AGAIN,
    LEAST_RMS,
    LEAST_SWARMS,
    Residual,
    misfit,
    required,
    shifted,
    swarm_seed,
)
from cpam_bayes.inference.optimise import maximise
from cpam_bayes.inference.scores import Expansion
from cpam_bayes.inference.swarm import (
    SwarmProblem,
    SwarmResult,
    SwarmSettings,
    material_swarm,
    minimise_problem,
)
from cpam_bayes.parallel import run
from cpam_bayes.parameters import ParameterSet
from cpam_bayes.plate import Specimen, angle_grid
from cpam_bayes.running import single_blas_thread

Array = NDArray[Any]

# (m, n_constants), (m, k) degrees -> frequencies (m, n_modes), their derivatives (m, n_modes, n_constants).
SequenceModel = Callable[[Array, Array], tuple[Array, Array]]
Feasible = Callable[[Array], NDArray[np.bool_]]


@dataclass(frozen=True, slots=True)
class ConditionalFit:
    """The best constants of m sequences.

    constants : (m, n_constants) SI. values : (m,) F at them. evaluations : parameter sets sent to the
    model, each with derivatives. settled : (m,) bool, True if no step lowers F by more than the tolerance.
    """

    constants: Array
    values: Array
    evaluations: int
    settled: NDArray[np.bool_]


def fit_constants(
    model: SequenceModel,
    feasible: Feasible,
    angles_deg: Array,
    starts: Array,
    measured: Array,
    lower: Array,
    upper: Array,
    *,
    weight: Array | None = None,
    iterations: int = 40,
    tolerance: float = 1e-9,
) -> ConditionalFit:
    """Constants in a box that minimise F = sum w_i (f_i - measured_i)^2, one set for each sequence.

    Each sequence starts from every row of ``starts``, and the lowest F is kept: F has several minima
    where modes cross. A step that leaves the constraints (9) is not taken.

    angles_deg : (m, k), one row per sequence. starts : (s, n_constants), feasible. measured : (n_modes,)
    Hz. lower, upper : (n_constants,). weight : (n_modes,), by default 1. tolerance : relative decrease
    of F under which a problem is settled.

    Raises ``ValueError`` if a start is not feasible or lies outside the box.
    """
    m, s = len(angles_deg), len(starts)
    if not (np.all(starts >= lower) and np.all(starts <= upper) and np.all(feasible(starts))):
        raise ValueError(
            f"starts of the constants: received {starts.tolist()}, accepted: sets within the bounds "
            "that meet eq. (9)"
        )
    root = np.ones_like(measured) if weight is None else np.sqrt(weight)
    angles = np.repeat(angles_deg, s, axis=0)
    width = upper - lower
    n = len(width)
    evaluations = 0

    def target(z: Array, rows: Array) -> Expansion:
        """-log F in the unit box, its gains being relative decreases of F, with Gauss-Newton curvature."""
        nonlocal evaluations
        x = lower + width * z
        inside = np.flatnonzero(feasible(x))
        expansion = Expansion(np.full(len(z), -np.inf), np.zeros((len(z), n)), np.zeros((len(z), n, n)))
        if len(inside):
            frequencies, jacobian = model(x[inside], angles[rows[inside]])
            evaluations += len(inside)
            r, j = root * (frequencies - measured), root[:, None] * jacobian * width
            f = np.maximum(np.sum(r**2, axis=1), 1e-300)
            expansion.value[inside] = -np.log(f)
            expansion.gradient[inside] = -2.0 * np.einsum("mij,mi->mj", j, r) / f[:, None]
            expansion.curvature[inside] = 2.0 * np.swapaxes(j, 1, 2) @ j / f[:, None, None]
        return expansion

    start = np.tile((starts - lower) / width, (m, 1))
    bounds = np.zeros(n), np.ones(n)
    maxima = maximise(target, start, *bounds, most_steps=iterations, promised=tolerance)
    f = np.exp(-maxima.expansion.value)
    best = f.reshape(m, s).argmin(axis=1) + s * np.arange(m)
    settled = maxima.converged | (maxima.steps < iterations)
    return ConditionalFit(lower + width * maxima.u[best], f[best], evaluations, settled[best])


# Sequences fitted together, which a worker takes at a time.
_TOGETHER = 128
# Constants, beside those of the swarm, from which the fit for its angles starts.
_STARTS = 3
# Two swarms found the same optimum where their F differ by less than this fraction.
_SAME_F = 1e-3


@dataclass(frozen=True, slots=True)
class AngleSearchProblem:
    """The objective of the search: frequencies of a plate against a list.

    model : of the constants, then the angles of ``specimen``. measured : (n,) Hz, paired with the
    first n modes. grid_deg : (n_angles,).
    """

    specimen: Specimen
    model: ForwardModel
    measured: Array
    grid_deg: Array
    residual: Residual = "absolute"

    @property
    def unknowns(self) -> ParameterSet:
        """The unknown constants."""
        return self.specimen.unknowns

    @property
    def n_plies(self) -> int:
        """Number of unknown angles."""
        return self.specimen.plate.layup.n_unknown

    def admissible(self, constants: Array) -> NDArray[np.bool_]:
        """Mask (m,) of constants (m, n_constants) that meet the constraints (9)."""
        angles = np.zeros((len(constants), self.n_plies))
        return np.asarray(self.model.admissible(np.hstack((constants, angles))))

    def values(self, constants: Array, sequences: Array) -> Array:
        """F (m,) at constants (m, n_constants) and grid indices (m, n_plies)."""
        x = np.hstack((constants, self.grid_deg[sequences]))
        predicted = self.model.predict(x).frequencies[:, : len(self.measured)]
        return misfit(predicted, self.measured, self.residual)


@dataclass(frozen=True, slots=True)
class AngleSearchResult:
    """Result of the fuzzy swarm for one specimen.

    angles_deg : (n_plies,)
    constants : SI, by name
    value : F, Hz^2, or without unit where residuals are relative
    predicted : (n,) Hz on the full model
    rms : root mean square of its relative residuals
    error : (n,) estimated relative error of the solver and of its reduced basis there
    swarm : the single one, or of several the one with the least F and the status of them all
    values : (n_swarms,) least F for the angles that each swarm ended at, ascending
    """

    specimen: Specimen
    angles_deg: Array
    constants: Mapping[str, float]
    value: float
    predicted: Array = field(repr=False)
    rms: float
    error: Array = field(repr=False)
    model: ReducedModel = field(repr=False)
    swarm: SwarmResult
    values: tuple[float, ...]
    seconds: float

    @property
    def known(self) -> Specimen:
        """The specimen with these angles."""
        plate = self.specimen.plate
        return replace(self.specimen, plate=replace(plate, layup=plate.layup.with_angles(self.angles_deg)))


def search_parameters(specimen: Specimen) -> ParameterSet:
    """The unknown constants of a specimen, then its unknown angles in degrees.

    Raises ``ValueError`` if no angle of the layup is unknown.
    """
    layup = specimen.plate.layup
    if not layup.n_unknown:
        raise ValueError(
            f'{specimen.source}: received the known layup {layup.text}, accepted: one with "?" plies; '
            'write "?" for each unknown angle'
        )
    return specimen.unknowns.union(angle_parameters(specimen))


def fuzzy_problem(fit: AngleSearchProblem) -> SwarmProblem:
    """Problem of the fuzzy swarm: the search for constants and a sequence."""
    return SwarmProblem(
        objective=fit.values,
        feasible=fit.admissible,
        lower=fit.unknowns.lower,
        upper=fit.unknowns.upper,
        n_plies=fit.n_plies,
        n_angles=len(fit.grid_deg),
    )


def run_swarm(
    fit: AngleSearchProblem,
    seed: int | Sequence[int],
    settings: SwarmSettings | None = None,
    progress: Callable[[int, float], None] | None = None,
) -> SwarmResult:
    """One run of the fuzzy swarm from the initial population of section 5.1.

    Raises ``ValueError`` if no particle is feasible.
    """
    settings = settings or SwarmSettings()
    rng = np.random.default_rng(seed)
    start = material_swarm(fit.specimen.material, fit.unknowns, settings.particles, rng)
    return minimise_problem(fuzzy_problem(fit), start, settings, rng, progress=progress)


def run_swarms(
    fit: AngleSearchProblem,
    seeds: Sequence[int],
    settings: SwarmSettings | None = None,
    executor: Executor | None = None,
) -> list[SwarmResult]:
    """Runs of the fuzzy swarm from several seeds, distributed over an executor's workers.

    Raises as ``run_swarm``.
    """
    return run(_swarm_of_seed, fit, [(seed, settings) for seed in seeds], executor)


def _swarm_of_seed(fit: AngleSearchProblem, item: tuple[int, SwarmSettings | None]) -> SwarmResult:
    return run_swarm(fit, *item)


@single_blas_thread
def search_angles(
    specimen: Specimen,
    seed: int,
    *,
    swarms: int = 1,
    settings: SwarmSettings | None = None,
    residual: Residual = "absolute",
    progress: Callable[[int, float], None] | None = None,
    notify: Callable[[str], None] = lambda text: None,
) -> AngleSearchResult:
    """Ply angles and constants of a specimen by the fuzzy swarm of the paper, or by several.

    Several run until two have found the least F of all, after derivatives have fitted the constants for the
    angles that each ended at. Swarms run on the reduced model for any layup; the reported values of the best
    answer are by the full one. ``notify`` is called before long steps that precede the swarm. Raises
    ``ValueError`` if the specimen has no measured frequencies, no unknown constants or no unknown angles, or
    if no particle is feasible.

    swarms : largest number; 1 is the paper's single swarm as it ends, its constants not fitted
    """
    start = time.perf_counter()
    measurement, unknowns = required(specimen)
    parameters = search_parameters(specimen)
    model = reduced_model(specimen, parameters, measurement.size, notify=notify)
    grid = angle_grid(specimen.angle_grid_deg)
    fit = AngleSearchProblem(specimen, model, measurement.frequencies, grid, residual)
    if swarms == 1:
        swarm = run_swarm(fit, seed, settings, progress)
        values: tuple[float, ...] = (swarm.value,)
    else:
        swarm, values = _several(fit, seed, swarms, settings or SwarmSettings(), progress)
    best = np.concatenate((swarm.best, grid[swarm.sequence]))
    predicted = model.full.predict(best).frequencies[0]
    return AngleSearchResult(
        specimen=specimen,
        angles_deg=grid[swarm.sequence],
        constants=dict(zip(unknowns.names, swarm.best.tolist(), strict=True)),
        value=swarm.value,
        predicted=predicted,
        rms=float(np.sqrt(np.mean((predicted / measurement.frequencies - 1.0) ** 2))),
        error=discretisation_error(model.full, best) + basis_error(model, best)[0],
        model=model,
        swarm=swarm,
        values=values,
        seconds=time.perf_counter() - start,
    )


def _several(
    fit: AngleSearchProblem,
    seed: int,
    most: int,
    settings: SwarmSettings,
    progress: Callable[[int, float], None] | None,
) -> tuple[SwarmResult, tuple[float, ...]]:
    """Swarms until two have found the least F: the best with the status of all, and the least F of each."""
    starts = search_starts(fit, _STARTS)
    scale = 1.0 if fit.residual == "relative" else float(fit.measured.max())
    rounding = len(fit.measured) * (LEAST_RMS * scale) ** 2
    ends: list[SwarmResult] = []
    for k in range(most):
        watched = shifted(progress, k * settings.iterations)
        swarm = run_swarm(fit, swarm_seed(seed, k), settings, watched)
        fitted = best_constants(fit, swarm.sequence[None], np.vstack((swarm.best, starts)))
        evaluations = swarm.evaluations + fitted.evaluations
        if fitted.values[0] < swarm.value:
            swarm = replace(swarm, best=fitted.constants[0], value=float(fitted.values[0]))
        ends.append(replace(swarm, evaluations=evaluations))
        least = min(end.value for end in ends)
        again = sum(end.value <= (1.0 + _SAME_F) * least + rounding for end in ends)
        if k + 1 >= LEAST_SWARMS and again >= FOUND_AGAIN:
            break
    best = min(ends, key=lambda end: end.value)
    agreed = again >= FOUND_AGAIN
    chosen = replace(
        best,
        evaluations=sum(end.evaluations for end in ends),
        status="converged" if agreed else "budget",
        message=_MESSAGES[agreed].format(run=len(ends), swarms=again),
    )
    return chosen, tuple(sorted(end.value for end in ends))


_MESSAGES: Final = {
    True: "{swarms} of {run} fuzzy swarms found angles of this F; none found a smaller one",
    False: (
        "the least F of {run} fuzzy swarms was found by one of them alone: other angles may fit better; "
        "`sequence` compares all on the grid"
    ),
}


def search_starts(fit: AngleSearchProblem, n: int) -> Array:
    """Constants (n, n_constants) from which fits start: the reference ones, then n - 1 of section 5.1.

    The reference is left out where it does not meet the constraints (9) within the bounds.
    """
    drawn = material_swarm(fit.specimen.material, fit.unknowns, 8 * n, np.random.default_rng(0))
    both = np.vstack((reference_vector(fit.specimen, fit.unknowns), drawn))
    return np.asarray(both[fit.admissible(both)][:n])


def best_constants(
    fit: AngleSearchProblem, sequences: Array, starts: Array, executor: Executor | None = None
) -> ConditionalFit:
    """Constants that minimise F for each of m sequences (m, n_plies): the step of plain enumeration.

    starts : (s, n_constants), for instance of ``search_starts``. Raises as ``fit_constants``.
    """
    parts = [sequences[first : first + _TOGETHER] for first in range(0, len(sequences), _TOGETHER)]
    fitted = run(_fitted, (fit, starts), parts, executor)
    return ConditionalFit(
        np.concatenate([p.constants for p in fitted]),
        np.concatenate([p.values for p in fitted]),
        sum(p.evaluations for p in fitted),
        np.concatenate([p.settled for p in fitted]),
    )


def _fitted(shared: tuple[AngleSearchProblem, Array], sequences: Array) -> ConditionalFit:
    fit, starts = shared
    n, n_modes = fit.unknowns.size, len(fit.measured)

    def model(constants: Array, angles: Array) -> tuple[Array, Array]:
        found = fit.model.predict(np.hstack((constants, angles)), jacobian=True)
        assert found.jacobian is not None
        return found.frequencies[:, :n_modes], found.jacobian[:, :n_modes, :n]

    return fit_constants(
        model,
        fit.admissible,
        fit.grid_deg[sequences],
        starts,
        fit.measured,
        fit.unknowns.lower,
        fit.unknowns.upper,
        weight=None if fit.residual == "absolute" else fit.measured**-2.0,
    )
