"""Conditional posteriors of stacking sequences, many sequences at once.

Given a sequence, the posterior is over the constants, the common errors of all frequencies, by sizes, mass,
frequency scale and theory, and the noise. Its evidence is by Laplace's method about the best of a few optima
(`fit_conditionals`), or by importance sampling about the same optima (`importance_evidence`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp, ndtri
from scipy.stats import qmc

from cpam_bayes.forward_model.known_errors import TolerantModel
from cpam_bayes.forward_model.model import ForwardModel, PlateModel
from cpam_bayes.forward_model.reduced import ReducedModel, focused
from cpam_bayes.inference.importance import Rounds, importance
from cpam_bayes.inference.laplace import log_volume
from cpam_bayes.inference.optimise import maximise, promised_gain
from cpam_bayes.inference.posterior import Posterior, plate_posterior
from cpam_bayes.inference.scores import Expansion, NormalScores, distinct
from cpam_bayes.inference.student_mixture import Mixture
from cpam_bayes.mechanics.problem import PlateState, StateFunction, Values
from cpam_bayes.parameters import Parameter, ParameterSet, TruncatedNormal
from cpam_bayes.plate.laminate import LaminateGeometry
from cpam_bayes.running import single_blas_thread

Array = NDArray[Any]

# Distance, in standard deviations, within which two optimisations of a sequence ended at one optimum.
_SAME = 0.5
# Optima this far below the best one of a sequence carry no probability.
_NEGLIGIBLE_NATS = 12.0
# Least curvature, against a direction that prior and data leave flat.
CURVATURE_FLOOR = 1e-3
# Optimisations end where a step promises less than this, nats, or after so many steps.
_PROMISED, _MOST_STEPS = 1e-4, 30
# Possible remaining gain of an optimisation that may be given up, over what a quadratic promises.
_UNFORESEEN = 1.5
# Numbers in the matrices of sequences that are solved for together: they fit in the processor's cache.
_CACHED = 1 << 19
# Degrees of freedom and widening of the proposals of importance sampling. With light tails few points scatter
# less, but the mean of 512 weights is too small where a constant is left open.
_LIGHT, _HEAVY = (6.0, 1.1), (3.0, 1.3)
# Draws of the constants that are kept of each sequence.
_KEPT = 32
# Points of importance sampling that are solved for together.
_POINTS = 2048
# Number of rounds, log2, between which proposals are refitted.
_LOG2_ROUNDS = 2
# Unsure evidences get 2^m times as many points, for each m in turn while they stay so.
_MORE = (2, 4)
# Basis for one sequence: sets of constants from which it is made, their widening over the posterior, its
# relative error, and the largest ratio of that to the noise.
_OWN_SETS, _OWN_WIDER, _OWN_ERROR, _OWN_SHARE = 64, 1.5, 1e-3, 0.05
# Points per dimension for which the first proposal counts where it is refitted.
_PRIOR_POINTS = 3.0
# Least weight of an optimum that counts in a proposal, and the least fraction that it then gets.
_USED, _LEAST_FRACTION = 1e-4, 0.1


# Range of the factor of a common error about one, in standard deviations, and the least factor.
_REACH, _LEAST_FACTOR = 5.0, 0.1


@dataclass(frozen=True, slots=True, eq=False)
class CommonErrors:
    """Factors of the frequencies by errors of sizes, mass, scale and theory: 1 for the plate as stated.

    sd : (k,) of the factors, which are normal.
    powers : (k, n_modes) of each factor in each predicted frequency.
    """

    sd: Array
    powers: Array

    def beside(self, model: ForwardModel) -> ForwardModel:
        """The model with the factors as its last parameters."""
        if not len(self.sd):
            return model
        factors = tuple(_factor(f"common error {i}", sd) for i, sd in enumerate(self.sd.tolist(), 1))
        return TolerantModel(model, ParameterSet(factors), self.powers)


NO_ERRORS: Final = CommonErrors(np.empty(0), np.empty((0, 0)))


def _factor(name: str, sd: float) -> Parameter:
    ends = max(1.0 - _REACH * sd, _LEAST_FACTOR), 1.0 + _REACH * sd
    return Parameter(name, "", TruncatedNormal(1.0, sd, *ends))


@dataclass(frozen=True, slots=True)
class ConditionalPosterior:
    """The posterior of constants (and noise) for any sequence of one layup.

    model : reduced, of the unknown angles and then the constants.
    template : a posterior without angles, whose model is that of some sequence.
    axes : coordinates in which the prior is a standard normal.
    common : errors that all frequencies have in common.
    """

    model: ReducedModel
    template: Posterior
    axes: NormalScores
    n_angles: int
    common: CommonErrors = NO_ERRORS

    @property
    def parameters(self) -> ParameterSet:
        """Constants, common errors, and the noise where it is inferred."""
        return self.template.parameters

    @property
    def n_constants(self) -> int:
        """Number of the constants, which are the first parameters."""
        return self.template.model.parameters.size - len(self.common.sd)

    @property
    def shown(self) -> Array:
        """Columns of the constants and of the noise among the parameters."""
        n = self.n_constants
        return np.concatenate((np.arange(n), np.arange(n + len(self.common.sd), self.parameters.size)))

    def nominal(self, constants: Array) -> Array:
        """Model parameters (..., n) from constants (..., n_constants), with the sizes as stated."""
        as_stated = np.ones((*constants.shape[:-1], len(self.common.sd)))
        return np.concatenate((constants, as_stated), axis=-1)

    def at(self, angles_deg: Array, rows: Array | None = None) -> Posterior:
        """The posterior of stacks whose row i has the sequence i, or rows[i], among (m, n_angles) degrees."""
        geometry = _geometry(self, angles_deg)
        geometry = geometry if rows is None else _rows(geometry, rows)
        return replace(self.template, model=self.model_at(geometry))

    def model_at(self, geometry: LaminateGeometry | None) -> ForwardModel:
        """The model of the constants and common errors: row i of a stack has the layup i."""
        return self.common.beside(_model_at(self.model, self.n_angles, geometry))

    def relative_noise(self, x: Array) -> Array:
        """Relative standard deviations (m, n_f) of noise and rounding at parameters x (m, n)."""
        noise = self.template.noise_model
        variance = (self.template.amplitude(x)[:, None] * noise.scale) ** 2 + noise.rounding
        return np.asarray(np.sqrt(variance) / self.template.measurement.frequencies)

    def least_noise(self, x: Array) -> float:
        """The least relative noise at any of the parameters x (m, n)."""
        return float(self.relative_noise(x).min())


def conditional_posterior(
    model: ReducedModel,
    n_angles: int,
    measurement: Any,
    solver_error: Array,
    common: CommonErrors = NO_ERRORS,
    **options: Any,
) -> ConditionalPosterior:
    """The conditional posterior of a model whose first ``n_angles`` parameters are ply angles.

    options : as of ``plate_posterior``.
    """
    some = _model_at(model, n_angles, None)
    template = plate_posterior(some, measurement, solver_error, tolerant=common.beside(some), **options)
    return ConditionalPosterior(model, template, NormalScores(template.parameters), n_angles, common)


def _geometry(conditional: ConditionalPosterior, angles_deg: Array) -> LaminateGeometry:
    problem = conditional.model.fast.operator.problem
    names = problem.parameters.names[: conditional.n_angles]
    others = {p.name: np.asarray(p.prior.mean) for p in problem.parameters.parameters[conditional.n_angles :]}
    values = {**others, **{name: angles_deg[:, i] for i, name in enumerate(names)}}
    state = problem.state(values)
    assert not isinstance(state.layup, LaminateGeometry)
    return state.geometry()


def _model_at(model: ReducedModel, n_angles: int, geometry: LaminateGeometry | None) -> ForwardModel:
    """The reduced plate with the sequences of a geometry: row i of a stack has the layup i."""
    operator = model.fast.operator
    problem = operator.problem
    constants = ParameterSet(problem.parameters.parameters[n_angles:], problem.parameters.fixed)
    angles = {name: np.asarray(0.0) for name in problem.parameters.names[:n_angles]}
    state = partial(_state_at, problem.state, angles, geometry)
    admissible = partial(_admissible_at, problem.admissible, angles)
    bound = replace(problem, parameters=constants, state=state, admissible=admissible)
    return PlateModel(replace(operator, problem=bound), model.n_modes, model.fast.error)


def _state_at(
    state: StateFunction, angles: Values, geometry: LaminateGeometry | None, values: Values
) -> PlateState:
    found = state({**values, **angles})
    if geometry is None or len(geometry.first) == 1:
        return found if geometry is None else replace(found, layup=geometry)
    shape = np.broadcast_shapes(*(np.shape(v) for v in values.values()))
    # derivatives repeat every row for each parameter, along a further axis
    return replace(found, layup=_rows(geometry, np.s_[:, None] if len(shape) > 1 else np.s_[:]))


def _admissible_at(admissible: Any, angles: Values, values: Values) -> Any:
    return admissible({**values, **angles})


def _rows(geometry: LaminateGeometry, rows: Any) -> LaminateGeometry:
    """Geometry of some layups of a stack."""
    return replace(
        geometry,
        in_plane=geometry.in_plane[rows],
        coupling=geometry.coupling[rows],
        flexural=geometry.flexural[rows],
        ply=geometry.ply[rows],
        first=geometry.first[rows],
        zeroth=None if geometry.zeroth is None else geometry.zeroth[rows],
    )


@dataclass(frozen=True, slots=True)
class ConditionalFits:
    """The conditional posteriors of m sequences about their optima.

    log_evidence : (m,) Laplace's, summed over the distinct optima.
    x : (m, n) parameters at the best optimum.
    residual : (m, n_frequencies) measured / predicted - 1 there, modes in ascending order.
    optima : (m, s, n) all optima, normal scores.
    weight : (m, s) their shares of the evidence, zero for copies.
    curvature : (m, s, n, n) negative Hessians (Gauss-Newton) there.
    """

    log_evidence: Array
    x: Array
    residual: Array
    optima: Array
    weight: Array
    curvature: Array

    def __getitem__(self, rows: Any) -> ConditionalFits:
        """The fits of some of the sequences."""
        return ConditionalFits(*(getattr(self, name)[rows] for name in self.__slots__))


Stack = TypeVar("Stack")


def joined(pieces: list[Stack]) -> Stack:
    """Several stacks concatenated."""
    kind: Any = type(pieces[0])
    found: Stack = kind(*(np.concatenate([getattr(p, name) for p in pieces]) for name in kind.__slots__))
    return found


@single_blas_thread
def fit_conditionals(
    conditional: ConditionalPosterior,
    angles_deg: Array,
    starts: Array,
    promised: float = _PROMISED,
    floor: float = -np.inf,
) -> ConditionalFits:
    """Laplace's evidence of sequences (m, n_angles), each optimised from every one of its starts.

    Z = sum over optima of (2 pi)^(n/2) det(H)^(-1/2) p(z), z being normal scores: the prior has no
    bounds there, and a constant that the data leave open is integrated exactly.

    starts : (s, n) for all sequences, or (m, s, n), parameters.
    promised : promised gain in nats below which an optimisation ends.
    floor : log evidence; optimisations that will not reach it are given up, with a result below it.
    """
    starts = np.broadcast_to(starts, (len(angles_deg), *starts.shape[-2:]))
    largest = max(block.size for block in conditional.model.fast.operator.blocks)
    each = int(np.clip(_CACHED // largest**2, 64, 512))
    return joined(
        [
            _fit(conditional, angles_deg[i : i + each], starts[i : i + each], promised, floor)
            for i in range(0, len(angles_deg), each)
        ]
    )


def _fit(
    conditional: ConditionalPosterior, angles_deg: Array, starts: Array, promised: float, floor: float
) -> ConditionalFits:
    m, s, n = starts.shape
    axes = conditional.axes
    geometry = _geometry(conditional, angles_deg)
    of_start = np.repeat(np.arange(m), s)

    def target(z: Array, rows: Array) -> Expansion:
        return _expand(conditional, geometry, z, of_start[rows])

    maxima = maximise(
        target,
        axes.to_z(starts.reshape(m * s, n)),
        axes.lower,
        axes.upper,
        most_steps=_MOST_STEPS,
        promised=promised,
        hopeless=None if np.isinf(floor) else partial(_stays_below, floor),
    )
    e = maxima.expansion
    value = np.where(np.isfinite(e.value), e.value, -1e300).reshape(m, s)
    z = maxima.u.reshape(m, s, n)
    curvature = e.curvature.reshape(m, s, n, n)
    flat = CURVATURE_FLOOR * np.eye(n)
    of = distinct(z, value, curvature, _SAME, depth=_NEGLIGIBLE_NATS)
    log_z = np.where(of == np.arange(s), value + log_volume(curvature + flat), -np.inf)
    total = logsumexp(log_z, axis=1)
    x = axes.to_x(z[np.arange(m), value.argmax(axis=1)])
    at = replace(conditional.template, model=conditional.model_at(geometry))
    measured = conditional.template.measurement.frequencies
    residual = measured / at.predict(x)[:, : len(measured)] - 1.0
    return ConditionalFits(total, x, residual, z, np.exp(log_z - total[:, None]), curvature)


def _stays_below(floor: float, e: Expansion) -> Array:
    """Whether Laplace's log evidence at the optimum stays below a floor, far beyond any promised gain."""
    matrix = e.curvature + CURVATURE_FLOOR * np.eye(e.gradient.shape[1])
    promised = promised_gain(e.gradient, matrix)
    return np.asarray(e.value + _UNFORESEEN * promised + log_volume(matrix) < floor)


