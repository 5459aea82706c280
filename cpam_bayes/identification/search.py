"""Minimum of a plate's misfit by the paper's swarm, alone or several, each polished by derivatives.

The particles of a converged swarm agree, but perhaps on the wrong one of two optima. Several swarms are
therefore run, their first and last positions are optimised by damped Gauss-Newton steps, and the best optimum
counts when two swarms have found it.

Also the posterior of a plate file, and the swarm from which its ensembles start.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.errors import checked
from cpam_bayes.forward_model.build import Neighbour, basis_tolerance, reduced_model
from cpam_bayes.forward_model.known_errors import tolerant
from cpam_bayes.forward_model.labels import labelled_model, list_order, spare_modes
from cpam_bayes.forward_model.model import (
    discretisation_error,
    reference_vector,
    size_parameters,
    with_references,
)
from cpam_bayes.forward_model.preconditions import explained_failures, require_choice, require_supported
from cpam_bayes.forward_model.reduced import ReducedModel, ReductionSettings
from cpam_bayes.forward_model.three_dimensions import theory_bias
from cpam_bayes.identification.density import residual_sd, scatter
from cpam_bayes.inference.optimise import maximise, polish
from cpam_bayes.inference.posterior import Likelihood, Posterior, plate_posterior
from cpam_bayes.inference.sampling import swarm_on_posterior
from cpam_bayes.inference.scores import Expansion, distinct
from cpam_bayes.inference.swarm import SwarmResult, SwarmSettings, material_swarm, minimise
from cpam_bayes.mechanics.problem import THEORY_ALONE, Bias
from cpam_bayes.parameters import ParameterSet
from cpam_bayes.plate import Measurement, PlateLike, Specimen, read_plate
from cpam_bayes.running import cut_short, is_time_up, single_blas_thread

NO_MESH: Final = (
    "identify computes rectangular plates only; leave mesh out, or compute this plate's frequencies "
    "from its reference constants: forward --solver fem"
)

Array = NDArray[Any]
Residual = Literal["absolute", "relative", "whitened"]

# Most swarms, fewest swarms, and how many of them have to find the best optimum.
MOST_SWARMS, LEAST_SWARMS, FOUND_AGAIN = 12, 3, 2
# Relative error of the plate model at the answer above which the model is converged anew there.
_ACCEPTED_ERROR = 5e-4
# Most models of a search, and the fraction of the error before above which a model converged at the answer is
# as good as any.
_MOST_MODELS, _LOWER_ERROR = 3, 0.7
# Constants that differ by less than this, relative, have the same error of the plate model.
_SAME_PLACE = 1e-3
# Half the width of a search interval in standard deviations of a uniform density over it.
_HALF_WIDTH = 3.0**0.5
# Steps of a polishing; distance of equal optima, standard deviations at the noise of the best one.
_STEPS, _SAME = 40, 1.0
# Optima this far above the best misfit, in units of the noise, are dropped.
_DEPTH = 50.0
# Least rms misfit, relative to the highest frequency, that counts as noise: rounding of exact lists.
LEAST_RMS = 1e-7


@dataclass(frozen=True, slots=True)
class Optimum:
    """A local minimum of the misfit.

    x : (n,) constants
    value : the misfit there
    swarms : number of swarms that found it
    """

    x: Array
    value: float
    swarms: int


@dataclass(frozen=True, slots=True)
class Search:
    """The optima that swarms found and the plate model that they ran on.

    swarm : the single swarm, or the first of several with the best optimum and the status of them all
    error : (n_modes,) relative error of the solver at its best particle
    centre : of the model, as of ``reduced_model``
    optima : distinct ones, the best first; of a single swarm its best particle
    swarms : number that were run
    """

    model: ReducedModel
    swarm: SwarmResult
    error: Array
    centre: Array | None
    optima: tuple[Optimum, ...]
    swarms: int


def misfit(predicted: Array, measured: Array, residual: Residual) -> Array:
    """F of eq. (7), the sum of squared differences of frequencies, Hz^2; or of relative ones.

    predicted (m, n), measured (n,) -> (m,).
    """
    difference = predicted - measured
    if residual == "relative":
        difference = difference / measured
    return np.asarray(np.sum(difference**2, axis=-1))


def required(specimen: Specimen) -> tuple[Measurement, ParameterSet]:
    """Measured frequencies and unknowns of a specimen; ``ValueError`` if it lacks either."""
    if specimen.measurement is None:
        raise ValueError(f"{specimen.source}: [measurement] is missing, nothing to identify from")
    if not specimen.unknowns.size:
        raise ValueError(f"{specimen.source}: [unknowns] is missing, nothing to identify")
    return specimen.measurement, specimen.unknowns


@single_blas_thread
def search(
    specimen: Specimen,
    seed: int,
    *,
    swarms: int = 1,
    spare: int = 0,
    settings: SwarmSettings | None = None,
    residual: Residual = "absolute",
    bias: Bias = THEORY_ALONE,
    centre: Array | None = None,
    progress: Callable[[int, float], None] | None = None,
    notify: Callable[[str], None] = lambda text: None,
) -> Search:
    """Minimum of ``misfit`` over the unknowns of a plate file, on a reduced model.

    Frequencies with a label are compared with the mode that has it, the others in ascending order.
    Raises ``ValueError`` if the specimen has no measured frequencies or no unknowns, or if no particle is
    feasible, and ``LabelError`` for labels that the model does not have.

    swarms : largest number; 1 is the paper's single swarm as it ends, not polished
    spare : modes of the model beyond those of the list
    bias : of the theory, in the frequencies that are compared
    centre : (n,) constants where the plate model is converged; left out, it is at the reference, and at the
        answer if that is far from it
    progress : called with the iteration over all swarms and the best misfit of the one that is running
    """
    measurement, unknowns = required(specimen)
    settings = settings or SwarmSettings()
    n_modes = measurement.size + max(spare, spare_modes(measurement))
    stays, solves, least = centre is not None, 0, np.inf
    reduction = ReductionSettings(basis_tolerance(measurement))
    for attempt in range(1, _MOST_MODELS + 1):
        reduced = reduced_model(
            specimen, unknowns, n_modes, settings=reduction, centre=centre, bias=bias, notify=notify
        )
        model = labelled_model(reduced, measurement, specimen)
        at = reference_vector(specimen, unknowns) if centre is None else centre
        sd = residual_sd(specimen, model, at) if residual == "whitened" else None
        task = _Task(specimen, model, measurement, unknowns, settings, residual, sd)
        run = _Swarms(task, seed, swarms, progress)
        # the first swarm tells whether the model is converged where the answer lies: the others wait for that
        run.add()
        at, error = run.best, discretisation_error(model.full, run.best)
        last = stays or attempt == _MOST_MODELS or error.max() >= least or is_time_up()
        if error.max() <= _ACCEPTED_ERROR or last:
            run.finish()
            if not np.allclose(run.best, at, rtol=_SAME_PLACE):
                error = discretisation_error(model.full, run.best)
        solves += run.solves
        if error.max() <= _ACCEPTED_ERROR or last:
            break
        notify("the answer is far from the reference constants: converging the plate model there")
        centre, least = run.best, _LOWER_ERROR * float(error.max())
    return Search(model, replace(run.result(), evaluations=solves), error, centre, run.optima, run.number)


Progress = Callable[[int, float], None] | None


@dataclass(frozen=True, slots=True)
class _Task:
    """The objective of a swarm."""

    specimen: Specimen
    model: ReducedModel
    measurement: Measurement
    unknowns: ParameterSet
    settings: SwarmSettings
    residual: Residual
    sd: Array | None

    def objective(self, x: Array) -> Array:
        """Misfit (m,) at constants (m, n)."""
        f = self.model.predict(x).frequencies[:, : self.measurement.size]
        if self.sd is not None:
            return np.asarray(np.sum(((f - self.measurement.frequencies) / self.sd) ** 2, axis=1))
        return misfit(f, self.measurement.frequencies, self.residual)

    @property
    def weight(self) -> Array:
        """Weights (n_f,) of the differences before they are squared."""
        measured = self.measurement.frequencies
        if self.sd is not None:
            return 1.0 / self.sd
        return 1.0 / measured if self.residual == "relative" else np.ones_like(measured)

    @property
    def half(self) -> Array:
        """Constants (n,) per unit of the coordinates of a polishing, whose bounds are +-3^(1/2)."""
        return np.asarray(0.5 * (self.unknowns.upper - self.unknowns.lower) / _HALF_WIDTH)

    @property
    def middle(self) -> Array:
        """Middles (n,) of the search intervals."""
        return np.asarray(0.5 * (self.unknowns.lower + self.unknowns.upper))

    def to_x(self, u: Array) -> Array:
        """Constants at coordinates (..., n)."""
        x = self.middle + self.half * u
        return np.asarray(np.clip(x, self.unknowns.lower, self.unknowns.upper))

    def variance(self, value: float) -> float:
        """Variance of a difference if the misfit is noise, at least that of rounding."""
        f = self.measurement.frequencies
        least = len(f) * (LEAST_RMS * float((self.weight * f).max())) ** 2
        return max(value, least) / max(len(f) - self.unknowns.size, 1)

    def start(self, rng: np.random.Generator) -> Array:
        """Start positions (particles, n) of a swarm."""
        return material_swarm(self.specimen.material, self.unknowns, self.settings.particles, rng)

    def swarm(self, start: Array, rng: np.random.Generator, progress: Progress) -> SwarmResult:
        """Run a swarm from these positions."""
        bounds = self.unknowns.lower, self.unknowns.upper
        feasible = self.model.full.admissible
        return minimise(
            self.objective, *bounds, start, self.settings, rng, feasible=feasible, progress=progress
        )


@dataclass(slots=True)
class _Swarms:
    """Swarms that run one after the other until two of them have found the best optimum.

    most : largest number of swarms; one alone is not polished
    first : the first one, as a single one would run
    optima : of all so far, the best first
    """

    task: _Task
    seed: int
    most: int
    progress: Progress
    first: SwarmResult | None = None
    ends: list[_Ends] = field(default_factory=list)
    optima: tuple[Optimum, ...] = ()
    solves: int = 0

    @property
    def number(self) -> int:
        """Number of swarms that have run."""
        return max(len(self.ends), 1)

    @property
    def best(self) -> Array:
        """Constants of the best optimum, (n,)."""
        return self.optima[0].x

    def add(self) -> None:
        """Run the next swarm."""
        k = len(self.ends)
        rng = np.random.default_rng(swarm_seed(self.seed, k))
        start = self.task.start(rng)
        swarm = self.task.swarm(start, rng, shifted(self.progress, k * self.task.settings.iterations))
        self.first = self.first or swarm
        self.solves += swarm.evaluations
        if self.most == 1:
            self.optima = (Optimum(swarm.best, swarm.value, 1),)
            return
        self.ends.append(_polished(self.task, np.vstack((swarm.best, start)), swarm.value))
        self.solves += self.ends[-1].solves
        self.optima = _distinct(self.task, self.ends)

    def finish(self) -> None:
        """Run more swarms until the best optimum is found again."""
        while self.number < self.most and not (self.number >= LEAST_SWARMS and self._agreed):
            if is_time_up():
                cut_short("cut_swarms", done=self.number, of=LEAST_SWARMS)
                break
            self.add()

    @property
    def _agreed(self) -> bool:
        return self.optima[0].swarms >= FOUND_AGAIN

    def result(self) -> SwarmResult:
        """The first swarm, with the best optimum and the status of all."""
        assert self.first is not None
        if self.most == 1:
            return self.first
        return replace(
            self.first,
            best=self.best,
            value=self.optima[0].value,
            status="converged" if self._agreed else "budget",
            message=_MESSAGES[self._agreed].format(run=self.number, swarms=self.optima[0].swarms),
        )


_MESSAGES = {
    True: "{swarms} of {run} swarms, polished by derivatives, found this optimum; none found a better one",
    False: (
        "the best optimum of {run} swarms, polished by derivatives, was found by one of them alone: there "
        "may be a better one; allow more swarms, or narrow the bounds"
    ),
}


def swarm_seed(seed: int, k: int) -> int | list[int]:
    """The seed of the k-th of several swarms: the first runs as a single one would."""
    return seed if k == 0 else [seed, k]


def shifted(progress: Progress, done: int) -> Progress:
    """Progress callback of a swarm that begins after so many iterations of others."""
    return None if progress is None else lambda iteration, best: progress(done + iteration, best)


@dataclass(frozen=True, slots=True)
class _Ends:
    """Ends of the polishing of one swarm.

    u : (m, n) constants from -1 to 1 times the half width of their intervals
    value : (m,) misfits
    curvature : (m, n, n) of the misfit over 2, in u
    solves : forward solves that it took
    """

    u: Array
    value: Array
    curvature: Array
    solves: int


def _polished(task: _Task, start: Array, value: float) -> _Ends:
    """Local minima of the misfit next to constants (m, n), the first of them with this misfit."""
    measured, weight, half = task.measurement.frequencies, task.weight, task.half
    variance, solves = task.variance(value), 0

    def target(u: Array, rows: Array) -> Expansion:
        nonlocal solves
        del rows
        m, n = u.shape
        x = task.to_x(u)
        values, gradient, curvature = np.full(m, -np.inf), np.zeros((m, n)), np.zeros((m, n, n))
        inside = np.flatnonzero(task.model.full.admissible(x))
        if len(inside):
            solves += len(inside)
            prediction = task.model.predict(x[inside], jacobian=True)
            assert prediction.jacobian is not None
            r = (prediction.frequencies[:, : len(measured)] - measured) * weight
            slope = prediction.jacobian[:, : len(measured)] * weight[:, None] * half
            values[inside] = -0.5 * np.sum(r**2, axis=1) / variance
            gradient[inside] = -np.einsum("mi,mij->mj", r, slope) / variance
            curvature[inside] = np.swapaxes(slope, 1, 2) @ slope / variance
        return Expansion(values, gradient, curvature)

    def value_of(u: Array) -> Array:
        nonlocal solves
        values = np.full(len(u), -np.inf)
        x = task.to_x(u)
        inside = np.flatnonzero(task.model.full.admissible(x))
        solves += len(inside)
        if len(inside):
            values[inside] = -0.5 * task.objective(x[inside]) / variance
        return values

    bound = np.full(len(half), _HALF_WIDTH)
    ends = maximise(target, (start - task.middle) / half, -bound, bound, most_steps=_STEPS)
    value_at = np.where(np.isfinite(ends.expansion.value), ends.expansion.value, -np.inf)
    row = int(np.argmax(value_at))
    # two modes that cross leave a kink, where steps shrink before the optimum
    at = ends.expansion.of(np.array([row]))
    best, expansion, _ = polish(value_of, target, ends.u[row], at, -bound, bound)
    u, curvature = ends.u.copy(), ends.expansion.curvature.copy()
    u[row], curvature[row], value_at[row] = best, expansion.curvature[0], expansion.value[0]
    known = np.isfinite(value_at)
    return _Ends(u[known], -2.0 * variance * value_at[known], variance * curvature[known], solves)


def _distinct(task: _Task, ends: Sequence[_Ends]) -> tuple[Optimum, ...]:
    """Distinct optima, the best first, each with the number of swarms that found it."""
    u = np.concatenate([e.u for e in ends])
    value = np.concatenate([e.value for e in ends])
    curvature = np.concatenate([e.curvature for e in ends])
    swarm = np.repeat(np.arange(len(ends)), [len(e.value) for e in ends])
    variance = task.variance(float(value.min()))
    height = -0.5 * value / variance
    # both are optima: where one lies on the way to the other it has a misfit of its own
    of = distinct(u, height, curvature / variance, _SAME, depth=_DEPTH, drop=0.5 * _SAME**2)
    best = [int(i) for i in np.argsort(value, kind="stable") if of[i] == i]
    return tuple(Optimum(task.to_x(u[i]), float(value[i]), len(set(swarm[of == i].tolist()))) for i in best)


# Modes considered beyond a list that may lack some, and beyond a complete one.
_SPARE_MODES, _ONE_MORE = 4, 1


@dataclass(frozen=True, slots=True)
class Start:
    """A posterior and the personal bests of a swarm on it or on its misfit.

    bests : (m, n_plate) the plate's parameters, without the noise; values : (m,) what the swarm
    minimised; solves : its forward solves.
    """

    posterior: Posterior
    model: ReducedModel
    bests: Array
    values: Array
    solves: int


@checked
@single_blas_thread
def posterior(
    plate: PlateLike,
    *,
    likelihood: Likelihood = "relative",
    degrees_of_freedom: float = np.inf,
    near: Neighbour | None = None,
) -> Posterior:
    """Posterior of a plate's unknowns, of its sizes and of the frequency scale: that of `sample`.

    The building block for one's own sampler or optimiser: ``log_prob`` takes parameter vectors (m, n) in SI
    units, in the order of ``parameters.names``, and returns (m,). The plate model is converged about the
    reference constants.

    Parameters
    ----------
    plate : a built-in name, a path, a table or a `Specimen`, see `read_plate`
    likelihood, degrees_of_freedom : of the noise, see `sample`
    near : a plate of slightly other sizes, whose trial functions are reused unconverged where they suit

    Raises
    ------
    ValueError
        If the plate cannot be read, has no measured frequencies or no unknowns.

    Examples
    --------
    >>> import cpam_bayes as cb
    >>> posterior = cb.posterior(cb.read_plate("A1").with_exact_sizes())
    >>> posterior.parameters.names
    ('E1', 'nu12', 'relative_std')
    >>> inside, outside = posterior.log_prob([[67e9, 0.33, 0.01], [300e9, 0.33, 0.01]])
    >>> print(inside > -40, outside)
    True -inf
    """
    require_choice("likelihood", likelihood, get_args(Likelihood))
    specimen = with_references(require_supported(read_plate(plate), NO_MESH))
    measurement, unknowns = required(specimen)
    spare = max(_ONE_MORE if measurement.complete else _SPARE_MODES, spare_modes(measurement))
    parameters = unknowns.union(size_parameters(specimen))
    with explained_failures(specimen):
        reduction = ReductionSettings(basis_tolerance(measurement))
        n_modes, bias = measurement.size + spare, _bias_of(specimen, likelihood)
        reduced = reduced_model(specimen, parameters, n_modes, settings=reduction, near=near, bias=bias)
    model = labelled_model(reduced, measurement, specimen)
    at = reference_vector(specimen, parameters)
    return _posterior_about(specimen, model, at, reduced.full.error, likelihood, degrees_of_freedom)


def _bias_of(specimen: Specimen, likelihood: Likelihood) -> Bias:
    """Bias of the theory; ``THEORY_ALONE`` for eq. (7), the absolute likelihood."""
    return THEORY_ALONE if likelihood == "absolute" else theory_bias(specimen)


def _posterior_about(
    specimen: Specimen,
    model: ReducedModel,
    at: Array,
    error: Array,
    likelihood: Likelihood,
    degrees_of_freedom: float,
) -> Posterior:
    """Posterior with the known errors of a model evaluated at a parameter vector (n,).

    For eq. (7), the absolute likelihood, they are the solver's and those of sizes whose sd the file states.

    error : (n_modes,) of the solver there
    """
    measurement, unknowns = required(specimen)
    if likelihood == "absolute":
        by_model, predicting = np.hypot(error, model.tolerance), None
    else:
        by_model = scatter(specimen, model, at, error)
        values = model.parameters.mapping(at)
        constants = {name: float(values[name]) for name in unknowns.names}
        predicting = tolerant(specimen, model, constants, list_order(model, at))
    return plate_posterior(
        model,
        measurement,
        by_model,
        likelihood=likelihood,
        degrees_of_freedom=degrees_of_freedom,
        tolerant=predicting,
    )


@single_blas_thread
def start_of(
    specimen: Specimen,
    seed: int,
    *,
    likelihood: Likelihood = "relative",
    degrees_of_freedom: float = np.inf,
    swarm_settings: SwarmSettings | None = None,
    notify: Callable[[str], None] = lambda text: None,
) -> Start:
    """Posterior of a specimen's unknowns, sizes and frequency scale, and the swarm that starts its sampling.

    A complete list is first fitted by the paper's swarm with the sizes of the plate file, an
    incomplete one by a swarm on the posterior itself. likelihood, degrees_of_freedom : of the noise,
    as of ``noise_model``. Raises ``ValueError`` as ``identify`` and ``noise_model`` do.
    """
    measurement, unknowns = required(specimen)
    sizes = size_parameters(specimen)
    parameters = unknowns.union(sizes)
    reduction, bias = ReductionSettings(basis_tolerance(measurement)), _bias_of(specimen, likelihood)

    if not measurement.complete:
        spare = max(_SPARE_MODES, spare_modes(measurement))
        reduced = reduced_model(
            specimen, parameters, measurement.size + spare, settings=reduction, bias=bias, notify=notify
        )
        model = labelled_model(reduced, measurement, specimen)
        at = reference_vector(specimen, parameters)
        target = _posterior_about(specimen, model, at, reduced.full.error, likelihood, degrees_of_freedom)
        bests, values, solves = swarm_on_posterior(target, seed, swarm_settings or SwarmSettings())
        return Start(target, model, bests, values, solves)
    searched = search(specimen, seed, spare=_ONE_MORE, settings=swarm_settings, bias=bias, notify=notify)
    swarm, model, error = searched.swarm, searched.model, searched.error
    at = swarm.best
    if sizes.size:
        nominal = reference_vector(specimen, sizes)
        at = np.append(at, nominal)
        centre = None if searched.centre is None else np.append(searched.centre, nominal)
        reduced = reduced_model(
            specimen,
            parameters,
            model.n_modes,
            settings=reduction,
            centre=centre,
            bias=bias,
            notify=notify,
        )
        model = labelled_model(reduced, measurement, specimen)
        error = discretisation_error(reduced.full, at)
    target = _posterior_about(specimen, model, at, error, likelihood, degrees_of_freedom)
    numbers = target.model.parameters.without(*searched.model.parameters.names)
    as_stated = np.tile(reference_vector(specimen, numbers), (len(swarm.personal_bests), 1))
    bests = np.column_stack((swarm.personal_bests, as_stated))
    return Start(target, model, bests, swarm.personal_values, swarm.evaluations)