def _expand(
    conditional: ConditionalPosterior, geometry: LaminateGeometry, z: Array, rows: Array
) -> Expansion:
    """Log density over normal scores, expanded, of stacks whose rows are sequences ``rows`` of a geometry."""
    axes = conditional.axes
    x = axes.to_x(z)
    # rows outside the support are removed first: every row of a stack must have its parameter set
    inside = np.flatnonzero(np.isfinite(conditional.template.log_prior(x)))
    m, n = z.shape
    found = Expansion(np.full(m, -np.inf), np.zeros((m, n)), np.zeros((m, n, n)))
    if not len(inside):
        return found
    model = conditional.model_at(_rows(geometry, rows[inside]))
    likelihood = replace(conditional.template, model=model).expand_likelihood(x[inside])
    e = axes.with_prior(likelihood, x[inside], z[inside])
    found.value[inside], found.gradient[inside], found.curvature[inside] = e.value, e.gradient, e.curvature
    return found


@dataclass(frozen=True, slots=True)
class RefinementSettings:
    """When importance sampling of a stacking sequence is refined.

    refitted_from : least log2 of the points with which the proposal is refitted.
    resampled_from : least log2 of the points with which the proposal has heavy tails, and an unsure evidence
        is sampled again.
    unsure : standard error above which a log evidence is unsure.
    large : least number of functions in a block with which an unsure sequence gets its own basis.
    """

    refitted_from: int = 7
    resampled_from: int = 9
    unsure: float = 0.08
    large: int = 60


DEFAULT_REFINEMENT = RefinementSettings()


@dataclass(frozen=True, slots=True)
class Conditionals:
    """The conditional posteriors of m sequences by importance sampling.

    log_evidence : (m,).
    error, effective_size, k_hat : (m,) as in ``Weighted``.
    mean, sd : (m, n) of the parameters.
    draws : (m, 32, n), equally probable.
    """

    log_evidence: Array
    error: Array
    effective_size: Array
    k_hat: Array
    mean: Array
    sd: Array
    draws: Array

    def __getitem__(self, rows: Any) -> Conditionals:
        """Conditional posteriors of some of the sequences."""
        return Conditionals(*(getattr(self, name)[rows] for name in self.__slots__))


@single_blas_thread
def importance_evidence(
    conditional: ConditionalPosterior,
    angles_deg: Array,
    fits: ConditionalFits,
    log2_points: int = 9,
    *,
    settings: RefinementSettings = DEFAULT_REFINEMENT,
) -> Conditionals:
    """Conditional posteriors of sequences by importance sampling about their optima.

    The proposal is a mixture of Student-t densities about the optima, refitted after each quarter of 128
    points or more, see ``importance``. Unsure evidences of 512 points or more are sampled again with four
    times as many, and if still unsure with sixteen times; where solves are slow, each on a basis of its own.
    """
    found = _in_parts(conditional, angles_deg, fits, log2_points, settings)
    for more in _MORE if log2_points >= settings.resampled_from else ():
        unsure = np.flatnonzero(found.error > settings.unsure)
        if not len(unsure):
            break
        again = joined(
            [
                _importance(basis, angles_deg[[i]], fits[[i]], log2_points + more, settings)
                for i in unsure
                for basis in [_on_own_basis(conditional, angles_deg[i], found[i], settings.large)]
            ]
        )
        place = np.arange(len(angles_deg))
        place[unsure] = len(angles_deg) + np.arange(len(unsure))
        found = joined([found, again])[place]
    return found


def _in_parts(
    conditional: ConditionalPosterior,
    angles_deg: Array,
    fits: ConditionalFits,
    log2_points: int,
    settings: RefinementSettings,
) -> Conditionals:
    each = max(_POINTS >> log2_points, 1)
    return joined(
        [
            _importance(conditional, angles_deg[i : i + each], fits[i : i + each], log2_points, settings)
            for i in range(0, len(angles_deg), each)
        ]
    )


def _on_own_basis(
    conditional: ConditionalPosterior, angles_deg: Array, known: Conditionals, large: int
) -> ConditionalPosterior:
    """The posterior on a basis for one sequence (k,) and the known range of its constants.

    The constants are spread independently, which covers the posterior whatever its correlations are.
    """
    if max(block.size for block in conditional.model.fast.operator.blocks) < large:
        return conditional
    p = conditional.parameters
    spread = ndtri(qmc.Sobol(p.size, rng=np.random.default_rng(0)).random(_OWN_SETS))
    some = np.clip(known.mean + _OWN_WIDER * known.sd * spread, p.lower, p.upper)
    some = np.concatenate((known.draws, some[np.isfinite(conditional.template.log_prior(some))]))
    noise = conditional.least_noise(known.draws)
    constants = some[:, : conditional.n_constants]
    x = np.column_stack((np.broadcast_to(angles_deg, (len(some), len(angles_deg))), constants))
    return replace(conditional, model=focused(conditional.model, x, min(_OWN_ERROR, _OWN_SHARE * noise)))


def _about_optima(fits: ConditionalFits, freedom: float, wider: float) -> Mixture:
    used = fits.weight > _USED
    share = np.where(used, np.maximum(fits.weight, _LEAST_FRACTION), 0.0)
    covariance = np.linalg.inv(fits.curvature + CURVATURE_FLOOR * np.eye(fits.optima.shape[2]))
    factor = np.linalg.cholesky(covariance) * wider
    return Mixture(share / share.sum(axis=1, keepdims=True), fits.optima, factor, freedom)


def _importance(
    conditional: ConditionalPosterior,
    angles_deg: Array,
    fits: ConditionalFits,
    log2_points: int,
    settings: RefinementSettings,
) -> Conditionals:
    log2_rounds = _LOG2_ROUNDS if log2_points >= settings.refitted_from else 0
    freedom, wider = _HEAVY if log2_points >= settings.resampled_from else _LIGHT
    rounds = Rounds(
        log2_points - log2_rounds,
        most=1 << log2_rounds,
        enough=np.inf,
        good=np.inf,
        least_share=_LEAST_FRACTION,
        wider=wider,
        prior_points=_PRIOR_POINTS,
    )
    target = partial(_log_density, conditional, angles_deg)
    found, _ = importance(target, _about_optima(fits, freedom, wider), rounds)
    x = conditional.axes.to_x(found.points)
    mean = np.einsum("mp,mpj->mj", found.weight, x)
    sd = np.sqrt(np.einsum("mp,mpj->mj", found.weight, (x - mean[:, None, :]) ** 2))
    # systematic resampling over the points in Sobol order, which is as good as random; all sequences have the
    # same points: each begins elsewhere, so that their errors differ
    begin = (0.5 + angles_deg @ np.sqrt(np.arange(2.0, 2.0 + angles_deg.shape[1]))) % 1.0
    places = (np.arange(_KEPT) + begin[:, None, None]) / _KEPT
    kept = np.sum(np.cumsum(found.weight, axis=1)[:, :, None] < places, axis=1)
    draws = x[np.arange(len(x))[:, None], np.minimum(kept, x.shape[1] - 1)]
    return Conditionals(
        found.log_evidence, found.standard_error, found.effective_size, found.k_hat, mean, sd, draws
    )


def _log_density(conditional: ConditionalPosterior, angles_deg: Array, z: Array) -> Array:
    """Log density (m, p) over normal scores z (m, p, n), row i having the sequence i."""
    axes, (m, p, n) = conditional.axes, z.shape
    z = z.reshape(m * p, n)
    x = axes.to_x(z)
    inside = np.all((z >= axes.lower) & (z <= axes.upper), axis=1) & np.isfinite(
        conditional.template.log_prior(x)
    )
    found = np.full(m * p, -np.inf)
    # every row of a stack must have its parameter set: those outside the support are removed first
    rows = np.flatnonzero(inside)
    if len(rows):
        at = conditional.at(angles_deg, rows // p)
        found[rows] = at.log_likelihood(x[rows]) + axes.log_prior(z[rows])
    return found.reshape(m, p)
